//! Settings of the policy: what it sees, its network, and its action distribution.

use proto::{InvalidSetting, config_hash};
use serde::{Deserialize, Serialize};

/// Everything that decides what a set of parameters means; all services of a run share one.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PolicyConfig {
    /// The network.
    pub network: NetworkConfig,
    /// What it sees.
    pub features: FeatureConfig,
    /// Which blocks a gripper may choose.
    pub mask: BlockMask,
    /// What counts as the action for its log-probability.
    pub joint_form: JointForm,
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

/// What the policy sees; the base is the paper's, every flag adds an extension. See [`crate::features`] for the indices.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FeatureConfig {
    /// Nodes: the world's up axis in the block's frame. Default true.
    pub up_axis: bool,
    /// Nodes: whether the block belongs to the blueprint. Default true.
    pub membership: bool,
    /// Nodes: the block's half extents. Default true.
    pub block_shape: bool,
    /// Edges: the move that the receiver needs if the sender stays, at two scales. Default true.
    pub needed_moves: bool,
    /// Nodes: where and when the blueprint's [plan](blueprints::Blueprint::plan) has the block, and how it comes there.
    /// Default false; an expert's labels are hard to understand without it.
    pub plan: bool,
    /// Nodes and edges: which blocks hang together as the blueprint has them. Default false.
    pub pieces: bool,
    /// Number of gripper halves in the globals, 1 or 2; must equal the network's. Default 2.
    pub n_grippers: u8,
}

impl Default for FeatureConfig {
    fn default() -> Self {
        Self {
            up_axis: true,
            membership: true,
            block_shape: true,
            needed_moves: true,
            plan: false,
            pieces: false,
            n_grippers: 2,
        }
    }
}

impl FeatureConfig {
    /// The paper's observations alone: 3, 24 and 50 features of nodes, edges and globals.
    pub fn paper() -> Self {
        Self {
            up_axis: false,
            membership: false,
            block_shape: false,
            needed_moves: false,
            plan: false,
            pieces: false,
            n_grippers: 2,
        }
    }
}

/// The network (paper, section "Agents" and its listing).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct NetworkConfig {
    /// From features to one vector per block and one for the scene.
    pub encoder: EncoderConfig,
    /// Length of the node, edge and global vectors and of the keys that choose blocks. Default 64.
    pub width: usize,
    /// Number of grippers that choose a block, 1 or 2. Default 2.
    pub n_grippers: u8,
    /// Hidden layers of the value head. Default `[512, 512, 512]`.
    pub value_hidden: Vec<usize>,
    /// Standard deviations of moves.
    pub scale: ScaleConfig,
}

/// The part of the network that reads the features.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub enum EncoderConfig {
    /// Graph attention, or with `attention = false` its "No Graph Attention" ablation.
    Gat(GatConfig),
    /// The "non-graph" baseline on the flattened features.
    Resnet(ResnetConfig),
}

/// The graph encoder.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GatConfig {
    /// False gives every incoming edge the same weight. Default true.
    pub attention: bool,
    /// Whether each block also sends to itself (256 edges instead of 240). Default false.
    pub self_edges: bool,
    /// Number of layers. Default 3.
    pub n_layers: usize,
    /// Number of attention heads. Default 4.
    pub n_heads: usize,
    /// Length of a query, key or message per head. Default 64.
    pub head_dim: usize,
    /// Hidden units of the node and global MLPs. Default 256.
    pub mlp_hidden: usize,
}

/// The flat encoder.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ResnetConfig {
    /// Units of each layer. Default 1024.
    pub hidden: usize,
    /// Number of residual blocks of two layers. Default 4.
    pub n_blocks: usize,
}

/// Standard deviations of moves: `floor + softplus(x + offset)`, bounded smoothly from above when `max_std` is given.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ScaleConfig {
    /// Standard deviation of an untrained policy, a fraction of the speed limit; it fixes `offset`. Default none:
    /// offset 0 as in the paper, which gives ln 2 = 0.69.
    pub init_std: Option<f32>,
    /// Bound `m`: the result s becomes `m · tanh(s / m)`. Default none (the paper).
    pub max_std: Option<f32>,
    /// Smallest standard deviation. Default 1e-6 (the paper).
    pub floor: f32,
}

