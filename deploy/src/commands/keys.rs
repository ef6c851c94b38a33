//! `keys`: creates the keys with which the processes of a run authenticate each other.

use crate::cli::KeysCommand;
use crate::exit::Failure;
use crate::keys;
use crate::live::Terminal;
use crate::shell;

pub(super) fn run(command: &KeysCommand, terminal: &Terminal) -> Result<(), Failure> {
    match command {
        KeysCommand::New { dir, keep: true, .. } if keys::exist(dir) => {
            terminal.print(&format!("{} holds keys already, which are kept", dir.display()));
        }
        KeysCommand::New { dir, certificate, .. } => {
            let hosts = certificate.hosts();
            keys::create(dir, &hosts, certificate.days)?;
            let dir = shell::path(dir);
            terminal.print(&format!(
                "keys for {} days in {dir}, for a router at {}\n\
                 give each machine the folder of its role only; keep {dir}/{} away from all of them\n\
                 router:  lodestone router --listen quic/0.0.0.0:7447 --keys {dir}\n\
                 others:  lodestone actor --connect quic/HOST:7447 --keys {dir} …\n\
                 over TCP: `tls/…` instead of `quic/…`, with any port",
                certificate.days,
                hosts.join(", "),
                keys::AUTHORITY,
            ));
        }
        KeysCommand::Router { dir, certificate } => {
            let hosts = certificate.hosts();
            keys::renew_router(dir, &hosts, certificate.days)?;
            terminal.print(&format!("the router's certificate is now for {}; restart the router", hosts.join(", ")));
        }
    }
    Ok(())
}
