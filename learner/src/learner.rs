//! The synchronous core of the learner: trajectories in, weights out.

use std::sync::Arc;

use blueprints::{BlueprintId, Catalog};
use policy::device::{DeviceError, DeviceKind};
use policy::normalization::FeatureMoments;
use policy::{Model, Policy, PolicyConfig, PolicyError};
use proto::codec::MAX_PARAMETERS;
use proto::metrics::PpoMetrics;
use proto::{CanonicalSettings, Normalization, SavedRng, Trajectory, Valid, Weights, WeightsVersion};
use rand::SeedableRng;
use rand::rngs::ChaCha8Rng;

use crate::adam::{Adam, LearningRate};
use crate::admission::{ActingLimits, Admission};
use crate::batch::Batch;
use crate::checkpoint::{Checkpoint, CheckpointError};
use crate::config::{LearnerConfig, LrSchedule, OptimizerConfig};
use crate::curriculum::Curriculum;
use crate::mailbox::{Mailbox, MailboxCounts};
use crate::normalization::ValueStatistics;
use crate::ppo::{Ppo, Trained};
use crate::state::LearnerState;
use crate::trial;

/// Number of scenes after which the feature statistics are frozen.
const N_FEATURE_SCENES: u64 = 500_000;

/// The inputs of a learner.
#[derive(Clone, Debug)]
pub struct LearnerSetup {
    /// The learner's settings.
    pub config: Valid<LearnerConfig>,
    /// The policy configuration that all services share.
    pub policy: Valid<PolicyConfig>,
    /// All blueprints; trajectories can refer to those of the training split.
    pub catalog: Arc<Catalog>,
    /// Blueprints of the training split to train on, at least one. Whoever selects goals has found them in the catalog.
    pub tasks: Vec<BlueprintId>,
    /// Settings of policy and worlds, which must be those of every actor. Weights carry them, and trajectories their
    /// hash.
    pub settings: CanonicalSettings,
    /// What actors do according to the run's settings.
    pub acting: ActingLimits,
    /// Seed of the initial parameters and of the sample order.
    pub seed: u64,
    /// The device that computes gradients.
    pub device: DeviceKind,
    /// A policy to start from instead of untrained parameters, with a fresh optimizer. Its network and features must
    /// match; the settings of its standard deviations may differ, since they have no parameters.
    pub init: Option<Arc<Model>>,
}

