//! Handmade runs and sweeps.

use std::path::Path;

use blueprints::Split;
use runlog::{History, RunPaths};
use serde_json::json;

#[path = "../../../runlog/src/history/tests/samples.rs"]
mod samples;

/// Writes one evaluation of two-block blueprints after each number of steps; all ten greedy episodes of each succeed.
pub(crate) fn write_run(run: &Path, ids: &[&str], steps: &[u64]) {
    let mut history = History::open(&RunPaths::new(run).history()).unwrap();
    let scores: Vec<_> = ids.iter().map(|&id| (id, Split::Train, 2, 10)).collect();
    steps.iter().for_each(|&n_env_steps| history.append(&samples::evaluation(n_env_steps, &scores)).unwrap());
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
