//! A random number generator that can be copied and kept.

use rand::SeedableRng;
use rand::rngs::ChaCha8Rng;
use serde::{Deserialize, Serialize};

/// The generator of all random draws, for whoever copies or saves it: as its seed, its stream, and the number of 32-bit
/// words that it has drawn.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
#[serde(from = "Position", into = "Position")]
pub struct SavedRng(pub ChaCha8Rng);

#[derive(Serialize, Deserialize)]
struct Position {
    seed: [u8; 32],
    stream: u64,
    word_pos: u128,
}

impl From<SavedRng> for Position {
    fn from(SavedRng(rng): SavedRng) -> Self {
        Self { seed: rng.get_seed(), stream: rng.get_stream(), word_pos: rng.get_word_pos() }
    }
}

impl From<Position> for SavedRng {
    fn from(Position { seed, stream, word_pos }: Position) -> Self {
        let mut rng = ChaCha8Rng::from_seed(seed);
        rng.set_stream(stream);
        rng.set_word_pos(word_pos);
        Self(rng)
    }
}

impl Clone for SavedRng {
    fn clone(&self) -> Self {
        Self(ChaCha8Rng::deserialize_state(&self.0.serialize_state()))
    }
}

#[cfg(test)]
mod tests {
    use rand::Rng;

    use super::*;

    #[test]
    fn a_generator_is_kept_as_earlier_versions_kept_it() {
        let mut rng = SavedRng(ChaCha8Rng::from_seed([3; 32]));
        rng.0.set_stream(5);
        (0..37).for_each(|_| _ = rng.0.next_u32());
        let json = serde_json::to_string(&rng).unwrap();
        let seed = ["3"; 32].join(",");
        assert_eq!(json, format!(r#"{{"seed":[{seed}],"stream":5,"word_pos":37}}"#));
        let mut kept: SavedRng = serde_json::from_str(&json).unwrap();
        let mut copy = rng.clone();
        assert_eq!(kept, rng);
        assert_eq!([kept.0.next_u64(), copy.0.next_u64()], [rng.0.next_u64(); 2]);
    }
}
