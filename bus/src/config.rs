//! Configuration of a process's bus session.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use serde_json::json;

use super::access;
use super::security::{Keys, KeysError, SecurityConfig, has_any_port, is_encrypted, is_endpoint, is_reachable};
use proto::codec::MAX_WEIGHTS_BYTES;
use proto::trajectory::is_valid_name;
use proto::{InvalidSetting, Valid, settings};

/// Time that a connection gets to become a member of the bus, in milliseconds; a router drops and counts the others.
pub(super) const JOIN_TIMEOUT_MS: u64 = 4_000;

/// Largest message that a process receives, in bytes: more than the largest weights, which are the largest messages.
const MAX_MESSAGE_BYTES: usize = MAX_WEIGHTS_BYTES + (7 << 20);

settings! {
    /// Configuration of a process's bus session.
    #[derive(Eq)]
    pub struct BusConfig in "bus", check endpoints {
        /// Name of the run; runs on one router do not see each other.
        pub run: String = "default".to_owned(),
            where |c| is_valid_name(&c.run) => "1 to 64 characters of a-z, 0-9 and -";
        /// Role in the network. A router needs no other process.
        pub mode: BusMode = BusMode::Router;
        /// Endpoints that a router listens on, such as `tcp/127.0.0.1:7447`, `unixsock-stream//tmp/bus.sock`, or, with
        /// keys, `quic/0.0.0.0:7447` (UDP) or `tls/0.0.0.0:7447` (TCP). Without any, no other process can join.
        pub listen: Vec<String> = Vec::new(),
            where |c| c.mode == BusMode::Router || c.listen.is_empty() => "none for a client";
        /// Endpoints to connect to: the router for a client, other routers for a router.
        pub connect: Vec<String> = Vec::new(),
            where |c| c.mode == BusMode::Router || !c.connect.is_empty() => "a router's endpoint for a client, such as tcp/HOST:7447 with --connect";
        /// Rate at which the learner answers pulls of the weights, in 10^6 bytes per second. Simultaneous pulls take
        /// turns, so that thousands of them do not fill all buffers at once. The bytes of one second may go out at
        /// once.
        pub weights_mb_per_s: u64 = 1000, in 1..=1_000_000;
        /// Credentials of this process. Listening where other machines can connect needs keys.
        pub security: SecurityConfig;
    }
}

/// A process's role in the network.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum BusMode {
    /// Routes the messages of other processes in addition to its own.
    Router,
    /// Connects to one router.
    Client,
}

impl BusConfig {
    /// A router that only processes with access to the folder `dir` can join, through a Unix socket in it.
    pub fn isolated_router(dir: &Path) -> Valid<Self> {
        isolated(Self { listen: vec![Self::socket_endpoint(dir)], ..Self::default() })
    }

    /// A client of [`Self::isolated_router`].
    pub fn isolated_client(dir: &Path) -> Valid<Self> {
        isolated(Self { mode: BusMode::Client, connect: vec![Self::socket_endpoint(dir)], ..Self::default() })
    }

    /// The socket in `dir` of these two.
    pub fn socket(dir: &Path) -> PathBuf {
        dir.join("bus.sock")
    }

    /// The endpoint of that socket.
    pub fn socket_endpoint(dir: &Path) -> String {
        format!("unixsock-stream/{}", Self::socket(dir).display())
    }

    fn endpoints(&self, path: &str) -> Result<(), InvalidSetting> {
        let has_keys = self.security.keys.is_some();
        let invalid = |rule: String| Err(InvalidSetting::new(format!("{path}.{rule}")));
        for (field, endpoints) in [("listen", &self.listen), ("connect", &self.connect)] {
            if let Some(endpoint) = endpoints.iter().find(|endpoint| !is_endpoint(endpoint)) {
                return invalid(format!(
                    "{field}: `{endpoint}` is no endpoint, expected `tcp/HOST:PORT`, `quic/HOST:PORT` or \
                     `tls/HOST:PORT` with keys, or `unixsock-stream/PATH`"
                ));
            }
        }
        if let Some(any) = self.listen.iter().find(|endpoint| has_any_port(endpoint)) {
            return invalid(format!(
                "listen: nobody could know the port of {any}, which the system would choose; name one from 1 to 65535"
            ));
        }
        if let Some(open) = self.listen.iter().find(|endpoint| !has_keys && is_reachable(endpoint)) {
            return invalid(format!(
                "listen: anybody who reaches {open} could replace the weights; run `lodestone keys new DIR --host \
                 NAME` once, then listen on `quic/ADDRESS:PORT` (UDP) or `tls/ADDRESS:PORT` (TCP) with `--keys DIR`, \
                 or listen on 127.0.0.1"
            ));
        }
        for (field, endpoints) in [("listen", &self.listen), ("connect", &self.connect)] {
            if let Some(odd) = endpoints.iter().find(|endpoint| has_keys != is_encrypted(endpoint)) {
                return invalid(match has_keys {
                    true => format!(
                        "{field}: with keys every endpoint is `quic/ADDRESS:PORT` or `tls/ADDRESS:PORT`, and {odd} is \
                         not"
                    ),
                    false => format!("{field}: {odd} needs keys; name their folder with `--keys DIR`"),
                });
            }
        }
        Ok(())
    }

