//! Videos of episodes: trajectories → frames → bytes of a file, with no I/O and no clock.
//!
//! Reading order: `collect` (segments → whole trajectories) → `episode` (one to show) → `stage` (an episode seen through
//! a camera that follows the construction) → `video` (frames with the goal and the score next to the world) → `mp4` and
//! `gif` (frames → bytes) → `strip` (an episode as one picture) → `attention` and `heads` (a policy's attention in an
//! episode).

mod attention;
mod collect;
mod episode;
mod frames;
mod gif;
mod heads;
mod mp4;
mod stage;
mod strip;
#[cfg(test)]
mod tests;

pub use attention::{AttentionError, EpisodeAttention, Shares};
pub use collect::Collector;
pub use episode::{Episode, OtherGoal, STEP_S};
pub use frames::{LAST_S, MAX_WIDTH, MIN_WIDTH, Video};
pub use gif::{MAX_GIF_FPS, gif};
pub use heads::{AttentionVideo, attention_strip};
pub use mp4::mp4;
pub use strip::strip;

/// Maximum frame rate of a video, frames per second.
pub const MAX_FPS: u32 = 60;

/// Errors of encoding a video.
#[derive(Debug, thiserror::Error)]
pub enum VideoError {
    /// There are no frames.
    #[error("a video needs at least one frame")]
    NoFrames,
    /// The format does not support the frame rate, but one up to the second number.
    #[error("{0} frames a second is not in 1..={1}")]
    Rate(u32, u32),
    /// Frames have odd or different widths and heights; chroma is coded for squares of four pixels.
    #[error("frames of {0} × {1} pixels; both must be even and the same in all frames")]
    Size(usize, usize),
    /// The encoder rejected a frame.
    #[error("encoding H.264: {0}")]
    Encoder(#[from] openh264::Error),
    /// The encoder skipped a frame.
    #[error("the encoder gave nothing for frame {0}")]
    Dropped(usize),
    /// The frames could not be written as MP4.
    #[error("writing MP4: {0}")]
    Container(#[from] muxide::api::MuxerError),
    /// The frames could not be written as GIF.
    #[error("writing GIF: {0}")]
    Gif(#[from] ::gif::EncodingError),
}
