//! From weights to reports: episodes of a frozen policy, success per blueprint and group with its uncertainty.
//!
//! Reading order: [`config`] → [`report`] and [`group`] (what is counted) → `lanes` (worlds side by side) →
//! `desk` (who runs which) → [`episodes`] and [`reset_free`] (what is run) → [`table`] and [`history`] (what is shown and
//! kept) → [`run()`] (the service on the bus), which shares its work by `clerks` with processes that [`assist()`]; [`web`]
//! serves a page about a running training, [`picture`] draws blocks, [`plot`] trainings, [`video`] films of episodes, of
//! which [`films`] makes some in every pass.

#![cfg_attr(test, allow(clippy::unwrap_used))]

mod assist;
mod clerks;
pub mod config;
mod desk;
pub mod episodes;
pub mod expert;
pub mod films;
pub mod group;
pub mod history;
mod lanes;
mod nice;
pub mod picture;
pub mod plot;
mod recording;
mod records;
pub mod report;
pub mod reset_free;
mod run;
mod schedule;
pub mod table;
pub mod trials;
mod vetting;
pub mod video;
pub mod web;

pub use assist::assist;
pub use config::{EpisodeConfig, EvaluatorConfig, EvaluatorConfigError, Every, ResetFreeConfig, Selection, Starts};
pub use environment::EnvironmentConfig;
pub use episodes::{EvalError, EvalSetup, evaluate};
pub use expert::{Cause, ExpertFailure, ExpertReport, ExpertSetup, evaluate_expert};
pub use films::{FilmsConfig, REPLAYS, VIDEOS};
pub use group::Group;
pub use history::{HISTORY, History, HistoryError, Pass};
pub use policy::{Policy, PolicyConfig, PolicyError};
pub use report::{Acting, EvalReport};
pub use run::{EvaluatorSetup, RecordPaths, Stop, run};
pub use table::{Detail, render, render_expert};
pub use web::{Page, WebError};
