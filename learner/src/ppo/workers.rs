//! Worker threads that run the pieces of a batch through their own networks.

use std::sync::atomic::{AtomicUsize, Ordering};

use burn::tensor::Device;
use parking_lot::Mutex;
use policy::parameters::ParameterError;
use policy::{Engine, PolicyConfig};

use super::passes::{Evaluation, GradientPass, Passes, Targets};
use crate::batch::Batch;

/// Samples per pass through the network, which bounds its memory: on a CPU, a pass with gradients keeps about 230 kB per
/// sample. A minibatch is split into equal pieces of about this size, the threads share the pieces, and their gradients
/// are summed.
pub(crate) const PIECE_SIZE: usize = 128;

/// One set of networks per thread. Each has its own buffers, and in burn, gradients of graphs that share a tensor would
/// block each other.
///
/// The split into pieces does not depend on the number of workers, and results are combined in piece order, so the sums
/// do not depend on that number either.
#[derive(Debug)]
pub(super) struct Workers {
    all: Vec<Passes>,
    spares: Spares,
}

/// Gradient buffers for reuse: for a new 5 MB buffer, fresh pages cost more than writing the zeros.
type Spares = Mutex<Vec<Vec<f32>>>;

impl Workers {
    /// Creates `n` workers, at least one, whose networks have the initial parameters of `seed`.
    pub(super) fn new(policy: &PolicyConfig, seed: u64, device: &Device, n: usize) -> Self {
        let all = (0..n.max(1)).map(|_| Passes::new(policy, seed, device)).collect();
        Self { all, spares: Spares::default() }
    }

    /// Returns one of the networks; all are equal.
    pub(super) fn engine(&self) -> &Engine {
        &self.all[0].engine
    }

    /// Loads `parameters` into all networks.
    pub(super) fn load(&mut self, parameters: &[f32]) -> Result<(), ParameterError> {
        let loaded = self.each(|passes, _| passes.engine.load(parameters));
        loaded.into_iter().collect()
    }

    /// Computes the values of all rows and the log-probabilities of all actions, in pieces.
    pub(super) fn evaluate(&mut self, batch: &Batch) -> Evaluation {
        let rows: Vec<usize> = (0..batch.features.n).collect();
        let mut whole = Evaluation::default();
        for piece in self.map(&pieces(&rows, PIECE_SIZE), |passes, rows, _| passes.evaluate(batch, rows)) {
            whole.values.extend(piece.values);
            whole.log_probs.extend(piece.log_probs);
            whole.entropies.extend(piece.entropies);
        }
        whole
    }

    /// Computes the log-probabilities of the actions of the samples in `rows`, which must be ascending.
    pub(super) fn log_probs(&mut self, batch: &Batch, rows: &[usize]) -> Vec<f32> {
        self.map(&pieces(rows, PIECE_SIZE), |passes, rows, _| passes.evaluate(batch, rows).log_probs).concat()
    }

    /// Computes the values of all rows, in pieces.
    pub(super) fn values(&mut self, batch: &Batch) -> Vec<f32> {
        let rows: Vec<usize> = (0..batch.features.n).collect();
        self.map(&pieces(&rows, PIECE_SIZE), |passes, rows, _| passes.engine.run(&batch.features, rows).values).concat()
    }

    /// Computes the gradient of the mean loss of `samples`, piece by piece.
    pub(super) fn gradient(&mut self, batch: &Batch, samples: &[usize], targets: &Targets<'_>) -> GradientPass {
        let share = 1.0 / samples.len() as f32;
        let passes = self.map(&pieces(samples, PIECE_SIZE), |passes, piece, spares| {
            let spare = spares.lock().pop().unwrap_or_default();
            passes.gradient(batch, piece, targets, share, spare)
        });
        let whole = passes.into_iter().reduce(|mut whole, piece| {
            whole.gradient.iter_mut().zip(&piece.gradient).for_each(|(sum, g)| *sum += g);
            self.reuse(piece.gradient);
            whole.log_probs.extend(piece.log_probs);
            whole.losses += piece.losses;
            whole
        });
        whole.expect("there is at least one piece")
    }

    /// Keeps the memory of a gradient for the next one.
    pub(super) fn reuse(&self, gradient: Vec<f32>) {
        self.spares.lock().push(gradient);
    }

    /// Runs `work` on every piece; the results are in piece order. An idle worker takes the next piece, because other
    /// threads on the same cores make some workers slower.
    fn map<R: Send>(
        &mut self,
        pieces: &[&[usize]],
        work: impl Fn(&mut Passes, &[usize], &Spares) -> R + Sync,
    ) -> Vec<R> {
        let next = AtomicUsize::new(0);
        let by_worker = self.each(|passes, spares| {
            // Relaxed: the counter orders no other memory accesses.
            let take = || Some(next.fetch_add(1, Ordering::Relaxed)).filter(|&i| i < pieces.len());
            std::iter::from_fn(take).map(|i| (i, work(passes, pieces[i], spares))).collect::<Vec<_>>()
        });
        let mut results: Vec<(usize, R)> = by_worker.into_iter().flatten().collect();
        results.sort_unstable_by_key(|(i, _)| *i);
        results.into_iter().map(|(_, result)| result).collect()
    }

    /// Runs `work` on every worker in parallel; the results are in worker order.
    fn each<R: Send>(&mut self, work: impl Fn(&mut Passes, &Spares) -> R + Sync) -> Vec<R> {
        let Self { all, spares } = self;
        let spares = &*spares;
        let (first, others) = all.split_first_mut().expect("there is at least one worker");
        std::thread::scope(|scope| {
            let work = &work;
            let threads: Vec<_> = others.iter_mut().map(|passes| scope.spawn(move || work(passes, spares))).collect();
            let mut results = vec![work(first, spares)];
            // Propagate a panic with its message to the waiting thread.
            let join = |thread: std::thread::ScopedJoinHandle<'_, R>| {
                thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
            };
            results.extend(threads.into_iter().map(join));
            results
        })
    }
}

/// Splits `items` into pieces of about equal size, at least `size` if there are that many items.
pub(super) fn pieces(items: &[usize], size: usize) -> Vec<&[usize]> {
    let n = (items.len() / size).max(1);
    (0..n).map(|i| &items[i * items.len() / n..(i + 1) * items.len() / n]).collect()
}

#[cfg(test)]
mod tests {
    use super::pieces;

    #[test]
    fn pieces_have_equal_size_and_cover_all_items() {
        let items: Vec<usize> = (0..10).collect();
        let sizes = |size| pieces(&items, size).iter().map(|piece| piece.len()).collect::<Vec<_>>();
        assert_eq!(sizes(4), [5, 5]);
        assert_eq!(sizes(3), [3, 3, 4]);
        assert_eq!(sizes(100), [10]);
        assert_eq!(pieces(&items, 3).concat(), items);
    }
}
