//! The best policy of a run, beside its newest checkpoint.

use std::process::{Output, Stdio};

use learner::{Checkpoint, Model, read_model};
use runlog::{Evaluation, History, RunPaths};
use serde_json::json;

use crate::support::program::{finished, lines, lodestone, n_saved_steps, printed_json};
use crate::support::served::{Process, train};

/// Success of an evaluation with the action mode that counts.
fn n_successes(evaluation: &Evaluation) -> u64 {
    let acting = [proto::ActionMode::Sampled, proto::ActionMode::Greedy];
    let of = |acting| evaluation.blueprints.iter().filter_map(move |score| score.outcome(acting));
    let chosen = acting.into_iter().find(|&acting| of(acting).next().is_some()).unwrap();
    of(chosen).map(|outcome| outcome.success.n_successes).sum()
}

#[test]
fn the_best_policy_of_a_run_is_kept_evaluated_played_and_exported_and_the_newest_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let mut command = lodestone(folder.path());
    train(&mut command).args(["--no-web", "--steps", "4096", "--set", "evaluator.every={versions=1}"]);
    finished(command.args(["--set", "evaluator.evaluate_last=true"]));
    let run = RunPaths::new(folder.path().join("run"));
    let evaluations = History::read(&run.history()).unwrap();
    let evaluated = evaluations.iter().filter(|evaluation| evaluation.n_env_steps > 0 && n_successes(evaluation) > 0);
    // Of equal ones, this is the last.
    let best = evaluated.max_by_key(|evaluation| n_successes(evaluation)).map(|evaluation| evaluation.n_env_steps);
    assert_eq!(read_model(&run.best()).ok().map(|model| model.weights.n_env_steps), best);

    // From here on, a best policy that is certain to exist.
    let newest = n_saved_steps(run.folder());
    let mut best = Model::from(&Checkpoint::read_latest(&run.checkpoints()).unwrap().checkpoint);
    best.weights.n_env_steps = 77;
    let success = proto::wilson::SuccessRate::new(3, 4);
    best.verdict = Some(json!({ "goals": "train", "n_goals": 2, "acting": "sampled", "success": success }));
    std::fs::create_dir_all(run.best().parent().unwrap()).unwrap();
    std::fs::write(run.best(), best.to_bytes().unwrap()).unwrap();

    let export = |checkpoint: &str| -> (Option<u64>, String) {
        let out = folder.path().join("out");
        let Output { stderr, .. } =
            lodestone(folder.path()).args(["export", "--out", "out", "--checkpoint", checkpoint]).output().unwrap();
        let model = read_model(&out).ok();
        assert!(model.iter().all(|model| model.verdict.is_none()));
        drop(std::fs::remove_file(&out));
        (model.map(|model| model.weights.n_env_steps), String::from_utf8(stderr).unwrap())
    };
    let said = "run/checkpoints/best/policy.safetensors: the run's best policy, after 77 environment steps, which succeeds in \
                75.0 % of 4 sampled episodes of 2 goals (train)";
    let (n_env_steps, stderr) = export("run");
    assert_eq!(n_env_steps, Some(77), "{stderr}");
    assert!(stderr.contains(&format!("{said}; for the newest: run/checkpoints")), "{stderr}");
    assert_eq!(export("run/checkpoints/best").0, Some(77));
    assert_eq!(export("run/checkpoints").0, Some(newest));
    assert_eq!(export(&format!("run/checkpoints/step-{newest}")).0, Some(newest));

    let eval = ["eval", "--checkpoint", "run", "--episodes", "1", "--blueprint", "2_000", "--json"];
    let evaluated = finished(lodestone(folder.path()).args(eval));
    let report: serde_json::Value = serde_json::from_slice(&evaluated.stdout).unwrap();
    assert_eq!(report["summary"]["n_env_steps"], 77);
    assert!(String::from_utf8_lossy(&evaluated.stderr).contains(said));

    let mut playing = lodestone(folder.path());
    let playing = playing.args(["play", "--checkpoint", "run", "2_000"]);
    let mut playing = Process(playing.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap());
    let mut lines = lines(playing.0.stderr.take().unwrap());
    assert!(lines.any(|line| line.contains(said)));

    let again = ["train", "--resume", "run", "--steps", &newest.to_string(), "--json", "--no-web"];
    assert_eq!(printed_json(lodestone(folder.path()).args(again))["n_env_steps"], newest);

    // Nothing but a damaged file keeps the newest from taking its place.
    std::fs::write(run.best(), "damaged").unwrap();
    let (n_env_steps, stderr) = export("run");
    assert_eq!(n_env_steps, Some(newest));
    assert!(stderr.contains("the best policy is unusable, trying the newest checkpoint"), "{stderr}");
}
