//! A batch of features on a device.

use blueprints::N_BLOCKS as N;
use burn::tensor::{Device, Int, Tensor, TensorData};

use crate::batch::FeatureBatch;
use crate::features::N_EDGES;

/// Network input for B scenes.
#[derive(Clone, Debug)]
pub struct BatchTensors {
    /// `[B, 16, nd]`
    pub nodes: Tensor<3>,
    /// `[B, 240, ed]` in the order of [`FeatureBatch`].
    pub edges: Tensor<3>,
    /// `[B, gd]`, gripper-major, each gripper's part ending with the one-hot of the block it held.
    pub globals: Tensor<2>,
}

impl BatchTensors {
    /// Copies a batch to a device.
    pub fn new(batch: &FeatureBatch, device: &Device) -> Self {
        let cube = |values: &[f32], n_rows: usize, width: usize| {
            Tensor::from_data(TensorData::new(values.to_vec(), [batch.n, n_rows, width]), device)
        };
        Self {
            nodes: cube(&batch.nodes, N, batch.sizes.node),
            edges: cube(&batch.edges, N_EDGES, batch.sizes.edge),
            globals: Tensor::from_data(TensorData::new(batch.globals.clone(), [batch.n, batch.sizes.global]), device),
        }
    }

    /// Returns one matrix of the incoming edges of each node, `[B·16, 16, ed]`, with zeros for self-edges.
    pub(super) fn edges_by_receiver(&self) -> Tensor<3> {
        let [b, _, ed] = self.edges.dims();
        let device = self.edges.device();
        let listed = |i: usize| listed_index(i % N, i / N).unwrap_or(N_EDGES) as i32;
        let indices = TensorData::new((0..N * N).map(listed).collect(), [N * N]);
        let with_zeros = Tensor::cat(vec![self.edges.clone(), Tensor::zeros([b, 1, ed], &device)], 1);
        with_zeros.select(1, Tensor::<1, Int>::from_data(indices, &device)).reshape([b * N, N, ed])
    }
}

/// Returns the index of edge `sender → receiver` in the sender-major list; `None` for a self-edge, which it lacks.
pub(crate) fn listed_index(sender: usize, receiver: usize) -> Option<usize> {
    (sender != receiver).then(|| sender * (N - 1) + receiver - usize::from(receiver > sender))
}
