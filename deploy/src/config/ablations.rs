//! The paper's ablations, as settings that are put over any preset.

use super::{ConfigError, Override, nearest, suggestion_or};

/// A named change of a few settings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ablation {
    /// Name on the command line.
    pub name: &'static str,
    /// What it changes, in one line.
    pub about: &'static str,
    /// The settings, each as given to `--set`.
    settings: &'static [&'static str],
}

/// All ablations, in the order of the paper.
pub const ABLATIONS: &[Ablation] = &[
    Ablation {
        name: "no-attention",
        about: "every edge of the graph has the same weight",
        settings: &["policy.network.encoder.attention=false"],
    },
    Ablation {
        name: "resnet",
        about: "a residual network on the flattened features instead of a graph",
        settings: &["policy.network.encoder={kind=\"resnet\"}"],
    },
    Ablation {
        name: "single-gripper",
        about: "one gripper",
        settings: &["environment.n_grippers=1", "policy.features.n_grippers=1"],
    },
    Ablation {
        name: "no-curriculum",
        about: "all goals are equally likely from the first step",
        settings: &["learner.curriculum={kind=\"uniform\"}"],
    },
    Ablation {
        name: "no-blueprint-resets",
        about: "no episode begins with another blueprint standing",
        settings: &["actor.tasks.prebuilt_probability=0.0"],
    },
    Ablation {
        name: "transition-delay",
        about: "a gripper rests for two steps when it goes to another block",
        settings: &["environment.transition_delay_steps=2"],
    },
    Ablation {
        name: "single-blueprint",
        about: "learns one blueprint alone, 6_000",
        settings: &[
            "actor.tasks.filter={blueprints=[\"6_000\"]}",
            "learner.curriculum={kind=\"uniform\"}",
            "evaluator.selection.blueprints=[\"6_000\"]",
            "evaluator.selection.splits=[\"train\"]",
        ],
    },
];

impl Ablation {
    /// Finds an ablation by name.
    ///
    /// # Errors
    /// Names the existing ablations.
    pub fn find(name: &str) -> Result<&'static Self, ConfigError> {
        ABLATIONS.iter().find(|ablation| ablation.name == name).ok_or_else(|| {
            let known: Vec<&str> = ABLATIONS.iter().map(|ablation| ablation.name).collect();
            let others = format!("; there are {}", known.join(", "));
            let suggestion = suggestion_or(&nearest(name, known.iter().copied()), &others);
            ConfigError::at(format_args!("ablation={name}"), format_args!("there is no such ablation{suggestion}"))
        })
    }

    /// Its settings, and its name as the run's.
    ///
    /// # Errors
    /// Never for the ablations of this module.
    pub fn overrides(&self) -> Result<Vec<Override>, ConfigError> {
        let origin = format!("--ablation {}", self.name);
        let own = self.settings.iter().map(|text| Ok(Override { origin: origin.clone(), ..Override::parse(text)? }));
        own.chain([Ok(Override::flag(&origin, "bus.run", self.name))]).collect()
    }
}
