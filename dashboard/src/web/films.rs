//! Video clips of evaluations: which there are, and their bytes.

use std::fs;
use std::path::Path;

use blueprints::Catalog;
use proto::codec::decode_trajectory;
use proto::{Trajectory, WeightsVersion};
use render::picture::encode;
use render::video::{Episode, Film, LAST_S, MIN_WIDTH};
use runlog::RunPaths;
use runlog::clips::{Clip, RECORDING, clips};
use serde::Serialize;

/// Most films that are told of.
const MAX_LISTED: usize = 60;

/// Largest film that is sent, bytes; one of 100 steps is below 2 MB.
const MAX_BYTES: u64 = 32 << 20;

/// Width of the still picture of a film.
const POSTER_PX: usize = MIN_WIDTH;

/// Colors of that picture.
const N_COLORS: usize = 96;

/// Clips and recordings of a run, read from their folders whenever somebody asks.
#[derive(Clone, Debug)]
pub(super) struct Films(Option<RunPaths>);

/// A film as it is told.
#[derive(Debug, Serialize)]
pub(super) struct FilmView {
    /// What `/api/film?id=` takes.
    id: String,
    blueprint: String,
    weights_version: WeightsVersion,
    ending: &'static str,
}

impl Films {
    /// Those of this run, if its evaluator keeps any.
    pub(super) fn new(run: Option<RunPaths>) -> Self {
        Self(run)
    }

    /// The newest ones, newest first.
    pub(super) fn list(&self) -> Vec<FilmView> {
        let view = |film: &Clip| FilmView {
            id: id(film),
            blueprint: film.blueprint.to_string(),
            weights_version: film.version,
            ending: film.ending,
        };
        self.all().iter().take(MAX_LISTED).map(view).collect()
    }

    /// The bytes of the film of this id. What is asked for is compared with what is there and is never a path.
    pub(super) fn bytes(&self, asked: &str) -> Option<Vec<u8>> {
        let film = self.all().into_iter().find(|film| id(film) == asked)?;
        let small = fs::metadata(&film.path).ok()?.len() <= MAX_BYTES;
        small.then(|| fs::read(&film.path).ok()).flatten()
    }

    /// The recorded episode that the film of this id shows.
    pub(super) fn recording(&self, asked: &str) -> Option<Trajectory> {
        let film = self.all().into_iter().find(|film| id(film) == asked)?;
        let name = Path::new(film.path.file_name()?).with_extension(RECORDING);
        let path = self.0.as_ref()?.replays().join(film.blueprint.as_str()).join(name);
        decode_trajectory(&fs::read(path).ok()?).ok()
    }

    /// A PNG of the last scene of the film of this id; `None` without a recording of a goal that is known.
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
