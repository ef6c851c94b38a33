//! An episode as one picture: the goal, then the world from the first scene to the last.

use proto::Status;

use super::episode::Episode;
use super::frames::captioned;
use super::stage::{SETTLING_STEPS, Stage};
use crate::picture::text::{GRAY, INK};
use crate::picture::{Image, Painter, View, WHITE, draw_blueprint};

/// Number of scenes, which fill two rows together with the goal.
const N_SCENES: usize = 7;

/// Number of pictures in a row.
const N_COLUMNS: usize = 4;

/// Space between pictures, and height of the text below each, in pixels.
const GAP: usize = 8;
const FOOT: usize = 26;

/// Draws pictures in two rows of four: the goal, then seven pictures of the world. The image is `width` pixels wide (at
/// least 480).
pub fn strip(episode: &Episode, width: usize) -> Image {
    let tile = (width.max(super::MIN_WIDTH) - (N_COLUMNS - 1) * GAP) / N_COLUMNS;
    let height = tile * 2 / 3;
    let n_rows = (N_SCENES + 1) / N_COLUMNS;
    let full_height = n_rows * (height + FOOT + GAP) - GAP;
    let mut image = Image::filled(N_COLUMNS * (tile + GAP) - GAP, full_height, WHITE);
    let mut painter = Painter::default();
    let corner = |i: usize| [i % N_COLUMNS * (tile + GAP), i / N_COLUMNS * (height + FOOT + GAP)];
    let inside = [tile - 2, height - 2];
    let goal = draw_blueprint(&mut painter, episode.goal(), View::FrontQuarter, inside);
    captioned(&mut image, corner(0), &goal, &format!("goal: {}", episode.goal().id()), INK);
    let stage = Stage::new(episode, inside);
    for i in 0..N_SCENES {
        let n_done = i * episode.n_steps() / (N_SCENES - 1);
        let is_last = i + 1 == N_SCENES;
        // The last picture shows the scene after the camera has settled.
        let settled = if is_last { SETTLING_STEPS } else { 0 };
        let picture = stage.picture(&mut painter, &episode.scenes()[n_done], (n_done + settled) as f32);
        let end = if is_last && episode.status() == Status::Success { ", success" } else { "" };
        captioned(&mut image, corner(i + 1), &picture, &(episode.progress(n_done) + end), GRAY);
    }
    image
}
