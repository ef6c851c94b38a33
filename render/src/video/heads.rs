//! Videos and strips of attention: the attention that every head of every layer pays to the blocks over an episode.

use super::attention::{AttentionSource, EpisodeAttention, FULL, Shares, shade};
use super::frames::{captioned, framed};
use super::stage::Stage;
use crate::picture::text::{GRAY, INK, Type, fitted, write};
use crate::picture::{Image, Painter, Rgb, View, WHITE, draw_blueprint};

/// Minimum number of pictures in a row of a video: world, goal, and two grippers.
const MIN_COLUMNS: usize = 4;

/// Space between pictures, height of the text below each, and height of the legend, in pixels.
const GAP: usize = 6;
const FOOT: usize = 22;
const LEGEND: usize = 24;

/// Number of scenes in a strip.
const N_SCENES: usize = 5;

/// Width of the text next to the rows of a strip, in pixels.
const MARGIN: usize = 152;

/// Duration of the last frame of a video, in seconds.
const LAST_S: f32 = 1.5;

const TRACK: Rgb = [226, 230, 238];

/// Draws frames of an episode with one picture per head.
#[derive(Debug)]
pub struct AttentionVideo<'g> {
    attention: &'g EpisodeAttention<'g>,
    stage: Stage,
    painter: Painter,
    goal: Image,
    /// Width and height of a picture with its frame.
    tile_px: [usize; 2],
    size_px: [usize; 2],
}

impl<'g> AttentionVideo<'g> {
    /// Creates a video with frames of `width` pixels, clamped to [`MIN_WIDTH`](super::MIN_WIDTH) and
    /// [`MAX_WIDTH`](super::MAX_WIDTH) and rounded to even. The height depends on the number of layers.
    pub fn new(attention: &'g EpisodeAttention<'g>, width: usize) -> Self {
        let width = width.clamp(super::MIN_WIDTH, super::MAX_WIDTH) / 2 * 2;
        let n_columns = attention.n_heads().max(MIN_COLUMNS);
        let tile_width = (width - (n_columns - 1) * GAP) / n_columns;
        let tile_px = [tile_width, tile_width * 9 / 16];
        let height = (attention.n_layers() + 1) * (tile_px[1] + FOOT) + LEGEND;
        let mut painter = Painter::default();
        let inside = tile_px.map(|side| side - 2);
        let goal = draw_blueprint(&mut painter, attention.episode.goal(), View::FrontQuarter, inside);
        let stage = Stage::new(attention.episode, inside);
        Self { attention, stage, painter, goal, tile_px, size_px: [width, height.next_multiple_of(2)] }
    }

    /// Returns all frames in order, `fps` (at least 1) per second, with a pause on the last one.
    pub fn frames(&mut self, fps: u32) -> impl Iterator<Item = Image> + '_ {
        let mut last: Option<(usize, Image)> = None;
        (0..self.attention.episode.n_frames(fps, LAST_S)).map(move |i| {
            let n_done = self.attention.episode.n_done(i as f32 / fps.max(1) as f32);
            match &last {
                Some((known, image)) if *known == n_done => image.clone(),
                _ => last.insert((n_done, self.frame(n_done))).1.clone(),
            }
        })
    }

    /// Returns the frame after `n_done` steps; attention is not interpolated between steps.
    fn frame(&mut self, n_done: usize) -> Image {
        let (attention, episode) = (self.attention, self.attention.episode);
        let [width, height] = self.tile_px;
        let corner = |column: usize, row: usize| [column * (width + GAP), row * (height + FOOT)];
        let mut image = Image::filled(self.size_px[0], self.size_px[1], WHITE);
        let world = self.stage.picture(&mut self.painter, &episode.scenes()[n_done], n_done as f32);
        captioned(&mut image, corner(0, 0), &world, &episode.progress(n_done), INK);
        let goal = format!("goal: {}", episode.goal().id());
        captioned(&mut image, corner(1, 0), &self.goal, &goal, INK);
        for source in attention.sources() {
            let picture = attention.picture(source, n_done, &self.stage, &mut self.painter);
            match source {
                AttentionSource::Gripper(gripper) => {
                    let (words, color) = source.caption(attention.n_grippers());
                    captioned(&mut image, corner(2 + gripper, 0), &picture, &words, color);
                }
                AttentionSource::Head { layer, head } => {
                    let words = format!("{}.{}", layer + 1, head + 1);
                    let [left, top] = captioned(&mut image, corner(head, layer + 1), &picture, &words, INK);
                    let room = width.saturating_sub(36);
                    bars(&mut image, [left + 36, top], room, attention.shares(layer, head, n_done));
                }
            }
        }
        let top = self.size_px[1] - LEGEND + 4;
        legend(&mut image, [2, top]);
        image
    }
}

