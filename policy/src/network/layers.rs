//! The basic layers of the network, and the builder that lists their parameters.

use burn::module::{Module, Param};
use burn::tensor::{Device, Tensor, module};

use crate::parameters::{Initializer, ParameterSpec};

/// Added to the variance in a LayerNorm (Haiku's default).
const LAYER_NORM_EPSILON: f64 = 1e-5;

/// `y = x w + b`.
#[derive(Module, Debug)]
pub(super) struct Linear {
    /// Kernel `[in, out]`.
    pub(super) w: Param<Tensor<2>>,
    /// Bias `[out]`.
    pub(super) b: Param<Tensor<1>>,
}

/// `y = x w`.
#[derive(Module, Debug)]
pub(super) struct Projection {
    /// Kernel `[in, out]`.
    pub(super) w: Param<Tensor<2>>,
}

/// Normalizes the last axis to mean 0 and variance 1, then scales and shifts it.
#[derive(Module, Debug)]
pub struct LayerNorm {
    /// Factor `[width]`.
    pub scale: Param<Tensor<1>>,
    /// Shift `[width]`.
    pub offset: Param<Tensor<1>>,
}

impl Linear {
    /// Applies the layer.
    ///
    /// # Shapes
    /// `[rows, in]` → `[rows, out]`
    pub(super) fn forward(&self, x: Tensor<2>) -> Tensor<2> {
        module::linear(x, self.w.val(), Some(self.b.val()))
    }
}

impl LayerNorm {
    /// Normalizes each row.
    ///
    /// # Shapes
    /// `[rows, width]` → `[rows, width]`
    pub fn forward(&self, x: Tensor<2>) -> Tensor<2> {
        module::layer_norm(x, self.scale.val(), Some(self.offset.val()), LAYER_NORM_EPSILON)
    }
}

/// Creates layers of zeros and records the name, shape, and initializer of each parameter in the order of creation.
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

    pub(crate) fn projection(&mut self, name: &str, [n_in, n_out]: [usize; 2], init: Initializer) -> Projection {
        self.note(format!("{name}.w"), vec![n_in, n_out], init);
        Projection { w: Param::from_tensor(Tensor::zeros([n_in, n_out], self.device)) }
    }

    pub(crate) fn linear(&mut self, name: &str, shape: [usize; 2], init: Initializer) -> Linear {
        let Projection { w } = self.projection(name, shape, init);
        self.note(format!("{name}.b"), vec![shape[1]], Initializer::Constant(0.0));
        Linear { w, b: Param::from_tensor(Tensor::zeros([shape[1]], self.device)) }
    }

    pub(crate) fn layer_norm(&mut self, name: &str, width: usize) -> LayerNorm {
        self.note(format!("{name}.scale"), vec![width], Initializer::Constant(1.0));
        self.note(format!("{name}.offset"), vec![width], Initializer::Constant(0.0));
        LayerNorm {
            scale: Param::from_tensor(Tensor::zeros([width], self.device)),
            offset: Param::from_tensor(Tensor::zeros([width], self.device)),
        }
    }

    /// Creates layers `name.0`, `name.1`, … between the given widths.
    pub(crate) fn mlp(&mut self, name: &str, widths: &[usize]) -> Vec<Linear> {
        let pairs = widths.windows(2).enumerate();
        pairs.map(|(j, w)| self.linear(&format!("{name}.{j}"), [w[0], w[1]], Initializer::HaikuLinear)).collect()
    }
}
