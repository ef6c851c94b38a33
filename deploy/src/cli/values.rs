//! Parsers of numbers and addresses on the command line.

use std::net::{Ipv4Addr, SocketAddr};
use std::path::PathBuf;

use clap::builder::{OsStringValueParser, TypedValueParser};

use crate::config::is_whole;

/// Parses a number of environment steps: `1000000`, `1_000_000`, `1e6`, or `2.5e6`.
pub(super) fn steps(text: &str) -> Result<i64, String> {
    let digits = text.replace('_', "");
    let number = digits.parse::<i64>().ok().or_else(|| {
        let number: f64 = digits.parse().ok()?;
        is_whole(number).then_some(number as i64)
    });
    match number {
        Some(number) if number >= 1 => Ok(number),
        Some(number) => Err(format!("{number} is not in 1..")),
        None => Err("expected a whole number, for example 1000000, 1_000_000 or 1e6".to_owned()),
    }
}

/// Parses the endpoint of a router; `HOST:PORT` alone means TCP. The bus validates the result.
pub(super) fn endpoint(text: &str) -> Result<String, String> {
    let text = text.trim();
    let is_address = || {
        let port = text.rsplit_once(':').filter(|(host, _)| !host.is_empty()).map(|(_, port)| port);
        port.is_some_and(|port| port.parse::<u16>().is_ok())
    };
    Ok(if !text.contains('/') && is_address() { format!("tcp/{text}") } else { text.to_owned() })
}

/// Parses a path that settings hold as text.
pub(super) fn text_path() -> impl TypedValueParser<Value = PathBuf> {
    OsStringValueParser::new().try_map(|path| {
        path.into_string()
            .map(PathBuf::from)
            .map_err(|_| "the path is kept in settings, which are UTF-8 text: rename it")
    })
}

/// Parses the address of a web page: `127.0.0.1:8080`, `localhost:8080`, or a port alone, which means 127.0.0.1.
pub(super) fn address(text: &str) -> Result<SocketAddr, String> {
    let port = match text.rsplit_once(':') {
        None => Some(text),
        Some(("" | "localhost", port)) => Some(port),
        Some(_) => None,
    };
    let own = port.and_then(|port| port.parse::<u16>().ok()).map(|port| (Ipv4Addr::LOCALHOST, port).into());
    own.or_else(|| text.parse().ok()).ok_or_else(|| "expected PORT or ADDRESS:PORT, for example 127.0.0.1:0".to_owned())
}

#[cfg(test)]
mod tests {
    use std::net::Ipv6Addr;

    use super::*;

    #[test]
    fn steps_are_written_as_people_write_them() {
        for (text, expected) in
            [("5", 5), ("1000000", 1_000_000), ("1_000_000", 1_000_000), ("1e6", 1_000_000), ("2.5E6", 2_500_000)]
        {
            assert_eq!(steps(text), Ok(expected), "{text}");
        }
        for (text, words) in [
            ("0", "0 is not in 1.."),
            ("-3", "-3 is not in 1.."),
            ("1.5", "whole"),
            ("2M", "1e6"),
            ("1e300", "whole"),
            ("nan", "whole"),
        ] {
            assert!(steps(text).unwrap_err().contains(words), "{text}");
        }
    }

    #[test]
    fn a_host_and_a_port_are_an_endpoint() {
        for (text, expected) in [
            ("localhost:7447", "tcp/localhost:7447"),
            ("10.0.0.1:7447", "tcp/10.0.0.1:7447"),
            ("[::1]:7447", "tcp/[::1]:7447"),
            ("quic/node:7447", "quic/node:7447"),
            ("unixsock-stream//tmp/bus.sock", "unixsock-stream//tmp/bus.sock"),
            ("nonsense", "nonsense"),
            (":7447", ":7447"),
            ("host:port", "host:port"),
        ] {
            assert_eq!(endpoint(text).as_deref(), Ok(expected));
        }
    }

    #[test]
    fn a_port_alone_is_an_address_of_this_machine() {
        for text in ["8080", ":8080", "localhost:8080", "127.0.0.1:8080"] {
            assert_eq!(address(text), Ok(SocketAddr::from(([127, 0, 0, 1], 8080))), "{text}");
        }
        assert_eq!(address("[::1]:80"), Ok(SocketAddr::from((Ipv6Addr::LOCALHOST, 80))));
        for text in ["", "page", "70000", "page:80"] {
            assert!(address(text).unwrap_err().contains("ADDRESS:PORT"), "{text}");
        }
    }
}
