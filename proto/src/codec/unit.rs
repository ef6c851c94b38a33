//! Evaluation units and the answers to them.

use prost::Message;

use super::check::{invalid, narrow, present, settings};
use super::error::DecodeError;
use super::scene::{reward_from_wire, reward_to_wire};
use super::trajectory::{task_from_wire, task_to_wire};
use super::weights::{MAX_WEIGHTS_BYTES, weights_from_wire, weights_to_wire};
use super::{PROTOCOL_VERSION, check_size, check_version, elements, parse};
use crate::unit::{End, EvalAnswer, EvalEpisode, EvalUnit, MAX_UNIT_SEQUENCES, PassId};
use crate::wire;

/// Maximum size of an encoded unit, in bytes: the weights, plus tasks of 100 bytes each.
pub const MAX_UNIT_BYTES: usize = MAX_WEIGHTS_BYTES + MAX_ANSWER_BYTES;

/// Maximum size of an encoded answer, in bytes; the 10 000 episodes of a large unit take less than 1 MiB.
const MAX_ANSWER_BYTES: usize = 8 << 20;

/// Maximum length of a refusal's reason, in characters.
const MAX_REFUSAL_CHARS: usize = 500;

/// Number of the field `sequences` of `EvalUnit`.
const SEQUENCES: u32 = 7;

/// Number of the field `tasks` of `EvalLane`.
const TASKS: u32 = 1;

/// Encodes a unit.
pub fn encode_unit(unit: &EvalUnit) -> Vec<u8> {
    let sequence = |tasks: &Vec<_>| wire::EvalLane { tasks: tasks.iter().map(task_to_wire).collect() };
    wire::EvalUnit {
        protocol_version: PROTOCOL_VERSION,
        settings: unit.settings.to_string(),
        epoch: unit.pass.epoch,
        pass: unit.pass.number,
        weights: unit.weights.as_ref().map(|weights| weights_to_wire(weights, unit.pass.epoch)),
        sampled: unit.is_sampled,
        sequences: unit.sequences.iter().map(sequence).collect(),
    }
    .encode_to_vec()
}

/// Decodes a unit and checks every rule that [`EvalUnit`] documents.
///
/// # Errors
/// The error names the first field that breaks a rule, and its value.
pub fn decode_unit(bytes: &[u8]) -> Result<EvalUnit, DecodeError> {
    check_size("EvalUnit", bytes.len(), MAX_UNIT_BYTES)?;
    let limit = (MAX_UNIT_SEQUENCES, "1 to 1000");
    for sequence in elements("EvalUnit", ("sequences", SEQUENCES), bytes, limit)? {
        elements("EvalUnit", ("sequences.tasks", TASKS), sequence, limit)?;
    }
    let message: wire::EvalUnit = parse("EvalUnit", bytes, MAX_UNIT_BYTES)?;
    check_version(message.protocol_version)?;
    check_count("sequences", message.sequences.len())?;
    let sequence = |sequence: wire::EvalLane| {
        check_count("sequences.tasks", sequence.tasks.len())?;
        sequence.tasks.into_iter().map(task_from_wire).collect()
    };
    Ok(EvalUnit {
        settings: settings(&message.settings)?,
        pass: PassId { epoch: message.epoch, number: message.pass },
        weights: message.weights.map(weights_from_wire).transpose()?.map(|published| published.weights),
        is_sampled: message.sampled,
        sequences: message.sequences.into_iter().map(sequence).collect::<Result<_, _>>()?,
    })
}

/// Encodes an answer.
pub fn encode_answer(answer: &EvalAnswer) -> Vec<u8> {
    use wire::eval_answer::Answer;
    let sequence = |episodes: &Vec<EvalEpisode>| wire::EvalLaneEpisodes {
        episodes: episodes.iter().map(episode_to_wire).collect(),
    };
    let answer = match answer {
        EvalAnswer::Episodes(sequences) => {
            Answer::Episodes(wire::EvalEpisodes { sequences: sequences.iter().map(sequence).collect() })
        }
        EvalAnswer::NeedsWeights => Answer::NeedsWeights(wire::NeedsWeights {}),
        EvalAnswer::Refused(why) => Answer::Refusal(why.chars().take(MAX_REFUSAL_CHARS).collect()),
    };
    wire::EvalAnswer { protocol_version: PROTOCOL_VERSION, answer: Some(answer) }.encode_to_vec()
}

/// Decodes an answer and checks every rule that [`EvalAnswer`] documents, except that its shape must match the unit.
///
/// # Errors
/// The error names the first field that breaks a rule, and its value.
pub fn decode_answer(bytes: &[u8]) -> Result<EvalAnswer, DecodeError> {
    use wire::eval_answer::Answer;
    let message: wire::EvalAnswer = parse("EvalAnswer", bytes, MAX_ANSWER_BYTES)?;
    check_version(message.protocol_version)?;
    Ok(match present("answer", message.answer)? {
        Answer::Episodes(wire::EvalEpisodes { sequences }) => {
            let sequence =
                |sequence: wire::EvalLaneEpisodes| sequence.episodes.into_iter().map(episode_from_wire).collect();
            EvalAnswer::Episodes(sequences.into_iter().map(sequence).collect::<Result<_, _>>()?)
        }
        Answer::NeedsWeights(wire::NeedsWeights {}) => EvalAnswer::NeedsWeights,
        Answer::Refusal(why) => EvalAnswer::Refused(why.chars().take(MAX_REFUSAL_CHARS).collect()),
    })
}

fn check_count(field: &'static str, n: usize) -> Result<(), DecodeError> {
    if (1..=MAX_UNIT_SEQUENCES).contains(&n) { Ok(()) } else { Err(invalid(field, n, "1 to 1000")) }
}

fn episode_to_wire(episode: &EvalEpisode) -> wire::EvalEpisode {
    use wire::eval_episode::End as WireEnd;
    let end = match episode.end {
        End::Success { stable } => WireEnd::Success(stable),
        End::TimeLimit => WireEnd::TimeLimit(wire::TimeLimit {}),
        End::Diverged => WireEnd::Diverged(wire::Diverged {}),
    };
    wire::EvalEpisode {
        end: Some(end),
        n_steps: episode.n_steps.into(),
        episode_return: Some(reward_to_wire(&episode.episode_return)),
        forced_reset: episode.forced_reset,
    }
}

fn episode_from_wire(episode: wire::EvalEpisode) -> Result<EvalEpisode, DecodeError> {
    use wire::eval_episode::End as WireEnd;
    let n_steps = narrow("episode.n_steps", episode.n_steps, "a number in 1..=65535")?;
    if n_steps == 0 {
        return Err(invalid("episode.n_steps", n_steps, "a number in 1..=65535"));
    }
    let end = match present("episode.end", episode.end)? {
        WireEnd::Success(stable) => End::Success { stable },
        WireEnd::TimeLimit(wire::TimeLimit {}) => End::TimeLimit,
        WireEnd::Diverged(wire::Diverged {}) => End::Diverged,
    };
    let episode_return = reward_from_wire(present("episode.episode_return", episode.episode_return)?)?;
    Ok(EvalEpisode { end, n_steps, episode_return, forced_reset: episode.forced_reset })
}
