//! The `lodestone` program as users and machines see it: its command line, whole clusters, failures, and its page in a
//! browser.
//!
//! All tests share one binary, because each binary would link burn, rapier, and zenoh again. It is a target of the
//! package `deploy`, because cargo sets the path of a program only for tests in the program's own package.

#![allow(clippy::unwrap_used)]

mod access;
mod best;
mod browser;
mod cli;
mod cluster;
mod compatibility;
mod finished;
mod output;
mod outside;
mod record;
mod report;
mod resume;
mod sharing;
mod shutdown;
mod support;
mod sweep;
mod train;
mod videos;
mod watch;
mod web;