impl Default for NetworkConfig {
    fn default() -> Self {
        Self {
            encoder: EncoderConfig::default(),
            width: 64,
            n_grippers: 2,
            value_hidden: vec![512; 3],
            scale: ScaleConfig::default(),
        }
    }
}

impl Default for EncoderConfig {
    fn default() -> Self {
        Self::Gat(GatConfig::default())
    }
}

impl Default for GatConfig {
    fn default() -> Self {
        Self { attention: true, self_edges: false, n_layers: 3, n_heads: 4, head_dim: 64, mlp_hidden: 256 }
    }
}

impl Default for ResnetConfig {
    fn default() -> Self {
        Self { hidden: 1024, n_blocks: 4 }
    }
}

impl Default for ScaleConfig {
    fn default() -> Self {
        Self { init_std: None, max_std: None, floor: 1e-6 }
    }
}

impl PolicyConfig {
    /// Checks every field.
    ///
    /// # Errors
    /// The first field that is out of range.
    pub fn validate(&self) -> Result<(), InvalidSetting> {
        self.network.validate()?;
        if self.features.n_grippers != self.network.n_grippers {
            let (own, network) = (self.features.n_grippers, self.network.n_grippers);
            let expected = format!("{network}, as policy.network.n_grippers");
            return InvalidSetting::check("policy.features.n_grippers", own, false, expected);
        }
        Ok(())
    }

    /// Hash of everything that gives parameters their meaning; goes into `Weights::network_hash`.
    ///
    /// The mask and the joint form are left out: the same parameters are valid with any of them.
    pub fn hash(&self) -> u64 {
        config_hash(&(&self.network, &self.features))
    }
}

impl NetworkConfig {
    /// Checks every field.
    ///
    /// # Errors
    /// The first field that is out of range.
    pub fn validate(&self) -> Result<(), InvalidSetting> {
        let count = |field, value: usize, min, max| {
            let ok = (min..=max).contains(&value);
            InvalidSetting::check(format_args!("policy.{field}"), value, ok, format_args!("{min}..={max}"))
        };
        count("network.n_grippers", usize::from(self.n_grippers), 1, 2)?;
        count("network.width", self.width, 1, 1024)?;
        count("network.value_hidden (number of layers)", self.value_hidden.len(), 0, 8)?;
        for hidden in &self.value_hidden {
            count("network.value_hidden", *hidden, 1, 4096)?;
        }
        match &self.encoder {
            EncoderConfig::Gat(gat) => {
                count("network.encoder.n_layers", gat.n_layers, 1, 16)?;
                count("network.encoder.n_heads", gat.n_heads, 1, 16)?;
                count("network.encoder.head_dim", gat.head_dim, 1, 512)?;
                count("network.encoder.mlp_hidden", gat.mlp_hidden, 1, 4096)?;
            }
            EncoderConfig::Resnet(resnet) => {
                count("network.encoder.hidden", resnet.hidden, 1, 8192)?;
                count("network.encoder.n_blocks", resnet.n_blocks, 1, 32)?;
            }
        }
        self.scale.validate()
    }

    /// Number of directed edges that the encoder reads, 240 or 256.
    pub fn n_edges(&self) -> usize {
        match &self.encoder {
            EncoderConfig::Gat(gat) if gat.self_edges => 256,
            _ => 240,
        }
    }
}

impl ScaleConfig {
    fn validate(&self) -> Result<(), InvalidSetting> {
        let check = |field, value: f32, valid: bool, range: String| {
            InvalidSetting::check(format_args!("policy.network.scale.{field}"), value, valid, range)
        };
        check("floor", self.floor, self.floor > 0.0 && self.floor < 1.0, "above 0 and below 1".into())?;
        if let Some(max) = self.max_std {
            check("max_std", max, max > self.floor && max <= 10.0, format!("above {} and at most 10", self.floor))?;
        }
        if let Some(init) = self.init_std {
            let top = self.max_std.unwrap_or(10.0);
            check("init_std", init, init > self.floor && init < top, format!("above {} and below {top}", self.floor))?;
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
