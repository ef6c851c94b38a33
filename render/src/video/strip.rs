//! An episode as one picture: the goal, then the world from the first scene to the last.

use proto::Status;

use super::episode::Episode;
use super::frames::captioned;
use super::stage::{SETTLING_STEPS, Stage};
use crate::picture::text::{GRAY, INK};
use crate::picture::{Image, Painter, View, WHITE, draw_blueprint};

/// Number of pictures in a row.
const N_COLUMNS: usize = 4;

/// Space between pictures, and height of the text below each, in pixels.
const GAP: usize = 8;
const FOOT: usize = 26;

/// Draws pictures in rows of four: the goal, then `n_frames` (at least 2) pictures of the world. The image is `width`
/// pixels wide (at least 480).
pub fn strip(episode: &Episode, n_frames: usize, width: usize) -> Image {
    let n_frames = n_frames.max(2);
    let tile = (width.max(super::MIN_WIDTH) - (N_COLUMNS - 1) * GAP) / N_COLUMNS;
    let height = tile * 2 / 3;
    let n_rows = (n_frames + 1).div_ceil(N_COLUMNS);
    let full_height = n_rows * (height + FOOT + GAP) - GAP;
    let mut image = Image::filled(N_COLUMNS * (tile + GAP) - GAP, full_height, WHITE);
    let mut painter = Painter::default();
    let corner = |i: usize| [i % N_COLUMNS * (tile + GAP), i / N_COLUMNS * (height + FOOT + GAP)];
    let inside = [tile - 2, height - 2];
    let goal = draw_blueprint(&mut painter, episode.goal(), View::FrontQuarter, inside);
    captioned(&mut image, corner(0), &goal, &format!("goal: {}", episode.goal().id()), INK);
    let stage = Stage::new(episode, inside);
    let n_links = episode.goal().links().len();
    for i in 0..n_frames {
        let n_done = i * episode.n_steps() / (n_frames - 1);
        let is_last = i + 1 == n_frames;
        // The last picture shows the scene after the camera has settled.
        let settled = if is_last { SETTLING_STEPS } else { 0 };
        let picture = stage.picture(&mut painter, &episode.scenes()[n_done], (n_done + settled) as f32);
        let end = if is_last && episode.status() == Status::Success { ", success" } else { "" };
        let step = episode.first_step() + n_done;
        let words = format!("step {step}: {}/{n_links} connected{end}", episode.n_connected(n_done));
        captioned(&mut image, corner(i + 1), &picture, &words, GRAY);
    }
    image
}
