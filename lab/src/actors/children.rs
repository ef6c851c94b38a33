//! Child processes of this program that end with their owner.

use std::io::{BufRead, BufReader, Write};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc;
use std::time::Duration;

use anyhow::Context;
use serde::Serialize;

use super::parts::Note;

/// A child process that runs a command of this program.
#[derive(Debug)]
pub(super) struct Part {
    child: Child,
    /// Closing it tells the process to exit.
    stdin: Option<ChildStdin>,
    notes: mpsc::Receiver<String>,
    name: String,
}

impl Part {
    /// Starts this program with `role` as its command.
    pub(super) fn start(name: impl Into<String>, role: &str) -> anyhow::Result<Self> {
        let name = name.into();
        let program = std::env::current_exe().context("finding this program")?;
        let mut command = Command::new(program);
        command.arg(role).stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut child = command.spawn().with_context(|| format!("starting the {name}"))?;
        let stdin = child.stdin.take();
        let stdout = child.stdout.take().context("a child has a stdout")?;
        let (sender, notes) = mpsc::channel();
        std::thread::spawn(move || {
            for line in BufReader::new(stdout).lines() {
                let Ok(line) = line else { return };
                if sender.send(line).is_err() {
                    return;
                }
            }
        });
        Ok(Self { child, stdin, notes, name })
    }

    pub(super) fn pid(&self) -> u32 {
        self.child.id()
    }

    pub(super) fn tell(&mut self, what: &impl Serialize) -> anyhow::Result<()> {
        let line = serde_json::to_string(what).context("a plan is JSON")?;
        let stdin = self.stdin.as_mut().with_context(|| format!("the {} was told to end", self.name))?;
        writeln!(stdin, "{line}").with_context(|| format!("the {} has ended", self.name))
    }

    /// Waits for the process's next note.
    pub(super) fn hear(&self, patience: Duration) -> anyhow::Result<Note> {
        let line = self.notes.recv_timeout(patience).map_err(|error| match error {
            mpsc::RecvTimeoutError::Timeout => anyhow::anyhow!("the {} said nothing for {patience:?}", self.name),
            mpsc::RecvTimeoutError::Disconnected => {
                anyhow::anyhow!("the {} has ended early; stderr says why", self.name)
            }
        })?;
        serde_json::from_str(&line).with_context(|| format!("reading what the {} says", self.name))
    }

    /// Returns an error if the process has exited.
    pub(super) fn check(&mut self) -> anyhow::Result<()> {
        let ended = self.child.try_wait().with_context(|| format!("asking for the {}", self.name))?;
        ended.map_or(Ok(()), |status| anyhow::bail!("the {} has ended early: {status}", self.name))
    }

    /// Closes stdin and waits for the process to exit.
    pub(super) fn join(mut self) -> anyhow::Result<()> {
        self.stdin = None;
        let status = self.child.wait().with_context(|| format!("waiting for the {}", self.name))?;
        anyhow::ensure!(status.success(), "the {} failed: {status}", self.name);
        Ok(())
    }
}

impl Drop for Part {
    fn drop(&mut self) {
        // Both calls fail only if the process has already exited, which is fine.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
