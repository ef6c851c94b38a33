//! Splits arrays owned by Python into rows, and processes rows in parallel threads.

use std::sync::{Mutex, PoisonError};
use std::thread;

use blueprints::{BlockIdx, N_BLOCKS};
use numpy::{IntoPyArray, PyArray2, PyArray3, PyArrayDyn, PyArrayMethods, PyReadonlyArray2, PyReadonlyArray3};
use numpy::{PyReadwriteArrayDyn, PyUntypedArrayMethods};
use policy::FeatureSizes;
use policy::features::N_EDGES;
use proto::{Action, N_GRIPPERS};
use pyo3::exceptions::PyValueError;
use pyo3::{Bound, PyResult, Python};

use crate::row::Features;

/// An action in Python: choices `[n, grippers]` and moves `[n, 16, 6]`.
pub(crate) type ActionArrays<'py> = (Bound<'py, PyArray2<i64>>, Bound<'py, PyArray3<f32>>);

/// Returns the numbers of a world's features: nodes, edges, globals.
pub(crate) fn lengths(sizes: &FeatureSizes) -> [usize; 3] {
    [N_BLOCKS * sizes.node, N_EDGES * sizes.edge, sizes.global]
}

/// Borrows the arrays for the features of `n` worlds: three arrays, or one with all features of a world in a row.
pub(crate) fn hold<'py>(
    arrays: &[Bound<'py, PyArrayDyn<f32>>],
    sizes: &FeatureSizes,
    n: usize,
) -> PyResult<Vec<PyReadwriteArrayDyn<'py, f32>>> {
    let parts = lengths(sizes);
    let wanted: Vec<usize> = match arrays.len() {
        1 => vec![parts.iter().sum()],
        3 => parts.to_vec(),
        other => return Err(PyValueError::new_err(format!("features go to 1 or 3 arrays, not {other}"))),
    };
    for (array, length) in arrays.iter().zip(wanted) {
        if array.len() != n * length {
            let shape = array.shape();
            let text = format!("an array for features has shape {shape:?}: expected {n} × {length} entries");
            return Err(PyValueError::new_err(text));
        }
    }
    arrays.iter().map(|array| Ok(array.try_readwrite()?)).collect()
}

/// Splits the arrays returned by [`hold`] into rows.
pub(crate) fn rows<'a>(
    held: &'a mut [PyReadwriteArrayDyn<'_, f32>],
    sizes: &FeatureSizes,
) -> PyResult<Vec<Features<'a>>> {
    let [n_nodes, n_edges, n_globals] = lengths(sizes);
    let slices = held.iter_mut().map(|array| Ok(array.as_slice_mut()?)).collect::<PyResult<Vec<_>>>()?;
    let cut = |row: &'a mut [f32]| {
        let (nodes, rest) = row.split_at_mut(n_nodes);
        let (edges, globals) = rest.split_at_mut(n_edges);
        [nodes, edges, globals]
    };
    Ok(match <[&mut [f32]; 3]>::try_from(slices) {
        Ok([nodes, edges, globals]) => {
            let (nodes, edges) = (nodes.chunks_exact_mut(n_nodes), edges.chunks_exact_mut(n_edges));
            let parts = nodes.zip(edges).zip(globals.chunks_exact_mut(n_globals));
            parts.map(|((nodes, edges), globals)| [nodes, edges, globals]).collect()
        }
        Err(flat) => {
            let whole = flat.into_iter().flat_map(|flat| flat.chunks_exact_mut(n_nodes + n_edges + n_globals));
            whole.map(cut).collect()
        }
    })
}

/// Converts arrays to actions.
pub(crate) fn actions(
    choices: &PyReadonlyArray2<'_, i64>,
    moves: &PyReadonlyArray3<'_, f32>,
    n: usize,
    n_grippers: usize,
) -> PyResult<Vec<Action>> {
    for (name, shape, wanted) in
        [("choices", choices.shape(), &[n, n_grippers][..]), ("moves", moves.shape(), &[n, N_BLOCKS, 6][..])]
    {
        if shape != wanted {
            return Err(PyValueError::new_err(format!("{name} has shape {shape:?}: expected {wanted:?}")));
        }
    }
    let mut actions = Vec::with_capacity(n);
    let rows = choices.as_slice()?.chunks_exact(n_grippers).zip(moves.as_slice()?.chunks_exact(N_BLOCKS * 6));
    for (row, (choices, moves)) in rows.enumerate() {
        let mut action = Action::IDLE;
        for (gripper, &block) in choices.iter().enumerate() {
            let known = u8::try_from(block).ok().and_then(|block| BlockIdx::try_from(block).ok());
            let refused = || format!("choices[{row}, {gripper}] is {block}: expected a block from 0 to 15");
            action.choices[gripper] = Some(known.ok_or_else(|| PyValueError::new_err(refused()))?);
        }
        for (to, from) in action.moves.iter_mut().zip(moves.as_chunks::<6>().0) {
            *to = *from;
        }
        actions.push(action);
    }
    Ok(actions)
}

/// Converts actions to arrays. An idle gripper chooses block 0 with that block's move, which is zero.
pub(crate) fn action_arrays<'py>(
    py: Python<'py>,
    actions: &[Action],
    n_grippers: usize,
) -> PyResult<ActionArrays<'py>> {
    let number = |choice: &Option<BlockIdx>| choice.map_or(0, |block| i64::from(u8::from(block)));
    let grippers = n_grippers.min(N_GRIPPERS);
    let choices: Vec<i64> = actions.iter().flat_map(|action| action.choices[..grippers].iter().map(number)).collect();
    let moves: Vec<f32> = actions.iter().flat_map(|action| action.moves.as_flattened().iter().copied()).collect();
    let choices = choices.into_pyarray(py).reshape([actions.len(), grippers])?;
    Ok((choices, moves.into_pyarray(py).reshape([actions.len(), N_BLOCKS, 6])?))
}

/// Runs `work` on every job, using this thread and up to `n_threads - 1` others. Each thread takes the next job when it
/// is done, so that a long job does not delay the rest.
pub(crate) fn share<T: Send>(n_threads: usize, jobs: Vec<T>, work: impl Fn(T) + Sync) {
    let n_threads = n_threads.min(jobs.len());
    if n_threads <= 1 {
        jobs.into_iter().for_each(work);
        return;
    }
    let queue = Mutex::new(jobs.into_iter());
    let next = || queue.lock().unwrap_or_else(PoisonError::into_inner).next();
    let drain = || {
        while let Some(job) = next() {
            work(job);
        }
    };
    thread::scope(|scope| {
        for _ in 1..n_threads {
            // This thread works too, so that the others are not needed where the system gives none.
            if thread::Builder::new().spawn_scoped(scope, drain).is_err() {
                break;
            }
        }
        drain();
    });
}
