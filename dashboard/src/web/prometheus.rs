//! Exports the board as metrics for Prometheus.
//!
//! Each scrape fills a new registry, so that it omits blueprints and actors that are gone.

use std::borrow::Cow;
use std::sync::atomic::AtomicU64;

use prometheus_client::encoding::text::encode;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::registry::Registry;
use proto::metrics::{LearnerMetrics, ProposalMetrics, VideoCounts};
use proto::wilson::SuccessRate;
use proto::{ActionMode, Role};
use serde::Serialize;

use super::board::State;
use crate::run_view::counters;
use crate::run_view::proposals::kinds;

/// The content type of [`text`].
pub(super) const CONTENT_TYPE: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

type Labels = Vec<(&'static str, String)>;

/// Returns all metrics of the board, each labeled with the name of its `run`.
///
/// # Errors
/// Never fails for the names and labels used here; this is the encoder's error type.
pub(super) fn text(state: &State, run: &str) -> Result<String, std::fmt::Error> {
    let run = (Cow::Borrowed("run"), Cow::Owned(run.to_owned()));
    let mut page = Scrape(Registry::with_prefix_and_labels("lodestone", std::iter::once(run)));
    // A constant whose label has the version of the program.
    let labels = vec![label("version", env!("CARGO_PKG_VERSION"))];
    page.gauges("build_info", "Always 1; the label has the version of the program", [(labels, 1.0)]);
    success(&mut page, state);
    learner(&mut page, state);
    roster(&mut page, state);
    dropped_by_learner(&mut page, state);
    dropped_by_evaluator(&mut page, state);
    dropped_by_page(&mut page, state);
    let mut text = String::new();
    encode(&mut text, &page.0)?;
    Ok(text)
}

struct Scrape(Registry);

impl Scrape {
    fn gauges(&mut self, name: &str, help: &str, values: impl IntoIterator<Item = (Labels, f64)>) {
        let family = Family::<Labels, Gauge<f64, AtomicU64>>::default();
        for (labels, value) in values {
            family.get_or_create(&labels).set(value);
        }
        self.0.register(name, help, family);
    }

    /// Adds a gauge without labels; none without a value, as a family without members is left out of a scrape.
    fn gauge(&mut self, name: &str, help: &str, value: Option<f64>) {
        self.gauges(name, help, value.map(|value| (Labels::new(), value)));
    }

    /// Adds a counter. The encoder appends `_total` to `name`, here and in `counters`.
    fn counter(&mut self, name: &str, help: &str, value: Option<u64>) {
        self.counters(name, help, value.map(|value| (Labels::new(), value)));
    }

    fn counters(&mut self, name: &str, help: &str, values: impl IntoIterator<Item = (Labels, u64)>) {
        let family = Family::<Labels, Counter>::default();
        for (labels, value) in values {
            family.get_or_create(&labels).inc_by(value);
        }
        self.0.register(name, help, family);
    }
}

fn label(name: &'static str, value: &str) -> (&'static str, String) {
    (name, value.to_owned())
}

/// Returns the counters of a struct, labeled by field name.
fn by_reason(counts: &impl Serialize) -> Vec<(Labels, u64)> {
    let reason = |name: String| vec![label("reason", name.strip_suffix("_total").unwrap_or(&name))];
    counters(counts).into_iter().map(|(name, n)| (reason(name), n)).collect()
}

fn success(page: &mut Scrape, state: &State) {
    let last = state.evaluations.last();
    let groups = last.into_iter().flat_map(|evaluation| evaluation.groups.iter().chain([&evaluation.all]));
    let rates: Vec<(Labels, SuccessRate)> = groups
        .flat_map(|group| {
            let both = [(ActionMode::Greedy, group.greedy), (ActionMode::Sampled, group.sampled)];
            both.into_iter().filter_map(|(acting, rate)| {
                Some((vec![label("group", group.name), label("acting", acting.name())], rate?))
            })
        })
        .collect();
    let of = |number: fn(&SuccessRate) -> f64| rates.iter().map(move |(labels, rate)| (labels.clone(), number(rate)));
    page.gauges("eval_group_success_ratio", "Success rate of the newest evaluation by group, 0 to 1", of(|r| r.rate));
    let help = "Lower end of the 95 % Wilson interval of the success rate, 0 to 1";
    page.gauges("eval_group_success_wilson_low_ratio", help, of(|r| r.wilson_low));
    let help = "Upper end of the 95 % Wilson interval of the success rate, 0 to 1";
    page.gauges("eval_group_success_wilson_high_ratio", help, of(|r| r.wilson_high));
    page.gauges("eval_group_episodes", "Episodes of the newest evaluation by group", of(|r| r.n_episodes as f64));
    let blueprint = |(row, acting, [hits, n]): (&runlog::series::Row, ActionMode, [u64; 2])| {
        let names = [
            label("blueprint", row.id.as_str()),
            label("split", &row.split.to_string()),
            label("acting", acting.name()),
        ];
        (names.to_vec(), SuccessRate::new(hits, n).rate)
    };
    let help = "Success rate of the newest evaluation by blueprint, 0 to 1";
    page.gauges("eval_blueprint_success_ratio", help, state.evaluations.newest().map(blueprint));
    let version = last.map(|evaluation| evaluation.weights_version as f64);
    page.gauge("eval_weights_version", "Version of the weights evaluated last", version);
    let steps = last.map(|evaluation| evaluation.n_env_steps as f64);
    page.gauge("eval_env_steps", "Environment steps that the weights evaluated last had learned from", steps);
}

fn learner(page: &mut Scrape, state: &State) {
    let learner = state.run.learner.as_ref().map(|heard| &heard.value);
    page.counter("learner_env_steps", "Environment steps consumed by the learner", learner.map(|l| l.n_env_steps));
    page.counter("learner_updates", "PPO updates", learner.map(|l| l.n_updates));
    page.counter("learner_episodes", "Training episodes whose end was seen", learner.map(|l| l.n_episodes));
    let mut gauge = |name, help, value: fn(&LearnerMetrics) -> f64| {
        page.gauge(name, help, learner.map(value));
    };
    gauge("learner_weights_version", "Version of the newest weights", |l| l.weights_version.0 as f64);
    gauge("learner_env_steps_per_second", "Environment steps consumed per second", |l| l.env_steps_per_s);
    gauge("learner_update_seconds", "Duration of the newest update", |l| l.update_s);
    gauge("learner_policy_lag_versions", "Mean age of the weights that acted, in versions", |l| l.policy_lag_mean);
    gauge("learner_mailbox_env_steps", "Environment steps that wait at the learner", |l| l.n_mailbox as f64);
    gauge("learner_policy_loss", "Clipped surrogate loss", |l| l.ppo.policy_loss);
    gauge("learner_value_loss", "Value loss on normalized values", |l| l.ppo.value_loss);
    gauge("learner_entropy_nats", "Entropy of the action distribution", |l| l.ppo.entropy);
    gauge("learner_approx_kl_nats", "KL divergence of an update, estimated", |l| l.ppo.approx_kl);
    gauge("learner_explained_variance_ratio", "Explained variance of the values, at most 1", |l| {
        l.ppo.explained_variance
    });
    gauge("learner_learning_rate", "Learning rate of the newest update", |l| l.ppo.learning_rate);
    proposals(page, learner.and_then(|learner| learner.proposals.as_ref()));
}

fn proposals(page: &mut Scrape, proposals: Option<&ProposalMetrics>) {
    let Some(proposals) = proposals else { return };
    let kinds = || kinds(proposals).map(|(kind, found)| (vec![label("kind", kind.name())], found));
    let share = kinds().map(|(labels, found)| (labels, found.share));
    let help = "Part of the mixture head's draws in the newest update, by kind";
    page.gauges("learner_proposal_share_ratio", help, share);
    let success = kinds().filter_map(|(labels, found)| Some((labels, found.success?)));
    let help = "Part of the draws with a connection to make or break whose step did so, by kind of proposal";
    page.gauges("learner_proposal_success_ratio", help, success);
    let entropies = [
        ("first_proposal", proposals.first_proposal_entropy),
        ("second_block", proposals.second_block_entropy),
        ("second_proposal", proposals.second_proposal_entropy),
    ];
    let entropies = entropies.map(|(choice, entropy)| (vec![label("choice", choice)], entropy));
    page.gauges("learner_proposal_entropy_nats", "Entropy of a choice of the mixture head", entropies);
}

fn roster(page: &mut Scrape, state: &State) {
    let roster = state.roster();
    let alive = [(Role::Actor, roster.actors), (Role::Learner, roster.learners), (Role::Evaluator, roster.evaluators)];
    let alive = alive.map(|(role, names)| (vec![label("role", role.as_str())], names.len() as f64));
    page.gauges("alive_processes", "Members of the run that are alive, by role", alive);
    let actors = || state.actors().map(|(id, actor)| (vec![label("actor", id.as_str())], actor));
    let speed = actors().map(|(labels, actor)| (labels, actor.env_steps_per_s));
    page.gauges("actor_env_steps_per_second", "Environment steps per second of an actor", speed);
    let lag = actors().map(|(labels, actor)| (labels, actor.policy_lag as f64));
    page.gauges("actor_policy_lag_versions", "Age of the weights that act, in versions", lag);
    let steps = actors().map(|(labels, actor)| (labels, actor.n_env_steps));
    page.counters("actor_env_steps", "Environment steps made by an actor", steps);
    let drops = actors().flat_map(|(labels, actor)| {
        let dropped = by_reason(&actor.dropped).into_iter();
        dropped.map(move |(reason, n)| ([&labels[..], &reason[..]].concat(), n))
    });
    page.counters("actor_trajectories_dropped", "Trajectories that an actor dropped, by reason", drops);
    let of_bus = actors().flat_map(|(labels, actor)| {
        // Omit zeros, which most counters stay at: thousands of actors with a dozen reasons each are too many for a
        // scrape.
        let some = by_reason(&actor.bus).into_iter().filter(|(_, n)| *n > 0);
        some.map(move |(reason, n)| ([&labels[..], &reason[..]].concat(), n))
    });
    let help = "What an actor's session dropped or refused, by reason, once there is any";
    page.counters("actor_bus_dropped", help, of_bus);
}

fn dropped_by_learner(page: &mut Scrape, state: &State) {
    let learner = state.run.learner.as_ref().map(|heard| &heard.value);
    let of_bus = learner.into_iter().flat_map(|learner| by_reason(&learner.bus));
    page.counters("learner_bus_dropped", "What the learner's session dropped or refused, by reason", of_bus);
    let reasons = learner.into_iter().flat_map(|learner| {
        let ingest = &learner.ingest;
        [
            ("stale", ingest.stale_total),
            ("invalid", ingest.invalid_total),
            ("name_taken", ingest.name_taken_total),
            ("expired", learner.expired_total),
            ("unmade", learner.unmade_total),
        ]
    });
    let reasons = reasons.map(|(reason, n)| (vec![label("reason", reason)], n));
    let help = "Trajectories that the learner did not learn from, by reason";
    page.counters("learner_trajectories_dropped", help, reasons);
    let help = "Updates that were taken back, because no policy could act with their weights";
    page.counter("learner_updates_refused", help, learner.map(|learner| learner.refused_total));
    let help = "Trajectories that came again after the learner had taken them";
    page.counter("learner_duplicates", help, learner.map(|learner| learner.ingest.duplicates_total));
    let help = "Trajectories that came while the mailbox was full, which actors send again";
    page.counter("learner_back_pressure", help, learner.map(|learner| learner.ingest.full_total));
}

fn dropped_by_evaluator(page: &mut Scrape, state: &State) {
    let evaluation = state.run.evaluation.as_ref().map(|heard| &heard.value);
    let of_bus = evaluation.into_iter().flat_map(|evaluation| by_reason(&evaluation.bus));
    page.counters("evaluator_bus_dropped", "What the evaluator's session dropped or refused, by reason", of_bus);
    if let Some(videos) = evaluation.and_then(|evaluation| evaluation.videos) {
        let VideoCounts { written_total, dropped_total, failed_total, unrecorded_total, .. } = videos;
        page.counter("evaluator_videos_written", "Files of videos written", Some(written_total));
        let reasons = [("dropped", dropped_total), ("failed", failed_total), ("unrecorded", unrecorded_total)];
        let reasons = reasons.map(|(reason, n)| (vec![label("reason", reason)], n));
        let help = "Videos that were not made, by reason";
        page.counters("evaluator_videos_dropped", help, reasons);
    }
}

fn dropped_by_page(page: &mut Scrape, state: &State) {
    let reasons = by_reason(&state.counts);
    page.counters("page_dropped", "What the page itself dropped or refused, by reason", reasons);
    let unread = by_reason(&state.run.unread);
    page.counters("page_metrics_unread", "Metrics that came and are not among these numbers, by reason", unread);
    let of_bus = by_reason(&state.run.bus);
    page.counters("page_bus_dropped", "What the session of the page's process dropped or refused, by reason", of_bus);
    page.gauge("page_viewers", "Browsers that listen", Some(state.viewers.len() as f64));
}

#[cfg(test)]
mod tests {
    use std::collections::{BTreeMap, BTreeSet};

    use std::time::Duration;

    use blueprints::Split;

    use super::*;
    use crate::follow::News;
    use crate::tests::samples;
    use crate::web::board::Board;
    use crate::web::tests::samples::evaluation;

    /// Parses samples by name and labels, without the `run` label. Checks that each is preceded by a type and a help
    /// text.
    fn parse(text: &str) -> BTreeMap<String, f64> {
        let (mut helped, mut typed, mut samples) = (BTreeSet::new(), BTreeSet::new(), BTreeMap::new());
        assert!(text.ends_with("# EOF\n"));
        for line in text.lines() {
            if let Some(rest) = line.strip_prefix("# HELP ") {
                let (name, help) = rest.split_once(' ').unwrap();
                assert!(!help.is_empty());
                helped.insert(name.to_owned());
            } else if let Some(rest) = line.strip_prefix("# TYPE ") {
                typed.insert(rest.split_once(' ').unwrap().0.to_owned());
            } else if !line.starts_with('#') {
                let (sample, value) = line.rsplit_once(' ').unwrap();
                let name = sample.split('{').next().unwrap();
                let family = name.strip_suffix("_total").unwrap_or(name);
                assert!(helped.contains(family) && typed.contains(family), "{line}");
                let labels = sample.strip_prefix(name).unwrap();
                let others = labels.strip_prefix(r#"{run="a run""#).unwrap_or_else(|| panic!("{line} is of no run"));
                let others = others.trim_start_matches(',').trim_end_matches('}');
                let sample = if others.is_empty() { name.to_owned() } else { format!("{name}{{{others}}}") };
                assert!(samples.insert(sample, value.parse().unwrap()).is_none(), "{line} twice");
            }
        }
        samples
    }

    /// Receives what comes from the bus, and returns the samples of a scrape then.
    fn scraped(board: &Board, news: impl IntoIterator<Item = News>) -> BTreeMap<String, f64> {
        news.into_iter().for_each(|news| board.receive(news, Duration::ZERO));
        parse(&text(&board.state(), "a run").unwrap())
    }

    /// Checks the values of these samples, whose names begin with `prefix`.
    #[track_caller]
    fn check(samples: &BTreeMap<String, f64>, prefix: &str, expected: &[(&str, f64)]) {
        for (sample, value) in expected {
            assert_eq!(samples.get(&format!("{prefix}_{sample}")), Some(value), "{sample} in {samples:#?}");
        }
    }

    #[test]
    fn draws_of_the_mixture_head_are_scraped_by_kind() {
        let samples = scraped(&Board::default(), [News::Metrics(samples::mixture_learner())]);
        let expected = [
            ("share_ratio{kind=\"join\"}", 0.75),
            ("share_ratio{kind=\"detach\"}", 0.05),
            ("success_ratio{kind=\"detach\"}", 0.4),
            ("entropy_nats{choice=\"second_block\"}", 1.25),
        ];
        check(&samples, "lodestone_learner_proposal", &expected);
        let n = |name: &str| samples.keys().filter(|sample| sample.contains(name)).count();
        assert_eq!((n("proposal_share"), n("proposal_success")), (3, 2), "{samples:#?}");
    }

    #[test]
    fn what_an_evaluator_dropped_is_scraped() {
        let board = Board::default();
        let mut evaluation = samples::evaluation();
        evaluation.value["bus"]["weights_refused_total"] = 2.into();
        let samples = scraped(&board, [News::Metrics(evaluation.clone())]);
        let expected = [("total{reason=\"weights_refused\"}", 2.0), ("total{reason=\"tokens_invalid\"}", 0.0)];
        check(&samples, "lodestone_evaluator_bus_dropped", &expected);
        // An evaluator that makes no videos has no counters of videos.
        assert!(!samples.keys().any(|sample| sample.contains("videos")), "{samples:#?}");

        evaluation.value["videos"] = serde_json::json!({
            "written_total": 6, "n_waiting": 1, "dropped_total": 2, "failed_total": 3, "unrecorded_total": 4,
            "oversized_total": 0,
        });
        let expected = [
            ("written_total", 6.0),
            ("dropped_total{reason=\"dropped\"}", 2.0),
            ("dropped_total{reason=\"failed\"}", 3.0),
            ("dropped_total{reason=\"unrecorded\"}", 4.0),
        ];
        check(&scraped(&board, [News::Metrics(evaluation)]), "lodestone_evaluator_videos", &expected);
    }

    #[test]
    fn a_hand_worked_scrape() {
        let board = Board::default();
        let scores = [("2_003", Split::Train, 2, 4), ("3_001", Split::Train, 3, 5)];
        board.evaluated(&evaluation(200, &scores));
        let mut other = samples::learner();
        other.value["schema_version"] = 1.into();
        let session = News::Session(samples::session(&["a", "b"]));
        let metrics = [samples::actor("a"), samples::actor("gone"), other].map(News::Metrics);
        let samples = scraped(&board, [session].into_iter().chain(metrics));
        let expected = [
            ("eval_group_success_ratio{group=\"train 2-6\",acting=\"greedy\"}", 0.45),
            ("eval_group_episodes{group=\"all\",acting=\"greedy\"}", 20.0),
            ("eval_blueprint_success_ratio{blueprint=\"2_003\",split=\"train\",acting=\"greedy\"}", 0.4),
            ("eval_weights_version", 20.0),
            ("eval_env_steps", 200.0),
            ("alive_processes{role=\"actor\"}", 2.0),
            ("actor_env_steps_per_second{actor=\"a\"}", 640.25),
            ("page_dropped_total{reason=\"browser_too_slow\"}", 0.0),
            ("page_metrics_unread_total{reason=\"schema_unknown\"}", 1.0),
            ("page_metrics_unread_total{reason=\"over_limit\"}", 0.0),
            ("page_bus_dropped_total{reason=\"metrics_dropped\"}", 0.0),
            (concat!("build_info{version=\"", env!("CARGO_PKG_VERSION"), "\"}"), 1.0),
        ];
        check(&samples, "lodestone", &expected);
        // No measurements yet, which is different from 0.
        assert!(!samples.keys().any(|sample| sample.starts_with("lodestone_learner_")), "{samples:#?}");
        assert!(!samples.keys().any(|sample| sample.contains("gone")), "{samples:#?}");
        // Without a router, live processes are unknown.
        let samples = scraped(&board, [News::Session(samples::cut_off())]);
        check(&samples, "lodestone", &[("alive_processes{role=\"learner\"}", 0.0)]);
        assert!(!samples.keys().any(|sample| sample.starts_with("lodestone_actor_")), "{samples:#?}");
    }
}
