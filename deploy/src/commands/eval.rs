//! `eval`: evaluates a policy or the expert on blueprints.

use std::time::Instant;

use blueprints::Split;
use evaluator::{
    Endings, EvalSetup, EvaluationProgress, EvaluatorConfig, Follower, N_WORLDS, Performer, Selection, evaluate, render,
};
use proto::Valid;
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

use super::common::{json, n_threads};
use super::goals::Goals;
use super::models::Source;
use crate::cli::EvalArgs;
use crate::config::{Config, DEFAULTS, Override, merge};
use crate::exit::Failure;
use crate::live::{self, Terminal};

/// What differs from the defaults in the expert's world: starts as in the table of results, and the seed of its figures.
const OF_EXPERT: &str = "seed = 0\nevaluator.episodes.starts = \"mixed\"";

/// Runs the episodes and prints the report; if `shutdown` comes first, the report of the episodes so far.
///
/// The world and the seed come from the configuration of the run that trained the policy, or from the defaults. So do,
/// without `--split`, the blueprints, which are those of the run's last evaluation; the shipped policy and the expert
/// get the paper's.
pub(super) async fn run(args: &EvalArgs, terminal: &Terminal, shutdown: &CancellationToken) -> Result<(), Failure> {
    let overrides: Vec<Override> = args.set.iter().map(|text| Override::parse(text)).collect::<Result<_, _>>()?;
    let source = if args.expert { None } else { Some(Source::of(args.checkpoint.as_deref())?) };
    let config = match &source {
        Some(source) => source.config(&overrides)?,
        None => config_of_expert(&overrides)?,
    };
    let selection = if !args.split.is_empty() {
        Selection { splits: args.split.clone(), ..Selection::default() }
    } else if args.checkpoint.is_none() {
        Selection::default()
    } else {
        final_selection(&config.evaluator)
    };
    let goals = Goals::open_beside(&args.blueprint, args.checkpoint.as_deref())?;
    goals.tell_choices(&terminal.on_stderr());
    let blueprints = goals.or_selected(&selection)?;
    let mut episodes = config.evaluator.episodes.clone();
    episodes.n_episodes = args.episodes;
    episodes.n_threads = n_threads(args.threads);
    let setup = EvalSetup {
        catalog: &goals.catalog,
        environment: Config::evaluation_environment(&config),
        episodes,
        reset_free: args.reset_free.then(|| config.evaluator.reset_free.clone().unwrap_or_default()),
        // The expert plans for each world separately, so more than one world per thread gains nothing.
        n_worlds: if args.expert { 1 } else { N_WORLDS },
        seed: config.seed,
    };
    let (progress, counted) = watch::channel(None);
    let counting = tokio::spawn(live::show_episodes(counted, "evaluated", terminal.on_stderr(), || true));
    let start = Instant::now();
    let endings = args.endings.then(Endings::default);
    let follower =
        Follower { keep_going: &|| !shutdown.is_cancelled(), progress: Some(&progress), endings: endings.as_ref() };
    let performer = match &source {
        Some(source) => Performer::Policy(&source.model.policy, &source.model.weights),
        None => Performer::Expert,
    };
    let report = evaluate(&setup, performer, &blueprints, &follower);
    let EvaluationProgress { n_ended, n_planned, .. } = progress.borrow().unwrap_or_default();
    drop(progress);
    counting.await?;
    let mut report = report.map_err(anyhow::Error::from)?;
    report.summary.elapsed_s = start.elapsed().as_secs_f64();
    if args.json {
        json(&report, terminal)?;
    } else {
        terminal.print(&render(&report, args.verbose));
        if let Some(endings) = endings {
            terminal.print(&endings.table());
        }
    }
    if report.summary.is_complete { Ok(()) } else { Err(Failure::Interrupted(n_ended, n_planned)) }
}

/// The default configuration with `overrides` applied.
fn config_of_expert(overrides: &[Override]) -> Result<Valid<Config>, Failure> {
    Override::only_in(&["environment", "evaluator", "seed"], overrides)?;
    let mut config = merge(OF_EXPERT, "the defaults", &DEFAULTS, overrides)?;
    // No policy acts here.
    config.policy.features.n_grippers = config.environment.n_grippers;
    Ok(config.checked()?)
}

/// The blueprints of the run's last evaluation. The validation split serves decisions during development, so it is
/// dropped, unless it is the only split or its blueprints are named: what remains by default are the paper's
/// blueprints.
fn final_selection(config: &EvaluatorConfig) -> Selection {
    let mut selection = config.last_selection();
    if selection.splits != [Split::Validation] && selection.blueprints.is_empty() {
        selection.splits.retain(|split| *split != Split::Validation);
    }
    selection
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn validation_is_evaluated_alone_or_by_name() {
        let splits = |splits: &[Split], last_splits: &[Split]| {
            let selection = Selection { splits: splits.to_vec(), ..Default::default() };
            let last_splits = last_splits.to_vec();
            final_selection(&EvaluatorConfig { selection, last_splits, ..Default::default() }).splits
        };
        assert_eq!(splits(&[Split::Train, Split::Validation], &[Split::Test]), [Split::Train, Split::Test]);
        assert_eq!(splits(&[Split::Validation], &[]), [Split::Validation]);
        let blueprints = vec!["validation_7_000".parse().unwrap()];
        let selection = Selection { splits: vec![Split::Train, Split::Validation], blueprints, ..Default::default() };
        let named = EvaluatorConfig { selection: selection.clone(), ..Default::default() };
        assert_eq!(final_selection(&named), selection);
    }
}
