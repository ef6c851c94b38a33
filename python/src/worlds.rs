//! A batch of worlds.

use std::hint::black_box;
use std::sync::{Mutex, MutexGuard, PoisonError};

use blueprints::{BlockIdx, Inventory, N_BLOCKS};
use environment::vec_env::generator;
use environment::world::CONTROL_DT_S;
use environment::{Arrangement, Env, EnvironmentConfig, StartError, StepResult, World};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArray3, PyArrayDyn, PyArrayMethods};
use numpy::{PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods};
use policy::{FeatureConfig, FeatureSizes};
use proto::{Action, Pose, RewardTerms, Scene, Status, Valid};
use pyo3::exceptions::{PyIndexError, PyMemoryError, PyValueError};
use pyo3::sync::MutexExt;
use pyo3::types::{PyAnyMethods, PyDict, PyDictMethods, PyType};
use pyo3::{Bound, PyAny, PyResult, Python, pyclass, pymethods};
use render::picture::Painter;

use crate::arrays::{ActionArrays, action_arrays, actions, hold, rows, share};
use crate::error::{message, refused};
use crate::goals::Goals;
use crate::picture::Stage;
use crate::proposals::{self, N_PICKS, ProposalArrays};
use crate::row::{Features, Row, RowState};
use crate::settings::parsed;
use crate::tasks::{Tasks, Wish};

/// Rewards `[n]`, statuses `[n]`, and reward terms `[n, 5]`.
type StepArrays<'py> = (Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<u8>>, Bound<'py, PyArray2<f32>>);

/// Upper bound of what a world takes in memory, bytes. New ones take a third of it, and the rest grows while structures
/// stand.
const WORLD_BYTES: usize = 400_000;

/// The arguments of [`Worlds::new`], without paths.
type Arguments = (usize, Vec<String>, Vec<(String, f64)>, bool, String, String, usize);

/// Worlds that step in parallel.
#[pyclass(module = "lodestone._native", frozen)]
pub(crate) struct Worlds {
    config: Valid<EnvironmentConfig>,
    features: FeatureConfig,
    sizes: FeatureSizes,
    tasks: Tasks,
    starts: Vec<(String, f64)>,
    /// Behind a lock, because Python may call from several threads.
    rows: Mutex<Vec<Row>>,
    n_threads: usize,
    painter: Mutex<Painter>,
}

/// What a world that has just started an episode reports.
const STARTED: StepResult = StepResult {
    reward: RewardTerms { connected: 0.0, wrong: 0.0, magnets: 0.0, blocks: 0.0, force: 0.0 },
    status: Status::Running,
};

/// Work on one world.
struct Job<'a> {
    row: &'a mut Row,
    /// `None` starts an episode.
    action: Option<Action>,
    features: Features<'a>,
    outcome: &'a mut Result<StepResult, StartError>,
}

#[pymethods]
impl Worlds {
    /// Creates worlds that wait for their first reset.
    #[new]
    #[pyo3(signature = (n, blueprints, starts, shuffle_blocks, settings, features, n_threads))]
    #[allow(clippy::too_many_arguments, reason = "a thin layer, called from one place")]
    fn new(
        py: Python<'_>,
        n: i64,
        blueprints: Vec<String>,
        starts: Vec<(String, f64)>,
        shuffle_blocks: bool,
        settings: &str,
        features: &str,
        n_threads: i64,
    ) -> PyResult<Self> {
        let positive = |number: i64| usize::try_from(number).ok().filter(|number| *number > 0);
        let (Some(n), Some(n_threads)) = (positive(n), positive(n_threads)) else {
            let text = format!("{n} worlds on {n_threads} threads: expected at least one of each");
            return Err(PyValueError::new_err(text));
        };
        let config = Valid::new(parsed::<EnvironmentConfig>("settings", settings)?).map_err(refused)?;
        let features: FeatureConfig = parsed("features", features)?;
        let features = FeatureConfig { n_grippers: config.n_grippers, ..features };
        let goals = Goals::new(&blueprints).map_err(refused)?;
        let tasks = Tasks::new(goals, &starts, shuffle_blocks).map_err(refused)?;
        let mut rows = room_for(n)?;
        rows.extend((0..n).map(|row| Row::new(World::new(&config), generator(0, row as u64))));
        // Skips the constructors of `Batch` and of the environment, and attributes the warning to their caller.
        tasks.goals.warn(py, 3)?;
        let sizes = FeatureSizes::new(&features);
        let (rows, painter) = (Mutex::new(rows), Mutex::default());
        Ok(Self { config, features, sizes, tasks, starts, rows, n_threads, painter })
    }

