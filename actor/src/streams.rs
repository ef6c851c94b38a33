//! Random streams: no two processes of a run, and no two lives of an actor, draw the same tasks and actions.

use blueprints::hash::fnv1a;
use environment::vec_env::generator;
use proto::{ActorId, WeightsVersion};
use rand::RngExt;

/// What distinguishes an actor's life from all others in a run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Life {
    pub(crate) run_seed: u64,
    pub(crate) actor: ActorId,
    /// Start time of the process, ms since 1970.
    pub(crate) epoch: u64,
    /// Version of its first weights, so that a resumed run does not repeat itself.
    pub(crate) version: WeightsVersion,
}

impl Life {
    /// Returns the seed of all tasks and actions of one of its threads.
    pub(crate) fn thread_seed(&self, thread_idx: usize) -> u64 {
        // The name comes last because its length varies, so no two lives give the same bytes.
        let numbers = [self.run_seed, self.epoch, self.version.0].map(u64::to_le_bytes);
        let seed = fnv1a(numbers.into_iter().flatten().chain(self.actor.as_str().bytes()));
        generator(seed, thread_idx as u64).random()
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use blueprints::Catalog;
    use proto::Task;

    use super::*;
    use crate::{TaskConfig, TaskSampler};

    fn life() -> Life {
        Life { run_seed: 7, actor: "local".parse().unwrap(), epoch: 1_700_000_000_000, version: WeightsVersion(0) }
    }

    /// Returns the first tasks of a thread.
    fn tasks(life: &Life, thread_idx: usize) -> Vec<Task> {
        let sampler = TaskSampler::new(&TaskConfig::default(), Catalog::builtin()).unwrap();
        let mut rng = generator(life.thread_seed(thread_idx), 0);
        (0..20).map(|_| sampler.sample(&mut rng)).collect()
    }

    #[test]
    fn whatever_differs_gives_other_tasks() {
        let first = tasks(&life(), 0);
        assert_eq!(tasks(&life(), 0), first, "equal lives give equal tasks");
        for other in [
            Life { run_seed: 8, ..life() },
            Life { actor: "actor-1".parse().unwrap(), ..life() },
            // A process that was restarted a millisecond later, and a resumed run.
            Life { epoch: life().epoch + 1, ..life() },
            Life { version: WeightsVersion(1), ..life() },
        ] {
            let tasks = tasks(&other, 0);
            assert!(tasks.iter().all(|task| first.iter().all(|old| old.seed != task.seed)), "{other:?}");
        }
        assert_ne!(tasks(&life(), 1), first);
    }

    #[test]
    fn lives_that_look_alike_have_seeds_of_their_own() {
        let names = ["a", "b", "actor-1", "actor-11"].map(|name| name.parse::<ActorId>().unwrap());
        let mut seeds = BTreeSet::new();
        let mut n = 0;
        for actor in &names {
            for (run_seed, epoch) in (0..8).flat_map(|run_seed| (0..8).map(move |epoch| (run_seed, epoch))) {
                for version in 0..8 {
                    let life = Life { run_seed, actor: actor.clone(), epoch, version: WeightsVersion(version) };
                    seeds.extend((0..4).map(|thread_idx| life.thread_seed(thread_idx)));
                    n += 4;
                }
            }
        }
        assert_eq!(seeds.len(), n);
    }
}
