//! Liveliness tokens: which processes are alive, and which runs have any.

use std::collections::BTreeSet;
use std::time::{Duration, Instant};

use tokio::sync::watch;
use zenoh::handlers::FifoChannelHandler;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Subscriber;
use zenoh::query::Reply;
use zenoh::sample::SampleKind;

use super::{Bus, BusConfig, BusError, Followed};
use proto::Valid;
use proto::keys::{self, Role};
use proto::trajectory::is_valid_name;

/// How long a service waits for another process with its name to end before it gives up. A killed process still appears
/// alive for up to 6 s, and its replacement must succeed.
pub const NAME_PATIENCE: Duration = Duration::from_secs(15);

/// Maximum number of names followed per role; more than a router has sessions.
pub(super) const MAX_NAMES: usize = 16_384;

/// Interval between checks of whether a name is still alive.
const LOOK_PERIOD: Duration = Duration::from_millis(250);

/// Timeout of one check.
const LOOK_TIMEOUT: Duration = Duration::from_secs(5);

/// Maximum number of runs listed.
const MAX_RUNS: usize = 100;

/// Timeout of the query for them.
const RUNS_TIMEOUT: Duration = Duration::from_secs(3);

/// Declares a process alive until the token is dropped, the session closes, or the process ends.
#[derive(Debug)]
pub struct AliveToken {
    _token: LivelinessToken,
    _open: Bus,
}

/// The names of the live processes of a role.
pub type AliveWatch = Followed<BTreeSet<String>>;

impl Bus {
    /// Declares that the process `id` (1 to 64 characters of `a-z`, `0-9`, `-`) is alive in `role`.
    ///
    /// # Errors
    /// If the name breaks the rule or the session is closed.
    pub async fn declare_alive(&self, role: Role, id: &str) -> Result<AliveToken, BusError> {
        let key = token_key(role, id)?;
        let declared = self.session.liveliness().declare_token(key.clone()).await;
        let token = declared.map_err(BusError::during(format!("declaring {key}")))?;
        Ok(AliveToken { _token: token, _open: self.clone() })
    }

    /// Like [`Self::declare_alive`], but first waits until no other process has the name, for up to `patience`. Two
    /// processes that start at the same moment may both succeed; of two actors, the learner then accepts one.
    ///
    /// Call this before the session follows [`Self::alive`] of the same role. zenoh sends a client the tokens it follows
    /// once only, so its own copy must answer then, and the router's end of the answer can overtake that.
    ///
    /// # Errors
    /// [`BusError::NameTaken`] if the other process stays, [`BusError::NoAnswer`] if that stays unknown, and the errors
    /// of [`Self::declare_alive`].
    pub async fn declare_alive_alone(&self, role: Role, id: &str, patience: Duration) -> Result<AliveToken, BusError> {
        let deadline = Instant::now() + patience;
        let mut has_warned = false;
        loop {
            let error = match self.is_alive(role, id).await {
                Ok(false) => return self.declare_alive(role, id).await,
                Ok(true) => BusError::NameTaken(role, id.to_owned()),
                Err(error) => error,
            };
            if Instant::now() >= deadline || !matches!(error, BusError::NameTaken(..) | BusError::NoAnswer) {
                return Err(error);
            }
            if !std::mem::replace(&mut has_warned, true) {
                tracing::warn!(%error, ?patience, "the name is in use, or may be; waiting");
            }
            tokio::time::sleep(LOOK_PERIOD).await;
        }
    }

    /// Returns whether a process with this name is alive.
    async fn is_alive(&self, role: Role, id: &str) -> Result<bool, BusError> {
        let key = token_key(role, id)?;
        let asked = self.session.liveliness().get(&key).timeout(LOOK_TIMEOUT).await;
        let replies = asked.map_err(BusError::during(format!("looking for {key}")))?;
        match next_token(&replies).await? {
            // Without a router, zenoh ends the query at once.
            None if !self.is_connected().await => Err(BusError::NoAnswer),
            token => Ok(token.is_some()),
        }
    }

    /// Follows the live processes of `role`, including those that were alive before.
    ///
    /// # Errors
    /// If the session is closed.
    pub async fn alive(&self, role: Role) -> Result<AliveWatch, BusError> {
        let (sender, names) = watch::channel(BTreeSet::new());
        let counts = self.counts.clone();
        let told = move |name: Option<&str>, is_alive: bool| {
            let has_room = !is_alive || sender.borrow().len() < MAX_NAMES;
            let Some(name) = name.filter(|_| has_room) else {
                counts.lock().tokens_invalid_total += 1;
                return;
            };
            sender.send_if_modified(|names| if is_alive { names.insert(name.to_owned()) } else { names.remove(name) });
        };
        let failed = BusError::during(format!("watching {}", keys::live(role, "*")));
        let subscriber = self.follow_tokens(role, told).await.map_err(failed)?;
        Ok(Followed { value: names, _source: Box::new(subscriber), _open: self.clone() })
    }

    /// Calls `told` with the name in each token of `role` and whether the process is alive, also for tokens that
    /// existed before. The name is `None` if it is not valid.
    pub(super) async fn follow_tokens(
        &self,
        role: Role,
        told: impl Fn(Option<&str>, bool) + Send + Sync + 'static,
    ) -> Result<Subscriber<()>, zenoh::Error> {
        let prefix = keys::live(role, "");
        let tokens = self.session.liveliness().declare_subscriber(keys::live(role, "*")).history(true);
        let subscriber = tokens.callback(move |sample| {
            let name = sample.key_expr().as_str().strip_prefix(&prefix).filter(|name| is_valid_name(name));
            told(name, sample.kind() == SampleKind::Put);
        });
        subscriber.await
    }
}

/// Returns the names of all runs with a live process, except that of `config`; at most the first hundred that answer.
///
/// This opens a separate session, because the sessions of a run see no other run.
///
/// # Errors
/// Those of [`Bus::open`], [`BusError::NoAnswer`], or if the session fails.
pub async fn runs(config: &Valid<BusConfig>) -> Result<BTreeSet<String>, BusError> {
    let bus = Bus::open_within(keys::ROOT, config).await?;
    let names = ask_for_runs(&bus).await;
    bus.close().await;
    names.map(|names| names.into_iter().filter(|name| *name != config.run).collect())
}

async fn ask_for_runs(bus: &Bus) -> Result<BTreeSet<String>, BusError> {
    let asked = bus.session.liveliness().get(keys::LIVE_IN_ALL_RUNS).timeout(RUNS_TIMEOUT).await;
    let replies = asked.map_err(BusError::during("looking for runs"))?;
    let mut names = BTreeSet::new();
    while let Some(key) = next_token(&replies).await? {
        let name = key.split('/').next();
        // Any process may have declared the key.
        names.extend(name.filter(|name| is_valid_name(name) && names.len() < MAX_RUNS).map(str::to_owned));
    }
    Ok(names)
}

/// Returns the key of the next token; `None` after the last.
async fn next_token(replies: &FifoChannelHandler<Reply>) -> Result<Option<String>, BusError> {
    let Ok(reply) = replies.recv_async().await else { return Ok(None) };
    // Whoever answers has the token; zenoh's error replies mean a timeout.
    let sample = reply.result().map_err(|_| BusError::NoAnswer)?;
    Ok(Some(sample.key_expr().as_str().to_owned()))
}

/// Returns the key of the token of the process `id`.
fn token_key(role: Role, id: &str) -> Result<String, BusError> {
    if is_valid_name(id) { Ok(keys::live(role, id)) } else { Err(BusError::Name(id.to_owned())) }
}
