//! What a sweep varies: keys with lists or ranges of values, as a grid or drawn at random.

use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};

use crate::exit::Failure;

const MAX_POINTS: usize = 10_000;

/// Values of one key.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Axis {
    key: String,
    values: Values,
}

#[derive(Clone, Debug, PartialEq)]
enum Values {
    /// As on the command line.
    List(Vec<String>),
    /// Whole numbers, both ends included.
    Whole(i64, i64),
    /// Numbers, uniform or with a uniform logarithm.
    Real { low: f64, high: f64, is_log: bool },
}

/// The settings of a point: keys and values, in the order of the axes.
pub(super) type Point = Vec<(String, String)>;

impl Axis {
    /// Parses `KEY=V1,V2,…`, `KEY=LOW..HIGH`, or `KEY=LOW..HIGH:log`.
    pub(super) fn parse(text: &str) -> Result<Self, Failure> {
        let wrong = |why: &str| Failure::Usage(format!("--grid {text}: {why}"));
        let (key, values) = text.split_once('=').ok_or_else(|| wrong("expected KEY=VALUE,VALUE"))?;
        let key = key.trim().to_owned();
        if key.is_empty() {
            return Err(wrong("expected a key before `=`"));
        }
        if key == "seed" {
            return Err(wrong("seeds are varied with --seeds N, from --seed on"));
        }
        if let Some(range) = range(values.trim()) {
            return Ok(Self { key, values: range.map_err(wrong)? });
        }
        let values: Vec<String> = split(values).into_iter().map(|value| value.trim().to_owned()).collect();
        if values.iter().any(String::is_empty) {
            return Err(wrong("it has a place without a value"));
        }
        if let Some(twice) = values.iter().enumerate().find(|(i, value)| values[..*i].contains(value)) {
            return Err(wrong(&format!("{} is there twice", twice.1)));
        }
        Ok(Self { key, values: Values::List(values) })
    }

    fn draw(&self, rng: &mut ChaCha8Rng) -> String {
        match &self.values {
            Values::List(values) => values[rng.random_range(0..values.len())].clone(),
            Values::Whole(low, high) => rng.random_range(*low..=*high).to_string(),
            Values::Real { low, high, is_log: true } => {
                format!("{:.3e}", (low.ln() + rng.random::<f64>() * (high.ln() - low.ln())).exp())
            }
            Values::Real { low, high, .. } => format!("{:.3e}", low + rng.random::<f64>() * (high - low)),
        }
    }
}

/// Parses a range; `None` if it is none.
fn range(text: &str) -> Option<Result<Values, &'static str>> {
    let (text, is_log) = text.strip_suffix(":log").map_or((text, false), |text| (text, true));
    let (low, high) = text.split_once("..")?;
    let whole = |text: &str| text.trim().parse::<i64>().ok();
    let real = |text: &str| text.trim().parse::<f64>().ok().filter(|number| number.is_finite());
    let (Some(first), Some(last)) = (real(low), real(high)) else { return Some(Err("a range is LOW..HIGH")) };
    Some(match (whole(low), whole(high)) {
        _ if first >= last => Err("a range goes from a number to a larger one"),
        _ if is_log && first <= 0.0 => Err("a range with :log begins above 0"),
        (Some(low), Some(high)) if !is_log => Ok(Values::Whole(low, high)),
        _ => Ok(Values::Real { low: first, high: last, is_log }),
    })
}

/// Splits at the commas that are in no brackets, braces, or quotes.
fn split(text: &str) -> Vec<&str> {
    let mut parts = Vec::new();
    let mut begin = 0;
    let mut depth = 0_usize;
    let mut quote = None;
    for (i, c) in text.char_indices() {
        match (quote, c) {
            (Some(open), _) => quote = (c != open).then_some(open),
            (None, '"' | '\'') => quote = Some(c),
            (None, '[' | '{') => depth += 1,
            (None, ']' | '}') => depth = depth.saturating_sub(1),
            (None, ',') if depth == 0 => {
                parts.push(&text[begin..i]);
                begin = i + 1;
            }
            _ => {}
        }
    }
    parts.push(&text[begin..]);
    parts
}

