//! Policies from files and from checkpoints. [`policy::model`] has the format of the file.

use std::path::Path;

use blueprints::outside;
use policy::Model;
use policy::model::MAX_FILE_BYTES;
use proto::Weights;

use crate::checkpoint::{Checkpoint, CheckpointError, at, io};

/// Reads a policy from a file; one that no policy of a permitted size fills is refused.
///
/// # Errors
/// [`CheckpointError::Io`], or [`CheckpointError::File`] with those of [`Model::from_bytes`].
pub fn read_model(path: &Path) -> Result<Model, CheckpointError> {
    let bytes = outside::read(path, MAX_FILE_BYTES).map_err(io("reading", path))?;
    Model::from_bytes(&bytes).map_err(at(path))
}

impl From<&Checkpoint> for Model {
    fn from(checkpoint: &Checkpoint) -> Self {
        let weights = Weights { task_probabilities: Default::default(), ..checkpoint.weights() };
        Self { policy: checkpoint.model.clone(), weights, verdict: None, table: checkpoint.table.clone() }
    }
}
