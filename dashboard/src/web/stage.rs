//! Episodes on demand: a browser names or draws a goal, chooses the agent and the action mode, and receives the whole
//! episode.

use std::fmt;
use std::sync::Arc;

use axum::body::Bytes;
use axum::http::header::{CONTENT_TYPE, RETRY_AFTER};
use axum::http::{StatusCode, Uri};
use axum::response::{IntoResponse, Response};
use blueprints::checks::check_text;
use blueprints::{BlockIdx, Blueprint, BlueprintId, Catalog};
use parking_lot::Mutex;
use proto::codec::MAX_SEGMENT_STEPS;
use proto::{ActionMode, Disturbance, Trajectory};
use render::video::{Episode, Video, mp4};
use runlog::RunPaths;
use serde_json::json;
use tokio::sync::Semaphore;
use tokio_util::sync::CancellationToken;

use super::replay::Replays;

/// Maximum number of goals in a row in one world, as in the evaluation without resets.
const MAX_IN_A_ROW: usize = 10;

/// Maximum number of disturbances of an episode.
const MAX_DISTURBANCES: usize = 16;

/// The parameters of a request.
const KEYS: &str = "blueprint, after, agent, mode, seed, snapshot and disturb";

/// Width of the frames of a video in pixels, and their number per second.
const VIDEO_PX: usize = 640;
const VIDEO_FPS: u32 = 20;

/// The agent that builds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Builder {
    /// The policy of the run, with its newest weights.
    #[default]
    Policy,
    /// The scripted expert.
    Expert,
}

/// A requested episode.
#[derive(Clone, Debug, PartialEq)]
pub struct Order {
    /// The goal.
    pub blueprint: Blueprint,
    /// Goals to build first, without a reset in between.
    pub before: Vec<Blueprint>,
    /// The agent that builds it.
    pub builder: Builder,
    /// Action mode of the policy.
    pub acting: ActionMode,
    /// Seed of the initial state and of sampled actions.
    pub seed: u64,
    /// Environment steps of the run's snapshot that acts; `None` for the newest weights.
    pub snapshot: Option<u64>,
    /// What somebody outside does to the blocks, by the steps from 0.
    pub disturbances: Vec<(u16, Disturbance)>,
}

/// Why no episode is returned.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum StageError {
    /// No weights have arrived yet.
    #[error("no weights came yet; ask again in a moment, or let the expert build")]
    NoWeights,
    /// The run has no such snapshot, or not any longer.
    #[error("there is no snapshot after {0} environment steps: /api/snapshots lists them")]
    NoSnapshot(u64),
    /// The requester has disconnected.
    #[error("the episode is no longer wanted")]
    Unwanted,
    /// The episode cannot be played.
    #[error("the episode cannot be played: {0}")]
    Failed(String),
}

/// Plays an episode. The second argument is called at every step and returns whether the episode is still wanted.
type Play = dyn Fn(&Order, &(dyn Fn() -> bool + Sync)) -> Result<Trajectory, StageError> + Send + Sync;

/// Plays episodes, one at a time.
#[derive(Clone)]
pub struct Stage {
    play: Arc<Play>,
    /// The run whose snapshots can act.
    run: Option<RunPaths>,
    turn: Arc<Semaphore>,
    /// The episode that every browser requests first, and its response.
    opening: Arc<Mutex<Option<(Order, Bytes)>>>,
}

impl fmt::Debug for Stage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Stage")
    }
}

impl Stage {
    /// Creates a stage that plays episodes, also with snapshots of `run`, with `play`, which is called on blocking
    /// threads.
    pub fn new(
        run: Option<RunPaths>,
        play: impl Fn(&Order, &(dyn Fn() -> bool + Sync)) -> Result<Trajectory, StageError> + Send + Sync + 'static,
    ) -> Self {
        Self { play: Arc::new(play), run, turn: Arc::new(Semaphore::new(1)), opening: Arc::default() }
    }

