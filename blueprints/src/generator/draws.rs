//! The generated structures that may be training goals; actors and the learner share this rule.

use std::collections::BTreeSet;

use super::{Request, Style};

/// Largest seed of a structure drawn as a goal; the generator itself accepts any seed.
pub const MAX_DRAWN_SEED: u32 = u32::MAX;

/// Styles and sizes of the structures drawn as goals.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Draws {
    styles: BTreeSet<Style>,
    sizes: BTreeSet<usize>,
}

impl Draws {
    /// Creates draws of these styles and numbers of blocks; each style is drawn only in the sizes that it supports.
    pub fn new(styles: impl IntoIterator<Item = Style>, sizes: impl IntoIterator<Item = usize>) -> Self {
        Self { styles: styles.into_iter().collect(), sizes: sizes.into_iter().collect() }
    }

    /// Returns whether the request can be drawn. Checks only the request and generates nothing; whether the structure
    /// has the outline of a held-out one is known only after generation.
    pub fn admit(&self, request: &Request) -> bool {
        self.styles.contains(&request.style)
            && self.sizes.contains(&request.n_blocks)
            && request.seed <= u64::from(MAX_DRAWN_SEED)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_outside_the_draws_are_refused() {
        let draws = Draws::new([Style::Tower, Style::Arch], [3, 4, 6]);
        let request = Request { style: Style::Tower, seed: u64::from(MAX_DRAWN_SEED), n_blocks: 4, index: 999 };
        assert!(draws.admit(&request));
        assert!(draws.admit(&Request { style: Style::Arch, n_blocks: 6, ..request }));
        for other in [
            Request { style: Style::Wall, ..request },
            Request { n_blocks: 5, ..request },
            Request { seed: request.seed + 1, ..request },
        ] {
            assert!(!draws.admit(&other), "{other:?}");
        }
    }
}
