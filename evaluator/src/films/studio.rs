//! The thread that makes films, and the tray on which episodes wait for it.
//!
//! A pass never waits for films: what finds no room on the tray is counted and dropped.

use std::collections::VecDeque;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;

use anyhow::Context;
use blueprints::Catalogue;
use proto::Weights;
use proto::codec::encode_trajectory;
use proto::metrics::FilmCounts;
use proto::tensorboard::{EventWriter, Picture};

use super::RECORDING;
use super::casting::{Casting, Take};
use super::config::FilmsConfig;
use super::shelf::{Label, Shelf};
use crate::report::Acting;
use crate::run::RecordPaths;
use crate::video::{Episode, Film, Miniature, miniature, mp4};

/// Episodes that may wait: three passes of the default films, each up to about a megabyte.
pub(super) const ROOM: usize = 32;

/// A thread that makes films of what passes leave on its tray.
#[derive(Debug)]
pub(crate) struct Studio {
    config: FilmsConfig,
    tray: Arc<Tray>,
    /// Until it is closed.
    thread: Option<JoinHandle<()>>,
}

/// Where episodes wait to be made into films.
#[derive(Debug, Default)]
pub(super) struct Tray {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Debug, Default)]
struct State {
    takes: VecDeque<Take>,
    is_closed: bool,
    /// But for what waits.
    counts: FilmCounts,
}

/// The files that the thread writes.
struct Files {
    videos: Shelf,
    replays: Shelf,
    reel: Option<Reel>,
}

/// Small films for TensorBoard, in two files of which the older one goes when the newer one is full.
struct Reel {
    folder: PathBuf,
    writer: EventWriter,
    older: Option<PathBuf>,
    n_bytes: u64,
    /// Of one file.
    max_bytes: u64,
}

impl Studio {
    /// Starts the thread. `None` if no films are asked for.
    ///
    /// # Errors
    /// When the event file or the thread cannot be made.
    pub(crate) fn open(config: &FilmsConfig, paths: &RecordPaths) -> anyhow::Result<Option<Self>> {
        if !config.any() {
            return Ok(None);
        }
        let shelf = |folder: &Path, kind| Shelf { folder: folder.to_owned(), kind, keep: config.keep };
        let reel = (config.tensorboard_mb > 0)
            .then(|| Reel::create(&paths.tensorboard, config.tensorboard_mb))
            .transpose()
            .with_context(|| format!("writing to {}", paths.tensorboard.display()))?;
        let mut files = Files { videos: shelf(&paths.videos, "mp4"), replays: shelf(&paths.replays, RECORDING), reel };
        let tray = Arc::new(Tray::default());
        let (its_tray, its_config) = (tray.clone(), config.clone());
        let work = move || {
            while let Some((take, is_late)) = its_tray.next() {
                its_tray.note(files.keep(&take, &its_config, is_late), &take);
            }
        };
        let thread = std::thread::Builder::new().name("films".to_owned()).spawn(work)?;
        Ok(Some(Self { config: config.clone(), tray, thread: Some(thread) }))
    }

    /// The films of a pass that judges `weights`.
    pub(crate) fn casting(&self, weights: &Arc<Weights>, acting: &[Acting]) -> Option<Casting> {
        Casting::new(&self.config, weights.clone(), *acting.first()?, self.tray.clone())
    }

    /// What became of the films so far.
    pub(crate) fn counts(&self) -> FilmCounts {
        self.tray.counts()
    }

    /// Waits for counts that a test expects.
    #[cfg(test)]
    pub(super) fn wait_until(&self, is_reached: impl Fn(FilmCounts) -> bool) -> FilmCounts {
        self.tray.wait_until(is_reached)
    }

    /// Ends the thread after the film in hand; of what waits only the recordings are kept.
    pub(crate) fn close(mut self) {
        self.tray.close();
        if self.thread.take().is_some_and(|thread| thread.join().is_err()) {
            tracing::error!("the thread of films panicked");
        }
        let FilmCounts { written_total, dropped_total, failed_total, .. } = self.tray.counts();
        tracing::info!(written_total, dropped_total, failed_total, "films of evaluations");
    }
}

impl Drop for Studio {
    /// Also where an evaluator fails before it could be closed, the thread ends.
    fn drop(&mut self) {
        self.tray.close();
    }
}

/// What became of a take.
enum Made {
    Film { is_oversized: bool },
    RecordingOnly,
}

