//! Runs the policy on arrays of features.

use std::borrow::Cow;
use std::error::Error;
use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard, PoisonError};

use blueprints::{N_BLOCKS, outside};
use environment::vec_env::generator;
use numpy::PyUntypedArrayMethods;
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray2, PyReadonlyArray3};
use policy::features::N_EDGES;
use policy::model::{MAX_FILE_BYTES, Model};
use policy::proposals::Proposals;
use policy::{FeatureBatch, MoveHead, PolicyConfig};
use proto::{ActionMode, Decision, Valid};
use pyo3::exceptions::{PyOSError, PyValueError};
use pyo3::sync::MutexExt;
use pyo3::types::{PyAnyMethods, PyBytes, PyType};
use pyo3::{Bound, PyResult, Python, pyclass, pymethods};
use rand::rngs::ChaCha8Rng;

use crate::arrays::{ActionArrays, action_arrays};
use crate::error::{message, refused};
use crate::worlds::Worlds;

/// The pretrained policy embedded in the program.
const PRETRAINED: &[u8] = include_bytes!("../../deploy/pretrained/model.safetensors");

/// Indices of two edge features: the two blocks are connected, and both belong to the blueprint.
const CONNECTED: usize = 22;
const BOTH_BELONG: usize = 23;

/// Actions, log-probabilities `[n]`, values `[n]`, and slots `[n, grippers]`.
type DecisionArrays<'py> =
    (ActionArrays<'py>, Bound<'py, PyArray1<f32>>, Bound<'py, PyArray1<f32>>, Bound<'py, PyArray2<i64>>);

/// The file, the seed, and how far each row's generator has come.
type Arguments<'py> = (Bound<'py, PyBytes>, u64, Vec<u128>);

/// A frozen policy.
#[pyclass(module = "lodestone._native", frozen)]
pub(crate) struct Policy {
    config: Valid<PolicyConfig>,
    version: u64,
    /// The file that it came from.
    file: Cow<'static, [u8]>,
    /// Behind a lock, because Python may call from several threads, and in a box, because Python does not align objects
    /// as the network's buffers need.
    actor: Mutex<Box<Actor>>,
}

struct Actor {
    policy: policy::Policy,
    batch: FeatureBatch,
    seed: u64,
    /// One generator for each row seen so far.
    rngs: Vec<ChaCha8Rng>,
}

#[pymethods]
impl Policy {
    /// Creates a policy from the contents of a file, and draws sampled actions from where the generators were.
    #[new]
    #[pyo3(signature = (file, seed=0, positions=Vec::new()))]
    fn new(py: Python<'_>, file: &[u8], seed: u64, positions: Vec<u128>) -> PyResult<Self> {
        let policy = Self::from_bytes(Cow::Owned(file.to_vec())).map_err(|error| refused(&*error))?;
        let mut actor = policy.lock(py);
        actor.seed = seed;
        actor.grow(positions.len());
        for (rng, position) in actor.rngs.iter_mut().zip(positions) {
            rng.set_word_pos(position);
        }
        drop(actor);
        Ok(policy)
    }

    /// Returns what a pickle holds.
    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> (Bound<'py, PyType>, Arguments<'py>) {
        let (this, py) = (slf.get(), slf.py());
        let actor = this.lock(py);
        let positions = actor.rngs.iter().map(ChaCha8Rng::get_word_pos).collect();
        (slf.get_type(), (PyBytes::new(py, &this.file), actor.seed, positions))
    }

    /// Returns the pretrained policy.
    #[staticmethod]
    fn pretrained() -> PyResult<Self> {
        Self::from_bytes(Cow::Borrowed(PRETRAINED)).map_err(|error| refused(&*error))
    }

    /// Loads a policy from a file written by `lodestone export`.
    #[staticmethod]
    fn load(path: PathBuf) -> PyResult<Self> {
        let shown = path.display();
        let bytes = outside::read(&path, MAX_FILE_BYTES)
            .map_err(|error| PyOSError::new_err(format!("cannot read {shown}: {error}")))?;
        Self::from_bytes(Cow::Owned(bytes))
            .map_err(|error| PyValueError::new_err(format!("path: {shown}: {}", message(&*error))))
    }

    /// Numbers of features per node, per edge, and of the whole scene.
    #[getter]
    fn sizes(&self) -> (usize, usize, usize) {
        let sizes = self.config.sizes();
        (sizes.node, sizes.edge, sizes.global)
    }

    /// Number of grippers.
    #[getter]
    fn n_grippers(&self) -> usize {
        usize::from(self.config.features.n_grippers)
    }

    /// The policy's feature flags as JSON.
    #[getter]
    fn features(&self) -> PyResult<String> {
        serde_json::to_string(&self.config.features).map_err(refused)
    }

    /// Whether it draws moves from proposals, so that it needs worlds to act.
    #[getter]
    fn is_mixture(&self) -> bool {
        self.config.network.move_head == MoveHead::Mixture
    }

    /// Version of the policy's weights.
    #[getter]
    fn version(&self) -> u64 {
        self.version
    }

    /// Seeds the generators for sampled actions.
    fn seed(&self, py: Python<'_>, seed: u64) {
        let mut actor = self.lock(py);
        actor.seed = seed;
        actor.rngs.clear();
    }

