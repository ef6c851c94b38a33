//! Errors of commands and their exit codes.

use std::io;
use std::path::PathBuf;
use std::process::ExitCode;

use bus::{BusError, KeysError};
use dashboard::WebError;
use dashboard::terminal::WatchError;
use learner::{CheckpointError, Diverged, LearnerError};
use proto::SettingsDifference;
use runlog::HistoryError;
use tokio::task::JoinError;

use crate::config::ConfigError;

/// Exit code of a command that a signal ended early, as shells report it.
pub const INTERRUPTED: u8 = 130;

/// Files that a process must be allowed to open: `train` with a page has 26 open, and browsers, videos, and actors that
/// join need more. Libraries panic where a file cannot be opened, so this is checked before they start.
pub(crate) const MIN_FILES: u64 = 64;

/// A failed command.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// The command line contradicts itself in a way that the parser cannot detect; code 2.
    #[error("{0}")]
    Usage(String),
    /// The configuration cannot be used; code 64.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The page cannot be served at the configured address; code 64.
    #[error(transparent)]
    Page(#[from] WebError),
    /// The bus cannot be opened, or the connection was lost; code 65.
    #[error("{0:#}")]
    Bus(anyhow::Error),
    /// Blueprint files cannot be read or do not form a catalog; code 64.
    #[error(transparent)]
    Catalog(#[from] blueprints::CatalogError),
    /// A blueprint, a split, a recording, or a host that was named cannot be used, what a command makes of it cannot be
    /// written, or this process has other settings than its run; code 64.
    #[error("{0}")]
    Input(String),
    /// A checkpoint, a run directory, or a key file cannot be read or written; code 66.
    #[error("{0:#}")]
    Checkpoint(anyhow::Error),
    /// No policy can act with the weights of a file; code 66.
    #[error("{0:#}")]
    Weights(anyhow::Error),
    /// The evaluation history of a run cannot be read; code 66.
    #[error(transparent)]
    History(#[from] HistoryError),
    /// A run, a checkpoint, or a recording does not exist, or has nothing to show; code 66.
    #[error("{0}")]
    NothingToShow(String),
    /// A signal ended an evaluation or a recording; partial results have been printed or kept; code 130.
    #[error("interrupted after {0} of {1} episodes")]
    Interrupted(u64, u64),
    /// A signal ended a command before it had saved anything in its folder; code 130.
    #[error("interrupted; nothing was saved in {}", .0.display())]
    NothingWritten(PathBuf),
    /// The result of a command cannot be written to stdout; code 1.
    #[error("cannot write to stdout: {0}")]
    Output(io::Error),
    /// Training has diverged; code 67.
    #[error(
        "{0:#}; go on from there with `--resume` and other settings, for example a lower learner.optimizer.learning_rate"
    )]
    Diverged(anyhow::Error),
    /// The system allows this many open files, which are too few; code 71.
    #[error(
        "this process may have {0} files open at once, and needs {MIN_FILES}: raise the limit, for example with \
         `ulimit -n 1024`"
    )]
    FewFiles(u64),
    /// A signal ended a learner that was asked to say so; code 75.
    #[error("stopped before the run's {0} environment steps; what was learned is saved")]
    Unfinished(u64),
    /// A service failed while running, or is unhealthy; code 1.
    #[error("{0:#}")]
    Service(anyhow::Error),
}

impl From<BusError> for Failure {
    fn from(error: BusError) -> Self {
        match &error {
            // A file system that fails may work later, so this is not a setting that nobody can use.
            BusError::Keys(KeysError::Unreadable(_, cause)) if !is_lasting(cause.kind()) => {
                Self::Checkpoint(error.into())
            }
            BusError::Keys(_) => Self::Config(ConfigError::at("bus", error)),
            _ => Self::Bus(error.into()),
        }
    }
}

