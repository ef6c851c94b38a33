//! The builder that creates the layers of the network and lists their parameters.

use burn::module::Param;
use burn::nn::{LayerNorm, LayerNormConfig, Linear};
use burn::tensor::{Device, Tensor};

use crate::parameters::{Initializer, ParameterSpec};

/// Kernel `[in, out]` of `y = x w`.
pub(super) type Kernel = Param<Tensor<2>>;

/// Creates layers whose values are to be loaded, and records the name, shape, and initializer of each parameter in the
/// order of creation. What burn adds to the variance in a LayerNorm, 1e-5, is Haiku's default too.
pub(crate) struct Builder<'a> {
    device: &'a Device,
    pub(crate) specs: Vec<ParameterSpec>,
    pub(crate) initializers: Vec<Initializer>,
}

impl<'a> Builder<'a> {
    pub(crate) fn new(device: &'a Device) -> Self {
        Self { device, specs: Vec::new(), initializers: Vec::new() }
    }

    fn note(&mut self, name: String, shape: Vec<usize>, initializer: Initializer) {
        self.specs.push(ParameterSpec { name, shape });
        self.initializers.push(initializer);
    }

    pub(crate) fn kernel(&mut self, name: &str, [n_in, n_out]: [usize; 2], init: Initializer) -> Kernel {
        self.note(format!("{name}.w"), vec![n_in, n_out], init);
        Param::from_tensor(Tensor::zeros([n_in, n_out], self.device))
    }

    pub(crate) fn linear(&mut self, name: &str, shape: [usize; 2], init: Initializer) -> Linear {
        let weight = self.kernel(name, shape, init);
        self.note(format!("{name}.b"), vec![shape[1]], Initializer::Constant(0.0));
        Linear { weight, bias: Some(Param::from_tensor(Tensor::zeros([shape[1]], self.device))) }
    }

    pub(crate) fn layer_norm(&mut self, name: &str, width: usize) -> LayerNorm {
        self.note(format!("{name}.scale"), vec![width], Initializer::Constant(1.0));
        self.note(format!("{name}.offset"), vec![width], Initializer::Constant(0.0));
        LayerNormConfig::new(width).init(self.device)
    }

    /// Creates layers `name.0`, `name.1`, … between the given widths.
    pub(crate) fn mlp(&mut self, name: &str, widths: &[usize]) -> Vec<Linear> {
        let pairs = widths.windows(2).enumerate();
        pairs.map(|(j, w)| self.linear(&format!("{name}.{j}"), [w[0], w[1]], Initializer::HaikuLinear)).collect()
    }
}

/// Returns the bias of a layer, as one row.
pub(super) fn bias(linear: &Linear) -> Tensor<2> {
    linear.bias.as_ref().expect("the builder gives every layer a bias").val().unsqueeze()
}
