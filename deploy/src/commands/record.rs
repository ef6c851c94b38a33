//! `record`: records episodes as trajectories.

use std::fs;
use std::path::Path;

use anyhow::Context;
use evaluator::report::{End, EpisodeResult};
use evaluator::{EpisodeConfig, EvalSetup, EvaluationProgress, Follower, Performer, Selection, record};
use parking_lot::Mutex;
use proto::codec::encode_recording;
use proto::{ActionMode, Trajectory};
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

use super::common::n_threads;
use super::files::write_file;
use super::goals::{Goals, is_path};
use super::models::Source;
use crate::cli::RecordArgs;
use crate::config::{Config, Override};
use crate::exit::Failure;
use crate::live::{self, Terminal};
use crate::shell;

struct Recording<'a> {
    folder: &'a Path,
    n_files: u64,
    n_diverged: u64,
    failure: Option<Failure>,
}

/// Runs the episodes and writes each when it ends. After `shutdown`, the episodes that have ended are kept.
pub(super) async fn run(args: &RecordArgs, terminal: &Terminal, shutdown: &CancellationToken) -> Result<(), Failure> {
    let overrides: Vec<Override> = args.set.iter().map(|text| Override::parse(text)).collect::<Result<_, _>>()?;
    Override::only_in(&["environment", "policy"], &overrides)?;
    // The expert acts in the world of the shipped policy.
    let source = Source::of(args.checkpoint.as_deref())?;
    let config = source.config(&overrides)?;
    let goals = Goals::open_beside(&args.goals.blueprint, args.checkpoint.as_deref())?;
    goals.tell_choices(terminal);
    let selection = Selection { splits: args.goals.split.clone(), ..Selection::default() };
    let blueprints = goals.or_selected(&selection)?;
    let performer =
        if args.expert { Performer::Expert } else { Performer::Policy(&source.model.policy, &source.model.weights) };
    let acting = if args.sampled { ActionMode::Sampled } else { ActionMode::Greedy };
    create(&args.out)?;
    let setup = EvalSetup {
        catalog: &goals.catalog,
        environment: Config::evaluation_environment(&config),
        episodes: EpisodeConfig {
            n_episodes: args.episodes,
            starts: args.start,
            n_threads: n_threads(args.threads),
            ..EpisodeConfig::default()
        },
        reset_free: None,
        // One world per thread: in a batch of several, rounding makes actions depend on which worlds share the batch,
        // and that depends on timing.
        n_worlds: 1,
        seed: args.seed,
    };
    let (progress, counted) = watch::channel(None);
    let counting = tokio::spawn(live::show_episodes(counted, "recorded", terminal.on_stderr(), || true));
    let stop = shutdown.child_token();
    let recording = Mutex::new(Recording { folder: &args.out, n_files: 0, n_diverged: 0, failure: None });
    let follower = Follower { keep_going: &|| !stop.is_cancelled(), progress: Some(&progress), endings: None };
    let on_episode = |idx: usize, trajectory: Trajectory, result: &EpisodeResult| {
        if !recording.lock().keep(idx, &trajectory, result) {
            stop.cancel();
        }
    };
    let played = record(&setup, performer, acting, &blueprints, &follower, &on_episode);
    let EvaluationProgress { n_ended, n_planned, .. } = progress.borrow().unwrap_or_default();
    drop(progress);
    counting.await?;
    let recording = recording.into_inner();
    let said = recording.said(args);
    if let Some(failure) = recording.failure {
        return Err(failure);
    }
    let is_complete = played.map_err(anyhow::Error::from)?;
    terminal.print(&said);
    if is_complete { Ok(()) } else { Err(Failure::Interrupted(n_ended, n_planned)) }
}

fn create(folder: &Path) -> Result<(), Failure> {
    if folder.exists() {
        return Err(Failure::Input(format!("{} exists already; nothing was written", folder.display())));
    }
    fs::create_dir_all(folder).with_context(|| format!("cannot make the folder {}", folder.display()))?;
    Ok(())
}

impl Recording<'_> {
    /// Writes an episode, unless it diverged or an earlier write failed. Returns whether all writes have succeeded.
    fn keep(&mut self, idx: usize, trajectory: &Trajectory, result: &EpisodeResult) -> bool {
        if result.end == End::Diverged {
            self.n_diverged += 1;
        } else if self.failure.is_none() {
            self.failure = self.write(idx, trajectory).err().map(Failure::from);
            tracing::debug!(blueprint = %result.blueprint, "an episode was kept");
        }
        self.failure.is_none()
    }

    /// Names the file by the episode's place in the plan: episodes do not end in that order.
    fn write(&mut self, idx: usize, trajectory: &Trajectory) -> anyhow::Result<()> {
        let name = format!("{idx:05}-{}.trajectory", trajectory.task.blueprint);
        write_file(&self.folder.join(name), &encode_recording(trajectory))?;
        self.n_files += 1;
        Ok(())
    }

    /// A summary of the recording and a command that shows it.
    fn said(&self, args: &RecordArgs) -> String {
        let left_out = match self.n_diverged {
            0 => String::new(),
            n => format!(", {n} more diverged and are left out"),
        };
        // `render` finds the user's own blueprints in the same files.
        let own = args.goals.blueprint.iter().filter(|name| is_path(name));
        let own: String = own.map(|path| format!(" --blueprint {}", shell::path(Path::new(path)))).collect();
        format!(
            "{} episodes{left_out}\nlodestone render {}/*.trajectory{own} --out videos",
            self.n_files,
            shell::path(self.folder)
        )
    }
}