    /// Returns worlds that go on bit for bit as these.
    fn __deepcopy__(&self, py: Python<'_>, _memo: &Bound<'_, PyAny>) -> PyResult<Self> {
        let all = self.lock(py);
        let mut rows = room_for(all.len())?;
        rows.extend(all.iter().cloned());
        Ok(Self {
            config: self.config.clone(),
            features: self.features,
            sizes: self.sizes,
            tasks: self.tasks.clone(),
            starts: self.starts.clone(),
            rows: Mutex::new(rows),
            n_threads: self.n_threads,
            painter: Mutex::default(),
        })
    }

    /// Returns what a pickle holds: the arguments, and what happened in each world.
    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<(Bound<'py, PyType>, Arguments, Vec<RowState>)> {
        let this = slf.get();
        let all = this.lock(slf.py());
        let settings = serde_json::to_string(&this.config).map_err(refused)?;
        let (names, starts) = (this.tasks.goals.sources.clone(), this.starts.clone());
        let (shuffle_blocks, features) = (this.tasks.shuffle_blocks, this.features()?);
        let arguments = (all.len(), names, starts, shuffle_blocks, settings, features, this.n_threads);
        let state = |(row, one): (usize, &Row)| {
            one.state().map_err(|error| PyValueError::new_err(format!("world {row} cannot be pickled: {error}")))
        };
        let states = all.iter().enumerate().map(state).collect::<PyResult<_>>()?;
        Ok((slf.get_type(), arguments, states))
    }

    /// Replays what happened in each world.
    fn __setstate__(&self, py: Python<'_>, states: Vec<RowState>) -> PyResult<()> {
        let mut all = self.lock(py);
        if states.len() != all.len() {
            return Err(PyValueError::new_err(format!("{} states for {} worlds", states.len(), all.len())));
        }
        let mut results: Vec<_> = states.iter().map(|_| Ok(())).collect();
        let jobs: Vec<_> = all.iter_mut().zip(states).zip(&mut results).collect();
        py.detach(|| share(self.n_threads, jobs, |((row, state), result)| *result = row.restore(&self.tasks, state)));
        for (row, result) in results.iter().enumerate() {
            if let Err(error) = result {
                let text = format!("world {row} cannot be restored: {}", message(error));
                return Err(PyValueError::new_err(text));
            }
        }
        Ok(())
    }

    /// Numbers of features per node, per edge, and of the whole scene.
    #[getter]
    fn sizes(&self) -> (usize, usize, usize) {
        (self.sizes.node, self.sizes.edge, self.sizes.global)
    }

    /// The feature flags as JSON.
    #[getter]
    fn features(&self) -> PyResult<String> {
        serde_json::to_string(&self.features).map_err(refused)
    }

    /// Number of grippers.
    #[getter]
    fn n_grippers(&self) -> usize {
        usize::from(self.config.n_grippers)
    }

    /// Steps after which an episode ends at the time limit.
    #[getter]
    fn episode_steps(&self) -> u16 {
        self.config.episode_steps
    }

    /// Length of a step in seconds.
    #[getter]
    fn step_s(&self) -> f32 {
        CONTROL_DT_S
    }

    /// Ids of the goals that episodes are drawn from.
    #[getter]
    fn blueprints(&self) -> Vec<String> {
        self.tasks.goals.ids.iter().map(ToString::to_string).collect()
    }

    /// Starts episodes in the worlds of `mask`, after reseeding those with a seed, and writes their features.
    #[pyo3(signature = (mask, seeds, blueprint, start, features))]
    fn reset(
        &self,
        py: Python<'_>,
        mask: PyReadonlyArray1<'_, bool>,
        seeds: Vec<Option<u64>>,
        blueprint: Option<&str>,
        start: Option<&str>,
        features: Vec<Bound<'_, PyArrayDyn<f32>>>,
    ) -> PyResult<()> {
        let mut all = self.lock(py);
        let mask = masked(&mask, all.len())?;
        if seeds.len() != all.len() {
            let text = format!("{} seeds for {} worlds", seeds.len(), all.len());
            return Err(PyValueError::new_err(text));
        }
        let wish = Wish::new(&self.tasks, blueprint, start).map_err(refused)?;
        let mut held = hold(&features, &self.sizes, all.len())?;
        let slices = rows(&mut held, &self.sizes)?;
        let mut outcomes = vec![Ok(STARTED); all.len()];
        let parts = all.iter_mut().zip(slices).zip(&mut outcomes).zip(seeds).zip(mask);
        let jobs = parts.filter(|(_, masked)| **masked).map(|((((row, features), outcome), seed), _)| {
            if let Some(seed) = seed {
                row.seed(generator(seed, 0));
            }
            Job { row, action: None, features, outcome }
        });
        self.work(py, jobs.collect(), &wish);
        outcomes.into_iter().try_for_each(|outcome| outcome.map(drop)).map_err(refused)
    }