/// Errors from creating a learner.
#[derive(Debug, thiserror::Error)]
pub enum LearnerError {
    /// The device does not exist.
    #[error(transparent)]
    Device(#[from] DeviceError),
    /// The network has too many parameters for a message with its weights.
    #[error("the network has {0} parameters, more than the {MAX_PARAMETERS} that the bus carries: make it smaller")]
    TooLarge(usize),
    /// The checkpoint cannot be used.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    /// No policy can act with the weights of the checkpoint.
    #[error(transparent)]
    Weights(#[from] PolicyError),
    /// The policy to start from has a different network.
    #[error("the policy to start from does not fit: {0}")]
    Init(String),
}

/// Turns trajectories into weights. It is synchronous and uses no clock: equal inputs in equal order produce equal
/// weights.
#[derive(Debug)]
pub struct Learner {
    pub(crate) setup: LearnerSetup,
    pub(crate) ppo: Ppo,
    pub(crate) state: LearnerState,
    pub(crate) mailbox: Arc<Mailbox>,
    /// Number of accepted trajectories that could not be learned from.
    pub(crate) n_unmade: u64,
    /// Tries the weights of each update.
    tried: Policy,
    /// Number of updates that were taken back.
    pub(crate) n_refused: u64,
}

impl LearnerSetup {
    /// Returns what a learner with this setup admits.
    pub(crate) fn admission(&self) -> Admission {
        let Self { catalog, policy, settings, acting, .. } = self;
        Admission::new(catalog, policy, settings, *acting)
    }
}

impl Learner {
    /// Creates a learner, untrained unless `setup.init` is a policy.
    ///
    /// # Errors
    /// If the device cannot be opened, or `setup.init` does not fit.
    pub fn new(setup: LearnerSetup) -> Result<Self, LearnerError> {
        let device = setup.device.open()?;
        let state = LearnerState {
            version: WeightsVersion(0),
            n_env_steps: 0,
            n_updates: 0,
            n_episodes: 0,
            learning_rate: LearningRate(setup.config.optimizer.learning_rate),
            initial_rate: Some(setup.config.optimizer.learning_rate),
            rng: SavedRng(ChaCha8Rng::seed_from_u64(setup.seed)),
            curriculum: Curriculum::new(setup.config.curriculum.clone(), setup.tasks.iter().cloned()),
            features: FeatureMoments::default(),
            n_feature_scenes: 0,
            values: ValueStatistics::default(),
            mailbox: MailboxCounts::default(),
            normalization: Normalization::default(),
        };
        let mailbox = Arc::new(Mailbox::new(setup.config.mailbox.clone(), setup.admission()));
        let n_threads = setup.config.n_threads.unwrap_or_else(|| match setup.device {
            DeviceKind::Cpu => std::thread::available_parallelism().map_or(1, usize::from),
            DeviceKind::Gpu => 1,
        });
        let ppo = Ppo::new(&setup.policy, setup.seed, &device, n_threads);
        let n_parameters = ppo.parameters().len();
        if n_parameters > MAX_PARAMETERS {
            return Err(LearnerError::TooLarge(n_parameters));
        }
        let tried = Policy::new(&setup.policy);
        let mut learner = Self { ppo, state, mailbox, n_unmade: 0, tried, n_refused: 0, setup };
        if let Some(model) = learner.setup.init.clone() {
            learner.start_from(&model)?;
        }
        Ok(learner)
    }

    /// Copies the parameters and statistics of a policy.
    fn start_from(&mut self, model: &Model) -> Result<(), LearnerError> {
        let mut theirs = PolicyConfig::clone(&model.policy);
        theirs.network.init_std = self.setup.policy.network.init_std;
        if let Some(difference) = self.setup.policy.network_difference(&theirs) {
            return Err(LearnerError::Init(difference.between("there", "in this run")));
        }
        let unfit = |error: &dyn std::fmt::Display| LearnerError::Init(error.to_string());
        // Checks the numbers; the parameters' names and order are checked below.
        Policy::with_weights(&model.policy, &model.weights).map_err(|error| unfit(&error))?;
        if model.table != self.ppo.table() {
            return Err(unfit(&"it has other parameters, or the same in another order"));
        }
        let Weights { parameters, normalization, .. } = &model.weights;
        let adam = Adam::new(parameters.len());
        self.ppo.restore(parameters.clone(), adam).map_err(|error| unfit(&error))?;
        self.state.values = ValueStatistics::new(normalization.value_mean, normalization.value_std);
        if normalization.feature_mean.iter().any(|means| !means.is_empty()) {
            // A model file contains no moments, so freeze its statistics.
            self.state.n_feature_scenes = u64::MAX;
        }
        self.state.normalization = normalization.clone();
        Ok(())
    }

    /// Resumes from `checkpoint`. The settings may have changed since, except those of the network, its features, and
    /// the training blueprints.
    ///
    /// # Errors
    /// Those of [`Learner::new`], [`CheckpointError::Mismatch`], and [`LearnerError::Weights`].
    pub fn resume(setup: LearnerSetup, checkpoint: Checkpoint) -> Result<Self, LearnerError> {
        let mut learner = Self::new(setup)?;
        let mismatch = |reason: &str| Err(CheckpointError::Mismatch(reason.to_owned()).into());
        if let Some(difference) = learner.setup.policy.network_difference(&checkpoint.model) {
            return mismatch(&difference.between("there", "in this run"));
        }
        if checkpoint.table != learner.ppo.table() {
            return mismatch("the network has other parameters");
        }
        let tasks = |state: &LearnerState| state.curriculum.tasks().keys().cloned().collect::<Vec<_>>();
        if tasks(&checkpoint.state) != tasks(&learner.state) {
            return mismatch("the training blueprints are others");
        }
        // Other settings of the policy may have changed.
        learner.tried.load(&Weights { settings: learner.setup.settings.clone(), ..checkpoint.weights() })?;
        let n_parameters = learner.ppo.parameters().len();
        if checkpoint.adam.first.len() != n_parameters || checkpoint.adam.second.len() != n_parameters {
            return mismatch("the optimizer has other parameters");
        }
        if let Err(error) = learner.ppo.restore(checkpoint.parameters, checkpoint.adam) {
            return mismatch(&error.to_string());
        }
        let Checkpoint { state, mailbox, .. } = checkpoint;
        learner.mailbox.restore(state.version, state.mailbox, mailbox);
        let initial_rate = learner.state.initial_rate;
        let learning_rate = resumed_rate(&state, &learner.setup.config.optimizer);
        let curriculum = learner.state.curriculum.with_state_of(state.curriculum);
        learner.state = LearnerState { curriculum, learning_rate, initial_rate, ..state };
        Ok(learner)
    }

    /// Returns the mailbox, which other threads fill.
    pub fn mailbox(&self) -> Arc<Mailbox> {
        self.mailbox.clone()
    }

    /// Records how episodes ended.
    pub(crate) fn record(&mut self, trajectories: &[Trajectory]) {
        for trajectory in trajectories {
            if let Some(stats) = &trajectory.episode_stats {
                self.state.curriculum.record(&trajectory.task.blueprint, stats.success);
            }
        }
    }

    /// Returns why the weights of an update are of no use; `None` if policies can act with them.
    pub(crate) fn refusal(&mut self, ppo: &PpoMetrics, batch: &Batch) -> Option<String> {
        if ppo.n_skipped_steps > 0 && ppo.n_gradient_steps == 0 {
            return Some("no gradient was finite".to_owned());
        }
        let weights = self.weights();
        trial::act(&weights, &mut self.tried, &batch.segments).err().map(|error| error.to_string())
    }

    /// Takes an update back. Its randomness is used up, so that the next one draws other minibatches, and an adaptive
    /// learning rate shrinks.
    pub(crate) fn take_back(&mut self, ((parameters, adam), state): (Trained, LearnerState)) {
        self.ppo.restore(parameters, adam).expect("these parameters were in use before");
        let mut learning_rate = state.learning_rate;
        if let LrSchedule::Adaptive(rule) = &self.setup.config.optimizer.lr_schedule {
            learning_rate = learning_rate.adapted(f32::INFINITY, rule);
        }
        let refused = std::mem::replace(&mut self.state, LearnerState { learning_rate, ..state });
        self.state.rng = refused.rng;
        self.n_refused += 1;
    }

    /// Counts an update, and tells the mailbox of its weights.
    pub(crate) fn count(&mut self, n_steps: u64, n_episodes: u64, batch: &Batch) {
        self.n_unmade += batch.n_refused as u64;
        self.state.n_updates += 1;
        self.state.n_env_steps += n_steps;
        self.state.n_episodes += n_episodes;
        self.mailbox.set_version(self.state.version);
    }

    /// Returns the newest weights.
    pub fn weights(&self) -> Weights {
        let settings = self.setup.settings.clone();
        self.state.weights(self.setup.policy.hash(), settings, self.ppo.parameters().to_vec())
    }

    /// Returns the version of the newest weights.
    pub fn version(&self) -> WeightsVersion {
        self.state.version
    }

    /// Returns the number of updates so far.
    pub fn n_updates(&self) -> u64 {
        self.state.n_updates
    }

    /// Returns the number of environment steps so far.
    pub fn n_env_steps(&self) -> u64 {
        self.state.n_env_steps
    }

    /// Returns everything needed to resume.
    pub fn checkpoint(&self) -> Checkpoint {
        let (counts, mailbox) = self.mailbox.snapshot();
        let (parameters, adam) = self.ppo.trained();
        Checkpoint {
            state: LearnerState { mailbox: counts, ..self.state.clone() },
            model: self.setup.policy.clone(),
            settings: self.setup.settings.clone(),
            table: self.ppo.table().to_vec(),
            parameters,
            adam,
            mailbox,
        }
    }

    /// Returns the feature statistics updated with the raw features of a batch, and its number of scenes; `None` if the
    /// statistics are frozen.
    pub(crate) fn statistics_after(&self, batch: &Batch) -> Option<(FeatureMoments, usize)> {
        let is_moving = self.setup.config.normalization.features && self.state.n_feature_scenes < N_FEATURE_SCENES;
        is_moving.then(|| {
            let mut moments = self.state.features.clone();
            moments.push(&batch.features);
            (moments, batch.features.n)
        })
    }

    /// Applies new statistics to the next weights.
    pub(crate) fn adopt(&mut self, statistics: Option<(FeatureMoments, usize)>) {
        if let Some((features, n_scenes)) = statistics {
            features.freeze_into(&mut self.state.normalization);
            self.state.features = features;
            self.state.n_feature_scenes += n_scenes as u64;
        }
        self.state.normalization.value_mean = self.state.values.mean as f32;
        self.state.normalization.value_std = self.state.values.std as f32;
    }
}

/// Returns the learning rate of a resumed run: another initial rate takes effect, and so do other bounds.
fn resumed_rate(saved: &LearnerState, config: &OptimizerConfig) -> LearningRate {
    let is_new = saved.initial_rate.is_some_and(|rate| rate != config.learning_rate);
    match &config.lr_schedule {
        _ if is_new => LearningRate(config.learning_rate),
        LrSchedule::Adaptive(rule) => LearningRate(saved.learning_rate.0.clamp(rule.min, rule.max)),
        LrSchedule::Fixed(_) | LrSchedule::Line(_) => saved.learning_rate,
    }
}
