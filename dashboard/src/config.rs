//! Dashboard settings: where the page is served and who may see it.

use std::fmt;
use std::net::SocketAddr;

use proto::{InvalidSetting, settings};
use serde::{Deserialize, Serialize};

/// Minimum and maximum length of a token in characters. Sixteen letters and digits hold 95 bits.
const TOKEN_LENGTHS: std::ops::RangeInclusive<usize> = 16..=128;

settings! {
    /// How a run is shown.
    #[derive(Eq)]
    pub struct DashboardConfig {
        /// Web page about the training, served by the evaluator process. Absent: no page.
        pub web: Option<WebConfig>;
    }

    /// Where the page is served and who may see it.
    #[derive(Eq)]
    pub struct WebConfig in "dashboard.web", check access {
        /// Address and port. Port 0 lets the system choose one. An address other than loopback requires `token` or
        /// `hosts`. The connection is unencrypted: outside a trusted network, put a TLS proxy in front of it.
        pub listen: SocketAddr = SocketAddr::from(([127, 0, 0, 1], 0));
        /// Secret that a browser must present: 16 to 128 characters of `A-Z`, `a-z`, `0-9`, `-` and `_`. Like every
        /// setting, it is written to the run's `config.toml`. It may be absent only if `listen` is a loopback address
        /// or `hosts` is not empty.
        pub token: Option<Token> = None;
        /// Without a token, host names for which the page answers requests, in addition to the names of its own
        /// machine. Meant for a container whose port is published on loopback only: any other client that reaches it
        /// can forge the name.
        pub hosts: Vec<String> = Vec::new();
    }
}

/// A shared secret. `Debug` does not reveal it.
#[derive(Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Token(String);

impl WebConfig {
    /// A page that other machines can reach requires a token or restricts its host names.
    fn access(&self, path: &str) -> Result<(), InvalidSetting> {
        match &self.token {
            None if !self.listen.ip().is_loopback() && self.hosts.is_empty() => Err(InvalidSetting::new(format!(
                "{path}.listen = {}, which others can reach: set {path}.token, listen on 127.0.0.1, or, in a network \
                 of its own, name in {path}.hosts how it is reached",
                self.listen
            ))),
            Some(token) if !token.is_usable() => Err(InvalidSetting::new(format!(
                "{path}.token has {} characters: expected 16 to 128 of A-Z, a-z, 0-9, - and _",
                token.0.chars().count()
            ))),
            _ => Ok(()),
        }
    }
}

impl Token {
    /// Returns whether the token is valid in a URL, a cookie and a header without escaping, and is long enough not to
    /// be guessed.
    fn is_usable(&self) -> bool {
        let allowed = |c: u8| c.is_ascii_alphanumeric() || c == b'-' || c == b'_';
        TOKEN_LENGTHS.contains(&self.0.len()) && self.0.bytes().all(allowed)
    }

    /// Returns whether `guess` equals the token. The comparison takes constant time for guesses of the right length.
    pub(crate) fn is(&self, guess: &str) -> bool {
        let same_length = self.0.len() == guess.len();
        same_length && self.0.bytes().zip(guess.bytes()).fold(0, |diff, (a, b)| diff | (a ^ b)) == 0
    }

    /// Returns the token in plain text, for the cookie.
    pub(crate) fn reveal(&self) -> &str {
        &self.0
    }
}

impl From<String> for Token {
    fn from(token: String) -> Self {
        Self(token)
    }
}

impl fmt::Debug for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Token(hidden)")
    }
}

#[cfg(test)]
mod tests {
    use proto::Valid;

    use super::*;

    #[test]
    fn whoever_can_be_reached_needs_a_token_or_names_its_hosts() {
        let good = "0123456789abcdef";
        let reached = "dashboard.web.listen = 0.0.0.0:8080, which others can reach: set dashboard.web.token, listen on \
                       127.0.0.1, or, in a network of its own, name in dashboard.web.hosts how it is reached";
        let short = "dashboard.web.token has 5 characters: expected 16 to 128 of A-Z, a-z, 0-9, - and _";
        let odd = "dashboard.web.token has 16 characters: expected 16 to 128 of A-Z, a-z, 0-9, - and _";
        let table = [
            ("127.0.0.1:0", None, None, None),
            ("[::1]:8080", None, None, None),
            ("0.0.0.0:8080", Some(good), None, None),
            // In a container.
            ("0.0.0.0:8080", None, Some("evaluator"), None),
            ("0.0.0.0:8080", None, None, Some(reached)),
            ("127.0.0.1:0", Some("short"), None, Some(short)),
            ("127.0.0.1:0", Some("0123456789abcde;"), None, Some(odd)),
        ];
        let default = WebConfig::default();
        assert!(default.listen.ip().is_loopback() && default.token.is_none());
        assert_eq!(Valid::new(default).err(), None);
        for (listen, token, host, error) in table {
            let token = token.map(|token| Token(token.to_owned()));
            let hosts = host.map(str::to_owned).into_iter().collect();
            let config = WebConfig { listen: listen.parse().unwrap(), token, hosts };
            assert_eq!(Valid::new(config).err().map(|error| error.to_string()).as_deref(), error, "{listen}");
        }
    }

    #[test]
    fn a_token_stays_out_of_logs() {
        let config = WebConfig { token: Some(Token("0123456789abcdef".to_owned())), ..Default::default() };
        assert!(!format!("{config:?}").contains("0123"));
    }

    #[test]
    fn only_the_token_is_the_token() {
        let token = Token("0123456789abcdef".to_owned());
        assert!(token.is("0123456789abcdef"));
        for guess in ["", "0123456789abcde", "0123456789abcdeg", "0123456789abcdef0"] {
            assert!(!token.is(guess), "{guess}");
        }
    }
}
