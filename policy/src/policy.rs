//! Inference with the newest weights, folded once, on batches of scenes.

mod attention;
mod trial;

use blueprints::{Catalog, N_BLOCKS};
use burn::tensor::Device;
use proto::{
    ActionMode, Agent, CanonicalSettings, Decision, N_GRIPPERS, Normalization, Observation, SettingsDifference, Valid,
    Weights, WeightsVersion,
};
use rand::rngs::ChaCha8Rng;

use crate::FeatureBatch;
use crate::config::{MoveHead, PolicyConfig};
use crate::cpu::Outputs;
use crate::distribution::{ActionDistribution, mask_logits};
use crate::engine::Engine;
use crate::mixture::{MixtureDistribution, N_READOUTS};
use crate::normalization::{self, normalize};
use crate::proposals::Slot;

pub use attention::Attention;

/// Why a policy or its weights are refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PolicyError {
    /// The weights are of a run with other settings of the policy or, for an actor, the world.
    #[error("weights {0} are of a run with other settings")]
    OtherSettings(WeightsVersion, #[source] SettingsDifference),
    /// The weights belong to another network.
    #[error("weights {0} are for network {1:016x}, this process runs {2:016x}")]
    OtherNetwork(WeightsVersion, u64, u64),
    /// The parameters or the normalization statistics do not fit.
    #[error("{0}")]
    Unfit(String),
    /// The output of a forward pass is not a distribution over actions, or not a value: the parameters are finite, but
    /// so large that sums overflow.
    #[error("{0}")]
    NoDistribution(String),
}

/// Checks that weights with the settings `theirs` are of a run with `own` settings, unless theirs are not known.
///
/// # Errors
/// [`PolicyError::OtherSettings`] with the first difference.
pub fn check_settings(
    version: WeightsVersion,
    theirs: &CanonicalSettings,
    own: &CanonicalSettings,
) -> Result<(), PolicyError> {
    match theirs.difference(own) {
        Some(difference) if !theirs.is_empty() => Err(PolicyError::OtherSettings(version, difference)),
        _ => Ok(()),
    }
}

impl PolicyError {
    /// Whether only these weights are at fault, so that a process can keep its previous weights and wait for better
    /// ones. Waiting does not help with weights of another network or an invalid configuration.
    pub fn is_of_weights(&self) -> bool {
        matches!(self, Self::Unfit(_) | Self::NoDistribution(_))
    }
}

/// Maximum magnitude of an output. Larger numbers could not be sent in a trajectory, and are far beyond the outputs of
/// any trained network.
const LARGEST_OUTPUT: f32 = 1e6;

/// A frozen policy on the CPU.
#[derive(Debug)]
pub struct Policy {
    config: Valid<PolicyConfig>,
    engine: Engine,
    normalization: Normalization,
    version: Option<WeightsVersion>,
    /// Kept to reuse its memory.
    batch: FeatureBatch,
}

impl Policy {
    /// Creates an untrained policy; its parameters are those of seed 0 until [`Policy::load`].
    pub fn new(config: &Valid<PolicyConfig>) -> Self {
        let engine = Engine::new(config, 0, &Device::flex(), false);
        let batch = FeatureBatch::of_policy(config);
        Self { config: config.clone(), engine, normalization: Normalization::default(), version: None, batch }
    }

    /// Creates a policy that acts with `weights`.
    ///
    /// # Errors
    /// Those of [`Policy::load`].
    pub fn with_weights(config: &Valid<PolicyConfig>, weights: &Weights) -> Result<Self, PolicyError> {
        let mut policy = Self::new(config);
        policy.load(weights)?;
        Ok(policy)
    }

    /// Returns the version of the loaded weights; `None` before the first.
    pub fn version(&self) -> Option<WeightsVersion> {
        self.version
    }

    /// Returns the configuration.
    pub fn config(&self) -> &PolicyConfig {
        &self.config
    }

    /// Loads new weights after testing them with a forward pass on a scene. After an error, the old weights stay in
    /// use.
    ///
    /// # Errors
    /// If the weights are of another network or of a policy with other settings, of the wrong length, not finite, or so
    /// large that they give no distribution.
    pub fn load(&mut self, weights: &Weights) -> Result<(), PolicyError> {
        let version = weights.version;
        let own = CanonicalSettings::default().with("policy", &*self.config);
        check_settings(version, &weights.settings.section("policy"), &own)?;
        let expected = self.config.hash();
        if weights.network_hash != expected {
            return Err(PolicyError::OtherNetwork(version, weights.network_hash, expected));
        }
        let sizes = self.config.sizes();
        normalization::check("normalization", &weights.normalization, [sizes.node, sizes.edge, sizes.global])
            .map_err(|error| PolicyError::Unfit(format!("weights {version} have {error}")))?;
        let engine = self
            .engine
            .with(&weights.parameters)
            .map_err(|error| PolicyError::Unfit(format!("weights {version} do not fit: {error}")))?;
        let mut tried = Self {
            config: self.config.clone(),
            engine,
            normalization: weights.normalization.clone(),
            version: Some(version),
            batch: FeatureBatch::of_policy(&self.config),
        };
        if let Some(blueprint) = Catalog::builtin().iter().next() {
            let mut batch = FeatureBatch::of_policy(&self.config);
            batch.push(&Observation { scene: &trial::scene(blueprint), blueprint });
            tried.forward(&mut batch)?;
        }
        *self = tried;
        Ok(())
    }

