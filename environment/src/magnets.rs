//! Magnet geometry of two blocks: which magnets attract, and which are close enough to snap.

use blueprints::{BlockIdx, CubeRotation, Inventory, Magnet, N_BLOCKS, Polarity, RelativePlacement, UNIT_M};
use nalgebra::{Isometry3, Matrix3, Vector3};

use crate::config::MagnetConfig;

/// Two faces attract only if their normals are opposed to within 45°.
const MIN_FACE_COSINE: f32 = std::f32::consts::FRAC_1_SQRT_2;

/// Distance between two opposite magnets below which they attract, m.
pub(crate) const ATTRACTION_RANGE_M: f32 = 0.04;
/// Attraction of a magnet pair at distance 0, N. It falls linearly to 0 at [`ATTRACTION_RANGE_M`].
const ATTRACTION_PEAK_N: f32 = 8.0;

/// A pose with its rotation as a matrix, because each block is compared with up to 15 others.
#[derive(Clone, Copy)]
pub(crate) struct Frame {
    pub(crate) position: Vector3<f32>,
    pub(crate) rotation: Matrix3<f32>,
}

/// A pair of opposite magnets within reach.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct MagnetPair {
    /// The magnet of the first block, world frame, m.
    pub(crate) point_a: Vector3<f32>,
    /// The magnet of the second block, world frame, m.
    pub(crate) point_b: Vector3<f32>,
    /// Distance between them, m.
    pub(crate) distance: f32,
    /// Position of each magnet in its block's frame, half units.
    local: [[i32; 3]; 2],
}

/// The magnets of all blocks, laid out for the hot loop.
#[derive(Clone)]
pub(crate) struct MagnetTable {
    half_extents: [Vector3<f32>; N_BLOCKS],
    radii: [f32; N_BLOCKS],
    /// Magnets by face, +x −x +y −y +z −z.
    faces: [[Vec<LocalMagnet>; 6]; N_BLOCKS],
}

/// A magnet's position in its block's frame.
#[derive(Clone, Copy)]
struct LocalMagnet {
    position_m: Vector3<f32>,
    half_units: [i32; 3],
}

impl Frame {
    pub(crate) fn new(pose: &Isometry3<f32>) -> Self {
        Self { position: pose.translation.vector, rotation: pose.rotation.to_rotation_matrix().into_inner() }
    }
}

impl MagnetTable {
    pub(crate) fn new(inventory: &Inventory) -> Self {
        let half_extents = BlockIdx::array(|block| Vector3::from(inventory.half_extents_m(block)));
        let local = |m: &Magnet| LocalMagnet { position_m: magnet_position_m(m), half_units: m.position_half_units };
        let faces = BlockIdx::array(|block| {
            let magnets = inventory.magnets(block).iter();
            std::array::from_fn(|face| magnets.clone().filter(|m| face_of(m) == face).map(local).collect())
        });
        Self { half_extents, radii: half_extents.map(|h| h.norm()), faces }
    }

    /// Returns the radius of a block's bounding sphere in meters.
    pub(crate) fn radius(&self, block: BlockIdx) -> f32 {
        self.radii[block.get()]
    }

    /// Returns the height of a block's lowest point in meters.
    pub(crate) fn bottom(&self, block: BlockIdx, frame: &Frame) -> f32 {
        let half_extents = self.half_extents[block.get()];
        frame.position.z - (0..3).map(|k| frame.rotation[(2, k)].abs() * half_extents[k]).sum::<f32>()
    }

    /// Returns whether the surfaces of the two blocks may be within `reach` meters; `false` is certain.
    pub(crate) fn may_touch(
        &self,
        (a, frame_a): (BlockIdx, &Frame),
        (b, frame_b): (BlockIdx, &Frame),
        reach: f32,
    ) -> bool {
        let between = frame_b.position - frame_a.position;
        let radii = self.radii[a.get()] + self.radii[b.get()] + reach;
        if between.norm_squared() > radii * radii {
            return false;
        }
        // Separating-axis test with only the six face normals, because edges do not attract each other.
        let relative = frame_a.rotation.tr_mul(&frame_b.rotation);
        let (in_a, in_b) = (frame_a.rotation.tr_mul(&between), frame_b.rotation.tr_mul(&between));
        let (half_a, half_b) = (self.half_extents[a.get()], self.half_extents[b.get()]);
        (0..3).all(|k| {
            let shadow_b: f32 = (0..3).map(|j| relative[(k, j)].abs() * half_b[j]).sum();
            let shadow_a: f32 = (0..3).map(|j| relative[(j, k)].abs() * half_a[j]).sum();
            in_a[k].abs() <= half_a[k] + shadow_b + reach && in_b[k].abs() <= half_b[k] + shadow_a + reach
        })
    }

