//! A trajectory as columns, one row per scene.
//!
//! | column | meaning |
//! |---|---|
//! | `observations` | `nodes`, `edges`, and `globals` of the scene |
//! | `actions` | `choices` and `moves`; the last row is padded with 0 |
//! | `rewards` | the sum of the terms; 0 in the last row |
//! | `terminations`, `truncations` | whether the step ended the episode, by success or by the time limit |
//! | `infos` | `is_success`, five `reward_terms`, and `blueprint`, as in the infos of the step that led to the scene |

use std::sync::Arc;

use arrow_array::{
    Array, ArrayRef, BooleanArray, FixedSizeListArray, Float32Array, Float64Array, Int64Array, PrimitiveArray,
};
use arrow_array::{RecordBatch, StringArray, StructArray};
use arrow_schema::{ArrowError, Field, FieldRef, Fields, Schema};
use blueprints::{Blueprint, BlueprintId};
use policy::features::write_features;
use proto::{Observation, RewardTerms, Scene, Status, Trajectory};

use crate::spaces::{N_MOVES, Spaces};

/// Number of reward terms, in the order of `REWARD_TERMS` in the Python package.
const N_TERMS: usize = 5;

/// Reasons why an episode cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum EpisodeError {
    /// The given blueprint is not the trajectory's goal.
    #[error("the goal is {expected}, not {given}")]
    OtherGoal {
        /// The trajectory's goal.
        expected: BlueprintId,
        /// The given blueprint.
        given: BlueprintId,
    },
    /// The trajectory is only part of an episode, or it diverged.
    #[error("the trajectory of {0} is no whole episode")]
    Part(BlueprintId),
    /// A column has too many numbers.
    #[error(transparent)]
    Arrow(#[from] ArrowError),
}

/// Converts an episode to rows.
///
/// # Errors
/// If the trajectory is not a complete, valid episode, or `goal` is not its blueprint.
pub fn columns(spaces: &Spaces, trajectory: &Trajectory, goal: &Blueprint) -> Result<RecordBatch, EpisodeError> {
    if *goal.id() != trajectory.task.blueprint {
        let (expected, given) = (trajectory.task.blueprint.clone(), goal.id().clone());
        return Err(EpisodeError::OtherGoal { expected, given });
    }
    if trajectory.first_step != 0 || trajectory.status == Status::Running {
        return Err(EpisodeError::Part(goal.id().clone()));
    }
    let goal = goal.permuted(&trajectory.task.assignment);
    let n_steps = trajectory.transitions.len();
    let is_last = |step: usize| step + 1 == n_steps;
    let ended = |status: Status| (0..=n_steps).map(move |step| is_last(step) && trajectory.status == status);
    let rewards = trajectory.transitions.iter().map(|step| f64::from(step.reward.total()));
    let columns: [(&str, ArrayRef); 6] = [
        ("observations", observations(spaces, trajectory, &goal)?),
        ("actions", actions(spaces, trajectory)?),
        ("rewards", Arc::new(rewards.chain([0.0]).collect::<Float64Array>())),
        ("terminations", Arc::new(ended(Status::Success).map(Some).collect::<BooleanArray>())),
        ("truncations", Arc::new(ended(Status::TimeLimit).map(Some).collect::<BooleanArray>())),
        ("infos", infos(trajectory)?),
    ];
    let fields: Vec<Field> =
        columns.iter().map(|(name, column)| Field::new(*name, column.data_type().clone(), true)).collect();
    let columns = columns.into_iter().map(|(_, column)| column).collect();
    Ok(RecordBatch::try_new(Arc::new(Schema::new(fields)), columns)?)
}

