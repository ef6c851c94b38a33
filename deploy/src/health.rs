//! Health of services: a service writes its state to a file, and `healthcheck` reads it.
//!
//! A file needs no port, no credentials, and no shell, so it works for containers, batch jobs, and people alike.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::anyhow;
use blueprints::outside;
use bus::{Bus, JoinCounts, unix_ms};
use dashboard::waits;
use proto::metrics::NotSaved;
use serde::{Deserialize, Serialize};
use tokio::sync::watch;
use tokio::task::JoinHandle;

use crate::exit::Failure;
use crate::replace::{PLAIN, replace_unsynced};

/// Time between writes of the state.
const PERIOD: Duration = Duration::from_secs(2);

/// A state older than this means that the process hangs or is gone.
const MAX_AGE: Duration = Duration::from_secs(15);

/// A main loop that makes no progress for this long hangs. The largest updates on slow machines take a minute.
const MAX_IDLE: Duration = Duration::from_secs(300);

/// Maximum size of a state in bytes; it has about 200.
const MAX_BYTES: u64 = 1 << 16;

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct State {
    /// Role of the service, for example `actor`.
    pub(crate) role: String,
    pub(crate) pid: u32,
    /// When this state was written, in milliseconds since 1970.
    pub(crate) unix_ms: u64,
    /// Whether the process reaches a router, or is one.
    pub(crate) connected: bool,
    /// Seconds since the main loop last made progress; 0 while it waits for other processes.
    pub(crate) idle_s: f64,
    /// Of a router with keys: what became of connections to it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) joins: Option<JoinCounts>,
    /// Why the service waits, if nothing can be saved.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) not_saved: Option<NotSaved>,
}

/// Writes the state of this process to a file, and removes the file when dropped.
#[derive(Debug)]
pub(crate) struct Reporter {
    bus: watch::Sender<Option<Bus>>,
    /// The file and the task that writes it.
    writing: Option<(PathBuf, JoinHandle<()>)>,
}

impl Reporter {
    /// Starts writing, if a file is given.
    pub(crate) fn start(role: &str, file: Option<&Path>) -> Result<Self, Failure> {
        let (sender, bus) = watch::channel(None);
        let Some(path) = file.map(Path::to_owned) else { return Ok(Self { bus: sender, writing: None }) };
        let role = role.to_owned();
        write(&path, &state(&role, false, Duration::ZERO))
            .map_err(|error| Failure::Usage(format!("--health-file: cannot write {}: {error}", path.display())))?;
        let its_path = path.clone();
        let task = tokio::spawn(async move {
            let mut is_written = true;
            loop {
                let session = bus.borrow().clone();
                let state = match session {
                    None => state(&role, false, Duration::ZERO),
                    Some(bus) => {
                        let state = state(&role, bus.is_connected().await, bus.pulse().age());
                        State { joins: bus.joins(), not_saved: bus.pulse().not_saved(), ..state }
                    }
                };
                // Logged once, because a disk may be full for hours.
                match write(&its_path, &state) {
                    Ok(()) => is_written = true,
                    Err(error) if is_written => {
                        is_written = false;
                        tracing::warn!(path = %its_path.display(), %error, "the state of health was not written");
                    }
                    Err(_) => {}
                }
                tokio::time::sleep(PERIOD).await;
            }
        });
        Ok(Self { bus: sender, writing: Some((path, task)) })
    }

    /// Reports on the service of this bus session from now on.
    pub(crate) fn joined(&self, bus: &Bus) {
        self.bus.send_replace(Some(bus.clone()));
    }
}

impl Drop for Reporter {
    fn drop(&mut self) {
        if let Some((file, task)) = &self.writing {
            task.abort();
            // Without the file, the process counts as gone, which it soon is.
            let _ = fs::remove_file(file);
        }
    }
}

