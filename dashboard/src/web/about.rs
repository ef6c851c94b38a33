//! Summary of the shown run: its name, target, and what the page offers.

use std::sync::Arc;

use blueprints::{BlueprintId, Catalog};
use render::picture::GRIPPER_COLORS;
use serde::Serialize;
use serde_json::{Value, json};

/// The kind of page.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// A run in progress.
    Training,
    /// A policy playing episodes, without a learner or actors.
    Play,
    /// A finished run, read from its files.
    Finished,
}

/// Summary of a run.
#[derive(Clone, Debug, Serialize)]
pub struct About {
    /// The kind of page.
    pub kind: Kind,
    /// Name of the run.
    pub run: String,
    /// The preset that the run was started with, if any.
    pub preset: Option<String>,
    /// Environment steps after which the run ends, if known.
    pub n_env_steps: Option<u64>,
    /// The goals shown first; empty for the whole catalog.
    pub blueprints: Vec<BlueprintId>,
    /// The goals that the run trains on; empty if they are not known.
    pub trained: Vec<BlueprintId>,
    /// All goals available for selection.
    #[serde(skip)]
    pub catalog: Arc<Catalog>,
    /// What the page says when nothing serves it any longer.
    pub farewell: Farewell,
    /// What produced the run: its settings, and what else is known; `null` if it is no run.
    pub origin: Value,
    /// Successes and episodes of the played policy by action mode and number of blocks; `null` if they are not known.
    pub success: Value,
}

/// The last words of a page.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Farewell {
    /// What has ended: `the run`, `the evaluator`, or `the program`.
    pub ended: &'static str,
    /// The command that shows the same again, for a shell in the folder where the program was started; `None` if there
    /// is none.
    pub command: Option<String>,
}

/// The first goal of a playing policy if none is configured: sixteen blocks.
const FIRST: &str = "16_002";

impl About {
    /// Returns the first goal of a playing policy.
    pub(super) fn first(&self) -> BlueprintId {
        let first = || FIRST.parse().expect("the catalog has it");
        self.blueprints.first().cloned().unwrap_or_else(first)
    }
}

/// Returns the path prefix of the run with index `place`.
pub(super) fn base(place: usize) -> String {
    if place == 0 { String::new() } else { format!("/runs/{place}") }
}

/// Returns the response to `/api/about`; `runs` are the names of all runs of the page, which may be those of a sweep.
pub(super) fn about(about: &About, can_play: bool, runs: &[String], is_of_sweep: bool) -> Value {
    let runs: Vec<Value> =
        runs.iter().enumerate().map(|(place, name)| json!({ "name": name, "base": base(place) })).collect();
    let mut answer = json!(about);
    answer["schema_version"] = 1.into();
    answer["first"] = json!(about.first());
    answer["can_play"] = can_play.into();
    answer["gripper_colors"] = json!(GRIPPER_COLORS);
    answer["runs"] = runs.into();
    answer["is_of_sweep"] = is_of_sweep.into();
    answer
}
