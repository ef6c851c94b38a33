//! The learner's newest update: throughput, policy lag, losses and episodes.

use ratatui::text::Line;

use super::format::{count, number, rate, seconds, success};
use super::{heading, plain, trends};
use crate::run_view::RunView;

/// Formats the learner's newest metrics, fitted to `width` characters where lines can get long.
pub(super) fn lines(run: &RunView, width: usize) -> Vec<Line<'static>> {
    let Some(heard) = run.learner() else {
        return vec![heading("Learning: no update so far".to_owned())];
    };
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
    ];
    // All zero while only the imitation loss is active.
    if [ppo.policy_loss, ppo.value_loss, ppo.entropy, ppo.approx_kl].iter().any(|number| *number != 0.0) {
        lines.push(plain(format!(
            "  loss        total {}, policy {}, value {}, gradient norm {}",
            number(ppo.total_loss),
            number(ppo.policy_loss),
            number(ppo.value_loss),
            number(ppo.grad_norm),
        )));
        lines.push(plain(format!(
            "  policy      KL {}, entropy {}, clipped {}, explained variance {}",
            number(ppo.approx_kl),
            number(ppo.entropy),
            number(ppo.clip_fraction),
            number(ppo.explained_variance),
        )));
    }
    lines.push(plain(format!("  episodes    {ended}")));
    if let Some(imitation) = learner.imitation.filter(|imitation| imitation.weight > 0.0) {
        lines.push(plain(format!(
            "  labels      block accuracy {:.1} %, block loss {}, move loss {}",
            100.0 * imitation.block_accuracy,
            number(imitation.block_loss),
            number(imitation.move_loss),
        )));
    }
    lines.extend(trends::overview(run, width));
    lines
}