    /// Plays the episode that the page opens with, so that it is ready when a browser requests it.
    pub(super) async fn open_with(&self, blueprint: Blueprint, replays: Arc<Replays>) {
        let order = Wishes::default().of(blueprint, Vec::new());
        let answer = perform(self.clone(), order, Form::Replay(replays), true).await;
        tracing::debug!(status = %answer.status(), "played the first episode");
    }
}

/// Parameters of a request: everything about an order but its goals.
#[derive(Debug, Default)]
struct Wishes<'q> {
    id: Option<&'q str>,
    before: Vec<&'q str>,
    builder: Builder,
    acting: ActionMode,
    seed: u64,
    snapshot: Option<u64>,
    disturbances: Vec<(u16, Disturbance)>,
}

impl<'q> Wishes<'q> {
    /// Parses `blueprint=…&after=…,…&agent=policy|expert&mode=greedy|sampled&seed=…&snapshot=…&disturb=…`. All
    /// parameters are optional.
    fn parse(query: &'q str) -> Result<Self, String> {
        let mut wishes = Self::default();
        for pair in query.split('&').filter(|pair| !pair.is_empty()) {
            match pair.split_once('=') {
                Some(("blueprint", value)) => wishes.id = Some(value),
                Some(("after", value)) => wishes.before = value.split(',').collect(),
                Some(("agent", "policy")) => wishes.builder = Builder::Policy,
                Some(("agent", "expert")) => wishes.builder = Builder::Expert,
                Some(("mode", "greedy")) => wishes.acting = ActionMode::Greedy,
                Some(("mode", "sampled")) => wishes.acting = ActionMode::Sampled,
                Some(("seed", value)) => wishes.seed = number("seed", value)?,
                Some(("snapshot", value)) => wishes.snapshot = Some(number("snapshot", value)?),
                Some(("disturb", value)) => wishes.disturbances = disturbances(value)?,
                Some((key @ ("agent" | "mode"), value)) => {
                    let known = if key == "agent" { "policy or expert" } else { "greedy or sampled" };
                    return Err(format!("{key}={value} is not known: use {known}"));
                }
                _ => return Err(format!("`{pair}` is not known: use {KEYS}")),
            }
        }
        Ok(wishes)
    }

    /// Looks up the goals before this one in the catalog.
    fn before(&self, catalog: &Catalog) -> Result<Vec<Blueprint>, String> {
        if self.before.len() >= MAX_IN_A_ROW {
            return Err(format!("after={} names more than {} goals", self.before.join(","), MAX_IN_A_ROW - 1));
        }
        self.before.iter().map(|id| known(id, catalog)).collect()
    }

    fn of(self, blueprint: Blueprint, before: Vec<Blueprint>) -> Order {
        let Self { builder, acting, seed, snapshot, disturbances, .. } = self;
        Order { blueprint, before, builder, acting, seed, snapshot, disturbances }
    }
}

/// Parses `STEP,BLOCK,X,Y,Z,VX,VY,VZ`, or several joined by `_`: a block is moved by meters and pushed by meters per
/// second.
fn disturbances(text: &str) -> Result<Vec<(u16, Disturbance)>, String> {
    let one = |part: &str| {
        let unknown = || format!("disturb={part}: expected step, block, 3 meters, 3 meters per second");
        let parts: Vec<_> = part.split(',').collect();
        let &[step, block, ref rest @ ..] = &parts[..] else { return Err(unknown()) };
        let step =
            step.parse::<u16>().ok().filter(|step| usize::from(*step) < MAX_SEGMENT_STEPS).ok_or_else(unknown)?;
        let block = block.parse::<u8>().ok().and_then(|block| BlockIdx::try_from(block).ok()).ok_or_else(unknown)?;
        let numbers = rest.iter().map(|number| number.parse().ok()).collect::<Option<Vec<f32>>>();
        let numbers = numbers.ok_or_else(unknown)?;
        let &[x, y, z, vx, vy, vz] = &numbers[..] else { return Err(unknown()) };
        let disturbance = Disturbance::new(block, [x, y, z], [vx, vy, vz]);
        disturbance.map(|disturbance| (step, disturbance)).map_err(|error| format!("disturb={part}: {error}"))
    };
    let all = text.split('_').map(one).collect::<Result<Vec<_>, _>>()?;
    if all.len() > MAX_DISTURBANCES || !all.is_sorted_by(|(a, _), (b, _)| a < b) {
        return Err(format!("disturb={text}: expected at most {MAX_DISTURBANCES} steps, in rising order, each once"));
    }
    Ok(all)
}

