//! Policy settings: features, network, and action distribution.

use blueprints::N_BLOCKS;
use proto::codec::MAX_PARAMETERS;
use proto::{CanonicalSettings, InvalidSetting, SettingsDifference, config_hash, settings};
use serde::{Deserialize, Serialize};

/// Version of the lists in `features.rs`, incremented when an entry moves or changes its meaning. Increment the format
/// versions of checkpoints and policies with it, so that programs refuse parameters that were trained on other features.
pub const FEATURE_LAYOUT: u32 = 3;

/// Version of the [slots](crate::proposals::Slot) and of the read-outs in `mixture.rs`, incremented likewise.
pub const MIXTURE_LAYOUT: u32 = 2;

settings! {
    /// Everything that determines the meaning of a set of parameters. All services of a run use the same configuration.
    pub struct PolicyConfig in "policy", check consistency {
        /// The network.
        pub network: NetworkConfig;
        /// Features of the observations.
        pub features: FeatureConfig;
        /// Which blocks a gripper may choose.
        pub mask: BlockMask = BlockMask::None;
        /// Number of steps for which a gripper keeps the block that it holds. It may choose another block only at
        /// episode steps that are a multiple of this, so that untrained choices last long enough to have an effect. The
        /// paper uses 1.
        pub grip_steps: u16 = 1, in 1..=100;
        /// Which parts of the action distribution count in the log-probability.
        pub joint_form: JointForm = JointForm::ChosenUnique;
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
        /// Number of grippers in the globals; must equal the network's.
        pub n_grippers: u8 = 2;
    }

    /// The network (paper, section "Agents" and its listing).
    pub struct NetworkConfig, check size {
        /// Maps the features to one vector per block and one for the scene.
        pub encoder: EncoderConfig;
        /// Length of the node, edge, and global vectors, and of the keys that choose blocks.
        pub width: usize = 64, in 1..=1024;
        /// Number of grippers that choose a block.
        pub n_grippers: u8 = 2, in 1..=2;
        /// Hidden layers of the value head.
        pub value_hidden: Vec<usize> = vec![512; 3], in 1..=4096,
            where |c| c.value_hidden.len() <= 8 => "at most 8 layers";
        /// Standard deviations of moves; for the Gaussian head.
        pub scale: ScaleConfig;
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
        /// Whether each block also sends to itself (256 edges instead of 240).
        pub self_edges: bool = false;
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

    /// Standard deviations of moves: `floor + softplus(x + offset)`, smoothly bounded from above if `max_std` is set.
    #[derive(Copy)]
    pub struct ScaleConfig, check order {
        /// Standard deviation of an untrained policy, as a fraction of the speed limit; determines `offset`. `None`
        /// means offset 0 as in the paper, which gives ln 2 = 0.69. Above `floor` and below `max_std`.
        pub init_std: Option<f32> = None;
        /// Bound `m`: the result s becomes `m · tanh(s / m)`. `None` means no bound, as in the paper. Above `floor` and
        /// at most 10.
        pub max_std: Option<f32> = None;
        /// Smallest standard deviation; the default is the paper's.
        pub floor: f32 = 1e-6, in 1e-6..1.0;
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

/// How the log-probability of an action is composed from the heads.
///
/// π_g is the distribution of gripper g over blocks, and N_b the Gaussian of block b's move.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum JointForm {
    /// Σ_g log π_g(b_g) + Σ over the *distinct* chosen blocks of log N_b: a block chosen by both grippers counts its
    /// move once.
    #[default]
    ChosenUnique,
    /// Σ_g (log π_g(b_g) + log N_{b_g}): a block chosen by both grippers counts its move twice.
    ChosenPerGripper,
    /// Σ_g log π_g(b_g) + Σ over all 16 blocks of log N_b, the listing's literal 16×6 action.
    Matrix,
}

impl PolicyConfig {
    fn consistency(&self, path: &str) -> Result<(), InvalidSetting> {
        if self.network.move_head == MoveHead::Mixture {
            let expected = format_args!("chosen-unique, because {path}.network.move_head = mixture");
            let fits = self.joint_form == JointForm::ChosenUnique;
            InvalidSetting::check(format_args!("{path}.joint_form"), self.joint_form.name(), fits, expected)?;
        }
        let (own, network) = (self.features.n_grippers, self.network.n_grippers);
        let expected = format_args!("{network}, as {path}.network.n_grippers");
        InvalidSetting::check(format_args!("{path}.features.n_grippers"), own, own == network, expected)
    }

    /// Hashes everything that gives parameters their meaning, for `Weights::network_hash`: the configuration,
    /// [`FEATURE_LAYOUT`], and for the mixture head [`MIXTURE_LAYOUT`].
    ///
    /// The mask, `grip_steps`, and the joint form are left out, because the same parameters are valid with any of them.
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

impl JointForm {
    /// Returns the name in configuration files.
    fn name(self) -> &'static str {
        match self {
            Self::ChosenUnique => "chosen-unique",
            Self::ChosenPerGripper => "chosen-per-gripper",
            Self::Matrix => "matrix",
        }
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
    /// Returns the number of directed edges that the encoder reads, 240 or 256.
    pub fn n_edges(&self) -> usize {
        match &self.encoder {
            EncoderConfig::Gat(gat) if gat.self_edges => 256,
            _ => 240,
        }
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

impl ScaleConfig {
    fn order(&self, path: &str) -> Result<(), InvalidSetting> {
        let Self { init_std, max_std, floor } = *self;
        if let Some(max) = max_std {
            let expected = format_args!("above {floor} and at most 10");
            InvalidSetting::check(format_args!("{path}.max_std"), max, max > floor && max <= 10.0, expected)?;
        }
        if let Some(init) = init_std {
            let top = max_std.unwrap_or(10.0);
            let expected = format_args!("above {floor} and below {top}");
            InvalidSetting::check(format_args!("{path}.init_std"), init, init > floor && init < top, expected)?;
        }
        Ok(())
    }

    /// Returns the constant added before the softplus, for which an input of 0 gives `init_std`.
    pub fn offset(&self) -> f32 {
        let Some(init) = self.init_std else { return 0.0 };
        let unbounded = match self.max_std {
            Some(max) => max * (init / max).atanh(),
            None => init,
        };
        (unbounded - self.floor).max(1e-6).exp_m1().ln()
    }
}
