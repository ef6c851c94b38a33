//! A connection to a server that can be cut, like the network between a browser and a run.

use std::io::copy;
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::{Arc, Mutex};

/// Forwards bytes between clients of [`Line::address`] and a server until the test ends.
pub(crate) struct Line {
    address: SocketAddr,
    state: Arc<Mutex<State>>,
}

#[derive(Default)]
struct State {
    is_cut: bool,
    /// Both ends of every connection so far.
    ends: Vec<TcpStream>,
}

impl Line {
    pub(crate) fn to(server: &str) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let state = Arc::new(Mutex::new(State::default()));
        let (server, its_state) = (server.to_owned(), state.clone());
        // The thread ends with the test process.
        std::thread::spawn(move || {
            for near in listener.incoming().map_while(Result::ok) {
                // While the line is cut, connections are closed at once, as if nothing listened. The port stays
                // reserved.
                let mut state = its_state.lock().unwrap();
                if state.is_cut {
                    continue;
                }
                let Ok(far) = TcpStream::connect(&server) else { continue };
                for (from, to) in [(&near, &far), (&far, &near)] {
                    pass(from.try_clone().unwrap(), to.try_clone().unwrap());
                }
                state.ends.extend([near, far]);
            }
        });
        Self { address, state }
    }

    pub(crate) fn address(&self) -> SocketAddr {
        self.address
    }

    /// Closes all connections, and every new one until [`Line::mend`].
    pub(crate) fn cut(&self) {
        let mut state = self.state.lock().unwrap();
        state.is_cut = true;
        for end in state.ends.drain(..) {
            // Fails only if the connection has already ended.
            let _ = end.shutdown(Shutdown::Both);
        }
    }

    pub(crate) fn mend(&self) {
        self.state.lock().unwrap().is_cut = false;
    }
}

/// Forwards bytes until end of stream, then shuts down the other side's write half.
fn pass(mut from: TcpStream, mut to: TcpStream) {
    std::thread::spawn(move || {
        // Either end may disconnect at any time.
        let _ = copy(&mut from, &mut to);
        let _ = to.shutdown(Shutdown::Write);
    });
}
