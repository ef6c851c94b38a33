//! Names of processes that nobody gave one.

use rand::TryRng;
use rand::rngs::{SysError, SysRng};

/// What a random name is made of.
const LETTERS: &[u8; 36] = b"abcdefghijklmnopqrstuvwxyz0123456789";

/// Letters after the role: 36^10 names, of which ten thousand processes share one with a probability of 1 in 70 million.
const N_LETTERS: usize = 10;

/// `<role>-<10 letters and digits>`, from the operating system's randomness: process ids and times are the same in
/// containers that start alike.
///
/// # Errors
/// When the operating system has none.
pub fn random_name(role: &str) -> Result<String, SysError> {
    let mut name = format!("{role}-");
    let length = name.len() + N_LETTERS;
    while name.len() < length {
        // Of a byte's 256 values 252 are 7 times 36; the others would favor the first letters.
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
