//! Random streams: no two processes of a run, and no two lives of an actor, draw the same tasks and actions.

use blueprints::hash::fnv1a;
use environment::vec_env::generator;
use proto::{ActorId, WeightsVersion};
use rand::RngExt;

/// Returns the seed of all tasks and actions of a thread.
///
/// `epoch` is the start time of the process, in ms since 1970. `version` is the version of its first weights: it
/// keeps a resumed run from repeating itself.
pub(crate) fn thread_seed(
    run_seed: u64,
    actor: &ActorId,
    epoch: u64,
    version: WeightsVersion,
    thread_idx: usize,
) -> u64 {
    // The name comes last because its length varies, so no two lives give the same bytes.
    let numbers = [run_seed, epoch, version.0].map(u64::to_le_bytes);
    let seed = fnv1a(numbers.into_iter().flatten().chain(actor.as_str().bytes()));
    generator(seed, thread_idx as u64).random()
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn lives_that_look_alike_have_seeds_of_their_own() {
        let names = ["a", "b", "actor-1", "actor-11"].map(|name| name.parse::<ActorId>().unwrap());
        let mut seeds = BTreeSet::new();
        let mut n = 0;
        for actor in &names {
            for (run_seed, epoch) in (0..8).flat_map(|run_seed| (0..8).map(move |epoch| (run_seed, epoch))) {
                for version in (0..8).map(WeightsVersion) {
                    seeds.extend((0..4).map(|thread_idx| thread_seed(run_seed, actor, epoch, version, thread_idx)));
                    n += 4;
                }
            }
        }
        assert_eq!(seeds.len(), n);
    }
}
