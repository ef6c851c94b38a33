//! The program `lodestone` as users and machines meet it: its command line, whole clusters, faults, its pages in a browser.
//!
//! One binary instead of one per file: each would link burn, rapier and zenoh again. It is a target of the package `deploy`,
//! because cargo tells only the tests of a program's own package where the program is.

#![allow(clippy::unwrap_used)]

mod access;
mod bench;
mod browser;
mod cli;
mod cluster;
mod compatibility;
mod films;
mod finished;
mod record;
mod report;
mod resume;
mod support;
mod train;
mod watch;
mod web;
