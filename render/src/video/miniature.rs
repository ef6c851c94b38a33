//! An episode as a small GIF of bounded size, for TensorBoard and other places that keep many of them.

use super::VideoError;
use super::episode::{Episode, STEP_S};
use super::frames::{HAIRLINE, INK, ending, goal_picture};
use super::gif::gif;
use super::stage::{SETTLING_STEPS, Stage};
use crate::picture::text::{Type, write};
use crate::picture::{Image, Painter, WHITE};

/// Width and height in pixels.
pub const MINIATURE_PX: [usize; 2] = [320, 200];

/// Maximum size of the GIF in bytes.
pub const MAX_MINIATURE_BYTES: usize = 400_000;

/// Frames per second: half of the steps.
const FPS: u32 = 5;

/// Maximum number of frames before the last one.
const MAX_FRAMES: usize = 60;

/// Number of frames of the last scene, while the camera moves closer.
const LAST_FRAMES: usize = 6;

/// Height of the line of text, and size of the goal in the upper right corner.
const FOOT_PX: usize = 20;
const GOAL_PX: [usize; 2] = [84, 72];

/// Encodes the episode as a GIF of [`MINIATURE_PX`] in at most [`MAX_MINIATURE_BYTES`]. While the GIF is too large, every
/// second frame is dropped; `None` if it never fits.
///
/// # Errors
/// Returns the errors of [`gif()`].
pub fn miniature(episode: &Episode) -> Result<Option<Vec<u8>>, VideoError> {
    let [width, height] = MINIATURE_PX;
    let stage = Stage::new(episode, [width, height - FOOT_PX]);
    let mut painter = Painter::default();
    let goal = goal_picture(&mut painter, episode, GOAL_PX);
    // Times are in steps here: each frame shows one step.
    let usual = (1.0 / STEP_S) as usize / FPS as usize;
    let mut every = usual.max(episode.n_steps().div_ceil(MAX_FRAMES)).max(1);
    loop {
        let before_last = (0..episode.n_steps()).step_by(every);
        let settling = (1..=LAST_FRAMES).map(|i| episode.n_steps() + i * SETTLING_STEPS / LAST_FRAMES);
        let times = before_last.chain(settling);
        let frames = times.map(|time| frame(episode, time, &goal, &stage, &mut painter));
        let gif = gif(frames, FPS)?;
        if gif.len() <= MAX_MINIATURE_BYTES {
            return Ok(Some(gif));
        }
        if every >= episode.n_steps() {
            return Ok(None);
        }
        every *= 2;
    }
}

/// Returns the frame at a time in steps; after the end, the last scene.
fn frame(episode: &Episode, time: usize, goal: &Image, stage: &Stage, painter: &mut Painter) -> Image {
    let n_done = time.min(episode.n_steps());
    let [width, height] = MINIATURE_PX;
    let mut image = Image::filled(width, height, WHITE);
    image.paste(&stage.picture(painter, &episode.scenes()[n_done], time as f32), 0, 0);
    let [goal_width, goal_height] = GOAL_PX;
    let left = width - goal_width;
    image.fill([left - 1, 0], [goal_width + 1, goal_height + 1], HAIRLINE);
    image.paste(goal, left, 0);
    let (end, color) = if n_done == episode.n_steps() { ending(episode.status()) } else { ("", INK) };
    let n_links = episode.goal().links().len();
    let connected = episode.n_connected(n_done);
    let words = format!(
        "{connected}/{n_links} step {} {:.1}",
        episode.first_step() + n_done,
        episode.return_after(n_done).total()
    );
    let top = height - FOOT_PX + 2;
    write(&mut image, [4, top], &words, Type::Small, INK);
    write(&mut image, [width.saturating_sub(Type::Small.width(end) + 4), top], end, Type::Small, color);
    image
}
