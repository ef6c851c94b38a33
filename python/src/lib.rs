//! The worlds and the policy of Lodestone for Python: batches of them behind arrays that Python owns.
//!
//! Worlds step and the policy acts without the global interpreter lock, and features are written into the arrays that Python
//! gets. Whatever is wrong with an argument becomes a `ValueError`. The classes of Gymnasium and PettingZoo are Python files in
//! `lodestone`, and `lodestone/_native.pyi` says what each method takes and gives.
//!
//! Reading order: `goals` and `tasks` (what to build) → `row` (one world) → `worlds` (many) → `picture` → `model` and `agent`
//! (the policy).

mod agent;
mod arrays;
mod error;
mod goals;
mod model;
mod picture;
mod row;
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
