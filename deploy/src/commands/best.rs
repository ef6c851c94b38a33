//! What an evaluator keeps of a run's weights: the best policy, `checkpoints/best/`, chosen by its verdict, and
//! snapshots, `snapshots/`, which show how the run learned.

use std::collections::BTreeSet;
use std::fs;
use std::sync::Arc;

use anyhow::Context;
use evaluator::{PolicyConfig, Scored, Verdict};
use learner::{Model, read_model};
use proto::{Valid, Weights};
use runlog::RunPaths;
use tokio::runtime::Handle;
use tokio::sync::{mpsc, watch};

use super::files::write_file;

/// Until an evaluator ends, keeps the best of the weights that it judges, and snapshots of those and of the `newest` ones,
/// spread over a run of `n_env_steps` environment steps.
///
/// A file that cannot be written does not end a run: a warning says so, and the next verdict tries again.
pub(super) async fn keep(
    mut evaluated: mpsc::UnboundedReceiver<Scored>,
    mut newest: watch::Receiver<Option<Arc<Weights>>>,
    n_env_steps: u64,
    policy: Valid<PolicyConfig>,
    paths: RunPaths,
) {
    let runtime = Handle::current();
    // Off the async runtime, because it waits for the disk.
    let keeping = tokio::task::spawn_blocking(move || {
        let mut keeper = Keeper::new(policy, &paths, n_env_steps);
        while let Some(next) = runtime.block_on(next(&mut evaluated, &mut newest, keeper.due)) {
            match next {
                Next::Scored(scored) => keeper.offer(scored),
                Next::Due(weights) => {
                    keeper.due = weights.n_env_steps + keeper.every;
                    keeper.snap(&weights);
                }
            }
        }
    });
    if let Err(panic) = keeping.await {
        tracing::warn!(%panic, "the best policy is not kept any more");
    }
}

/// The verdict on a policy that was chosen for it.
pub(super) fn verdict_of(model: &Model) -> Option<Verdict> {
    serde_json::from_value(model.verdict.clone()?).ok()
}

/// Largest number of snapshots of a run, and the most that more than two of them take together in bytes.
const MAX_SNAPSHOTS: usize = 12;
const MAX_SNAPSHOT_BYTES: usize = 64 << 20;

/// What comes next to a keeper.
enum Next {
    Scored(Scored),
    /// Weights of which a snapshot is due.
    Due(Arc<Weights>),
}

/// Waits for a verdict, or for weights after `due` environment steps; `None` once no verdict can come.
async fn next(
    evaluated: &mut mpsc::UnboundedReceiver<Scored>,
    newest: &mut watch::Receiver<Option<Arc<Weights>>>,
    due: u64,
) -> Option<Next> {
    tokio::select! {
        scored = evaluated.recv() => scored.map(Next::Scored),
        Ok(weights) = newest.wait_for(|newest| newest.as_ref().is_some_and(|newest| newest.n_env_steps >= due)) => {
            weights.clone().map(Next::Due)
        }
    }
}

struct Keeper {
    policy: Valid<PolicyConfig>,
    paths: RunPaths,
    /// The verdict on the policy in the file.
    kept: Option<Verdict>,
    /// A better policy that could not be written yet.
    waiting: Option<Scored>,
    /// Environment steps after which the next snapshot is due without a verdict, and between two of those.
    due: u64,
    every: u64,
    /// Environment steps of the weights that were evaluated.
    evaluated: BTreeSet<u64>,
}

impl Keeper {
    fn new(policy: Valid<PolicyConfig>, paths: &RunPaths, n_env_steps: u64) -> Self {
        let path = paths.best();
        // What a killed process left of a file that it was writing.
        let folders = [path.with_file_name(""), paths.snapshot_folder()];
        let entries = folders.iter().filter_map(|folder| fs::read_dir(folder).ok()).flatten().flatten();
        for left in entries.filter(|entry| entry.path().extension().is_some_and(|kind| kind == "part")) {
            drop(fs::remove_file(left.path()));
        }
        // A file that cannot be read is replaced by the next policy.
        let kept = path.exists().then(|| read_model(&path)).and_then(|read| match read {
            Ok(model) => verdict_of(&model),
            Err(error) => {
                tracing::warn!(%error, "the best policy so far cannot be read");
                None
            }
        });
        let every = (n_env_steps / (MAX_SNAPSHOTS as u64 - 1)).max(1);
        let due = paths.snapshots().last_key_value().map_or(0, |(last, _)| last + every);
        Self { policy, paths: paths.clone(), kept, waiting: None, due, every, evaluated: BTreeSet::new() }
    }

