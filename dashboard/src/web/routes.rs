//! Endpoints and access control. Every route is fixed: no part of a request is ever used as a file path.

use proto::Valid;
use std::sync::Arc;

use axum::Router;
use axum::body::{Body, Bytes};
use axum::extract::{DefaultBodyLimit, Extension, RawQuery, Request, State};
use axum::http::header::{
    ACCEPT, AUTHORIZATION, CACHE_CONTROL, CONTENT_LENGTH, CONTENT_SECURITY_POLICY, CONTENT_TYPE, COOKIE, HOST,
    LOCATION, ORIGIN, REFERRER_POLICY, RETRY_AFTER, SET_COOKIE, TRANSFER_ENCODING, X_CONTENT_TYPE_OPTIONS,
    X_FRAME_OPTIONS,
};
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode, Uri};
use axum::middleware::{Next, from_fn_with_state};
use axum::response::{Html, IntoResponse, Response};
use axum::routing::{MethodRouter, get, post};
use serde_json::{Value, json};
use tokio::sync::Semaphore;

use super::about::{About, Kind, about, base};
use super::assets;
use super::board::Board;
use super::drawing::{self, OneCheck};
use super::events::Places;
use super::gallery::{self, Gallery};
use super::prometheus;
use super::query::id_of;
use super::replay::Replays;
use super::server::Connection;
use super::stage::{self, Form, Stage};
use super::videos::Videos;
use crate::config::{Token, WebConfig};

/// Beginning of the name of the cookie that holds the token. The rest depends on the token: browsers send the cookies of
/// a host to all its ports, so one name would let the page of another run overwrite it.
const COOKIE_NAME: &str = "lodestone_token";

/// Headers of every response. Only the page's own files are loaded or run, no other site may frame the page, and links
/// do not send a referrer, which could contain a token.
const HEADERS: [(HeaderName, &str); 5] = [
    (CONTENT_SECURITY_POLICY, "default-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"),
    (X_CONTENT_TYPE_OPTIONS, "nosniff"),
    (X_FRAME_OPTIONS, "DENY"),
    (REFERRER_POLICY, "no-referrer"),
    (CACHE_CONTROL, "no-store"),
];

/// A run shown on the page.
pub(super) struct Shown {
    pub(super) about: About,
    pub(super) board: Arc<Board>,
    pub(super) replays: Arc<Replays>,
    pub(super) videos: Videos,
    pub(super) stage: Option<Stage>,
}

/// Builds the routes. All but the two for probes require the token of `config` or, without a token, a host name that is
/// this machine's or in `hosts`. Of several runs, the first is at the root and run `i` is below `/runs/<i>`; `sweep` is
/// what they belong to. Listening browsers take `places`.
pub(super) fn routes(
    first: Shown,
    others: Vec<Shown>,
    sweep: Option<Value>,
    places: Places,
    config: Valid<WebConfig>,
) -> Router {
    let board = first.board.clone();
    let guard = Arc::new(Guard { board: board.clone(), token: config.token.clone(), hosts: config.hosts.clone() });
    let opens = first.about.kind == Kind::Play;
    // The gallery shows the goals of the first run.
    let catalog = first.about.catalog.clone();
    let names = std::iter::once(&first).chain(&others).map(|run| run.about.run.clone()).collect::<Vec<_>>();
    let mut guarded = of_run(first, &names, sweep.is_some());
    for (place, run) in others.into_iter().enumerate() {
        guarded = guarded.nest(&base(place + 1), of_run(run, &names, sweep.is_some()));
    }
    if let Some(sweep) = sweep {
        guarded = guarded.route("/api/sweep", answer_with(&sweep));
    }
    guarded = guarded
        .route("/api/blueprints", answer_with(&gallery::list(&catalog)))
        .route("/api/picture", get(gallery::picture))
        .route("/api/blueprint", get(drawing::file))
        .route("/api/inventory", answer_with(&drawing::inventory()))
        .route("/api/check", post(drawing::check));
    for asset in assets::all() {
        guarded = guarded.route(asset.0, assets::route(asset, opens));
    }
    guarded
        .fallback(StatusCode::NOT_FOUND)
        .layer(Extension(Arc::new(Gallery::default())))
        .layer(Extension(catalog))
        .layer(Extension(places))
        .layer(Extension(OneCheck(Arc::new(Semaphore::new(1)))))
        .layer(DefaultBodyLimit::max(drawing::MAX_BYTES))
        .layer(from_fn_with_state(guard.clone(), authorize))
        .merge(
            Router::new()
                .route("/healthz", get(|| async { "serving\n" }))
                .route("/readyz", get(ready))
                .with_state(board),
        )
        .layer(from_fn_with_state(guard, set_headers))
}

