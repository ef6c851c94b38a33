//! The integer lattice of blueprints, with a spacing of one unit (0.1 m), and its 24 proper rotations.

use std::sync::LazyLock;

use serde::{Deserialize, Serialize};

/// Edge of a unit cell in meters.
pub const UNIT_M: f32 = 0.1;

/// One of the 24 rotations that map the cube onto itself.
///
/// Index order: `CubeRotation::all()` enumerates signed axis permutations with determinant +1, in lexicographic order
/// of (image axis of x, image axis of y) where axes are numbered +x −x +y −y +z −z; index 0 is the identity.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(try_from = "u8", into = "u8")]
pub struct CubeRotation(u8);

/// A rotation index outside 0..24.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("cube rotation {0} is not in 0..24")]
pub struct InvalidRotation(pub u8);

impl TryFrom<u8> for CubeRotation {
    type Error = InvalidRotation;

    fn try_from(index: u8) -> Result<Self, InvalidRotation> {
        if index < 24 { Ok(Self(index)) } else { Err(InvalidRotation(index)) }
    }
}

impl From<CubeRotation> for u8 {
    fn from(rotation: CubeRotation) -> Self {
        rotation.0
    }
}

type Matrix = [[i32; 3]; 3];

/// Scenes need hundreds of these in every step.
static TABLES: LazyLock<Tables> = LazyLock::new(Tables::new);

/// The matrices, inverses, and products of all rotations, by index.
struct Tables {
    matrices: [Matrix; 24],
    inverses: [CubeRotation; 24],
    products: [[CubeRotation; 24]; 24],
}

impl Tables {
    fn new() -> Self {
        let matrices: [Matrix; 24] = std::array::from_fn(matrix);
        let quotient = |a: usize, b: usize| {
            let (a, b) = (&matrices[a], &matrices[b]);
            let wanted: Matrix =
                std::array::from_fn(|i| std::array::from_fn(|j| (0..3).map(|k| a[k][i] * b[k][j]).sum()));
            let index = matrices.iter().position(|found| *found == wanted);
            CubeRotation(index.expect("rotations are a group") as u8)
        };
        let inverses = std::array::from_fn(|a| quotient(a, 0));
        let product = |a: usize, b: usize| quotient(usize::from(inverses[a].0), b);
        Self { matrices, inverses, products: std::array::from_fn(|a| std::array::from_fn(|b| product(a, b))) }
    }
}

/// Computes the matrix of a rotation.
fn matrix(index: usize) -> Matrix {
    let axis = |k: usize| {
        let mut v = [0; 3];
        v[k / 2] = 1 - 2 * (k % 2) as i32;
        v
    };
    // Four choices of y remain for each image of x: the axes that are not ±x.
    let kx = index / 4;
    let ky = (0..6).filter(|k| k / 2 != kx / 2).nth(index % 4).unwrap_or(0);
    let (x, y) = (axis(kx), axis(ky));
    let z = [x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]];
    [[x[0], y[0], z[0]], [x[1], y[1], z[1]], [x[2], y[2], z[2]]]
}

impl CubeRotation {
    /// The identity.
    pub const IDENTITY: Self = Self(0);

    /// Iterates over all 24 rotations in index order.
    pub fn all() -> impl Iterator<Item = Self> {
        (0..24).map(Self)
    }

    /// Returns the rotation with these [axes](Self::axes); `None` unless they are two different axes.
    pub fn from_axes(axes: &str) -> Option<Self> {
        Self::all().find(|rotation| rotation.axes() == axes)
    }

    /// Returns the rotation as a row-major matrix of −1, 0, and 1; column `j` is the image of axis `j`.
    pub fn matrix(self) -> [[i32; 3]; 3] {
        TABLES.matrices[usize::from(self.0)]
    }

    /// Returns the signs of the magnets on the faces that point along +x, +y, and +z when a block is rotated; those on
    /// the opposite faces have the other signs.
    pub fn signs(self) -> [i32; 3] {
        self.matrix().map(|row| row.iter().sum())
    }

    /// Applies the rotation to an integer vector.
    pub fn apply(self, v: [i32; 3]) -> [i32; 3] {
        self.matrix().map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
    }

