//! The `lodestone` program: command line, configuration, signals, logs, and terminal output around the services.
//!
//! Reading order: [`cli`] → [`config`] → [`commands`] → [`live`], then the smaller modules.

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
mod replace;
pub mod run_dir;
mod shell;
pub mod signals;
pub mod telemetry;