    /// Starts an episode in the worlds of `resets`, advances all others by one step, and writes all features.
    fn step<'py>(
        &self,
        py: Python<'py>,
        choices: PyReadonlyArray2<'py, i64>,
        moves: PyReadonlyArray3<'py, f32>,
        resets: PyReadonlyArray1<'py, bool>,
        features: Vec<Bound<'py, PyArrayDyn<f32>>>,
    ) -> PyResult<StepArrays<'py>> {
        let mut all = self.lock(py);
        let n = all.len();
        let resets = masked(&resets, n)?;
        let actions = actions(&choices, &moves, n, self.n_grippers())?;
        if let Some(row) = all.iter().zip(resets).position(|(row, reset)| row.task.is_none() && !reset) {
            return Err(PyValueError::new_err(format!(
                "world {row} has no episode yet: reset it before the first step"
            )));
        }
        let mut held = hold(&features, &self.sizes, n)?;
        let slices = rows(&mut held, &self.sizes)?;
        let mut outcomes = vec![Ok(STARTED); n];
        let parts = all.iter_mut().zip(slices).zip(&mut outcomes).zip(actions).zip(resets);
        let jobs = parts.map(|((((row, features), outcome), action), reset)| Job {
            row,
            action: (!*reset).then_some(action),
            features,
            outcome,
        });
        self.work(py, jobs.collect(), &Wish::default());
        let results: Vec<StepResult> = outcomes.into_iter().collect::<Result<_, _>>().map_err(refused)?;
        let rewards: Vec<f64> = results.iter().map(|result| f64::from(result.reward.total())).collect();
        let statuses: Vec<u8> = results.iter().map(|result| code(result.status)).collect();
        let terms = |result: &StepResult| {
            let terms = &result.reward;
            [terms.connected, terms.wrong, terms.magnets, terms.blocks, terms.force]
        };
        let terms: Vec<f32> = results.iter().flat_map(terms).collect();
        Ok((rewards.into_pyarray(py), statuses.into_pyarray(py), terms.into_pyarray(py).reshape([n, 5])?))
    }

    /// Writes the features for another configuration.
    fn observe(&self, py: Python<'_>, settings: &str, features: Vec<Bound<'_, PyArrayDyn<f32>>>) -> PyResult<()> {
        let mut all = self.lock(py);
        let config: FeatureConfig = parsed("features", settings)?;
        let sizes = FeatureSizes::new(&config);
        let mut held = hold(&features, &sizes, all.len())?;
        let jobs: Vec<(&mut Row, Features<'_>)> = all.iter_mut().zip(rows(&mut held, &sizes)?).collect();
        py.detach(|| share(self.n_threads, jobs, |(row, features)| row.observe(&config, features)));
        Ok(())
    }

    /// Returns the goal of a world's episode, its start, and its seed.
    fn episode(&self, py: Python<'_>, row: usize) -> PyResult<(String, String, u64)> {
        let all = self.lock(py);
        let task = all.get(row).and_then(|row| row.task.as_ref());
        let task = task.ok_or_else(|| PyIndexError::new_err(format!("world {row} has no episode")))?;
        Ok((task.blueprint.to_string(), task.start.to_string(), task.seed))
    }

    /// Returns the blocks that a masked gripper may choose, `[n, 16]`: those of the blueprint, and connected ones,
    /// which may have to be taken apart.
    fn allowed<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<bool>>> {
        let all = self.lock(py);
        let allowed: Vec<bool> = all.iter().flat_map(Row::allowed).collect();
        allowed.into_pyarray(py).reshape([all.len(), N_BLOCKS])
    }

    /// Returns the proposals of each world.
    fn proposals<'py>(&self, py: Python<'py>) -> PyResult<ProposalArrays<'py>> {
        proposals::arrays(py, &mut self.with_proposals(py))
    }

    /// Returns which picks are offered, `[n, 16 · 33]`: in a masked world, only those of allowed blocks.
    fn offered<'py>(&self, py: Python<'py>, is_masked: bool) -> PyResult<Bound<'py, PyArray2<bool>>> {
        let mut rows = self.with_proposals(py);
        let offered: Vec<bool> = rows.iter_mut().flat_map(|row| proposals::offered(row, is_masked)).collect();
        offered.into_pyarray(py).reshape([rows.len(), N_PICKS])
    }

    /// Converts picks `[n, grippers]` to actions; draws no noise where `skipped`.
    fn picked<'py>(
        &self,
        py: Python<'py>,
        picks: PyReadonlyArray2<'py, i64>,
        skipped: PyReadonlyArray1<'py, bool>,
        is_noisy: bool,
        is_masked: bool,
    ) -> PyResult<ActionArrays<'py>> {
        let mut rows = self.with_proposals(py);
        let skipped = masked(&skipped, rows.len())?;
        let picks = proposals::picks(&picks, rows.len(), self.n_grippers())?;
        let mut actions = vec![Action::IDLE; rows.len()];
        let parts = rows.iter_mut().zip(&picks).zip(&mut actions).zip(skipped);
        for (((row, picks), action), _) in parts.filter(|(_, skipped)| !**skipped) {
            *action = proposals::action(row, picks, is_noisy, is_masked);
        }
        action_arrays(py, &actions, self.n_grippers())
    }

    /// Returns the scripted expert's action in each world.
    fn expert<'py>(&self, py: Python<'py>) -> PyResult<ActionArrays<'py>> {
        let mut all = self.lock(py);
        let mut actions = vec![Action::IDLE; all.len()];
        let jobs: Vec<(&mut Row, &mut Action)> = all.iter_mut().zip(&mut actions).collect();
        py.detach(|| share(self.n_threads, jobs, |(row, action)| *action = row.ask_expert(&self.config)));
        action_arrays(py, &actions, self.n_grippers())
    }

    /// Returns the state of a world as arrays.
    fn scene<'py>(&self, py: Python<'py>, row: usize) -> PyResult<Bound<'py, PyDict>> {
        let all = self.lock(py);
        let world = &all.get(row).ok_or_else(|| PyIndexError::new_err(format!("there is no world {row}")))?.world;
        let (scene, goal) = (world.scene(), world.blueprint());
        let state = PyDict::new(py);
        let positions: Vec<f32> = scene.blocks.iter().flat_map(|pose| pose.position).collect();
        let orientations: Vec<f32> = scene.blocks.iter().flat_map(|pose| pose.orientation).collect();
        let extents: Vec<f32> = BlockIdx::all().flat_map(|b| Inventory::standard().half_extents_m(b)).collect();
        let joints: Vec<i64> = scene.joints.iter().flat_map(|j| [j.a, j.b].map(|b| i64::from(u8::from(b)))).collect();
        let goal: Vec<bool> = BlockIdx::all().map(|block| goal.contains(block)).collect();
        state.set_item("positions", positions.into_pyarray(py).reshape([16, 3])?)?;
        state.set_item("orientations", orientations.into_pyarray(py).reshape([16, 4])?)?;
        state.set_item("half_extents", extents.into_pyarray(py).reshape([16, 3])?)?;
        state.set_item("speeds", scene.speeds_mps.to_vec().into_pyarray(py))?;
        state.set_item("connections", joints.into_pyarray(py).reshape([scene.joints.len(), 2])?)?;
        state.set_item("held", held(scene, self.n_grippers()).into_pyarray(py))?;
        state.set_item("in_blueprint", goal.into_pyarray(py))?;
        state.set_item("heavy_contacts", scene.n_heavy_contacts)?;
        Ok(state)
    }

    /// Begins a world's episode anew in a scene.
    fn set_scene(
        &self,
        py: Python<'_>,
        row: usize,
        positions: PyReadonlyArray2<'_, f32>,
        orientations: PyReadonlyArray2<'_, f32>,
        connections: Vec<(i64, i64)>,
    ) -> PyResult<()> {
        let mut all = self.lock(py);
        let row = all.get_mut(row).filter(|row| row.task.is_some());
        let row = row.ok_or_else(|| PyValueError::new_err("this world has no episode yet: reset it first"))?;
        let (positions, orientations) = (positions.as_slice()?.as_chunks().0, orientations.as_slice()?.as_chunks().0);
        let pose = |(&position, &orientation)| Pose { position, orientation };
        let poses: Vec<Pose> = positions.iter().zip(orientations).map(pose).collect();
        let poses = poses.try_into().map_err(|_| PyValueError::new_err("scene: expected 16 poses"))?;
        let block = |block: i64| {
            let known = u8::try_from(block).ok().and_then(|block| BlockIdx::try_from(block).ok());
            let text = || format!("scene: connections have the block {block}: expected a block from 0 to 15");
            known.ok_or_else(|| PyValueError::new_err(text()))
        };
        let connections = connections.into_iter().map(|(a, b)| Ok((block(a)?, block(b)?))).collect::<PyResult<_>>()?;
        let set = row.set_scene(&Arrangement { poses, connections });
        set.map_err(|error| PyValueError::new_err(format!("scene: {error}")))
    }

    /// Returns a picture of a world and its goal, `[height, width, 3]`.
    fn picture<'py>(&self, py: Python<'py>, row: usize, width: i64, height: i64) -> PyResult<Bound<'py, PyArray3<u8>>> {
        let side = |pixels: i64| usize::try_from(pixels).ok().filter(|pixels| (32..=4096).contains(pixels));
        let (Some(width), Some(height)) = (side(width), side(height)) else {
            let text = format!("a picture of {width} × {height} pixels: expected 32 to 4096 each");
            return Err(PyValueError::new_err(text));
        };
        let mut all = self.lock(py);
        let row = all.get_mut(row).ok_or_else(|| PyIndexError::new_err(format!("there is no world {row}")))?;
        let pixels = py.detach(|| {
            let mut painter = self.painter.lock().unwrap_or_else(PoisonError::into_inner);
            let size = [width, height];
            row.stage.take_if(|stage| stage.size_px() != size);
            let goal = row.world.blueprint();
            let stage = row.stage.get_or_insert_with(|| Stage::new(&row.opening, goal, size));
            stage.picture(&mut painter, row.world.scene())
        });
        pixels.into_pyarray(py).reshape([height, width, 3])
    }
}

