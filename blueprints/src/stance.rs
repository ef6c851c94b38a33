//! Static stability: the center of mass relative to the convex hull of the ground contacts.

use crate::Placement;

/// Minimum distance from a blueprint's center of mass to the edge of the support polygon, in units.
pub const MIN_SUPPORT_MARGIN_U: f64 = 0.1;

/// Returns the support margin of a rigid structure: the distance in units from its center of mass to the nearest edge
/// of the support polygon, negative outside it. Cells at z = 0 touch the ground, and there must be at least one. All
/// blocks have the same density.
pub fn support_margin_u(placements: &[Placement]) -> f64 {
    let cells: Vec<[i32; 3]> = placements.iter().flat_map(|p| p.filled_cells()).collect();
    let mean = |axis: usize| {
        let sum: i32 = cells.iter().map(|cell| cell[axis]).sum();
        f64::from(sum) / cells.len() as f64 + 0.5
    };
    let corners = cells
        .iter()
        .filter(|cell| cell[2] == 0)
        .flat_map(|&[x, y, _]| [[x, y], [x + 1, y], [x, y + 1], [x + 1, y + 1]]);
    support_margin(corners.collect(), [mean(0), mean(1)])
}

/// Returns the distance from `center` to the nearest edge of the convex hull of `corners`, negative outside it.
pub(crate) fn support_margin(corners: Vec<[i32; 2]>, center: [f64; 2]) -> f64 {
    let hull = convex_hull(corners);
    (0..hull.len()).map(|i| distance_inside(hull[i], hull[(i + 1) % hull.len()], center)).fold(f64::INFINITY, f64::min)
}

/// Returns the signed distance of `p` from the line `a`→`b`, positive on its left.
fn distance_inside(a: [i32; 2], b: [i32; 2], p: [f64; 2]) -> f64 {
    let (dx, dy) = (f64::from(b[0] - a[0]), f64::from(b[1] - a[1]));
    (dx * (p[1] - f64::from(a[1])) - dy * (p[0] - f64::from(a[0]))) / dx.hypot(dy)
}

/// Returns the corners of the convex hull, counterclockwise (Andrew's monotone chain).
fn convex_hull(mut points: Vec<[i32; 2]>) -> Vec<[i32; 2]> {
    points.sort_unstable();
    points.dedup();
    let mut hull = half_hull(points.iter().copied());
    hull.extend(half_hull(points.iter().rev().copied()));
    hull
}

/// Returns one side of the hull without its last point, which begins the other side.
fn half_hull(points: impl Iterator<Item = [i32; 2]>) -> Vec<[i32; 2]> {
    let mut chain: Vec<[i32; 2]> = Vec::new();
    for p in points {
        while let [.., a, b] = chain[..]
            && (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]) <= 0
        {
            chain.pop();
        }
        chain.push(p);
    }
    chain.pop();
    chain
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{BlockIdx, CubeRotation};

    fn cube(x: i32, y: i32, z: i32) -> Placement {
        let block = BlockIdx::try_from(0).unwrap();
        Placement { block, center_half_units: [2 * x + 1, 2 * y + 1, 2 * z + 1], rotation: CubeRotation::IDENTITY }
    }

    #[test]
    fn margin_is_the_distance_to_the_nearest_edge() {
        let check = |placements: &[Placement], expected: f64| {
            let got = support_margin_u(placements);
            assert!((got - expected).abs() < 1e-12, "{got} is not {expected}");
        };
        check(&[cube(0, 0, 0)], 0.5);
        // Two cells of overhang put the center at x = (0.5 + 0.5 + 1.5 + 2.5) / 4 = 1.25, past the edge at 1.
        check(&[cube(0, 0, 0), cube(0, 0, 1), cube(1, 0, 1), cube(2, 0, 1)], -0.25);
        // Feet at (0,0) and (1,1): the hull's long edges are x − y = ±1, at 1/√2 from the center (1, 1).
        check(&[cube(0, 0, 0), cube(1, 1, 0)], std::f64::consts::FRAC_1_SQRT_2);
    }
}
