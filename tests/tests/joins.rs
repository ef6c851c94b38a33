//! Joining a router while others keep connections open that lead nowhere. With `--nocapture`, the tests print seconds.

use proto::Valid;
use std::any::Any;
use std::future::Future;
use std::net::{SocketAddr, TcpListener as StdListener, UdpSocket as StdSocket};
use std::sync::Arc;
use std::time::{Duration, Instant};

use bus::{Bus, BusConfig, BusMode, JoinCounts, SecurityConfig};
use quinn::crypto::rustls::QuicClientConfig;
use quinn::rustls;
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use tempfile::TempDir;
use tokio::io::AsyncReadExt;
use tokio::net::{TcpStream, UdpSocket};

/// Connections that lead nowhere.
const N_OPEN: u64 = 100;

/// The time that a connection gets.
const JOIN_TIME: Duration = Duration::from_secs(4);

/// Only ends a test that hangs.
const LIMIT: Duration = Duration::from_secs(120);

async fn within<T>(what: &str, future: impl Future<Output = T>) -> T {
    tokio::time::timeout(LIMIT, future).await.unwrap_or_else(|_| panic!("{what}: nothing within {LIMIT:?}"))
}

/// A router, with keys unless it speaks plain TCP.
struct Site {
    folder: TempDir,
    endpoint: String,
    at: SocketAddr,
    router: Bus,
}

impl Site {
    async fn open(protocol: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let hosts = ["127.0.0.1".to_owned(), "localhost".to_owned()];
        deploy::keys::create(&folder.path().join("keys"), &hosts, 1).unwrap();
        // This port was free a moment ago.
        let at = match protocol {
            "quic" => StdSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap(),
            _ => StdListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap(),
        };
        let endpoint = format!("{protocol}/{at}");
        let security = security(&folder, protocol, "router");
        let config =
            Valid::new(BusConfig { listen: vec![endpoint.clone()], security, ..BusConfig::default() }).unwrap();
        let router = within("router", Bus::open(&config)).await.unwrap();
        Self { folder, endpoint, at, router }
    }

    fn client_config(&self, role: &str) -> Valid<BusConfig> {
        let security = security(&self.folder, self.endpoint.split('/').next().unwrap(), role);
        let connect = vec![self.endpoint.clone()];
        Valid::new(BusConfig { mode: BusMode::Client, connect, security, ..BusConfig::default() }).unwrap()
    }

    async fn client(&self, role: &str) -> Bus {
        within(role, Bus::open(&self.client_config(role))).await.unwrap()
    }

    fn counts(&self) -> JoinCounts {
        self.router.joins().unwrap()
    }

    async fn counted(&self, what: &str, holds: impl Fn(JoinCounts) -> bool) -> JoinCounts {
        within(what, async {
            while !holds(self.counts()) {
                tokio::task::yield_now().await;
            }
            self.counts()
        })
        .await
    }
}

fn security(folder: &TempDir, protocol: &str, role: &str) -> SecurityConfig {
    let keys = (protocol != "tcp").then(|| folder.path().join("keys").join(role));
    SecurityConfig { keys }
}

/// TCP connections on which nothing is ever sent.
async fn silent(at: SocketAddr) -> Vec<TcpStream> {
    let mut open = Vec::new();
    for _ in 0..N_OPEN {
        open.push(TcpStream::connect(at).await.unwrap());
    }
    open
}

/// The QUIC client of a process with the keys of `role`.
fn quic_client(site: &Site, role: &str) -> quinn::Endpoint {
    let folder = site.folder.path().join("keys").join(role);
    let certificates =
        |name: &str| CertificateDer::pem_file_iter(folder.join(name)).unwrap().collect::<Result<Vec<_>, _>>().unwrap();
    let mut roots = rustls::RootCertStore::empty();
    roots.add(certificates("ca.pem").remove(0)).unwrap();
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let builder =
        rustls::ClientConfig::builder_with_provider(provider).with_protocol_versions(&[&rustls::version::TLS13]);
    let key = PrivateKeyDer::from_pem_file(folder.join("key.pem")).unwrap();
    let builder = builder.unwrap().with_root_certificates(roots);
    let mut config = builder.with_client_auth_cert(certificates("cert.pem"), key).unwrap();
    config.alpn_protocols = vec![b"zenoh".to_vec()];
    let mut endpoint = quinn::Endpoint::client("127.0.0.1:0".parse().unwrap()).unwrap();
    endpoint.set_default_client_config(quinn::ClientConfig::new(Arc::new(QuicClientConfig::try_from(config).unwrap())));
    endpoint
}

