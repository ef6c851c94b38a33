//! Settings of the curriculum.

use blueprints::N_BLOCKS;
use proto::setting::{above, above_to};
use proto::settings;

settings! {
    /// The rule that turns successes into task probabilities.
    pub enum CurriculumConfig = Paper {
        /// All training blueprints alike.
        Uniform(UniformConfig),
        /// The paper's: the less often one succeeds, the likelier (appendix "Curriculum").
        Paper(PaperConfig),
        /// Those that succeed about every other time are the likeliest: p(1 − p).
        Learnability(LearnabilityConfig),
        /// All up to a number of blocks that grows with success, every number of blocks alike.
        Widening(WideningConfig),
    }

    /// Settings of the reverse curriculum (an extension): goals of every size begin with one block taken off, and with
    /// one more whenever the episodes that begin with the most succeed often enough.
    #[derive(Copy)]
    pub struct ReverseConfig {
        /// Weight of one episode in the success rate.
        pub tau: f64 = 0.05, in above_to(0.0, 1.0);
        /// Success rate from which on one more block is taken off.
        pub gate: f64 = 0.7, in above_to(0.0, 1.0);
    }

    /// Settings of the uniform curriculum: none.
    pub struct UniformConfig {}

    /// Settings of the paper's curriculum.
    pub struct PaperConfig {
        /// Weight of one episode in a blueprint's success rate.
        pub tau: f64 = 0.2, in above_to(0.0, 1.0);
        /// Temperature of the softmax over failure rates.
        pub temperature: f64 = 0.5, in above(0.0);
        /// All rates are multiplied by this once a batch, so that nothing is forgotten.
        pub decay: f64 = 0.99, in above_to(0.0, 1.0);
        /// Finished episodes in a batch, which sets the strength of the decay.
        pub episodes_per_batch: usize = 64, in 1..=65536;
    }

    /// Settings of the learnability curriculum.
    pub struct LearnabilityConfig {
        /// Weight of one episode in a blueprint's success rate.
        pub tau: f64 = 0.05, in above_to(0.0, 1.0);
        /// Share of goals drawn from all blueprints alike.
        pub uniform: f64 = 0.15, in above_to(0.0, 1.0);
        /// Finished episodes between two changes of the probabilities.
        pub episodes_per_batch: usize = 64, in 1..=65536;
    }

    /// Settings of the widening curriculum.
    pub struct WideningConfig {
        /// Weight of one episode in a blueprint's success rate.
        pub tau: f64 = 0.2, in above_to(0.0, 1.0);
        /// Most blocks at first.
        pub first_size: usize = 4, in 2..=N_BLOCKS;
        /// The next larger blueprints come in when those with `first_size` blocks, and each larger number in use,
        /// succeed as often as this in the mean.
        pub gate: f64 = 0.6, in above_to(0.0, 1.0);
        /// Share of the draws of a number of blocks in which a blueprint is the likelier the more often it fails; in the
        /// others all are alike.
        pub failures: f64 = 0.0, in 0.0..=1.0;
        /// Finished episodes between two changes of the probabilities.
        pub episodes_per_batch: usize = 64, in 1..=65536;
    }
}

impl CurriculumConfig {
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
