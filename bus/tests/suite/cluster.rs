//! A router and clients for one test, and waiting with a timeout.

use std::future::{Future, IntoFuture};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use bus::{Bus, BusConfig, TrajectoryServer};
use proto::{Refusal, Trajectory, Valid, WeightsVersion};
use tempfile::TempDir;
use tokio::sync::watch;

/// Every wait takes milliseconds; the timeout only ends a test that hangs.
const LIMIT: Duration = Duration::from_secs(60);

pub(crate) async fn within<T>(what: &str, future: impl Future<Output = T>) -> T {
    tokio::time::timeout(LIMIT, future).await.unwrap_or_else(|_| panic!("{what}: nothing within {LIMIT:?}"))
}

/// Waits until the watched value satisfies `wanted`, and returns it.
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

    pub(crate) fn client_config(&self) -> Valid<BusConfig> {
        BusConfig::isolated_client(self.dir.path())
    }

    pub(crate) async fn client(&self) -> Bus {
        within("client", Bus::open(&self.client_config())).await.unwrap()
    }

    /// A plain zenoh session without our types, like that of a script.
    pub(crate) async fn script(&self) -> zenoh::Session {
        let endpoint = &self.client_config().connect[0];
        let config = format!(
            r#"{{ mode: "client", connect: {{ endpoints: ["{endpoint}"] }}, scouting: {{ multicast: {{ enabled: false }} }} }}"#
        );
        within("script", zenoh::open(zenoh::Config::from_json5(&config).unwrap()).into_future()).await.unwrap()
    }
}

/// A learner that keeps the trajectories it accepts.
pub(crate) struct Learner {
    pub(crate) server: TrajectoryServer,
    pub(crate) taken: Arc<Mutex<Vec<Trajectory>>>,
}

impl Learner {
    /// Accepts the trajectories that pass `decide`; its weights are at version 12.
    pub(crate) async fn start(
        bus: &Bus,
        decide: impl Fn(&Trajectory) -> Result<(), Refusal> + Send + Sync + 'static,
    ) -> Self {
        let taken = Arc::new(Mutex::new(Vec::new()));
        let mailbox = taken.clone();
        let handler = move |trajectory: Trajectory| {
            decide(&trajectory)?;
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