/// Checks that the service that writes `file` is healthy: that its process is alive, its main loop makes progress, and,
/// unless `alive` is set, it reaches a router.
///
/// # Errors
/// [`Failure::Service`] with the reason.
pub(crate) fn check(file: &Path, alive: bool) -> Result<State, Failure> {
    let text = outside::read_text(file, MAX_BYTES)
        .map_err(|error| Failure::Service(anyhow!("no service reports at {}: {error}", file.display())))?;
    let state: State = serde_json::from_str(&text)
        .map_err(|error| Failure::Service(anyhow!("{} holds no state: {error}", file.display())))?;
    let role = &state.role;
    // A state from the future was left behind before the clock was set back.
    let age = Duration::from_millis(unix_ms().abs_diff(state.unix_ms));
    let reason = if age > MAX_AGE {
        format!("the {role} has given no sign of life for {} s", age.as_secs())
    } else if state.idle_s > MAX_IDLE.as_secs_f64() {
        format!("the {role}'s main loop has not turned for {:.0} s", state.idle_s)
    } else if !alive && !state.connected {
        format!("the {role} reaches no router")
    } else if let Some(not_saved) = state.not_saved.as_ref().filter(|_| !alive) {
        format!("{role}: {}", waits(not_saved))
    } else {
        return Ok(state);
    };
    Err(Failure::Service(anyhow!(reason)))
}

fn state(role: &str, connected: bool, idle: Duration) -> State {
    let pid = std::process::id();
    let idle_s = idle.as_secs_f64();
    State { role: role.to_owned(), pid, unix_ms: unix_ms(), connected, idle_s, joins: None, not_saved: None }
}

/// Replaces the file, so that no reader sees a partial state. A power loss ends the process too, so the disk need not be
/// waited for every time.
fn write(path: &Path, state: &State) -> io::Result<()> {
    replace_unsynced(path, &serde_json::to_vec(state)?, PLAIN)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn verdict(state: &State, alive: bool) -> Option<String> {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("health");
        write(&file, state).unwrap();
        check(&file, alive).err().map(|failure| failure.to_string())
    }

    #[test]
    fn a_service_is_well_while_it_lives_turns_and_is_connected() {
        let well = state("actor", true, Duration::from_secs(299));
        assert_eq!(verdict(&well, false), None);
        let gone = State { unix_ms: unix_ms() - 16_000, ..well.clone() };
        assert_eq!(verdict(&gone, true).unwrap(), "the actor has given no sign of life for 16 s");
        let from_tomorrow = State { unix_ms: unix_ms() + 86_400_000, ..well.clone() };
        assert!(verdict(&from_tomorrow, true).unwrap().starts_with("the actor has given no sign of life"));
        let hangs = State { idle_s: 301.0, ..well.clone() };
        assert_eq!(verdict(&hangs, true).unwrap(), "the actor's main loop has not turned for 301 s");
        let reason = "cannot write run/metrics.jsonl".to_owned();
        let waits = State { not_saved: Some(NotSaved { since_unix_ms: 0, reason }), ..well.clone() };
        assert_eq!(verdict(&waits, true), None, "a restart would lose more");
        let expected = "actor: training waits: not saved since 1970-01-01 00:00 UTC: cannot write run/metrics.jsonl";
        assert_eq!(verdict(&waits, false).unwrap(), expected);
        let lost = State { connected: false, ..well };
        assert_eq!(verdict(&lost, true), None);
        assert_eq!(verdict(&lost, false).unwrap(), "the actor reaches no router");
    }

    #[test]
    fn nobody_reports_before_the_start_or_with_nonsense() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("health");
        assert!(check(&file, true).unwrap_err().to_string().contains("no service reports"));
        fs::write(&file, "{").unwrap();
        assert!(check(&file, true).unwrap_err().to_string().contains("holds no state"));
    }

    #[tokio::test]
    async fn the_file_is_there_as_long_as_the_service() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("health");
        let reporter = Reporter::start("router", Some(&file)).unwrap();
        let message = check(&file, false).unwrap_err().to_string();
        assert_eq!(message, "the router reaches no router");
        assert_eq!(check(&file, true).unwrap().pid, std::process::id());
        drop(reporter);
        assert!(!file.exists());
    }
}
