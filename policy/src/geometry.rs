//! Rotation helpers for features.

use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};
use proto::Pose;

/// Position and rotation of a block, with the rotation as a matrix.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Frame {
    /// Center, m.
    pub(crate) position: Vector3<f32>,
    /// Columns are the block's axes in the world.
    pub(crate) axes: Matrix3<f32>,
}

impl Frame {
    pub(crate) fn new(pose: &Pose) -> Self {
        Self { position: Vector3::from(pose.position), axes: rotation(pose.orientation) }
    }

    /// Rotates a world vector into this frame.
    pub(crate) fn localize(&self, v: &Vector3<f32>) -> Vector3<f32> {
        self.axes.tr_mul(v)
    }
}

/// Returns the rotation matrix of a quaternion x, y, z, w, which is normalized first.
pub(crate) fn rotation([x, y, z, w]: [f32; 4]) -> Matrix3<f32> {
    *UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z)).to_rotation_matrix().matrix()
}

/// Converts a rotation of the lattice.
pub(crate) fn matrix(rows: [[i32; 3]; 3]) -> Matrix3<f32> {
    Matrix3::from_fn(|i, j| rows[i][j] as f32)
}

/// Returns axis times angle of a rotation, with the angle in 0..=π rad.
pub(crate) fn rotation_vector(m: &Matrix3<f32>) -> Vector3<f32> {
    let q = quaternion(m);
    // Both signs are the same rotation; the one with w ≥ 0 has an angle of at most π.
    let q = if q.w < 0.0 { -q } else { q };
    let v = q.imag();
    let sine = v.norm();
    // The limit 2v is exact to f32 rounding here; dividing by `sine` would lose the axis.
    if sine < 1e-6 { v * 2.0 } else { v * (2.0 * sine.atan2(q.w) / sine) }
}

/// Returns the quaternion of a rotation matrix. Pivots on the largest diagonal entry, so that half turns stay exact.
fn quaternion(m: &Matrix3<f32>) -> Quaternion<f32> {
    let trace = m.trace();
    let q = if trace > 0.0 {
        Quaternion::new(1.0 + trace, m[(2, 1)] - m[(1, 2)], m[(0, 2)] - m[(2, 0)], m[(1, 0)] - m[(0, 1)])
    } else if m[(0, 0)] >= m[(1, 1)] && m[(0, 0)] >= m[(2, 2)] {
        let d = 1.0 + m[(0, 0)] - m[(1, 1)] - m[(2, 2)];
        Quaternion::new(m[(2, 1)] - m[(1, 2)], d, m[(0, 1)] + m[(1, 0)], m[(0, 2)] + m[(2, 0)])
    } else if m[(1, 1)] >= m[(2, 2)] {
        let d = 1.0 + m[(1, 1)] - m[(0, 0)] - m[(2, 2)];
        Quaternion::new(m[(0, 2)] - m[(2, 0)], m[(0, 1)] + m[(1, 0)], d, m[(1, 2)] + m[(2, 1)])
    } else {
        let d = 1.0 + m[(2, 2)] - m[(0, 0)] - m[(1, 1)];
        Quaternion::new(m[(1, 0)] - m[(0, 1)], m[(0, 2)] + m[(2, 0)], m[(1, 2)] + m[(2, 1)], d)
    };
    q / q.norm()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rotation_vectors_of_known_turns() {
        for v in
            [[0.0, 0.0, 0.0], [0.1, -0.2, 0.3], [3.1, 0.0, 0.0], [0.0, -3.1, 0.1], [1.7, 1.7, -1.7], [1e-8, 0.0, 0.0]]
        {
            let v = Vector3::from(v);
            let m = *nalgebra::Rotation3::new(v).matrix();
            assert!((rotation_vector(&m) - v).norm() < 1e-5, "{v} gave {}", rotation_vector(&m));
        }
        let half_turn = Matrix3::from_diagonal(&Vector3::new(-1.0, -1.0, 1.0));
        let v = rotation_vector(&half_turn);
        assert!((v.z.abs() - std::f32::consts::PI).abs() < 1e-6 && v.x == 0.0 && v.y == 0.0);
    }
}