fn number(key: &str, value: &str) -> Result<u64, String> {
    value.parse().map_err(|_| format!("{key}={value} is no number"))
}

/// Returns the blueprint, or an error message about its id.
fn known(id: &str, catalog: &Catalog) -> Result<Blueprint, String> {
    let unknown = || format!("there is no blueprint `{id}`: /api/blueprints lists them");
    let id: BlueprintId = id.parse().map_err(|_| unknown())?;
    catalog.get(&id).cloned().ok_or_else(unknown)
}

impl Order {
    /// Parses a query whose goal is in the catalog.
    fn named(query: &str, catalog: &Catalog) -> Result<Self, String> {
        let wishes = Wishes::parse(query)?;
        let id = wishes.id.ok_or_else(|| "blueprint=… is missing".to_owned())?;
        let blueprint = known(id, catalog)?;
        let before = wishes.before(catalog)?;
        Ok(wishes.of(blueprint, before))
    }

    /// Parses a query whose goal is a blueprint file. Takes up to a second.
    fn drawn(query: &str, file: &[u8]) -> Result<Self, String> {
        let wishes = Wishes::parse(query)?;
        if wishes.id.is_some() {
            return Err("the blueprint is in the body, so that the query must not name one".to_owned());
        }
        if !wishes.before.is_empty() {
            return Err(
                "a drawing begins with scattered blocks, so that the query must not name goals before".to_owned()
            );
        }
        let text = std::str::from_utf8(file).map_err(|_| "the blueprint is not text".to_owned())?;
        let blueprint = check_text("drawing", text).blueprint.map_err(|error| error.error.to_string())?;
        Ok(wishes.of(blueprint, Vec::new()))
    }
}

/// Plays the episode that the query describes, of a blueprint file or else of a goal of the catalog.
pub(super) async fn play(stage: Stage, catalog: Arc<Catalog>, uri: Uri, file: Option<Bytes>, form: Form) -> Response {
    // The check of a file waits for its turn like an episode, and finishes even if its browser disconnects.
    let turn = if file.is_some() { stage.turn.clone().acquire_owned().await.ok() } else { None };
    let order = tokio::task::spawn_blocking(move || {
        let query = uri.query().unwrap_or_default();
        let _turn = turn;
        file.map_or_else(|| Order::named(query, &catalog), |file| Order::drawn(query, &file))
    });
    match order.await {
        Ok(Ok(order)) => perform(stage, order, form, false).await,
        Ok(Err(reason)) => refused(reason),
        Err(_) => StatusCode::INTERNAL_SERVER_ERROR.into_response(),
    }
}

/// Lists the snapshots by their environment steps, as JSON.
pub(super) fn snapshots(stage: Option<&Stage>) -> String {
    let run = stage.and_then(|stage| stage.run.as_ref());
    let all = run.map(|run| run.snapshots().into_keys().collect::<Vec<_>>()).unwrap_or_default();
    json!({ "schema_version": 1, "snapshots": all }).to_string()
}

fn refused(reason: String) -> Response {
    (StatusCode::BAD_REQUEST, reason + "\n").into_response()
}

/// What an episode is returned as.
pub(super) enum Form {
    /// The format of `/api/replay`.
    Replay(Arc<Replays>),
    /// MP4.
    Video,
}

