//! Positions of the parameters in the flat vector.

use std::ops::Range;

use pulp::Arch;

use crate::config::{EncoderConfig, GatConfig, NetworkConfig};
use crate::features::FeatureSizes;
use crate::parameters::{ParameterSpec, spans};

/// The parts of a network that every pass needs.
#[derive(Clone, Copy)]
pub(super) struct Context<'a> {
    pub(super) arch: Arch,
    pub(super) shape: &'a Shape,
    pub(super) spans: &'a Spans,
    /// The flat vector.
    pub(super) parameters: &'a [f32],
}

/// A range in the flat vector.
pub(super) type Span = Range<usize>;

/// The dimensions that determine all shapes.
#[derive(Clone, Debug)]
pub(super) struct Shape {
    pub(super) sizes: FeatureSizes,
    pub(super) gat: GatConfig,
    /// Number of attention heads and width of each. Without attention, all heads compute the same average, so they are
    /// merged into one.
    pub(super) n_heads: usize,
    pub(super) head_dim: usize,
    pub(super) width: usize,
    pub(super) std_offset: f32,
}

/// A kernel `[n_in, n_out]` and its bias.
#[derive(Clone, Debug)]
pub(super) struct Linear {
    pub(super) w: Span,
    pub(super) b: Span,
    pub(super) n_out: usize,
}

/// Scale and offset of a LayerNorm.
pub(super) type Norm = [Span; 2];

/// One layer of the encoder.
#[derive(Clone, Debug)]
pub(super) struct LayerSpans {
    pub(super) message: Span,
    /// Both are absent without attention.
    pub(super) query: Option<Span>,
    pub(super) key: Option<Span>,
    pub(super) node_proj: Span,
    pub(super) ln_attn: Norm,
    pub(super) mlp_node: [Linear; 2],
    pub(super) ln_mlp: Norm,
    pub(super) mlp_global: [Linear; 2],
    pub(super) ln_global: Norm,
}

/// Positions of all parameters of the network.
#[derive(Clone, Debug)]
pub(super) struct Spans {
    pub(super) n_parameters: usize,
    /// Kernel followed by its bias: `[nd + 1, w]`.
    pub(super) embed_node: Span,
    pub(super) embed_edge: Linear,
    pub(super) embed_global: Linear,
    pub(super) layers: Vec<LayerSpans>,
    pub(super) input_global: Span,
    /// Of means and deviations; absent with the mixture head.
    pub(super) act: Option<[Linear; 2]>,
    pub(super) grip_key: Span,
    pub(super) block_key: Span,
    /// Absent with the Gaussian head.
    pub(super) proposals: Option<Linear>,
    pub(super) value_input_global: Span,
    pub(super) value_graph_global: Span,
    pub(super) value_mlp: Vec<Linear>,
}

impl<'a> Context<'a> {
    /// Returns one parameter.
    pub(super) fn of(&self, span: &Span) -> &'a [f32] {
        &self.parameters[span.clone()]
    }
}

impl Shape {
    /// Returns `None` if the encoder is not the graph encoder.
    pub(super) fn new(config: &NetworkConfig, sizes: &FeatureSizes) -> Option<Self> {
        let EncoderConfig::Gat(gat) = config.encoder else { return None };
        let (n_heads, head_dim) =
            if gat.attention { (gat.n_heads, gat.head_dim) } else { (1, gat.n_heads * gat.head_dim) };
        Some(Self { sizes: *sizes, gat, n_heads, head_dim, width: config.width, std_offset: config.std_offset() })
    }

    /// Whether a layer attends to raw node features. Only the first layer's input is linear in them; it does so if they
    /// are fewer.
    pub(super) fn attends_to_raw(&self, layer: usize) -> bool {
        layer == 0 && self.sizes.node + 1 < self.width
    }
}

impl Spans {
    pub(super) fn new(shape: &Shape, table: &[ParameterSpec]) -> Self {
        let find = |name: &str| -> (Span, usize) {
            let (spec, span) = spans(table)
                .find(|(spec, _)| spec.name == name)
                .unwrap_or_else(|| panic!("the network has no parameter {name}"));
            (span, *spec.shape.last().expect("every parameter has a shape"))
        };
        let has = |name: &str| table.iter().any(|spec| spec.name == name);
        let span = |name: &str| find(name).0;
        let linear = |name: &str| {
            let (w, n_out) = find(&format!("{name}.w"));
            Linear { w, b: span(&format!("{name}.b")), n_out }
        };
        let norm = |name: &str| ["scale", "offset"].map(|part| span(&format!("{name}.{part}")));
        let mlp = |name: &str| [0, 1].map(|j| linear(&format!("{name}.{j}")));
        let layer = |l: usize| {
            let name = |part: &str| format!("layer{l}.{part}");
            LayerSpans {
                message: span(&name("message.w")),
                query: shape.gat.attention.then(|| span(&name("query.w"))),
                key: shape.gat.attention.then(|| span(&name("key.w"))),
                node_proj: span(&name("node_proj.w")),
                ln_attn: norm(&name("ln_attn")),
                mlp_node: mlp(&name("mlp_node")),
                ln_mlp: norm(&name("ln_mlp")),
                mlp_global: mlp(&name("mlp_global")),
                ln_global: norm(&name("ln_global")),
            }
        };
        let n_value = table.iter().filter(|spec| spec.name.starts_with("value.mlp.")).count() / 2;
        let embed_node = linear("embed_node");
        assert_eq!(embed_node.w.end, embed_node.b.start, "a kernel is followed by its bias");
        Self {
            n_parameters: table.iter().map(ParameterSpec::n_values).sum(),
            embed_node: embed_node.w.start..embed_node.b.end,
            embed_edge: linear("embed_edge"),
            embed_global: linear("embed_global"),
            layers: (0..shape.gat.n_layers).map(layer).collect(),
            input_global: span("head.input_global.w"),
            act: has("head.act_loc.w").then(|| ["head.act_loc", "head.act_scale"].map(linear)),
            grip_key: span("head.grip_key.w"),
            block_key: span("head.block_key.w"),
            proposals: has("head.proposals.w").then(|| linear("head.proposals")),
            value_input_global: span("value.input_global.w"),
            value_graph_global: span("value.graph_global.w"),
            value_mlp: (0..n_value).map(|j| linear(&format!("value.mlp.{j}"))).collect(),
        }
    }
}
