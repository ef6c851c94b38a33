//! Settings of the curriculum.

use proto::setting::above;
use proto::settings;

settings! {
    /// The rule that turns success rates into task probabilities.
    pub enum CurriculumConfig = Paper {
        /// All training blueprints are equally likely.
        Uniform(UniformConfig),
        /// The paper's rule: the less often a blueprint succeeds, the likelier it is (appendix "Curriculum").
        Paper(PaperConfig),
    }

    /// Settings of the uniform curriculum (none).
    pub struct UniformConfig {}

    /// Settings of the paper's curriculum.
    pub struct PaperConfig {
        /// Temperature of the softmax over failure rates.
        pub temperature: f64 = 0.5, in above(0.0);
    }
}
