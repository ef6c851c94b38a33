//! Observation and action spaces in Gymnasium's terms, serialized in Minari's format.
//!
//! The Python package defines the same spaces (`python/lodestone/batch.py`), and a test there compares the two.

use blueprints::N_BLOCKS;
use policy::features::N_EDGES;
use policy::{FeatureConfig, FeatureSizes};
use serde_json::{Value, json};

/// Number of entries in a block's move.
pub(crate) const N_MOVES: usize = 6;
/// Bound of the observations, which no feature of a valid world exceeds.
const MAX_FEATURE: f32 = 256.0;

/// The spaces of a world observed with some features.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spaces {
    /// Configuration of the features.
    pub features: FeatureConfig,
    pub(crate) sizes: FeatureSizes,
}

impl Spaces {
    /// Creates the spaces of a feature configuration.
    pub fn new(features: &FeatureConfig) -> Self {
        Self { features: *features, sizes: FeatureSizes::new(features) }
    }

    /// Returns the number of grippers.
    pub fn n_grippers(&self) -> usize {
        usize::from(self.features.n_grippers)
    }

    /// Returns how many numbers an observation's nodes, edges, and globals have.
    pub fn lengths(&self) -> [usize; 3] {
        [N_BLOCKS * self.sizes.node, N_EDGES * self.sizes.edge, self.sizes.global]
    }

    /// Returns a dictionary of `nodes`, 16 × nd, `edges`, 240 × ed, and `globals`, gd.
    pub(crate) fn observations(&self) -> Value {
        let FeatureSizes { node, edge, global } = self.sizes;
        dictionary(&[
            ("edges", bounded(MAX_FEATURE, &[N_EDGES, edge])),
            ("globals", bounded(MAX_FEATURE, &[global])),
            ("nodes", bounded(MAX_FEATURE, &[N_BLOCKS, node])),
        ])
    }

    /// Returns a dictionary of `choices`, one for each gripper, and `moves`, 16 × 6.
    pub(crate) fn actions(&self) -> Value {
        let n = self.n_grippers();
        let choices = json!({
            "type": "MultiDiscrete", "dtype": "int64", "nvec": vec![N_BLOCKS; n], "start": vec![0; n],
        });
        dictionary(&[("choices", choices), ("moves", bounded(1.0, &[N_BLOCKS, N_MOVES]))])
    }
}

fn dictionary(subspaces: &[(&str, Value)]) -> Value {
    let subspaces: serde_json::Map<String, Value> =
        subspaces.iter().map(|(name, space)| ((*name).to_owned(), space.clone())).collect();
    json!({ "type": "Dict", "subspaces": subspaces })
}

/// Returns a space of numbers from `-limit` to `limit`.
fn bounded(limit: f32, shape: &[usize]) -> Value {
    let filled = |bound: f32| shape.iter().rev().fold(json!(bound), |inner, &n| Value::Array(vec![inner; n]));
    json!({ "type": "Box", "dtype": "float32", "shape": shape, "low": filled(-limit), "high": filled(limit) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spaces_are_written_as_minari_writes_them() {
        let features = FeatureConfig { n_grippers: 1, ..FeatureConfig::default() };
        let spaces = Spaces::new(&features);
        // 10 per node, 36 per edge, 25 per gripper.
        assert_eq!(spaces.lengths(), [160, 8640, 25]);
        let seen = spaces.observations();
        assert_eq!(seen["subspaces"]["edges"]["shape"], json!([240, 36]));
        assert_eq!(seen["subspaces"]["nodes"]["low"][15], json!(vec![-256.0; 10]));
        let done = spaces.actions();
        let choices = json!({ "type": "MultiDiscrete", "dtype": "int64", "nvec": [16], "start": [0] });
        assert_eq!(done["subspaces"]["choices"], choices);
        assert_eq!(done["subspaces"]["moves"]["high"], json!(vec![[1.0; 6]; 16]));
    }
}
