//! Views of a running training: a web page and a terminal view.
//!
//! Reading order: `follow` (messages from the bus) → `run_view` (the known state of a run) → [`web`], served by the
//! evaluator process, and [`terminal`], which runs anywhere that can reach the bus. Neither slows down the run: both
//! follow the bus like any other client.

#![cfg_attr(test, allow(clippy::unwrap_used))]

pub mod config;
mod follow;
mod run_view;
pub mod terminal;
pub mod web;

pub use config::DashboardConfig;
pub use run_view::{Sizes, success_rate, waits};
pub use web::{About, Builder, Farewell, Finished, Kind, Order, Page, ShownRun, Stage, StageError, WebError, export};

#[cfg(test)]
mod tests;
