//! Checkpoints: everything that a learner needs to resume exactly.
//!
//! A checkpoint is a folder `step-<environment steps>` that contains
//! - `parameters.safetensors`: the network, one f32 tensor per parameter, by name;
//! - `adam.safetensors`: Adam's moments, `first.<name>` and `second.<name>`;
//! - `mailbox.bin`: waiting trajectories, each as a little-endian u64 length and a recording;
//! - `model.json`: the policy's configuration, enough to act with the parameters;
//! - `state.json`: the rest, the length and FNV-1a hash of each file above, and a digest of the parameters' names, shapes,
//!   and values in their order.
//!
//! A checkpoint is written under a temporary name, flushed to disk, and renamed, so a folder with the final name is
//! complete. The lengths and hashes detect other damage, such as an interrupted copy. A failed write, such as on a full
//! disk, leaves nothing behind. The next start removes the leftovers of a killed process.

mod error;
pub(crate) mod files;

use std::fs;
use std::path::{Path, PathBuf};

use policy::PolicyConfig;
use policy::model::{FORMAT_VERSION, FormatVersion, parse_policy, tensors};
use policy::parameters::{ParameterSpec, digest};
use proto::codec::{decode_recording, encode_recording};
use proto::{CanonicalSettings, Trajectory, Valid, Weights};
use serde::{Deserialize, Serialize};

use crate::adam::Adam;
use crate::state::LearnerState;
pub use error::CheckpointError;
use error::damaged;
pub(crate) use error::{at, io};
use files::FileInfo;
pub use files::clean;

/// A function that durably writes a new file to a folder.
pub(crate) type WriteFile<'w> = &'w mut dyn FnMut(&Path, &str, &[u8]) -> Result<FileInfo, CheckpointError>;

const PARAMETERS: &str = "parameters.safetensors";
const ADAM: &str = "adam.safetensors";
const MAILBOX: &str = "mailbox.bin";
const MODEL: &str = "model.json";
const STATE: &str = "state.json";

/// Maximum size of `state.json` in bytes; it has about 100 000.
const MAX_STATE_BYTES: u64 = 64 << 20;

/// The complete state of a learner.
#[derive(Clone, Debug, PartialEq)]
pub struct Checkpoint {
    /// Counters, statistics, curriculum, and random number generator.
    pub state: LearnerState,
    /// The policy's configuration.
    pub model: Valid<PolicyConfig>,
    /// Settings of policy and worlds.
    pub settings: CanonicalSettings,
    /// Names and shapes of the parameters in the order of `parameters`.
    pub table: Vec<ParameterSpec>,
    /// All parameters as one flat vector.
    pub parameters: Vec<f32>,
    /// The optimizer.
    pub adam: Adam,
    /// Waiting trajectories, oldest first.
    pub mailbox: Vec<Trajectory>,
}

/// The newest readable checkpoint, with the errors of newer ones.
#[derive(Debug)]
pub struct Found {
    /// Its folder.
    pub path: PathBuf,
    /// Its content.
    pub checkpoint: Checkpoint,
    /// The error of each newer checkpoint, newest first.
    pub passed_over: Vec<CheckpointError>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct StateFile {
    format_version: u32,
    files: Vec<FileInfo>,
    settings: CanonicalSettings,
    /// Of the parameters.
    digest: String,
    table: Vec<ParameterSpec>,
    adam_steps: u64,
    state: LearnerState,
}

impl Checkpoint {
    /// Writes the folder `step-<n>` in `dir`, replacing an existing one, and returns its path.
    ///
    /// # Errors
    /// If the file system returns an error. Incomplete files are removed, and an older checkpoint with the same name
    /// remains.
    pub fn write(&self, dir: &Path) -> Result<PathBuf, CheckpointError> {
        self.write_with(dir, &mut files::write)
    }

    /// Like [`Checkpoint::write`], but writes each file with `write`.
    pub(crate) fn write_with(&self, dir: &Path, write: WriteFile<'_>) -> Result<PathBuf, CheckpointError> {
        let path = dir.join(format!("{}{}", files::STEP, self.state.n_env_steps));
        let temporary = dir.join(format!("{}{}", files::NEW, self.state.n_env_steps));
        fs::create_dir_all(dir).map_err(io("creating", dir))?;
        files::remove(&temporary)?;
        let written = self.write_files(&temporary, write).and_then(|()| files::replace(&temporary, &path));
        if written.is_err()
            && let Err(error) = files::remove(&temporary)
        {
            // Report the first error, which explains more; the next start retries the cleanup.
            tracing::warn!(%error, "an incomplete checkpoint was not removed");
        }
        written?;
        files::sync_folder(dir)?;
        Ok(path)
    }

    /// Creates the folder with all files of the checkpoint.
    fn write_files(&self, temporary: &Path, write: WriteFile<'_>) -> Result<(), CheckpointError> {
        fs::create_dir(temporary).map_err(io("creating", temporary))?;
        let tensors = |vectors: &[_]| tensors::write(&self.table, vectors, None).map_err(at(temporary));
        let contents = [
            (PARAMETERS, tensors(&[("", &self.parameters)])?),
            (ADAM, tensors(&[("first.", &self.adam.first), ("second.", &self.adam.second)])?),
            (MAILBOX, pack(&self.mailbox)),
            (MODEL, json(&self.model)?),
        ];
        let files = contents.iter().map(|(name, bytes)| write(temporary, name, bytes)).collect::<Result<_, _>>()?;
        let state = StateFile {
            format_version: FORMAT_VERSION,
            files,
            settings: self.settings.clone(),
            digest: digest(&self.table, &self.parameters),
            table: self.table.clone(),
            adam_steps: self.adam.n_steps,
            state: self.state.clone(),
        };
        write(temporary, STATE, &json(&state)?)?;
        files::sync_folder(temporary)
    }

