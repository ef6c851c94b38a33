//! Ways around the blocks of a structure.

use nalgebra::Vector3;

use super::solid::{Closed, Solid};

/// Distance that a moving block keeps from others, m.
const CLEARANCE_M: f32 = 0.02;
/// Distances of the points that are tried, m.
const REACHES_M: [f32; 3] = [0.25, 0.5, 0.8];
/// Lowest height of such a point, m.
const LOWEST_M: f32 = 0.15;
/// Distance from which on a stop counts as reached, m. A block that is off by a little would stay there forever.
const REACHED_M: f32 = 0.1;

/// Returns where a block that starts at `from`, with the axes of `mover`, goes first to reach `to` around the
/// obstacles: `to` itself if the straight way is free, or if no way around was found. It tries points beside `to`:
/// along `normal`, upward, and to all sides.
pub(super) fn next_stop(
    mover: &Solid,
    from: &Vector3<f32>,
    to: &Vector3<f32>,
    normal: &Vector3<f32>,
    obstacles: &[Solid],
) -> Vector3<f32> {
    let closed_by = |obstacle: &Solid| obstacle.closed_to(mover, CLEARANCE_M);
    let mut near = obstacles.iter().filter(|obstacle| obstacle.may_meet(mover, CLEARANCE_M, from, to));
    if near.all(|obstacle| !closed_by(obstacle).is_entered(from, to)) {
        return *to;
    }
    let closed: Vec<(&Solid, Closed)> = obstacles.iter().map(|obstacle| (obstacle, closed_by(obstacle))).collect();
    let is_free = |a: &Vector3<f32>, b: &Vector3<f32>| {
        let mut near = closed.iter().filter(|(obstacle, _)| obstacle.may_meet(mover, CLEARANCE_M, a, b));
        near.all(|(_, space)| !space.is_entered(a, b))
    };
    let side = normal.cross(&Vector3::z()).try_normalize(0.1).unwrap_or_else(Vector3::x);
    let across = normal.cross(&side);
    let directions = [*normal, Vector3::z(), side, -side, across, -across];
    let stops = directions.iter().flat_map(|direction| REACHES_M.map(|reach| to + direction * reach));
    let length = |stop: &Vector3<f32>| (stop - from).norm() + (to - stop).norm();
    let mut best: Option<(f32, Vector3<f32>)> = None;
    for stop in stops.filter(|stop| stop.z >= LOWEST_M) {
        let length = length(&stop);
        if best.is_none_or(|(least, _)| length < least) && is_free(&stop, to) && is_free(from, &stop) {
            best = Some((length, stop));
        }
    }
    best.map(|(_, stop)| stop).filter(|stop| (stop - from).norm() > REACHED_M).unwrap_or(*to)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Frame;
    use blueprints::BlockIdx;
    use nalgebra::Matrix3;

    #[test]
    fn a_free_way_is_straight_and_a_blocked_one_goes_around() {
        let solid = |block: u8, position| {
            Solid::new(BlockIdx::try_from(block).unwrap(), Frame { position, axes: Matrix3::identity() })
        };
        // A bar of 0.4 m across the way of a cube.
        let from = Vector3::new(0.0, -0.5, 1.0);
        let to = Vector3::new(0.0, 0.3, 1.0);
        let cube = solid(0, from);
        let bar = [solid(10, Vector3::new(0.0, 0.0, 1.0))];
        let stop = next_stop(&cube, &from, &to, &Vector3::y(), &bar);
        // The nearest way is over or under the bar, whose top with the cube and the clearance is at 1.12 m.
        assert!((stop.z - 1.0).abs() > 0.2 && stop.x == 0.0, "{stop}");
        // From the stop, and from near it, the block goes on.
        for off in [0.0, 0.05] {
            let from = stop - Vector3::z() * off * (stop.z - 1.0).signum();
            assert_eq!(next_stop(&cube, &from, &to, &Vector3::y(), &bar), to);
        }
        let above = Vector3::z() * 0.4;
        assert_eq!(next_stop(&cube, &(from + above), &(to + above), &Vector3::y(), &bar), to + above);
    }
}
