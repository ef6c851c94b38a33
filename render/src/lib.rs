//! Rendering: functions from scenes and recordings to PNG, GIF, and MP4. No I/O, no clock.
//!
//! Reading order: [`picture`] (blocks in a world) → [`video`] (episodes, and a policy's attention in them).

#![cfg_attr(test, allow(clippy::unwrap_used))]
#![cfg_attr(not(feature = "videos"), allow(dead_code, unused_imports))]

pub mod picture;
#[cfg(feature = "videos")]
pub mod video;
