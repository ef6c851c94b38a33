//! Sample evaluations for tests, also of other crates.

use blueprints::{BlueprintId, Split};
use proto::metrics::{EvalBlueprint, EvalOutcome, METRICS_SCHEMA_VERSION};
use proto::wilson::SuccessRate;
use proto::{RewardTerms, WeightsVersion};
use runlog::Evaluation;

/// Returns an outcome with this many successes in ten episodes and plausible other values.
pub(crate) fn outcome(n_successes: u64) -> EvalOutcome {
    EvalOutcome {
        success: SuccessRate::new(n_successes, 10),
        stable_success: SuccessRate::new(n_successes / 2, 10),
        mean_steps: 63.7,
        mean_steps_to_success: (n_successes > 0).then_some(21.3),
        mean_return: RewardTerms { connected: 1.3, wrong: -0.1, magnets: 0.07, blocks: 0.0, force: -1e-9 },
        n_diverged: (10 - n_successes) / 5,
    }
}

/// Returns an evaluation of blueprints given as id, split, size, and successes in ten greedy episodes, without sampled
/// ones.
pub(crate) fn evaluation(n_env_steps: u64, scores: &[(&str, Split, u64, u64)]) -> Evaluation {
    let weights_version = WeightsVersion(n_env_steps / 10);
    let score = |&(id, split, n_blocks, n_successes): &(&str, Split, u64, u64)| EvalBlueprint {
        schema_version: METRICS_SCHEMA_VERSION,
        weights_version,
        n_env_steps,
        blueprint: BlueprintId::try_from(id.to_owned()).unwrap(),
        split,
        n_blocks,
        sampled: EvalOutcome::default(),
        greedy: outcome(n_successes),
    };
    Evaluation {
        ended_unix_ms: 1_767_225_600_123 + n_env_steps,
        elapsed_s: 12.25,
        weights_version,
        n_env_steps,
        seed: 3,
        blueprints: scores.iter().map(score).collect(),
        reset_free: None,
    }
}
