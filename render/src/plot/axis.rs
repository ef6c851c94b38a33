//! Ticks and labels of an axis.

/// The unit of environment steps on an axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct StepUnit {
    /// Environment steps per unit.
    pub(super) n_steps: f64,
    /// Title of the axis.
    pub(super) title: &'static str,
}

impl StepUnit {
    /// Returns the unit for steps up to `most`.
    pub(super) fn of(most: f64) -> Self {
        let (n_steps, title) = match most {
            most if most >= 2e9 => (1e9, "environment steps (billions)"),
            most if most >= 2e6 => (1e6, "environment steps (millions)"),
            most if most >= 2e3 => (1e3, "environment steps (thousands)"),
            _ => (1.0, "environment steps"),
        };
        Self { n_steps, title }
    }

    /// Formats a number of steps in this unit, without trailing zeros.
    pub(super) fn label(self, n_steps: f64) -> String {
        let text = format!("{:.3}", n_steps / self.n_steps);
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    }
}

/// Returns round numbers from `low` to `high`, 1, 2, or 5 times a power of ten apart, at most `n_max` of them (2 or
/// more).
pub(super) fn ticks(low: f64, high: f64, n_max: usize) -> Vec<f64> {
    let span = high - low;
    if span.is_nan() || span <= 0.0 {
        return vec![low];
    }
    let rough = span / n_max as f64;
    let power = 10_f64.powf(rough.log10().floor());
    // Steps are integers, so ticks are at least one step apart.
    let step = [1.0, 2.0, 5.0, 10.0].map(|factor| factor * power).into_iter().find(|step| *step >= rough);
    let step = step.unwrap_or(10.0 * power).max(1.0);
    let first = (low / step).ceil() as i64;
    let last = (high / step).floor() as i64;
    (first..=last).map(|i| i as f64 * step).collect()
}

/// Returns the borders between cells around sorted places: halfway between neighbors, and equally far beyond the ends.
pub(super) fn borders(places: &[u64]) -> Vec<f64> {
    let places: Vec<f64> = places.iter().map(|place| *place as f64).collect();
    match places[..] {
        [] => Vec::new(),
        [only] => vec![only - 0.5, only + 0.5],
        [first, second, ..] => {
            let [.., before, last] = places[..] else { return Vec::new() };
            let middles = places.windows(2).map(|pair| f64::midpoint(pair[0], pair[1]));
            let (left, right) = (first - (second - first) / 2.0, last + (last - before) / 2.0);
            std::iter::once(left).chain(middles).chain([right]).collect()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round() {
        assert_eq!(ticks(0.0, 60_000.0, 6), [0.0, 10_000.0, 20_000.0, 30_000.0, 40_000.0, 50_000.0, 60_000.0]);
        assert_eq!(ticks(-2_000.0, 11_000.0, 6), [0.0, 5_000.0, 10_000.0]);
        assert_eq!(ticks(3.0, 5.0, 6), [3.0, 4.0, 5.0]);
        assert_eq!(ticks(7.0, 7.0, 6), [7.0]);
    }

    #[test]
    fn borders_lie_halfway() {
        assert_eq!(borders(&[0, 10, 40]), [-5.0, 5.0, 25.0, 55.0]);
        assert_eq!(borders(&[8]), [7.5, 8.5]);
        assert_eq!(borders(&[]), [0.0; 0]);
    }

    #[test]
    fn step_unit_suits_the_range() {
        for (most, n_steps, label, word) in [
            (900.0, 450.0, "450", "steps"),
            (60_000.0, 2_500.0, "2.5", "thousands"),
            (3e6, 2_000_000.0, "2", "millions"),
            (3e9, 1e9, "1", "billions"),
        ] {
            let unit = StepUnit::of(most);
            assert_eq!(unit.label(n_steps), label);
            assert!(unit.title.contains(word), "{}", unit.title);
        }
    }
}
