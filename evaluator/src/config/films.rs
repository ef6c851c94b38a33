//! Settings of the films of an evaluator's evaluations.

use blueprints::{BlueprintId, Catalog};
use serde::{Deserialize, Serialize};

use super::{EvaluatorConfigError, check};
use blueprints::Group;
use render::video::{MAX_FPS, MAX_WIDTH, MIN_WIDTH};

/// Which episodes of an evaluation become films, and how. Only an evaluator that keeps records makes any.
///
/// They are made by default, because numbers do not say what a policy does wrong, and cost little: two films for each
/// group and evaluation, each about a second on one core.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FilmsConfig {
    /// Groups of blueprints, by their names in reports; none twice. Default: all.
    pub groups: Vec<Group>,
    /// Blueprints of which films are made besides; none twice. Default: none.
    pub blueprints: Vec<BlueprintId>,
    /// Successes, and as many failures, that an evaluation films of each of those, 0 to 10; the first ones with the first
    /// way of acting. Default 1.
    pub n_of_each: u32,
    /// Width of the frames in pixels, 480 to 1920. Default 640.
    pub width: usize,
    /// Frames per second, 1 to 60; a second has ten steps of the world. Default 20.
    pub fps: u32,
    /// Films of one blueprint that are kept, as many of successes and of failures, 1 to 10 000; older ones are removed with
    /// their recordings. Default 10.
    pub keep: usize,
    /// Room for small films for TensorBoard in megabytes, 0 to 10 000; when it is used up the older half goes. 0 makes none.
    /// Default 64.
    pub tensorboard_mb: u64,
}

impl Default for FilmsConfig {
    fn default() -> Self {
        Self {
            groups: Group::ALL.to_vec(),
            blueprints: Vec::new(),
            n_of_each: 1,
            width: 640,
            fps: 20,
            keep: 10,
            tensorboard_mb: 64,
        }
    }
}

impl FilmsConfig {
    /// Whether any film is asked for.
    pub fn any(&self) -> bool {
        self.n_of_each > 0 && !(self.groups.is_empty() && self.blueprints.is_empty())
    }

    /// Checks every field against its documented range.
    ///
    /// # Errors
    /// Names the first field that is out of range, or a blueprint that there is not.
    pub fn validate(&self) -> Result<(), EvaluatorConfigError> {
        check("films.groups", &self.groups, are_distinct(&self.groups), "names of groups, none twice")?;
        check("films.blueprints", &self.blueprints, are_distinct(&self.blueprints), "names of blueprints, none twice")?;
        if let Some(unknown) = self.blueprints.iter().find(|id| Catalog::builtin().get(id).is_none()) {
            return Err(EvaluatorConfigError::UnknownBlueprint(unknown.clone()));
        }
        check("films.n_of_each", self.n_of_each, self.n_of_each <= 10, "0..=10")?;
        check("films.width", self.width, (MIN_WIDTH..=MAX_WIDTH).contains(&self.width), "480..=1920")?;
        check("films.fps", self.fps, (1..=MAX_FPS).contains(&self.fps), "1..=60")?;
        check("films.keep", self.keep, (1..=10_000).contains(&self.keep), "1..=10000")?;
        check("films.tensorboard_mb", self.tensorboard_mb, self.tensorboard_mb <= 10_000, "0..=10000")
    }
}

fn are_distinct<T: PartialEq>(items: &[T]) -> bool {
    (1..items.len()).all(|i| !items[..i].contains(&items[i]))
}