impl Tray {
    /// Leaves a take for the thread, unless the tray is full.
    pub(super) fn offer(&self, take: Take) {
        let mut state = self.state();
        if state.is_closed || state.takes.len() >= ROOM {
            state.counts.dropped_total += 1;
            tracing::debug!(blueprint = %take.trajectory.task.blueprint, "no room for a film");
            return;
        }
        state.takes.push_back(take);
        self.changed.notify_all();
    }

    pub(super) fn count_unrecorded(&self) {
        self.state().counts.unrecorded_total += 1;
    }

    pub(super) fn counts(&self) -> FilmCounts {
        self.state().all_counts()
    }

    /// Waits for the next take, and says whether the tray is closed; `None` once it is closed and empty.
    fn next(&self) -> Option<(Take, bool)> {
        let is_idle = |state: &mut State| state.takes.is_empty() && !state.is_closed;
        let mut state = self.changed.wait_while(self.state(), is_idle).unwrap_or_else(PoisonError::into_inner);
        let is_closed = state.is_closed;
        state.takes.pop_front().map(|take| (take, is_closed))
    }

    fn note(&self, made: anyhow::Result<Made>, take: &Take) {
        let mut state = self.state();
        let counts = &mut state.counts;
        match made {
            Ok(Made::Film { is_oversized }) => {
                counts.written_total += 1;
                counts.oversized_total += u64::from(is_oversized);
            }
            Ok(Made::RecordingOnly) => counts.dropped_total += 1,
            Err(error) => {
                counts.failed_total += 1;
                tracing::warn!(blueprint = %take.trajectory.task.blueprint, "a film failed: {error:#}");
            }
        }
        self.changed.notify_all();
    }

    fn close(&self) {
        self.state().is_closed = true;
        self.changed.notify_all();
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    #[cfg(test)]
    fn wait_until(&self, is_reached: impl Fn(FilmCounts) -> bool) -> FilmCounts {
        let waits = |state: &mut State| !is_reached(state.all_counts());
        self.changed.wait_while(self.state(), waits).unwrap().all_counts()
    }
}

impl State {
    fn all_counts(&self) -> FilmCounts {
        FilmCounts { n_waiting: self.takes.len() as u64, ..self.counts }
    }
}

impl Files {
    fn keep(&mut self, take: &Take, config: &FilmsConfig, is_late: bool) -> anyhow::Result<Made> {
        let (segment, id) = (&take.trajectory, &take.trajectory.task.blueprint);
        let label = Label { version: segment.weights_version, ending: take.ending, number: take.number };
        self.replays.put(id, label, &encode_trajectory(segment)).context("keeping the recording")?;
        if is_late {
            return Ok(Made::RecordingOnly);
        }
        let goal = Catalogue::builtin().get(id).context("its goal is not in the catalogue")?;
        let episode = Episode::new(std::slice::from_ref(segment), goal)?;
        let film = mp4(Film::new(&episode, config.width).frames(config.fps), config.fps)?;
        let path = self.videos.put(id, label, &film).context("keeping the film")?;
        tracing::debug!(path = %path.display(), "a film of an evaluation");
        let Some(reel) = &mut self.reel else { return Ok(Made::Film { is_oversized: false }) };
        let small = miniature(&episode)?;
        if let Some(small) = &small {
            reel.add(take, small).context("writing for TensorBoard")?;
        }
        Ok(Made::Film { is_oversized: small.is_none() })
    }
}

impl Reel {
    /// Beside the files with numbers, and not in one of them: readers take what is in one folder for one row of files.
    fn create(tensorboard: &Path, room_mb: u64) -> io::Result<Self> {
        let folder = tensorboard.join("films");
        let writer = EventWriter::create(&folder)?;
        Ok(Self { folder, writer, older: None, n_bytes: 0, max_bytes: room_mb * 1_000_000 / 2 })
    }

    fn add(&mut self, take: &Take, small: &Miniature) -> io::Result<()> {
        let [width, height] = small.size_px.map(|side| i32::try_from(side).unwrap_or(i32::MAX));
        let n_bytes = (small.gif.len() * take.tags.len()) as u64;
        if self.n_bytes > 0 && self.n_bytes + n_bytes > self.max_bytes {
            let newer = EventWriter::create(&self.folder)?;
            let full = std::mem::replace(&mut self.writer, newer);
            let oldest = self.older.replace(full.path().to_owned());
            self.n_bytes = 0;
            oldest.map_or(Ok(()), std::fs::remove_file)?;
        }
        self.n_bytes += n_bytes;
        let picture = Picture { height, width, colorspace: 3, encoded: small.gif.clone() };
        self.writer.picture(take.n_env_steps, &take.tags, &picture)
    }
}
