//! Random names for processes that were not given one.

use rand::TryRng;
use rand::rngs::{SysError, SysRng};

/// Characters of a random name.
const LETTERS: &[u8; 36] = b"abcdefghijklmnopqrstuvwxyz0123456789";

/// Characters after the role: 36^10 names, so two of ten thousand processes share one with a probability of 1 in 70
/// million.
const N_LETTERS: usize = 10;

/// Returns `<role>-<10 letters and digits>`. The randomness comes from the operating system, because process ids and
/// times are the same in containers that start alike.
///
/// # Errors
/// When the operating system provides no randomness.
pub fn random_name(role: &str) -> Result<String, SysError> {
    let mut name = format!("{role}-");
    let length = name.len() + N_LETTERS;
    while name.len() < length {
        // 252 of a byte's 256 values are a multiple of 36; the rest would favor the first letters.
        let [byte, ..] = SysRng.try_next_u32()?.to_le_bytes();
        if byte < 252 {
            name.push(LETTERS[usize::from(byte % 36)].into());
        }
    }
    Ok(name)
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
