//! Colors that are distinguishable with red-green color blindness.

use crate::picture::Rgb;

/// Matplotlib's viridis at equal distances from 0 to 1; lighter means more, also in grayscale.
const VIRIDIS: [Rgb; 17] = [
    [68, 1, 84],
    [72, 24, 106],
    [71, 45, 123],
    [66, 64, 134],
    [59, 82, 139],
    [51, 99, 141],
    [44, 114, 142],
    [38, 130, 142],
    [33, 145, 140],
    [31, 160, 136],
    [40, 174, 128],
    [63, 188, 115],
    [94, 201, 98],
    [132, 212, 75],
    [173, 220, 48],
    [216, 226, 25],
    [253, 231, 37],
];

/// ColorBrewer's RdBu at equal distances from −1 to 1: red means worse, white equal, blue better.
const RED_BLUE: [Rgb; 11] = [
    [103, 0, 31],
    [177, 24, 43],
    [214, 96, 77],
    [243, 164, 129],
    [253, 219, 199],
    [247, 247, 247],
    [209, 229, 240],
    [144, 196, 221],
    [67, 147, 195],
    [32, 101, 171],
    [5, 48, 97],
];

/// Cells that were not evaluated.
pub(super) const NOTHING: Rgb = [204, 204, 204];
/// Lines of axes and text.
pub(super) const INK: Rgb = [34, 34, 34];
/// Secondary text.
pub(super) const FAINT: Rgb = [102, 102, 102];
/// Brackets around groups of rows.
pub(super) const BRACKETS: Rgb = [170, 170, 170];
/// Grid lines behind the data.
pub(super) const GRID: Rgb = [226, 226, 226];

/// The color scale of a value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Scale {
    /// A rate, 0 to 1.
    Rate,
    /// A difference of two rates, −1 to 1.
    Difference,
}

impl Scale {
    /// Returns the minimum and maximum value.
    pub(super) fn range(self) -> [f64; 2] {
        match self {
            Self::Rate => [0.0, 1.0],
            Self::Difference => [-1.0, 1.0],
        }
    }

    /// Returns the color of a value; values outside the range have the color of its end.
    pub(super) fn color(self, value: f64) -> Rgb {
        let [low, high] = self.range();
        let share = ((value - low) / (high - low)).clamp(0.0, 1.0);
        match self {
            Self::Rate => along(&VIRIDIS, share),
            Self::Difference => along(&RED_BLUE, share),
        }
    }
}

/// Colors of the curves in order (Okabe and Ito, 2008).
pub(super) const CURVES: [Rgb; 6] =
    [[0, 114, 178], [230, 159, 0], [0, 158, 115], [213, 94, 0], [150, 80, 160], [86, 180, 233]];

/// Returns the color at `share` of the way, 0 to 1.
fn along(colors: &[Rgb], share: f64) -> Rgb {
    let place = share * (colors.len() - 1) as f64;
    let i = (place as usize).min(colors.len() - 2);
    crate::picture::mix(colors[i], colors[i + 1], (place - i as f64) as f32)
}
