//! Tests of the wire format: golden bytes, round trips, decoding rules, and arbitrary bytes.

mod golden;
mod properties;
mod rules;
mod samples;
