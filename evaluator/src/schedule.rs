//! When the next evaluation is due.

use std::time::{Duration, Instant};

use proto::{Weights, WeightsVersion};

use crate::config::Every;

/// The newest evaluation, complete or not.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Evaluated {
    /// When it began.
    pub(crate) start: Instant,
    /// Version of the evaluated weights.
    pub(crate) version: WeightsVersion,
    /// Environment steps on which the weights were trained.
    pub(crate) n_env_steps: u64,
    /// Whether it covered all blueprints for the last weights.
    pub(crate) is_last: bool,
}

/// When to evaluate the newest weights.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Due {
    /// Now.
    Now,
    /// After this time, with newer weights if there are any by then.
    After(Duration),
    /// Not before newer weights arrive.
    WithNewer,
}

/// Returns when to evaluate `newest` after `last`, seen from `now`.
///
/// Untrained weights are not evaluated. The first weights after them are due as if weights 0 had been evaluated, or at
/// once where a time says when. The same weights are never evaluated again. A version or step count lower than the last
/// one means that the learner resumed from a checkpoint, so its weights count as new.
pub(crate) fn due(every: Every, last: Option<&Evaluated>, newest: &Weights, now: Instant) -> Due {
    let far_enough = |passed: Option<u64>, step: u64| match passed {
        Some(passed) if passed < step => Due::WithNewer,
        _ => Due::Now,
    };
    let Some(last) = last else {
        return match every {
            Every::Minutes(_) => far_enough(Some(newest.n_env_steps), 1),
            Every::Steps(steps) => far_enough(Some(newest.n_env_steps), steps),
            Every::Versions(versions) => far_enough(Some(newest.version.0), versions),
        };
    };
    if newest.version == last.version && newest.n_env_steps == last.n_env_steps {
        return Due::WithNewer;
    }
    match every {
        Every::Minutes(minutes) => {
            let period = Duration::from_secs_f64(60.0 * minutes);
            match period.checked_sub(now.duration_since(last.start)) {
                None | Some(Duration::ZERO) => Due::Now,
                Some(rest) => Due::After(rest),
            }
        }
        Every::Steps(steps) => far_enough(newest.n_env_steps.checked_sub(last.n_env_steps), steps),
        Every::Versions(versions) => far_enough(newest.version.0.checked_sub(last.version.0), versions),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn weights(version: u64, n_env_steps: u64) -> Weights {
        Weights { version: WeightsVersion(version), n_env_steps, ..crate::episodes::tests::weights() }
    }

    #[test]
    fn evaluations_are_as_far_apart_as_configured() {
        let secs = Duration::from_secs;
        let now = Instant::now() + secs(1000);
        let last = |version, n_env_steps, seconds| {
            let start = now - secs(seconds);
            Some(Evaluated { start, version: WeightsVersion(version), n_env_steps, is_last: false })
        };
        let table = [
            (Every::Minutes(10.0), None, weights(0, 0), Due::WithNewer),
            (Every::Minutes(10.0), None, weights(1, 10), Due::Now),
            (Every::Steps(100), None, weights(1, 99), Due::WithNewer),
            (Every::Steps(100), None, weights(2, 100), Due::Now),
            (Every::Versions(5), None, weights(4, 40), Due::WithNewer),
            (Every::Versions(5), None, weights(5, 50), Due::Now),
            (Every::Minutes(10.0), last(3, 30, 60), weights(3, 30), Due::WithNewer),
            (Every::Minutes(10.0), last(3, 30, 60), weights(4, 40), Due::After(secs(540))),
            (Every::Minutes(10.0), last(3, 30, 600), weights(4, 40), Due::Now),
            (Every::Minutes(10.0), last(3, 30, 999), weights(4, 40), Due::Now),
            (Every::Steps(100), last(3, 30, 0), weights(9, 129), Due::WithNewer),
            (Every::Steps(100), last(3, 30, 0), weights(9, 130), Due::Now),
            (Every::Versions(5), last(3, 30, 0), weights(7, 70), Due::WithNewer),
            (Every::Versions(5), last(3, 30, 0), weights(8, 80), Due::Now),
            (Every::Versions(5), last(30, 300, 0), weights(25, 250), Due::Now),
        ];
        for (every, last, newest, expected) in table {
            assert_eq!(due(every, last.as_ref(), &newest, now), expected, "{every:?} {last:?}");
        }
    }
}
