//! Settings of the curriculum.

use blueprints::N_BLOCKS;
use proto::setting::{above, above_to};
use proto::settings;

settings! {
    /// The rule that turns success rates into task probabilities.
    pub enum CurriculumConfig = Paper {
        /// All training blueprints are equally likely.
        Uniform(UniformConfig),
        /// The paper's rule: the less often a blueprint succeeds, the likelier it is (appendix "Curriculum").
        Paper(PaperConfig),
        /// Blueprints that succeed about half the time are the likeliest: p(1 − p).
        Learnability(LearnabilityConfig),
        /// All blueprints up to a number of blocks that grows with success; all numbers of blocks are equally likely.
        Widening(WideningConfig),
    }

    /// Settings of the reverse curriculum (an extension): for each goal size, episodes begin with one block removed
    /// from the goal. One more block is removed whenever the episodes with the most blocks removed succeed often
    /// enough.
    #[derive(Copy)]
    pub struct ReverseConfig {
        /// Success rate at which one more block is removed.
        pub gate: f64 = 0.7, in above_to(0.0, 1.0);
    }

    /// Settings of the uniform curriculum (none).
    pub struct UniformConfig {}

    /// Settings of the paper's curriculum.
    pub struct PaperConfig {
        /// Temperature of the softmax over failure rates.
        pub temperature: f64 = 0.5, in above(0.0);
    }

    /// Settings of the learnability curriculum.
    pub struct LearnabilityConfig {
        /// Share of goals drawn uniformly from all blueprints.
        pub uniform: f64 = 0.15, in above_to(0.0, 1.0);
    }

    /// Settings of the widening curriculum.
    pub struct WideningConfig {
        /// Largest number of blocks in use at first.
        pub first_size: usize = 4, in 2..=N_BLOCKS;
        /// Mean success rate that blueprints with `first_size` blocks, and with each larger number in use, must reach
        /// before the next larger ones are added.
        pub gate: f64 = 0.6, in above_to(0.0, 1.0);
        /// Share of draws, within one number of blocks, in which blueprints are drawn in proportion to their failure
        /// rates; in the others, all are equally likely.
        pub failures: f64 = 0.0, in 0.0..=1.0;
    }
}