    /// Acts like [`Agent::act`], but on features, which must be those that [`FeatureBatch::push`] writes, including
    /// `allowed`. Normalizes the features in place.
    ///
    /// # Errors
    /// [`PolicyError::NoDistribution`] if the forward pass gives no distribution for one of the rows.
    ///
    /// # Panics
    /// If the number of generators or modes differs from the number of rows, the features have other sizes, or the batch
    /// is not one of [`FeatureBatch::of_policy`].
    pub fn act_on(
        &mut self,
        batch: &mut FeatureBatch,
        modes: &[ActionMode],
        rngs: &mut [ChaCha8Rng],
    ) -> Result<Vec<Decision>, PolicyError> {
        assert_eq!((rngs.len(), modes.len()), (batch.n, batch.n), "one generator and one mode per row");
        let is_mixture = self.config.network.move_head == MoveHead::Mixture;
        assert_eq!(batch.proposals.len(), if is_mixture { batch.n } else { 0 }, "proposals for the mixture head alone");
        let mut output = self.forward(batch)?;
        let per_scene = output.logits.len() / batch.n.max(1);
        let mut decisions = Vec::with_capacity(batch.n);
        for (row, (rng, mode)) in rngs.iter_mut().zip(modes).enumerate() {
            let logits = &mut output.logits[row * per_scene..(row + 1) * per_scene];
            if let Some(allowed) = self.config.choosable(batch, row) {
                mask_logits(logits, &allowed);
            }
            let no_choice = || self.no_distribution("a logit", f32::NAN);
            let (action, proposals, log_prob) = if let Some(proposals) = batch.proposals.get(row) {
                let readouts = &output.readouts[row * N_BLOCKS * N_READOUTS..][..N_BLOCKS * N_READOUTS];
                let distribution = MixtureDistribution { logits, readouts, proposals };
                let drawn = distribution.act(*mode, rng).ok_or_else(no_choice)?;
                (drawn.action, drawn.slots.map(|slot| slot.map(Slot::index)), drawn.log_prob)
            } else {
                let [locs, scales] = [&output.locs, &output.scales].map(|of| &of[row * 96..(row + 1) * 96]);
                let distribution = ActionDistribution::new(logits, locs, scales);
                let action = match mode {
                    ActionMode::Sampled => distribution.sample(rng).ok_or_else(no_choice)?,
                    ActionMode::Greedy => distribution.mode(),
                };
                let log_prob = distribution.log_prob(&action);
                (action, [None; N_GRIPPERS], log_prob)
            };
            self.check("a log-probability", &[log_prob])?;
            decisions.push(Decision { action, proposals, log_prob, value: output.values[row] });
        }
        Ok(decisions)
    }

    fn forward(&mut self, batch: &mut FeatureBatch) -> Result<Outputs, PolicyError> {
        if batch.n == 0 {
            return Ok(Outputs::default());
        }
        normalize(batch, &self.normalization);
        let rows: Vec<usize> = (0..batch.n).collect();
        let mut output = self.engine.run(batch, &rows);
        let Normalization { value_mean, value_std, .. } = self.normalization;
        output.values.iter_mut().for_each(|v| *v = *v * value_std + value_mean);
        for (name, numbers) in [
            ("a logit", &output.logits),
            ("a mean move", &output.locs),
            ("a deviation of a move", &output.scales),
            ("a read-out", &output.readouts),
            ("a value", &output.values),
        ] {
            self.check(name, numbers)?;
        }
        Ok(output)
    }

    fn check(&self, output: &'static str, numbers: &[f32]) -> Result<(), PolicyError> {
        // No range contains NaN.
        let odd = numbers.iter().copied().find(|x| !(-LARGEST_OUTPUT..=LARGEST_OUTPUT).contains(x));
        odd.map_or(Ok(()), |value| Err(self.no_distribution(output, value)))
    }

    fn no_distribution(&self, output: &'static str, value: f32) -> PolicyError {
        PolicyError::NoDistribution(format!(
            "{} give {output} = {value} for a scene, must be a number in −1e6..=1e6",
            self.version.map_or_else(|| "untrained weights".to_owned(), |version| format!("weights {version}"))
        ))
    }
}

impl Agent for Policy {
    type Error = PolicyError;

    /// Returns [`PolicyError::NoDistribution`] if the forward pass gives no distribution for one of the scenes.
    ///
    /// # Panics
    /// If the number of generators or modes differs from the number of observations.
    fn act(
        &mut self,
        observations: &[Observation<'_>],
        modes: &[ActionMode],
        rngs: &mut [ChaCha8Rng],
    ) -> Result<Vec<Decision>, PolicyError> {
        let mut batch = std::mem::replace(&mut self.batch, FeatureBatch::of_policy(&self.config));
        batch.fill(observations);
        let decisions = self.act_on(&mut batch, modes, rngs);
        self.batch = batch;
        decisions
    }
}
