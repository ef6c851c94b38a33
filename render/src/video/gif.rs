//! Encodes frames as a GIF, for viewers without video playback.

use ::gif::{DisposalMethod, Encoder, Frame, Repeat};

use super::VideoError;
use crate::picture::palette::Palette;
use crate::picture::{Image, Rgb};

/// Maximum frame rate: browsers slow down delays of less than two hundredths of a second.
pub const MAX_GIF_FPS: u32 = 50;

/// One palette index is reserved for unchanged pixels.
const N_COLORS: usize = 255;

/// Encodes the frames as a looping GIF, `fps` (1 to [`MAX_GIF_FPS`]) per second. Equal frames give equal bytes.
///
/// Each frame stores only its changes, in up to 255 colors of its own. A frame without a change is stored as one pixel,
/// so that the number of frames stays the same.
///
/// # Errors
/// Returns an error if there is no frame, or the format does not support the frame rate or size (see [`VideoError`]).
pub fn gif(frames: impl IntoIterator<Item = Image>, fps: u32) -> Result<Vec<u8>, VideoError> {
    if !(1..=MAX_GIF_FPS).contains(&fps) {
        return Err(VideoError::Rate(fps, MAX_GIF_FPS));
    }
    let mut frames = frames.into_iter().peekable();
    let first = frames.peek().ok_or(VideoError::NoFrames)?;
    let (width, height) = (first.width(), first.height());
    let side = |n: usize| u16::try_from(n).map_err(|_| VideoError::Size(width, height));
    let mut encoder = Encoder::new(Vec::new(), side(width)?, side(height)?, &[])?;
    encoder.set_repeat(Repeat::Infinite)?;
    let mut last: Option<Image> = None;
    for (i, image) in (0_u32..).zip(frames) {
        if (image.width(), image.height()) != (width, height) {
            return Err(VideoError::Size(image.width(), image.height()));
        }
        let [x, y] = last.as_ref().map_or([[0, width], [0, height]], |last| changed(last, &image));
        let pixels = part(&image, x, y);
        let palette = Palette::of(&pixels, N_COLORS);
        let mut numbers = palette.indices(&pixels);
        if let Some(last) = &last {
            let before = part(last, x, y);
            let both = before.iter().zip(&pixels);
            let unchanged = numbers.iter_mut().zip(both).filter(|(_, (before, pixel))| before == pixel);
            unchanged.for_each(|(number, _)| *number = N_COLORS as u8);
        }
        let mut colors = palette.colors().to_vec();
        colors.resize(N_COLORS + 1, [0; 3]);
        // Hundredths of a second, rounded so that errors do not accumulate.
        let until = |i: u32| (100 * i + fps / 2) / fps;
        encoder.write_frame(&Frame {
            delay: (until(i + 1) - until(i)) as u16,
            dispose: DisposalMethod::Keep,
            transparent: Some(N_COLORS as u8),
            left: side(x[0])?,
            top: side(y[0])?,
            width: side(x[1] - x[0])?,
            height: side(y[1] - y[0])?,
            palette: Some(colors.concat()),
            buffer: numbers.into(),
            ..Frame::default()
        })?;
        last = Some(image);
    }
    Ok(encoder.into_inner()?)
}

/// Returns the bounds of the changed pixels, as columns and rows (start inclusive, end exclusive); one pixel if nothing
/// changed.
fn changed(last: &Image, image: &Image) -> [[usize; 2]; 2] {
    let width = image.width();
    let mut x = [width, 0];
    let mut y = [image.height(), 0];
    let rows = last.pixels().chunks_exact(width).zip(image.pixels().chunks_exact(width));
    for (row_idx, (before, after)) in rows.enumerate() {
        let differs = |(a, b): (&Rgb, &Rgb)| a != b;
        let Some(from) = before.iter().zip(after).position(differs) else { continue };
        let to = before.iter().zip(after).rposition(differs).map_or(width, |at| at + 1);
        x = [x[0].min(from), x[1].max(to)];
        y = [y[0].min(row_idx), row_idx + 1];
    }
    if y[1] == 0 { [[0, 1], [0, 1]] } else { [x, y] }
}

/// Returns the pixels of a part of an image.
fn part(image: &Image, x: [usize; 2], y: [usize; 2]) -> Vec<Rgb> {
    let rows = image.pixels().chunks_exact(image.width()).take(y[1]).skip(y[0]);
    rows.flat_map(|row| &row[x[0]..x[1]]).copied().collect()
}