    /// Returns choices and moves, log-probabilities, values, and slots for each row of features. A policy that draws
    /// from proposals takes those of the worlds, which the features are of.
    #[pyo3(signature = (nodes, edges, globals, sampled, worlds=None))]
    fn act<'py>(
        &self,
        py: Python<'py>,
        nodes: PyReadonlyArray3<'py, f32>,
        edges: PyReadonlyArray3<'py, f32>,
        globals: PyReadonlyArray2<'py, f32>,
        sampled: bool,
        worlds: Option<&Bound<'py, Worlds>>,
    ) -> PyResult<DecisionArrays<'py>> {
        let (n, sizes, n_grippers) = (nodes.shape()[0], self.config.sizes(), self.n_grippers());
        for (name, shape, wanted) in [
            ("nodes", nodes.shape(), &[n, N_BLOCKS, sizes.node][..]),
            ("edges", edges.shape(), &[n, N_EDGES, sizes.edge][..]),
            ("globals", globals.shape(), &[n, sizes.global][..]),
        ] {
            if shape != wanted {
                let text = format!("{name} has shape {shape:?}: this policy expects {wanted:?}");
                return Err(PyValueError::new_err(text));
            }
        }
        let parts = [nodes.as_slice()?, edges.as_slice()?, globals.as_slice()?];
        let mode = if sampled { ActionMode::Sampled } else { ActionMode::Greedy };
        let proposals = if self.is_mixture() { proposals_of(py, worlds, n)? } else { Vec::new() };
        let mut held = self.lock(py);
        let actor = &mut **held;
        let decided = py.detach(|| actor.act(parts, n, sizes.edge, mode, proposals));
        let decisions = decided.map_err(refused)?;
        let log_probs: Vec<f32> = decisions.iter().map(|decision| decision.log_prob).collect();
        let values: Vec<f32> = decisions.iter().map(|decision| decision.value).collect();
        let number = |slot: &Option<u8>| slot.map_or(-1, i64::from);
        let slots = decisions.iter().flat_map(|decision| decision.proposals[..n_grippers].iter().map(number));
        let slots = slots.collect::<Vec<i64>>().into_pyarray(py).reshape([n, n_grippers])?;
        let actions: Vec<_> = decisions.into_iter().map(|decision| decision.action).collect();
        let actions = action_arrays(py, &actions, n_grippers)?;
        Ok((actions, log_probs.into_pyarray(py), values.into_pyarray(py), slots))
    }
}

impl Policy {
    /// Locks the actor. Releases the interpreter lock while waiting.
    fn lock(&self, py: Python<'_>) -> MutexGuard<'_, Box<Actor>> {
        self.actor.lock_py_attached(py).unwrap_or_else(PoisonError::into_inner)
    }

    fn from_bytes(file: Cow<'static, [u8]>) -> Result<Self, Box<dyn Error>> {
        let Model { policy: config, weights, .. } = Model::from_bytes(&file)?;
        let policy = policy::Policy::with_weights(&config, &weights)?;
        let actor = Actor { policy, batch: FeatureBatch::of_policy(&config), seed: 0, rngs: Vec::new() };
        Ok(Self { config, version: weights.version.0, file, actor: Mutex::new(Box::new(actor)) })
    }
}

impl Actor {
    /// Creates the generators that `n` rows lack.
    fn grow(&mut self, n: usize) {
        for row in self.rngs.len()..n {
            self.rngs.push(generator(self.seed, row as u64));
        }
    }

    fn act(
        &mut self,
        [nodes, edges, globals]: [&[f32]; 3],
        n: usize,
        edge: usize,
        mode: ActionMode,
        proposals: Vec<Proposals>,
    ) -> Result<Vec<Decision>, policy::PolicyError> {
        self.batch.clear();
        self.batch.n = n;
        self.batch.nodes.extend_from_slice(nodes);
        self.batch.edges.extend_from_slice(edges);
        self.batch.globals.extend_from_slice(globals);
        self.batch.allowed.extend(edges.chunks_exact(N_EDGES * edge).map(|edges| allowed(edges, edge)));
        self.batch.proposals = proposals;
        self.grow(n);
        self.policy.act_on(&mut self.batch, &vec![mode; n], &mut self.rngs[..n])
    }
}

/// Returns the proposals of `n` worlds.
fn proposals_of(py: Python<'_>, worlds: Option<&Bound<'_, Worlds>>, n: usize) -> PyResult<Vec<Proposals>> {
    let Some(worlds) = worlds else {
        return Err(PyValueError::new_err(
            "observation: this policy draws moves from proposals (policy.network.move_head = mixture), and features do \
             not tell what is proposed: use act(env)",
        ));
    };
    let mut rows = worlds.get().with_proposals(py);
    if rows.len() != n {
        return Err(PyValueError::new_err(format!("features of {n} scenes for {} worlds", rows.len())));
    }
    Ok(rows.iter_mut().map(|row| row.proposals().clone()).collect())
}

/// Derives the blocks that a masked policy may choose from a scene's edges: those of the blueprint, which has at least
/// two, and those with a connection.
fn allowed(edges: &[f32], edge: usize) -> [bool; N_BLOCKS] {
    let mut allowed = [false; N_BLOCKS];
    for (pair, features) in edges.chunks_exact(edge).enumerate() {
        if features[CONNECTED] > 0.5 || features[BOTH_BELONG] > 0.5 {
            // Pairs are sender-major without self-edges. Every pair occurs in both directions, so checking its sender
            // suffices.
            allowed[pair / (N_BLOCKS - 1)] = true;
        }
    }
    allowed
}