impl Worlds {
    /// Locks the worlds, and makes the proposals of their scenes.
    pub(crate) fn with_proposals(&self, py: Python<'_>) -> MutexGuard<'_, Vec<Row>> {
        let mut all = self.lock(py);
        let jobs: Vec<&mut Row> = all.iter_mut().collect();
        py.detach(|| {
            share(self.n_threads, jobs, |row| {
                row.proposals();
            });
        });
        all
    }

    /// Locks the worlds. Releases the interpreter lock while waiting.
    fn lock(&self, py: Python<'_>) -> MutexGuard<'_, Vec<Row>> {
        self.rows.lock_py_attached(py).unwrap_or_else(PoisonError::into_inner)
    }

    fn work(&self, py: Python<'_>, jobs: Vec<Job<'_>>, wish: &Wish) {
        let work = |Job { row, action, features, outcome }: Job<'_>| {
            *outcome = match action {
                Some(action) => Ok(row.step(&action)),
                None => row.begin(&self.tasks, wish).map(|()| STARTED),
            };
            row.observe(&self.features, features);
        };
        py.detach(|| share(self.n_threads, jobs, work));
    }
}

/// Makes room for `n` worlds. The engine cannot report that memory has run out while it grows, so this tries first.
fn room_for(n: usize) -> PyResult<Vec<Row>> {
    let mut rows = Vec::new();
    let mut trial = Vec::<u8>::new();
    let n_bytes = n.saturating_mul(WORLD_BYTES);
    let fits = trial.try_reserve_exact(n_bytes).and_then(|()| rows.try_reserve_exact(n));
    // An allocation that nobody looks at could be optimized away.
    black_box(&trial);
    fits.map_err(|_| {
        let text = format!("no memory for {n} worlds, which take up to {} MB", n_bytes.div_ceil(1_000_000));
        PyMemoryError::new_err(text)
    })?;
    Ok(rows)
}

fn masked<'a>(mask: &'a PyReadonlyArray1<'_, bool>, n: usize) -> PyResult<&'a [bool]> {
    if mask.len() != n {
        return Err(PyValueError::new_err(format!("a mask has {} entries for {n} worlds", mask.len())));
    }
    Ok(mask.as_slice()?)
}

/// Returns the block that each gripper held in the last step, −1 for none.
fn held(scene: &Scene, n_grippers: usize) -> Vec<i64> {
    let block = |gripper: &Option<proto::Gripper>| gripper.and_then(|gripper| gripper.held);
    let grippers = scene.grippers.iter().take(n_grippers);
    grippers.map(|gripper| block(gripper).map_or(-1, |block| i64::from(u8::from(block)))).collect()
}

/// Returns the Python code of a status.
fn code(status: Status) -> u8 {
    match status {
        Status::Running => 0,
        Status::Success => 1,
        Status::TimeLimit => 2,
        Status::Diverged => 3,
    }
}
