//! The command-line interface.

use std::borrow::Cow;
use std::ffi::OsString;
use std::io::{self, Write};
use std::path::PathBuf;
use std::process::ExitCode;

use ::blueprints::Split;
use ::blueprints::outside::{printable, printable_lines};
use clap::error::{ContextKind, ContextValue, ErrorKind};
use clap::{ArgGroup, Args, CommandFactory, Parser, Subcommand};
use clap_complete::Shell;

mod blueprints;
mod bus;
mod examples;
mod record;
mod settings;
mod sweep;
mod values;
mod views;

pub use self::blueprints::{BlueprintsArgs, BlueprintsCommand, ShowArgs};
pub use self::bus::{CertificateArgs, EndpointArgs, HealthArgs, KeysArgs, KeysCommand, RouterArgs};
pub use self::record::{GoalArgs, RecordArgs};
pub use self::settings::{ConfigArgs, Settings};
pub use self::sweep::SweepArgs;
pub use self::views::{RenderArgs, ReportArgs, ServeArgs, VideoFormat, WatchArgs};

use crate::config::Override;
use crate::exit::Failure;
use crate::telemetry::LogFormat;

/// Trains an agent to assemble magnet blocks into blueprints.
#[derive(Debug, Parser)]
#[command(name = "lodestone", version, max_term_width = 100, arg_required_else_help = true, after_help = examples::PROGRAM)]
pub struct Cli {
    /// The subcommand.
    #[command(subcommand)]
    pub command: Command,
    /// Format of log lines, which go to stderr. The variable RUST_LOG selects them: error, warn, info, debug, or trace
    /// [default: info].
    #[arg(long, global = true, value_enum, default_value_t, env = "LODESTONE_LOG_FORMAT", help_heading = "Logs")]
    pub log_format: LogFormat,
}

/// Returns the definition of the command line.
pub fn program() -> clap::Command {
    Cli::command()
}

impl Cli {
    /// Parses the arguments of this process.
    ///
    /// # Errors
    /// Returns the exit code of the process after printing the help text, the version, or an error that names the
    /// argument.
    pub fn of_process() -> Result<Self, ExitCode> {
        Self::try_parse().map_err(|mut error| {
            suggest_gpu(&mut error);
            let printed = print(&error);
            // The help and the version are results. If stderr is closed, only the exit code is left.
            if let (Err(failed), false) = (printed, error.use_stderr())
                && failed.kind() != io::ErrorKind::BrokenPipe
            {
                drop(writeln!(io::stderr(), "error: {}", Failure::Output(failed)));
                return ExitCode::FAILURE;
            }
            if let Some(variable) = variable(&error) {
                drop(writeln!(io::stderr(), "\nThe value comes from the environment variable {variable}."));
            }
            u8::try_from(error.exit_code()).map_or(ExitCode::FAILURE, ExitCode::from)
        })
    }
}

/// Suggests the GPU for names of its programming interfaces, although `cuda` has more letters of `cpu` in it.
fn suggest_gpu(error: &mut clap::Error) {
    const GPUS: [&str; 9] = ["cuda", "gpu", "hip", "metal", "mps", "nvidia", "rocm", "vulkan", "wgpu"];
    let text = |kind| match error.get(kind) {
        Some(ContextValue::String(text)) => text.to_ascii_lowercase(),
        _ => String::new(),
    };
    let is_device = text(ContextKind::InvalidArg).starts_with("--device");
    let given = text(ContextKind::InvalidValue);
    if is_device && GPUS.iter().any(|name| given.starts_with(name)) {
        error.insert(ContextKind::SuggestedValue, ContextValue::String("gpu".to_owned()));
    }
}

/// Prints an error of the parser, or the help; an error without colors, and so without escape sequences of anybody, if an
/// argument or a variable has characters that a terminal acts on.
fn print(error: &clap::Error) -> io::Result<()> {
    let of_us = |name: &OsString| name.as_encoded_bytes().starts_with(b"LODESTONE_");
    let variables = std::env::vars_os().filter(|(name, _)| of_us(name)).map(|(_, value)| value);
    let is_active = |text: OsString| matches!(printable(&text.to_string_lossy()), Cow::Owned(_));
    if error.use_stderr() && std::env::args_os().chain(variables).any(is_active) {
        return io::stderr().write_all(printable_lines(&error.render().to_string()).as_bytes());
    }
    error.print()
}

