//! Weights, and notices of newer weights.

use std::collections::BTreeMap;

use prost::Message;

use super::check::{LARGEST_MAGNITUDE, blueprint_id, ensure, number, positive, present, settings};
use super::{Bytes, DecodeError, MAX_SMALL_BYTES, PROTOCOL_VERSION, check_version, parse};
use crate::{Normalization, Weights, WeightsVersion, wire};

/// Number of parameters checked at a time.
const BLOCK: usize = 1024;

/// Maximum number of network parameters. The largest network in a preset, a residual network on all features, has 20
/// million.
pub const MAX_PARAMETERS: usize = 24 << 20;

/// Maximum size of encoded weights, in bytes: the parameters and 1 MiB for the rest.
pub const MAX_WEIGHTS_BYTES: usize = 4 * MAX_PARAMETERS + (1 << 20);

/// Tolerance of the task probabilities' sum: rounding of a few hundred f32 terms.
const SUM_TOLERANCE: f64 = 1e-3;

/// A notice that newer weights can be pulled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WeightsNotice {
    /// Start time of the learner process, ms since 1970. A learner that resumes an older checkpoint continues from that
    /// checkpoint's version, so versions are comparable only within one epoch.
    pub epoch: u64,
    /// The newest version.
    pub version: WeightsVersion,
}

/// Weights and the learner process that published them.
#[derive(Clone, Debug, PartialEq)]
pub struct PublishedWeights {
    /// Start time of the learner process, ms since 1970.
    pub epoch: u64,
    /// The weights.
    pub weights: Weights,
}

/// Encodes weights published by the learner process that started at `epoch`.
pub fn encode_weights(weights: &Weights, epoch: u64) -> Vec<u8> {
    let statistics = |i: usize| {
        Some(wire::FeatureStatistics {
            mean: weights.normalization.feature_mean[i].clone(),
            std: weights.normalization.feature_std[i].clone(),
        })
    };
    wire::Weights {
        protocol_version: PROTOCOL_VERSION,
        epoch,
        version: weights.version.0,
        n_env_steps: weights.n_env_steps,
        network_hash: weights.network_hash,
        settings: weights.settings.to_string(),
        parameters: parameters_to_wire(&weights.parameters),
        normalization: Some(wire::Normalization {
            nodes: statistics(0),
            edges: statistics(1),
            globals: statistics(2),
            value_mean: weights.normalization.value_mean,
            value_std: weights.normalization.value_std,
        }),
        task_probabilities: weights
            .task_probabilities
            .iter()
            .map(|(id, &probability)| wire::TaskProbability { blueprint: id.to_string(), probability })
            .collect(),
    }
    .encode_to_vec()
}

/// Decodes weights and checks every rule that [`Weights`] documents. The parameters are copied once.
///
/// # Errors
/// The error names the first field that breaks a rule, and its value.
pub fn decode_weights(bytes: Bytes) -> Result<PublishedWeights, DecodeError> {
    let message: wire::Weights = parse("Weights", bytes, MAX_WEIGHTS_BYTES)?;
    check_version(message.protocol_version)?;
    let weights = Weights {
        version: WeightsVersion(message.version),
        n_env_steps: message.n_env_steps,
        network_hash: message.network_hash,
        parameters: parameters_from_wire(&message.parameters)?,
        settings: settings(&message.settings)?,
        normalization: normalization_from_wire(present("normalization", message.normalization)?)?,
        task_probabilities: probabilities_from_wire(message.task_probabilities)?,
    };
    Ok(PublishedWeights { epoch: message.epoch, weights })
}

fn parameters_to_wire(parameters: &[f32]) -> Bytes {
    let mut bytes = vec![0; 4 * parameters.len()];
    let places = bytes.as_chunks_mut::<4>().0;
    places.iter_mut().zip(parameters).for_each(|(place, parameter)| *place = parameter.to_le_bytes());
    bytes.into()
}

