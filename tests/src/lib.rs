//! Nothing to use: this crate exists for its one integration binary, `tests/main.rs`, which runs what no single crate can.