    /// Returns whether other processes connect to this one.
    fn is_listening(&self) -> bool {
        !self.listen.is_empty()
    }

    /// Reads and checks the keys of this process.
    pub(super) fn read_keys(&self) -> Result<Option<Keys>, KeysError> {
        self.security.keys.as_deref().map(|folder| Keys::read(folder, self.is_listening())).transpose()
    }

    /// Converts to zenoh's configuration, for a session in which all keys have the prefix `namespace` and whose public
    /// endpoints to listen on and to connect to are `instead`, if given.
    pub(super) fn to_zenoh(
        &self,
        namespace: &str,
        keys: Option<&Keys>,
        instead: Option<[&[String]; 2]>,
    ) -> Result<zenoh::Config, zenoh::Error> {
        let [listen, connect] = instead.unwrap_or([&self.listen, &self.connect]);
        let retry = json!({ "period_init_ms": 500, "period_max_ms": 8000, "period_increase_factor": 2 });
        let mut config = json!({
            "mode": match self.mode { BusMode::Router => "router", BusMode::Client => "client" },
            "namespace": namespace,
            // No time limit: a process may start before its router.
            "connect": { "endpoints": connect, "timeout_ms": -1, "exit_on_failure": false, "retry": retry },
            // Report a port that is in use at once.
            "listen": { "endpoints": listen, "timeout_ms": 0, "exit_on_failure": true },
            // Peers are configured, never discovered, because any discovered process could overwrite any key.
            "scouting": { "delay": 0, "multicast": { "enabled": false }, "gossip": { "enabled": false } },
            "transport": {
                "unicast": { "max_sessions": 8192, "accept_pending": 1024, "accept_timeout": JOIN_TIMEOUT_MS },
                "link": {
                    "tx": {
                        "lease": 6000,
                        // The default closes the whole transport if a peer is slow for 5 s; −1 makes zenoh panic. If a
                        // connection is lost while a sender waits, the sender gives up only after this time, and until
                        // then nothing leaves the process. So use little more than the lease, after which a peer counts
                        // as gone.
                        "queue": { "congestion_control": { "block": { "wait_before_close": 8_000_000 } } },
                    },
                    "rx": { "buffer_size": 1 << 20, "max_message_size": MAX_MESSAGE_BYTES },
                },
            },
        });
        if self.is_listening() {
            config["downsampling"] = access::rate_limits();
        }
        if let Some(keys) = keys {
            config["transport"]["link"]["tls"] = keys.tls();
            config["transport"]["auth"] = json!({ "usrpwd": keys.passwords(self.is_listening()) });
            if self.is_listening() {
                config["access_control"] = access::rules();
                config["low_pass_filter"] = access::size_limits();
            }
        }
        zenoh::Config::from_json5(&config.to_string())
    }
}

fn isolated(config: BusConfig) -> Valid<BusConfig> {
    Valid::new(config).expect("a socket in a folder is an endpoint")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reachable_listener_needs_keys() {
        let router = |endpoint: &str| BusConfig { listen: vec![endpoint.to_owned()], ..BusConfig::default() };
        let refused = |endpoint: &str| Valid::new(router(endpoint)).unwrap_err().to_string();
        let message = refused("tcp/0.0.0.0:7447");
        assert!(message.contains("tcp/0.0.0.0:7447") && message.contains("lodestone keys new"), "{message}");
        assert_eq!(Valid::new(router("tcp/127.0.0.1:7447")).err(), None);
        for wrong in ["tcp/127.0.0.1", "tcp/127.0.0.1:99999", "tcp/:7447", "tcp/127.0.0.1:port", "udp/127.0.0.1:7447"] {
            let message = refused(wrong);
            assert!(message.starts_with(&format!("bus.listen: `{wrong}` is no endpoint")), "{message}");
        }
        let message = refused("tcp/127.0.0.1:0");
        assert!(message.starts_with("bus.listen: nobody could know the port of tcp/127.0.0.1:0"), "{message}");
        for endpoint in ["quic/127.0.0.1:7447", "tls/127.0.0.1:7447"] {
            let message = format!("bus.listen: {endpoint} needs keys; name their folder with `--keys DIR`");
            assert_eq!(refused(endpoint), message);
        }
        let mut config = router("quic/0.0.0.0:7447");
        config.security.keys = Some("keys/router".into());
        assert_eq!(Valid::new(config.clone()).err(), None);
        config.connect = vec!["tcp/10.0.0.1:7447".to_owned()];
        assert_eq!(
            Valid::new(config).unwrap_err().to_string(),
            "bus.connect: with keys every endpoint is `quic/ADDRESS:PORT` or `tls/ADDRESS:PORT`, and tcp/10.0.0.1:7447 is not"
        );
    }
}
