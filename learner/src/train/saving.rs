//! Saving, and waiting for a disk that takes nothing.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use bus::unix_ms;
use proto::keys;
use proto::metrics::{LearnerMetrics, NotSaved};
use runlog::{Lines, tensorboard};

use super::output::Output;
use crate::checkpoint;
use crate::learner::Learner;

/// Interval at which a run that waits for its disk looks whether it was told to end.
const POLL_INTERVAL: Duration = Duration::from_millis(100);

/// Metrics without TensorBoard curves: constants, those with one curve per blueprint, and what is no measurement.
const UNPLOTTED: [&str; 4] = ["schema_version", "task_probabilities", "success_by_blueprint", "not_saved"];

impl Output {
    /// Saves the metrics of the newest update and, if one is due, a checkpoint; returns whether one was due. If
    /// training `has_diverged`, the last checkpoint is written elsewhere.
    ///
    /// Returns when that is done: training waits for as long as nothing can be saved, because whatever it learns could
    /// be lost.
    pub(super) fn save(&mut self, learner: &Learner, has_diverged: bool) -> anyhow::Result<bool> {
        let is_due =
            !has_diverged && learner.n_updates().is_multiple_of(learner.setup.config.checkpoints.every_updates);
        if let Some(metrics) = &self.saving.metrics {
            let mut line = Lines::default();
            line.push(keys::METRICS_LEARNER, metrics)?;
            let scalars = tensorboard::flatten("learner", &serde_json::to_value(metrics)?, &UNPLOTTED);
            self.saving.scalars = Some((metrics.n_env_steps, scalars));
            self.saving.line = Some(line);
        }
        self.saving.is_due = is_due;
        self.save_or_wait(learner);
        Ok(is_due)
    }

    /// Saves a checkpoint, and waits for it like [`Output::save`].
    ///
    /// # Errors
    /// If it cannot be saved when the run is told to end, or its session has failed.
    pub(super) fn save_last(&mut self, learner: &Learner) -> anyhow::Result<PathBuf> {
        self.saving.is_due = true;
        self.save_or_wait(learner);
        // Once told to end, the checkpoint alone counts.
        match self.saving.checkpoint.take() {
            Some(path) if !self.saving.is_due => Ok(path),
            _ => self.save_checkpoint(learner).map_err(|error| self.lost(learner, error)),
        }
    }

    /// Saves everything, again and again until it succeeds, or until the run is told to end or its session fails.
    fn save_or_wait(&mut self, learner: &Learner) {
        let pause = self.save_retry;
        let mut waiting = None;
        let mut last_reason: Option<String> = None;
        while let Err(error) = self.try_save(learner) {
            waiting.get_or_insert_with(|| self.bus.pulse().waiting());
            let reason = format!("{error:#}");
            if last_reason.as_ref() != Some(&reason) {
                tracing::error!(reason, "nothing can be saved: training waits, and tries again every {pause:?}");
                let since_unix_ms = self.saving.saved_unix_ms;
                self.tell(Some(NotSaved { since_unix_ms, reason: reason.clone() }));
                last_reason = Some(reason);
            }
            if !self.pause(pause) {
                return;
            }
        }
        if waiting.is_some() {
            tracing::info!("everything is saved again");
            self.tell(None);
        }
    }

    /// Saves what is not on disk yet. What cannot be saved does not keep the rest from it.
    fn try_save(&mut self, learner: &Learner) -> anyhow::Result<()> {
        let line = self.saving.line.as_ref().map_or(Ok(()), |line| self.records.append(line));
        if line.is_ok() {
            self.saving.line = None;
        }
        let scalars = self.saving.scalars.as_ref();
        let scalars = scalars.map_or(Ok(()), |(n, scalars)| self.records.scalars(*n, scalars.iter().cloned()));
        if scalars.is_ok() {
            self.saving.scalars = None;
        }
        let written = line.and(scalars);
        if !self.saving.is_due {
            // After an error, the next try saves a checkpoint too.
            self.saving.is_due = written.is_err();
            return Ok(written?);
        }
        let saved = self.save_checkpoint(learner).map(|path| self.saving.checkpoint = Some(path));
        written?;
        Ok(saved?)
    }

    fn save_checkpoint(&mut self, learner: &Learner) -> Result<PathBuf, checkpoint::CheckpointError> {
        let checkpoints = self.run_dir.checkpoints();
        let path = learner.checkpoint().write(&checkpoints)?;
        let keep = learner.setup.config.checkpoints.keep;
        if let Err(error) = checkpoint::prune(&checkpoints, learner.n_env_steps(), keep) {
            tracing::warn!(%error, "older checkpoints were not removed");
        }
        tracing::info!(path = %path.display(), "saved");
        self.saving.is_due = false;
        self.saving.saved_unix_ms = unix_ms();
        Ok(path)
    }

    /// Tells viewers and health checks whether the run waits for its disk.
    fn tell(&self, not_saved: Option<NotSaved>) {
        self.bus.pulse().set_not_saved(not_saved.clone());
        if let Some(metrics) = &self.saving.metrics {
            self.send(Some(LearnerMetrics { not_saved, ..metrics.clone() }));
        }
    }

    /// Waits; returns whether the run goes on.
    fn pause(&self, pause: Duration) -> bool {
        let start = Instant::now();
        while !self.is_stopped() {
            let Some(left) = pause.checked_sub(start.elapsed()) else { return true };
            // What ends the wait has no blocking form here, and nothing unparks this thread.
            std::thread::park_timeout(left.min(POLL_INTERVAL));
        }
        false
    }

    /// Returns the error for a run whose last checkpoint was not saved, which names the newest valid one.
    fn lost(&self, learner: &Learner, error: checkpoint::CheckpointError) -> anyhow::Error {
        let checkpoints = self.run_dir.checkpoints();
        let newest = match checkpoint::Checkpoint::read_latest(&checkpoints) {
            Ok(found) => format!("the newest whole one is {}", found.path.display()),
            Err(_) => format!("there is no whole one in {}", checkpoints.display()),
        };
        let n_env_steps = learner.n_env_steps();
        let version = learner.version().0;
        let lost = format!("the last checkpoint, of {n_env_steps} environment steps and weights {version}, is lost");
        anyhow::Error::new(error).context(format!("{lost}; {newest}"))
    }
}