    /// Returns the inverse rotation.
    pub fn inverse(self) -> Self {
        TABLES.inverses[usize::from(self.0)]
    }

    /// Returns `self ∘ other`: first `other`, then `self`.
    pub fn compose(self, other: Self) -> Self {
        TABLES.products[usize::from(self.0)][usize::from(other.0)]
    }

    /// Returns the directions of the rotated x and y axes, as written in a blueprint's file: `+x +y` for the identity.
    pub fn axes(self) -> String {
        let matrix = self.matrix();
        let image = |column: usize| {
            let axis = (0..3).find(|&row| matrix[row][column] != 0).unwrap_or(0);
            format!("{}{}", if matrix[axis][column] > 0 { '+' } else { '-' }, ["x", "y", "z"][axis])
        };
        format!("{} {}", image(0), image(1))
    }

    /// Returns the rotation nearest to `orientation`, and the angle between the two in radians, 0 to about 1.1.
    ///
    /// The nearest rotation has the largest trace of `Rᵀ·M`, so no angle is computed for the other 23. Ties go to the
    /// first.
    pub fn nearest(orientation: &nalgebra::UnitQuaternion<f32>) -> (Self, f32) {
        let wanted = orientation.to_rotation_matrix();
        let trace = |r: Self| {
            let m = r.matrix();
            (0..9).map(|k| m[k / 3][k % 3] as f32 * wanted[(k / 3, k % 3)]).sum::<f32>()
        };
        let traces = Self::all().map(|rotation| (rotation, trace(rotation)));
        let nearest = traces.reduce(|best, next| if next.1 > best.1 { next } else { best });
        let (nearest, _) = nearest.expect("there are rotations");
        // Compute the angle from the quaternions: acos of the trace loses half the digits near zero.
        (nearest, nearest.quaternion().angle_to(orientation))
    }

    /// Returns the rotation as a unit quaternion.
    pub fn quaternion(self) -> nalgebra::UnitQuaternion<f32> {
        let m = nalgebra::Matrix3::from_fn(|i, j| self.matrix()[i][j] as f32);
        nalgebra::UnitQuaternion::from_rotation_matrix(&nalgebra::Rotation3::from_matrix_unchecked(m))
    }
}

/// Returns whether a block with three different sides lies in an odd permutation of its axes; `None` if sides are
/// equal. `own` are its sides along its own axes, and `size` those along the drawing's.
///
/// The product of a block's three [signs](CubeRotation::signs) is the determinant of this permutation.
pub fn is_odd(own: [i32; 3], size: [i32; 3]) -> Option<bool> {
    let is_distinct = own[0] != own[1] && own[1] != own[2] && own[0] != own[2];
    // The three cyclic permutations are the even ones.
    is_distinct.then(|| !(0..3).any(|by| (0..3).all(|k| size[k] == own[(k + by) % 3])))
}

/// The pose of block `b` relative to block `a` on the lattice. It is exact, so `==` can compare two of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct RelativePlacement {
    /// Center of `b` minus center of `a` in `a`'s frame, in half units (0.05 m).
    pub offset_half_units: [i32; 3],
    /// Rotation of `b` relative to `a`.
    pub rotation: CubeRotation,
}

impl RelativePlacement {
    /// Returns the center of `b` minus the center of `a` in `a`'s frame, in meters.
    pub fn position_m(&self) -> nalgebra::Vector3<f32> {
        nalgebra::Vector3::from(self.offset_half_units.map(|x| x as f32 * (UNIT_M / 2.0)))
    }

