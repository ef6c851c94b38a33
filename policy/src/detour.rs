//! Ways around the blocks of a structure.

use nalgebra::Vector3;

use crate::geometry::Frame;

/// Distance that the center of a moving block keeps from the faces of others, m: half of a block's thickness, and a
/// little more.
const CLEARANCE_M: f32 = 0.08;
/// Distances of the points that are tried, m.
const REACHES_M: [f32; 3] = [0.25, 0.5, 0.8];
/// Lowest height of such a point, m.
const LOWEST_M: f32 = 0.15;

/// A box in the world.
pub(crate) struct Obstacle<'a> {
    pub(crate) frame: &'a Frame,
    pub(crate) half_extents_m: Vector3<f32>,
}

/// Returns where a point at `from` goes first to reach `to` around the obstacles: `to` itself if the straight way is
/// free, or if no way around was found. It tries points beside `to`: along `normal`, upward, and to all sides.
///
/// An obstacle whose neighborhood contains one of the ends is not in the way: the point leaves it, or goes to it.
pub(crate) fn next_stop(
    from: &Vector3<f32>,
    to: &Vector3<f32>,
    normal: &Vector3<f32>,
    obstacles: &[Obstacle<'_>],
) -> Vector3<f32> {
    let is_free = |a: &Vector3<f32>, b: &Vector3<f32>| obstacles.iter().all(|obstacle| !obstacle.blocks(a, b));
    if is_free(from, to) {
        return *to;
    }
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
    best.map_or(*to, |(_, stop)| stop)
}

impl Obstacle<'_> {
    /// Whether the straight way from `a` to `b` comes too near, and neither end is as near.
    fn blocks(&self, a: &Vector3<f32>, b: &Vector3<f32>) -> bool {
        let [a, b] = [a, b].map(|end| self.frame.localize(&(end - self.frame.position)));
        let reach = self.half_extents_m.add_scalar(CLEARANCE_M);
        let is_inside = |end: &Vector3<f32>| (0..3).all(|k| end[k].abs() < reach[k]);
        if is_inside(&a) || is_inside(&b) {
            return false;
        }
        // The parts of the way between the two planes of each axis have a common part.
        let (mut enter, mut leave) = (0.0_f32, 1.0_f32);
        for k in 0..3 {
            let step = b[k] - a[k];
            if step.abs() < 1e-6 {
                if a[k].abs() >= reach[k] {
                    return false;
                }
                continue;
            }
            let (s, t) = ((-reach[k] - a[k]) / step, (reach[k] - a[k]) / step);
            enter = enter.max(s.min(t));
            leave = leave.min(s.max(t));
        }
        enter < leave
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix3;

    #[test]
    fn a_free_way_is_straight_and_a_blocked_one_goes_around() {
        let frame = Frame { position: Vector3::new(0.0, 0.0, 1.0), axes: Matrix3::identity() };
        let wall = [Obstacle { frame: &frame, half_extents_m: Vector3::new(0.05, 0.2, 0.1) }];
        let (from, to) = (Vector3::new(-0.5, 0.0, 1.0), Vector3::new(0.3, 0.0, 1.0));
        let stop = next_stop(&from, &to, &Vector3::x(), &wall);
        // The nearest way is over or under the wall, whose top with the clearance is at 1.18 m.
        assert_ne!(stop, to);
        assert!((stop.z - 1.0).abs() > 0.2 && stop.y == 0.0, "{stop}");
        assert_eq!(next_stop(&stop, &to, &Vector3::x(), &wall), to);
        let above = Vector3::new(-0.5, 0.0, 1.4);
        assert_eq!(next_stop(&above, &(to + Vector3::z() * 0.4), &Vector3::x(), &wall), to + Vector3::z() * 0.4);
    }

    #[test]
    fn what_is_touched_already_is_not_in_the_way() {
        let frame = Frame { position: Vector3::new(0.0, 0.0, 1.0), axes: Matrix3::identity() };
        let wall = [Obstacle { frame: &frame, half_extents_m: Vector3::new(0.05, 0.2, 0.1) }];
        let (from, to) = (Vector3::new(-0.1, 0.0, 1.0), Vector3::new(0.3, 0.0, 1.0));
        assert_eq!(next_stop(&from, &to, &Vector3::x(), &wall), to);
    }
}
