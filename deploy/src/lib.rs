//! The program `lodestone`: command line, configuration, signals, logs and terminal around the services.
//!
//! Reading order: [`cli`] → [`config`] → [`commands`] → [`live`] and the small parts.

#![cfg_attr(test, allow(clippy::unwrap_used))]

pub mod cli;
pub mod commands;
pub mod config;
pub mod exit;
pub mod health;
pub mod keys;
pub mod limits;
pub mod live;
pub mod names;
pub mod run_dir;
pub mod signals;
pub mod telemetry;