impl Form {
    /// Returns the episode in this form; `None` if there is nothing to show.
    fn of(&self, episode: Trajectory, goal: &Blueprint) -> Option<Bytes> {
        match self {
            Self::Replay(replays) => replays.show(&episode, goal),
            Self::Video => {
                let episode = Episode::new(&episode, goal).ok()?;
                mp4(Video::new(&episode, VIDEO_PX).frames(VIDEO_FPS), VIDEO_FPS).ok().map(Bytes::from)
            }
        }
    }
}

/// Waits for the stage and plays the order; stops if the browser disconnects. Keeps the response if it `opens` the
/// page.
async fn perform(stage: Stage, order: Order, form: Form, opens: bool) -> Response {
    let Ok(_turn) = stage.turn.acquire().await else { return StatusCode::INTERNAL_SERVER_ERROR.into_response() };
    let content_type = if matches!(form, Form::Video) { "video/mp4" } else { "application/json" };
    let shown = |bytes: Bytes| ([(CONTENT_TYPE, content_type)], bytes).into_response();
    let opening = stage.opening.lock().clone().filter(|_| matches!(form, Form::Replay(_)));
    if let Some((_, json)) = opening.filter(|(first, _)| *first == order) {
        return shown(json);
    }
    let unwanted = CancellationToken::new();
    let _dropped_with_the_request = unwanted.clone().drop_guard();
    let play = stage.play.clone();
    let answer = tokio::task::spawn_blocking(move || {
        let episode = play(&order, &|| !unwanted.is_cancelled())?;
        let bytes = form.of(episode, &order.blueprint);
        Ok((order, bytes.ok_or_else(|| StageError::Failed("it has nothing to show".to_owned()))?))
    });
    match answer.await {
        Ok(Ok((order, bytes))) => {
            if opens {
                *stage.opening.lock() = Some((order, bytes.clone()));
            }
            shown(bytes)
        }
        Ok(Err(error @ StageError::NoWeights)) => {
            (StatusCode::SERVICE_UNAVAILABLE, [(RETRY_AFTER, "1")], format!("{error}\n")).into_response()
        }
        Ok(Err(error @ StageError::NoSnapshot(_))) => refused(error.to_string()),
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
        let catalog = Catalog::builtin();
        let order = Order::named("blueprint=2_000&agent=expert&mode=sampled&seed=7", catalog).unwrap();
        assert_eq!((order.blueprint.id().as_str(), order.builder), ("2_000", Builder::Expert));
        assert_eq!((order.acting, order.seed), (ActionMode::Sampled, 7));
        let plain = Order::named("blueprint=2_000", catalog).unwrap();
        assert_eq!((plain.builder, plain.acting, plain.seed), (Builder::Policy, ActionMode::Greedy, 0));
        assert_eq!((plain.snapshot, plain.disturbances.len()), (None, 0));
        let disturbed = Order::named("blueprint=2_000&disturb=4,3,0.5,0,0.25,0,0,0_9,0,0,0,0,1,-2,0", catalog).unwrap();
        let [moved, pushed] = [(3, [0.5, 0.0, 0.25], [0.0; 3]), (0, [0.0; 3], [1.0, -2.0, 0.0])]
            .map(|(block, by, push)| Disturbance::new(BlockIdx::try_from(block).unwrap(), by, push).unwrap());
        assert_eq!(disturbed.disturbances, [(4, moved), (9, pushed)]);
        assert_eq!(Order::named("blueprint=2_000&snapshot=0", catalog).unwrap().snapshot, Some(0));
        let third = Order::named("blueprint=2_000&after=2_001,2_000", catalog).unwrap();
        assert_eq!(third.before.iter().map(|goal| goal.id().as_str()).collect::<Vec<_>>(), ["2_001", "2_000"]);
        assert_eq!(Order::named("", catalog).unwrap_err(), "blueprint=… is missing");
        let many = format!("after={}", ["2_000"; MAX_IN_A_ROW].join(","));
        let often: Vec<String> = (0..17).map(|step| format!("{step},0,1,0,0,0,0,0")).collect();
        let often = format!("disturb={}", often.join("_"));
        for (query, words) in [
            ("blueprint=../etc", "no blueprint `../etc`"),
            ("blueprint=99_999", "no blueprint `99_999`"),
            ("seed=-1", "seed=-1"),
            ("after=2_001,", "no blueprint ``"),
            (&many, "more than 9 goals"),
            ("agent=me", "agent=me is not known: use policy or expert"),
            ("mode=", "mode= is not known: use greedy or sampled"),
            ("speed=2", "`speed=2` is not known: use blueprint, after, agent, mode, seed, snapshot and"),
            ("snapshot=last", "snapshot=last is no number"),
            ("disturb=4,3,1,0,0,0,0", "disturb=4,3,1,0,0,0,0: expected step, block, 3 meters"),
            ("disturb=4,3,1,0,0,0,0,0_", "disturb=: expected step"),
            ("disturb=1000,3,1,0,0,0,0,0", "disturb=1000,3"),
            ("disturb=4,16,1,0,0,0,0,0", "disturb=4,16"),
            ("disturb=4,3,nan,0,0,0,0,0", "moved by [NaN, 0.0, 0.0] m and pushed by [0.0, 0.0, 0.0] m/s"),
            ("disturb=4,3,0,0,0,0,6,0", "but the most along an axis is 2 m and 5 m/s"),
            ("disturb=4,3,1,0,0,0,0,0_4,2,1,0,0,0,0,0", "in rising order, each once"),
            (&often, "at most 16 steps"),
        ] {
            let reason = Order::named(&format!("blueprint=2_000&{query}"), catalog).unwrap_err();
            assert!(reason.contains(words), "{query}: {reason}");
        }
    }

    #[tokio::test]
    async fn snapshots_are_listed_and_one_that_is_not_there_is_the_askers_mistake() {
        let dir = tempfile::tempdir().unwrap();
        let run = RunPaths::new(dir.path());
        std::fs::create_dir(run.snapshot_folder()).unwrap();
        for name in ["77.safetensors", "5.safetensors", ".X.part", "077.safetensors"] {
            std::fs::write(run.snapshot_folder().join(name), "").unwrap();
        }
        let stage = Stage::new(Some(run), |order, _| Err(StageError::NoSnapshot(order.snapshot.unwrap())));
        let text = async |answer: Response| axum::body::to_bytes(answer.into_body(), 1000).await.unwrap();
        assert_eq!(snapshots(Some(&stage)), "{\"schema_version\":1,\"snapshots\":[5,77]}");
        let order = Order::named("blueprint=2_000&snapshot=6", Catalog::builtin()).unwrap();
        let answer = perform(stage, order, Form::Video, false).await;
        assert_eq!(answer.status(), StatusCode::BAD_REQUEST);
        assert!(text(answer).await.starts_with(b"there is no snapshot after 6 environment steps"));
    }

    #[test]
    fn a_drawn_goal_is_checked_like_any_file() {
        let file = Catalog::builtin().get(&"2_000".parse().unwrap()).unwrap().to_toml("a test");
        let order = Order::drawn("agent=expert&seed=7", file.as_bytes()).unwrap();
        assert_eq!((order.blueprint.n_blocks(), order.builder, order.seed), (2, Builder::Expert, 7));
        for (query, file, words) in [
            ("blueprint=2_000", file.as_bytes(), "must not name one"),
            ("after=2_000", file.as_bytes(), "must not name goals before"),
            ("agent=me", file.as_bytes(), "agent=me is not known: use policy or expert"),
            ("", b"\xff", "not text"),
            ("", b"{}", "line 1"),
            ("", file.replace("1x1x1", "9x9x9").as_bytes(), "unknown type"),
            ("", file.replace("[0, 0, 1]", "[0, 0, 999]").as_bytes(), "outside -64..=64"),
        ] {
            let reason = Order::drawn(query, file).unwrap_err();
            assert!(reason.contains(words), "{reason}");
        }
    }
}
