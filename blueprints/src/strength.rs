//! A static estimate of whether the magnets can carry the structure's weight.

use crate::UNIT_M;
use crate::pieces::pieces;

/// Weight of one unit cell in newtons: 200 kg/m³ in a cube of 0.1 m at 9.81 m/s², the world's defaults.
pub const CELL_WEIGHT_N: f64 = 1.962;

/// Force that breaks a connection in the default world, in newtons per magnet pair.
///
/// A copy of the environment's default `break_force_n`: this crate does not depend on the environment, and a blueprint
/// must hold in the world used for training. The breaking torque is this times one unit (0.1 m).
pub const BREAK_FORCE_N: f64 = 30.0;

/// Maximum number of magnet pairs that add to a connection's strength.
pub const MAX_STRONG_PAIRS: usize = 3;

/// Ratio of breaking load to static load that a connection needs: structures are also shaken, carried, and hit.
pub const SAFETY_FACTOR: f64 = 2.0;

/// Two touching blocks by index in a list, and the points where their magnets meet, in half units.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Joint {
    /// One of the blocks.
    pub a: usize,
    /// The other.
    pub b: usize,
    /// Where magnets meet, half units.
    pub places: Vec<[i32; 3]>,
}

/// The load on a connection and its limits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Load {
    /// Weight that hangs on it, N.
    pub force_n: f64,
    /// Torque of that weight, Nm.
    pub torque_nm: f64,
    /// Largest safe force, N.
    pub max_force_n: f64,
    /// Largest safe torque, Nm.
    pub max_torque_nm: f64,
}

/// Returns the first joint whose load exceeds its limit, by index in `joints`.
///
/// `cells` are the filled cells of each block, `lowest` the height of the ground in units. Only joints whose removal
/// cuts the structure in two are considered, and only if one part does not touch the ground: its weight is the force on
/// the joint, and the torque is that force times the horizontal lever from the center of the contact. Parallel paths to
/// the ground share the load in a proportion that statics alone cannot determine.
pub fn overloaded(cells: &[Vec<[i32; 3]>], joints: &[Joint], lowest: i32) -> Option<(usize, Load)> {
    let grounded: Vec<bool> = cells.iter().map(|cells| cells.iter().any(|cell| cell[2] == lowest)).collect();
    joints.iter().enumerate().find_map(|(at, joint)| {
        let others = joints.iter().enumerate().filter(|(i, _)| *i != at);
        let piece = pieces(cells.len(), others.map(|(_, joint)| (joint.a, joint.b)));
        if piece[joint.a] == piece[joint.b] {
            return None;
        }
        [true, false].into_iter().find_map(|is_with_a| {
            let hanging: Vec<usize> = (0..cells.len()).filter(|&i| (piece[i] == piece[joint.a]) == is_with_a).collect();
            let load = load_of(&hanging, cells, joint);
            let is_excessive = load.force_n > load.max_force_n || load.torque_nm > load.max_torque_nm;
            (is_excessive && !hanging.iter().any(|&i| grounded[i])).then_some((at, load))
        })
    })
}

fn load_of(hanging: &[usize], cells: &[Vec<[i32; 3]>], joint: &Joint) -> Load {
    let of_part: Vec<&[i32; 3]> = hanging.iter().flat_map(|&i| &cells[i]).collect();
    let lever_u = |axis: usize| {
        let center: i32 = of_part.iter().map(|cell| 2 * cell[axis] + 1).sum();
        let contact: i32 = joint.places.iter().map(|place| place[axis]).sum();
        // Both are sums of half units.
        (f64::from(center) / of_part.len() as f64 - f64::from(contact) / joint.places.len() as f64) / 2.0
    };
    let force_n = of_part.len() as f64 * CELL_WEIGHT_N;
    let max_force_n = joint.places.len().min(MAX_STRONG_PAIRS) as f64 * BREAK_FORCE_N / SAFETY_FACTOR;
    Load {
        force_n,
        torque_nm: force_n * lever_u(0).hypot(lever_u(1)) * f64::from(UNIT_M),
        max_force_n,
        max_torque_nm: max_force_n * f64::from(UNIT_M),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the overload of a bar of `length` cells along +x from the top of a column of `height` cells, each one
    /// block.
    fn cantilever(height: i32, length: i32) -> Option<(usize, Load)> {
        let column = (0..height).map(|z| [0, 0, z]).collect();
        let bar = (1..=length).map(|x| [x, 0, height - 1]).collect();
        // The magnets meet at x = 1 u, half a unit up in the column's highest cell.
        let joint = Joint { a: 0, b: 1, places: vec![[2, 1, 2 * height - 1]] };
        overloaded(&[column, bar], &[joint], 0)
    }

    #[test]
    fn cantilever_is_limited_by_its_moment() {
        // Three cells: 5.886 N at 0.15 m = 0.88 N m, below 1.5 N m. Four: 7.848 N at 0.2 m = 1.57 N m.
        assert_eq!(cantilever(3, 3), None);
        let (at, load) = cantilever(3, 4).unwrap();
        assert_eq!(at, 0);
        assert!((load.force_n - 7.848).abs() < 1e-9 && (load.torque_nm - 1.5696).abs() < 1e-6, "{load:?}");
        assert!((load.max_force_n - 15.0).abs() < 1e-9 && (load.max_torque_nm - 1.5).abs() < 1e-6, "{load:?}");
        // On the ground, the joint carries nothing.
        assert_eq!(cantilever(1, 4), None);
    }

    #[test]
    fn second_support_or_more_pairs_relieve_a_joint() {
        let tower = |n: i32| (1..=n).map(|z| [0, 0, z]).collect::<Vec<_>>();
        let foot = vec![[0, 0, 0], [1, 0, 0]];
        let stacked = |n_pairs: i32| Joint { a: 0, b: 1, places: (0..n_pairs).map(|_| [1, 1, 2]).collect() };
        // 7 cells weigh 13.7 N, 8 weigh 15.7 N.
        assert_eq!(overloaded(&[foot.clone(), tower(7)], &[stacked(1)], 0), None);
        assert!(overloaded(&[foot.clone(), tower(8)], &[stacked(1)], 0).is_some());
        assert_eq!(overloaded(&[foot.clone(), tower(8)], &[stacked(2)], 0), None);
        // 24 cells weigh 47.1 N, more than three pairs hold, and a fourth does not help.
        assert!(overloaded(&[foot.clone(), tower(24)], &[stacked(4)], 0).is_some());
        let loops =
            [stacked(1), Joint { a: 0, b: 2, places: vec![[3, 1, 2]] }, Joint { a: 1, b: 2, places: vec![[2, 1, 3]] }];
        assert_eq!(overloaded(&[foot, tower(8), vec![[1, 0, 1]]], &loops, 0), None);
    }
}
