//! Episodes on demand: a browser names goal, agent, way of acting and seed, and gets the whole episode.

use std::fmt;
use std::sync::Arc;

use axum::extract::{Extension, RawQuery};
use axum::http::StatusCode;
use axum::http::header::{CONTENT_TYPE, RETRY_AFTER};
use axum::response::{IntoResponse, Response};
use blueprints::{Blueprint, BlueprintId, Catalog};
use proto::{ActionMode, Trajectory};
use tokio::sync::Semaphore;
use tokio_util::sync::CancellationToken;

use super::replay::Replays;

/// Who builds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Builder {
    /// The policy of the run, with its newest weights.
    #[default]
    Policy,
    /// The scripted expert.
    Expert,
}

/// The episode that somebody wants to see.
#[derive(Clone, Debug)]
pub struct Order {
    /// The goal.
    pub blueprint: Blueprint,
    /// Who builds it.
    pub builder: Builder,
    /// How a policy acts.
    pub acting: ActionMode,
    /// Seed of the start and of sampled actions.
    pub seed: u64,
}

/// Why there is no episode.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum StageError {
    /// The first weights are still under way.
    #[error("no weights came yet; ask again in a moment, or let the expert build")]
    NoWeights,
    /// Nobody waits for it any more.
    #[error("the episode is no longer wanted")]
    Unwanted,
    /// It cannot be played.
    #[error("the episode cannot be played: {0}")]
    Failed(String),
}

/// Plays an episode; the second argument is asked at every step whether somebody still waits for it.
type Play = dyn Fn(&Order, &(dyn Fn() -> bool + Sync)) -> Result<Trajectory, StageError> + Send + Sync;

/// Where episodes are played, one at a time.
#[derive(Clone)]
pub struct Stage {
    play: Arc<Play>,
    turn: Arc<Semaphore>,
}

impl fmt::Debug for Stage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Stage")
    }
}

impl Stage {
    /// A stage whose episodes `play` plays. It is called on threads that may block.
    pub fn new(
        play: impl Fn(&Order, &(dyn Fn() -> bool + Sync)) -> Result<Trajectory, StageError> + Send + Sync + 'static,
    ) -> Self {
        Self { play: Arc::new(play), turn: Arc::new(Semaphore::new(1)) }
    }
}

impl Order {
    /// Reads `blueprint=…&agent=policy|expert&mode=greedy|sampled&seed=…`, of which only the first is needed.
    fn parse(query: &str) -> Result<Self, String> {
        let (mut id, mut builder, mut acting, mut seed) = (None, Builder::default(), ActionMode::default(), 0);
        for pair in query.split('&').filter(|pair| !pair.is_empty()) {
            match pair.split_once('=') {
                Some(("blueprint", value)) => id = Some(value),
                Some(("agent", "policy")) => builder = Builder::Policy,
                Some(("agent", "expert")) => builder = Builder::Expert,
                Some(("mode", "greedy")) => acting = ActionMode::Greedy,
                Some(("mode", "sampled")) => acting = ActionMode::Sampled,
                Some(("seed", value)) => seed = value.parse().map_err(|_| format!("seed={value} is no number"))?,
                _ => return Err(format!("`{pair}` is not known: use blueprint, agent, mode and seed")),
            }
        }
        let id = id.ok_or_else(|| "blueprint=… is missing".to_owned())?;
        let unknown = || format!("there is no blueprint `{id}`: /api/blueprints lists them");
        let id: BlueprintId = id.parse().map_err(|_| unknown())?;
        let blueprint = Catalog::builtin().find(&id).ok_or_else(unknown)?.into_owned();
        Ok(Self { blueprint, builder, acting, seed })
    }
}

/// The episode that the query names, in the form of `/api/replay`.
pub(super) async fn play(
    Extension(stage): Extension<Option<Stage>>,
    Extension(replays): Extension<Arc<Replays>>,
    RawQuery(query): RawQuery,
) -> Response {
    let Some(stage) = stage else { return (StatusCode::NOT_FOUND, "nothing is played here\n").into_response() };
    match Order::parse(query.as_deref().unwrap_or_default()) {
        Ok(order) => perform(stage, replays, order).await,
        Err(reason) => (StatusCode::BAD_REQUEST, reason + "\n").into_response(),
    }
}

/// Waits for its turn, and gives up when the browser does.
async fn perform(stage: Stage, replays: Arc<Replays>, order: Order) -> Response {
    let Ok(_turn) = stage.turn.acquire().await else { return StatusCode::INTERNAL_SERVER_ERROR.into_response() };
    let unwanted = CancellationToken::new();
    let _dropped_with_the_request = unwanted.clone().drop_guard();
    let play = stage.play.clone();
    let answer = tokio::task::spawn_blocking(move || {
        let episode = play(&order, &|| !unwanted.is_cancelled())?;
        let shown = replays.show(std::slice::from_ref(&episode), &order.blueprint);
        shown.ok_or_else(|| StageError::Failed("it has nothing to show".to_owned()))
    });
    match answer.await {
        Ok(Ok(json)) => ([(CONTENT_TYPE, "application/json")], json).into_response(),
        Ok(Err(error @ StageError::NoWeights)) => {
            (StatusCode::SERVICE_UNAVAILABLE, [(RETRY_AFTER, "1")], format!("{error}\n")).into_response()
        }
        Ok(Err(error)) => (StatusCode::INTERNAL_SERVER_ERROR, format!("{error}\n")).into_response(),
        Err(error) => {
            tracing::warn!(%error, "an episode could not be played");
            StatusCode::INTERNAL_SERVER_ERROR.into_response()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_order_says_what_is_wrong_with_it() {
        let order = Order::parse("blueprint=2_000&agent=expert&mode=sampled&seed=7").unwrap();
        assert_eq!((order.blueprint.id().as_str(), order.builder), ("2_000", Builder::Expert));
        assert_eq!((order.acting, order.seed), (ActionMode::Sampled, 7));
        let plain = Order::parse("blueprint=2_000").unwrap();
        assert_eq!((plain.builder, plain.acting, plain.seed), (Builder::Policy, ActionMode::Greedy, 0));
        for (query, words) in [
            ("", "blueprint=… is missing"),
            ("blueprint=../etc", "no blueprint `../etc`"),
            ("blueprint=99_999", "no blueprint `99_999`"),
            ("blueprint=2_000&seed=-1", "seed=-1"),
            ("blueprint=2_000&agent=me", "`agent=me`"),
            ("blueprint=2_000&speed=2", "`speed=2`"),
        ] {
            let reason = Order::parse(query).unwrap_err();
            assert!(reason.contains(words), "{query}: {reason}");
        }
    }
}
