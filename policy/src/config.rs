//! Policy settings: features, network, and action distribution.

use blueprints::N_BLOCKS;
use proto::codec::MAX_PARAMETERS;
use proto::setting::above_to;
use proto::{CanonicalSettings, InvalidSetting, SettingsDifference, config_hash, settings};
use serde::{Deserialize, Serialize};

/// Version of the lists in `features.rs`, incremented when an entry moves or changes its meaning. Increment the format
/// versions of checkpoints and policies with it, so that programs refuse parameters that were trained on other features.
pub const FEATURE_LAYOUT: u32 = 3;

/// Version of the [slots](crate::proposals::Slot) and of the read-outs in `mixture.rs`, incremented likewise.
pub const MIXTURE_LAYOUT: u32 = 2;

/// Smallest standard deviation of a move (paper).
pub(crate) const MIN_STD: f32 = 1e-6;

settings! {
    /// Everything that determines the meaning of a set of parameters. All services of a run use the same configuration.
    pub struct PolicyConfig in "policy" {
        /// The network.
        pub network: NetworkConfig;
        /// Features of the observations.
        pub features: FeatureConfig;
        /// Which blocks a gripper may choose.
        pub mask: BlockMask = BlockMask::None;
    }

    /// Features of the observations. The base is the paper's; every flag adds an extension. See [`crate::features`] for
    /// the indices.
    #[derive(Copy, Eq)]
    pub struct FeatureConfig {
        /// Nodes: the world's up axis in the block's frame.
        pub up_axis: bool = true;
        /// Nodes: whether the block belongs to the blueprint.
        pub membership: bool = true;
        /// Nodes: the block's half extents.
        pub block_shape: bool = true;
        /// Edges: the move that the receiver needs if the sender stays, at two scales.
        pub needed_moves: bool = true;
        /// Number of grippers that the globals describe, and that choose a block.
        pub n_grippers: u8 = 2, in 1..=2;
    }

    /// The network (paper, section "Agents" and its listing).
    pub struct NetworkConfig, check size {
        /// Maps the features to one vector per block and one for the scene.
        pub encoder: EncoderConfig;
        /// Length of the node, edge, and global vectors, and of the keys that choose blocks.
        pub width: usize = 64, in 1..=1024;
        /// Hidden layers of the value head.
        pub value_hidden: Vec<usize> = vec![512; 3], in 1..=4096,
            where |c| c.value_hidden.len() <= 8 => "at most 8 layers";
        /// Standard deviation of the moves of an untrained policy with the Gaussian head, as a fraction of the speed
        /// limit. Absent: the paper's ln 2 = 0.69.
        pub init_std: Option<f32> = None, in above_to(MIN_STD, 10.0);
        /// How moves are drawn.
        #[serde(skip_serializing_if = "MoveHead::is_gaussian")]
        pub move_head: MoveHead = MoveHead::Gaussian;
    }

    /// The part of the network that reads the features.
    pub enum EncoderConfig = Gat {
        /// Graph attention, or with `attention = false` its "No Graph Attention" ablation.
        Gat(GatConfig),
        /// The "non-graph" baseline on the flattened features.
        Resnet(ResnetConfig),
    }

    /// The graph encoder.
    #[derive(Copy, Eq)]
    pub struct GatConfig {
        /// Whether to use attention; if false, every incoming edge has the same weight.
        pub attention: bool = true;
        /// Number of layers.
        pub n_layers: usize = 3, in 1..=16;
        /// Number of attention heads.
        pub n_heads: usize = 4, in 1..=16;
        /// Length of a query, key or message per head.
        pub head_dim: usize = 64, in 1..=512;
        /// Hidden units of the node and global MLPs.
        pub mlp_hidden: usize = 256, in 1..=4096;
    }

    /// The flat encoder.
    #[derive(Copy, Eq)]
    pub struct ResnetConfig {
        /// Units of each layer.
        pub hidden: usize = 1024, in 1..=8192;
        /// Number of residual blocks of two layers.
        pub n_blocks: usize = 4, in 1..=32;
    }
}

/// How the moves of chosen blocks are drawn.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MoveHead {
    /// From a Gaussian with a diagonal covariance; the grippers choose independently (the paper).
    #[default]
    Gaussian,
    /// From a mixture of [proposals](crate::proposals); the second gripper knows what the first drew (an extension).
    Mixture,
}

/// Which blocks a gripper may choose.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum BlockMask {
    /// All 16 blocks (the paper).
    #[default]
    None,
    /// Blocks of the blueprint, and connected blocks, because they may have to be taken apart. The logits of all others
    /// become −1e9 (an extension).
    Blueprint,
}

impl PolicyConfig {
    /// Hashes everything that gives parameters their meaning, for `Weights::network_hash`: the configuration,
    /// [`FEATURE_LAYOUT`], and for the mixture head [`MIXTURE_LAYOUT`].
    ///
    /// The mask is left out, because the same parameters are valid with and without it.
    pub fn hash(&self) -> u64 {
        let common = (&self.network, &self.features, FEATURE_LAYOUT);
        match self.network.move_head {
            MoveHead::Gaussian => config_hash(&common),
            MoveHead::Mixture => config_hash(&(common, MIXTURE_LAYOUT)),
        }
    }

    /// Returns the first setting of those in the [hash](Self::hash) that `theirs` has otherwise.
    pub fn network_difference(&self, theirs: &Self) -> Option<SettingsDifference> {
        let settings = |config: &Self| {
            let network = CanonicalSettings::default().with("policy.network", &config.network);
            network.with("policy.features", &config.features)
        };
        settings(theirs).difference(&settings(self))
    }
}

impl MoveHead {
    fn is_gaussian(&self) -> bool {
        *self == Self::Gaussian
    }
}

impl FeatureConfig {
    /// Returns the paper's observations alone: 3, 24, and 50 features of nodes, edges, and globals.
    pub fn paper() -> Self {
        Self { up_axis: false, membership: false, block_shape: false, needed_moves: false, ..Self::default() }
    }
}

impl NetworkConfig {
    /// Returns the constant added before the softplus that gives standard deviations, for which an input of 0 gives
    /// `init_std`.
    pub(crate) fn std_offset(&self) -> f32 {
        self.init_std.map_or(0.0, |init| (init - MIN_STD).max(1e-6).exp_m1().ln())
    }

    /// Refuses a network that the bus could not carry, before a process tries to hold it.
    fn size(&self, path: &str) -> Result<(), InvalidSetting> {
        let n = self.n_parameters_at_least();
        let expected = format_args!("at most {MAX_PARAMETERS}: make it smaller");
        InvalidSetting::check(format_args!("the number of parameters of {path}"), n, n <= MAX_PARAMETERS, expected)
    }

    /// Returns the number of entries of the large matrices, which have nearly all parameters.
    fn n_parameters_at_least(&self) -> usize {
        let layers = match self.encoder {
            EncoderConfig::Gat(gat) => {
                // Message, query, and key read 2, 2, and 1 vectors; the result becomes one.
                let n_vectors = if gat.attention { 6 } else { 3 };
                let attention = n_vectors * self.width * gat.n_heads * gat.head_dim;
                // Two MLPs map two vectors to one.
                gat.n_layers * (attention + 2 * 3 * self.width * gat.mlp_hidden)
            }
            EncoderConfig::Resnet(resnet) => {
                resnet.hidden * (2 * resnet.n_blocks * resnet.hidden + N_BLOCKS * self.width)
            }
        };
        let value: usize = self.value_hidden.windows(2).map(|pair| pair[0] * pair[1]).sum();
        layers + value
    }
}
