//! `keys`: creates the keys with which the processes of a run authenticate each other.

use crate::cli::KeysCommand;
use crate::exit::Failure;
use crate::keys;
use crate::live::Terminal;
use crate::shell;

/// Creates or renews keys.
pub(super) fn run(command: &KeysCommand, terminal: &Terminal) -> Result<(), Failure> {
    match command {
        KeysCommand::New(args) if args.keep && keys::exist(&args.dir) => {
            terminal.print(&format!("{} holds keys already, which are kept", args.dir.display()));
        }
        KeysCommand::New(args) => {
            let dir = shell::path(&args.dir);
            let hosts = args.certificate.hosts();
            keys::create(&args.dir, &hosts, args.certificate.days)?;
            terminal.print(&format!(
                "keys for {} days in {dir}, for a router at {}\n\
                 give each machine the folder of its role only; keep {dir}/{} away from all of them\n\
                 router:  lodestone router --listen quic/0.0.0.0:7447 --keys {dir}\n\
                 others:  lodestone actor --connect quic/HOST:7447 --keys {dir} …\n\
                 over TCP: `tls/…` instead of `quic/…`, with any port",
                args.certificate.days,
                hosts.join(", "),
                keys::AUTHORITY,
            ));
        }
        KeysCommand::Router(args) => {
            let hosts = args.certificate.hosts();
            keys::renew_router(&args.dir, &hosts, args.certificate.days)?;
            terminal.print(&format!("the router's certificate is now for {}; restart the router", hosts.join(", ")));
        }
    }
    Ok(())
}
