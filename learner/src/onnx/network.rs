//! The network as operators: the paper's listing, with a query and a message for every edge.
//!
//! Values have a batch axis in front. Lists are shapes, in which 0 keeps the length of an axis, or axes.

use std::cmp::Ordering;

use blueprints::N_BLOCKS;
use policy::config::MIN_STD;
use policy::features::N_EDGES;
use policy::normalization::MAX_NORMALIZED;
use policy::proposals::{N_RELATION, N_SLOTS};
use policy::{GatConfig, NetworkConfig, PolicyConfig};
use proto::Normalization;

use super::graph::{Graph, Type};

const N: usize = N_BLOCKS;
/// The logit of what cannot be chosen.
const MASKED: f32 = -1e9;

/// Adds everything up to the logits of blocks, and the value.
pub(super) fn trunk(graph: &mut Graph, policy: &PolicyConfig, gat: GatConfig, normalization: &Normalization) {
    let sizes = policy.sizes();
    let width = policy.network.width;
    let n_grippers = usize::from(policy.features.n_grippers);
    graph.input("nodes", Type::Float, &[N, sizes.node]);
    graph.input("edges", Type::Float, &[N_EDGES, sizes.edge]);
    graph.input("globals", Type::Float, &[sizes.global]);
    let [nodes, edges, globals] = std::array::from_fn(|k| normalized(graph, k, normalization));
    // The list of edges has, for each sender, all receivers but itself. What is just past its end are zeros.
    let at = |receiver: usize, sender: usize| match receiver.cmp(&sender) {
        Ordering::Less => sender * (N - 1) + receiver,
        Ordering::Equal => N_EDGES,
        Ordering::Greater => sender * (N - 1) + receiver - 1,
    };
    let listed: Vec<String> = (0..N * N).map(|k| at(k / N, k % N).to_string()).collect();
    let listed = listed.join(",");
    let no_edge = (0..N * N).map(|k| if k / N == k % N { MASKED } else { 0.0 });
    graph.tensor("no_edge", &[N, 1, N], Type::Float, no_edge.map(f32::to_le_bytes));
    let embedding = format!(
        "padded = Pad {edges} [0,0,0,0,1,0]
         listed = Gather padded [{listed}] axis:1
         dense = Reshape listed [0,16,16,{}]
         pairs = Linear dense embed_edge
         layer0.nodes = Linear {nodes} embed_node
         layer0.scene = Linear {globals} embed_global",
        sizes.edge
    );
    graph.add("", &embedding);
    for layer in 0..gat.n_layers {
        let next = format!("layer{}", layer + 1);
        encode(graph, &format!("layer{layer}"), &next, width, gat);
    }
    let heads = format!(
        "head.global = MatMul {globals} head.input_global.w
         head.scene = Concat head.global .scene axis:-1
         head.grips = MatMul head.scene head.grip_key.w
         head.grip = Reshape head.grips [-1,{n_grippers},{width}]
         head.grippers = Reshape {globals} [0,{n_grippers},-1]
         head.last = Slice head.grippers [-16] [99] [2]
         head.held = Einsum head.last equation:bgi->big
         head.blocks = Concat .nodes head.held axis:-1
         head.keys = MatMul head.blocks head.block_key.w
         head.matches = Einsum head.grip head.keys equation:bgf,bif->bgi
         logits = Mul head.matches {}
         value.choice = Softmax logits
         value.choices = Reshape value.choice [0,-1]
         value.global = MatMul {globals} value.input_global.w
         value.scene = MatMul .scene value.graph_global.w
         value.0 = Concat value.global value.scene value.choices axis:-1",
        1.0 / (width as f32).sqrt(),
    );
    graph.add(&format!("layer{}", gat.n_layers), &heads);
    let n_hidden = policy.network.value_hidden.len();
    for layer in 0..n_hidden {
        let next = layer + 1;
        let hidden =
            format!("value.y{layer} = Linear value.{layer} value.mlp.{layer}\nvalue.{next} = Relu value.y{layer}");
        graph.add("", &hidden);
    }
    let Normalization { value_mean, value_std, .. } = normalization;
    let value = format!(
        "value.normal = Linear value.{n_hidden} value.mlp.{n_hidden}
         value.scaled = Mul value.normal {value_std}
         value.shifted = Add value.scaled {value_mean}
         values = Reshape value.shifted [-1]"
    );
    graph.add("", &value);
    graph.output("logits", &[n_grippers, N]);
    graph.output("values", &[]);
}

