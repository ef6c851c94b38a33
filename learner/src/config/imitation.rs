//! What is learned from the expert's labels.

use proto::setting::above;
use proto::settings;

use super::Schedule;

settings! {
    /// Learning from the expert's labels, alone or together with PPO: every gradient step minimizes one weighted sum.
    pub struct ImitationConfig {
        /// Weight of the imitation loss. At 0 no labels are drawn.
        pub weight: Schedule = Schedule::Constant(1.0), in 0.0..=100.0;
        /// Weight of PPO's policy loss and entropies.
        pub ppo_weight: Schedule = Schedule::Constant(0.0), in 0.0..=100.0;
        /// Factor of the value loss. It may rise before `ppo_weight`, so that the critic knows the policy's returns
        /// when PPO begins. While `ppo_weight` and `weight` are 0, it trains the value head alone.
        pub value_weight: Schedule = Schedule::Constant(0.0), in 0.0..=100.0;
        /// Weight of KL(imitator ‖ policy) on PPO's samples, where the imitator is the policy when this first was above
        /// 0.
        pub kl_weight: Schedule = Schedule::Constant(0.0), in 0.0..=100.0;
        /// Weight of the loss of moves against that of block choices.
        pub move_weight: f32 = 20.0, in 0.0..;
        /// Weight of the negative log-likelihood of the labels' moves under the standard deviations, nats per entry; the
        /// means are held fixed in it. Above 0 the policy's noise becomes as large as its errors.
        pub scale_weight: Schedule = Schedule::Constant(0.0), in 0.0..=100.0;
        /// Errors of a move's entries count by their square below this and by their size above.
        pub move_delta: f32 = 0.1, in above(0.0);
        /// Scenes of one gradient step.
        pub minibatch_size: usize = 256, in 1..=65536;
        /// Gradient steps with labels in an update. PPO's steps carry them while any are left; if PPO has fewer, the rest
        /// follow by themselves.
        pub steps_per_update: usize = 32, in 1..=65536;
        /// Where labeled scenes are kept.
        pub replay: ReplayConfig;
    }

    /// The store of labeled scenes.
    pub struct ReplayConfig {
        /// Most scenes. One takes about 1.3 KB, in memory and in a checkpoint.
        pub capacity_steps: usize = 60_000, in 1024..;
        /// Goals of n blocks are drawn in proportion to n to this power: 0 for all sizes alike.
        pub size_power: f64 = 1.0, in -4.0..=4.0;
    }
}
