//! Success rates during training: of the paper's groups in one run, or of several runs.

use std::collections::BTreeMap;

use proto::wilson::SuccessRate;

use super::axis::{StepUnit, ticks};
use super::color::{CURVES, FAINT, GRID, INK};
use super::drawing::{Anchor, Drawing};
use crate::picture::{Rgb, Type};
use blueprints::Group;
use proto::ActionMode;
use runlog::Pass;
use runlog::series::{common_rates, group_rates};

/// The plot area and the page around it, pixels.
const LEFT: f64 = 112.0;
const TOP: f64 = 104.0;
const PLOT: [f64; 2] = [820.0, 460.0];
const PAGE: [usize; 2] = [1256, 648];
/// Opacity of intervals, 0 to 255: light enough that curves show through several of them.
const BAND: u8 = 46;
/// Distance between curves if there is only one evaluation, pixels.
const OFFSET: f64 = 24.0;
/// Minimum distance between two labels, pixels.
const LABEL_HEIGHT: f64 = 46.0;
/// Radius of a marker, pixels. With more evaluations than this the markers would touch, so only the last one is drawn.
const MARKER: f64 = 5.5;
const MAX_MARKED: usize = 40;

/// Maximum number of runs in one plot, so that each has a color and a marker of its own.
pub const MAX_RUNS: usize = 5;

/// One curve of a plot.
struct Curve {
    name: String,
    /// Index of the color and marker.
    style: usize,
    /// Environment steps and success rate.
    points: Vec<(f64, SuccessRate)>,
    /// Number of blueprints in the last evaluation.
    n_blueprints: usize,
}

/// Draws the curves of the evaluated groups with 95 % Wilson intervals. The evaluations have increasing steps. Returns
/// `None` if there is nothing to draw.
pub fn curves(passes: &[&Pass], acting: ActionMode, title: &str, subtitle: &str) -> Option<Drawing> {
    let mut by_group: BTreeMap<Group, Curve> = BTreeMap::new();
    for pass in passes {
        for (group, (rate, n_blueprints)) in group_rates(pass, acting) {
            let style = Group::ALL.iter().position(|other| *other == group).unwrap_or_default();
            let curve = by_group.entry(group).or_insert_with(|| Curve {
                name: group.name().to_owned(),
                style,
                points: Vec::new(),
                n_blueprints,
            });
            curve.points.push((pass.n_env_steps as f64, rate));
            curve.n_blueprints = n_blueprints;
        }
    }
    draw(&by_group.into_values().collect::<Vec<_>>(), title, subtitle)
}

/// Draws the curves of at most [`MAX_RUNS`] named runs on the blueprints that all of them evaluated. The evaluations
/// have increasing steps. Returns `None` if there are no such blueprints.
pub fn comparison(runs: &[(String, Vec<&Pass>)], acting: ActionMode, title: &str, subtitle: &str) -> Option<Drawing> {
    let rates = common_rates(runs.iter().map(|(_, passes)| &passes[..]), acting)?;
    let named = runs.iter().zip(rates.of_runs).enumerate();
    let curves = named.map(|(i, ((name, _), points))| Curve {
        name: name.clone(),
        style: i % MAX_RUNS,
        points: points.into_iter().map(|(steps, rate)| (steps as f64, rate)).collect(),
        n_blueprints: rates.n_blueprints,
    });
    draw(&curves.collect::<Vec<_>>(), title, subtitle)
}

fn draw(curves: &[Curve], title: &str, subtitle: &str) -> Option<Drawing> {
    let steps = curves.iter().flat_map(|curve| curve.points.iter().map(|(steps, _)| *steps));
    let (low, high) = (steps.clone().reduce(f64::min)?, steps.reduce(f64::max)?);
    let mut drawing = Drawing::new(PAGE[0], PAGE[1]);
    drawing.text(title, [24.0, 36.0], Anchor::Start, Type::Heading, INK);
    drawing.text(subtitle, [24.0, 64.0], Anchor::Start, Type::Body, FAINT);
    let x = |steps: f64| {
        // A single evaluation is centered; otherwise keep markers clear of the frame.
        let share = if high > low { (steps - low) / (high - low) } else { 0.5 };
        LEFT + 12.0 + share * (PLOT[0] - 24.0)
    };
    // With a single evaluation, draw the curves side by side so that their intervals do not hide each other.
    let aside = |i: usize| if high > low { 0.0 } else { OFFSET * (i as f64 - (curves.len() - 1) as f64 / 2.0) };
    axes(&mut drawing, low, high, x);
    for (i, curve) in curves.iter().enumerate() {
        intervals(&mut drawing, curve, x, aside(i));
    }
    for (i, curve) in curves.iter().enumerate() {
        line(&mut drawing, curve, x, aside(i));
    }
    legend(&mut drawing, curves);
    Some(drawing)
}

/// Returns the y coordinate of a rate, in pixels from the top.
fn y(rate: f64) -> f64 {
    TOP + (1.0 - rate) * PLOT[1]
}