/// The environment variable that an invalid value came from, if it did not come from an argument.
fn variable(error: &clap::Error) -> Option<String> {
    if !matches!(error.kind(), ErrorKind::ValueValidation | ErrorKind::InvalidValue) {
        return None;
    }
    // For example `--steps <N>`.
    let Some(ContextValue::String(argument)) = error.get(ContextKind::InvalidArg) else { return None };
    let flag = argument.split(' ').next()?;
    let is_flag = |given: &str| given == flag || given.split('=').next() == Some(flag);
    if std::env::args_os().any(|given| is_flag(&given.to_string_lossy())) {
        return None;
    }
    let command = Cli::command();
    let all = command.get_subcommands().chain([&command]).flat_map(clap::Command::get_arguments);
    let mut of_flag = all.filter(|arg| arg.get_long() == flag.strip_prefix("--"));
    Some(of_flag.find_map(clap::Arg::get_env)?.to_string_lossy().into_owned())
}

/// The subcommands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Train in one process: learner, actors, and evaluator.
    #[command(after_help = examples::TRAIN)]
    Train(TrainArgs),
    /// Train all combinations of some settings, or random ones, with several seeds each, and compare them.
    #[command(after_help = examples::SWEEP)]
    Sweep(SweepArgs),
    /// Step worlds and send trajectories to the learner of a run.
    #[command(after_help = examples::ACTOR)]
    Actor(MemberArgs),
    /// Train on the trajectories of a run's actors.
    #[command(after_help = examples::LEARNER)]
    Learner(LearnerArgs),
    /// Evaluate a run's weights as they are published.
    #[command(after_help = examples::EVALUATOR)]
    Evaluator(EvaluatorArgs),
    /// Route messages between the processes of runs.
    #[command(after_help = examples::ROUTER)]
    Router(RouterArgs),
    /// Create keys, which processes need to join a router that other machines can reach.
    #[command(subcommand)]
    Keys(KeysCommand),
    /// Check the health of a service on this machine: exit code 0 if it is healthy, else 1 and the reason.
    Healthcheck {
        /// The file that the service writes with --health-file.
        #[arg(long, value_name = "FILE", env = "LODESTONE_HEALTH_FILE")]
        file: PathBuf,
        /// Check only that the process is alive and making progress, not that it reaches a router.
        #[arg(long)]
        alive: bool,
    },
    /// Watch a run live: success, throughput, losses, actors, and drops.
    #[command(after_help = examples::WATCH)]
    Watch(WatchArgs),
    /// Evaluate a checkpoint, the shipped policy, or the scripted expert.
    #[command(after_help = examples::EVAL)]
    Eval(EvalArgs),
    /// Watch a policy build on a web page: any blueprint, from any start, to rotate and step through.
    #[command(after_help = examples::PLAY)]
    Play(PlayArgs),
    /// Show finished runs on a web page, several side by side.
    #[command(after_help = examples::SERVE)]
    Serve(ServeArgs),
    /// Export the policy of a checkpoint to a single file, for acting only.
    #[command(after_help = examples::EXPORT)]
    Export(ExportArgs),
    /// Write tables of how success grew during a run, by group and by blueprint.
    #[command(after_help = examples::REPORT)]
    Report(ReportArgs),
    /// Record episodes as trajectories, for `render`.
    ///
    /// For a Minari dataset for offline learning, use the Python package: `python -m lodestone.record`.
    #[command(after_help = examples::RECORD)]
    Record(RecordArgs),
    /// Render recorded episodes as videos.
    #[command(after_help = examples::RENDER)]
    Render(RenderArgs),
    /// List, check, and draw blueprints.
    #[command(subcommand, after_help = examples::BLUEPRINTS)]
    Blueprints(BlueprintsCommand),
    /// Print shell completions; load them with `source <(lodestone completions bash)`.
    Completions {
        /// The shell.
        #[arg(value_name = "SHELL", value_enum)]
        shell: Shell,
    },
}