/// The points of a sweep: all combinations, the last axis fastest, or `n_random` draws. Without axes, there is one point
/// without settings.
pub(super) fn points(axes: &[Axis], n_random: Option<usize>, seed: u64) -> Result<Vec<Point>, Failure> {
    let keys: Vec<&str> = axes.iter().map(|axis| axis.key.as_str()).collect();
    if let Some(twice) = keys.iter().enumerate().find(|(i, key)| keys[..*i].contains(key)) {
        return Err(Failure::Usage(format!("--grid: {} is there twice", twice.1)));
    }
    if let Some(n) = n_random {
        if axes.is_empty() {
            return Err(Failure::Usage(format!("--random {n} draws from the values of --grid, and there is none")));
        }
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let draw = |_| axes.iter().map(|axis| (axis.key.clone(), axis.draw(&mut rng))).collect();
        return Ok((0..n.min(MAX_POINTS)).map(draw).collect());
    }
    let mut points: Vec<Point> = vec![Vec::new()];
    for Axis { key, values } in axes {
        let Values::List(values) = values else {
            return Err(Failure::Usage(format!("--grid {key}: a range has no grid; add --random N to draw from it")));
        };
        if points.len() * values.len() > MAX_POINTS {
            return Err(Failure::Usage(format!("--grid: more than {MAX_POINTS} points")));
        }
        let with = |point: &Point, value: &String| [&point[..], &[(key.clone(), value.clone())]].concat();
        points = points.iter().flat_map(|point| values.iter().map(|value| with(point, value))).collect();
    }
    Ok(points)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn axes(texts: &[&str]) -> Vec<Axis> {
        texts.iter().map(|text| Axis::parse(text).unwrap()).collect()
    }

    fn shown(points: &[Point]) -> Vec<String> {
        let pair = |(key, value): &(String, String)| format!("{key}={value}");
        points.iter().map(|point| point.iter().map(pair).collect::<Vec<_>>().join(" ")).collect()
    }

    #[test]
    fn a_grid_has_every_combination() {
        let two = axes(&["learner.gamma=0.95, 0.97", "actor.sigmas=[0.0,1.0],[2.0]"]);
        let expected = [
            "learner.gamma=0.95 actor.sigmas=[0.0,1.0]",
            "learner.gamma=0.95 actor.sigmas=[2.0]",
            "learner.gamma=0.97 actor.sigmas=[0.0,1.0]",
            "learner.gamma=0.97 actor.sigmas=[2.0]",
        ];
        assert_eq!(shown(&points(&two, None, 1).unwrap()), expected);
        assert_eq!(points(&[], None, 1).unwrap(), [Vec::new()]);
        assert_eq!(split("{a=[1,2]},'x,y',z"), ["{a=[1,2]}", "'x,y'", "z"]);
    }

    #[test]
    fn random_points_are_in_their_ranges_and_the_same_for_the_same_seed() {
        let axes = axes(&["a=1e-4..1e-2:log", "b=2..4", "c=x,y", "d=0.5..1"]);
        let drawn = points(&axes, Some(300), 7).unwrap();
        assert_eq!(points(&axes, Some(300), 7).unwrap(), drawn);
        assert_ne!(points(&axes, Some(300), 8).unwrap(), drawn);
        let numbers = |i: usize| drawn.iter().map(move |point| point[i].1.parse::<f64>().unwrap());
        assert!(numbers(0).all(|a| (1e-4..=1e-2).contains(&a)) && numbers(3).all(|d| (0.5..=1.0).contains(&d)));
        // Half of the logarithms are below the middle one; uniform numbers would have one in eleven there.
        let n_below = numbers(0).filter(|a| *a < 1e-3).count();
        assert!((100..200).contains(&n_below), "{n_below}");
        for (i, values) in [(1, ["2", "3", "4"].as_slice()), (2, &["x", "y"])] {
            let mut found: Vec<&str> = drawn.iter().map(|point| point[i].1.as_str()).collect();
            found.sort_unstable();
            found.dedup();
            assert_eq!(found, values);
        }
    }

    #[test]
    fn what_is_no_grid_is_refused_by_its_text() {
        for (text, words) in [
            ("gamma", "--grid gamma: expected KEY=VALUE"),
            ("=1", "expected a key"),
            ("gamma=", "a place without a value"),
            ("gamma=1,,2", "a place without a value"),
            ("gamma=1,1", "1 is there twice"),
            ("seed=1,2", "--seeds N"),
            ("gamma=1..x", "LOW..HIGH"),
            ("gamma=2..1", "to a larger one"),
            ("gamma=0..1:log", "begins above 0"),
        ] {
            let message = Axis::parse(text).unwrap_err().to_string();
            assert!(message.contains(words), "{message}");
        }
        let refused = |texts: &[&str], n| points(&axes(texts), n, 1).unwrap_err().to_string();
        assert!(refused(&["a=1..2"], None).contains("--random N"));
        assert!(refused(&["a=1", "a=2"], None).contains("a is there twice"));
        assert!(refused(&[], Some(3)).contains("there is none"));
    }
}
