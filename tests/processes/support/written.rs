//! Handmade runs and sweeps.

use std::path::Path;

use blueprints::{BlueprintId, Split};
use proto::WeightsVersion;
use proto::metrics::{EvalBlueprint, EvalOutcome, METRICS_SCHEMA_VERSION};
use proto::wilson::SuccessRate;
use runlog::{Evaluation, History, RunPaths};
use serde_json::json;

/// Writes one evaluation of two-block blueprints after each number of steps; all greedy episodes succeed.
pub(crate) fn write_run(run: &Path, ids: &[&str], steps: &[u64]) {
    let mut history = History::open(&RunPaths::new(run).history()).unwrap();
    for &n_env_steps in steps {
        let weights_version = WeightsVersion(n_env_steps);
        let score = |id: &&str| EvalBlueprint {
            schema_version: METRICS_SCHEMA_VERSION,
            weights_version,
            n_env_steps,
            blueprint: BlueprintId::try_from((*id).to_owned()).unwrap(),
            split: Split::Train,
            n_blocks: 2,
            sampled: EvalOutcome::default(),
            greedy: EvalOutcome { success: SuccessRate::new(4, 4), ..EvalOutcome::default() },
        };
        let blueprints = ids.iter().map(score).collect();
        let (ended_unix_ms, elapsed_s, seed) = (1_767_225_600_000, 2.5, 1);
        let evaluation =
            Evaluation { ended_unix_ms, elapsed_s, weights_version, n_env_steps, seed, blueprints, reset_free: None };
        history.append(&evaluation).unwrap();
    }
}

/// Writes a sweep with these values of `learner.gamma`, whose runs are all done and were evaluated twice.
pub(crate) fn write_sweep(folder: &Path, gammas: &[&str], n_seeds: u64) {
    let ids = ["2_000", "2_001"];
    let score = |id| json!({ "group": "train 2-6", "goal": id, "acting": "greedy", "rate": 1.0 });
    let done = json!({ "state": "done", "n_env_steps": 1000, "scores": ids.map(score) }).to_string();
    let seeds: Vec<u64> = (1..=n_seeds).collect();
    for (i, seed) in (1..=gammas.len()).flat_map(|i| seeds.iter().map(move |seed| (i, seed))) {
        let run = folder.join(format!("point-{i}/seed-{seed}"));
        std::fs::create_dir_all(&run).unwrap();
        std::fs::write(RunPaths::new(&run).config(), "").unwrap();
        std::fs::write(run.with_extension("json"), &done).unwrap();
        write_run(&run, &ids, &[500, 1000]);
    }
    let point = |gamma: &&str| json!({ "settings": [["learner.gamma", gamma]], "config": "" });
    let points: Vec<_> = gammas.iter().map(point).collect();
    let plan = json!({ "lodestone_version": "", "command": [], "seeds": seeds, "points": points });
    std::fs::write(folder.join("sweep.json"), plan.to_string()).unwrap();
}