impl Command {
    /// Whether what the command prints is its result, rather than the progress of a service.
    pub fn has_result(&self) -> bool {
        match self {
            Self::Train(args) => args.json || args.config.print_config,
            Self::Actor(args) => args.config.print_config,
            Self::Learner(args) => args.member.config.print_config,
            Self::Evaluator(args) => args.member.config.print_config,
            Self::Serve(args) => args.export.is_some(),
            Self::Router(_) | Self::Play(_) => false,
            _ => true,
        }
    }
}

/// Arguments of `train`.
#[derive(Debug, Args)]
pub struct TrainArgs {
    #[command(flatten)]
    pub(crate) config: ConfigArgs,
    #[command(flatten)]
    pub(crate) run: RunArgs,
    /// Train and evaluate on this blueprint only: an id or a name such as scorpion, a file, or a
    /// folder of files; may be repeated.
    #[arg(long, value_name = "FILE|ID")]
    pub(crate) blueprint: Vec<OsString>,
    /// Threads that step worlds.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(i64).range(1..=64))]
    pub(crate) actors: Option<i64>,
    /// Alternate between stepping worlds and learning. This is slower, but equal seeds produce equal bytes, even in a
    /// run that is resumed from one of its periodic checkpoints.
    #[arg(long)]
    pub(crate) lockstep: bool,
    /// Print every blueprint after an evaluation, not only the groups and the worst blueprints.
    #[arg(long)]
    pub(crate) verbose: bool,
    /// Print a summary of the training as JSON at the end; everything else goes to stderr.
    #[arg(long)]
    pub(crate) json: bool,
    /// Let other processes join at this endpoint, for example tcp/127.0.0.1:7447; may be repeated.
    #[arg(long, value_name = "ENDPOINT", env = "LODESTONE_LISTEN", value_delimiter = ',', value_parser = values::endpoint)]
    pub(crate) listen: Vec<String>,
    #[command(flatten)]
    pub(crate) keys: KeysArgs,
    #[command(flatten)]
    pub(crate) health: HealthArgs,
    #[command(flatten)]
    pub(crate) page: PageArgs,
    /// Do not serve a web page.
    #[arg(long, conflicts_with = "web")]
    pub(crate) no_web: bool,
    /// Save and end when stdin is closed: `sweep` keeps it open for as long as it lives.
    #[arg(long, hide = true)]
    pub(crate) end_with_stdin: bool,
}

/// Where the evaluator's web page is served.
#[derive(Clone, Debug, Default, Args)]
pub struct PageArgs {
    /// Serve a web page about the training here, for example 8080, or 127.0.0.1:0 for a free port; an address that
    /// other machines can reach needs dashboard.web.token [default: for `train`, 127.0.0.1 with a free port].
    #[arg(long, value_name = "ADDRESS:PORT", env = "LODESTONE_WEB", value_parser = values::address)]
    pub(crate) web: Option<std::net::SocketAddr>,
}

/// Where a learner starts, what it writes, and when it stops.
#[derive(Clone, Debug, Default, Args)]
pub struct RunArgs {
    /// Stop after this many environment steps, for example 1e6 or 1_000_000, up to the end of the last segment; steps
    /// before a resume count.
    #[arg(long, value_name = "N", env = "LODESTONE_STEPS", value_parser = values::steps, allow_negative_numbers = true)]
    pub(crate) steps: Option<i64>,
    /// Folder for checkpoints and metrics [default: runs/DATE-NAME].
    #[arg(long, value_name = "DIR", env = "LODESTONE_RUN_DIR")]
    pub(crate) run_dir: Option<PathBuf>,
    /// Continue the run in this folder, with its configuration.
    #[arg(long, value_name = "DIR", conflicts_with_all = ["config", "preset"])]
    pub(crate) resume: Option<PathBuf>,
    /// Continue the run in --run-dir, with its configuration, or start it there if it does not exist yet: a supervisor
    /// can use the same command every time.
    #[arg(long, env = "LODESTONE_AUTO_RESUME", requires = "run_dir", conflicts_with = "resume")]
    pub(crate) auto_resume: bool,
    /// Start from this policy, with a fresh optimizer: a file written by `export`, the folder of a run for its best
    /// policy, or `pretrained` for the shipped policy. The network must be the same, but the settings of its
    /// standard deviations (policy.network.init_std) may differ.
    #[arg(long, value_name = "MODEL", conflicts_with = "resume")]
    pub(crate) init_from: Option<PathBuf>,
}

