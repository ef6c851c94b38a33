//! Settings of the curriculum.

use blueprints::N_BLOCKS;
use serde::{Deserialize, Serialize};

use proto::InvalidSetting;

use super::check;

/// The rule that turns successes into task probabilities.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub enum CurriculumConfig {
    /// All training blueprints alike.
    Uniform(UniformConfig),
    /// The paper's: the less often one succeeds, the likelier (appendix "Curriculum").
    Paper(PaperConfig),
    /// Those that succeed about every other time are the likeliest: p(1 − p).
    Learnability(LearnabilityConfig),
    /// All up to a number of blocks that grows with success, every number of blocks alike.
    Widening(WideningConfig),
}

/// Settings of the uniform curriculum: none.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct UniformConfig {}

/// Settings of the paper's curriculum.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PaperConfig {
    /// Weight of one episode in a blueprint's success rate; above 0, at most 1, default 0.2.
    pub tau: f64,
    /// Temperature of the softmax over failure rates; above 0, default 0.5.
    pub temperature: f64,
    /// All rates are multiplied by this once a batch, so that nothing is forgotten; above 0, at most 1, default 0.99.
    pub decay: f64,
    /// Finished episodes in a batch, which sets the strength of the decay; 1..=65536, default 64.
    pub episodes_per_batch: usize,
}

/// Settings of the learnability curriculum.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LearnabilityConfig {
    /// Weight of one episode in a blueprint's success rate; above 0, at most 1, default 0.05.
    pub tau: f64,
    /// Share of goals drawn from all blueprints alike; above 0, at most 1, default 0.15.
    pub uniform: f64,
    /// Finished episodes between two changes of the probabilities; 1..=65536, default 64.
    pub episodes_per_batch: usize,
}

/// Settings of the widening curriculum.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WideningConfig {
    /// Weight of one episode in a blueprint's success rate; above 0, at most 1, default 0.2.
    pub tau: f64,
    /// Most blocks at first, at least 2; default 4.
    pub first_size: usize,
    /// The next larger blueprints come in when those with `first_size` blocks, and each larger number in use, succeed as
    /// often as this in the mean; above 0, at most 1, default 0.6.
    pub gate: f64,
    /// Finished episodes between two changes of the probabilities; 1..=65536, default 64.
    pub episodes_per_batch: usize,
}

impl Default for CurriculumConfig {
    fn default() -> Self {
        Self::Paper(PaperConfig::default())
    }
}

impl Default for PaperConfig {
    fn default() -> Self {
        Self { tau: 0.2, temperature: 0.5, decay: 0.99, episodes_per_batch: 64 }
    }
}

impl Default for LearnabilityConfig {
    fn default() -> Self {
        Self { tau: 0.05, uniform: 0.15, episodes_per_batch: 64 }
    }
}

impl Default for WideningConfig {
    fn default() -> Self {
        Self { tau: 0.2, first_size: 4, gate: 0.6, episodes_per_batch: 64 }
    }
}

impl CurriculumConfig {
    /// Checks the ranges of the chosen rule.
    ///
    /// # Errors
    /// The first field out of range.
    pub fn validate(&self) -> Result<(), InvalidSetting> {
        match self {
            Self::Uniform(_) => Ok(()),
            Self::Paper(paper) => {
                check_share("curriculum.tau", paper.tau)?;
                check_share("curriculum.decay", paper.decay)?;
                let temperature = paper.temperature;
                check("curriculum.temperature", temperature, temperature > 0.0 && temperature.is_finite(), "above 0")?;
                check_batch(paper.episodes_per_batch)
            }
            Self::Learnability(learnability) => {
                check_share("curriculum.tau", learnability.tau)?;
                check_share("curriculum.uniform", learnability.uniform)?;
                check_batch(learnability.episodes_per_batch)
            }
            Self::Widening(widening) => {
                check_share("curriculum.tau", widening.tau)?;
                check_share("curriculum.gate", widening.gate)?;
                let first = widening.first_size;
                check("curriculum.first_size", first as f64, (2..=N_BLOCKS).contains(&first), "2..=16")?;
                check_batch(widening.episodes_per_batch)
            }
        }
    }

    /// Finished episodes between two changes of the probabilities.
    pub(crate) fn episodes_per_batch(&self) -> usize {
        match self {
            Self::Uniform(_) => 1,
            Self::Paper(paper) => paper.episodes_per_batch,
            Self::Learnability(learnability) => learnability.episodes_per_batch,
            Self::Widening(widening) => widening.episodes_per_batch,
        }
    }
}

fn check_share(field: &'static str, value: f64) -> Result<(), InvalidSetting> {
    check(field, value, value > 0.0 && value <= 1.0, "above 0 and at most 1")
}

fn check_batch(episodes: usize) -> Result<(), InvalidSetting> {
    check("curriculum.episodes_per_batch", episodes as f64, (1..=65536).contains(&episodes), "1..=65536")
}
