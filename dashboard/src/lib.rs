//! A running training, to look at: as a web page and as a view in the terminal.
//!
//! [`web`] is served beside an evaluator, [`terminal`] is drawn wherever the bus can be reached. Neither holds up what it shows:
//! both follow the bus as any client does.

#![cfg_attr(test, allow(clippy::unwrap_used))]

pub mod config;
pub mod terminal;
pub mod web;

pub use config::DashboardConfig;
pub use web::{Page, Source, WebError};
