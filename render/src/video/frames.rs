//! Frames of an episode: the world, and next to it the goal, the score, and the held blocks.

use blueprints::Inventory;
use proto::{Scene, Status};

use super::episode::{Episode, STEP_S};
use super::stage::Stage;
use crate::picture::text::{GRAY, INK, Type, fitted, write};
use crate::picture::{GRIPPER_COLORS, Image, Painter, Rgb, View, WHITE, draw_blueprint};

/// Minimum width of a frame in pixels, so that the text fits.
pub const MIN_WIDTH: usize = 480;
/// Maximum width of a frame in pixels; the font is too small for larger frames.
pub const MAX_WIDTH: usize = 1920;

const HAIRLINE: Rgb = [214, 219, 228];
const PANEL: Rgb = [244, 246, 250];
const TRACK: Rgb = [222, 226, 235];
const GREEN: Rgb = [24, 132, 84];
const AMBER: Rgb = [186, 104, 10];

/// Duration of the last scene in seconds: the camera moves closer and then pauses.
pub const LAST_S: f32 = 2.0;

/// Frames wider than this use larger text, pixels.
const WIDE_PX: usize = 800;

/// Draws frames of one episode.
#[derive(Debug)]
pub struct Video<'a> {
    episode: &'a Episode,
    stage: Stage,
    painter: Painter,
    size_px: [usize; 2],
    /// The static parts of the panel next to the world.
    panel: Image,
    layout: Layout,
}

/// Positions in the panel, in pixels.
#[derive(Clone, Copy, Debug)]
struct Layout {
    pad: usize,
    /// Width of the panel.
    width: usize,
    words: Type,
    bold: Type,
    line: usize,
    /// Top of the score, below the goal.
    score_top: usize,
}

impl<'a> Video<'a> {
    /// Creates a video with frames of `width` pixels, clamped to [`MIN_WIDTH`] and [`MAX_WIDTH`] and rounded to even.
    /// The height is nine sixteenths of the width, also rounded to even.
    pub fn new(episode: &'a Episode, width: usize) -> Self {
        let width = width.clamp(MIN_WIDTH, MAX_WIDTH) / 2 * 2;
        let size_px = [width, width * 9 / 32 * 2];
        let mut painter = Painter::default();
        let (panel, layout) = panel(&mut painter, episode, size_px);
        let stage = Stage::new(episode, [width - layout.width, size_px[1]]);
        Self { episode, stage, painter, size_px, panel, layout }
    }

    /// Returns all frames in order, `fps` (at least 1) per second. On the last scene, the camera moves closer and then
    /// pauses.
    pub fn frames(&mut self, fps: u32) -> impl Iterator<Item = Image> + '_ {
        (0..self.episode.n_frames(fps, LAST_S)).map(move |i| self.frame(i as f32 / fps.max(1) as f32))
    }

    /// Returns the frame at a time in seconds since the first scene. After the end, this is the last scene with the
    /// camera moving closer.
    pub fn frame(&mut self, time_s: f32) -> Image {
        let n_done = time_s / STEP_S;
        let time_s = time_s.clamp(0.0, self.episode.length_s());
        let mut image = Image::filled(self.size_px[0], self.size_px[1], WHITE);
        let scene = self.episode.scene_at(time_s);
        image.paste(&self.stage.picture(&mut self.painter, &scene, n_done), 0, 0);
        let left = self.size_px[0] - self.layout.width;
        image.paste(&self.panel, left, 0);
        self.score(&mut image, left, time_s, &scene);
        image
    }

    fn score(&self, image: &mut Image, left: usize, time_s: f32, scene: &Scene) {
        let Layout { pad, width, words, bold, line, score_top } = self.layout;
        let x = left + pad;
        let room = width - 2 * pad;
        let n_done = self.episode.n_done(time_s);
        let n_connected = self.episode.n_connected(n_done);
        let n_links = self.episode.goal().links().len();
        let mut y = score_top;
        row(image, [x, y], room, words, "connected", &format!("{n_connected}/{n_links}"));
        y += line;
        let bar = line / 3;
        image.fill([x, y], [room, bar], TRACK);
        image.fill([x, y], [room * n_connected / n_links.max(1), bar], GREEN);
        y += line * 2 / 3;
        let step = self.episode.first_step() + n_done;
        let n_steps = self.episode.first_step() + self.episode.n_steps();
        let reward = self.episode.return_after(n_done).total();
        row(image, [x, y], room, words, "step", &format!("{step}/{n_steps}"));
        row(image, [x, y + line], room, words, "reward", &format!("{reward:.1}"));
        y += 2 * line + line / 3;
        for (gripper_idx, color) in GRIPPER_COLORS.into_iter().enumerate() {
            let Some(held) = held(scene, gripper_idx) else { continue };
            let side = words.height() * 3 / 4;
            image.fill([x, y + 2], [side, side], color);
            image.fill([x + side / 4, y + 2 + side / 4], [side - side / 4 * 2, side - side / 4 * 2], PANEL);
            write(image, [x + side + pad / 2, y], &fitted(held, words, room - side - pad / 2), words, INK);
            y += line;
        }
        if n_done < self.episode.n_steps() {
            return;
        }
        let (text, color) = ending(self.episode.status());
        let height = bold.height() + pad;
        let top = self.size_px[1] - height;
        image.fill([left, top], [width, height], color);
        let middle = left + (width - bold.width(text).min(width)) / 2;
        write(image, [middle, top + pad / 2], text, bold, WHITE);
    }
}