fn observations(spaces: &Spaces, trajectory: &Trajectory, goal: &Blueprint) -> Result<ArrayRef, EpisodeError> {
    let [n_nodes, n_edges, n_globals] = spaces.lengths();
    let n_rows = trajectory.transitions.len() + 1;
    let filled = |n: usize| vec![0.0; n_rows * n];
    let (mut nodes, mut edges, mut globals) = (filled(n_nodes), filled(n_edges), filled(n_globals));
    let rows = nodes.chunks_exact_mut(n_nodes).zip(edges.chunks_exact_mut(n_edges));
    let rows = rows.zip(globals.chunks_exact_mut(n_globals)).zip(scenes(trajectory)).zip(0..);
    for ((((nodes, edges), globals), scene), n_steps) in rows {
        let seen = Observation { scene, blueprint: goal, n_steps };
        write_features(&seen, &spaces.features, nodes, edges, globals);
    }
    table(vec![
        listed("edges", n_edges, Float32Array::from(edges))?,
        listed("globals", n_globals, Float32Array::from(globals))?,
        listed("nodes", n_nodes, Float32Array::from(nodes))?,
    ])
}

/// Returns all scenes, one more than there are steps.
fn scenes(trajectory: &Trajectory) -> impl Iterator<Item = &Scene> {
    trajectory.transitions.iter().map(|step| &step.scene).chain([&trajectory.last_scene])
}

fn actions(spaces: &Spaces, trajectory: &Trajectory) -> Result<ArrayRef, EpisodeError> {
    let n_grippers = spaces.n_grippers();
    let (mut choices, mut moves) = (Vec::new(), Vec::new());
    for step in &trajectory.transitions {
        // As in the Python package, an idle gripper chooses block 0.
        let number = |gripper: usize| step.action.choices[gripper].map_or(0, |block| i64::from(u8::from(block)));
        choices.extend((0..n_grippers).map(number));
        moves.extend(step.action.moves.as_flattened().iter().map(|x| x.clamp(-1.0, 1.0)));
    }
    let n_moves = blueprints::N_BLOCKS * N_MOVES;
    choices.resize(choices.len() + n_grippers, 0);
    moves.resize(moves.len() + n_moves, 0.0);
    table(vec![
        listed("choices", n_grippers, Int64Array::from(choices))?,
        listed("moves", n_moves, Float32Array::from(moves))?,
    ])
}

fn infos(trajectory: &Trajectory) -> Result<ArrayRef, EpisodeError> {
    let n_steps = trajectory.transitions.len();
    let succeeded = (0..=n_steps).map(|row| row == n_steps && trajectory.status == Status::Success);
    let terms = |reward: &RewardTerms| [reward.connected, reward.wrong, reward.magnets, reward.blocks, reward.force];
    let rewards = trajectory.transitions.iter().map(|step| &step.reward);
    let rewards: Vec<f32> = [&RewardTerms::default()].into_iter().chain(rewards).flat_map(terms).collect();
    let goals = (0..=n_steps).map(|_| Some(trajectory.task.blueprint.as_str()));
    let (terms, rewards) = listed("reward_terms", N_TERMS, Float32Array::from(rewards))?;
    // Minari uses this to distinguish an array from a list.
    let shape = [("shape", N_TERMS.to_string())];
    table(vec![
        named("blueprint", Arc::new(goals.collect::<StringArray>())),
        named("is_success", Arc::new(succeeded.map(Some).collect::<BooleanArray>())),
        (Arc::new(terms.as_ref().clone().with_metadata(shape)), rewards),
    ])
}

fn named(name: &str, column: ArrayRef) -> (FieldRef, ArrayRef) {
    (Arc::new(Field::new(name, column.data_type().clone(), true)), column)
}

/// Builds a column with `n` numbers in each row.
fn listed<T: arrow_array::types::ArrowPrimitiveType>(
    name: &str,
    n: usize,
    numbers: PrimitiveArray<T>,
) -> Result<(FieldRef, ArrayRef), EpisodeError> {
    let item = Arc::new(Field::new("item", T::DATA_TYPE, true));
    let n = i32::try_from(n).map_err(|error| ArrowError::from_external_error(Box::new(error)))?;
    let lists = FixedSizeListArray::try_new(item, n, Arc::new(numbers), None)?;
    Ok(named(name, Arc::new(lists)))
}

fn table(columns: Vec<(FieldRef, ArrayRef)>) -> Result<ArrayRef, EpisodeError> {
    let (fields, columns): (Vec<FieldRef>, Vec<ArrayRef>) = columns.into_iter().unzip();
    Ok(Arc::new(StructArray::try_new(Fields::from(fields), columns, None)?))
}
