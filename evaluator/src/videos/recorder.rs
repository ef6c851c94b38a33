//! The thread that renders videos.
//!
//! An evaluation never waits for videos: when the queue is full, new episodes are counted and dropped.

use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::thread::JoinHandle;

use anyhow::Context;
use blueprints::Catalog;
use proto::codec::encode_recording;
use proto::metrics::VideoCounts;
use proto::{Role, Weights};
use runlog::tensorboard::{EventWriter, Picture, event_files};

use super::queue::{ClipQueue, Made, VideoRequest};
use super::selector::EpisodeSelector;
use crate::config::VideosConfig;
use proto::ActionMode;
use render::video::{Episode, MINIATURE_PX, Video, miniature, mp4};
use runlog::RunPaths;
use runlog::videos::{RECORDING, VideoName, VideoStore};

/// Width of the frames in pixels.
const WIDTH_PX: usize = 640;

/// Frames per second; a second is ten timesteps.
const FPS: u32 = 20;

/// Number of videos kept per blueprint and ending (success or failure). Older videos are removed with their recordings.
const N_KEPT: usize = 10;

/// Space for small TensorBoard videos, in megabytes. When it is full, the older half is deleted.
const TENSORBOARD_MB: u64 = 64;

/// A thread that renders the episodes that evaluations put on its queue.
#[derive(Debug)]
pub(crate) struct VideoRecorder {
    config: VideosConfig,
    pub(super) queue: Arc<ClipQueue>,
    /// `None` once closed.
    thread: Option<JoinHandle<()>>,
}

/// The files that the thread writes.
struct Files {
    videos: VideoStore,
    replays: VideoStore,
    reel: Reel,
    catalog: Arc<Catalog>,
}

/// Small videos for TensorBoard, in two files. When the newer file is full, the older one is deleted.
pub(super) struct Reel {
    folder: PathBuf,
    writer: EventWriter,
    /// The previous file, of this process or of the one before it.
    older: Option<PathBuf>,
    n_bytes: u64,
    /// Maximum size of one file.
    max_bytes: u64,
    /// Whether an earlier process left videos that this one has not gone on from yet.
    goes_on: bool,
}

impl VideoRecorder {
    /// Starts the thread. Returns `None` if no videos are requested.
    ///
    /// # Errors
    /// If the event file or the thread cannot be created.
    pub(crate) fn open(config: &VideosConfig, paths: &RunPaths, catalog: Arc<Catalog>) -> anyhow::Result<Option<Self>> {
        if !config.any() {
            return Ok(None);
        }
        let store = |folder, kind| VideoStore { folder, kind, keep: N_KEPT };
        let tensorboard = paths.tensorboard(Role::Evaluator);
        let reel = Reel::create(&tensorboard, TENSORBOARD_MB)
            .with_context(|| format!("writing to {}", tensorboard.display()))?;
        let mut files =
            Files { videos: store(paths.videos(), "mp4"), replays: store(paths.replays(), RECORDING), reel, catalog };
        let queue = Arc::new(ClipQueue::default());
        let its_queue = queue.clone();
        let work = move || {
            while let Some(request) = its_queue.next() {
                let is_late = its_queue.is_closed();
                its_queue.note(files.keep(&request, is_late), &request);
            }
        };
        let thread = std::thread::Builder::new().name("videos".to_owned()).spawn(work)?;
        Ok(Some(Self { config: config.clone(), queue, thread: Some(thread) }))
    }

    /// Returns the selector of the episodes to record in an evaluation of `weights`.
    pub(crate) fn selector(&self, weights: &Arc<Weights>, acting: &[ActionMode]) -> Option<EpisodeSelector> {
        Some(EpisodeSelector::new(&self.config, weights.clone(), *acting.first()?, self.queue.clone()))
    }

    pub(crate) fn counts(&self) -> VideoCounts {
        self.queue.counts()
    }

    /// Ends the thread after the current video. Of the waiting requests, only the recordings are kept.
    pub(crate) fn close(mut self) {
        self.queue.close();
        if self.thread.take().is_some_and(|thread| thread.join().is_err()) {
            tracing::error!("the thread of videos panicked");
        }
        let VideoCounts { written_total, dropped_total, failed_total, .. } = self.queue.counts();
        tracing::info!(written_total, dropped_total, failed_total, "videos of evaluations");
    }
}

impl Drop for VideoRecorder {
    /// Ends the thread even if the evaluator fails before `close`.
    fn drop(&mut self) {
        self.queue.close();
    }
}

impl Files {
    /// Keeps the recording of a request, and its video unless it `is_late`.
    fn keep(&mut self, request: &VideoRequest, is_late: bool) -> anyhow::Result<Made> {
        let (segment, id) = (&request.trajectory, &request.trajectory.task.blueprint);
        let label = VideoName { version: segment.weights_version, ending: request.ending, number: request.number };
        self.replays.put(id, label, &encode_recording(segment)).context("keeping the recording")?;
        if is_late {
            return Ok(Made::RecordingOnly);
        }
        let goal = self.catalog.get(id).context("its goal is not in the catalog")?;
        let episode = Episode::new(std::slice::from_ref(segment), goal)?;
        let video = mp4(Video::new(&episode, WIDTH_PX).frames(FPS), FPS)?;
        let path = self.videos.put(id, label, &video).context("keeping the video")?;
        tracing::debug!(path = %path.display(), "a video of an evaluation");
        let small = miniature(&episode)?;
        if let Some(small) = &small {
            self.reel.add(request, small).context("writing for TensorBoard")?;
        }
        Ok(Made::Video { is_oversized: small.is_none() })
    }
}

impl Reel {
    /// Creates the event file in a folder other than that of the scalars, because readers treat all files of a folder
    /// as one series. Of the files that earlier processes left there, only the newest is kept, because a run that
    /// restarts often would otherwise exceed `room_mb` megabytes.
    ///
    /// # Errors
    /// If the folder cannot be read, a file cannot be deleted, or the new one cannot be created.
    pub(super) fn create(tensorboard: &Path, room_mb: u64) -> io::Result<Self> {
        let folder = tensorboard.join("videos");
        std::fs::create_dir_all(&folder)?;
        let mut left = event_files(&folder)?;
        let older = left.pop();
        left.into_iter().try_for_each(std::fs::remove_file)?;
        let writer = EventWriter::create(&folder)?;
        let goes_on = older.is_some();
        Ok(Self { folder, writer, older, n_bytes: 0, max_bytes: room_mb * 1_000_000 / 2, goes_on })
    }

    pub(super) fn add(&mut self, request: &VideoRequest, gif: &[u8]) -> io::Result<()> {
        let [width, height] = MINIATURE_PX.map(|side| i32::try_from(side).unwrap_or(i32::MAX));
        let n_bytes = (gif.len() * request.tags.len()) as u64;
        if self.n_bytes > 0 && self.n_bytes + n_bytes > self.max_bytes {
            let newer = EventWriter::create(&self.folder)?;
            let full = std::mem::replace(&mut self.writer, newer);
            let oldest = self.older.replace(full.path().to_owned());
            self.n_bytes = 0;
            oldest.map_or(Ok(()), std::fs::remove_file)?;
        }
        self.n_bytes += n_bytes;
        if std::mem::take(&mut self.goes_on) {
            self.writer.restart(request.n_env_steps)?;
        }
        let picture = Picture { height, width, colorspace: 3, encoded: gif.to_vec() };
        self.writer.picture(request.n_env_steps, &request.tags, &picture)
    }
}