    /// Calls `f` for every pair of opposite magnets on opposed faces that are within `reach` meters. Returns the nearest.
    pub(crate) fn for_each_pair(
        &self,
        (a, frame_a): (BlockIdx, &Frame),
        (b, frame_b): (BlockIdx, &Frame),
        reach: f32,
        mut f: impl FnMut(MagnetPair),
    ) -> Option<MagnetPair> {
        let mut nearest: Option<MagnetPair> = None;
        let relative = frame_a.rotation.tr_mul(&frame_b.rotation);
        let offset = frame_a.rotation.tr_mul(&(frame_b.position - frame_a.position));
        for (k, j) in (0..9).map(|i| (i / 3, i % 3)) {
            // Opposite magnets sit on faces of opposite sign, so their normals are opposed when the axes agree.
            if relative[(k, j)] < MIN_FACE_COSINE {
                continue;
            }
            for (face_a, face_b) in [(2 * k, 2 * j + 1), (2 * k + 1, 2 * j)] {
                for magnet_b in &self.faces[b.get()][face_b] {
                    let seen_from_a = offset + relative * magnet_b.position_m;
                    for magnet_a in &self.faces[a.get()][face_a] {
                        let distance_squared = (seen_from_a - magnet_a.position_m).norm_squared();
                        if distance_squared <= reach * reach {
                            let pair = MagnetPair {
                                point_a: frame_a.position + frame_a.rotation * magnet_a.position_m,
                                point_b: frame_a.position + frame_a.rotation * seen_from_a,
                                distance: distance_squared.sqrt(),
                                local: [magnet_a.half_units, magnet_b.half_units],
                            };
                            nearest = nearest.filter(|best| best.distance <= pair.distance).or(Some(pair));
                            f(pair);
                        }
                    }
                }
            }
        }
        nearest
    }
}

impl MagnetPair {
    /// Returns the lattice pose of the second block relative to the first that joins this pair, if they are close
    /// enough.
    pub(crate) fn snap(
        &self,
        a: &Isometry3<f32>,
        b: &Isometry3<f32>,
        config: &MagnetConfig,
    ) -> Option<RelativePlacement> {
        if self.distance > config.snap_gap_m {
            return None;
        }
        let (rotation, angle) = CubeRotation::nearest(&(a.rotation.inverse() * b.rotation));
        if angle > config.snap_angle_deg.to_radians() {
            return None;
        }
        let [local_a, local_b] = self.local;
        let turned = rotation.apply(local_b);
        Some(RelativePlacement { offset_half_units: std::array::from_fn(|i| local_a[i] - turned[i]), rotation })
    }

    /// Returns the attraction of the second block toward the first in N; the first gets the opposite force.
    pub(crate) fn attraction(&self) -> Vector3<f32> {
        let strength = ATTRACTION_PEAK_N * (1.0 - self.distance / ATTRACTION_RANGE_M).max(0.0);
        (self.point_a - self.point_b) * (strength / self.distance.max(1e-6))
    }
}

/// Returns the position of a magnet in its block's frame, m.
pub(crate) fn magnet_position_m(magnet: &Magnet) -> Vector3<f32> {
    Vector3::from(magnet.position_half_units.map(|x| x as f32 * (UNIT_M / 2.0)))
}

/// Returns the index of a magnet's face in the order +x −x +y −y +z −z.
fn face_of(magnet: &Magnet) -> usize {
    let axis = magnet.normal.iter().position(|&n| n != 0).unwrap_or(0);
    2 * axis + usize::from(magnet.polarity == Polarity::Negative)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::{at, block};

    fn pairs(b: Isometry3<f32>) -> Vec<MagnetPair> {
        let table = MagnetTable::new(Inventory::standard());
        let frame_a = Frame::new(&at(0.0, 0.0, 0.05, 0.0));
        let frame_b = Frame::new(&b);
        let mut found = vec![];
        table.for_each_pair((block(0), &frame_a), (block(1), &frame_b), 0.04, |pair| found.push(pair));
        if !found.is_empty() {
            assert!(table.may_touch((block(0), &frame_a), (block(1), &frame_b), 0.04));
        }
        found
    }

    #[test]
    fn a_cube_beside_a_cube_meets_it_with_one_pair() {
        // The +x face of one cube is at x = 0.05, the −x face of the other at 0.12 − 0.05 = 0.07.
        let found = pairs(at(0.12, 0.0, 0.05, 0.0));
        assert_eq!(found.len(), 1);
        assert!((found[0].distance - 0.02).abs() < 1e-6);
        let force = found[0].attraction();
        // Halfway into the range: half of 8 N, toward the first block.
        assert!((force - Vector3::new(-4.0, 0.0, 0.0)).norm() < 1e-3, "{force}");
        let placement =
            found[0].snap(&at(0.0, 0.0, 0.05, 0.0), &at(0.12, 0.0, 0.05, 0.0), &MagnetConfig::default()).unwrap();
        assert_eq!(placement, RelativePlacement { offset_half_units: [2, 0, 0], rotation: CubeRotation::IDENTITY });
    }

    #[test]
    fn a_snap_needs_gap_and_angle() {
        let snap = |b: Isometry3<f32>| {
            pairs(b).iter().find_map(|p| p.snap(&at(0.0, 0.0, 0.05, 0.0), &b, &MagnetConfig::default())).is_some()
        };
        assert!(snap(at(0.12, 0.0, 0.05, 8_f32.to_radians())));
        assert!(snap(at(0.12, 0.015, 0.05, 0.0)));
        assert!(!snap(at(0.135, 0.0, 0.05, 0.0)), "35 mm");
        assert!(!snap(at(0.12, 0.0, 0.05, 20_f32.to_radians())), "20 degrees");
    }
}
