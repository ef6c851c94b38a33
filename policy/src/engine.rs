//! Runs the network in the fastest form for its device: [`crate::cpu`] for the graph encoder on a CPU, burn for the
//! non-graph baseline and for GPUs.

use burn::tensor::{Device, Tensor};

use crate::FeatureBatch;
use crate::config::PolicyConfig;
use crate::cpu::{CpuNetwork, NetworkLayout, Outputs, Tape};
use crate::mixture::{ActionRows, DrawLogits, DrawNumbers};
use crate::network::{BatchTensors, Folded, MoveTensors, Network, NetworkOutput};
use crate::parameters::{self, ParameterError, ParameterSpec, gradient, leaf, to_vec};

/// A network with parameters.
#[derive(Debug)]
pub struct Engine {
    table: Vec<ParameterSpec>,
    n_grippers: usize,
    device: Device,
    with_gradients: bool,
    form: Form,
}

#[derive(Debug)]
enum Form {
    Cpu { layout: Box<NetworkLayout>, network: Box<CpuNetwork>, tape: Box<Tape> },
    Burn { plain: Box<Network>, folded: Box<Folded>, tracked: Option<Box<Network>> },
}

/// Outputs of a tracked pass. [`crate::cpu`] backpropagates from their gradients; burn does not need them.
#[derive(Debug)]
pub struct Leaves(Option<NetworkOutput>);

impl Engine {
    /// Creates a network with the initial parameters of `seed`. Without `with_gradients`, it can only run forward.
    pub fn new(config: &PolicyConfig, seed: u64, device: &Device, with_gradients: bool) -> Self {
        let plain = Network::init(&config.network, &config.sizes(), seed, device);
        let table = plain.table().to_vec();
        let layout = NetworkLayout::new(&config.network, &config.sizes(), &table).filter(|_| *device == Device::flex());
        let form = match layout {
            Some(layout) => {
                let network = CpuNetwork::new(&layout, &parameters::flatten(&plain), with_gradients)
                    .expect("finite initial parameters of the right number");
                Form::Cpu { layout: Box::new(layout), network: Box::new(network), tape: Box::default() }
            }
            None => {
                let on = device.clone().autodiff();
                let tracked =
                    with_gradients.then(|| Box::new(Network::init(&config.network, &config.sizes(), seed, &on)));
                Form::Burn { folded: Box::new(plain.fold()), plain: Box::new(plain), tracked }
            }
        };
        let n_grippers = usize::from(config.features.n_grippers);
        Self { table, n_grippers, device: device.clone(), with_gradients, form }
    }

    /// Returns the name and shape of every parameter, in the order of the flat vector.
    pub fn table(&self) -> &[ParameterSpec] {
        &self.table
    }

    /// Returns the parameters as one flat vector.
    pub fn parameters(&self) -> Vec<f32> {
        match &self.form {
            Form::Cpu { network, .. } => network.parameters().to_vec(),
            Form::Burn { plain, .. } => parameters::flatten(plain.as_ref()),
        }
    }

    /// Replaces the parameters; after an error, the old ones stay in use.
    ///
    /// # Errors
    /// If their number is wrong or one is not finite.
    pub fn load(&mut self, values: &[f32]) -> Result<(), ParameterError> {
        match &mut self.form {
            // Reuses the tape's memory.
            Form::Cpu { layout, network, .. } => **network = CpuNetwork::new(layout, values, self.with_gradients)?,
            Form::Burn { .. } => *self = self.with(values)?,
        }
        Ok(())
    }

    /// Returns the same network with other parameters.
    ///
    /// # Errors
    /// As for [`Engine::load`].
    pub fn with(&self, values: &[f32]) -> Result<Self, ParameterError> {
        let form = match &self.form {
            Form::Cpu { layout, .. } => Form::Cpu {
                network: Box::new(CpuNetwork::new(layout, values, self.with_gradients)?),
                layout: layout.clone(),
                tape: Box::default(),
            },
            Form::Burn { plain, tracked, .. } => {
                let plain = parameters::load((**plain).clone(), values)?;
                let tracked = tracked.as_ref().map(|tracked| parameters::load((**tracked).clone(), values));
                let tracked = tracked.transpose()?.map(Box::new);
                Form::Burn { folded: Box::new(plain.fold()), plain: Box::new(plain), tracked }
            }
        };
        Ok(Self { table: self.table.clone(), device: self.device.clone(), form, ..*self })
    }

    /// Computes the outputs for `rows` of a batch of normalized features.
    ///
    /// # Panics
    /// If a row is not in the batch, or the batch has other feature sizes.
    pub fn run(&mut self, batch: &FeatureBatch, rows: &[usize]) -> Outputs {
        match &mut self.form {
            Form::Cpu { network, tape, .. } => network.infer(batch, rows, tape).clone(),
            Form::Burn { plain, folded, .. } => run_on_burn(plain, folded, &batch.select(rows), &self.device),
        }
    }