/// Whether a file that cannot be read for this reason stays so until somebody changes it.
fn is_lasting(kind: io::ErrorKind) -> bool {
    use io::ErrorKind::{InvalidData, IsADirectory, NotADirectory, NotFound, PermissionDenied};
    matches!(kind, NotFound | PermissionDenied | NotADirectory | IsADirectory | InvalidData)
}

impl From<WatchError> for Failure {
    fn from(error: WatchError) -> Self {
        match error {
            WatchError::NoTerminal => Self::Usage(error.to_string()),
            WatchError::Silent(_) => Self::NothingToShow(error.to_string()),
            WatchError::NoRouter(_) => Self::Bus(error.into()),
            WatchError::Bus(error) => error.into(),
            WatchError::Terminal(_) | WatchError::Panic(_) => Self::Service(error.into()),
        }
    }
}

impl From<JoinError> for Failure {
    fn from(panic: JoinError) -> Self {
        Self::Service(panic.into())
    }
}

impl From<anyhow::Error> for Failure {
    /// Determines the kind of failure from the error's causes.
    fn from(error: anyhow::Error) -> Self {
        let is_checkpoint = |cause: &(dyn std::error::Error + 'static)| {
            let of_learner = cause.downcast_ref::<LearnerError>();
            cause.is::<CheckpointError>()
                || cause.is::<HistoryError>()
                || matches!(
                    of_learner,
                    Some(LearnerError::Checkpoint(_) | LearnerError::Init(_) | LearnerError::Weights(_))
                )
        };
        if error.is::<Diverged>() {
            Self::Diverged(error)
        } else if error.chain().any(|cause| cause.is::<SettingsDifference>()) {
            Self::Input(format!("{error:#}"))
        } else if error.chain().any(is_checkpoint) {
            Self::Checkpoint(error)
        } else if error.chain().any(|cause| cause.is::<BusError>()) {
            Self::Bus(error)
        } else {
            Self::Service(error)
        }
    }
}

impl Failure {
    /// The process's exit code.
    pub fn exit_code(&self) -> ExitCode {
        ExitCode::from(match self {
            Self::Usage(_) => 2,
            Self::Config(_) | Self::Page(_) | Self::Catalog(_) | Self::Input(_) => 64,
            Self::Bus(_) => 65,
            Self::Checkpoint(_) | Self::Weights(_) | Self::History(_) | Self::NothingToShow(_) => 66,
            Self::Diverged(_) => 67,
            Self::FewFiles(_) => 71,
            Self::Unfinished(_) => 75,
            Self::Service(_) | Self::Output(_) => 1,
            Self::Interrupted(..) | Self::NothingWritten(_) => INTERRUPTED,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_process_with_other_settings_than_its_run_is_not_started_again() {
        let [theirs, own] = ["blueprint", "none"].map(|mask| {
            let policy = std::collections::BTreeMap::from([("mask", mask)]);
            proto::CanonicalSettings::default().with("policy", &policy)
        });
        let difference = theirs.difference(&own).unwrap();
        let error = evaluator::PolicyError::OtherSettings(proto::WeightsVersion(5), difference);
        let failure = Failure::from(anyhow::Error::new(actor::RolloutError::from(error)));
        assert_eq!(failure.exit_code(), ExitCode::from(64));
        let sentence =
            r#"weights 5 are of a run with other settings: policy.mask is "blueprint" there and "none" here"#;
        assert_eq!(failure.to_string(), sentence);
    }

    #[test]
    fn keys_on_a_file_system_that_fails_are_no_wrong_setting() {
        let code = |kind: io::ErrorKind| {
            let error = KeysError::Unreadable("keys/learner".into(), kind.into());
            Failure::from(BusError::Keys(error)).exit_code()
        };
        // Supervisors start again after 66, but not after 64.
        assert_eq!(code(io::ErrorKind::StaleNetworkFileHandle), ExitCode::from(66));
        assert_eq!(code(io::ErrorKind::NotFound), ExitCode::from(64));
    }
}
