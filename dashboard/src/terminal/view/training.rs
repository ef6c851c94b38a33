//! The learner's newest update: throughput, policy lag, losses and episodes.

use proto::metrics::{KindMetrics, ProposalMetrics};
use ratatui::text::Line;

use super::format::{count, number, rate, seconds, success};
use super::styled::{heading, plain};
use super::trends;
use crate::run_view::{RunView, proposals};

/// Formats the learner's newest metrics, fitted to `width` characters where lines can get long.
pub(super) fn lines(run: &RunView, width: usize) -> Vec<Line<'static>> {
    let Some(heard) = &run.learner else { return vec![heading("Learning: no update so far".to_owned())] };
    let learner = &heard.value;
    let (ppo, episodes) = (&learner.ppo, &learner.episodes);
    let ended = if episodes.success.n_episodes == 0 {
        "none ended since the last update".to_owned()
    } else {
        format!(
            "success {} of {}, return {}, {:.1} steps",
            success(&episodes.success).trim_start(),
            episodes.success.n_episodes,
            number(episodes.mean_return.total().into()),
            episodes.mean_steps,
        )
    };
    let [total, policy, value, norm] = [ppo.total_loss, ppo.policy_loss, ppo.value_loss, ppo.grad_norm].map(number);
    let [kl, entropy, clipped, explained] =
        [ppo.approx_kl, ppo.entropy, ppo.clip_fraction, ppo.explained_variance].map(number);
    let mut lines = vec![
        heading(format!(
            "Learning: weights {}, {} environment steps in {}",
            learner.weights_version.0,
            count(learner.n_env_steps),
            seconds(learner.elapsed_s.max(learner.run_elapsed_s)),
        )),
        plain(format!(
            "  throughput  {} steps/s, {} waiting; lag {:.2} versions, at most {}",
            rate(learner.env_steps_per_s),
            count(learner.n_mailbox),
            learner.policy_lag_mean,
            learner.policy_lag_max,
        )),
        plain(format!("  loss        total {total}, policy {policy}, value {value}, gradient norm {norm}")),
        plain(format!("  policy      KL {kl}, entropy {entropy}, clipped {clipped}, explained variance {explained}")),
        plain(format!("  episodes    {ended}")),
    ];
    lines.extend(run.sizes.text().map(|sizes| plain(format!("  by blocks   {sizes}"))));
    if let Some(proposals) = &learner.proposals {
        lines.extend(draws(proposals));
    }
    lines.extend(trends::overview(run, width));
    lines
}

/// Formats the kinds that were drawn, how often they did what they are for, and the entropies of the choices.
fn draws(found: &ProposalMetrics) -> [Line<'static>; 2] {
    let percents = |of: fn(&KindMetrics) -> Option<f64>| {
        let each = proposals::kinds(found).filter_map(|(kind, numbers)| Some((kind, of(numbers)?)));
        each.map(|(kind, share)| format!("{} {:.0} %", kind.name(), 100.0 * share)).collect::<Vec<_>>().join(", ")
    };
    let ProposalMetrics { first_proposal_entropy, second_block_entropy, second_proposal_entropy, .. } = found;
    let entropy = format!("{first_proposal_entropy:.2} / {second_block_entropy:.2} / {second_proposal_entropy:.2}");
    let success = Some(percents(|kind| kind.success)).filter(|success| !success.is_empty());
    [
        plain(format!("  draws       {}", percents(|kind| Some(kind.share)))),
        plain(format!("  succeeded   {}; entropy {entropy}", success.as_deref().unwrap_or("none had anything to do"))),
    ]
}
