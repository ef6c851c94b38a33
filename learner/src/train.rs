//! PPO on one page.
//!
//! ```text
//!  source ── trajectories ──▶ batch ──▶ ppo.update ──▶ publish ──▶ save
//!     ▲                                                  │
//!     └─────────────── the newest weights ───────────────┘
//! ```
//!
//! [`Source`] finds trajectories, [`Batch`] turns them into inputs of the network, `ppo` takes gradient steps on the
//! [`loss`](crate::loss) with advantages by [`gae`](crate::gae), and `Output` hands the weights to the bus and to the run
//! folder.

mod output;
mod saving;

use std::path::PathBuf;

use policy::normalization::normalize;
use proto::Trajectory;

pub(crate) use self::output::{Output, Publication, Saving};
pub use self::output::{SAVE_RETRY, Summary};
use crate::batch::Batch;
use crate::episodes::episode_metrics;
use crate::learner::Learner;
use crate::metrics::UpdateResult;
use crate::source::Source;

/// Number of updates in a row that may be taken back. A single one can come from an odd batch, which the next update
/// does not have. After three, the settings are at fault, and waiting would only cost time.
const MAX_REFUSED: u64 = 3;

/// Why training stopped: update after update gave weights with which no policy can act.
#[derive(Debug, thiserror::Error)]
#[error(
    "training has diverged: {MAX_REFUSED} updates in a row gave no usable weights ({reason}); the last usable ones are \
     in {}", checkpoint.display()
)]
pub struct Diverged {
    reason: String,
    checkpoint: PathBuf,
}

/// A learner, where its trajectories come from, and where its weights go.
pub(crate) struct Trainer {
    pub(crate) learner: Learner,
    pub(crate) source: Source,
    pub(crate) output: Output,
}

impl Trainer {
    /// Trains until the run is told to end or has all of its steps, and saves a checkpoint in any case.
    pub(crate) fn run(mut self) -> anyhow::Result<Summary> {
        let ended = self.train();
        // Trajectories acknowledged after the checkpoint would be lost.
        self.learner.mailbox().close();
        let checkpoint = self.output.save_last(&self.learner)?;
        match ended? {
            Some(reason) => Err(Diverged { reason, checkpoint }.into()),
            None => Ok(self.output.summary(&self.learner, checkpoint)),
        }
    }

    /// The loop. Returns why training diverged, if it did.
    fn train(&mut self) -> anyhow::Result<Option<String>> {
        let Self { learner, source, output } = self;
        let mut n_refused = 0;
        let mut restart = true;
        // The weights that the run begins with.
        output.send(None);
        while let Some(n_steps) = output.next_steps(learner) {
            let trajectories = source.next(&learner.mailbox, &output.newest, n_steps, &mut restart)?;
            output.start_update();
            let Some(update) = learner.update(trajectories) else { continue };
            output.publish(learner, &update.metrics);
            n_refused = if update.refused.is_some() { n_refused + 1 } else { 0 };
            let has_diverged = n_refused == MAX_REFUSED;
            restart |= output.save(learner, has_diverged)?;
            if has_diverged {
                return Ok(update.refused);
            }
        }
        Ok(None)
    }
}

impl Learner {
    /// Runs one update; `None` without trajectories.
    ///
    /// If no policy could act with the new weights, the update is taken back: its steps count, the weights stay.
    pub fn update(&mut self, trajectories: Vec<Trajectory>) -> Option<UpdateResult> {
        if trajectories.is_empty() {
            return None;
        }
        let episodes = episode_metrics(&trajectories);
        let n_steps = trajectories.iter().map(|trajectory| trajectory.transitions.len() as u64).sum();
        self.record(&trajectories);
        let before = (self.ppo.trained(), self.state.clone());

        let mut batch = Batch::new(trajectories, self.state.version, &self.setup.catalog, &self.setup.policy);
        // The statistics come from raw features and take effect with the next weights.
        let statistics = self.statistics_after(&batch);
        normalize(&mut batch.features, &self.state.normalization);
        let learned = self.ppo.update(&mut batch, &self.setup.config, &mut self.state);
        self.adopt(statistics);
        self.state.version.0 += 1;

        let refused = self.refusal(&learned.ppo, &batch);
        if refused.is_some() {
            self.take_back(before);
        }
        self.count(n_steps, episodes.success.n_episodes, &batch);
        Some(self.result(&batch, n_steps, learned, episodes, refused))
    }

    /// Runs one [update](Self::update) on the oldest trajectories of the mailbox; `None` if there are not enough.
    pub fn update_from_mailbox(&mut self) -> Option<UpdateResult> {
        self.update(self.mailbox.take(self.setup.config.batch_size))
    }
}
