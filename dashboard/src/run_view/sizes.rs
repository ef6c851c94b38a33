//! Success of training episodes by the number of blocks of their goals.

use std::collections::{BTreeMap, VecDeque};
use std::ops::RangeInclusive;

use proto::metrics::LearnerMetrics;

/// Number of episodes of a size that are remembered at least, as soon as there are so many.
const N_EPISODES: u64 = 100;

/// Maximum number of sizes with a rate each; more are joined into groups, so that all fit into 80 columns.
const MAX_SIZES: usize = 6;

/// The paper's groups.
const GROUPS: [RangeInclusive<usize>; 3] = [2..=6, 7..=11, 12..=16];

/// Counts successes among the newest training episodes of each size.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sizes {
    /// Successes and episodes, oldest first. `None` is the size of goals whose id does not tell it.
    by_size: BTreeMap<Option<usize>, VecDeque<[u64; 2]>>,
    n_updates: u64,
}

impl Sizes {
    /// Adds the episodes of an update, unless it came before, and forgets the oldest that are not needed.
    pub fn add(&mut self, learner: &LearnerMetrics) {
        if self.n_updates == learner.n_updates {
            return;
        }
        self.n_updates = learner.n_updates;
        for (id, success) in learner.episodes.success_by_blueprint.iter().filter(|(_, rate)| rate.n_episodes > 0) {
            let newest = self.by_size.entry(id.size()).or_default();
            newest.push_back([success.n_successes, success.n_episodes]);
            while newest.len() > 1 && sum(newest.range(1..))[1] >= N_EPISODES {
                newest.pop_front();
            }
        }
    }

    /// Returns the success rates in percent by number of blocks, such as `2: 100  3: 98  4: 91 %`, in at most 66
    /// characters; `None` for fewer than two sizes, which say no more than the rate of all episodes.
    pub fn text(&self) -> Option<String> {
        let of = |counts: [u64; 2]| format!("{:.0}", 100.0 * counts[0] as f64 / counts[1].max(1) as f64);
        let sizes: Vec<usize> = self.by_size.keys().copied().flatten().collect();
        let mut parts: Vec<String> = if sizes.len() <= MAX_SIZES {
            sizes.iter().map(|size| format!("{size}: {}", of(self.total(&(*size..=*size))))).collect()
        } else {
            let groups = GROUPS.iter().map(|group| (group, self.total(group))).filter(|(_, counts)| counts[1] > 0);
            groups.map(|(group, counts)| format!("{}-{}: {}", group.start(), group.end(), of(counts))).collect()
        };
        parts.extend(self.by_size.get(&None).map(|others| format!("other: {}", of(sum(others)))));
        (parts.len() > 1).then(|| parts.join("  ") + " %")
    }

    fn total(&self, sizes: &RangeInclusive<usize>) -> [u64; 2] {
        sum(self.by_size.range(Some(*sizes.start())..=Some(*sizes.end())).flat_map(|(_, counts)| counts))
    }
}

fn sum<'a>(counts: impl IntoIterator<Item = &'a [u64; 2]>) -> [u64; 2] {
    let add = |[a, b]: [u64; 2], [c, d]: &[u64; 2]| [a.saturating_add(*c), b.saturating_add(*d)];
    counts.into_iter().fold([0, 0], add)
}

#[cfg(test)]
mod tests {
    use proto::wilson::SuccessRate;

    use super::*;
    use crate::tests::samples;

    fn update(sizes: &mut Sizes, rates: &[(&str, u64, u64)]) {
        let mut learner: LearnerMetrics = serde_json::from_value(samples::learner().value).unwrap();
        learner.n_updates = sizes.n_updates + 1;
        let rate = |&(id, n, of): &(&str, u64, u64)| (id.parse().unwrap(), SuccessRate::new(n, of));
        learner.episodes.success_by_blueprint = rates.iter().map(rate).collect();
        sizes.add(&learner);
        // A learner that waits for its disk tells of the same update again.
        let before = sizes.clone();
        sizes.add(&learner);
        assert_eq!(*sizes, before);
    }

    #[test]
    fn success_is_that_of_the_newest_hundred_episodes_of_each_size() {
        let mut sizes = Sizes::default();
        update(&mut sizes, &[("2_000", 0, 40), ("2_001", 20, 20)]);
        assert_eq!(sizes.text(), None, "one size says no more than all episodes");
        update(&mut sizes, &[("my-tower_3_000", 1, 2), ("2_000", 39, 40)]);
        assert_eq!(sizes.text().unwrap(), "2: 59  3: 50 %");
        // The first 40 of two blocks are no longer needed.
        update(&mut sizes, &[("2_001", 40, 40), ("4_000", 0, 0), ("my-castle", 1, 4)]);
        assert_eq!(sizes.text().unwrap(), "2: 99  3: 50  other: 25 %");
        update(&mut sizes, &[("2_001", u64::MAX, u64::MAX)]);
        update(&mut sizes, &[("2_002", u64::MAX, u64::MAX)]);
        assert_eq!(sizes.text().unwrap(), "2: 100  3: 50  other: 25 %");
    }

    #[test]
    fn many_sizes_are_told_in_groups_and_all_fit_into_a_line() {
        let mut sizes = Sizes::default();
        let ids: Vec<String> = (11..=16).map(|size| format!("{size}_000")).collect();
        let all: Vec<(&str, u64, u64)> = ids.iter().map(|id| (id.as_str(), 200, 200)).collect();
        update(&mut sizes, &all);
        update(&mut sizes, &[("mine", 5, 5)]);
        let widest = sizes.text().unwrap();
        assert_eq!(widest.len(), 66);
        assert_eq!(widest, "11: 100  12: 100  13: 100  14: 100  15: 100  16: 100  other: 100 %");
        update(&mut sizes, &[("2_000", 1, 2), ("6_000", 1, 6)]);
        assert_eq!(sizes.text().unwrap(), "2-6: 25  7-11: 100  12-16: 100  other: 100 %");
    }
}
