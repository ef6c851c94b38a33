//! `play`: a web page on which a policy builds.

use std::io::IsTerminal;
use std::net::{Ipv4Addr, SocketAddr};
use std::process::{Command, Stdio};
use std::sync::Arc;

use blueprints::{BlueprintId, Catalog, N_BLOCKS, Split};
use dashboard::{About, Farewell, Kind, Page};
use proto::{Valid, Weights};
use tokio_util::sync::CancellationToken;

use super::goals::{Goals, run_of};
use super::models::{Source, pretrained_success};
use super::{common::join_bus, services};
use crate::cli::PlayArgs;
use crate::config::{Config, Override};
use crate::exit::Failure;
use crate::live::Terminal;
use crate::shell;

/// Name of the run and of its only service.
const NAME: &str = "play";

/// The configuration of a run that consists of the evaluator only, for the blueprints `named`, or for all.
pub(super) fn configure(source: &Source, named: &[BlueprintId], args: &PlayArgs) -> Result<Valid<Config>, Failure> {
    let page = args.web.unwrap_or_else(|| SocketAddr::from((Ipv4Addr::LOCALHOST, 0)));
    let mut overrides = vec![
        Override::flag("play", "bus.run", NAME),
        Override::flag("--web", "dashboard.web.listen", page.to_string()),
    ];
    if !named.is_empty() {
        let ids: Vec<String> = named.iter().map(ToString::to_string).collect();
        let splits: Vec<String> = Split::ALL.iter().map(ToString::to_string).collect();
        overrides.push(Override::flag("ID", "evaluator.selection.blueprints", ids));
        // Regardless of what the policy was evaluated on during training.
        overrides.push(Override::flag("ID", "evaluator.selection.splits", splits));
        overrides.push(Override::flag("ID", "evaluator.selection.sizes", vec![2, N_BLOCKS as i64]));
    }
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
    let weights = Arc::new(published(source, config, &goals.catalog)?);
    let page = Page::bind(&services::web(config).expect("`configure` asks for a page")).await?;
    services::tell_page(Some(&page), terminal);
    if !args.no_open {
        open(&format!("http://{}", page.address()));
    }
    let run = args.checkpoint.as_deref().and_then(run_of);
    // So that the first episode does not wait for the bus.
    let first = Some(weights.clone());
    terminal.print("Ctrl-C ends");
    let Some(bus) = join_bus(&config.part(|config| &config.bus), &shutdown).await? else { return Ok(()) };
    let publisher = bus.weights_publisher().await?;
    publisher.publish(weights).await?;
    let setup = services::evaluator_setup(config, NAME.to_owned(), None, &goals.catalog);
    let opened = services::Opened { page, about: about(args, goals), first, run };
    let ended = services::show(setup, opened, &bus, shutdown).await;
    bus.close().await;
    ended
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
    [shell::program(), "play".to_owned()]
        .into_iter()
        .chain(checkpoint)
        .chain(ids)
        .chain(files)
        .collect::<Vec<_>>()
        .join(" ")
}

/// The weights as a learner would publish them, with task probabilities: here uniform over all evaluated goals.
fn published(source: Source, config: &Config, catalog: &Catalog) -> Result<Weights, Failure> {
    let selected = config.evaluator.selection.select(catalog);
    let goals = selected.map_err(|error| Failure::Usage(error.to_string()))?;
    let share = 1.0 / goals.len().max(1) as f32;
    let task_probabilities = goals.iter().map(|goal| (goal.id().clone(), share)).collect();
    Ok(Weights { task_probabilities, ..source.model.weights })
}
