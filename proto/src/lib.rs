//! All that two processes must agree on: the plain validated types, their wire form, the key expressions and the bus.

pub mod scene;
pub mod step;
pub mod trajectory;
pub mod weights;

pub use scene::{Gripper, Joint, N_GRIPPERS, Pose, Scene};
pub use step::{Action, Move, RewardTerms, Status};
pub use trajectory::{ActorId, Outcome, Start, Task, Trajectory, Transition};
pub use weights::{Normalisation, Weights, WeightsVersion};
