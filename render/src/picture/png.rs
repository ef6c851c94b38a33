//! An image as the bytes of a PNG file.

use png::{BitDepth, ColorType, Compression, Encoder, EncodingError, Filter};

use super::image::Image;
use super::palette::Palette;

/// The image as a PNG of at most `n_colors` colors, 1 to 256; equal arguments give equal bytes.
///
/// A drawing with flat colors looks the same with 256 colors and takes two fifths of the space. With a hundred it takes a
/// sixth less again, and wide soft shadows show steps.
///
/// # Errors
/// When a side is longer than the format can say.
pub fn encode(image: &Image, n_colors: usize) -> Result<Vec<u8>, EncodingError> {
    let palette = Palette::of(image.pixels(), n_colors);
    let side = |n: usize| u32::try_from(n).map_err(|_| EncodingError::LimitsExceeded);
    let mut bytes = Vec::new();
    let mut encoder = Encoder::new(&mut bytes, side(image.width())?, side(image.height())?);
    encoder.set_color(ColorType::Indexed);
    encoder.set_depth(BitDepth::Eight);
    encoder.set_palette(palette.colors().concat());
    encoder.set_compression(Compression::High);
    // Neighboring numbers of a palette are no similar colors, so differences between them do not help.
    encoder.set_filter(Filter::NoFilter);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(&palette.indices(image.pixels()))?;
    writer.finish()?;
    Ok(bytes)
}
