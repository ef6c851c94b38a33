//! Videos made by a running evaluator: for each group, a success and a failure.
//!
//! Reading order: `selector` (chooses the episodes to record) → `queue` → `recorder` (the rendering thread).
//! [`runlog::videos`] defines where the files are stored.

mod queue;
mod recorder;
mod selector;
#[cfg(test)]
mod tests;

pub(crate) use recorder::VideoRecorder;
pub(crate) use selector::EpisodeSelector;
