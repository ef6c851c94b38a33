//! A policy's attention over an episode: the numbers, and the world with blocks shaded by them.

use std::fmt;

use blueprints::{BlockIdx, N_BLOCKS};
use policy::{Attention, Policy};
use proto::Observation;

use super::episode::Episode;
use super::stage::Stage;
use crate::picture::text::INK;
use crate::picture::{GRIPPER_COLORS, Image, Painter, Rgb, holder, mix, of_scene};

/// Colors of no attention, of some, and of [`FULL`] or more.
const RAMP: [Rgb; 3] = [[240, 242, 246], [247, 164, 66], [140, 14, 84]];

/// Share of attention at the end of the color scale; few heads give more to one block.
pub(super) const FULL: f32 = 0.5;

/// Minimum share of attention for which a line is drawn from a block to another.
const LINE_FROM: f32 = 0.2;

const LINE: Rgb = [30, 60, 130];

/// Number of scenes whose attention is computed together.
const BATCH: usize = 16;

/// Reasons why there is no attention to show.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum AttentionError {
    /// The encoder weights all blocks equally.
    #[error("this network has no attention in its layers")]
    NoAttention,
    /// The episode and the policy have different numbers of grippers, these.
    #[error("the episode has {0} grippers and the network {1}")]
    Grippers(usize, usize),
}

/// A policy's attention in every scene of an episode.
#[derive(Clone, Debug)]
pub struct EpisodeAttention<'e> {
    pub(super) episode: &'e Episode,
    scenes: Vec<Attention>,
}

/// A source of attention in a policy.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AttentionSource {
    /// A gripper when it chooses a block.
    Gripper(usize),
    /// A head of a layer, averaged over the goal's blocks.
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

/// Shares of the attention of the goal's blocks, 0 to 1. They overlap and need not sum to 1.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Shares {
    /// On blocks that the goal connects them to.
    pub planned: f32,
    /// On blocks that they are connected to.
    pub joined: f32,
    /// On blocks held by a gripper.
    pub held: f32,
}

impl Shares {
    /// Returns the mean of the shares; zeros for an empty iterator.
    pub fn mean(all: impl IntoIterator<Item = Self>) -> Self {
        let (mut sum, mut n) = (Self::default(), 0.0_f32);
        for Self { planned, joined, held } in all {
            sum = Self { planned: sum.planned + planned, joined: sum.joined + joined, held: sum.held + held };
            n += 1.0;
        }
        let each = 1.0 / n.max(1.0);
        Self { planned: sum.planned * each, joined: sum.joined * each, held: sum.held * each }
    }
}

impl<'e> EpisodeAttention<'e> {
    /// Computes the attention of `policy` in the episode, regardless of which agent acted.
    ///
    /// # Errors
    /// Returns an error if the policy's network has no attention, or a different number of grippers than the episode.
    pub fn new(policy: &Policy, episode: &'e Episode) -> Result<Self, AttentionError> {
        let network = usize::from(policy.config().features.n_grippers);
        let grippers = episode.scenes()[0].grippers.iter().flatten().count();
        if grippers != network {
            return Err(AttentionError::Grippers(grippers, network));
        }
        let seen = |scene| Observation { scene, blueprint: episode.goal() };
        let observations: Vec<_> = episode.scenes().iter().map(seen).collect();
        let scenes: Vec<Attention> = observations.chunks(BATCH).flat_map(|some| policy.attention(some)).collect();
        if scenes[0].n_layers() == 0 {
            return Err(AttentionError::NoAttention);
        }
        Ok(Self { episode, scenes })
    }

    /// Returns the number of layers of the network.
    pub fn n_layers(&self) -> usize {
        self.scenes[0].n_layers()
    }

    /// Returns the number of heads per layer.
    pub fn n_heads(&self) -> usize {
        self.scenes[0].n_heads()
    }

    pub(super) fn n_grippers(&self) -> usize {
        self.scenes[0].n_grippers()
    }

    /// Returns all attention sources: grippers first, then the heads layer by layer.
    pub fn sources(&self) -> impl Iterator<Item = AttentionSource> + use<> {
        let (n_layers, n_heads) = (self.n_layers(), self.n_heads());
        let heads =
            (0..n_layers).flat_map(move |layer| (0..n_heads).map(move |head| AttentionSource::Head { layer, head }));
        (0..self.n_grippers()).map(AttentionSource::Gripper).chain(heads)
    }

    /// Returns the number of scenes in the episode.
    pub fn n_scenes(&self) -> usize {
        self.scenes.len()
    }

