//! Empty: this crate exists for its integration test binary, `tests/main.rs`, whose tests belong to no single crate.
