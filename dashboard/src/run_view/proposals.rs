//! The draws of the mixture head, as numbers with names.

use policy::proposals::Kind;
use proto::metrics::{KindMetrics, LearnerMetrics, ProposalMetrics};

/// Returns a number of an update; `None` where it does not apply.
pub(crate) type Look = fn(&LearnerMetrics) -> Option<f64>;

/// Charted numbers: name in `/api/history`, name for people, and value; `None` where there is nothing to chart.
pub(crate) const CHARTED: [(&str, &str, Look); 8] = [
    ("share_join", "share of join", |l| Some(of(l, Kind::Join)?.share)),
    ("share_detach", "share of detach", |l| Some(of(l, Kind::Detach)?.share)),
    ("share_hold", "share of hold", |l| Some(of(l, Kind::Hold)?.share)),
    ("success_join", "success of join", |l| of(l, Kind::Join)?.success),
    ("success_detach", "success of detach", |l| of(l, Kind::Detach)?.success),
    ("first_proposal_entropy", "entropy 1st proposal", |l| l.proposals.as_ref().map(|p| p.first_proposal_entropy)),
    ("second_block_entropy", "entropy 2nd block", |l| l.proposals.as_ref().map(|p| p.second_block_entropy)),
    ("second_proposal_entropy", "entropy 2nd proposal", |l| l.proposals.as_ref().map(|p| p.second_proposal_entropy)),
];

/// Iterates over the kinds that are known, in their order; whatever else came from the bus is left out.
pub(crate) fn kinds(proposals: &ProposalMetrics) -> impl Iterator<Item = (Kind, &KindMetrics)> {
    Kind::ALL.into_iter().filter_map(|kind| Some((kind, proposals.kinds.get(kind.name())?)))
}

/// Returns whether the numbers are ones that draws can have.
pub(super) fn are_believable(proposals: &ProposalMetrics) -> bool {
    let ProposalMetrics { first_proposal_entropy, second_block_entropy, second_proposal_entropy, kinds } = proposals;
    let is_share = |share: f64| (0.0..=1.0).contains(&share);
    [first_proposal_entropy, second_block_entropy, second_proposal_entropy].into_iter().all(|x| x.is_finite())
        && kinds
            .values()
            .all(|kind| kind.n_tries <= kind.n_draws && is_share(kind.share) && kind.success.is_none_or(is_share))
}

fn of(learner: &LearnerMetrics, kind: Kind) -> Option<&KindMetrics> {
    learner.proposals.as_ref()?.kinds.get(kind.name())
}
