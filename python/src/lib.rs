//! Python bindings of Lodestone's worlds and policy: batches behind arrays that Python owns.
//!
//! Worlds step and the policy acts without the global interpreter lock. Features are written directly to the arrays
//! that Python receives. Invalid arguments raise a `ValueError`, too many worlds a `MemoryError`. The
//! Gymnasium and PettingZoo classes are Python files in `lodestone`, and `lodestone/_native.pyi` documents the
//! arguments and results of each method.
//!
//! Reading order: `settings` → `goals` and `tasks` (what to build) → `history` → `row` (one world) →
//! `proposals` → `worlds` (a batch) → `picture` → `agent` (the policy).

mod agent;
mod arrays;
mod error;
mod goals;
mod history;
mod picture;
mod proposals;
mod row;
mod settings;
mod tasks;
mod worlds;

/// The module `lodestone._native`.
#[pyo3::pymodule(gil_used = false)]
mod _native {
    #[pymodule_export]
    use crate::agent::Policy;
    #[pymodule_export]
    use crate::goals::named;
    #[pymodule_export]
    use crate::worlds::Worlds;
}
