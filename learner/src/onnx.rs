//! A policy as an ONNX graph, for runtimes that know nothing of this program.

mod graph;
mod network;

use policy::{EncoderConfig, Model, MoveHead};

use self::graph::{Graph, Type};

/// A policy without a graph.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a policy with the flat encoder (resnet) has no ONNX graph; export it without --onnx")]
pub struct NoGraph;

/// Returns the ONNX graph of a policy for any number of scenes B, in float32. Probabilities are the caller's to draw
/// from.
///
/// | input | shape | meaning |
/// |---|---|---|
/// | nodes, edges, globals | `[B, 16, nd]`, `[B, 240, ed]`, `[B, gd]` | the features |
/// | relations, offered | `[B, 16, 16, 8]`, `[B, 16, 33] bool` | mixture head: the proposals |
/// | first | `[B, 2] int64` | mixture head of two grippers: block and slot that the first one drew |
///
/// | output | shape | meaning |
/// |---|---|---|
/// | logits | `[B, grippers, 16]` | each gripper's choice of a block, without a mask |
/// | values | `[B]` | expected returns |
/// | locs, scales | `[B, 16, 6]` | Gaussian head: the moves |
/// | first_slots | `[B, 16, 33]` | mixture head: the first gripper's slots, for each block |
/// | second_blocks, second_slots | `[B, 16]`, `[B, 16, 33]` | mixture head of two grippers: the second's, after `first` |
///
/// # Errors
/// Returns an error if the encoder is the flat one.
pub fn to_onnx(model: &Model) -> Result<Vec<u8>, NoGraph> {
    let EncoderConfig::Gat(gat) = model.policy.network.encoder else { return Err(NoGraph) };
    let mut graph = Graph::default();
    let mut values = &model.weights.parameters[..];
    for entry in &model.table {
        let (own, rest) = values.split_at(entry.n_values().min(values.len()));
        graph.tensor(&entry.name, &entry.shape, Type::Float, own.iter().map(|x| x.to_le_bytes()));
        values = rest;
    }
    network::trunk(&mut graph, &model.policy, gat, &model.weights.normalization);
    let last = format!("layer{}", gat.n_layers);
    match model.policy.network.move_head {
        MoveHead::Gaussian => network::gaussian(&mut graph, &last, &model.policy.network),
        MoveHead::Mixture => network::mixture(&mut graph, &last, model.policy.features.n_grippers > 1),
    }
    Ok(graph.into_bytes())
}
