//! HTTP connections, with limits on their number, their duration and the size of a request.

use std::convert::Infallible;
use std::sync::{Arc, Weak};
use std::time::Duration;

use axum::Router;
use axum::body::Body;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::{Service, service_fn};
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use parking_lot::Mutex;
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

/// A connection, shared with the request on it.
#[derive(Clone, Debug, Default)]
pub(super) struct Connection {
    /// Closes the connection.
    pub(super) close: CancellationToken,
    progress: Arc<Mutex<Progress>>,
}

/// How far a connection has come. There are no idle ones, because each serves one request.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Progress {
    /// The head of the request has not arrived in full.
    #[default]
    Silent,
    /// The request has not been answered in full: its body comes slowly, the answer takes time or is read slowly.
    Asked,
    /// The answer is an endless stream.
    Lasting,
}

impl Connection {
    /// Marks the connection as an endless stream, exempt from [`REQUEST_TIMEOUT`] and never closed to make room.
    pub(super) fn lasts(&self) {
        *self.progress.lock() = Progress::Lasting;
    }
}

/// Open connections, from the oldest to the newest.
#[derive(Debug, Default)]
struct Open(Vec<(Weak<Mutex<Progress>>, CancellationToken)>);

impl Open {
    fn add(&mut self) -> Connection {
        self.0.retain(|(progress, _)| progress.strong_count() > 0);
        let connection = Connection::default();
        self.0.push((Arc::downgrade(&connection.progress), connection.close.clone()));
        connection
    }

    /// Closes the oldest connection of the larger group: those without a head, or those without an answer. Returns
    /// false if all are endless streams, whose number has its own limit.
    ///
    /// Silent connections thus cost no answer, and slow requests leave room for heads to arrive. The address of a
    /// client plays no part: all that come through a proxy or a tunnel share one.
    fn make_room(&mut self) -> bool {
        let known = self.0.iter().filter(|(_, close)| !close.is_cancelled());
        let known = known.filter_map(|(progress, close)| Some((*progress.upgrade()?.lock(), close)));
        let finite: Vec<_> = known.filter(|(progress, _)| *progress != Progress::Lasting).collect();
        let n_silent = finite.iter().filter(|(progress, _)| *progress == Progress::Silent).count();
        let larger = if 2 * n_silent >= finite.len() { Progress::Silent } else { Progress::Asked };
        let oldest = finite.iter().find(|(progress, _)| *progress == larger);
        oldest.map(|(_, close)| close.cancel()).is_some()
    }
}

/// Serves requests until `shutdown`, then closes all connections.
pub(super) async fn serve(listener: TcpListener, routes: Router, board: Arc<Board>, shutdown: CancellationToken) {
    let (mut tasks, mut open) = (JoinSet::new(), Open::default());
    loop {
        let accepted = tokio::select! {
            () = shutdown.cancelled() => break,
            Some(_) = tasks.join_next() => continue,
            accepted = listener.accept() => accepted,
        };
        let stream = match accepted {
            Ok((stream, _)) => stream,
            Err(error) => {
                tracing::debug!(%error, "a connection to the page was not accepted");
                board.state().counts.connection_refused_total += 1;
                tokio::time::sleep(ACCEPT_REST).await;
                continue;
            }
        };
        while tasks.try_join_next().is_some() {}
        if tasks.len() >= MAX_CONNECTIONS && open.make_room() {
            board.state().counts.connection_evicted_total += 1;
            // Waiting for its end keeps the limit, and lets the connections before this one read what has arrived.
            tasks.join_next().await;
        }
        tasks.spawn(answer(stream, open.add(), routes.clone(), board.clone()));
    }
    tasks.shutdown().await;
}

/// Serves one request on a connection, which then either ends soon or is an event stream.
async fn answer(stream: TcpStream, connection: Connection, routes: Router, board: Arc<Board>) {
    let routes = TowerToHyperService::new(routes);
    let of_request = connection.clone();
    let service = service_fn(move |request: hyper::Request<Incoming>| {
        *of_request.progress.lock() = Progress::Asked;
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
        if *connection.progress.lock() == Progress::Lasting {
            std::future::pending::<()>().await;
        }
    };
    tokio::select! {
        done = talk => if let Err(error) = done {
            tracing::trace!(%error, "a connection to the page ended early");
        },
        () = connection.close.cancelled() => {}
        () = time_is_up => board.state().counts.connection_expired_total += 1,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_oldest_of_the_larger_group_makes_room() {
        let mut open = Open::default();
        let all: Vec<Connection> = (0..6).map(|_| open.add()).collect();
        all[0].lasts();
        for asked in [1, 3] {
            *all[asked].progress.lock() = Progress::Asked;
        }
        // One that has ended makes no room.
        let mut all: Vec<Option<Connection>> = all.into_iter().map(Some).collect();
        all[4] = None;
        let closed = || all.iter().map(|one| one.as_ref().is_some_and(|one| one.close.is_cancelled()));
        for expected in [2, 1, 5, 3] {
            let before: Vec<bool> = closed().collect();
            assert!(open.make_room());
            let now = closed().zip(before).position(|(is_closed, was_closed)| is_closed && !was_closed);
            assert_eq!(now, Some(expected));
        }
        assert!(!open.make_room(), "a stream is never closed");
    }
}
