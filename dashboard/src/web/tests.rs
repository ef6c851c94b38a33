//! Tests of the page from the perspective of browsers and probes, with a real bus and hand-written requests.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

use blueprints::Catalog;
use proto::codec::encode_recording;
use proto::{Role, Trajectory, Valid};
use serde_json::{Value, json};
use tokio::io::{AsyncBufReadExt, AsyncReadExt, AsyncWriteExt, BufReader};
use tokio::net::TcpStream;

use super::events::MAX_VIEWERS;
use super::server::MAX_CONNECTIONS;
use super::*;
use crate::config::Token;
use samples::evaluation;

mod finished;
#[path = "../../../runlog/src/history/tests/samples.rs"]
pub(super) mod samples;
#[path = "../../../proto/src/codec/tests/samples.rs"]
#[expect(dead_code)]
mod trajectories;
#[path = "../../../policy/tests/samples/untrained.rs"]
mod untrained;

const TOKEN: &str = "0123456789abcdef";

/// The last two steps of an episode that succeeds.
pub(super) fn recording() -> Trajectory {
    let mut recording = trajectories::successful("a", 0);
    recording.task.blueprint = "2_000".parse().unwrap();
    recording
}

/// Fails a test that waits for something that never happens.
async fn within<T>(future: impl Future<Output = T>) -> T {
    tokio::time::timeout(Duration::from_secs(60), future).await.expect("it takes a moment only")
}

struct Served {
    dir: tempfile::TempDir,
    bus: Bus,
    address: SocketAddr,
    evaluations: mpsc::UnboundedSender<Evaluation>,
    task: tokio::task::JoinHandle<anyhow::Result<()>>,
}

/// A page connected to a bus. Videos and recordings are read from a new folder; attention is that of an untrained
/// network.
async fn serve(token: Option<&str>) -> Served {
    let dir = tempfile::tempdir().unwrap();
    let bus = Bus::isolated(dir.path()).await.unwrap();
    let token = token.map(|token| Token::from(token.to_owned()));
    let page = Page::bind(&Valid::new(WebConfig { token, ..Default::default() }).unwrap()).await.unwrap();
    let address = page.address();
    let (evaluations, its_evaluations) = mpsc::unbounded_channel();
    let farewell = Farewell { ended: "the run", command: Some("a command".to_owned()) };
    let about = About { farewell, ..about(Kind::Training, "r", 5000, Catalog::builtin().clone()) };
    let stage = Stage::new(None, |order, _| match order.builder {
        Builder::Expert => Ok(recording()),
        Builder::Policy => Err(StageError::NoWeights),
    });
    let run = ShownRun {
        about,
        evaluations: Vec::new(),
        learner: Vec::new(),
        run: Some(RunPaths::new(dir.path())),
        policy: untrained::small_policy(),
        weights: untrained_weights(),
        stage: Some(stage),
    };
    let its_bus = bus.clone();
    let task = tokio::spawn(async move { page.serve(&its_bus, run, its_evaluations).await });
    Served { dir, bus, address, evaluations, task }
}

fn untrained_weights() -> watch::Receiver<Option<Arc<Weights>>> {
    watch::channel(Some(Arc::new(untrained::weights()))).1
}

fn about(kind: Kind, run: &str, n_env_steps: u64, catalog: Arc<Catalog>) -> About {
    let (blueprints, trained) = (Vec::new(), Vec::new());
    let farewell = Farewell { ended: "the program", command: None };
    let run = run.to_owned();
    let n_env_steps = Some(n_env_steps);
    let (origin, success) = (Value::Null, Value::Null);
    About { kind, run, preset: None, n_env_steps, blueprints, trained, catalog, farewell, origin, success }
}

/// Sends bytes and returns the whole response.
async fn send(address: SocketAddr, bytes: &[u8]) -> String {
    let mut stream = TcpStream::connect(address).await.unwrap();
    // The server may close the connection before it has read all of a request that is too large.
    let _ = stream.write_all(bytes).await;
    let mut answer = Vec::new();
    let _ = within(stream.read_to_end(&mut answer)).await;
    String::from_utf8_lossy(&answer).into_owned()
}

