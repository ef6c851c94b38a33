//! Random names for processes that were not given one, and other random text.

use rand::TryRng;
use rand::rngs::{SysError, SysRng};

const LETTERS: &[u8; 36] = b"abcdefghijklmnopqrstuvwxyz0123456789";

/// Characters after the role: 36^10 names, so two of ten thousand processes share one with a probability of 1 in 70
/// million.
const N_LETTERS: usize = 10;

/// Returns `<role>-<10 letters and digits>`. The randomness comes from the operating system, because process ids and
/// times are the same in containers that start alike.
pub(crate) fn random_name(role: &str) -> Result<String, SysError> {
    Ok(format!("{role}-{}", random_text(LETTERS, N_LETTERS)?))
}

/// Draws `n` of at most 64 ASCII characters, all of them equally likely.
pub(crate) fn random_text(characters: &[u8], n: usize) -> Result<String, SysError> {
    let mut text = String::new();
    while text.len() < n {
        // Six bits at a time; a value beyond the characters is redrawn.
        let word = SysRng.try_next_u32()?;
        text.extend(characters.get((word & 63) as usize).map(|&character| char::from(character)));
    }
    Ok(text)
}

#[cfg(test)]
mod tests {
    use proto::ActorId;

    use super::*;

    #[test]
    fn names_are_valid_and_differ() {
        let names: std::collections::BTreeSet<String> = (0..1000).map(|_| random_name("actor").unwrap()).collect();
        assert_eq!(names.len(), 1000);
        for name in names {
            assert_eq!((name.len(), name.starts_with("actor-")), (16, true), "{name}");
            ActorId::try_from(name).unwrap();
        }
    }
}
