//! What goes over the wire: golden bytes, round trips, every rule of decoding, and bytes from anybody.

mod golden;
mod properties;
mod rules;
mod samples;