impl Served {
    /// Asks for the events and returns the lines of the response.
    async fn listen(&self) -> BufReader<TcpStream> {
        let mut stream = TcpStream::connect(self.address).await.unwrap();
        let request = format!("GET /api/events HTTP/1.1\r\nHost: {}\r\n\r\n", self.address);
        stream.write_all(request.as_bytes()).await.unwrap();
        BufReader::new(stream)
    }

    async fn get_with(&self, path: &str, headers: &str) -> String {
        let request = format!("GET {path} HTTP/1.1\r\nHost: {}\r\n{headers}\r\n", self.address);
        send(self.address, request.as_bytes()).await
    }

    async fn get(&self, path: &str) -> String {
        self.get_with(path, "").await
    }

    async fn status(&self, path: &str, headers: &str) -> u16 {
        status(&self.get_with(path, headers).await)
    }

    async fn end(self) {
        drop(self.evaluations);
        within(self.task).await.unwrap().unwrap();
        self.bus.close().await;
    }
}

fn status(answer: &str) -> u16 {
    answer.split(' ').nth(1).unwrap_or_else(|| panic!("no status: {answer:?}")).parse().unwrap()
}

fn json_of(answer: &str) -> Value {
    serde_json::from_str(answer.split_once("\r\n\r\n").unwrap().1).unwrap()
}

/// Reads events until one matches, and returns its data.
async fn event_with(lines: &mut BufReader<TcpStream>, name: &str, wanted: impl Fn(&Value) -> bool) -> Value {
    let (mut line, mut found) = (String::new(), String::new());
    loop {
        line.clear();
        assert!(lines.read_line(&mut line).await.unwrap() > 0, "the stream ended before {name}");
        if let Some(name) = line.strip_prefix("event: ") {
            found = name.trim().to_owned();
        } else if let Some(data) = line.strip_prefix("data: ").filter(|_| found == name) {
            let data: Value = serde_json::from_str(data).unwrap();
            if wanted(&data) {
                return data;
            }
        }
    }
}