fn parameters_from_wire(bytes: &[u8]) -> Result<Vec<f32>, DecodeError> {
    let (places, rest) = bytes.as_chunks::<4>();
    ensure(rest.is_empty(), "parameters", format_args!("{} bytes", bytes.len()), "four bytes per value")?;
    let is_valid = (1..=MAX_PARAMETERS).contains(&places.len());
    ensure(is_valid, "parameters", format_args!("{} values", places.len()), "1 to 25165824 values")?;
    let parameters: Vec<f32> = places.iter().map(|place| f32::from_le_bytes(*place)).collect();
    for block in parameters.chunks(BLOCK) {
        // Without an early exit, checking a block takes a few instructions per 16 values.
        if !block.iter().fold(true, |all, parameter| all & (parameter.abs() <= LARGEST_MAGNITUDE)) {
            block.iter().try_for_each(|&parameter| number("parameters", parameter).map(drop))?;
        }
    }
    Ok(parameters)
}

/// Encodes a notice.
pub fn encode_notice(notice: WeightsNotice) -> Vec<u8> {
    wire::WeightsNotice { protocol_version: PROTOCOL_VERSION, epoch: notice.epoch, version: notice.version.0 }
        .encode_to_vec()
}

/// Decodes a notice.
///
/// # Errors
/// If the bytes are not a notice of this protocol version.
///
/// # Example
/// ```
/// use proto::WeightsVersion;
/// use proto::codec::{WeightsNotice, decode_notice, encode_notice};
///
/// let notice = WeightsNotice { epoch: 77, version: WeightsVersion(300) };
/// assert_eq!(decode_notice(&encode_notice(notice)).expect("it was just written"), notice);
/// // Bytes from outside are an error, never a panic.
/// assert!(decode_notice(b"not a message").is_err());
/// ```
pub fn decode_notice(bytes: &[u8]) -> Result<WeightsNotice, DecodeError> {
    let notice: wire::WeightsNotice = parse("WeightsNotice", bytes, MAX_SMALL_BYTES)?;
    check_version(notice.protocol_version)?;
    Ok(WeightsNotice { epoch: notice.epoch, version: WeightsVersion(notice.version) })
}

fn normalization_from_wire(message: wire::Normalization) -> Result<Normalization, DecodeError> {
    let (node_mean, node_std) = statistics_from_wire(present("normalization.nodes", message.nodes)?)?;
    let (edge_mean, edge_std) = statistics_from_wire(present("normalization.edges", message.edges)?)?;
    let (global_mean, global_std) = statistics_from_wire(present("normalization.globals", message.globals)?)?;
    Ok(Normalization {
        feature_mean: [node_mean, edge_mean, global_mean],
        feature_std: [node_std, edge_std, global_std],
        value_mean: number("normalization.value_mean", message.value_mean)?,
        value_std: positive("normalization.value_std", message.value_std)?,
    })
}

fn statistics_from_wire(message: wire::FeatureStatistics) -> Result<(Vec<f32>, Vec<f32>), DecodeError> {
    let wire::FeatureStatistics { mean, std } = message;
    let n_std = format_args!("{} values", std.len());
    ensure(mean.len() == std.len(), "normalization.std", n_std, "as many as the means")?;
    mean.iter().try_for_each(|&m| number("normalization.mean", m).map(drop))?;
    std.iter().try_for_each(|&s| positive("normalization.std", s).map(drop))?;
    Ok((mean, std))
}

fn probabilities_from_wire(
    message: Vec<wire::TaskProbability>,
) -> Result<BTreeMap<blueprints::BlueprintId, f32>, DecodeError> {
    let mut probabilities = BTreeMap::new();
    let mut sum = 0.0;
    for wire::TaskProbability { blueprint, probability: p } in message {
        let id = blueprint_id("task_probabilities.blueprint", blueprint)?;
        ensure((0.0..=1.0).contains(&p), "task_probabilities.probability", p, "a number in 0..=1")?;
        sum += f64::from(p);
        let is_new = probabilities.insert(id.clone(), p).is_none();
        ensure(is_new, "task_probabilities.blueprint", id, "each blueprint once")?;
    }
    let is_one = (sum - 1.0).abs() <= SUM_TOLERANCE;
    ensure(is_one, "task_probabilities", format_args!("a sum of {sum}"), "a sum of 1")?;
    Ok(probabilities)
}
