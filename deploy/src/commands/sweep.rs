//! `sweep`: trains the points of a grid or of a random search, with several seeds each, and compares them.

mod axes;
mod plan;
mod pool;
mod results;
mod scores;
mod statistics;
mod tables;

use std::path::{Path, PathBuf};

use anyhow::anyhow;
use tokio::runtime::Handle;
use tokio_util::sync::CancellationToken;

use super::common::serve_command;
use crate::cli::SweepArgs;
use crate::exit::Failure;
use crate::live::Terminal;
use crate::shell;
use plan::{Plan, Run};
use pool::Pool;
pub(super) use results::Results;
use results::RunResult;

/// Runs the subcommand.
pub(super) async fn run(args: &SweepArgs, terminal: &Terminal, shutdown: CancellationToken) -> Result<(), Failure> {
    let said = if args.json || args.slurm { terminal.on_stderr() } else { terminal.clone() };
    let (folder, plan) = match (&args.dir, &args.out) {
        (Some(folder), _) => (folder.clone(), Plan::read(folder)?),
        (None, Some(out)) => {
            let Some(plan) = Plan::of(args, terminal)? else { return Ok(()) };
            plan.keep(out)?;
            (out.clone(), plan)
        }
        (None, None) => return Err(Failure::Usage("give --out DIR, or the folder of a sweep".to_owned())),
    };
    let runs = plan.runs(&folder);
    if args.slurm {
        terminal.print(&script(&folder, runs.len(), args.jobs)?);
        return Ok(());
    }
    let chosen = match (&args.dir, args.only, args.jobs) {
        (Some(_), None, None) => Vec::new(),
        (_, Some(only), _) => {
            let n_runs = runs.len();
            let no_run = || Failure::Usage(format!("--only {only}: the sweep has {n_runs} runs, from 0 on"));
            vec![(only, runs.into_iter().nth(only).ok_or_else(no_run)?)]
        }
        (_, None, _) => runs.into_iter().enumerate().collect(),
    };
    let only = args.only.and_then(|_| chosen.first().map(|(_, run)| run.clone()));
    train(&plan, unfinished(chosen)?, usize::from(args.jobs.unwrap_or(1)), &said, &shutdown).await?;
    if let Some(run) = only {
        // The others have processes of their own.
        return match RunResult::read(&run)? {
            Some(RunResult::Failed { .. }) => Err(Failure::Service(anyhow!("the run failed"))),
            _ => Ok(()),
        };
    }
    let mut results = Results::of(&plan, &folder)?;
    if args.json {
        results = results.with_curves()?;
        super::common::json(&results, terminal)?;
    } else {
        terminal.print(&format!("\n{}", results.markdown().trim_end()));
    }
    if results.done(1).is_ok() {
        said.print(&format!("page with curves: {}", serve_command(std::slice::from_ref(&folder))));
    }
    match results.n_missing() {
        (0, 0) => Ok(()),
        (0, n) => {
            said.print(&format!(
                "{n} runs are not finished; go on with `{} sweep {} --jobs 1`",
                shell::program(),
                shell::path(&folder)
            ));
            Ok(())
        }
        (n, _) => Err(Failure::Service(anyhow!("{n} of {} runs failed", plan.points.len() * plan.seeds.len()))),
    }
}

/// The results of the sweep in the folder, with curves; `None` if it is no sweep.
pub(super) fn results(folder: &Path) -> Result<Option<Results>, Failure> {
    crate::run_dir::check_exists(folder)?;
    if !folder.join(plan::FILE).exists() {
        return Ok(None);
    }
    Results::of(&Plan::read(folder)?, folder)?.with_curves().map(Some)
}

/// The runs that have no result, or one that may be better the next time.
fn unfinished(runs: Vec<(usize, Run)>) -> Result<Vec<(usize, Run)>, Failure> {
    let mut left = Vec::new();
    for (index, run) in runs {
        if !matches!(RunResult::read(&run)?, Some(RunResult::Done { .. })) {
            left.push((index, run));
        }
    }
    Ok(left)
}

async fn train(
    plan: &Plan,
    runs: Vec<(usize, Run)>,
    n_jobs: usize,
    terminal: &Terminal,
    shutdown: &CancellationToken,
) -> anyhow::Result<()> {
    let (stdin, open) = std::io::pipe()?;
    let runtime = Handle::current();
    let pool = Pool { plan: plan.clone(), terminal: terminal.clone(), shutdown: shutdown.clone(), runtime, stdin };
    let mut training = tokio::task::spawn_blocking(move || pool.train(&runs, n_jobs));
    tokio::select! {
        ended = &mut training => return ended?,
        () = shutdown.cancelled() => drop(open),
    }
    training.await?
}

/// A job array for Slurm, one task for each run.
fn script(folder: &Path, n_runs: usize, n_jobs: Option<u16>) -> Result<String, Failure> {
    let absolute = |path: &Path| std::path::absolute(path).map_err(|error| Failure::Service(error.into()));
    let program = std::env::current_exe().map_err(|error| Failure::Service(error.into()))?;
    let (folder, program): (PathBuf, _) = (absolute(folder)?, shell::path(&program));
    let at_a_time = n_jobs.map_or_else(String::new, |n| format!("%{n}"));
    let last = n_runs.saturating_sub(1);
    let output = shell::path(&folder.join("slurm-%A-%a.log"));
    let folder = shell::path(&folder);
    Ok(format!(
        "#!/usr/bin/env bash\n\
         # Trains a sweep, one run a task. A task that is preempted saves and comes back by itself; submitted again, the\n\
         # array goes on with what is not finished. The options of sbatch come before these: sbatch --time=8:00:00.\n\
         #SBATCH --job-name=lodestone-sweep\n\
         #SBATCH --array=0-{last}{at_a_time}\n\
         #SBATCH --ntasks=1\n\
         #SBATCH --cpus-per-task=2\n\
         #SBATCH --output={output}\n\
         #SBATCH --requeue\n\
         #SBATCH --open-mode=append\n\
         #SBATCH --signal=B:TERM@60\n\
         exec {program} sweep {folder} --only \"$SLURM_ARRAY_TASK_ID\"\n"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_array_has_a_task_for_each_run() {
        let text = script(Path::new("/sweeps/a b"), 6, Some(2)).unwrap();
        assert!(text.contains("#SBATCH --array=0-5%2\n"), "{text}");
        assert!(text.ends_with("sweep '/sweeps/a b' --only \"$SLURM_ARRAY_TASK_ID\"\n"), "{text}");
        assert!(script(Path::new("/x"), 1, None).unwrap().contains("--array=0-0\n"));
    }
}