    fn offer(&mut self, new: Scored) {
        self.evaluated.insert(new.weights.n_env_steps);
        self.snap(&new.weights);
        // Neither untrained weights nor those that build nothing are better than what comes after them.
        if new.weights.n_env_steps == 0 || new.verdict.success.n_successes == 0 {
            return;
        }
        let best = self.waiting.as_ref().map(|waiting| &waiting.verdict).or(self.kept.as_ref());
        if best.is_none_or(|best| new.verdict.beats(best)) {
            self.waiting = Some(new);
        }
        let Some(best) = &self.waiting else { return };
        match self.write(best) {
            Ok(()) => self.kept = self.waiting.take().map(|written| written.verdict),
            Err(error) => tracing::warn!(error = format!("{error:#}"), "the best policy so far cannot be kept yet"),
        }
    }

    fn snap(&self, weights: &Weights) {
        if let Err(error) = self.write_snapshot(weights) {
            let n_env_steps = weights.n_env_steps;
            tracing::warn!(error = format!("{error:#}"), n_env_steps, "a snapshot cannot be kept");
        }
    }

    /// Keeps a snapshot. Of too many, removes those that leave the smallest gaps, but neither the first nor the last, and
    /// those that were evaluated only after all others.
    fn write_snapshot(&self, weights: &Weights) -> anyhow::Result<()> {
        let bytes = Model::new(&self.policy, weights).to_bytes()?;
        let most = (MAX_SNAPSHOT_BYTES / bytes.len()).clamp(2, MAX_SNAPSHOTS);
        write_file(&self.paths.snapshot(weights.n_env_steps), &bytes)?;
        let mut kept: Vec<_> = self.paths.snapshots().into_iter().collect();
        while kept.len() > most {
            let rank = |i: &usize| (self.evaluated.contains(&kept[*i].0), kept[i + 1].0 - kept[i - 1].0);
            let least = (1..kept.len() - 1).min_by_key(rank);
            let (_, path) = kept.remove(least.context("there is one between")?);
            fs::remove_file(&path).with_context(|| format!("removing {}", path.display()))?;
        }
        Ok(())
    }