/// Arguments of a process that joins a run.
#[derive(Debug, Args)]
pub struct MemberArgs {
    /// The configuration, which must match the learner's.
    #[command(flatten)]
    pub(crate) config: ConfigArgs,
    #[command(flatten)]
    pub(crate) endpoints: EndpointArgs,
    /// Name of this process: 1 to 64 characters of a-z, 0-9, and -, unique among the run's processes of this kind
    /// [default: random].
    #[arg(long, value_name = "ID", env = "LODESTONE_ID")]
    pub(crate) id: Option<String>,
    #[command(flatten)]
    pub(crate) health: HealthArgs,
}

/// Arguments of `learner`.
#[derive(Debug, Args)]
pub struct LearnerArgs {
    #[command(flatten)]
    pub(crate) member: MemberArgs,
    #[command(flatten)]
    pub(crate) run: RunArgs,
    /// Exit with 75 if a signal ends the learner before the run has its steps, for a supervisor that takes 0 for the end
    /// of the run.
    #[arg(long, env = "LODESTONE_FAIL_UNFINISHED")]
    pub(crate) fail_unfinished: bool,
}

/// Arguments of `evaluator`.
#[derive(Debug, Args)]
pub struct EvaluatorArgs {
    #[command(flatten)]
    pub(crate) member: MemberArgs,
    /// Keep reports in this folder, in metrics.jsonl and eval.db.
    #[arg(long, value_name = "DIR", env = "LODESTONE_RUN_DIR")]
    pub(crate) run_dir: Option<PathBuf>,
    /// Print every blueprint after an evaluation, not only the groups and the worst blueprints.
    #[arg(long)]
    pub(crate) verbose: bool,
    #[command(flatten)]
    pub(crate) page: PageArgs,
}

/// Arguments of `export`.
#[derive(Debug, Args)]
pub struct ExportArgs {
    /// Folder of a run (for its best policy, or else its newest checkpoint), of its `checkpoints` (for the newest), or of
    /// one of them, or a file written by `export`. If repeated, the mean of policies that were learned from one another,
    /// which often does better than each of them.
    #[arg(long, value_name = "DIR_OR_FILE", required = true)]
    pub(crate) checkpoint: Vec<PathBuf>,
    /// Output file, which must not exist.
    #[arg(long, value_name = "FILE")]
    pub(crate) out: PathBuf,
}

/// Arguments of `play`.
#[derive(Debug, Args)]
pub struct PlayArgs {
    /// Folder of a run (for its best policy, or else its newest checkpoint), of its `checkpoints` (for the newest), or of
    /// one of them, or a file written by `export` [default: the shipped policy].
    #[arg(long, value_name = "DIR_OR_FILE")]
    pub(crate) checkpoint: Option<PathBuf>,
    /// The shipped policy, as without --checkpoint.
    #[arg(long, conflicts_with = "checkpoint")]
    pub(crate) pretrained: bool,
    /// Only these blueprints: ids or names such as scorpion, files, or folders of files [default: the whole catalog].
    #[arg(value_name = "FILE|ID")]
    pub(crate) ids: Vec<OsString>,
    /// Same as FILE|ID; may be repeated.
    #[arg(long, value_name = "FILE|ID")]
    pub(crate) blueprint: Vec<OsString>,
    /// Address of the web page [default: 127.0.0.1 with a free port].
    #[arg(long, value_name = "ADDRESS:PORT", value_parser = values::address)]
    pub(crate) web: Option<std::net::SocketAddr>,
    /// Do not open the page in a browser, which happens where a terminal and a display are.
    #[arg(long)]
    pub(crate) no_open: bool,
    /// Set one configuration key, for example environment.episode_steps=140; may be repeated.
    #[arg(long, value_name = "KEY=VALUE")]
    pub(crate) set: Vec<String>,
}

