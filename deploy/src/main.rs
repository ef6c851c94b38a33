//! Entry point of the `lodestone` program.

use std::process::ExitCode;

use deploy::cli::Cli;
use deploy::live::Terminal;
use deploy::{commands, telemetry};

fn main() -> ExitCode {
    let cli = match Cli::of_process() {
        Ok(cli) => cli,
        Err(code) => return code,
    };
    let terminal = Terminal::default();
    telemetry::init(cli.log_format, &terminal);
    let has_result = cli.command.has_result();
    let ended = match commands::execute(cli.command, &terminal) {
        // Services go on without a reader: what they print is progress.
        Ok(()) if has_result => terminal.check_written(),
        ended => ended,
    };
    match ended {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            terminal.on_stderr().print(&format!("error: {failure}"));
            failure.exit_code()
        }
    }
}
