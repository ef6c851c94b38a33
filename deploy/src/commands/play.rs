//! `play`: a web page on which a policy builds.

use std::io::IsTerminal;
use std::process::{Command, Stdio};
use std::sync::Arc;

use dashboard::config::WebConfig;
use dashboard::{About, Farewell, Finished, Kind, ShownRun};
use proto::Valid;
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

use super::goals::{Goals, run_of};
use super::models::{Source, pretrained_success};
use super::services;
use super::stage::stage;
use crate::cli::PlayArgs;
use crate::config::{Config, Override};
use crate::exit::Failure;
use crate::live::Terminal;
use crate::shell;

/// The configuration of the worlds and of the page.
pub(super) fn configure(source: &Source, args: &PlayArgs) -> Result<Valid<Config>, Failure> {
    let page = args.web.unwrap_or(WebConfig::default().listen);
    let mut overrides = vec![Override::flag("--web", "dashboard.web.listen", page.to_string())];
    for text in &args.set {
        overrides.push(Override::parse(text)?);
    }
    source.config(&overrides)
}

/// Serves the page until `shutdown`.
pub(super) async fn run(
    source: Source,
    goals: &Goals,
    config: &Valid<Config>,
    args: &PlayArgs,
    terminal: &Terminal,
    shutdown: CancellationToken,
) -> Result<(), Failure> {
    let page = services::page(config).await?.expect("`configure` asks for a page");
    services::tell_page(Some(&page), terminal);
    if !args.no_open {
        open(&format!("http://{}", page.address()));
    }
    terminal.print("Ctrl-C ends");
    let weights = watch::channel(Some(Arc::new(source.model.weights))).1;
    let policy = config.part(|config| &config.policy);
    let run = args.checkpoint.as_deref().and_then(run_of);
    let stage = Some(stage(Config::evaluation_environment(config), policy.clone(), weights.clone(), run));
    let (evaluations, learner) = (Vec::new(), Vec::new());
    let first = ShownRun { about: about(args, goals), evaluations, learner, run: None, policy, weights, stage };
    page.show(Finished { first, others: Vec::new(), sweep: None }, shutdown).await?;
    Ok(())
}

/// Opens the page in a browser, where a person at a terminal has one.
fn open(address: &str) {
    let has_display = ["DISPLAY", "WAYLAND_DISPLAY"].iter().any(|name| std::env::var_os(name).is_some());
    if !std::io::stdout().is_terminal() || !(has_display || cfg!(target_os = "macos")) {
        return;
    }
    let program = if cfg!(target_os = "macos") { "open" } else { "xdg-open" };
    let mut command = Command::new(program);
    command.arg(address).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    // It may go on for as long as the browser does.
    std::thread::spawn(move || command.status());
}

/// Describes the page, which shows no training here.
fn about(args: &PlayArgs, goals: &Goals) -> About {
    let run = match &args.checkpoint {
        None => "the policy that comes with the program".to_owned(),
        Some(path) => path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned(),
    };
    About {
        kind: Kind::Play,
        run,
        preset: None,
        n_env_steps: None,
        blueprints: goals.ids.clone(),
        trained: Vec::new(),
        catalog: goals.catalog.clone(),
        farewell: Farewell { ended: "the program", command: Some(command(args)) },
        origin: serde_json::Value::Null,
        success: args.checkpoint.is_none().then(pretrained_success).unwrap_or_default(),
    }
}

/// The command that plays the same policy and goals.
fn command(args: &PlayArgs) -> String {
    let checkpoint = args.checkpoint.iter().flat_map(|path| ["--checkpoint".to_owned(), shell::path(path)]);
    let ids = args.ids.iter().map(|id| shell::path(id.as_ref()));
    let files = args.blueprint.iter().flat_map(|file| ["--blueprint".to_owned(), shell::path(file.as_ref())]);
    shell::command("play", checkpoint.chain(ids).chain(files))
}
