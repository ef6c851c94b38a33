//! The thread that renders videos.
//!
//! An evaluation never waits for videos: when the queue is full, new episodes are counted and dropped.

use std::sync::Arc;
use std::thread::JoinHandle;

use anyhow::Context;
use blueprints::Catalog;
use proto::codec::encode_recording;
use proto::metrics::VideoCounts;
use proto::{ActionMode, Status, Trajectory};

use super::queue::ClipQueue;
use super::selector::EpisodeSelector;
use crate::config::VideosConfig;
use render::video::{Episode, Video, mp4};
use runlog::RunPaths;
use runlog::videos::{Ending, RECORDING, VideoName, VideoStore};

/// Width of the frames in pixels.
const WIDTH_PX: usize = 640;

/// Frames per second; a second is ten timesteps.
const FPS: u32 = 20;

/// Number of videos kept per blueprint and ending (success or failure). Older videos are removed with their recordings.
const N_KEPT: usize = 10;

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
    catalog: Arc<Catalog>,
}

impl VideoRecorder {
    /// Starts the thread. Returns `None` if no videos are requested.
    ///
    /// # Errors
    /// If the thread cannot be created.
    pub(crate) fn open(config: &VideosConfig, paths: &RunPaths, catalog: Arc<Catalog>) -> anyhow::Result<Option<Self>> {
        if !config.any() {
            return Ok(None);
        }
        let store = |folder, kind| VideoStore { folder, kind, keep: N_KEPT };
        let files = Files { videos: store(paths.videos(), "mp4"), replays: store(paths.replays(), RECORDING), catalog };
        let queue = Arc::new(ClipQueue::default());
        let its_queue = queue.clone();
        let work = move || {
            while let Some((episode, is_late)) = its_queue.next() {
                let kept = files.keep(&episode, is_late);
                if let Err(error) = &kept {
                    tracing::warn!(blueprint = %episode.task.blueprint, "a video failed: {error:#}");
                }
                its_queue.count(|counts| match kept {
                    Ok(()) if is_late => counts.dropped_total += 1,
                    Ok(()) => counts.written_total += 1,
                    Err(_) => counts.failed_total += 1,
                });
            }
        };
        let thread = std::thread::Builder::new().name("videos".to_owned()).spawn(work)?;
        Ok(Some(Self { config: config.clone(), queue, thread: Some(thread) }))
    }

    /// Returns the selector of the episodes to record in an evaluation.
    pub(crate) fn selector(&self, acting: &[ActionMode]) -> Option<EpisodeSelector> {
        Some(EpisodeSelector::new(&self.config, *acting.first()?, self.queue.clone()))
    }

    pub(crate) fn counts(&self) -> VideoCounts {
        self.queue.counts()
    }

    /// Ends the thread after the current video. Of the waiting episodes, only the recordings are kept.
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
    /// Keeps the recording of an episode, and its video unless it `is_late`.
    fn keep(&self, episode: &Trajectory, is_late: bool) -> anyhow::Result<()> {
        let id = &episode.task.blueprint;
        let ending = if episode.status == Status::Success { Ending::Success } else { Ending::Failure };
        let label = VideoName { version: episode.weights_version, ending };
        self.replays.put(id, label, &encode_recording(episode)).context("keeping the recording")?;
        if is_late {
            return Ok(());
        }
        let goal = self.catalog.get(id).context("its goal is not in the catalog")?;
        let video = mp4(Video::new(&Episode::new(episode, goal)?, WIDTH_PX).frames(FPS), FPS)?;
        let path = self.videos.put(id, label, &video).context("keeping the video")?;
        tracing::debug!(path = %path.display(), "a video of an evaluation");
        Ok(())
    }
}
