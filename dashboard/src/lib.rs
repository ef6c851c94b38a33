//! A running training, to look at: as a web page and as a view in the terminal.
//!
//! Reading order: `follow` (what comes from the bus) → `run_view` (what is known) → [`web`], which is served beside an
//! evaluator, and [`terminal`], which is drawn wherever the bus can be reached. Neither holds up what it shows: both
//! follow the bus as any client does.

#![cfg_attr(test, allow(clippy::unwrap_used))]

pub mod config;
mod follow;
mod run_view;
pub mod terminal;
pub mod web;

pub use config::DashboardConfig;
pub use web::{About, Builder, FinishedRun, Kind, Order, Page, Source, Stage, StageError, WebError, export};

#[cfg(test)]
mod samples;
