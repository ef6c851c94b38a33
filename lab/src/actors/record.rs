//! Records the segments that simulated actors send: parts of real episodes, cut as an actor of this configuration
//! would.

use std::path::{Path, PathBuf};

use actor::Lockstep;
use anyhow::Context;
use blueprints::Catalog;
use deploy::commands::{actor_setup, learner_setup};
use deploy::config::Config;
use learner::Learner;
use proto::codec::encode_recording;
use proto::{ActorId, Trajectory, Valid};

/// Segments to record; more would hardly change their mean size.
const N_SEGMENTS: usize = 16;

/// Worlds stepped to record them.
const N_WORLDS: usize = 4;

/// An actor name of typical length, because it counts toward the encoded size.
const NAME: &str = "load-1000";

/// A start time of typical length, because it counts toward the encoded size.
const EPOCH: u64 = 1_700_000_000_000;

/// Recorded segments.
pub(super) struct Recording {
    pub(super) files: Vec<PathBuf>,
    pub(super) n_steps: usize,
    pub(super) n_bytes: usize,
    /// Parameters of the network.
    pub(super) n_parameters: usize,
}

/// Steps a few worlds with the untrained policy and writes the segments that an actor would send to `folder`.
///
/// # Errors
/// When the configuration cannot be used or the folder cannot be written.
pub(super) fn record(config: &Valid<Config>, folder: &Path) -> anyhow::Result<Recording> {
    let weights = Learner::new(learner_setup(config, None, Catalog::builtin())?)?.weights();
    let id = ActorId::try_from(NAME.to_owned()).context("naming a simulated actor")?;
    let mut setup = actor_setup(config, id, Catalog::builtin());
    setup.config = setup.config.with(|actor| {
        actor.n_worlds = N_WORLDS;
        actor.n_threads = 1;
    })?;
    let mut worlds = Lockstep::new(setup);
    let mut segments = Vec::new();
    while segments.len() < N_SEGMENTS {
        segments.extend(worlds.step(&weights, false)?);
    }
    segments.truncate(N_SEGMENTS);
    let n_steps = segments.iter().map(|segment| segment.transitions.len()).sum();
    let mut recording = Recording { files: Vec::new(), n_steps, n_bytes: 0, n_parameters: weights.parameters.len() };
    for (i, segment) in segments.into_iter().enumerate() {
        let bytes = encode_recording(&Trajectory { epoch: EPOCH, ..segment });
        let path = folder.join(format!("segment-{i}.bin"));
        recording.n_bytes += bytes.len();
        std::fs::write(&path, bytes).with_context(|| format!("writing {}", path.display()))?;
        recording.files.push(path);
    }
    Ok(recording)
}
