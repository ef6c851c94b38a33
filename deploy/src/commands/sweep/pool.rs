//! Trains the runs of a sweep, each in a process of this program.

use std::fs::{self, File, TryLockError};
use std::io::PipeReader;
use std::process::Command;
use std::time::Duration;

use anyhow::Context;
use parking_lot::Mutex;
use runlog::RunPaths;
use tokio::runtime::Handle;
use tokio::time::sleep;
use tokio_util::sync::CancellationToken;

use super::plan::{Plan, Run};
use super::results::RunResult;
use crate::exit::INTERRUPTED;
use crate::live::Terminal;

/// Interval between checks of whether the process that trains a run has ended.
const LOOK_PERIOD: Duration = Duration::from_millis(100);

/// Trains runs, several at a time.
pub(super) struct Pool {
    pub(super) plan: Plan,
    pub(super) terminal: Terminal,
    pub(super) shutdown: CancellationToken,
    pub(super) runtime: Handle,
    /// The standard input of all processes. A training saves and ends when its other end is closed, so it also ends with
    /// this process, however that ends.
    pub(super) stdin: PipeReader,
}

impl Pool {
    /// Trains the runs with these indices, `n_jobs` at a time, until all have ended or `shutdown`.
    ///
    /// # Errors
    /// When a process cannot be started, or a result cannot be kept. A training that fails is a result.
    pub(super) fn train(&self, runs: &[(usize, Run)], n_jobs: usize) -> anyhow::Result<()> {
        let waiting = Mutex::new(runs.iter());
        let work = || -> anyhow::Result<()> {
            while !self.shutdown.is_cancelled() {
                let Some((index, run)) = waiting.lock().next() else { break };
                self.one(*index, run).inspect_err(|_| self.shutdown.cancel())?;
            }
            Ok(())
        };
        std::thread::scope(|scope| {
            let workers: Vec<_> = (0..n_jobs.min(runs.len())).map(|_| scope.spawn(work)).collect();
            let mut ended = Ok(());
            for worker in workers {
                ended = ended.and(worker.join().map_err(|_| anyhow::anyhow!("a thread of the sweep panicked"))?);
            }
            ended
        })
    }

    fn one(&self, index: usize, run: &Run) -> anyhow::Result<()> {
        let n_runs = self.plan.points.len() * self.plan.seeds.len();
        let point = self.plan.points[run.point].name();
        let say =
            |what: &str| self.terminal.print(&format!("[{}/{n_runs}] {point}, seed {}: {what}", index + 1, run.seed));
        let (config, settings) = self.plan.config(run)?;
        fs::create_dir_all(&run.folder).with_context(|| format!("making {}", run.folder.display()))?;
        let log = run.log();
        let output = File::options().create(true).append(true).open(&log);
        let output = output.with_context(|| format!("opening {}", log.display()))?;
        // A training of an earlier call may still be saving. It has this lock with its output, so from its first moment
        // on; one that was started by hand has that of the run.
        let lock = RunPaths::new(&run.folder).lock();
        let lock = File::create(&lock).with_context(|| format!("opening {}", lock.display()))?;
        let mut is_said = false;
        for file in [&output, &lock] {
            while let Err(error) = file.try_lock() {
                if let TryLockError::Error(error) = error {
                    return Err(error).context("locking a run");
                }
                if !std::mem::replace(&mut is_said, true) {
                    say("waiting for the process that trains it");
                }
                let pause = async { self.shutdown.run_until_cancelled(sleep(LOOK_PERIOD)).await };
                if self.runtime.block_on(pause).is_none() {
                    return Ok(());
                }
            }
        }
        drop(lock);
        // It says how the run failed before; most runs have none.
        drop(fs::remove_file(run.result()));
        let mut command = Command::new(std::env::current_exe().context("finding this program")?);
        for (name, _) in std::env::vars_os() {
            // The plan has taken in the settings among them.
            if name.as_encoded_bytes().starts_with(b"LODESTONE_") {
                command.env_remove(name);
            }
        }
        command.args(["train", "--auto-resume", "--no-web", "--end-with-stdin", "--seed", &run.seed.to_string()]);
        command.arg("--config").arg(config).arg("--run-dir").arg(&run.folder);
        command.stdin(self.stdin.try_clone()?).stdout(output.try_clone()?).stderr(output);
        let mut child = command.spawn().context("starting a training")?;
        say(&format!("training in {}", run.folder.display()));
        let status = child.wait().context("waiting for a training")?;
        let is_interrupted = self.shutdown.is_cancelled() || status.code() == Some(INTERRUPTED.into());
        if !status.success() && !is_interrupted {
            say(&format!("failed ({status}); see {}", log.display()));
            return RunResult::Failed { status: status.to_string() }.keep(run);
        }
        // A training that a signal ended had success as well.
        match RunResult::of_run(&run.folder, settings.n_env_steps)?.filter(|_| !is_interrupted) {
            Some(done) => {
                done.keep(run)?;
                say("done");
            }
            None => say("interrupted; the same command goes on with it"),
        }
        Ok(())
    }
}
