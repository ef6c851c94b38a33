//! What the page is about: which run, how far it is to go, and what can be asked.

use blueprints::{BlueprintId, Catalog};
use render::picture::GRIPPER_COLORS;
use serde::Serialize;
use serde_json::{Value, json};

/// Why there is a page.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// A run that goes on.
    Training,
    /// A policy is shown at work. There is no learner and no actor.
    Play,
    /// A run that has ended, as its files tell it.
    Finished,
}

/// A run in a few words.
#[derive(Clone, Debug)]
pub struct About {
    /// Why there is a page.
    pub kind: Kind,
    /// Name of the run.
    pub run: String,
    /// The preset that it was started with, if any.
    pub preset: Option<String>,
    /// Environment steps after which it ends, if that is known.
    pub n_env_steps: Option<u64>,
    /// The goals that are shown first; empty for the whole catalog.
    pub blueprints: Vec<BlueprintId>,
    /// All goals that can be chosen.
    pub catalog: Catalog,
}

/// What is built first where nobody has named a goal: sixteen blocks.
const FIRST: &str = "16_002";

impl About {
    /// What a policy that is shown at work builds first.
    pub(super) fn first(&self) -> BlueprintId {
        let first = || FIRST.parse().expect("the catalog has it");
        self.blueprints.first().cloned().unwrap_or_else(first)
    }
}

/// The answer to `/api/about`; `runs` are the names of all runs of the page.
pub(super) fn about(about: &About, can_play: bool, runs: &[String]) -> Value {
    let base = |place: usize| if place == 0 { String::new() } else { format!("/runs/{place}") };
    let runs: Vec<Value> =
        runs.iter().enumerate().map(|(place, name)| json!({ "name": name, "base": base(place) })).collect();
    json!({
        "schema_version": 1,
        "kind": about.kind,
        "run": about.run,
        "preset": about.preset,
        "n_env_steps": about.n_env_steps,
        "blueprints": about.blueprints,
        "first": about.first(),
        "can_play": can_play,
        "gripper_colors": GRIPPER_COLORS,
        "runs": runs,
    })
}
