//! Queries for the history of evaluations.

use serde::Serialize;
use zenoh::bytes::{Encoding, ZBytes};

use super::latest::Latest;
use super::{Bus, BusError};
use proto::keys;

/// Answers queries for [`keys::HISTORY_EVAL`] with JSON.
#[derive(Debug)]
pub struct HistoryAnswer(Latest);

impl Bus {
    /// Answers queries for the history from now on. Sends no reply before the first [`HistoryAnswer::set`].
    ///
    /// # Errors
    /// If the session is closed.
    pub async fn history_answer(&self) -> Result<HistoryAnswer, BusError> {
        Ok(HistoryAnswer(Latest::declare(self, keys::HISTORY_EVAL.to_owned(), Encoding::APPLICATION_JSON).await?))
    }
}

impl HistoryAnswer {
    /// Sets the answer.
    ///
    /// # Errors
    /// If the history cannot be serialized as JSON.
    pub fn set(&self, history: &impl Serialize) -> Result<(), BusError> {
        let json = serde_json::to_vec(history);
        let json = json.map_err(|source| BusError::Json { key: keys::HISTORY_EVAL.to_owned(), source })?;
        self.0.set(ZBytes::from(json));
        Ok(())
    }
}
