//! The `lodestone` program: command line, configuration, signals, logs, and terminal output around the services.
//!
//! Reading order: [`cli`] → [`config`] → [`commands`] → [`live`], then the smaller modules.

#![cfg_attr(test, allow(clippy::unwrap_used))]

pub mod cli;
pub mod commands;
pub mod config;
pub mod exit;
mod health;
pub mod keys;
pub mod live;
mod names;
mod replace;
mod run_dir;
mod shell;
mod signals;
pub mod telemetry;