/// Serves JSON that does not change.
fn answer_with<S: Clone + Send + Sync + 'static>(json: &Value) -> MethodRouter<S> {
    let answer = Bytes::from(json.to_string());
    get(move || std::future::ready(([(CONTENT_TYPE, "application/json")], answer.clone())))
}

/// Builds the endpoints of one run.
fn of_run(run: Shown, names: &[String], is_of_sweep: bool) -> Router {
    let about = about(&run.about, run.stage.is_some(), names, is_of_sweep);
    Router::new()
        .route("/api/about", answer_with(&about))
        .route("/api/history", get(history))
        .route("/api/events", get(events))
        .route("/api/play", get(play).post(play))
        .route("/api/play.mp4", get(play).post(play))
        .route("/api/snapshots", get(snapshots))
        .route("/api/replay", get(replay))
        .route("/api/recording", get(recording))
        .route("/api/videos", get(list_videos))
        .route("/api/video", get(video))
        .route("/api/poster", get(poster))
        .route("/metrics", get(metrics))
        .with_state(Arc::new(run))
}

async fn ready(State(board): State<Arc<Board>>) -> (StatusCode, &'static str) {
    if board.is_ready() {
        (StatusCode::OK, "ready\n")
    } else {
        (StatusCode::SERVICE_UNAVAILABLE, "nothing was evaluated or measured yet\n")
    }
}

async fn history(State(run): State<Arc<Shown>>) -> Response {
    found("application/json", run.board.history().map(Some))
}

async fn metrics(State(run): State<Arc<Shown>>) -> Response {
    found(prometheus::CONTENT_TYPE, prometheus::text(&run.board.state(), &run.about.run).map(Some))
}

async fn list_videos(State(run): State<Arc<Shown>>) -> Response {
    // Off the runtime, because this blocks on disk reads. The same applies below.
    let list = move || Some(json!({ "schema_version": 1, "videos": run.videos.list() }).to_string());
    found("application/json", tokio::task::spawn_blocking(list).await)
}

/// Returns the video named in the query.
async fn video(State(run): State<Arc<Shown>>, RawQuery(query): RawQuery) -> Response {
    found("video/mp4", tokio::task::spawn_blocking(move || run.videos.bytes(&id_of(query))).await)
}

/// Returns the last scene of the video named in the query.
async fn poster(State(run): State<Arc<Shown>>, RawQuery(query): RawQuery) -> Response {
    let poster = move || run.videos.poster(&run.about.catalog, &id_of(query));
    found("image/png", tokio::task::spawn_blocking(poster).await)
}

/// Returns the episode of the video named in the query, in the format of [`replay`].
async fn recording(State(run): State<Arc<Shown>>, RawQuery(query): RawQuery) -> Response {
    let recording = move || run.replays.show_known(&run.videos.recording(&id_of(query))?);
    found("application/json", tokio::task::spawn_blocking(recording).await)
}

async fn snapshots(State(run): State<Arc<Shown>>) -> Response {
    let list = move || Some(stage::snapshots(run.stage.as_ref()));
    found("application/json", tokio::task::spawn_blocking(list).await)
}

/// Plays an episode. Returns it in the format of [`replay`], or as a video if the path ends like one.
async fn play(State(run): State<Arc<Shown>>, method: Method, uri: Uri, file: Bytes) -> Response {
    let Some(stage) = run.stage.clone() else {
        return (StatusCode::NOT_FOUND, "nothing is played here\n").into_response();
    };
    let form = if uri.path().ends_with(".mp4") { Form::Video } else { Form::Replay(run.replays.clone()) };
    let file = (method == Method::POST).then_some(file);
    stage::play(stage, run.about.catalog.clone(), uri, file, form).await
}

/// Returns the bytes that were found, 404 if there are none, or 500 after an error, such as a panic of a blocking task.
fn found(content_type: &'static str, answer: Result<Option<impl Into<Bytes>>, impl std::error::Error>) -> Response {
    match answer {
        Ok(Some(bytes)) => ([(CONTENT_TYPE, content_type)], bytes.into()).into_response(),
        Ok(None) => StatusCode::NOT_FOUND.into_response(),
        Err(error) => {
            tracing::warn!(%error, "the page could not be answered");
            StatusCode::INTERNAL_SERVER_ERROR.into_response()
        }
    }
}

async fn events(
    State(run): State<Arc<Shown>>,
    Extension(connection): Extension<Connection>,
    Extension(places): Extension<Places>,
) -> Response {
    let Some(place) = places.take() else {
        return (StatusCode::SERVICE_UNAVAILABLE, [(RETRY_AFTER, "10")], "too many browsers listen\n").into_response();
    };
    connection.lasts();
    let events = run.board.listen(connection.close.clone(), place);
    ([(CONTENT_TYPE, "text/event-stream")], Body::new(events)).into_response()
}