/// Draws rows of pictures at five evenly spaced steps: the world, then the attention of each gripper and of each head of
/// each layer. The image is about `width` pixels wide (at least 480).
pub fn attention_strip(attention: &EpisodeAttention<'_>, width: usize) -> Image {
    let episode = attention.episode;
    let tile_width = (width.max(super::MIN_WIDTH) - MARGIN) / N_SCENES - GAP;
    let tile_px = [tile_width, tile_width * 9 / 16];
    let sources: Vec<AttentionSource> = attention.sources().collect();
    let step_px = [tile_px[0] + GAP, tile_px[1] + GAP];
    let height = FOOT + (sources.len() + 1) * step_px[1] + LEGEND;
    let mut image = Image::filled(MARGIN + N_SCENES * step_px[0], height, WHITE);
    let mut painter = Painter::default();
    let inside = tile_px.map(|side| side - 2);
    let goal = draw_blueprint(&mut painter, episode.goal(), View::FrontQuarter, [MARGIN - 14, inside[1]]);
    framed(&mut image, [0, FOOT], &goal);
    let words = format!("goal: {}", episode.goal().id());
    write(&mut image, [2, 2], &fitted(&words, Type::Small, MARGIN), Type::Small, INK);
    let stage = Stage::new(episode, inside);
    for moment in 0..N_SCENES {
        let n_done = moment * episode.n_steps() / (N_SCENES - 1);
        let x = MARGIN + moment * step_px[0];
        let words = format!("step {}", episode.first_step() + n_done);
        write(&mut image, [x + 2, 2], &fitted(&words, Type::Small, tile_px[0]), Type::Small, GRAY);
        framed(&mut image, [x, FOOT], &stage.picture(&mut painter, &episode.scenes()[n_done], n_done as f32));
        for (row, source) in sources.iter().enumerate() {
            let picture = attention.picture(*source, n_done, &stage, &mut painter);
            framed(&mut image, [x, FOOT + (row + 1) * step_px[1]], &picture);
        }
    }
    for (row, source) in sources.iter().enumerate() {
        let y = FOOT + (row + 1) * step_px[1];
        let (words, color) = source.caption(attention.n_grippers());
        write(&mut image, [2, y + 4], &fitted(&words, Type::Small, MARGIN), Type::Small, color);
        let AttentionSource::Head { layer, head } = *source else { continue };
        let mean = Shares::mean((0..attention.n_scenes()).map(|n_done| attention.shares(layer, head, n_done)));
        for (i, (name, color, share)) in named(mean).into_iter().enumerate() {
            let top = y + 24 + i * 18;
            if top + 16 < y + tile_px[1] {
                bar(&mut image, [8, top], MARGIN - 24, name, share, color);
            }
        }
    }
    legend(&mut image, [2, height - LEGEND + 4]);
    image
}

/// Returns the shares with their names and colors.
fn named(Shares { planned, joined, held }: Shares) -> [(&'static str, Rgb, f32); 3] {
    [("plan", [24, 132, 84], planned), ("join", [30, 60, 130], joined), ("held", [214, 0, 110], held)]
}

/// Draws the three shares side by side.
fn bars(image: &mut Image, [x, y]: [usize; 2], width: usize, shares: Shares) {
    let shares = named(shares);
    let each = width / shares.len();
    for (i, (name, color, share)) in shares.into_iter().enumerate() {
        bar(image, [x + i * each, y], each.saturating_sub(8), name, share, color);
    }
}

/// Draws a name and a bar that is full at a share of 1.
fn bar(image: &mut Image, [x, y]: [usize; 2], width: usize, name: &str, share: f32, color: Rgb) {
    let words = Type::Small.width(name) + 4;
    write(image, [x, y], name, Type::Small, GRAY);
    let room = width.saturating_sub(words);
    image.fill([x + words, y + 5], [room, 7], TRACK);
    image.fill([x + words, y + 5], [(room as f32 * share.clamp(0.0, 1.0)) as usize, 7], color);
}

fn legend(image: &mut Image, [x, y]: [usize; 2]) {
    let before = "attention 0";
    write(image, [x, y], before, Type::Small, GRAY);
    let left = x + Type::Small.width(before) + 6;
    let length = 90;
    for i in 0..length {
        image.fill([left + i, y + 3], [1, 11], shade(FULL * i as f32 / length as f32));
    }
    let words = format!(
        "{:.0} %, of the goal's blocks; bars: its share on partners in the plan, blocks connected, blocks held",
        100.0 * FULL
    );
    let at = left + length + 6;
    let room = image.width().saturating_sub(at);
    write(image, [at, y], &fitted(&words, Type::Small, room), Type::Small, GRAY);
}