fn axes(drawing: &mut Drawing, low: f64, high: f64, x: impl Fn(f64) -> f64) {
    let (right, bottom) = (LEFT + PLOT[0], TOP + PLOT[1]);
    for percent in [0, 20, 40, 60, 80, 100] {
        let y = y(f64::from(percent) / 100.0);
        drawing.line(vec![[LEFT, y], [right, y]], 1.0, GRID);
        drawing.text(percent.to_string(), [LEFT - 12.0, y], Anchor::End, Type::Body, INK);
    }
    let unit = StepUnit::of(high);
    for mark in ticks(low, high, 8) {
        drawing.line(vec![[x(mark), bottom], [x(mark), bottom + 6.0]], 1.0, INK);
        drawing.text(unit.label(mark), [x(mark), bottom + 22.0], Anchor::Middle, Type::Body, INK);
    }
    drawing.line(vec![[LEFT, TOP], [LEFT, bottom], [right, bottom]], 1.4, INK);
    drawing.text(unit.title, [LEFT + PLOT[0] / 2.0, bottom + 52.0], Anchor::Middle, Type::Body, INK);
    drawing.text("success (%)", [36.0, TOP + PLOT[1] / 2.0], Anchor::Turned, Type::Body, INK);
}

/// Draws a band, or a bar offset by `aside` pixels if there is only one evaluation.
fn intervals(drawing: &mut Drawing, curve: &Curve, x: impl Fn(f64) -> f64, aside: f64) {
    let color = CURVES[curve.style];
    if let [(steps, rate)] = curve.points[..] {
        let x = x(steps) + aside;
        for y in [y(rate.wilson_low), y(rate.wilson_high)] {
            drawing.line(vec![[x - 6.0, y], [x + 6.0, y]], 2.0, color);
        }
        drawing.line(vec![[x, y(rate.wilson_low)], [x, y(rate.wilson_high)]], 2.0, color);
        return;
    }
    let above = curve.points.iter().map(|(steps, rate)| [x(*steps), y(rate.wilson_high)]);
    let below = curve.points.iter().rev().map(|(steps, rate)| [x(*steps), y(rate.wilson_low)]);
    drawing.polygon(above.chain(below).collect(), color, BAND);
}

fn line(drawing: &mut Drawing, curve: &Curve, x: impl Fn(f64) -> f64, aside: f64) {
    let color = CURVES[curve.style];
    let points: Vec<[f64; 2]> = curve.points.iter().map(|(steps, rate)| [x(*steps) + aside, y(rate.rate)]).collect();
    let n_unmarked = if points.len() > MAX_MARKED { points.len() - 1 } else { 0 };
    let marked = points[n_unmarked..].to_vec();
    drawing.line(points, 2.6, color);
    for point in marked {
        marker(drawing, curve.style, point, color);
    }
}

/// Draws a marker shape specific to the curve, which works without colors.
fn marker(drawing: &mut Drawing, style: usize, [x, y]: [f64; 2], color: Rgb) {
    let (n_corners, first, radius) = match style {
        0 => (24, 0.0, 1.0),
        1 => (4, 0.125, 1.25),
        2 => (3, -0.25, 1.4),
        3 => (4, 0.0, 1.3),
        4 => (3, 0.25, 1.4),
        _ => (5, -0.25, 1.25),
    };
    let corner = |i: u32| {
        let angle = std::f64::consts::TAU * (f64::from(i) / f64::from(n_corners) + first);
        [x + MARKER * radius * angle.cos(), y + MARKER * radius * angle.sin()]
    };
    drawing.polygon((0..n_corners).map(corner).collect(), color, 255);
}

/// Draws names next to the ends of the curves, moved apart if they would overlap.
fn legend(drawing: &mut Drawing, curves: &[Curve]) {
    let ends = curves.iter().filter_map(|curve| Some((curve, curve.points.last()?.1.rate)));
    let mut ends: Vec<(&Curve, f64)> = ends.collect();
    ends.sort_by(|(_, a), (_, b)| b.total_cmp(a));
    let places = apart(&ends.iter().map(|(_, rate)| y(*rate)).collect::<Vec<_>>(), [TOP, TOP + PLOT[1]]);
    for ((curve, rate), y) in ends.into_iter().zip(places) {
        let (x, color) = (LEFT + PLOT[0] + 30.0, CURVES[curve.style]);
        drawing.line(vec![[x - 14.0, y], [x + 14.0, y]], 2.6, color);
        marker(drawing, curve.style, [x, y], color);
        let plural = if curve.n_blueprints == 1 { "" } else { "s" };
        let detail = format!("{} blueprint{plural}, last {:.1} %", curve.n_blueprints, 100.0 * rate);
        drawing.text(curve.name.clone(), [x + 24.0, y], Anchor::Start, Type::BodyBold, INK);
        drawing.text(detail, [x + 24.0, y + 19.0], Anchor::Start, Type::Small, FAINT);
    }
}

/// Moves y coordinates as little as possible to keep their minimum distance and stay in the range.
fn apart(places: &[f64], [top, bottom]: [f64; 2]) -> Vec<f64> {
    let mut moved: Vec<f64> = Vec::with_capacity(places.len());
    for place in places {
        let least = moved.last().map_or(top, |before| before + LABEL_HEIGHT);
        moved.push(place.max(least));
    }
    let mut most = bottom;
    for place in moved.iter_mut().rev() {
        *place = place.min(most);
        most = *place - LABEL_HEIGHT;
    }
    moved
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_keep_their_minimum_distance() {
        // The second is pushed down by the first, the last two up by the end of the range.
        assert_eq!(apart(&[100.0, 110.0, 300.0, 300.0], [100.0, 320.0]), [100.0, 146.0, 274.0, 320.0]);
        assert_eq!(apart(&[], [0.0, 9.0]), [0.0; 0]);
    }
}
