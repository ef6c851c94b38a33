//! Color quantization.

use super::image::Rgb;

/// Maximum number of colors that a byte can index.
const MAX_COLORS: usize = 256;

/// The palette of an image.
#[derive(Debug)]
pub(crate) struct Palette {
    colors: Vec<Rgb>,
    /// Every color of the image in order, with the index of its palette color.
    known: Vec<(Rgb, u8)>,
}

/// A group of the image's colors, each with its number of pixels.
struct Group {
    members: Vec<(Rgb, u32)>,
    mean: [f32; 3],
    /// The channel with the largest variation, and its sum of squared differences from the mean.
    channel: usize,
    spread: f32,
}

impl Palette {
    /// Builds a palette of the pixels with at most `n_colors` colors (1 to 256); exact if the image has no more.
    ///
    /// Otherwise the group with the largest variation is split at its mean until there are enough groups. A color that
    /// many pixels share (background, flat sides) stays exact.
    pub(crate) fn of(pixels: &[Rgb], n_colors: usize) -> Self {
        let n_colors = n_colors.clamp(1, MAX_COLORS);
        let mut groups = vec![Group::new(counted(pixels))];
        while groups.len() < n_colors {
            let widest = groups.iter().enumerate().max_by(|(_, a), (_, b)| a.spread.total_cmp(&b.spread));
            let Some((at, _)) = widest.filter(|(_, group)| group.spread > 0.0) else { break };
            let (low, high) = groups.swap_remove(at).split();
            groups.extend([low, high]);
        }
        let colors = groups.iter().map(Group::color).collect();
        let numbers = groups.iter().zip(0_u8..=u8::MAX);
        let mut known: Vec<(Rgb, u8)> =
            numbers.flat_map(|(group, number)| group.members.iter().map(move |(color, _)| (*color, number))).collect();
        known.sort_unstable();
        Self { colors, known }
    }

    /// Returns the colors by index.
    pub(crate) fn colors(&self) -> &[Rgb] {
        &self.colors
    }

    /// Returns the palette indices of the pixels that the palette was built from.
    pub(crate) fn indices(&self, pixels: &[Rgb]) -> Vec<u8> {
        let mut numbers = Vec::with_capacity(pixels.len());
        // Most pixels equal the previous one.
        for same in pixels.chunk_by(|a, b| a == b) {
            let at = self.known.partition_point(|(known, _)| *known < same[0]).min(self.known.len().saturating_sub(1));
            numbers.extend(std::iter::repeat_n(self.known[at].1, same.len()));
        }
        numbers
    }
}

/// Returns each color in order with its number of pixels.
fn counted(pixels: &[Rgb]) -> Vec<(Rgb, u32)> {
    let mut sorted = pixels.to_vec();
    sorted.sort_unstable();
    sorted.chunk_by(|a, b| a == b).map(|same| (same[0], same.len() as u32)).collect()
}

impl Group {
    fn new(members: Vec<(Rgb, u32)>) -> Self {
        let total: f64 = members.iter().map(|(_, n)| f64::from(*n)).sum();
        let moment = |channel: usize, power: i32| {
            let terms = members.iter().map(|(color, n)| f64::from(color[channel]).powi(power) * f64::from(*n));
            terms.sum::<f64>()
        };
        let mean: [f64; 3] = std::array::from_fn(|channel| moment(channel, 1) / total.max(1.0));
        let spread = |channel: usize| {
            // Do not use a difference of sums: a single color must give exactly zero.
            let (low, high) = members.iter().fold((u8::MAX, u8::MIN), |(low, high), (color, _)| {
                (low.min(color[channel]), high.max(color[channel]))
            });
            if low >= high { 0.0 } else { moment(channel, 2) - mean[channel] * mean[channel] * total }
        };
        let spreads: [f64; 3] = std::array::from_fn(spread);
        let channel = (0..3).max_by(|&a, &b| spreads[a].total_cmp(&spreads[b])).unwrap_or(0);
        Self { members, mean: mean.map(|x| x as f32), channel, spread: spreads[channel] as f32 }
    }

    /// Splits the colors into those below and those above the mean.
    fn split(self) -> (Self, Self) {
        let channel = self.channel;
        let mean = self.mean[channel];
        let (low, high) = self.members.into_iter().partition(|(color, _)| f32::from(color[channel]) < mean);
        (Self::new(low), Self::new(high))
    }

    /// Returns the most frequent color if half of the pixels have it, otherwise the mean.
    fn color(&self) -> Rgb {
        let total: u32 = self.members.iter().map(|(_, n)| n).sum();
        let commonest = self.members.iter().max_by_key(|(_, n)| *n).filter(|(_, n)| 2 * n >= total);
        commonest.map_or(self.mean.map(|x| x.round() as u8), |(color, _)| *color)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_colors_stay_exact() {
        let pixels: Vec<Rgb> = (0..=255).map(|x| [x, 255 - x, x / 2]).collect();
        let palette = Palette::of(&pixels, 256);
        let seen: Vec<Rgb> = palette.indices(&pixels).iter().map(|&i| palette.colors()[usize::from(i)]).collect();
        assert_eq!(seen, pixels);
    }

    #[test]
    fn many_colors_are_approximated_and_the_most_frequent_is_exact() {
        // 4096 colors on a grid of steps of 17, and white in most pixels.
        let grid = (0..4096_u32).map(|k| [k % 16, k / 16 % 16, k / 256].map(|x| (17 * x) as u8));
        let pixels: Vec<Rgb> = grid.chain(std::iter::repeat_n([250, 251, 252], 20_000)).collect();
        let palette = Palette::of(&pixels, 96);
        assert_eq!(palette.colors().len(), 96);
        for (pixel, index) in pixels.iter().zip(palette.indices(&pixels)) {
            let seen = palette.colors()[usize::from(index)];
            let off = (0..3).map(|i| pixel[i].abs_diff(seen[i])).max().unwrap();
            // 96 groups of 43 neighbors are about 3.5 steps wide: no color is three steps from its center.
            assert!(off <= 51, "{pixel:?} became {seen:?}");
        }
        let common = palette.indices(&[[250, 251, 252]])[0];
        assert_eq!(palette.colors()[usize::from(common)], [250, 251, 252]);
    }
}
