//! The draws of the mixture head.

use policy::proposals::Kind;
use proto::metrics::{KindMetrics, ProposalMetrics};

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
