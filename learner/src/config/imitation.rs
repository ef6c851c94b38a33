//! Settings for learning from the expert's labels.

use proto::setting::above;
use proto::settings;

use super::Schedule;

settings! {
    /// Imitation of the expert's labels, alone or together with PPO: every gradient step minimizes one weighted sum.
    pub struct ImitationConfig {
        /// Weight of the imitation loss. At 0, no labels are drawn.
        pub weight: Schedule = Schedule::Constant(1.0), in 0.0..=100.0;
        /// Weight of PPO's policy loss and entropies. Adam's steps do not shrink with it, so the learning rate must be
        /// low enough for the policy when this rises above 0.
        pub ppo_weight: Schedule = Schedule::Constant(0.0), in 0.0..=100.0;
        /// Factor of the value loss. It can rise before `ppo_weight`, so that the critic knows the policy's returns
        /// when PPO begins. While `ppo_weight` and `weight` are 0, only the value head is trained.
        pub value_weight: Schedule = Schedule::Constant(0.0), in 0.0..=100.0;
        /// Weight of KL(imitator ‖ policy) on PPO's samples, where the imitator is the policy frozen when this weight
        /// was first above 0.
        pub kl_weight: Schedule = Schedule::Constant(0.0), in 0.0..=100.0;
        /// Weight of the move loss relative to the block-choice loss.
        pub move_weight: f32 = 20.0, in 0.0..;
        /// Weight of the negative log-likelihood of the labels' moves, nats per entry, which trains the standard
        /// deviations with the means held fixed. Above 0, the policy's noise becomes as large as its errors.
        pub scale_weight: Schedule = Schedule::Constant(0.0), in 0.0..=100.0;
        /// Errors of a move's entries are squared below this and linear above.
        pub move_delta: f32 = 0.1, in above(0.0);
        /// Scenes per gradient step.
        pub minibatch_size: usize = 256, in 1..=65536;
        /// Gradient steps with labels per update, rounded. They are combined with PPO's steps; if PPO takes fewer, the
        /// rest follow on their own.
        pub steps_per_update: Schedule = Schedule::Constant(32.0), in 1.0..=65536.0;
        /// Replay buffer of labeled scenes.
        pub replay: ReplayConfig;
    }

    /// Settings of the replay buffer of labeled scenes.
    pub struct ReplayConfig {
        /// Maximum number of scenes. Each takes about 1.3 KB, both in memory and in a checkpoint.
        pub capacity_steps: usize = 60_000, in 1024..;
        /// Goals with n blocks are drawn in proportion to n to this power; at 0, all sizes are equally likely.
        pub size_power: f64 = 1.0, in -4.0..=4.0;
    }
}