/// Sends the first packets of QUIC clients that never hear an answer, as behind a firewall that lets UDP out only.
async fn unanswered(site: &Site) -> UdpSocket {
    let out = UdpSocket::bind("127.0.0.1:0").await.unwrap();
    let client = quic_client(site, "actor");
    let mut packet = [0; 2048];
    for _ in 0..N_OPEN {
        let wall = UdpSocket::bind("127.0.0.1:0").await.unwrap();
        let connecting = client.connect(wall.local_addr().unwrap(), "localhost").unwrap();
        let (n_bytes, _) = wall.recv_from(&mut packet).await.unwrap();
        out.send_to(&packet[..n_bytes], site.at).await.unwrap();
        drop(connecting);
    }
    out
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_joins_while_100_connections_lead_nowhere() {
    for protocol in ["tls", "quic", "tcp"] {
        // On a busy machine, the router may drop the open ones before the client has come.
        within(protocol, async { while !joins_beside_open_ones(protocol).await {} }).await;
    }
}

/// Opens connections that lead nowhere, and joins. Returns whether all this took less time than each of them gets.
async fn joins_beside_open_ones(protocol: &str) -> bool {
    let site = Site::open(protocol).await;
    let opening = Instant::now();
    let open: Box<dyn Any> = match protocol {
        "quic" => Box::new(unanswered(&site).await),
        _ => Box::new(silent(site.at).await),
    };
    if protocol != "tcp" {
        site.counted("the open ones", |counts| counts.n_pending + counts.n_stalled == N_OPEN).await;
    }
    let start = Instant::now();
    let client = site.client("viewer").await;
    println!("{protocol}: joined after {:.2} s, beside {N_OPEN} open ones", start.elapsed().as_secs_f64());
    assert!(client.is_connected().await);
    // The router counts the client a moment after it has answered.
    let joins = match protocol {
        "tcp" => site.router.joins(),
        _ => Some(site.counted("the client", |counts| counts.n_joined > 0).await),
    };
    let is_in_time = opening.elapsed() < JOIN_TIME;
    if is_in_time {
        let counts = JoinCounts { n_pending: N_OPEN, n_joined: 1, ..JoinCounts::default() };
        assert_eq!(joins, (protocol != "tcp").then_some(counts), "{protocol}");
    }
    client.close().await;
    site.router.close().await;
    drop(open);
    is_in_time
}

#[tokio::test(flavor = "multi_thread")]
async fn who_stands_still_is_dropped_and_counted() {
    for protocol in ["tls", "tcp"] {
        let site = Site::open(protocol).await;
        let start = Instant::now();
        for mut connection in silent(site.at).await {
            // zenoh may say goodbye.
            let mut rest = Vec::new();
            let _ = within("the end of the connection", connection.read_to_end(&mut rest)).await;
        }
        println!("{protocol}: dropped after {:.2} s", start.elapsed().as_secs_f64());
        if protocol == "tls" {
            let expected = JoinCounts { n_stalled: N_OPEN, ..JoinCounts::default() };
            assert_eq!(site.counted("all", |counts| counts.n_stalled == N_OPEN).await, expected);
        }
        site.router.close().await;
    }
    // Good keys make no difference. On a busy machine, the router may drop the connection before it is open.
    let (site, connection) = within("QUIC", async {
        loop {
            let site = Site::open("quic").await;
            match quic_client(&site, "actor").connect(site.at, "localhost").unwrap().await {
                Ok(connection) => break (site, connection),
                Err(_) => site.router.close().await,
            }
        }
    })
    .await;
    let start = Instant::now();
    within("the end of the connection", connection.closed()).await;
    println!("quic: dropped after {:.2} s", start.elapsed().as_secs_f64());
    let expected = JoinCounts { n_stalled: 1, ..JoinCounts::default() };
    assert_eq!(site.counted("it", |counts| counts.n_stalled == 1).await, expected);
    site.router.close().await;
}

#[test]
fn who_mixes_the_keys_of_two_roles_is_refused() {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().unwrap();
    for protocol in ["tls", "quic"] {
        runtime.block_on(async {
            let site = Site::open(protocol).await;
            let keys = site.folder.path().join("keys");
            std::fs::copy(keys.join("learner/password"), keys.join("actor/password")).unwrap();
            let config = site.client_config("actor");
            tokio::select! {
                joined = Bus::open(&config) => panic!("{protocol}: {joined:?}"),
                counts = site.counted("a refusal", |counts| counts.n_refused > 0) => assert_eq!(counts.n_joined, 0),
            }
            site.router.close().await;
        });
    }
    // Waiting for the threads that keep trying would have no end.
    runtime.shutdown_background();
}

#[tokio::test(flavor = "multi_thread")]
async fn members_talk_over_either_protocol() {
    for protocol in ["tls", "quic"] {
        let site = Site::open(protocol).await;
        let (evaluator, viewer) = (site.client("evaluator").await, site.client("viewer").await);
        let publisher = evaluator.metrics_publisher("eval/summary").await.unwrap();
        // Longer than any buffer on the way.
        let value = serde_json::Value::String("0123456789".repeat(500_000));
        publisher.put(&value).await.unwrap();
        let mut reader = viewer.metrics_subscriber("eval/summary").await.unwrap();
        // The router may know the evaluator's key a moment after the viewer has asked.
        let sample = within("the value", async {
            loop {
                match tokio::time::timeout(Duration::from_secs(1), reader.recv()).await {
                    Ok(sample) => break sample.unwrap(),
                    Err(_) => reader.ask_latest().await.unwrap(),
                }
            }
        });
        assert!(sample.await.value == value, "{protocol}");
        // The router goes; both notice.
        site.router.close().await;
        for member in [&evaluator, &viewer] {
            within("the loss", async {
                while member.is_connected().await {
                    tokio::task::yield_now().await;
                }
            })
            .await;
            member.close().await;
        }
    }
}
