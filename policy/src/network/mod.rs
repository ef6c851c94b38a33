//! The network: an encoder, a policy head, and a value head. For the shapes, see [`BatchTensors`] and
//! [`NetworkOutput`].

mod gat;
mod heads;
mod layers;
mod resnet;
mod tensors;

use burn::module::Module;
use burn::tensor::{Device, Tensor};

pub use heads::MoveTensors;
pub use tensors::BatchTensors;
pub(crate) use tensors::listed_index;

use crate::config::{EncoderConfig, NetworkConfig};
use crate::features::FeatureSizes;
use crate::mixture::DrawLogits;
use crate::parameters::{self, ParameterSpec};
use gat::{FoldedLayer, GatEncoder};
use heads::{PolicyHead, ValueHead};
use layers::Builder;
use resnet::ResnetEncoder;

/// The actor-critic network of the paper, for both training and inference.
#[derive(Module, Debug)]
pub struct Network {
    encoder: Encoder,
    head: PolicyHead,
    value: ValueHead,
    #[module(skip)]
    table: Vec<ParameterSpec>,
}

/// One of the two encoders.
#[derive(Module, Debug)]
enum Encoder {
    /// Graph attention, or equal weights.
    Gat(GatEncoder),
    /// The flat baseline.
    Resnet(ResnetEncoder),
}

/// Network output for a batch of B scenes with G grippers.
#[derive(Clone, Debug)]
pub struct NetworkOutput {
    /// Gaussians of the moves; `None` for the mixture head.
    pub moves: Option<MoveTensors>,
    /// Logits of each gripper's choice `[B, G, 16]`, not masked.
    pub logits: Tensor<3>,
    /// Values `[B]`, in the unit of the value targets used in training (normalized, see `Normalization`).
    pub values: Tensor<1>,
    /// Read-outs of the mixture head `[B, 16, N_READOUTS]`; `None` for the Gaussian head.
    pub readouts: Option<Tensor<3>>,
    /// Logits of recorded draws from the mixture head; `None` for the Gaussian head, or if no draws were given.
    pub draws: Option<DrawLogits>,
}

impl NetworkOutput {
    /// Returns the Gaussians of the moves.
    ///
    /// # Panics
    /// If the network has the mixture head.
    pub fn gaussians(&self) -> &MoveTensors {
        self.moves.as_ref().expect("the Gaussian head")
    }
}

/// The part of a forward pass that depends only on parameters; valid until they change. The flat encoder has none.
#[derive(Clone, Debug)]
pub struct Folded(Vec<FoldedLayer>);

impl Network {
    /// Creates a network with Haiku's initial values; the same seed gives the same values.
    ///
    /// On `device.autodiff()`, its parameters are tracked for training. `config` must be valid.
    pub fn init(config: &NetworkConfig, sizes: &FeatureSizes, seed: u64, device: &Device) -> Self {
        let mut builder = Builder::new(device);
        let encoder = match &config.encoder {
            EncoderConfig::Gat(gat) => Encoder::Gat(GatEncoder::build(&mut builder, gat, config.width, sizes)),
            EncoderConfig::Resnet(resnet) => {
                Encoder::Resnet(ResnetEncoder::build(&mut builder, resnet, config.width, sizes))
            }
        };
        let head = PolicyHead::build(&mut builder, config, sizes);
        let value = ValueHead::build(&mut builder, config, sizes);
        let values = parameters::initial_values(&builder.specs, &builder.initializers, seed);
        parameters::load(Self { encoder, head, value, table: builder.specs }, &values)
            .expect("the table lists every parameter once, with finite initial values")
    }

    /// Returns the name and shape of every parameter, in the order of the flat vector.
    pub fn table(&self) -> &[ParameterSpec] {
        &self.table
    }

    /// Folds and runs the network as one graph.
    ///
    /// # Shapes
    /// As in [`BatchTensors`] and [`NetworkOutput`].
    pub fn forward(&self, batch: &BatchTensors) -> NetworkOutput {
        self.forward_folded(&self.fold(), batch)
    }

    /// Computes the part that inference shares between batches.
    pub fn fold(&self) -> Folded {
        Folded(match &self.encoder {
            Encoder::Gat(gat) => gat.fold(),
            Encoder::Resnet(_) => Vec::new(),
        })
    }

    /// Runs the network with `folded`, which must be computed from its current parameters.
    ///
    /// # Shapes
    /// As in [`BatchTensors`] and [`NetworkOutput`].
    ///
    /// # Panics
    /// If `folded` comes from a network with another number of layers.
    pub fn forward_folded(&self, folded: &Folded, batch: &BatchTensors) -> NetworkOutput {
        let (nodes, global) = match &self.encoder {
            Encoder::Gat(gat) => gat.forward(&folded.0, batch),
            Encoder::Resnet(resnet) => resnet.forward(batch),
        };
        let logits = self.head.logits(&nodes, &global, &batch.globals);
        let values = self.value.forward(&global, &batch.globals, &logits);
        let (moves, readouts) = (self.head.moves(&nodes), self.head.readouts(&nodes));
        NetworkOutput { moves, logits, values, readouts, draws: None }
    }
}