/// Arguments of `eval`.
#[derive(Debug, Args)]
#[command(group = ArgGroup::new("agent").required(true).args(["checkpoint", "pretrained", "expert"]))]
pub struct EvalArgs {
    /// Folder of a run (for its best policy, or else its newest checkpoint), of its `checkpoints` (for the newest), or of
    /// one of them, or a file written by `export`.
    #[arg(long, value_name = "DIR_OR_FILE")]
    pub(crate) checkpoint: Option<PathBuf>,
    /// The shipped policy.
    #[arg(long)]
    pub(crate) pretrained: bool,
    /// The scripted expert, in the default world; of the settings, `environment`, `evaluator`, and `seed` matter.
    #[arg(long)]
    pub(crate) expert: bool,
    /// Only this blueprint: an id or a name such as scorpion, a file, or a folder of files; may be repeated.
    #[arg(long, value_name = "FILE|ID", conflicts_with = "split")]
    pub(crate) blueprint: Vec<OsString>,
    /// All blueprints of this split: train, test, test-literal, test-longest, test-tallest, or validation; may be
    /// repeated [default: the splits of the run's last evaluation, without validation unless it is the only one; of the
    /// shipped policy, the paper's].
    #[arg(long, value_name = "SPLIT")]
    pub(crate) split: Vec<Split>,
    /// Episodes per blueprint and action mode.
    #[arg(long, value_name = "N", default_value_t = 40, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub(crate) episodes: u32,
    /// Also run reset-free sequences: 50 runs over 10 goals of at least 12 blocks, or as many as the run's evaluator is
    /// configured for.
    #[arg(long)]
    pub(crate) reset_free: bool,
    /// Threads [default: one per core].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=64))]
    pub(crate) threads: Option<u16>,
    /// Set one key of the run's configuration, for example evaluator.episodes.starts=mixed; may be repeated.
    #[arg(long, value_name = "KEY=VALUE")]
    pub(crate) set: Vec<String>,
    /// Also print how the episodes ended, by number of blocks.
    #[arg(long, conflicts_with = "json")]
    pub(crate) endings: bool,
    /// Print every blueprint, not only the groups and the worst blueprints.
    #[arg(long)]
    pub(crate) verbose: bool,
    /// Print the report as JSON.
    #[arg(long)]
    pub(crate) json: bool,
}

impl RunArgs {
    /// The configuration overrides of these flags.
    pub fn overrides(&self) -> Vec<Override> {
        self.steps.map(|steps| Override::flag("--steps", "n_env_steps", steps)).into_iter().collect()
    }
}

impl PageArgs {
    /// The configuration override of this flag.
    pub fn overrides(&self) -> Option<Override> {
        self.web.map(|address| Override::flag("--web", "dashboard.web.listen", address.to_string()))
    }
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;

    #[test]
    fn the_command_line_contradicts_itself_nowhere() {
        Cli::command().debug_assert();
    }

    #[test]
    fn examples_are_commands() {
        let program = Cli::command();
        for command in [&program].into_iter().chain(program.get_subcommands()) {
            let Some(help) = command.get_after_help() else { continue };
            for example in help.to_string().lines().skip(1) {
                let words = example.trim().split("  ").next().unwrap().split(' ');
                match Cli::try_parse_from(words) {
                    Ok(_) => {}
                    Err(error) => assert_eq!(error.kind(), ErrorKind::DisplayHelp, "{example}: {error}"),
                }
            }
        }
    }

    #[test]
    fn threads_are_numbers_wherever_episodes_are_played() {
        for command in [
            &["eval", "--pretrained"][..],
            &["eval", "--expert"],
            &["record", "--pretrained", "--blueprint", "2_000", "--out", "played"],
        ] {
            // Clap checks an argument's type only when it reads the argument.
            let words = ["lodestone"].iter().chain(command).chain(&["--threads", "2"]);
            assert!(Cli::try_parse_from(words).is_ok(), "{command:?}");
        }
    }
}
