//! Settings of the policy: what it sees, its network, and its action distribution.

use std::ops::Bound::Excluded;

use proto::{InvalidSetting, config_hash, settings};
use serde::{Deserialize, Serialize};

settings! {
    /// Everything that decides what a set of parameters means; all services of a run share one.
    pub struct PolicyConfig in "policy", check grippers {
        /// The network.
        pub network: NetworkConfig;
        /// What it sees.
        pub features: FeatureConfig;
        /// Which blocks a gripper may choose.
        pub mask: BlockMask = BlockMask::None;
        /// Steps for which a gripper keeps what it holds: it may choose another block only where the steps of the episode
        /// are a multiple of this, so that untrained choices last long enough to have an effect. 1 is the paper.
        pub grip_steps: u16 = 1, in 1..=100;
        /// What counts as the action for its log-probability.
        pub joint_form: JointForm = JointForm::ChosenUnique;
    }

    /// What the policy sees; the base is the paper's, every flag adds an extension. See [`crate::features`] for the
    /// indices.
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
        /// Nodes: where and when the blueprint's [plan](blueprints::Blueprint::plan) has the block, and how it comes
        /// there. An expert's labels are hard to understand without it.
        pub plan: bool = false;
        /// Nodes and edges: which blocks hang together as the blueprint has them.
        pub pieces: bool = false;
        /// Nodes: the share of an episode that is left, for episodes of so many steps, as `environment.episode_steps` says.
        /// A critic that does not know it cannot tell a late start from a bad one.
        #[serde(skip_serializing_if = "Option::is_none")]
        pub remaining_time: Option<u16> = None, in 1..=10_000;
        /// Number of gripper halves in the globals; must equal the network's.
        pub n_grippers: u8 = 2;
    }

    /// The network (paper, section "Agents" and its listing).
    pub struct NetworkConfig {
        /// From features to one vector per block and one for the scene.
        pub encoder: EncoderConfig;
        /// Length of the node, edge and global vectors and of the keys that choose blocks.
        pub width: usize = 64, in 1..=1024;
        /// Number of grippers that choose a block.
        pub n_grippers: u8 = 2, in 1..=2;
        /// Hidden layers of the value head.
        pub value_hidden: Vec<usize> = vec![512; 3], in 1..=4096,
            where |c| c.value_hidden.len() <= 8 => "at most 8 layers";
        /// Standard deviations of moves.
        pub scale: ScaleConfig;
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
        /// False gives every incoming edge the same weight.
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

    /// Standard deviations of moves: `floor + softplus(x + offset)`, bounded smoothly from above when `max_std` is
    /// given.
    #[derive(Copy)]
    pub struct ScaleConfig, check order {
        /// Standard deviation of an untrained policy, a fraction of the speed limit; it fixes `offset`. `None` is
        /// offset 0 as in the paper, which gives ln 2 = 0.69. Above `floor` and below `max_std`.
        pub init_std: Option<f32> = None;
        /// Bound `m`: the result s becomes `m · tanh(s / m)`. `None` is the paper. Above `floor` and at most 10.
        pub max_std: Option<f32> = None;
        /// Smallest standard deviation; the default is the paper's.
        pub floor: f32 = 1e-6, in (Excluded(0.0), Excluded(1.0));
    }
}

/// Which blocks a gripper may choose.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum BlockMask {
    /// All 16 (the paper).
    #[default]
    None,
    /// Those of the blueprint and those with a connection, as they may have to be taken apart; the others' logits become
    /// −1e9 (an extension).
    Blueprint,
}

/// How the log-probability of an action is put together from the heads.
///
/// With π_g the distribution of gripper g over blocks and N_b the Gaussian of block b's move:
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum JointForm {
    /// Σ_g log π_g(b_g) + Σ over the *distinct* chosen blocks of log N_b: a block chosen by both counts its move once.
    #[default]
    ChosenUnique,
    /// Σ_g (log π_g(b_g) + log N_{b_g}): a block chosen by both counts its move twice.
    ChosenPerGripper,
    /// Σ_g log π_g(b_g) + Σ over all 16 blocks of log N_b, the listing's literal 16×6 action.
    Matrix,
}

impl PolicyConfig {
    fn grippers(&self, path: &str) -> Result<(), InvalidSetting> {
        let (own, network) = (self.features.n_grippers, self.network.n_grippers);
        let expected = format_args!("{network}, as {path}.network.n_grippers");
        InvalidSetting::check(format_args!("{path}.features.n_grippers"), own, own == network, expected)
    }

    /// Hash of everything that gives parameters their meaning; goes into `Weights::network_hash`.
    ///
    /// The masks and the joint form are left out: the same parameters are valid with any of them.
    pub fn hash(&self) -> u64 {
        config_hash(&(&self.network, &self.features))
    }
}

impl FeatureConfig {
    /// The paper's observations alone: 3, 24 and 50 features of nodes, edges and globals.
    pub fn paper() -> Self {
        Self { up_axis: false, membership: false, block_shape: false, needed_moves: false, ..Self::default() }
    }
}

impl NetworkConfig {
    /// Number of directed edges that the encoder reads, 240 or 256.
    pub fn n_edges(&self) -> usize {
        match &self.encoder {
            EncoderConfig::Gat(gat) if gat.self_edges => 256,
            _ => 240,
        }
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

    /// The constant added before the softplus, so that an input of 0 gives `init_std`.
    pub fn offset(&self) -> f32 {
        let Some(init) = self.init_std else { return 0.0 };
        let unbounded = match self.max_std {
            Some(max) => max * (init / max).atanh(),
            None => init,
        };
        (unbounded - self.floor).max(1e-6).exp_m1().ln()
    }
}
