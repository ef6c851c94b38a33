//! Errors of blueprint files.

use crate::assembly::impossible;
use crate::strength::Load;

/// An error in a blueprint's text or structure. Blocks are named as in the file.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the fields are the values that the messages show")]
pub enum BlueprintError {
    /// The text is not that of a blueprint, or blocks overlap, repel, or are not connected as it says.
    #[error("{0}")]
    Invalid(String),
    /// The structure would tip over.
    #[error(
        "the structure tips over: its center of mass is {} of what it stands on, and must be at least {min_u} u inside; \
         put more of its lowest layer under it",
        from_edge(*.margin_u)
    )]
    Unsupported { margin_u: f64, min_u: f64 },
    /// A connection carries too much load.
    #[error(
        "the connection of {a:?} and {b:?} carries {:.1} N and {:.2} N m; {n_pairs} magnet pair(s) may carry {} N and \
         {:.2} N m",
        .load.force_n,
        .load.torque_nm,
        .load.max_force_n,
        .load.max_torque_nm
    )]
    Overloaded { a: String, b: String, n_pairs: usize, load: Load },
    /// No assembly order was found; `gave_up` says that there may be one.
    #[error(
        "{} so that all stands and each block has a straight way in: blocks {blocks:?} are never reached",
        impossible(*gave_up)
    )]
    NoAssembly { blocks: Vec<String>, gave_up: bool },
}

impl BlueprintError {
    pub(crate) fn out_of_range(block: &str, at: [i64; 3]) -> Self {
        Self::Invalid(format!("block {block:?}: cell {at:?} is outside -64..=64"))
    }

    pub(crate) fn bad_axes(block: &str, axes: &str) -> Self {
        Self::Invalid(format!("block {block:?}: axes {axes:?} are not two different axes like \"+x +y\""))
    }
}

/// Describes where a center of mass is relative to the edge of the support polygon.
fn from_edge(margin_u: f64) -> String {
    let side = if margin_u < 0.0 { "outside" } else { "inside" };
    format!("{:.2} u {side} the outline", margin_u.abs())
}

/// A [`BlueprintError`] and the file that caused it.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{file}: {error}")]
pub struct BlueprintFileError {
    /// Name of the file.
    pub file: String,
    /// The error.
    #[source]
    pub error: BlueprintError,
}
