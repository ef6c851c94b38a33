//! What a policy attends to through an episode: numbers first, then the world with blocks shaded by them.

use std::fmt;

use blueprints::{BlockIdx, N_BLOCKS};
use policy::{Attention, Policy};
use proto::{Observation, Scene};

use super::episode::Episode;
use super::stage::Stage;
use crate::picture::{Finish, GRIPPER_COLORS, Image, Painter, Rgb, mix, of_scene};

/// Colors of no attention, of some, and of [`FULL`] and more.
const RAMP: [Rgb; 3] = [[240, 242, 246], [247, 164, 66], [140, 14, 84]];

/// The share of attention with the ramp's last color: few heads give a block more.
pub(super) const FULL: f32 = 0.5;

/// Lines are drawn from a block to those that have at least this share of its attention.
const LINE_FROM: f32 = 0.2;

const LINE: Rgb = [30, 60, 130];

/// Scenes whose attention is computed together.
const BATCH: usize = 16;

/// Why there is nothing to show.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum AttentionError {
    /// The encoder weighs all blocks alike.
    #[error("this network has no attention in its layers")]
    NoAttention,
    /// The policy sees another world.
    #[error("the episode has {episode} grippers and the network {network}")]
    Grippers {
        /// Of the episode.
        episode: usize,
        /// Of the network.
        network: usize,
    },
}

/// What a policy attends to in every scene of an episode.
#[derive(Clone, Debug)]
pub struct EpisodeAttention<'e> {
    pub(super) episode: &'e Episode,
    scenes: Vec<Attention>,
}

/// One of the things that a policy attends with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AttentionSource {
    /// A gripper, when it chooses what to hold.
    Gripper(usize),
    /// A head of a layer, when the blocks of the goal gather what others have to say.
    Head { layer: usize, head: usize },
}

impl fmt::Display for AttentionSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Gripper(gripper) => write!(f, "gripper {}", gripper + 1),
            Self::Head { layer, head } => write!(f, "layer {}, head {}", layer + 1, head + 1),
        }
    }
}

/// Shares of the attention of the goal's blocks, 0 to 1. They overlap, and need not add up to 1.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Shares {
    /// On blocks that the goal connects them with.
    pub(super) planned: f32,
    /// On blocks that they are connected with.
    pub(super) joined: f32,
    /// On blocks that a gripper holds.
    pub(super) held: f32,
}

impl<'e> EpisodeAttention<'e> {
    /// What `policy` attends to in the episode, whoever acted in it.
    ///
    /// # Errors
    /// When the policy's network has no attention or another number of grippers than the episode.
    pub fn new(policy: &Policy, episode: &'e Episode) -> Result<Self, AttentionError> {
        let network = usize::from(policy.config().network.n_grippers);
        let grippers = episode.scenes()[0].grippers.iter().flatten().count();
        if grippers != network {
            return Err(AttentionError::Grippers { episode: grippers, network });
        }
        let mut scenes = Vec::with_capacity(episode.scenes().len());
        let seen = |scene| Observation { scene, blueprint: episode.goal() };
        for some in episode.scenes().chunks(BATCH) {
            scenes.extend(policy.attention(&some.iter().map(seen).collect::<Vec<_>>()));
        }
        if scenes[0].n_layers() == 0 { Err(AttentionError::NoAttention) } else { Ok(Self { episode, scenes }) }
    }

    pub(super) fn n_layers(&self) -> usize {
        self.scenes[0].n_layers()
    }

    pub(super) fn n_heads(&self) -> usize {
        self.scenes[0].n_heads()
    }

    pub(super) fn n_grippers(&self) -> usize {
        self.scenes[0].n_grippers()
    }

    /// Everything that attends: grippers first, then the heads of one layer after the other.
    pub fn sources(&self) -> impl Iterator<Item = AttentionSource> + use<> {
        let (n_layers, n_heads) = (self.n_layers(), self.n_heads());
        let heads =
            (0..n_layers).flat_map(move |layer| (0..n_heads).map(move |head| AttentionSource::Head { layer, head }));
        (0..self.n_grippers()).map(AttentionSource::Gripper).chain(heads)
    }

    /// Scenes of the episode.
    pub fn n_scenes(&self) -> usize {
        self.scenes.len()
    }