    /// Returns the share of attention on each block after `n_done` steps: that of a gripper, or the mean over the
    /// goal's blocks.
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

    /// Returns the block that each block attends to most after `n_done` steps, and the share: by a source, or by the mean
    /// over the heads of the last layer. `None` for a gripper.
    pub fn most(&self, source: Option<AttentionSource>, n_done: usize) -> Option<[(BlockIdx, f32); N_BLOCKS]> {
        let (layer, heads) = match source {
            Some(AttentionSource::Gripper(_)) => return None,
            Some(AttentionSource::Head { layer, head }) => (layer, head..head + 1),
            None => (self.n_layers() - 1, 0..self.n_heads()),
        };
        let share = |from, to: BlockIdx| {
            let weights = heads.clone().map(|head| self.scenes[n_done].row(layer, head, from)[to.get()]);
            weights.sum::<f32>() / heads.len() as f32
        };
        Some(BlockIdx::array(|block| {
            let shares = BlockIdx::all().map(|other| (other, share(block, other)));
            shares.max_by(|(_, a), (_, b)| a.total_cmp(b)).expect("there are blocks")
        }))
    }

    /// Returns the shares of a head's attention after `n_done` steps.
    pub fn shares(&self, layer: usize, head: usize, n_done: usize) -> Shares {
        self.shares_of(n_done, |receiver, sender| self.scenes[n_done].row(layer, head, receiver)[sender.get()])
    }

    /// Returns the shares after `n_done` steps for uniform attention over all other blocks.
    pub fn uniform_shares(&self, n_done: usize) -> Shares {
        let weight = 1.0 / (N_BLOCKS - 1) as f32;
        self.shares_of(n_done, |receiver, sender| if sender == receiver { 0.0 } else { weight })
    }

    fn shares_of(&self, n_done: usize, weight: impl Fn(BlockIdx, BlockIdx) -> f32) -> Shares {
        let goal = self.episode.goal();
        let scene = &self.episode.scenes()[n_done];
        let mut shares = Shares::default();
        let each = 1.0 / goal.placements().len() as f32;
        for receiver in self.receivers() {
            for sender in BlockIdx::all() {
                let weight = each * weight(receiver, sender);
                let is_joined =
                    |joint: &proto::Joint| [(joint.a, joint.b), (joint.b, joint.a)].contains(&(receiver, sender));
                shares.planned += if goal.link(receiver, sender).is_some() { weight } else { 0.0 };
                shares.joined += if scene.joints.iter().any(is_joined) { weight } else { 0.0 };
                shares.held += if holder(scene, sender).is_some() { weight } else { 0.0 };
            }
        }
        shares
    }

    /// Paints the world after `n_done` steps, with blocks shaded by attention and lines to the blocks they attend to.
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
            block.shade = Some(shade(received[block.block.get()]));
        }
        let mut image = stage.paint(painter, &blocks, n_done as f32);
        let AttentionSource::Head { layer, head } = source else { return image };
        let camera = stage.camera(n_done as f32);
        for receiver in self.receivers() {
            let row = self.scenes[n_done].row(layer, head, receiver);
            for sender in BlockIdx::all().filter(|sender| row[sender.get()] >= LINE_FROM) {
                let ends = [receiver, sender].map(|block| scene.blocks[block.get()].position);
                Stage::line(&mut image, &camera, ends, LINE, (80.0 + 175.0 * row[sender.get()]) as u8);
            }
        }
        image
    }

    fn receivers(&self) -> impl Iterator<Item = BlockIdx> {
        self.episode.goal().placements().iter().map(|placement| placement.block)
    }
}

/// Returns the color of a share of attention.
pub(super) fn shade(share: f32) -> Rgb {
    // Uniform attention, 1 of 15, should look pale but different from none.
    let along = (share / FULL).clamp(0.0, 1.0).powf(0.8) * 2.0;
    if along <= 1.0 { mix(RAMP[0], RAMP[1], along) } else { mix(RAMP[1], RAMP[2], along - 1.0) }
}

impl AttentionSource {
    /// Returns the name and color in captions.
    pub(super) fn caption(self, n_grippers: usize) -> (String, Rgb) {
        match self {
            Self::Gripper(_) if n_grippers == 1 => ("gripper's choice".to_owned(), GRIPPER_COLORS[0]),
            Self::Gripper(idx) => (format!("gripper {}'s choice", idx + 1), GRIPPER_COLORS[idx]),
            Self::Head { .. } => (self.to_string(), INK),
        }
    }
}
