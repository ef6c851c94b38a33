//! Encodes an image as PNG.

use png::{BitDepth, ColorType, Compression, Encoder, EncodingError, Filter};

use super::image::Image;
use super::palette::Palette;

/// Encodes the image as a PNG of at most `n_colors` colors, 1 to 256; equal arguments give equal bytes.
///
/// A drawing with flat colors looks the same with 256 colors and takes two fifths of the space. A hundred colors save
/// another sixth, but wide soft shadows show banding.
///
/// # Errors
/// Returns an error if a side exceeds the limit of the format.
pub fn encode(image: &Image, n_colors: usize) -> Result<Vec<u8>, EncodingError> {
    let palette = Palette::of(image.pixels(), n_colors);
    let side = |n: usize| u32::try_from(n).map_err(|_| EncodingError::LimitsExceeded);
    let mut bytes = Vec::new();
    let mut encoder = Encoder::new(&mut bytes, side(image.width())?, side(image.height())?);
    encoder.set_color(ColorType::Indexed);
    encoder.set_depth(BitDepth::Eight);
    encoder.set_palette(palette.colors().concat());
    encoder.set_compression(Compression::High);
    // Neighboring palette indices are not similar colors, so filtering does not help.
    encoder.set_filter(Filter::NoFilter);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(&palette.indices(image.pixels()))?;
    writer.finish()?;
    Ok(bytes)
}
