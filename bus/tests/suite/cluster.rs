//! A router and clients for one test, and waiting with a limit.

use std::future::{Future, IntoFuture};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use bus::{Bus, BusConfig, TrajectoryServer};
use proto::{Refusal, Trajectory, WeightsVersion};
use tempfile::TempDir;
use tokio::sync::watch;

/// Everything here takes milliseconds; the limit only ends a test that hangs.
const LIMIT: Duration = Duration::from_secs(60);

pub(crate) async fn within<T>(what: &str, future: impl Future<Output = T>) -> T {
    tokio::time::timeout(LIMIT, future).await.unwrap_or_else(|_| panic!("{what}: nothing within {LIMIT:?}"))
}

/// Waits until the watched value is as wanted, and returns it.
pub(crate) async fn until<T: Clone>(what: &str, watch: &mut watch::Receiver<T>, wanted: impl FnMut(&T) -> bool) -> T {
    within(what, watch.wait_for(wanted)).await.unwrap().clone()
}

pub(crate) struct Cluster {
    pub(crate) dir: TempDir,
    pub(crate) router: Bus,
}

impl Cluster {
    pub(crate) async fn start() -> Self {
        let dir = tempfile::tempdir().unwrap();
        let router = within("router", Bus::isolated(dir.path())).await.unwrap();
        Self { dir, router }
    }

    pub(crate) fn client_config(&self) -> BusConfig {
        BusConfig::isolated_client(self.dir.path())
    }

    pub(crate) async fn client(&self) -> Bus {
        within("client", Bus::open(&self.client_config())).await.unwrap()
    }

    /// A session that knows nothing of ours, like that of a script.
    pub(crate) async fn stranger(&self) -> zenoh::Session {
        let endpoint = &self.client_config().connect[0];
        let config = format!(
            r#"{{ mode: "client", connect: {{ endpoints: ["{endpoint}"] }}, scouting: {{ multicast: {{ enabled: false }} }} }}"#
        );
        within("stranger", zenoh::open(zenoh::Config::from_json5(&config).unwrap()).into_future()).await.unwrap()
    }
}

/// A learner that keeps what it takes.
pub(crate) struct Learner {
    pub(crate) server: TrajectoryServer,
    pub(crate) taken: Arc<Mutex<Vec<Trajectory>>>,
}

impl Learner {
    /// Takes what `judge` lets pass; its weights are at version 12.
    pub(crate) async fn start(
        bus: &Bus,
        judge: impl Fn(&Trajectory) -> Result<(), Refusal> + Send + Sync + 'static,
    ) -> Self {
        let taken = Arc::new(Mutex::new(Vec::new()));
        let mailbox = taken.clone();
        let handler = move |trajectory: Trajectory| {
            judge(&trajectory)?;
            mailbox.lock().unwrap().push(trajectory);
            Ok(())
        };
        let (_, version) = watch::channel(WeightsVersion(12));
        let server = bus.serve_trajectories(handler, version).await.unwrap();
        Self { server, taken }
    }

    pub(crate) fn seqs(&self) -> Vec<u64> {
        self.taken.lock().unwrap().iter().map(|t| t.seq).collect()
    }
}
