//! What the mixture head drew in an update, and whether it did what it was for.

use blueprints::{BlockIdx, Blueprint};
use policy::mixture::ActionRows;
use policy::proposals::{Kind, Slot};
use proto::metrics::{KindMetrics, ProposalMetrics};
use proto::{N_GRIPPERS, Scene, Transition};

/// The draws of one action from the mixture head.
#[derive(Clone, Debug, PartialEq)]
pub struct Draws {
    /// The proposal of each gripper.
    pub slots: [Option<Slot>; N_GRIPPERS],
    /// What they were chosen among.
    pub rows: ActionRows,
    /// Whether the step did what each proposal is for; `None` if there was nothing to do.
    pub did: [Option<bool>; N_GRIPPERS],
}

/// Returns for each gripper whether the step from `transition` to `after` made or broke the connection that its
/// proposal is for; `None` if there was none to make or break.
pub(crate) fn did(
    transition: &Transition,
    slots: &[Option<Slot>; N_GRIPPERS],
    after: &Scene,
    blueprint: &Blueprint,
) -> [Option<bool>; N_GRIPPERS] {
    std::array::from_fn(|gripper| {
        let (block, slot) = (transition.action.choices[gripper]?, slots[gripper]?);
        let partner = slot.partner()?;
        let [before, after] = [&transition.scene, after].map(|scene| connection(scene, blueprint, block, partner));
        let wanted = Some(true);
        match slot.kind() {
            Kind::Join => {
                let is_open = blueprint.link(block, partner).is_some() && before != wanted;
                is_open.then_some(after == wanted)
            }
            Kind::Detach => (before == Some(false)).then_some(after != Some(false)),
            Kind::Hold => None,
        }
    })
}

/// Returns whether the connection of two blocks is the one that the blueprint wants; `None` if they have none.
fn connection(scene: &Scene, blueprint: &Blueprint, a: BlockIdx, b: BlockIdx) -> Option<bool> {
    let joint = scene.joints.iter().find(|joint| (joint.a, joint.b) == (a.min(b), a.max(b)))?;
    Some(joint.is_right(blueprint))
}

/// Summarizes the draws of all samples, and the entropies of their choices.
pub(crate) fn metrics(draws: &[Draws], entropies: &[[f32; 3]]) -> ProposalMetrics {
    let drawn = draws.iter().flat_map(|draws| draws.slots.into_iter().zip(draws.did));
    let drawn: Vec<_> = drawn.filter_map(|(slot, did)| Some((slot?.kind(), did))).collect();
    let of_kind = |kind: Kind| {
        let did: Vec<_> = drawn.iter().filter(|(of, _)| *of == kind).map(|(_, did)| *did).collect();
        let tries: Vec<bool> = did.iter().copied().flatten().collect();
        let n_successes = tries.iter().filter(|succeeded| **succeeded).count();
        KindMetrics {
            n_draws: did.len() as u64,
            n_tries: tries.len() as u64,
            share: did.len() as f64 / drawn.len().max(1) as f64,
            success: (!tries.is_empty()).then(|| n_successes as f64 / tries.len() as f64),
        }
    };
    let kinds = Kind::ALL.into_iter().map(|kind| (kind.name().to_owned(), of_kind(kind))).collect();
    let mean = |part: usize| {
        let made = draws.iter().zip(entropies).filter(|(draws, _)| !draws.rows.all()[part].is_empty());
        let (n, total) = made.fold((0_u64, 0.0), |(n, total), (_, of)| (n + 1, total + f64::from(of[part])));
        total / n.max(1) as f64
    };
    let [first_proposal_entropy, second_block_entropy, second_proposal_entropy] = [0, 1, 2].map(mean);
    ProposalMetrics { first_proposal_entropy, second_block_entropy, second_proposal_entropy, kinds }
}

#[cfg(test)]
mod tests {
    use proto::Joint;

    use super::*;
    use crate::tests::fixtures::{blueprint_id, trajectory};

    #[test]
    fn a_draw_succeeds_if_its_step_makes_or_breaks_the_connection() {
        let blueprint = blueprints::Catalog::builtin().get(&blueprint_id()).unwrap();
        let link = blueprint.links()[0];
        let (a, b) = (link.a, link.b);
        let right = Joint { a, b, relative: link.relative };
        let mut wrong = right;
        wrong.relative.offset_half_units[0] += 1;
        let other = BlockIdx::all().find(|block| !blueprint.contains(*block)).unwrap();
        let of = Slot::paired;
        let [done, not, nothing] = [Some(true), Some(false), None];
        for (slot, before, after, expected) in [
            (of(Kind::Join, b), None, Some(right), done),
            (of(Kind::Join, b), Some(wrong), Some(right), done),
            (of(Kind::Join, b), None, None, not),
            (of(Kind::Join, b), None, Some(wrong), not),
            (of(Kind::Join, b), Some(right), Some(right), nothing),
            (of(Kind::Join, other), None, None, nothing),
            (of(Kind::Detach, b), Some(wrong), None, done),
            (of(Kind::Detach, b), Some(wrong), Some(right), done),
            (of(Kind::Detach, b), Some(wrong), Some(wrong), not),
            (of(Kind::Detach, b), Some(right), None, nothing),
            (Slot::HOLD, None, Some(right), nothing),
        ] {
            let mut segment = trajectory(1, 1);
            segment.transitions[0].scene.joints.extend(before);
            segment.last_scene.joints.extend(after);
            segment.transitions[0].action.choices = [Some(a), None];
            let found = did(&segment.transitions[0], &[Some(slot), None], &segment.last_scene, blueprint);
            assert_eq!(found, [expected, None], "{slot:?}: {before:?} {after:?}");
            // The same pair from the other side.
            if slot.partner() == Some(b) {
                segment.transitions[0].action.choices = [None, Some(b)];
                let mirrored = [None, Some(Slot::paired(slot.kind(), a))];
                let found = did(&segment.transitions[0], &mirrored, &segment.last_scene, blueprint);
                assert_eq!(found, [None, expected], "{slot:?}, mirrored");
            }
        }
    }
}