/// Returns the text and color of a status.
fn ending(status: Status) -> (&'static str, Rgb) {
    match status {
        Status::Success => ("success", GREEN),
        Status::TimeLimit => ("time is up", AMBER),
        Status::Diverged => ("diverged", AMBER),
        Status::Running => ("cut here", GRAY),
    }
}

/// Returns the name of the held block's type, `None` for an absent gripper.
fn held(scene: &Scene, gripper_idx: usize) -> Option<&'static str> {
    let gripper = scene.grippers[gripper_idx].as_ref()?;
    Some(gripper.held.map_or("free", |block| Inventory::standard().block_type(block).name))
}

/// Draws a line with a name on the left and a value on the right.
fn row(image: &mut Image, [x, y]: [usize; 2], room: usize, words: Type, name: &str, value: &str) {
    write(image, [x, y], name, words, GRAY);
    write(image, [(x + room).saturating_sub(words.width(value)), y], value, words, INK);
}

/// Draws a picture in a thin frame, whose upper left corner is at `[x, y]`.
pub(super) fn framed(image: &mut Image, [x, y]: [usize; 2], picture: &Image) {
    image.fill([x, y], [picture.width() + 2, picture.height() + 2], HAIRLINE);
    image.paste(picture, x + 1, y + 1);
}

/// Draws a picture in a thin frame and a line of text below it; returns the position of the text.
pub(super) fn captioned(image: &mut Image, [x, y]: [usize; 2], picture: &Image, words: &str, color: Rgb) -> [usize; 2] {
    framed(image, [x, y], picture);
    let below = [x + 2, y + picture.height() + 5];
    write(image, below, &fitted(words, Type::Small, picture.width()), Type::Small, color);
    below
}

fn panel(painter: &mut Painter, episode: &Episode, [full_width, height]: [usize; 2]) -> (Image, Layout) {
    let is_wide = full_width > WIDE_PX;
    let (words, bold) = if is_wide { (Type::Body, Type::Heading) } else { (Type::Small, Type::BodyBold) };
    let width = full_width * 27 / 100;
    let pad = full_width / 64;
    let line = words.height() + 3;
    let mut panel = Image::filled(width, height, PANEL);
    let room = width - 2 * pad;
    let goal = episode.goal();
    write(&mut panel, [pad, pad / 2], "goal", bold, INK);
    let after = pad + bold.width("goal ");
    let lower = pad / 2 + bold.height() - words.height();
    let id = fitted(goal.id().as_str(), words, width.saturating_sub(after + pad));
    write(&mut panel, [after, lower], &id, words, GRAY);
    write(&mut panel, [pad, pad / 2 + bold.height() + 2], &fitted(goal.title(), words, room), words, GRAY);
    let top = pad / 2 + bold.height() + line + 2;
    // Five lines, two gaps, and the final banner must fit below.
    let below = 6 * line + line / 3 + bold.height() + pad * 3 / 2;
    let size_px = [room, height.saturating_sub(top + below).max(1)];
    let picture = draw_blueprint(painter, goal, View::FrontQuarter, size_px);
    framed(&mut panel, [pad - 1, top - 1], &picture);
    panel.fill([0, 0], [1, height], HAIRLINE);
    let layout = Layout { pad, width, words, bold, line, score_top: top + picture.height() + pad / 2 };
    (panel, layout)
}
