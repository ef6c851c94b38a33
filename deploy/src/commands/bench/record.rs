//! The segments that simulated actors send: of real episodes, as an actor of the configuration cuts them.

use std::path::{Path, PathBuf};

use actor::Lockstep;
use anyhow::Context;
use blueprints::Catalog;
use learner::Learner;
use proto::codec::encode_trajectory;
use proto::{ActorId, Trajectory};

use crate::commands::services::{actor_setup, learner_setup};
use crate::config::Config;
use crate::exit::Failure;

/// Segments recorded; more differ little in their mean size.
const N_SEGMENTS: usize = 16;

/// Worlds that are stepped for them.
const N_WORLDS: usize = 4;

/// Name of usual length, for sizes.
const NAME: &str = "load-1000";

/// Start time of usual length, for sizes.
const EPOCH: u64 = 1_700_000_000_000;

/// Recorded segments.
pub(super) struct Recording {
    pub(super) files: Vec<PathBuf>,
    pub(super) n_steps: usize,
    pub(super) n_bytes: usize,
    /// Of the network's weights.
    pub(super) n_parameters: usize,
}

/// Steps a few worlds with the untrained policy and writes what an actor would send into `folder`.
///
/// # Errors
/// When the configuration cannot be used or the folder not written.
pub(super) fn record(config: &Config, folder: &Path) -> Result<Recording, Failure> {
    let weights = Learner::new(learner_setup(config, None, Catalog::builtin())?).map_err(anyhow::Error::new)?.weights();
    let id = ActorId::try_from(NAME.to_owned()).context("naming a simulated actor")?;
    let mut setup = actor_setup(config, id);
    (setup.config.n_worlds, setup.config.n_threads) = (N_WORLDS, 1);
    let mut worlds = Lockstep::new(setup);
    let mut segments = Vec::new();
    while segments.len() < N_SEGMENTS {
        segments.extend(worlds.step(&weights, false)?);
    }
    segments.truncate(N_SEGMENTS);
    let n_steps = segments.iter().map(|segment| segment.transitions.len()).sum();
    let mut recording = Recording { files: Vec::new(), n_steps, n_bytes: 0, n_parameters: weights.parameters.len() };
    for (i, segment) in segments.into_iter().enumerate() {
        let bytes = encode_trajectory(&Trajectory { epoch: EPOCH, ..segment });
        let path = folder.join(format!("segment-{i}.bin"));
        recording.n_bytes += bytes.len();
        std::fs::write(&path, bytes).with_context(|| format!("writing {}", path.display()))?;
        recording.files.push(path);
    }
    Ok(recording)
}
