//! HTTP connections, with limits on their number, their duration and the size of a request.

use std::convert::Infallible;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use axum::Router;
use axum::body::Body;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::{Service, service_fn};
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::net::{TcpListener, TcpStream};
use tokio::task::JoinSet;
use tokio_util::sync::CancellationToken;

use super::board::Board;

/// Maximum number of open connections; up to [`MAX_VIEWERS`](super::events::MAX_VIEWERS) of them may be event streams.
pub(super) const MAX_CONNECTIONS: usize = 64;

/// Time limit for sending the head of a request.
const HEAD_TIMEOUT: Duration = Duration::from_secs(10);

/// Time limit for a whole request, except for event streams.
const REQUEST_TIMEOUT: Duration = Duration::from_secs(30);

/// Maximum size in bytes and number of headers of a request head. Larger requests receive a 431 response.
const MAX_HEAD_BYTES: usize = 16 << 10;
const MAX_HEADERS: usize = 64;

/// Pause after a failed `accept`, for example because the process has run out of file descriptors.
const ACCEPT_REST: Duration = Duration::from_millis(200);

/// The connection of a request.
#[derive(Clone, Debug, Default)]
pub(super) struct Connection {
    /// Closes the connection.
    pub(super) close: CancellationToken,
    is_lasting: Arc<AtomicBool>,
}

impl Connection {
    /// Marks the connection as an endless stream, exempt from [`REQUEST_TIMEOUT`].
    pub(super) fn lasts(&self) {
        self.is_lasting.store(true, Ordering::Relaxed);
    }
}

/// Serves requests until `shutdown`, then closes all connections.
pub(super) async fn serve(listener: TcpListener, routes: Router, board: Arc<Board>, shutdown: CancellationToken) {
    let mut connections = JoinSet::new();
    loop {
        let accepted = tokio::select! {
            () = shutdown.cancelled() => break,
            Some(_) = connections.join_next() => continue,
            accepted = listener.accept() => accepted,
        };
        match accepted {
            Ok((stream, _)) if connections.len() < MAX_CONNECTIONS => {
                connections.spawn(answer(stream, routes.clone(), board.clone()));
            }
            Ok(_) => board.state().counts.connections_refused_total += 1,
            Err(error) => {
                tracing::debug!(%error, "a connection to the page was not accepted");
                board.state().counts.connections_refused_total += 1;
                tokio::time::sleep(ACCEPT_REST).await;
            }
        }
    }
    connections.shutdown().await;
}

/// Serves one request on a connection, which then either ends soon or is an event stream.
async fn answer(stream: TcpStream, routes: Router, board: Arc<Board>) {
    let connection = Connection::default();
    let (routes, of_request) = (TowerToHyperService::new(routes), connection.clone());
    let service = service_fn(move |request: hyper::Request<Incoming>| {
        let mut request = request.map(Body::new);
        request.extensions_mut().insert(of_request.clone());
        let answered = routes.call(request);
        async move { Ok::<_, Infallible>(answered.await.unwrap_or_else(|never| match never {})) }
    });
    let talk = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(HEAD_TIMEOUT)
        .max_buf_size(MAX_HEAD_BYTES)
        .max_headers(MAX_HEADERS)
        .keep_alive(false)
        .serve_connection(TokioIo::new(stream), service);
    let time_is_up = async {
        tokio::time::sleep(REQUEST_TIMEOUT).await;
        if connection.is_lasting.load(Ordering::Relaxed) {
            std::future::pending::<()>().await;
        }
    };
    tokio::select! {
        done = talk => if let Err(error) = done {
            tracing::trace!(%error, "a connection to the page ended early");
        },
        () = connection.close.cancelled() => {}
        () = time_is_up => board.state().counts.connections_expired_total += 1,
    }
}
