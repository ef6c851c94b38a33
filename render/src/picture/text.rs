//! Lines of text in a monospaced font.

use noto_sans_mono_bitmap::{FontWeight, RasterHeight, get_raster, get_raster_width};

use super::image::{Image, Rgb};

/// Color of most text.
pub(crate) const INK: Rgb = [34, 38, 50];

/// Color of less important text.
pub(crate) const GRAY: Rgb = [104, 110, 126];

/// A text style.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Type {
    /// For captions.
    Small,
    /// For most text.
    Body,
    /// For names in other text.
    BodyBold,
    /// For headings.
    Heading,
}

impl Type {
    fn font(self) -> (FontWeight, RasterHeight) {
        match self {
            Self::Small => (FontWeight::Regular, RasterHeight::Size16),
            Self::Body => (FontWeight::Regular, RasterHeight::Size20),
            Self::BodyBold => (FontWeight::Bold, RasterHeight::Size20),
            Self::Heading => (FontWeight::Bold, RasterHeight::Size24),
        }
    }

    /// Returns the height of a line in pixels.
    pub(crate) fn height(self) -> usize {
        self.font().1.val()
    }

    /// Returns the width of a text in pixels.
    pub(crate) fn width(self, text: &str) -> usize {
        let (weight, size) = self.font();
        get_raster_width(weight, size) * text.chars().count()
    }
}

/// Writes a line with its upper left corner at `at`, in pixels; characters missing from the font become question marks.
pub(crate) fn write(image: &mut Image, [left, top]: [usize; 2], text: &str, kind: Type, color: Rgb) {
    let (weight, size) = kind.font();
    let width = get_raster_width(weight, size);
    for (i, letter) in text.chars().enumerate() {
        let Some(raster) = get_raster(letter, weight, size).or_else(|| get_raster('?', weight, size)) else { continue };
        for (y, row) in raster.rows().enumerate() {
            for (x, &ink) in row.iter().enumerate() {
                image.blend(left + i * width + x, top + y, color, ink);
            }
        }
    }
}

/// Returns the text, or the prefix that fits into `width_px` followed by two dots.
pub(crate) fn fitted(text: &str, kind: Type, width_px: usize) -> String {
    if kind.width(text) <= width_px {
        return text.to_owned();
    }
    let n_fitting = width_px / kind.width("x");
    let cut: String = text.chars().take(n_fitting.saturating_sub(2)).collect();
    format!("{}..", cut.trim_end())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::picture::image::WHITE;

    #[test]
    fn text_is_written_at_its_position() {
        let mut image = Image::filled(60, 40, WHITE);
        let at = [10, 12];
        write(&mut image, at, "H×", Type::Small, [0; 3]);
        let dark = |i: &usize| image.pixels()[*i][0] < 128;
        let dark: Vec<(usize, usize)> = (0..60 * 40).filter(dark).map(|i| (i % 60, i / 60)).collect();
        let right = at[0] + Type::Small.width("H×");
        assert!(dark.iter().all(|&(x, y)| (10..right).contains(&x) && (12..28).contains(&y)), "{dark:?}");
        // Both characters are drawn: the font has the multiplication sign.
        let middle = at[0] + Type::Small.width("H");
        assert!(dark.iter().any(|&(x, _)| x < middle) && dark.iter().any(|&(x, _)| x >= middle));
        let mut unknown = Image::filled(60, 40, WHITE);
        write(&mut unknown, at, "H?", Type::Small, [0; 3]);
        assert_ne!(image, unknown);
    }

    #[test]
    fn long_text_is_truncated() {
        let width = Type::Small.width("12345678");
        assert_eq!(fitted("12345678", Type::Small, width), "12345678");
        assert_eq!(fitted("12345 789", Type::Small, width), "12345..");
    }
}
