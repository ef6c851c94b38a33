//! Video clips that a running evaluator makes of its evaluations: of each group a success and a failure.
//!
//! Reading order: [`selector`] (which episodes of an evaluation are recorded) → `queue` → `recorder` (a thread that
//! draws them). Where the files lie is [`runlog::clips`]' matter.

mod queue;
mod recorder;
pub mod selector;
#[cfg(test)]
mod tests;

pub(crate) use recorder::VideoRecorder;
pub use selector::EpisodeSelector;
