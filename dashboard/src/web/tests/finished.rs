//! Runs that have ended, two of them on one page.

use super::*;

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn runs_that_have_ended_stand_side_by_side() {
    let dir = tempfile::tempdir().unwrap();
    // The second run has a goal of its own, and a video of it.
    let text = Catalog::builtin().get(&"2_000".parse().unwrap()).unwrap().to_toml("a test").replace("2_000", "mine");
    let own = Arc::new(Catalog::builtin().with(&Catalog::from_files([("mine.toml", text.as_str())]).unwrap()));
    let mut recorded = recording();
    recorded.task.blueprint = "mine".parse().unwrap();
    for (folder, file, bytes) in [
        ("videos/mine", "00000007-success.mp4", b"the video".to_vec()),
        ("replays/mine", "00000007-success.trajectory", encode_recording(&recorded)),
    ] {
        std::fs::create_dir_all(dir.path().join(folder)).unwrap();
        std::fs::write(dir.path().join(folder).join(file), bytes).unwrap();
    }
    let finished = |name: &str, n_env_steps, catalog| {
        let about = about(Kind::Finished, name, n_env_steps, catalog);
        let (policy, weights) = (untrained::small_policy(), untrained_weights());
        let run = Some(RunPaths::new(dir.path()));
        let evaluations = vec![evaluation(n_env_steps, &[])];
        ShownRun { about, evaluations, learner: Vec::new(), run, policy, weights, stage: None }
    };
    let page = Page::bind(&Valid::default()).await.unwrap();
    let address = page.address();
    let shutdown = CancellationToken::new();
    let first = finished("a", 100, Catalog::builtin().clone());
    let others = vec![finished("b", 200, own)];
    let all = Finished { first, others, sweep: Some(json!({ "points": [] })) };
    let task = tokio::spawn(page.show(all, shutdown.clone()));
    let ask =
        async |path: &str| send(address, format!("GET {path} HTTP/1.1\r\nHost: {address}\r\n\r\n").as_bytes()).await;
    let get = async |path: &str| json_of(&ask(path).await);
    let about = get("/runs/1/api/about").await;
    assert_eq!((&about["run"], &about["kind"], &about["can_play"]), (&json!("b"), &json!("finished"), &json!(false)));
    let runs = json!([{ "name": "a", "base": "" }, { "name": "b", "base": "/runs/1" }]);
    assert_eq!((&about["runs"], &get("/api/about").await["runs"]), (&runs, &runs));
    assert_eq!((&about["is_of_sweep"], get("/api/sweep").await), (&json!(true), json!({ "points": [] })));
    assert_eq!(get("/api/history").await["evaluations"][0]["n_env_steps"], 100);
    assert_eq!(get("/runs/1/api/history").await["evaluations"][0]["n_env_steps"], 200);
    let video = "mine.7.success";
    assert_eq!(get(&format!("/runs/1/api/recording?id={video}")).await["blueprint"], "mine");
    assert_eq!(status(&ask(&format!("/runs/1/api/poster?id={video}")).await), 200);
    // The first run does not know that goal.
    assert_eq!(status(&ask(&format!("/api/recording?id={video}")).await), 404);
    shutdown.cancel();
    within(task).await.unwrap().unwrap();
}