    /// Reads a folder written by [`Checkpoint::write`].
    ///
    /// # Errors
    /// [`CheckpointError::File`] with the first file that cannot be used, or a file system error.
    pub fn read(path: &Path) -> Result<Self, CheckpointError> {
        let bytes = files::read(path, STATE, MAX_STATE_BYTES)?;
        parse::<FormatVersion>(path, STATE, &bytes)?.check().map_err(at(&path.join(STATE)))?;
        let state: StateFile = parse(path, STATE, &bytes)?;
        let verified = |name| files::read_verified(path, name, &state.files);
        let [parameters] =
            tensors::read(&verified(PARAMETERS)?, &state.table, [""]).map_err(at(&path.join(PARAMETERS)))?;
        tensors::check_digest(&state.table, &parameters, &state.digest).map_err(at(&path.join(STATE)))?;
        let [first, second] =
            tensors::read(&verified(ADAM)?, &state.table, ["first.", "second."]).map_err(at(&path.join(ADAM)))?;
        let mailbox = unpack(path, MAILBOX, &verified(MAILBOX)?)?;
        let model = parse_policy(parse(path, MODEL, &verified(MODEL)?)?).map_err(at(&path.join(MODEL)))?;
        state.state.check(&model).map_err(|error| damaged(path, STATE, error.to_string()))?;
        let adam = Adam { first, second, n_steps: state.adam_steps };
        let StateFile { table, settings, state, .. } = state;
        Ok(Self { state, model, settings, table, parameters, adam, mailbox })
    }

    /// Reads the newest valid checkpoint in `dir`, or `dir` itself if it is a checkpoint.
    ///
    /// # Errors
    /// [`CheckpointError::Absent`] if there is none; if all are damaged, the error of the newest.
    pub fn read_latest(dir: &Path) -> Result<Found, CheckpointError> {
        if dir.join(STATE).exists() {
            return Ok(Found { path: dir.into(), checkpoint: Self::read(dir)?, passed_over: Vec::new() });
        }
        let mut passed_over = Vec::new();
        for (_, path) in files::steps(dir)?.into_iter().rev() {
            match Self::read(&path) {
                Ok(checkpoint) => return Ok(Found { path, checkpoint, passed_over }),
                Err(error) => {
                    tracing::warn!(%error, "a checkpoint is unusable, trying the previous one");
                    passed_over.push(error);
                }
            }
        }
        Err(if passed_over.is_empty() { CheckpointError::Absent(dir.into()) } else { passed_over.swap_remove(0) })
    }

    /// Returns the frozen policy, as sent to the actors.
    pub fn weights(&self) -> Weights {
        self.state.weights(self.model.hash(), self.settings.clone(), self.parameters.clone())
    }
}

/// Returns whether `dir` contains a checkpoint, valid or not.
pub fn exists(dir: &Path) -> bool {
    files::steps(dir).is_ok_and(|steps| !steps.is_empty())
}

/// Removes all but the `keep` newest checkpoints of up to `n_env_steps` environment steps in `dir`, and the leftovers
/// of interrupted writes. Checkpoints of later steps stay: a run that resumed before them passed over them as damaged,
/// so they must not take the place of valid ones.
///
/// # Errors
/// If the file system returns an error.
pub fn prune(dir: &Path, n_env_steps: u64, keep: usize) -> Result<(), CheckpointError> {
    clean(dir)?;
    let steps: Vec<PathBuf> = files::steps(dir)?.range(..=n_env_steps).map(|(_, path)| path.clone()).collect();
    let n_old = steps.len().saturating_sub(keep);
    steps.iter().take(n_old).try_for_each(|path| files::remove(path))
}

fn json(value: &impl Serialize) -> Result<Vec<u8>, CheckpointError> {
    serde_json::to_vec_pretty(value).map_err(|error| CheckpointError::Mismatch(error.to_string()))
}

fn parse<T: for<'de> Deserialize<'de>>(folder: &Path, name: &str, bytes: &[u8]) -> Result<T, CheckpointError> {
    serde_json::from_slice(bytes).map_err(|error| {
        // The files have one key in a line.
        let line = bytes.split(|byte| *byte == b'\n').nth(error.line().saturating_sub(1)).unwrap_or_default();
        let line = String::from_utf8_lossy(line);
        let line: String = line.trim().chars().filter(|c| !c.is_control()).take(80).collect();
        damaged(folder, name, format!("{error}: `{line}`"))
    })
}

fn pack<'t>(trajectories: impl IntoIterator<Item = &'t Trajectory>) -> Vec<u8> {
    let mut bytes = Vec::new();
    for trajectory in trajectories {
        let encoded = encode_recording(trajectory);
        bytes.extend((encoded.len() as u64).to_le_bytes());
        bytes.extend(encoded);
    }
    bytes
}

fn unpack(folder: &Path, name: &str, mut bytes: &[u8]) -> Result<Vec<Trajectory>, CheckpointError> {
    let mut trajectories = Vec::new();
    while let Some((length, rest)) = bytes.split_first_chunk::<8>() {
        let length = usize::try_from(u64::from_le_bytes(*length)).unwrap_or(usize::MAX);
        let Some((message, rest)) = rest.split_at_checked(length) else { break };
        trajectories.push(decode_recording(message).map_err(|error| damaged(folder, name, error.to_string()))?);
        bytes = rest;
    }
    if bytes.is_empty() { Ok(trajectories) } else { Err(damaged(folder, name, "its last trajectory is cut short")) }
}