    /// Share of the attention that each block gets after so many steps: of a gripper's, or of that of the goal's blocks.
    pub fn received(&self, source: AttentionSource, n_done: usize) -> [f32; N_BLOCKS] {
        let seen = &self.scenes[n_done];
        let mut received = [0.0; N_BLOCKS];
        match source {
            AttentionSource::Gripper(gripper) => received.copy_from_slice(seen.choice(gripper)),
            AttentionSource::Head { layer, head } => {
                let share = 1.0 / self.episode.goal().placements().len() as f32;
                for receiver in self.receivers() {
                    let row = seen.row(layer, head, receiver);
                    received.iter_mut().zip(row).for_each(|(sum, weight)| *sum += share * weight);
                }
            }
        }
        received
    }

    /// What the attention of a head is on after so many steps.
    pub(super) fn shares(&self, layer: usize, head: usize, n_done: usize) -> Shares {
        let (goal, scene) = (self.episode.goal(), &self.episode.scenes()[n_done]);
        let mut shares = Shares::default();
        let each = 1.0 / goal.placements().len() as f32;
        for receiver in self.receivers() {
            let row = self.scenes[n_done].row(layer, head, receiver);
            for sender in BlockIdx::all() {
                let weight = each * row[sender.get()];
                let is_joined =
                    |joint: &proto::Joint| [(joint.a, joint.b), (joint.b, joint.a)].contains(&(receiver, sender));
                shares.planned += if goal.link(receiver, sender).is_some() { weight } else { 0.0 };
                shares.joined += if scene.joints.iter().any(is_joined) { weight } else { 0.0 };
                shares.held += if is_held(scene, sender) { weight } else { 0.0 };
            }
        }
        shares
    }

    /// The world after so many steps, blocks shaded by the attention they get, lines from blocks to what they attend to.
    pub(super) fn picture(
        &self,
        source: AttentionSource,
        n_done: usize,
        stage: &Stage,
        painter: &mut Painter,
    ) -> Image {
        let scene = &self.episode.scenes()[n_done];
        let received = self.received(source, n_done);
        let mut blocks = of_scene(scene);
        for block in &mut blocks {
            let frame = match block.finish {
                Finish::Framed(color) => Some(color),
                _ => None,
            };
            block.finish = Finish::Shaded { fill: shade(received[block.block.get()]), frame };
        }
        let mut image = stage.paint(painter, &blocks);
        let AttentionSource::Head { layer, head } = source else { return image };
        for receiver in self.receivers() {
            let row = self.scenes[n_done].row(layer, head, receiver);
            for sender in BlockIdx::all().filter(|sender| row[sender.get()] >= LINE_FROM) {
                let ends = [receiver, sender].map(|block| scene.blocks[block.get()].position);
                stage.line(&mut image, ends, LINE, (80.0 + 175.0 * row[sender.get()]) as u8);
            }
        }
        image
    }

    fn receivers(&self) -> impl Iterator<Item = BlockIdx> {
        self.episode.goal().placements().iter().map(|placement| placement.block)
    }
}

fn is_held(scene: &Scene, block: BlockIdx) -> bool {
    scene.grippers.iter().flatten().any(|gripper| gripper.held == Some(block))
}

/// Color of a share of attention.
pub(super) fn shade(share: f32) -> Rgb {
    // Equal attention to all, 1 of 15, is to look pale and yet not like none.
    let along = (share / FULL).clamp(0.0, 1.0).powf(0.8) * 2.0;
    if along <= 1.0 { mix(RAMP[0], RAMP[1], along) } else { mix(RAMP[1], RAMP[2], along - 1.0) }
}

impl AttentionSource {
    /// Name and color in captions.
    pub(super) fn caption(self, n_grippers: usize) -> (String, Rgb) {
        match self {
            Self::Gripper(_) if n_grippers == 1 => ("gripper's choice".to_owned(), GRIPPER_COLORS[0]),
            Self::Gripper(idx) => (format!("gripper {}'s choice", idx + 1), GRIPPER_COLORS[idx]),
            Self::Head { layer, head } => (format!("layer {}, head {}", layer + 1, head + 1), super::film::INK),
        }
    }
}