/// Returns the newest episode, or 202 while there is none. Each request also triggers the recording of a newer one.
async fn replay(State(run): State<Arc<Shown>>) -> Response {
    match run.replays.ask() {
        Some(json) => ([(CONTENT_TYPE, "application/json")], json).into_response(),
        None => (StatusCode::ACCEPTED, [(RETRY_AFTER, "2")], "an episode is being recorded\n").into_response(),
    }
}

/// Paths of endpoints that read a body: a drawing.
const WITH_BODY: [&str; 3] = ["/api/check", "/api/play", "/api/play.mp4"];

/// Sets the headers of every response. Rejects requests with a body that no endpoint reads, and those whose host is
/// ambiguous.
async fn set_headers(State(guard): State<Arc<Guard>>, request: Request, next: Next) -> Response {
    let headers = request.headers();
    let has_body = headers.contains_key(TRANSFER_ENCODING)
        || headers.get(CONTENT_LENGTH).is_some_and(|length| length.as_bytes() != b"0");
    let is_read = request.method() == Method::POST && WITH_BODY.iter().any(|path| request.uri().path().ends_with(path));
    let mut response = if names_two_hosts(&request) {
        guard.refuse(headers, StatusCode::BAD_REQUEST, "a request names one host, once\n")
    } else if has_body && !is_read {
        StatusCode::PAYLOAD_TOO_LARGE.into_response()
    } else {
        next.run(request).await
    };
    for (name, value) in HEADERS {
        // Immutable responses have set their own cache lifetime.
        response.headers_mut().entry(name).or_insert(HeaderValue::from_static(value));
    }
    response
}

/// Returns whether the request has several `Host` headers, or a target with another host than its `Host` header. A proxy
/// and this page could each go by another one.
fn names_two_hosts(request: &Request) -> bool {
    let mut hosts = request.headers().get_all(HOST).iter().map(HeaderValue::as_bytes);
    let first = hosts.next();
    let is_single = hosts.next().is_none();
    let is_same = |named: &str| first.is_some_and(|host| host.eq_ignore_ascii_case(named.as_bytes()));
    !is_single || request.uri().authority().is_some_and(|named| !is_same(named.as_str()))
}

struct Guard {
    board: Arc<Board>,
    token: Option<Token>,
    hosts: Vec<String>,
}

impl Guard {
    fn refuse(&self, asked: &HeaderMap, status: StatusCode, reason: &'static str) -> Response {
        self.board.state().counts.request_refused_total += 1;
        if values(asked, ACCEPT).all(|types| !types.contains("text/html")) {
            return (status, reason).into_response();
        }
        // Without a viewport, a phone shows text as on a large screen, tiny.
        let head = r#"<!doctype html><html lang="en"><meta name="viewport" content="width=device-width"><title>Lodestone</title>"#;
        (status, Html(format!("{head}<p>{reason}"))).into_response()
    }
}

async fn authorize(State(guard): State<Arc<Guard>>, request: Request, next: Next) -> Response {
    let Some(token) = &guard.token else {
        // Protects against DNS rebinding: a foreign site may resolve its own name to 127.0.0.1, but the `Host` header
        // reveals it.
        let refusal = if !is_for_us(request.headers(), &guard.hosts) {
            "without a token the page answers to 127.0.0.1, localhost and web.hosts only\n"
        } else if Asker::of(&request).is_another_site() {
            "without a token the page does not answer to other sites\n"
        } else {
            return next.run(request).await;
        };
        return guard.refuse(request.headers(), StatusCode::FORBIDDEN, refusal);
    };
    let in_query = request.uri().query().into_iter().flat_map(|query| query.split('&'));
    let (tokens, others): (Vec<&str>, Vec<&str>) = in_query.partition(|pair| pair.starts_with("token="));
    if tokens.iter().filter_map(|pair| pair.strip_prefix("token=")).any(|guess| token.is(guess)) {
        return keep_in_cookie(token, request.uri().path(), &others.join("&"));
    }
    if is_in_header(token, request.headers()) {
        return next.run(request).await;
    }
    if !is_in_cookie(token, request.headers()) {
        let how = "open the page with ?token=…, or send Authorization: Bearer …\n";
        return guard.refuse(request.headers(), StatusCode::UNAUTHORIZED, how);
    }
    // A browser adds the cookie by itself, also for another page of this host on another port.
    if Asker::of(&request).uses_the_cookie() {
        let reason = "a cookie does not let other sites use the page\n";
        return guard.refuse(request.headers(), StatusCode::FORBIDDEN, reason);
    }
    next.run(request).await
}