/// Adds a layer: attention over each block's senders, then an MLP of each node and one of the scene.
fn encode(graph: &mut Graph, at: &str, next: &str, width: usize, gat: GatConfig) {
    let GatConfig { n_heads, head_dim, .. } = gat;
    let queries = format!(
        ".asked = MatMul .edges .query.w
         .queries = Reshape .asked [0,16,16,{n_heads},{head_dim}]
         .known = MatMul .nodes .key.w
         .keys = Reshape .known [0,16,{n_heads},{head_dim}]
         .scores = Einsum .queries .keys equation:brshd,brhd->brhs
         .scaled = Mul .scores {}",
        1.0 / (head_dim as f32).sqrt()
    );
    // The same for all senders.
    let none = ".scores = Einsum .messages .messages equation:brshd,brshd->brhs\n.scaled = Mul .scores 0.0";
    let layer = format!(
        ".nodes_1 = Reshape .nodes [0,1,16,{width}]
         .senders = Expand .nodes_1 [1,16,1,1]
         .edges = Concat .senders pairs axis:-1
         .said = MatMul .edges .message.w
         .messages = Reshape .said [0,16,16,{n_heads},{head_dim}]
         {}
         .masked = Add .scaled no_edge
         .weights = Softmax .masked
         .heads = Einsum .weights .messages equation:brhs,brshd->brhd
         .means = Reshape .heads [0,16,{}]
         .residual = MatMul .means .node_proj.w
         .sum = Add .nodes .residual
         .y = LayerNormalization .sum .ln_attn.scale .ln_attn.offset
         .scene_1 = Reshape .scene [0,1,{width}]
         .scenes = Expand .scene_1 [1,16,1]
         .mlp_node_0 = Concat .y .scenes axis:-1
         .mlp_node_1 = Linear .mlp_node_0 .mlp_node.0
         .mlp_node_2 = Relu .mlp_node_1
         .mlp_node_3 = Linear .mlp_node_2 .mlp_node.1
         .sum_node = Add .mlp_node_3 .y
         {next}.nodes = LayerNormalization .sum_node .ln_mlp.scale .ln_mlp.offset
         .all = ReduceSum {next}.nodes [1] keepdims:0
         .mlp_global_0 = Concat .scene .all axis:-1
         .mlp_global_1 = Linear .mlp_global_0 .mlp_global.0
         .mlp_global_2 = Relu .mlp_global_1
         .mlp_global_3 = Linear .mlp_global_2 .mlp_global.1
         .sum_global = Add .mlp_global_3 .scene
         {next}.scene = LayerNormalization .sum_global .ln_global.scale .ln_global.offset",
        if gat.attention { &queries } else { none },
        n_heads * head_dim
    );
    graph.add(at, &layer);
}

/// Adds the moves of the Gaussian head, from the nodes of `at`.
pub(super) fn gaussian(graph: &mut Graph, at: &str, network: &NetworkConfig) {
    let moves = format!(
        "locs = Linear .nodes head.act_loc
         head.scale = Linear .nodes head.act_scale
         head.shifted = Add head.scale {}
         head.positive = Softplus head.shifted
         scales = Add head.positive {MIN_STD}",
        network.std_offset()
    );
    graph.add(at, &moves);
    graph.output("locs", &[N, 6]);
    graph.output("scales", &[N, 6]);
}

/// Parts of a block's read-outs, and their lengths; `policy::mixture` says what their sums are.
const READOUTS: [(&str, usize); 11] = [
    ("query", 16),
    ("key", 16),
    ("paired", 18),
    ("alone", 1),
    ("after", 9),
    ("toward", 6),
    ("mutual", 6),
    ("block_query", 16),
    ("block_key", 16),
    ("block_relation", 8),
    ("block_after", 9),
];

/// The first gripper's slots.
const FIRST_SLOTS: &str = "
    m.coefficients = Reshape m.paired [0,16,2,9]
    m.factors = Slice m.coefficients [0] [8] [3]
    m.bias = Slice m.coefficients [8] [9] [3]
    m.related = Einsum m.factors relations equation:bikr,bijr->bikj
    m.matches = Einsum m.query m.key equation:bif,bjf->bij
    m.scaled = Mul m.matches 0.25
    m.matched = Reshape m.scaled [0,16,1,16]
    m.joins = Sum m.related m.bias m.matched
    m.join_slots = Reshape m.joins [0,16,32]
    m.slots = Concat m.join_slots m.alone axis:-1
    first_slots = Where offered m.slots -1e9";

/// The first gripper's draw as one-hots: its block and its partner [B, 16], and the kind [B, 3].
const FIRST: &str = "
    f.blocks = Slice first [0] [1] [1]
    f.block_index = Reshape f.blocks [-1]
    f.slots = Slice first [1] [2] [1]
    f.slot_index = Reshape f.slots [-1]
    f.kind_index = Div f.slot_index [16]
    f.block = OneHot f.block_index [16] off_on
    f.kind = OneHot f.kind_index [3] off_on
    f.slot = OneHot f.slot_index [33] off_on
    f.joins = Slice f.slot [0] [32] [1]
    f.by_kind = Reshape f.joins [0,2,16]
    f.partner = ReduceSum f.by_kind [1] keepdims:0";