    /// Returns the pose of `a` relative to `b`.
    pub fn inverse(self) -> Self {
        let rotation = self.rotation.inverse();
        Self { offset_half_units: rotation.apply(self.offset_half_units).map(|x| -x), rotation }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use nalgebra::{UnitQuaternion, Vector3};
    use proptest::prelude::*;

    use super::*;
    use crate::{BlockIdx, Placement};

    #[test]
    fn rotations_form_a_group() {
        let all: Vec<_> = CubeRotation::all().collect();
        let matrices: BTreeSet<_> = all.iter().map(|r| r.matrix()).collect();
        assert_eq!(matrices.len(), 24);
        for &a in &all {
            assert_eq!(a.compose(CubeRotation::IDENTITY), a);
            assert_eq!(CubeRotation::IDENTITY.compose(a), a);
            assert_eq!(a.compose(a.inverse()), CubeRotation::IDENTITY);
            for &b in &all {
                let v = [1, 2, 3];
                assert_eq!(a.compose(b).apply(v), a.apply(b.apply(v)));
                for &c in &all {
                    assert_eq!(a.compose(b).compose(c), a.compose(b.compose(c)));
                }
            }
        }
    }

    #[test]
    fn index_order_follows_the_images_of_x_and_y() {
        for (index, axes, x, y) in [
            (0, "+x +y", [1, 0, 0], [0, 1, 0]),
            (1, "+x -y", [1, 0, 0], [0, -1, 0]),
            (3, "+x -z", [1, 0, 0], [0, 0, -1]),
            (4, "-x +y", [-1, 0, 0], [0, 1, 0]),
            (8, "+y +x", [0, 1, 0], [1, 0, 0]),
            (23, "-z -y", [0, 0, -1], [0, -1, 0]),
        ] {
            let rotation = CubeRotation::try_from(index).unwrap();
            assert_eq!(CubeRotation::from_axes(axes), Some(rotation), "index {index}");
            assert_eq!([rotation.apply([1, 0, 0]), rotation.apply([0, 1, 0])], [x, y], "index {index}");
        }
        for axes in ["+x +x", "+x -x", "+x", "x y", "+x  +y", ""] {
            assert_eq!(CubeRotation::from_axes(axes), None, "{axes:?}");
        }
        assert_eq!(CubeRotation::try_from(24), Err(InvalidRotation(24)));
    }

    #[test]
    fn quaternion_agrees_with_the_matrix() {
        for rotation in CubeRotation::all() {
            let [x, y, z] = rotation.apply([1, 2, 3]).map(|x| x as f32);
            let turned = rotation.quaternion() * Vector3::new(1.0, 2.0, 3.0);
            assert!((turned - Vector3::new(x, y, z)).norm() < 1e-5, "{rotation:?}");
        }
    }

    fn rotation() -> impl Strategy<Value = CubeRotation> {
        (0_u8..24).prop_map(|index| CubeRotation::try_from(index).unwrap())
    }

    fn placement(block: u8) -> impl Strategy<Value = Placement> {
        let block = BlockIdx::try_from(block).unwrap();
        (prop::array::uniform3(-20..20), rotation()).prop_map(move |(center_half_units, rotation)| Placement {
            block,
            center_half_units,
            rotation,
        })
    }

    proptest! {
        #[test]
        fn nearest_undoes_a_small_turn(
            rotation in rotation(),
            axis in prop::array::uniform3(-1.0_f32..1.0),
            angle in 0.0_f32..0.7,
        ) {
            let axis = Vector3::from(axis);
            prop_assume!(axis.norm() > 0.1);
            let turn = UnitQuaternion::from_scaled_axis(axis.normalize() * angle);
            let (found, found_angle) = CubeRotation::nearest(&(rotation.quaternion() * turn));
            // Rotations of the cube are at least π/2 apart, so below π/4 the answer is unique.
            prop_assert_eq!(found, rotation);
            prop_assert!((found_angle - angle).abs() < 1e-3);
        }

        #[test]
        fn relative_placements_invert_and_follow_the_frame(
            a in placement(0), b in placement(1), turn in rotation(),
        ) {
            let relative = RelativePlacement::between(&a, &b);
            prop_assert_eq!(relative.inverse(), RelativePlacement::between(&b, &a));
            prop_assert_eq!(relative.inverse().inverse(), relative);
            let turned = |p: Placement| Placement {
                center_half_units: turn.apply(p.center_half_units),
                rotation: turn.compose(p.rotation),
                ..p
            };
            prop_assert_eq!(RelativePlacement::between(&turned(a), &turned(b)), relative);
        }
    }
}
