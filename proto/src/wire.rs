//! The prost types generated from `proto/lodestone.proto`; only the codec uses them.

#![allow(missing_docs, unreachable_pub, clippy::all)]

include!(concat!(env!("OUT_DIR"), "/lodestone.v1.rs"));
