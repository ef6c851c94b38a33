//! Proposals as arrays, and actions that pick among them.
//!
//! A *pick* is the number of a block's proposal among all of a world: block · [`N_SLOTS`] + slot.

use blueprints::{BlockIdx, N_BLOCKS};
use numpy::{IntoPyArray, PyArray3, PyArray4, PyArrayMethods, PyReadonlyArray2, PyUntypedArrayMethods};
use policy::distribution::unit_normal;
use policy::proposals::{N_RELATION, N_SLOTS, Slot};
use proto::{Action, N_GRIPPERS};
use pyo3::exceptions::PyValueError;
use pyo3::{Bound, PyResult, Python};

use crate::row::Row;

/// Number of picks of a world.
pub(crate) const N_PICKS: usize = N_BLOCKS * N_SLOTS;

/// Whether a slot is offered `[n, 16, 33]`, the moves `[n, 16, 33, 6]`, their noise `[n, 16, 33]`, and the relations
/// `[n, 16, 16, 8]`.
pub(crate) type ProposalArrays<'py> =
    (Bound<'py, PyArray3<bool>>, Bound<'py, PyArray4<f32>>, Bound<'py, PyArray3<f32>>, Bound<'py, PyArray4<f32>>);

/// One gripper's pick.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pick {
    block: BlockIdx,
    slot: Slot,
}

/// Copies the proposals of worlds, which have been made.
pub(crate) fn arrays<'py>(py: Python<'py>, rows: &mut [Row]) -> PyResult<ProposalArrays<'py>> {
    let n = rows.len();
    let mut offered = vec![false; n * N_BLOCKS * N_SLOTS];
    let mut moves = vec![0.0; offered.len() * 6];
    let mut noise = vec![0.0; offered.len()];
    let mut relations = Vec::with_capacity(n * N_BLOCKS * N_BLOCKS * N_RELATION);
    for (row, world) in rows.iter_mut().enumerate() {
        let proposals = world.proposals();
        for block in BlockIdx::all() {
            for proposal in proposals.slots(block).iter().filter_map(|&slot| proposals.get(block, slot)) {
                let at = (row * N_BLOCKS + block.get()) * N_SLOTS + usize::from(proposal.slot.index());
                offered[at] = true;
                moves[at * 6..(at + 1) * 6].copy_from_slice(&proposal.movement);
                noise[at] = proposal.noise();
            }
            BlockIdx::all().for_each(|other| relations.extend(proposals.relation(block, other)));
        }
    }
    Ok((
        offered.into_pyarray(py).reshape([n, N_BLOCKS, N_SLOTS])?,
        moves.into_pyarray(py).reshape([n, N_BLOCKS, N_SLOTS, 6])?,
        noise.into_pyarray(py).reshape([n, N_BLOCKS, N_SLOTS])?,
        relations.into_pyarray(py).reshape([n, N_BLOCKS, N_BLOCKS, N_RELATION])?,
    ))
}

/// Returns which picks a world offers: in a masked one, only those of allowed blocks.
pub(crate) fn offered(row: &mut Row, is_masked: bool) -> [bool; N_PICKS] {
    let allowed = if is_masked { row.allowed() } else { [true; N_BLOCKS] };
    let proposals = row.proposals();
    let mut offered = [false; N_PICKS];
    for block in BlockIdx::all().filter(|block| allowed[block.get()]) {
        for slot in proposals.slots(block) {
            offered[block.get() * N_SLOTS + usize::from(slot.index())] = true;
        }
    }
    offered
}

/// Converts an array to picks.
pub(crate) fn picks(
    picks: &PyReadonlyArray2<'_, i64>,
    n: usize,
    n_grippers: usize,
) -> PyResult<Vec<[Option<Pick>; N_GRIPPERS]>> {
    let wanted = [n, n_grippers];
    if picks.shape() != wanted {
        return Err(PyValueError::new_err(format!("picks has shape {:?}: expected {wanted:?}", picks.shape())));
    }
    let mut all = Vec::with_capacity(n);
    for (row, picks) in picks.as_slice()?.chunks_exact(n_grippers).enumerate() {
        let mut made = [None; N_GRIPPERS];
        for (gripper, &number) in picks.iter().enumerate() {
            let refused = || {
                let last = N_PICKS - 1;
                PyValueError::new_err(format!("picks[{row}, {gripper}] is {number}: expected a pick from 0 to {last}"))
            };
            made[gripper] = Some(pick(number).ok_or_else(refused)?);
        }
        all.push(made);
    }
    Ok(all)
}

fn pick(number: i64) -> Option<Pick> {
    let number = usize::try_from(number).ok()?;
    let block = BlockIdx::try_from(u8::try_from(number / N_SLOTS).ok()?).ok()?;
    Some(Pick { block, slot: Slot::from_index((number % N_SLOTS) as u8)? })
}

/// Returns the action of picks, with noise from the world's generator. What is not offered leaves its block where it is,
/// and where two grippers pick the same block, the first one's proposal moves it.
pub(crate) fn action(row: &mut Row, picks: &[Option<Pick>; N_GRIPPERS], is_noisy: bool, is_masked: bool) -> Action {
    let allowed = if is_masked { row.allowed() } else { [true; N_BLOCKS] };
    let mut action = Action::IDLE;
    for (gripper, pick) in picks.iter().enumerate() {
        let Some(Pick { block, slot }) = *pick else { continue };
        let is_taken = action.choices[..gripper].contains(&Some(block));
        action.choices[gripper] = Some(block);
        if is_taken || !allowed[block.get()] {
            continue;
        }
        let Some(proposal) = row.proposals().get(block, slot) else { continue };
        let noise = if is_noisy { proposal.noise() } else { 0.0 };
        action.moves[block.get()] = proposal.movement.map(|mean| {
            let normal = if is_noisy { unit_normal(&mut row.noise.0) } else { 0.0 };
            (mean + noise * normal).clamp(-1.0, 1.0)
        });
    }
    action
}
