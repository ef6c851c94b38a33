//! Writes a dataset to a folder that is complete after every episode.
//!
//! ```text
//! <root>/<namespace>/<name>-v<version>/data/
//!     metadata.json     of the dataset; counts the episodes
//!     <number>/         of an episode
//!         part-0.arrow  its rows, as an Arrow IPC file
//!         metadata.json its steps, its end, and what to reset the environment with to see it again
//! ```

use std::collections::BTreeMap;
use std::fmt;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use arrow_array::RecordBatch;
use arrow_ipc::writer::FileWriter;
use arrow_schema::ArrowError;
use blueprints::Blueprint;
use policy::FeatureConfig;
use proto::{Status, Trajectory};
use serde::Serialize;
use serde_json::json;

use crate::episode::{EpisodeError, columns};
use crate::spaces::Spaces;

/// Version of Minari that defines the format.
const MINARI_VERSION: &str = "0.5.4";
/// Name of the metadata files.
const METADATA: &str = "metadata.json";

/// Name of a dataset: `NAMESPACE/NAME-vVERSION`. The namespace is optional and may have several parts; parts and names
/// consist of letters, digits, `-`, and `_`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DatasetId(String);

/// A string that is not a dataset name.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0:?} is no name of a dataset: expected, for example, lodestone/expert-v0")]
pub struct InvalidDatasetId(pub String);

/// The description of a dataset in its metadata.
#[derive(Clone, Debug)]
pub struct About {
    /// Name of the dataset.
    pub id: DatasetId,
    /// The algorithm that acted.
    pub algorithm: String,
    /// Description in one sentence.
    pub description: String,
    /// URL of the code that generated the dataset.
    pub code_permalink: Option<String>,
    /// Origin of the episodes.
    pub origin: Origin,
}

/// Origin of the episodes of a dataset.
#[derive(Clone, Debug, Serialize)]
pub struct Origin {
    /// Version of the program.
    pub lodestone_version: &'static str,
    /// Version of the weights that acted; 0 for the expert.
    pub weights_version: u64,
    /// Environment steps that these weights were trained on; 0 for the expert.
    pub n_env_steps: u64,
    /// `mode` or `sampled`.
    pub acting: &'static str,
    /// Seed of the recording.
    pub seed: u64,
}

/// The arguments of the environment, except those that have a default.
#[derive(Debug, Serialize)]
pub struct World<'a, S> {
    /// Blueprint ids, or TOML texts of blueprints that the Python package does not have.
    pub blueprint: Vec<String>,
    /// Kinds of starts, with weights.
    pub starts: BTreeMap<&'static str, f64>,
    /// The configuration section `[environment]`.
    pub settings: &'a S,
    /// The configuration section `[policy.features]`.
    pub features: &'a FeatureConfig,
}

/// Reasons why a dataset cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum DatasetError {
    /// The folder already exists.
    #[error("{} exists already; choose another --out or --name, or delete it", .0.display())]
    Exists(PathBuf),
    /// A file or folder cannot be written.
    #[error("cannot write {}: {error}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// The cause.
        #[source]
        error: io::Error,
    },
    /// An episode cannot be written.
    #[error(transparent)]
    Episode(#[from] EpisodeError),
}

/// Writes the episodes of a dataset. Stopping early leaves a valid dataset of the episodes so far.
#[derive(Debug)]
pub struct Writer {
    data: PathBuf,
    spaces: Spaces,
    head: Head,
}

/// The metadata of a dataset.
#[derive(Debug, Serialize)]
struct Head {
    dataset_id: String,
    total_episodes: u64,
    total_steps: u64,
    /// Size in MB.
    dataset_size: f64,
    #[serde(skip)]
    n_bytes: u64,
    data_format: &'static str,
    jpeg_encoding: bool,
    minari_version: &'static str,
    algorithm_name: String,
    description: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    code_permalink: Option<String>,
    lodestone: Origin,
    env_spec: String,
    observation_space: String,
    action_space: String,
}

/// The specification from which Gymnasium creates an environment.
#[derive(Debug, Serialize)]
struct EnvSpec<'a, S> {
    id: &'static str,
    entry_point: &'static str,
    reward_threshold: Option<f64>,
    nondeterministic: bool,
    max_episode_steps: Option<u64>,
    order_enforce: bool,
    disable_env_checker: bool,
    kwargs: &'a World<'a, S>,
    additional_wrappers: [(); 0],
    vector_entry_point: &'static str,
}

impl FromStr for DatasetId {
    type Err = InvalidDatasetId;

    fn from_str(text: &str) -> Result<Self, InvalidDatasetId> {
        let is_word =
            |word: &str| !word.is_empty() && word.chars().all(|c| c.is_ascii_alphanumeric() || "-_".contains(c));
        let (namespace, name) = text.rsplit_once('/').map_or((None, text), |(space, name)| (Some(space), name));
        let versioned = name.rsplit_once("-v").is_some_and(|(name, version)| {
            is_word(name) && version.parse::<u32>().is_ok() && version.bytes().all(|c| c.is_ascii_digit())
        });
        // Minari rejects namespaces of one letter.
        let spaced = namespace.is_none_or(|space| space.len() > 1 && space.split('/').all(is_word));
        if versioned && spaced { Ok(Self(text.to_owned())) } else { Err(InvalidDatasetId(text.to_owned())) }
    }
}

