//! The groups of blueprints in reports: the paper's, and the validation split.

use crate::Split;
use serde::{Deserialize, Serialize};

/// A column of the paper's ablation table, in the paper's order, or a part of the validation split.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum Group {
    /// Training blueprints of 2 to 6 blocks.
    Train2To6,
    /// Training blueprints of 7 to 11 blocks.
    Train7To11,
    /// Training blueprints of 12 to 16 blocks.
    Train12To16,
    /// Held-out blueprints of 12 to 16 blocks in the style of training.
    Test12To16,
    /// Held-out literal, longest and tallest blueprints.
    TestSpecial,
    /// Blueprints of 2 to 6 blocks of the validation split, which is not in the paper.
    Validation2To6,
    /// Blueprints of 7 to 16 blocks of the validation split.
    Validation,
}

/// A string that is not a group name.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{0:?} is not a group: train 2-6, train 7-11, train 12-16, test 12-16, test special, validation 2-6 or validation"
)]
pub struct InvalidGroup(pub String);

impl TryFrom<String> for Group {
    type Error = InvalidGroup;

    fn try_from(name: String) -> Result<Self, InvalidGroup> {
        Self::ALL.into_iter().find(|group| group.name() == name).ok_or(InvalidGroup(name))
    }
}

impl From<Group> for String {
    fn from(group: Group) -> Self {
        group.name().to_owned()
    }
}

impl Group {
    /// All groups in the paper's order, then validation.
    pub const ALL: [Self; 7] = [
        Self::Train2To6,
        Self::Train7To11,
        Self::Train12To16,
        Self::Test12To16,
        Self::TestSpecial,
        Self::Validation2To6,
        Self::Validation,
    ];

    /// Returns the group of a blueprint of `n_blocks` blocks; `None` for a size outside the paper's groups.
    pub fn of(split: Split, n_blocks: usize) -> Option<Self> {
        match (split, n_blocks) {
            (Split::Train, 2..=6) => Some(Self::Train2To6),
            (Split::Train, 7..=11) => Some(Self::Train7To11),
            (Split::Train, 12..=16) => Some(Self::Train12To16),
            (Split::Test, 12..=16) => Some(Self::Test12To16),
            (Split::TestLiteral | Split::TestLongest | Split::TestTallest, _) => Some(Self::TestSpecial),
            (Split::Validation, 2..=6) => Some(Self::Validation2To6),
            (Split::Validation, _) => Some(Self::Validation),
            (Split::Train | Split::Test, _) => None,
        }
    }

    /// Returns the name used in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Train2To6 => "train 2-6",
            Self::Train7To11 => "train 7-11",
            Self::Train12To16 => "train 12-16",
            Self::Test12To16 => "test 12-16",
            Self::TestSpecial => "test special",
            Self::Validation2To6 => "validation 2-6",
            Self::Validation => "validation",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn group_boundaries() {
        let table = [
            (Split::Train, 1, None),
            (Split::Train, 2, Some(Group::Train2To6)),
            (Split::Train, 6, Some(Group::Train2To6)),
            (Split::Train, 7, Some(Group::Train7To11)),
            (Split::Train, 11, Some(Group::Train7To11)),
            (Split::Train, 12, Some(Group::Train12To16)),
            (Split::Train, 16, Some(Group::Train12To16)),
            (Split::Test, 11, None),
            (Split::Test, 16, Some(Group::Test12To16)),
            (Split::TestLiteral, 10, Some(Group::TestSpecial)),
            (Split::TestLongest, 12, Some(Group::TestSpecial)),
            (Split::TestTallest, 16, Some(Group::TestSpecial)),
            (Split::Validation, 6, Some(Group::Validation2To6)),
            (Split::Validation, 7, Some(Group::Validation)),
            (Split::Validation, 16, Some(Group::Validation)),
        ];
        for (split, n_blocks, group) in table {
            assert_eq!(Group::of(split, n_blocks), group, "{split:?} {n_blocks}");
        }
    }
}