#[test]
fn every_module_is_served_with_what_it_imports() {
    for (path, _, text) in assets::all().filter(|(path, ..)| path.ends_with(".js")) {
        for name in text.split("\"./").skip(1).filter_map(|rest| rest.split('"').next()) {
            let is_served = assets::all().any(|(path, ..)| path.strip_prefix('/') == Some(name));
            // Types are for the checker only.
            assert!(is_served || name == "types", "{path} imports {name}");
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn only_what_is_meant_to_be_seen_is_served() {
    let served = serve(None).await;
    let host = format!("Host: {}\r\n", served.address);
    for (expected, paths) in [
        (200, "/ /app.js /style.css /icon.svg /three.js /space.js /draw.js /metrics /healthz"),
        (200, "/api/about /api/blueprints /api/picture?id=2_000 /api/inventory /api/blueprint?id=2_000 /api/history"),
        (202, "/api/replay"),
        (400, "/api/play"),
        (404, "/api/picture?id=../eval.db /api/blueprint?id=../eval.db /runs/1/api/about /api/sweep"),
        (404, "/../Cargo.toml /%2e%2e/%2e%2e/etc/passwd //etc/passwd"),
        (404, "/assets/app.js /app.js/../../src/web.rs /app.js%00"),
        (405, "/api/check"),
        (503, "/readyz"),
    ] {
        for path in paths.split(' ') {
            assert_eq!(served.status(path, "").await, expected, "{path}");
        }
    }
    let table = [
        ("HEAD / HTTP/1.1", &host[..], 200),
        ("POST /api/check HTTP/1.1", &host, 400),
        ("POST /api/check HTTP/1.1", "Host: evil.example\r\nContent-Length: 4\r\n", 403),
        ("POST / HTTP/1.1", &host, 405),
        ("GET / HTTP/1.1", "Host: localhost:1\r\n", 200),
        ("GET / HTTP/1.1", "Host: [::1]:80\r\n", 200),
        ("GET / HTTP/1.1", "Host: evil.example\r\n", 403),
        ("GET / HTTP/1.1", "Host: 127.0.0.1.evil.example\r\n", 403),
        ("GET / HTTP/1.1", "", 403),
        ("GET / HTTP/1.1", "Host: localhost\r\nContent-Length: 4\r\n", 413),
        ("GET / HTTP/1.1", "Host: localhost\r\nTransfer-Encoding: chunked\r\n", 413),
        ("GET\0/ HTTP/1.1", &host, 400),
        // One host, named once: what comes first or last depends on who reads it.
        ("GET / HTTP/1.1", "Host: localhost\r\nHost: evil.example\r\n", 400),
        ("GET / HTTP/1.1", "Host: evil.example\r\nHost: localhost\r\n", 400),
        ("GET / HTTP/1.1", "Host: localhost\r\nHost: localhost\r\n", 400),
        ("GET /healthz HTTP/1.1", "Host: localhost\r\nHost: localhost\r\n", 400),
        ("GET / HTTP/1.1", "Host: localhost, evil.example\r\n", 403),
        ("GET / HTTP/1.1", "Host: localhost@evil.example\r\n", 403),
        ("GET http://localhost/ HTTP/1.1", "Host: LOCALHOST\r\n", 200),
        ("GET http://localhost/ HTTP/1.1", "Host: evil.example\r\n", 400),
        ("GET http://evil.example/ HTTP/1.1", "Host: localhost\r\n", 400),
        ("GET http://evil.example/ HTTP/1.1", "Host: evil.example\r\n", 403),
        ("GET http://localhost@evil.example/ HTTP/1.1", "Host: localhost\r\n", 400),
        ("GET http://localhost/ HTTP/1.1", "", 400),
        ("GET http://localhost/ HTTP/1.0", "", 400),
        ("GET /healthz HTTP/1.0", "", 200),
        ("OPTIONS * HTTP/1.1", &host, 404),
        ("CONNECT localhost:80 HTTP/1.1", "Host: localhost:80\r\n", 404),
    ];
    for (line, headers, expected) in table {
        let answer = send(served.address, format!("{line}\r\n{headers}\r\n").as_bytes()).await;
        assert_eq!(status(&answer), expected, "{line} {headers}");
    }
    let large = format!("X-Large: {}\r\n", "x".repeat(20 << 10));
    assert_eq!(served.status("/", &large).await, 431);
    let many: String = (0..80).map(|i| format!("X-{i}: x\r\n")).collect();
    assert_eq!(served.status("/", &many).await, 431);
    let answer = served.get("/api/about").await.to_lowercase();
    for header in [
        "content-security-policy: default-src 'self'",
        "x-content-type-options: nosniff",
        "referrer-policy: no-referrer",
        "cache-control: no-store",
    ] {
        assert!(answer.contains(header), "{header}");
    }
    served.end().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn other_sites_may_link_to_the_page_but_not_use_it() {
    let served = serve(None).await;
    let table = [
        ("/api/history", "cross-site", "empty", 403),
        ("/api/history", "same-site", "empty", 403),
        ("/three.js", "cross-site", "script", 403),
        ("/", "cross-site", "iframe", 403),
        ("/", "cross-site", "document", 200),
        ("/api/history", "same-origin", "empty", 200),
        ("/", "none", "document", 200),
        ("/healthz", "cross-site", "empty", 200),
    ];
    for (path, site, dest, expected) in table {
        let headers = format!("Sec-Fetch-Site: {site}\r\nSec-Fetch-Dest: {dest}\r\n");
        assert_eq!(served.status(path, &headers).await, expected, "{path} {site} {dest}");
    }
    // Browsers without `Sec-Fetch-Site` send `Origin` for what scripts and forms ask for.
    let own = format!("http://{}", served.address);
    let table = [
        (&own[..], "", 200),
        (&own.to_uppercase().replace("HTTP", "http"), "", 200),
        (&own, "Sec-Fetch-Site: same-origin\r\n", 200),
        ("http://evil.example", "", 403),
        ("http://evil.example", "Sec-Fetch-Site: same-origin\r\n", 403),
        ("http://127.0.0.1:1", "", 403),
        ("http://127.0.0.1", "", 403),
        (&format!("{own}.evil.example"), "", 403),
        (&format!("ftp://{}", served.address), "", 403),
        ("null", "", 403),
        ("", "", 403),
        (&own, "Origin: http://evil.example\r\n", 403),
        (&own, "Sec-Fetch-Site: same-origin\r\nSec-Fetch-Site: cross-site\r\n", 403),
        (&own, "Sec-Fetch-Site: other\r\n", 403),
    ];
    for (origin, more, expected) in table {
        let headers = format!("Origin: {origin}\r\n{more}");
        assert_eq!(served.status("/api/history", &headers).await, expected, "{headers}");
    }
    let metrics = served.get("/metrics").await;
    assert!(metrics.contains("lodestone_page_dropped_total{run=\"r\",reason=\"request_refused\"} 15\n"), "{metrics}");
    served.end().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_token_keeps_others_out_but_not_probes() {
    let served = serve(Some(TOKEN)).await;
    for path in ["/", "/api/history", "/metrics", "/nothing", "/?token=wrong", "/?token="] {
        assert_eq!(served.status(path, "").await, 401, "{path}");
    }
    assert_eq!((served.status("/healthz", "").await, served.status("/readyz", "").await), (200, 503));
    let table = [
        ("/", "Authorization: Bearer wrong\r\n".to_owned(), 401),
        ("/", "Cookie: lodestone_token=wrong\r\n".to_owned(), 401),
        ("/", format!("Cookie: other={TOKEN}\r\n"), 401),
        ("/metrics", format!("Authorization: Bearer {TOKEN}\r\n"), 200),
        ("/api/history", format!("Cookie: a=b; lodestone_token={TOKEN}\r\n"), 200),
        ("/nothing", format!("Authorization: Bearer {TOKEN}\r\n"), 404),
    ];
    for (path, headers, expected) in table {
        assert_eq!(served.status(path, &headers).await, expected, "{path} {headers}");
    }
    let answer = served.get(&format!("/?token={TOKEN}")).await;
    assert_eq!(status(&answer), 303);
    let header = |name: &str| {
        let of = |line: &str| {
            line.split_once(": ").filter(|(key, _)| key.eq_ignore_ascii_case(name)).map(|(_, v)| v.to_owned())
        };
        answer.lines().find_map(of).unwrap()
    };
    assert_eq!(header("location"), "/");
    let cookie = header("set-cookie");
    assert!(cookie.contains("HttpOnly") && cookie.contains("SameSite=Lax"), "{cookie}");
    let cookie = cookie.split(';').next().unwrap();
    assert_eq!(served.status("/", &format!("Cookie: {cookie}\r\n")).await, 200);
    // The cookie of another page on this host has another name, so both are sent.
    let both = format!("Cookie: lodestone_token_0={}; {cookie}\r\n", "x".repeat(16));
    assert_eq!(served.status("/", &both).await, 200);
    // A browser adds the cookie to what other sites ask for, but not the header. A proxy may have changed the host.
    let elsewhere = "Origin: http://127.0.0.1:1\r\n";
    for (headers, expected) in [
        (format!("Cookie: {cookie}\r\nSec-Fetch-Site: same-site\r\n"), 403),
        (format!("Cookie: {cookie}\r\nSec-Fetch-Site: same-site\r\nSec-Fetch-Dest: document\r\n"), 200),
        (format!("Cookie: {cookie}\r\n{elsewhere}"), 403),
        (format!("Cookie: {cookie}\r\n{elsewhere}Sec-Fetch-Site: same-origin\r\n"), 200),
        (format!("Authorization: Bearer {TOKEN}\r\n{elsewhere}"), 200),
    ] {
        assert_eq!(served.status("/", &headers).await, expected, "{headers}");
    }
    assert!(served.get(&format!("/?step=4&token={TOKEN}")).await.contains("location: /?step=4\r\n"));
    // Two slashes would redirect to a host of that name.
    assert!(served.get(&format!("//evil.example?token={TOKEN}")).await.contains("location: /evil.example\r\n"));
    let metrics = served.get_with("/metrics", &format!("Authorization: Bearer {TOKEN}\r\n")).await;
    assert!(metrics.contains("lodestone_page_dropped_total{run=\"r\",reason=\"request_refused\"} 11\n"), "{metrics}");
    served.end().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn too_many_browsers_leave_room_for_probes() {
    let served = serve(None).await;
    let mut listeners = Vec::new();
    for _ in 0..MAX_VIEWERS {
        let mut lines = served.listen().await;
        // Only a connection with a response occupies a slot.
        within(event_with(&mut lines, "roster", |_| true)).await;
        listeners.push(lines);
    }
    assert_eq!(served.status("/api/events", "").await, 503);
    assert_eq!(served.status("/healthz", "").await, 200);
    let metrics = served.get("/metrics").await;
    assert!(metrics.contains(&format!("lodestone_page_viewers{{run=\"r\"}} {MAX_VIEWERS}.0\n")), "{metrics}");
    drop(listeners);
    served.end().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn connections_that_say_too_little_are_few_and_short() {
    /// How often all places are taken again.
    const N_ROUNDS: usize = 40;
    let served = serve(None).await;
    // No head, half of one, and a head whose body does not come.
    let body = format!("POST /api/check HTTP/1.1\r\nHost: {}\r\nContent-Length: 9\r\n\r\n", served.address);
    let mut held = VecDeque::new();
    let hold = async |held: &mut VecDeque<TcpStream>, words: &str| {
        let mut stream = TcpStream::connect(served.address).await.unwrap();
        stream.write_all(words.as_bytes()).await.unwrap();
        held.push_back(stream);
        // What was closed long ago only takes up file descriptors.
        held.drain(..held.len().saturating_sub(2 * MAX_CONNECTIONS));
    };
    for round in 0..N_ROUNDS {
        for _ in 0..MAX_CONNECTIONS {
            hold(&mut held, ["", "GET / HTTP/1.1\r\n", &body][round % 3]).await;
        }
        assert_eq!(served.status("/healthz", "").await, 200, "round {round}");
        assert_eq!(served.status("/metrics", "").await, 200, "round {round}");
    }
    // A browser that listens keeps its place.
    let mut lines = served.listen().await;
    within(event_with(&mut lines, "roster", |_| true)).await;
    for _ in 0..2 * MAX_CONNECTIONS {
        hold(&mut held, "").await;
    }
    served.evaluations.send(evaluation(1000, &[])).unwrap();
    within(event_with(&mut lines, "evaluation", |_| true)).await;
    let metrics = served.get("/metrics").await;
    let evicted = metrics.lines().find_map(|line| {
        line.strip_prefix("lodestone_page_dropped_total{run=\"r\",reason=\"connection_evicted\"} ")?
            .parse::<usize>()
            .ok()
    });
    // Some were given up by this side first.
    let n_held = (N_ROUNDS + 2) * MAX_CONNECTIONS;
    assert!(evicted.is_some_and(|n| (n_held / 2..=n_held).contains(&n)), "{evicted:?} of {n_held}");
    // Those end soon as well, although nothing comes after them.
    for mut stream in held {
        // The server may have left bytes unread.
        let _ = within(stream.read_to_end(&mut Vec::new())).await;
    }
    drop(lines);
    served.end().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_connection_serves_one_request() {
    let served = serve(None).await;
    // Reads to the end, which comes although the client keeps its side open.
    let answer = served.get_with("/healthz", "Connection: keep-alive\r\n").await.to_lowercase();
    assert!(answer.contains("connection: close") && answer.ends_with("serving\n"), "{answer}");
    served.end().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_is_put_on_the_bus_reaches_the_browser() {
    let mut served = serve(None).await;
    let before = served.bus.metrics_publisher("learner").await.unwrap();
    before.put(&crate::tests::samples::learner().value).await.unwrap();
    let mut lines = served.listen().await;
    // A late subscriber first receives the newest value. A sample still in flight arrives as an event.
    let first = within(event_with(&mut lines, "metrics", |data| data["key"] == "learner")).await;
    assert_eq!(first["payload"]["weights_version"], 812);
    let alive = served.bus.declare_alive(Role::Actor, "a-1").await.unwrap();
    within(event_with(&mut lines, "roster", |data| data["actors"] == json!(["a-1"]))).await;
    drop(alive);
    within(event_with(&mut lines, "roster", |data| data["actors"] == json!([]))).await;
    served.evaluations.send(evaluation(1000, &[])).unwrap();
    let news = within(event_with(&mut lines, "evaluation", |_| true)).await;
    assert_eq!(news["n_env_steps"], 1000);
    assert_eq!(served.status("/readyz", "").await, 200);
    let metrics = served.get("/metrics").await;
    assert!(metrics.contains("lodestone_page_viewers{run=\"r\"} 1.0\n"), "{metrics}");
    let about = served.get("/api/about").await;
    // The last event says what to do next. The page then answers until those who listen have gone.
    let (silenced, _passes) = mpsc::unbounded_channel();
    drop(std::mem::replace(&mut served.evaluations, silenced));
    let ended = within(event_with(&mut lines, "ended", |_| true)).await;
    assert_eq!(ended, json!({ "ended": "the run", "command": "a command" }));
    assert!(about.contains(&format!("\"farewell\":{ended}")), "{about}");
    assert_eq!(served.status("/api/history", "").await, 200);
    drop(lines);
    within(&mut served.task).await.unwrap().unwrap();
    assert!(TcpStream::connect(served.address).await.is_err());
    served.bus.close().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn videos_are_told_and_sent_and_nothing_else_is() {
    let served = serve(None).await;
    let dir = &served.dir;
    let folder = dir.path().join("videos").join("2_000");
    std::fs::create_dir_all(&folder).unwrap();
    std::fs::write(folder.join("00000007-success.mp4"), "the video").unwrap();
    std::fs::write(folder.join("secret.mp4"), "not a video of ours").unwrap();
    std::fs::write(dir.path().join("eval.db"), "not a video").unwrap();
    let answer = json_of(&served.get("/api/videos").await);
    let video = json!({ "id": "2_000.7.success", "blueprint": "2_000", "weights_version": 7, "ending": "success" });
    assert_eq!(answer, json!({ "schema_version": 1, "videos": [video] }));
    let answer = served.get("/api/video?id=2_000.7.success").await;
    assert!(answer.contains("content-type: video/mp4") && answer.ends_with("the video"), "{answer}");
    // The matching recording: two steps, with the attention in each scene.
    let recordings = dir.path().join("replays").join("2_000");
    std::fs::create_dir_all(&recordings).unwrap();
    assert_eq!(served.status("/api/recording?id=2_000.7.success", "").await, 404, "there is none yet");
    let recording = encode_recording(&recording());
    std::fs::write(recordings.join("00000007-success.trajectory"), recording).unwrap();
    let answer = json_of(&served.get("/api/recording?id=2_000.7.success").await);
    assert_eq!((&answer["blueprint"], answer["scenes"].as_array().unwrap().len()), (&json!("2_000"), 3));
    let poster = served.get("/api/poster?id=2_000.7.success").await;
    assert!(poster.contains("content-type: image/png") && poster.contains("IHDR"), "{} bytes", poster.len());
    let attention = &answer["attention"];
    assert_eq!((&attention["weights_version"], &attention["sources"][0]), (&json!(2), &json!("gripper 1")));
    let percent: Vec<Vec<Vec<f64>>> = serde_json::from_value(attention["percent"].clone()).unwrap();
    assert_eq!(percent.len(), attention["sources"].as_array().unwrap().len());
    for shares in percent.iter().flatten() {
        // Each of the 16 values is rounded by at most one half.
        assert!(shares.len() == 16 && (shares.iter().sum::<f64>() - 100.0).abs() <= 8.0, "{shares:?}");
    }
    // A gripper's choice is no attention of blocks.
    let most: Vec<Vec<Vec<(usize, u64)>>> = serde_json::from_value(attention["most"].clone()).unwrap();
    assert!(most.len() == percent.len() + 1 && most[0].is_empty());
    assert!(most.last().unwrap().iter().all(|blocks| blocks.len() == 16), "{most:?}");
    assert!(most.iter().flatten().flatten().all(|(block, percent)| *block < 16 && (6..=100).contains(percent)));
    for id in
        ["", "?id=", "?id=2_000.8.success", "?id=../eval.db", "?id=2_000/secret", "?id=secret", "?id=%2e%2e/eval.db"]
    {
        assert_eq!(served.status(&format!("/api/video{id}"), "").await, 404, "{id}");
        assert_eq!(served.status(&format!("/api/recording{id}"), "").await, 404, "{id}");
        assert_eq!(served.status(&format!("/api/poster{id}"), "").await, 404, "{id}");
    }
    served.end().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_episode_is_played_when_somebody_asks_for_it() {
    let served = serve(None).await;
    let answer = served.get("/api/play?blueprint=2_000&agent=expert&seed=3").await;
    assert_eq!(status(&answer), 200, "{answer}");
    let episode = json_of(&answer);
    assert_eq!((&episode["blueprint"], &episode["end"]), (&json!("2_000"), &json!("success")));
    assert_eq!(episode["scenes"].as_array().unwrap().len(), 3);
    // No weights have arrived, so the policy is unavailable. Invalid orders are rejected.
    assert_eq!(served.status("/api/play?blueprint=2_000", "").await, 503);
    assert_eq!(served.status("/api/play?blueprint=99_999", "").await, 400);
    // The played episode has a different goal than the requested one, so it is not shown.
    assert_eq!(served.status("/api/play?blueprint=2_001&agent=expert", "").await, 500);
    served.end().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_drawing_is_checked_and_built() {
    let served = serve(Some(TOKEN)).await;
    let post = async |path: &str, body: &str, token: &str| {
        let head = format!("POST {path} HTTP/1.1\r\nHost: {}\r\nAuthorization: Bearer {token}\r\n", served.address);
        send(served.address, format!("{head}Content-Length: {}\r\n\r\n{body}", body.len()).as_bytes()).await
    };
    let file = Catalog::builtin().get(&"2_000".parse().unwrap()).unwrap().to_toml("a test");
    let answer = post("/api/check", &file, TOKEN).await;
    assert_eq!(status(&answer), 200, "{answer}");
    let found = json_of(&answer);
    assert_eq!((&found["problems"], found["connections"].as_array().unwrap().len()), (&json!([]), 1));
    assert!(found["toml"].as_str().unwrap().contains("id = \"drawn_2_"));
    assert_eq!(status(&post("/api/play?agent=expert", &file, TOKEN).await), 200);
    let table = [
        ("/api/check", file.as_str(), "wrong", 401),
        ("/api/play?agent=expert", &file, "wrong", 401),
        ("/api/play?agent=expert&blueprint=2_000", &file, TOKEN, 400),
        ("/api/play?agent=expert", "no blueprint", TOKEN, 400),
        ("/api/check", "no blueprint", TOKEN, 400),
        ("/api/check", &" ".repeat((64 << 10) + 1), TOKEN, 413),
        ("/api/about", &file, TOKEN, 413),
    ];
    for (path, body, token, expected) in table {
        assert_eq!(status(&post(path, body, token).await), expected, "{path}");
    }
    served.end().await;
}
