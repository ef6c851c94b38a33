//! Rendering: functions from scenes, recordings, and histories to SVG, PNG, GIF, and MP4. No I/O, no clock.
//!
//! Reading order: [`picture`] (blocks in a world) → [`video`] (episodes, and a policy's attention in them) → [`plot`]
//! (training runs).

#![cfg_attr(test, allow(clippy::unwrap_used))]
#![cfg_attr(not(feature = "films"), allow(dead_code, unused_imports))]

pub mod picture;
#[cfg(feature = "films")]
pub mod plot;
#[cfg(feature = "films")]
pub mod video;
