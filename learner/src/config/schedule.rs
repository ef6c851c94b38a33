//! Settings that change with the environment steps consumed.

use std::ops::RangeBounds;

use proto::InvalidSetting;
use proto::setting::Setting;
use serde::{Deserialize, Serialize};

/// A constant such as `0.005`, or a piecewise linear schedule such as `[[0, 0.005], [1000000, 0.0]]`: points of
/// environment steps and value, constant before the first and after the last.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Schedule {
    /// The same value at all steps.
    Constant(f32),
    /// Points in ascending order of steps, at least one.
    Line(Vec<(u64, f32)>),
}

impl Schedule {
    /// Returns the value after `n_env_steps`.
    pub fn at(&self, n_env_steps: u64) -> f32 {
        let points = match self {
            Self::Constant(value) => return *value,
            Self::Line(points) => points,
        };
        let after = points.partition_point(|(steps, _)| *steps <= n_env_steps);
        match (after.checked_sub(1).and_then(|before| points.get(before)), points.get(after)) {
            (Some(&(x0, y0)), Some(&(x1, y1))) => y0 + (y1 - y0) * ((n_env_steps - x0) as f32 / (x1 - x0) as f32),
            (Some(&(_, y)), None) | (None, Some(&(_, y))) => y,
            (None, None) => 0.0,
        }
    }
}

impl Setting for Schedule {
    type Number = f32;

    fn check_in(&self, key: &str, range: &impl RangeBounds<f32>) -> Result<(), InvalidSetting> {
        let points = match self {
            Self::Constant(value) => return value.check_in(key, range),
            Self::Line(points) => points,
        };
        let first = points.first().map_or(f32::NAN, |(_, value)| *value);
        let ok = !points.is_empty() && points.is_sorted_by(|(a, _), (b, _)| a < b);
        InvalidSetting::check(key, first, ok, "a number, or points of ascending environment steps")?;
        points.iter().try_for_each(|(_, value)| value.check_in(key, range))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_level_outside_its_points() {
        let line = Schedule::Line(vec![(100, 1.0), (300, 0.0), (400, -0.5)]);
        let values = [0, 100, 150, 300, 350, 400, 1000].map(|steps| line.at(steps));
        assert_eq!(values, [1.0, 1.0, 0.75, 0.0, -0.25, -0.5, -0.5]);
        assert_eq!(Schedule::Constant(0.3).at(7), 0.3);
        assert_eq!(line.check_in("key", &(-1.0..=1.0)), Ok(()));
        for unordered in [vec![(3, 0.0), (3, 1.0)], Vec::new()] {
            assert!(Schedule::Line(unordered).check_in("key", &(-1.0..=1.0)).is_err());
        }
    }
}
