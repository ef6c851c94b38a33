//! Conversions between nalgebra, used everywhere else, and glam, rapier's own types. No other module may name glam.

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};
use proto::Pose;
use rapier3d::math;

pub(crate) fn to_rapier(v: Vector3<f32>) -> math::Vector {
    math::Vector::new(v.x, v.y, v.z)
}

pub(crate) fn from_rapier(v: math::Vector) -> Vector3<f32> {
    Vector3::new(v.x, v.y, v.z)
}

pub(crate) fn pose_to_rapier(pose: &Isometry3<f32>) -> math::Pose {
    let q = pose.rotation;
    math::Pose::from_parts(to_rapier(pose.translation.vector), math::Rotation::from_xyzw(q.i, q.j, q.k, q.w))
}

pub(crate) fn pose_from_rapier(pose: &math::Pose) -> Isometry3<f32> {
    let q = pose.rotation;
    // Do not normalize: the engine keeps its quaternions normalized, and a second pass would change their last bit.
    let rotation = UnitQuaternion::new_unchecked(Quaternion::new(q.w, q.x, q.y, q.z));
    Isometry3::from_parts(Translation3::from(from_rapier(pose.translation)), rotation)
}

/// Converts to the pose type of messages.
pub(crate) fn to_pose(pose: &Isometry3<f32>) -> Pose {
    Pose { position: pose.translation.vector.into(), orientation: pose.rotation.coords.into() }
}

/// Converts from the pose type of messages. Normalizes the quaternion, which may be off by rounding.
pub(crate) fn from_pose(pose: &Pose) -> Isometry3<f32> {
    Isometry3::from_parts(pose.position.into(), UnitQuaternion::new_normalize(pose.orientation.into()))
}
