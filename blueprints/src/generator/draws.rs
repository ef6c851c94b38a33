//! Which structures of the generator are goals of a training: known to whoever draws them and to whoever is sent them.

use std::collections::BTreeSet;

use super::{Request, Style};

/// Largest seed of a structure that is drawn as a goal; the generator itself takes any.
pub const MAX_DRAWN_SEED: u32 = u32::MAX;

/// Styles and sizes of the structures that are drawn as goals.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Draws {
    styles: BTreeSet<Style>,
    sizes: BTreeSet<usize>,
}

impl Draws {
    /// Structures of these styles and numbers of blocks, as far as a style has the size.
    pub fn new(styles: impl IntoIterator<Item = Style>, sizes: impl IntoIterator<Item = usize>) -> Self {
        Self { styles: styles.into_iter().collect(), sizes: sizes.into_iter().collect() }
    }

    /// Whether such a structure can be drawn. This looks at the request alone and makes nothing; whether the structure is one
    /// of the held-out ones shows only when it is made.
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
    fn style_size_and_seed_must_be_among_those_drawn() {
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
