//! Video clips of evaluations: their list and their contents.

use std::path::Path;

use blueprints::{Catalog, outside};
use proto::codec::{MAX_RECORDING_BYTES, decode_recording};
use proto::{Trajectory, WeightsVersion};
use render::picture::encode;
use render::video::{Episode, Film, LAST_S, MIN_WIDTH};
use runlog::RunPaths;
use runlog::clips::{Clip, RECORDING, clips};
use serde::Serialize;

/// Maximum number of listed clips.
const MAX_LISTED: usize = 60;

/// Maximum size of a served clip in bytes. A clip of 100 steps is below 2 MB.
const MAX_BYTES: u64 = 32 << 20;

/// Width of a clip's still image in pixels.
const POSTER_PX: usize = MIN_WIDTH;

/// Number of colors in that image.
const N_COLORS: usize = 96;

/// Clips and recordings of a run, read from their folders on every request.
#[derive(Clone, Debug)]
pub(super) struct Films(Option<RunPaths>);

/// A clip as sent to the browser.
#[derive(Debug, Serialize)]
pub(super) struct FilmView {
    /// Value of `id` in `/api/film?id=`.
    id: String,
    blueprint: String,
    weights_version: WeightsVersion,
    ending: &'static str,
}

impl Films {
    /// Creates a view of the clips of `run`; `None` has no clips.
    pub(super) fn new(run: Option<RunPaths>) -> Self {
        Self(run)
    }

    /// Returns the newest clips, newest first.
    pub(super) fn list(&self) -> Vec<FilmView> {
        let view = |film: &Clip| FilmView {
            id: id(film),
            blueprint: film.blueprint.to_string(),
            weights_version: film.version,
            ending: film.ending,
        };
        self.all().iter().take(MAX_LISTED).map(view).collect()
    }

    /// Returns the bytes of the clip with this id. The id is compared with the existing clips and never used as a path.
    pub(super) fn bytes(&self, asked: &str) -> Option<Vec<u8>> {
        let film = self.all().into_iter().find(|film| id(film) == asked)?;
        outside::read(&film.path, MAX_BYTES).ok()
    }

    /// Returns the recorded episode of the clip with this id.
    pub(super) fn recording(&self, asked: &str) -> Option<Trajectory> {
        let film = self.all().into_iter().find(|film| id(film) == asked)?;
        let name = Path::new(film.path.file_name()?).with_extension(RECORDING);
        let path = self.0.as_ref()?.replays().join(film.blueprint.as_str()).join(name);
        decode_recording(&outside::read(&path, MAX_RECORDING_BYTES as u64).ok()?).ok()
    }

    /// Returns a PNG of the last scene of the clip with this id; `None` without a recording or if the goal is unknown.
    pub(super) fn poster(&self, catalog: &Catalog, asked: &str) -> Option<Vec<u8>> {
        let recording = self.recording(asked)?;
        let goal = catalog.find(&recording.task.blueprint)?;
        let episode = Episode::new(&[recording], &goal).ok()?;
        let frame = Film::new(&episode, POSTER_PX).frame(episode.length_s() + LAST_S);
        encode(&frame, N_COLORS).ok()
    }

    fn all(&self) -> Vec<Clip> {
        self.0.as_ref().map(|run| clips(&run.videos())).unwrap_or_default()
    }
}

fn id(film: &Clip) -> String {
    format!("{}.{}.{}.{}", film.blueprint, film.version.0, film.ending, film.number)
}
