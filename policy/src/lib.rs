//! From a scene to an action: graph features, the network, the action distribution, and parameters as flat vectors.
//!
//! Reading order: [`config`] → [`features`] → [`batch`] → [`network`] → [`cpu`] → [`engine`] → [`parameters`] →
//! [`distribution`] (the Gaussian head) → [`proposals`] and [`mixture`] (the other head) → [`policy`] (inference) and
//! [`loss_terms`] (the same distributions on tensors, for training); [`model`] (a policy in a file).

#![cfg_attr(test, allow(clippy::unwrap_used))]

pub mod batch;
pub mod config;
pub mod cpu;
pub mod device;
pub mod distribution;
pub mod engine;
pub mod features;
mod geometry;
pub mod loss_terms;
pub mod mixture;
pub mod model;
pub mod network;
pub mod normalization;
pub mod parameters;
pub mod policy;
pub mod proposals;

pub use batch::FeatureBatch;
pub use config::{
    BlockMask, EncoderConfig, FeatureConfig, GatConfig, MoveHead, NetworkConfig, PolicyConfig, ResnetConfig,
};
pub use device::{DeviceError, DeviceKind};
pub use engine::{Engine, Leaves};
pub use features::FeatureSizes;
pub use model::{Model, ModelError};
pub use network::{BatchTensors, MoveTensors, Network, NetworkOutput};
pub use policy::{Attention, Policy, PolicyError, check_settings};
