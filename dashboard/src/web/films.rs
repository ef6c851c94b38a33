//! Video clips of evaluations: which there are, and their bytes.

use std::fs;
use std::path::Path;

use proto::codec::decode_trajectory;
use proto::{Trajectory, WeightsVersion};
use serde::Serialize;

use runlog::RunPaths;
use runlog::clips::{Clip, RECORDING, clips};

/// Most films that are told of.
const MAX_LISTED: usize = 60;

/// Largest film that is sent, bytes; one of 100 steps is below 2 MB.
const MAX_BYTES: u64 = 32 << 20;

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

    fn all(&self) -> Vec<Clip> {
        self.0.as_ref().map(|run| clips(&run.videos())).unwrap_or_default()
    }
}

fn id(film: &Clip) -> String {
    format!("{}.{}.{}.{}", film.blueprint, film.version.0, film.ending, film.number)
}
