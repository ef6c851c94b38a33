//! Follows the connections of an episode.

use proto::{Joint, Observation, Scene};

/// The connections of an episode so far.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Connections {
    /// Correct connections in the newest scene.
    n_right: u32,
    /// Steps since their number last grew.
    pub(crate) steps_since_gain: u32,
    /// Wrong connections that formed.
    pub(crate) n_wrong: u32,
    /// Correct connections that broke.
    pub(crate) n_broken: u32,
    /// Wrong connections after the newest step.
    pub(crate) n_wrong_left: u32,
    /// Correct connections missing after the newest step.
    pub(crate) n_missing: u32,
}

impl Connections {
    pub(crate) fn new(start: Observation<'_>) -> Self {
        let n_right = count(start.scene, |joint| joint.is_right(start.blueprint));
        Self { n_right, steps_since_gain: 0, n_wrong: 0, n_broken: 0, n_wrong_left: 0, n_missing: 0 }
    }

    /// Counts what a step from the scene `before` changed.
    pub(crate) fn note(&mut self, before: &Scene, Observation { scene, blueprint }: Observation<'_>) {
        let is_new = |joint: &Joint| !before.joints.contains(joint);
        self.n_wrong += count(scene, |joint| is_new(joint) && !joint.is_right(blueprint));
        self.n_broken += count(before, |joint| !scene.joints.contains(joint) && joint.is_right(blueprint));
        let n_right = count(scene, |joint| joint.is_right(blueprint));
        self.steps_since_gain = if n_right > self.n_right { 0 } else { self.steps_since_gain + 1 };
        self.n_right = n_right;
        self.n_wrong_left = scene.joints.len() as u32 - n_right;
        self.n_missing = blueprint.links().len() as u32 - n_right;
    }
}

fn count(scene: &Scene, wanted: impl Fn(&Joint) -> bool) -> u32 {
    scene.joints.iter().filter(|joint| wanted(joint)).count() as u32
}