    /// Like [`Engine::run`], on the autodiff device. Also returns what [`Engine::gradient`] needs. With the mixture
    /// head, `draws` are the recorded draws in the scenes of `rows`, or empty if their logits are not needed.
    ///
    /// # Panics
    /// As for [`Engine::run`], or if the engine was created without gradients.
    pub fn run_tracked(
        &mut self,
        batch: &FeatureBatch,
        rows: &[usize],
        draws: &[&ActionRows],
    ) -> (NetworkOutput, Leaves) {
        match &mut self.form {
            Form::Cpu { network, tape, .. } => {
                let device = self.device.clone().autodiff();
                let outputs = network.forward(batch, rows, tape);
                let mut leaves = outputs.to_tensors(self.n_grippers, &device);
                if !draws.is_empty() {
                    let logits = DrawNumbers::new(draws, &outputs.readouts);
                    leaves.draws = Some(logits.to_tensors(draws.len(), &device));
                }
                (leaves.clone(), Leaves(Some(leaves)))
            }
            Form::Burn { tracked, .. } => {
                let network = tracked.as_ref().expect("the engine was made with gradients");
                let device = self.device.clone().autodiff();
                let batch = BatchTensors::new(&batch.select(rows), &device);
                let output = network.forward(&batch);
                let readouts = output.readouts.as_ref().filter(|_| !draws.is_empty());
                let draws = readouts.map(|readouts| DrawLogits::new(draws, readouts));
                (NetworkOutput { draws, ..output }, Leaves(None))
            }
        }
    }

    /// Returns the gradient of a loss in the order of the flat parameters. `leaves` must be those of the engine's last
    /// tracked pass, from whose output the loss was computed, and `draws` those of that pass. Reuses the memory of
    /// `spare`, such as an earlier gradient.
    pub fn gradient(
        &mut self,
        leaves: Leaves,
        loss: &Tensor<1>,
        draws: &[&ActionRows],
        mut spare: Vec<f32>,
    ) -> Vec<f32> {
        let mut gradients = loss.backward();
        match (&mut self.form, leaves.0) {
            (Form::Cpu { network, tape, .. }, Some(leaves)) => {
                let readouts = &tape.outputs().readouts;
                let by_readouts = match &leaves.draws {
                    Some(DrawLogits { first, blocks, second }) => {
                        let by_logits = [first, blocks, second].map(|logits| gradient(logits, &mut gradients));
                        DrawNumbers(by_logits).by_readouts(draws, readouts)
                    }
                    None => vec![0.0; readouts.len()],
                };
                let [locs, scales] = leaves.moves.as_ref().map_or_else(Default::default, |moves| {
                    [&moves.locs, &moves.scales].map(|leaf| gradient(leaf, &mut gradients))
                });
                let by_output = Outputs {
                    locs,
                    scales,
                    logits: gradient(&leaves.logits, &mut gradients),
                    values: gradient(&leaves.values, &mut gradients),
                    readouts: by_readouts,
                };
                network.backward(tape, &by_output, &mut spare);
                spare
            }
            (Form::Burn { tracked: Some(network), .. }, None) => {
                parameters::flatten_gradients(network.as_ref(), &mut gradients)
            }
            _ => panic!("a tracked pass of another engine"),
        }
    }

    /// Returns each layer's attention weights for every scene of a batch, per layer
    /// `[n, 16 receivers, heads, 16 senders]`, and the logits `[n, G, 16]`. A network without attention has no layers.
    pub fn attention(&self, batch: &FeatureBatch) -> (Vec<Vec<f32>>, Vec<f32>) {
        match &self.form {
            Form::Cpu { network, .. } => {
                let (rows, mut tape): (Vec<usize>, _) = ((0..batch.n).collect(), Tape::default());
                let logits = network.forward(batch, &rows, &mut tape).logits.clone();
                (if network.attends() { tape.attention() } else { Vec::new() }, logits)
            }
            Form::Burn { plain, folded, .. } => (Vec::new(), run_on_burn(plain, folded, batch, &self.device).logits),
        }
    }
}

fn run_on_burn(network: &Network, folded: &Folded, batch: &FeatureBatch, device: &Device) -> Outputs {
    network.forward_folded(folded, &BatchTensors::new(batch, device)).into()
}

impl From<NetworkOutput> for Outputs {
    fn from(NetworkOutput { moves, logits, values, readouts, .. }: NetworkOutput) -> Self {
        let (locs, scales) = moves.map(|moves| (to_vec(moves.locs), to_vec(moves.scales))).unwrap_or_default();
        let readouts = readouts.map(to_vec).unwrap_or_default();
        Self { locs, scales, logits: to_vec(logits), values: to_vec(values), readouts }
    }
}

impl Outputs {
    /// Converts the outputs to tensors, except the read-outs. On a device with autodiff, they are leaves of its graph.
    pub fn to_tensors(&self, n_grippers: usize, device: &Device) -> NetworkOutput {
        let n = self.values.len();
        let cube = |values: &[f32], shape: [usize; 3]| leaf(values, shape, device);
        NetworkOutput {
            moves: (!self.locs.is_empty())
                .then(|| MoveTensors { locs: cube(&self.locs, [n, 16, 6]), scales: cube(&self.scales, [n, 16, 6]) }),
            logits: cube(&self.logits, [n, n_grippers, 16]),
            values: leaf(&self.values, [n], device),
            readouts: None,
            draws: None,
        }
    }
}