/// The second gripper's block: the same one, or another.
const SECOND_BLOCKS: &str = "
    b.query = Einsum f.block m.block_query equation:bi,bif->bf
    b.factors = Einsum f.block m.block_relation equation:bi,bif->bf
    b.afters = Einsum f.block m.block_after equation:bi,bif->bf
    b.by_kind = Reshape b.afters [0,3,3]
    b.after = Einsum b.by_kind f.kind equation:bkf,bk->bf
    b.same = Slice b.after [0] [1] [1]
    b.its_partner = Slice b.after [1] [2] [1]
    b.same_piece = Slice b.after [2] [3] [1]
    b.matches = Einsum m.block_key b.query equation:bjf,bf->bj
    b.matched = Mul b.matches 0.25
    b.relations = Einsum f.block relations equation:bi,bijr->bjr
    b.related = Einsum b.relations b.factors equation:bjr,br->bj
    b.of_partner = Mul b.its_partner f.partner
    b.pieces = Slice b.relations [1] [2] [2]
    b.piece = Reshape b.pieces [0,16]
    b.is_piece = Cast b.piece to:9
    b.in_piece = Cast b.is_piece to:1
    b.of_piece = Mul b.same_piece b.in_piece
    b.others = Sum b.matched b.related b.of_partner b.of_piece
    b.is_same = Cast f.block to:9
    b.change = Where b.is_same b.same b.others
    b.logits = Slice logits [1] [2] [1]
    b.own = Reshape b.logits [0,16]
    second_blocks = Add b.own b.change";

/// The second gripper's slots.
const SECOND_SLOTS: &str = "
    s.afters = Reshape m.after [0,16,3,3]
    s.after = Einsum s.afters f.kind equation:bikf,bk->bif
    s.towards = Reshape m.toward [0,16,3,2]
    s.toward = Einsum s.towards f.kind equation:bikf,bk->bif
    s.mutuals = Reshape m.mutual [0,16,3,2]
    s.mutual = Einsum s.mutuals f.kind equation:bikf,bk->bif
    s.comes_here = Reshape f.partner [0,16,1]
    s.both = Mul s.mutual s.comes_here
    s.pull = Add s.toward s.both
    s.pulled = Einsum s.pull f.block equation:bik,bj->bikj
    s.after_joins = Slice s.after [0] [2] [2]
    s.after_join = Reshape s.after_joins [0,16,2,1]
    s.after_alone = Slice s.after [2] [3] [2]
    s.joins = Sum m.joins s.after_join s.pulled
    s.alone = Add m.alone s.after_alone
    s.join_slots = Reshape s.joins [0,16,32]
    s.slots = Concat s.join_slots s.alone axis:-1
    second_slots = Where offered s.slots -1e9";

/// Adds the logits of the mixture head, from the nodes of `at`.
pub(super) fn mixture(graph: &mut Graph, at: &str, has_second: bool) {
    graph.input("relations", Type::Float, &[N, N, N_RELATION]);
    graph.input("offered", Type::Bool, &[N, N_SLOTS]);
    graph.add(at, "readouts = Linear .nodes head.proposals");
    let mut begin = 0;
    for (name, length) in READOUTS {
        let end = begin + length;
        graph.add("", &format!("m.{name} = Slice readouts [{begin}] [{end}] [2]"));
        begin = end;
    }
    graph.add("", FIRST_SLOTS);
    graph.output("first_slots", &[N, N_SLOTS]);
    if has_second {
        graph.input("first", Type::Int64, &[2]);
        graph.tensor("off_on", &[2], Type::Float, [0_f32, 1.0].map(f32::to_le_bytes));
        for lines in [FIRST, SECOND_BLOCKS, SECOND_SLOTS] {
            graph.add("", lines);
        }
        graph.output("second_blocks", &[N]);
        graph.output("second_slots", &[N, N_SLOTS]);
    }
}

/// Adds the normalization of the features of one kind; returns the name of the result.
fn normalized(graph: &mut Graph, k: usize, normalization: &Normalization) -> String {
    let name = ["nodes", "edges", "globals"][k];
    let (mean, std) = (&normalization.feature_mean[k], &normalization.feature_std[k]);
    if mean.is_empty() {
        return name.to_owned();
    }
    for (part, values) in [("mean", mean), ("std", std)] {
        let bytes = values.iter().map(|x| x.to_le_bytes());
        graph.tensor(&format!("{name}.{part}"), &[values.len()], Type::Float, bytes);
    }
    let lines = format!(
        ".centered = Sub {name} .mean
         .scaled = Div .centered .std
         .clipped = Clip .scaled -{MAX_NORMALIZED} {MAX_NORMALIZED}"
    );
    graph.add(name, &lines);
    format!("{name}.clipped")
}