impl fmt::Display for DatasetId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl Writer {
    /// Creates a dataset without episodes below `root`, the folder that `MINARI_DATASETS_PATH` names.
    ///
    /// # Errors
    /// If the dataset's folder already exists or cannot be created.
    pub fn create<S: Serialize>(
        root: &Path,
        about: About,
        spaces: Spaces,
        world: &World<'_, S>,
    ) -> Result<Self, DatasetError> {
        let About { id, algorithm, description, code_permalink, origin } = about;
        let folder = root.join(&id.0);
        let parent = folder.parent().unwrap_or(root);
        fs::create_dir_all(parent).map_err(|error| DatasetError::Io { path: parent.to_owned(), error })?;
        fs::create_dir(&folder).map_err(|error| match error.kind() {
            io::ErrorKind::AlreadyExists => DatasetError::Exists(folder.clone()),
            _ => DatasetError::Io { path: folder.clone(), error },
        })?;
        let data = folder.join("data");
        fs::create_dir(&data).map_err(|error| DatasetError::Io { path: data.clone(), error })?;
        let env_spec = EnvSpec {
            id: "Lodestone/Assembly-v0",
            entry_point: "lodestone.env:AssemblyEnv",
            reward_threshold: None,
            nondeterministic: false,
            max_episode_steps: None,
            order_enforce: true,
            disable_env_checker: false,
            kwargs: world,
            additional_wrappers: [],
            vector_entry_point: "lodestone.vector:AssemblyVectorEnv",
        };
        let head = Head {
            dataset_id: id.0,
            total_episodes: 0,
            total_steps: 0,
            dataset_size: 0.0,
            n_bytes: 0,
            data_format: "arrow",
            jpeg_encoding: false,
            minari_version: MINARI_VERSION,
            algorithm_name: algorithm,
            description,
            code_permalink,
            lodestone: origin,
            env_spec: text(&env_spec),
            observation_space: spaces.observations().to_string(),
            action_space: spaces.actions().to_string(),
        };
        let writer = Self { data, spaces, head };
        writer.write_head()?;
        Ok(writer)
    }

    /// Appends an episode; `seed` is the seed from which the environment draws it.
    ///
    /// # Errors
    /// If the trajectory is not a complete, valid episode, `goal` is not its blueprint, or a file cannot be written.
    pub fn write(&mut self, trajectory: &Trajectory, goal: &Blueprint, seed: u64) -> Result<(), DatasetError> {
        let rows = encoded(&columns(&self.spaces, trajectory, goal)?).map_err(EpisodeError::from)?;
        let n_steps = trajectory.transitions.len();
        let task = &trajectory.task;
        let metadata = text(&json!({
            "id": self.head.total_episodes,
            "total_steps": n_steps,
            "seed": seed,
            "options": { "blueprint": task.blueprint, "start": task.start.to_string() },
            "is_success": trajectory.status == Status::Success,
        }));
        let name = self.head.total_episodes.to_string();
        let (folder, part) = (self.data.join(&name), self.data.join(format!(".{name}.part")));
        let failed = |path: &Path| {
            let path = path.to_owned();
            move |error| DatasetError::Io { path, error }
        };
        fs::create_dir(&part).map_err(failed(&part))?;
        for (name, bytes) in [("part-0.arrow", &rows[..]), (METADATA, metadata.as_bytes())] {
            let path = part.join(name);
            fs::write(&path, bytes).map_err(failed(&path))?;
        }
        fs::rename(&part, &folder).map_err(failed(&folder))?;
        self.head.total_episodes += 1;
        self.head.total_steps += n_steps as u64;
        self.head.n_bytes += (rows.len() + metadata.len()) as u64;
        self.head.dataset_size = (self.head.n_bytes as f64 / 1e5).round() / 10.0;
        self.write_head()
    }

    /// Returns the name of the dataset.
    pub fn id(&self) -> &str {
        &self.head.dataset_id
    }

    /// Returns the number of episodes so far.
    pub fn n_episodes(&self) -> u64 {
        self.head.total_episodes
    }

    /// Returns the number of steps so far.
    pub fn n_steps(&self) -> u64 {
        self.head.total_steps
    }

    /// Returns the number of bytes of the episodes so far.
    pub fn n_bytes(&self) -> u64 {
        self.head.n_bytes
    }

    fn write_head(&self) -> Result<(), DatasetError> {
        let (path, part) = (self.data.join(METADATA), self.data.join(format!(".{METADATA}.part")));
        fs::write(&part, text(&self.head))
            .and_then(|()| fs::rename(&part, &path))
            .map_err(|error| DatasetError::Io { path, error })
    }
}

/// Encodes rows as an Arrow IPC file.
fn encoded(rows: &RecordBatch) -> Result<Vec<u8>, ArrowError> {
    let mut writer = FileWriter::try_new(Vec::new(), &rows.schema())?;
    writer.write(rows)?;
    writer.into_inner()
}

fn text(value: &impl Serialize) -> String {
    serde_json::to_string(value).expect("keys are texts")
}

#[cfg(test)]
mod tests;