/// Redirects to the same path and the rest of the query without the token, which would otherwise stay in the browser's
/// history.
fn keep_in_cookie(token: &Token, path: &str, query: &str) -> Response {
    // `Lax`, because `Strict` would reject a first visit through a link from another site.
    let token = token.reveal();
    let of_token = proto::config_hash(&token);
    let cookie = format!("{COOKIE_NAME}_{of_token:016x}={token}; Path=/; HttpOnly; SameSite=Lax");
    // Keep one leading slash: with two, the path would name another host.
    let path = format!("/{}{}{query}", path.trim_start_matches('/'), if query.is_empty() { "" } else { "?" });
    match (HeaderValue::from_str(&path), HeaderValue::from_str(&cookie)) {
        (Ok(path), Ok(cookie)) => (StatusCode::SEE_OTHER, [(LOCATION, path), (SET_COOKIE, cookie)]).into_response(),
        _ => StatusCode::BAD_REQUEST.into_response(),
    }
}

/// Returns the values of a header as text; empty where they are none.
fn values(headers: &HeaderMap, name: HeaderName) -> impl Iterator<Item = &str> {
    headers.get_all(name).iter().map(|value| value.to_str().unwrap_or_default())
}

fn is_in_header(token: &Token, headers: &HeaderMap) -> bool {
    values(headers, AUTHORIZATION).any(|value| value.strip_prefix("Bearer ").is_some_and(|guess| token.is(guess)))
}

fn is_in_cookie(token: &Token, headers: &HeaderMap) -> bool {
    let mut pairs =
        values(headers, COOKIE).flat_map(|value| value.split(';')).filter_map(|pair| pair.trim().split_once('='));
    pairs.any(|(name, guess)| name.starts_with(COOKIE_NAME) && token.is(guess))
}

/// Headers in which a browser says how the site that asks relates to the one that it asks, and what it asks for.
const SEC_FETCH_SITE: HeaderName = HeaderName::from_static("sec-fetch-site");
const SEC_FETCH_DEST: HeaderName = HeaderName::from_static("sec-fetch-dest");

/// What a browser says about the site on whose behalf it sends a request, which could keep this process busy. `None`
/// where it says nothing; a link to the page is no request of another site.
struct Asker {
    /// Whether `Sec-Fetch-Site` names another site. Browsers send it to this machine and to encrypted pages only.
    by_fetch: Option<bool>,
    /// Whether `Origin` is another host or port than `Host`. Browsers leave it out of most of their GET requests.
    by_origin: Option<bool>,
}

impl Asker {
    fn of(request: &Request) -> Self {
        let headers = request.headers();
        let is_visit = request.method() == Method::GET && values(headers, SEC_FETCH_DEST).eq(["document"]);
        let is_foreign = |site: &str| !is_visit && !matches!(site, "same-origin" | "none");
        let host = values(headers, HOST).next().unwrap_or_default();
        let is_elsewhere = |origin: &str| {
            let named = origin.strip_prefix("http://").or_else(|| origin.strip_prefix("https://"));
            !named.is_some_and(|named| named.eq_ignore_ascii_case(host))
        };
        Self {
            by_fetch: values(headers, SEC_FETCH_SITE).map(is_foreign).reduce(|a, b| a || b),
            by_origin: values(headers, ORIGIN).map(is_elsewhere).reduce(|a, b| a || b),
        }
    }

    /// Returns whether either header names another site.
    fn is_another_site(&self) -> bool {
        self.by_fetch == Some(true) || self.by_origin == Some(true)
    }

    /// Returns whether another site makes use of the browser's cookie. `Sec-Fetch-Site` decides where there is one,
    /// because a proxy in front of the page may put its own name into `Host`.
    fn uses_the_cookie(&self) -> bool {
        self.by_fetch.or(self.by_origin) == Some(true)
    }
}

/// Returns whether the request addresses `localhost`, a loopback address or one of `hosts`, with any port.
fn is_for_us(headers: &HeaderMap, hosts: &[String]) -> bool {
    let Some(host) = headers.get(HOST).and_then(|host| host.to_str().ok()) else { return false };
    let name = match host.rsplit_once(':') {
        Some((name, port)) if port.bytes().all(|c| c.is_ascii_digit()) => name,
        _ => host,
    };
    let address = name.trim_start_matches('[').trim_end_matches(']');
    name.eq_ignore_ascii_case("localhost")
        || hosts.iter().any(|known| name.eq_ignore_ascii_case(known))
        || address.parse().is_ok_and(|ip: std::net::IpAddr| ip.is_loopback())
}