    fn write(&self, Scored { weights, verdict }: &Scored) -> anyhow::Result<()> {
        let mut model = Model::new(&self.policy, weights);
        model.verdict = Some(serde_json::to_value(verdict)?);
        let path = self.paths.best();
        write_file(&path, &model.to_bytes()?)?;
        tracing::info!(path = %path.display(), n_env_steps = weights.n_env_steps, "the best so far: {verdict}");
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use proto::wilson::SuccessRate;
    use proto::{ActionMode, WeightsVersion};

    use super::*;

    fn shipped() -> Model {
        read_model(Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/pretrained/model.safetensors"))).unwrap()
    }

    /// Weights after this many steps, and a verdict of this many successes in ten episodes.
    fn evaluated(n_env_steps: u64, n_successes: u64) -> Scored {
        let shipped = shipped().weights;
        let weights = Weights { n_env_steps, version: WeightsVersion(n_env_steps), ..shipped };
        let success = SuccessRate::new(n_successes, 10);
        let verdict = Verdict { goals: "train".to_owned(), n_goals: 2, acting: ActionMode::Sampled, success };
        Scored { weights: Arc::new(weights), verdict }
    }

    #[test]
    fn the_best_of_a_run_is_kept_also_by_a_process_that_continues_it() {
        let folder = tempfile::tempdir().unwrap();
        let paths = RunPaths::new(folder.path());
        let policy = shipped().policy;
        let start = || Keeper::new(policy.clone(), &paths, 1000);
        let kept = || read_model(&paths.best()).map(|model| model.weights.n_env_steps).ok();
        let mut keeper = start();
        for (n_env_steps, n_successes, expected) in
            [(0, 9, None), (100, 0, None), (200, 5, Some(200)), (300, 7, Some(300)), (400, 6, Some(300))]
        {
            keeper.offer(evaluated(n_env_steps, n_successes));
            assert_eq!(kept(), expected, "after {n_env_steps}");
        }
        // Killed while it wrote another one.
        fs::write(folder.path().join("checkpoints/best/.X.part"), "half").unwrap();
        let mut keeper = start();
        keeper.offer(evaluated(500, 6));
        assert_eq!(kept(), Some(300));
        keeper.offer(evaluated(600, 7));
        assert_eq!(kept(), Some(600), "of equal ones the later");
        assert_eq!(verdict_of(&read_model(&paths.best()).unwrap()).unwrap(), evaluated(600, 7).verdict);
        assert_eq!(fs::read_dir(folder.path().join("checkpoints/best")).unwrap().count(), 1);
        // A damaged file keeps nothing better away.
        fs::write(paths.best(), "damaged").unwrap();
        start().offer(evaluated(700, 1));
        assert_eq!(kept(), Some(700));
    }

    #[test]
    fn snapshots_are_spread_over_the_run_and_few() {
        let folder = tempfile::tempdir().unwrap();
        let paths = RunPaths::new(folder.path());
        fs::create_dir_all(paths.snapshot_folder()).unwrap();
        for other in [".X.part", "mine.safetensors"] {
            fs::write(paths.snapshot_folder().join(other), "half").unwrap();
        }
        let mut keeper = Keeper::new(shipped().policy, &paths, 4000);
        (0..=40).for_each(|n| keeper.offer(evaluated(100 * n, 0)));
        let kept: Vec<u64> = paths.snapshots().into_keys().collect();
        assert_eq!((kept.len(), kept[0], kept[MAX_SNAPSHOTS - 1]), (MAX_SNAPSHOTS, 0, 4000));
        assert!(kept.array_windows().all(|[a, b]| b - a <= 800), "{kept:?}");
        assert_eq!(read_model(&paths.snapshot(kept[1])).unwrap().weights.n_env_steps, kept[1]);
        assert_eq!(fs::read_dir(paths.snapshot_folder()).unwrap().count(), MAX_SNAPSHOTS + 1, "the user's file stays");
    }

    #[tokio::test]
    async fn snapshots_need_no_verdict_and_those_with_one_stay() {
        let folder = tempfile::tempdir().unwrap();
        let paths = RunPaths::new(folder.path());
        let (verdicts, evaluated_weights) = mpsc::unbounded_channel();
        let (weights, newest) = watch::channel(None);
        let keeping = tokio::spawn(keep(evaluated_weights, newest, 1100, shipped().policy, paths.clone()));
        for n_env_steps in (3..=1100).step_by(50) {
            weights.send_replace(Some(evaluated(n_env_steps, 0).weights));
            // Half of them come before the next one is due.
            let is_due = (n_env_steps - 3) % 100 == 0;
            while is_due && !paths.snapshot(n_env_steps).exists() {
                tokio::task::yield_now().await;
            }
            if n_env_steps == 553 {
                verdicts.send(evaluated(553, 0)).unwrap();
            }
        }
        drop(verdicts);
        keeping.await.unwrap();
        let kept: Vec<u64> = paths.snapshots().into_keys().collect();
        let due = (3..=1100).step_by(100);
        assert_eq!(kept, due.chain([553]).collect::<BTreeSet<u64>>().into_iter().collect::<Vec<_>>());
    }

    #[test]
    fn a_best_policy_that_cannot_be_written_waits() {
        let folder = tempfile::tempdir().unwrap();
        let paths = RunPaths::new(folder.path());
        let policy = shipped().policy;
        // A file in the place of the folder makes writing fail, as a full disk would.
        fs::write(paths.checkpoints(), "").unwrap();
        let mut keeper = Keeper::new(policy, &paths, 1000);
        keeper.offer(evaluated(100, 5));
        fs::remove_file(paths.checkpoints()).unwrap();
        keeper.offer(evaluated(200, 4));
        assert_eq!(read_model(&paths.best()).unwrap().weights.n_env_steps, 100);
    }
}
