//! An image as rows of pixels, with operations to change it.

/// Red, green, and blue, each 0 to 255, sRGB.
pub type Rgb = [u8; 3];

/// The background color.
pub const WHITE: Rgb = [255; 3];

/// Pixels by row from the top, each row from the left.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Image {
    width: usize,
    height: usize,
    pixels: Vec<Rgb>,
}

impl Image {
    /// Creates an image of one color. Both sides are in pixels, and 0 counts as 1.
    pub fn filled(width: usize, height: usize, color: Rgb) -> Self {
        let (width, height) = (width.max(1), height.max(1));
        Self { width, height, pixels: vec![color; width * height] }
    }

    /// Returns the width in pixels, at least 1.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Returns the height in pixels, at least 1.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Returns all pixels.
    pub fn pixels(&self) -> &[Rgb] {
        &self.pixels
    }

    /// Returns the row with this index from the top.
    pub(crate) fn row_mut(&mut self, y: usize) -> &mut [Rgb] {
        &mut self.pixels[y * self.width..(y + 1) * self.width]
    }

    /// Blends `color` over a pixel with an opacity of 0 to 255; does nothing outside.
    pub(crate) fn blend(&mut self, x: usize, y: usize, color: Rgb, opacity: u8) {
        if x < self.width && y < self.height {
            let pixel = &mut self.pixels[y * self.width + x];
            *pixel = mix(*pixel, color, f32::from(opacity) / 255.0);
        }
    }

    /// Fills a rectangle given by its upper left corner and size in pixels, clipped to the image.
    pub(crate) fn fill(&mut self, [x, y]: [usize; 2], [width, height]: [usize; 2], color: Rgb) {
        let (right, bottom) = ((x + width).min(self.width), (y + height).min(self.height));
        for row in y..bottom {
            self.row_mut(row)[x.min(right)..right].fill(color);
        }
    }

    /// Copies another image with its upper left corner to `(x, y)`, clipped to this image.
    pub fn paste(&mut self, other: &Self, x: usize, y: usize) {
        let x = x.min(self.width);
        let n_columns = other.width.min(self.width - x);
        for row in 0..other.height.min(self.height.saturating_sub(y)) {
            let from = row * other.width;
            self.row_mut(y + row)[x..x + n_columns].copy_from_slice(&other.pixels[from..from + n_columns]);
        }
    }
}

/// Mixes two colors: `a` at a `share` of 0, `b` at 1.
pub(crate) fn mix(a: Rgb, b: Rgb, share: f32) -> Rgb {
    std::array::from_fn(|i| {
        let (a, b) = (f32::from(a[i]), f32::from(b[i]));
        (a + (b - a) * share + 0.5) as u8
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shapes_outside_are_clipped() {
        let mut image = Image::filled(3, 2, WHITE);
        image.paste(&Image::filled(5, 5, [1, 2, 3]), 2, 1);
        image.paste(&Image::filled(1, 1, [9; 3]), 7, 0);
        image.fill([5, 5], [2, 2], [9; 3]);
        image.blend(3, 0, [9; 3], 255);
        let changed: Vec<usize> = (0..6).filter(|&i| image.pixels()[i] != WHITE).collect();
        assert_eq!((changed, image.pixels()[5]), (vec![5], [1, 2, 3]));
    }

    #[test]
    fn blend_interpolates_between_colors() {
        // 100 + (200 − 100) · 51/255 = 120.
        let mut image = Image::filled(1, 1, [100; 3]);
        image.blend(0, 0, [200, 0, 100], 51);
        assert_eq!(image.pixels(), [[120, 80, 100]]);
    }
}
