//! Videos of a small hand-made episode, checked by decoding their bytes.

use blueprints::{BlockIdx, Blueprint, Catalog, N_BLOCKS};
use proto::{
    Action, ActorId, EpisodeStats, Gripper, Observation, Pose, RewardTerms, Scene, Start, Status, Task, Trajectory,
    Transition, Valid, WeightsVersion,
};

use super::*;
use crate::picture::{GRIPPER_COLORS, Image, Rgb, WHITE};

const STILL: [f32; 4] = [0.0, 0.0, 0.0, 1.0];

fn goal() -> &'static Blueprint {
    Catalog::builtin().iter().next().unwrap()
}

/// Blocks in rows of four. The first one is held and moved aside by `along_m`.
fn scene(along_m: f32) -> Scene {
    let row = |i: usize| [(i % 4) as f32 * 0.5, (i / 4) as f32 * 0.5, 0.05];
    let mut blocks = std::array::from_fn(|i| Pose { position: row(i), orientation: STILL });
    blocks[0].position = [along_m, -0.5, 0.05];
    let gripper = Gripper { held: BlockIdx::all().next(), ..Gripper::IDLE };
    Scene { grippers: [Some(gripper), None], ..Scene::at_rest(blocks) }
}

/// Steps `first` to `last` of an episode of four. The first block moves 0.4 m per step, for a reward of 1 each.
pub(super) fn segment(first: u16, last: u16) -> Trajectory {
    let action = Action { choices: [BlockIdx::all().next(), None], moves: [[0.0; 6]; N_BLOCKS] };
    let reward = RewardTerms { connected: 1.0, ..RewardTerms::default() };
    let transition = |step: u16| Transition {
        scene: scene(0.4 * f32::from(step)),
        action: action.clone(),
        proposals: [None; 2],
        behavior_log_prob: 0.0,
        reward,
        disturbance: None,
    };
    let status = if last == 4 { Status::Success } else { Status::Running };
    let stats = EpisodeStats { success: true, n_steps: 4, episode_return: reward };
    Trajectory {
        actor: ActorId::try_from("by-hand".to_owned()).unwrap(),
        epoch: 0,
        seq: first.into(),
        weights_version: WeightsVersion(0),
        settings_hash: 0,
        task: Task {
            blueprint: goal().id().clone(),
            assignment: BlockIdx::array(|block| block),
            start: Start::Scattered,
            seed: 1,
        },
        behavior_policy: proto::BehaviorPolicy::Sampled,
        first_step: first,
        transitions: (first..last).map(transition).collect(),
        last_scene: scene(0.4 * f32::from(last)),
        status,
        episode_stats: (status == Status::Success).then_some(stats),
    }
}

fn episode() -> Episode {
    Episode::new(&segment(0, 4), goal()).unwrap()
}

/// Mean column of the pixels of a color in the left 70 % of an image.
fn mean_column(image: &Image, color: Rgb) -> f32 {
    let world = image.width() * 7 / 10;
    let columns: Vec<usize> = (0..image.pixels().len())
        .filter(|i| image.pixels()[*i] == color)
        .map(|i| i % image.width())
        .filter(|x| *x < world)
        .collect();
    assert!(columns.len() > 10, "{} pixels of {color:?}", columns.len());
    columns.iter().sum::<usize>() as f32 / columns.len() as f32
}

#[test]
fn an_episode_has_its_own_goal() {
    assert_eq!(episode().return_after(episode().n_done(0.25)).total(), 2.0);
    let another = Catalog::builtin().iter().nth(1).unwrap();
    let error = Episode::new(&segment(0, 4), another).unwrap_err();
    assert!(error.to_string().contains(another.id().as_str()), "{error}");
}

#[test]
fn a_held_block_moves_evenly() {
    let episode = episode();
    let mut video = Video::new(&episode, 480);
    let frames = [0.0, 0.1, 0.15, 0.2].map(|time_s| video.frame(time_s));
    let [_, b, c, d] = frames.each_ref().map(|frame| mean_column(frame, GRIPPER_COLORS[0]));
    // 1 m is about 200 pixels here, and sideways motion appears 0.85 times as long: 0.4 m are about 70 pixels.
    assert!((50.0..90.0).contains(&(d - b)), "{b} to {d}");
    assert!((c - 0.5 * (b + d)).abs() < 2.0, "{b}, {c}, {d}");
}

#[test]
fn video_shows_the_goal_next_to_the_world() {
    let episode = episode();
    let frame = Video::new(&episode, 960).frame(0.0);
    // The panel takes the last 27 % of the width. Only magnets are red or blue in it, and the goal has both.
    let left = 960 - 960 * 27 / 100;
    let panel = || frame.pixels().chunks_exact(960).flat_map(|row| &row[left..]);
    let n_red = panel().filter(|[r, g, b]| r / 2 > *g && r / 2 > *b).count();
    let n_blue = panel().filter(|[r, g, b]| b / 2 > *r && b > g).count();
    assert!(n_red.min(n_blue) > 100 && panel().filter(|color| **color == WHITE).count() > 1000, "{n_red} {n_blue}");
    // Only the last frame shows success.
    let last = Video::new(&episode, 960).frame(9.0);
    let banner = |image: &Image| image.pixels()[535 * 960 + left + 5];
    assert_ne!(banner(&frame), banner(&last));
}

/// The content of the box at `path` in an MP4 file.
fn mp4_box<'a>(bytes: &'a [u8], path: &[&str]) -> &'a [u8] {
    let Some((name, rest)) = path.split_first() else { return bytes };
    let mut at = bytes;
    while at.len() >= 8 {
        let length = u32::from_be_bytes(at[..4].try_into().unwrap()) as usize;
        if &at[4..8] == name.as_bytes() {
            return mp4_box(&at[8..length], rest);
        }
        at = &at[length..];
    }
    panic!("no box {name}")
}

#[test]
fn mp4_contains_every_frame_and_decodes() {
    let episode = episode();
    let frames: Vec<Image> = Video::new(&episode, 480).frames(10).collect();
    // Five scenes, and 2 seconds of the last one.
    assert_eq!(frames.len(), 5 + 20);
    let bytes = mp4(frames.iter().cloned(), 10).unwrap();
    let table = |name| mp4_box(&bytes, &["moov", "trak", "mdia", "minf", "stbl", name]);
    let sizes: Vec<usize> =
        table("stsz")[12..].chunks_exact(4).map(|n| u32::from_be_bytes(n.try_into().unwrap()) as usize).collect();
    assert_eq!(sizes.len(), frames.len());
    // Each frame consists of units with a length prefix; the decoder expects a start code instead. The first frame
    // contains the decoder configuration.
    let mut data = mp4_box(&bytes, &["mdat"]);
    assert_eq!(data.len(), sizes.iter().sum::<usize>());
    let mut decoder = openh264::decoder::Decoder::new().unwrap();
    let mut n_decoded = 0;
    for size in sizes {
        let (mut units, rest) = data.split_at(size);
        data = rest;
        let mut stream = Vec::new();
        while !units.is_empty() {
            let length = u32::from_be_bytes(units[..4].try_into().unwrap()) as usize;
            stream.extend([0, 0, 0, 1]);
            stream.extend(&units[4..4 + length]);
            units = &units[4 + length..];
        }
        n_decoded += usize::from(decoder.decode(&stream).unwrap().is_some());
    }
    n_decoded += decoder.flush_remaining().unwrap().len();
    assert_eq!(n_decoded, frames.len());
    assert_eq!(bytes, mp4(frames, 10).unwrap(), "equal frames give equal bytes");
}

#[test]
fn gif_contains_every_frame_unchanged() {
    let episode = episode();
    let frames: Vec<Image> = Video::new(&episode, 480).frames(10).collect();
    let bytes = gif(frames.iter().cloned(), 10).unwrap();
    let mut options = ::gif::DecodeOptions::new();
    options.set_color_output(::gif::ColorOutput::RGBA);
    let mut decoder = options.read_info(bytes.as_slice()).unwrap();
    let width = frames[0].width();
    let mut canvas = vec![[0_u8; 3]; width * frames[0].height()];
    let mut n_decoded = 0;
    while let Some(frame) = decoder.read_next_frame().unwrap() {
        assert_eq!(frame.delay, 10);
        for (i, pixel) in frame.buffer.chunks_exact(4).enumerate().filter(|(_, pixel)| pixel[3] > 0) {
            let x = i % usize::from(frame.width);
            let y = i / usize::from(frame.width);
            let at = (y + usize::from(frame.top)) * width + x + usize::from(frame.left);
            canvas[at].copy_from_slice(&pixel[..3]);
        }
        let off = |(a, b): (&Rgb, &Rgb)| (0..3).map(|i| a[i].abs_diff(b[i])).max().unwrap();
        let n_far = canvas.iter().zip(frames[n_decoded].pixels()).map(off).filter(|off| *off > 24).count();
        assert!(n_far < canvas.len() / 500, "{n_far} pixels of frame {n_decoded} have other colors");
        n_decoded += 1;
    }
    assert_eq!(n_decoded, frames.len());
}

#[test]
fn unsupported_frames_are_refused() {
    let blank = |width| Image::filled(width, 4, WHITE);
    assert!(matches!(mp4([], 10), Err(VideoError::NoFrames)));
    assert!(matches!(gif([], 10), Err(VideoError::NoFrames)));
    assert!(matches!(mp4([blank(4)], 0), Err(VideoError::Rate(0, _))));
    assert!(matches!(gif([blank(4)], 51), Err(VideoError::Rate(51, 50))));
    assert!(matches!(mp4([blank(5)], 10), Err(VideoError::Size(5, _))));
    assert!(matches!(gif([blank(4), blank(6)], 10), Err(VideoError::Size(6, _))));
}

#[test]
fn strip_shows_the_goal_and_the_scenes_in_rows_of_four() {
    // Tiles are (600 − 3 · 8) / 4 = 144 wide and 96 high, with 26 pixels of text and 8 between: 2 · 130 − 8.
    let strip = strip(&episode(), 600);
    assert_eq!((strip.width(), strip.height()), (600, 252));
}

/// An untrained policy with two layers of three heads.
fn policy(n_grippers: u8, attention: bool) -> policy::Policy {
    let gat = policy::GatConfig { n_layers: 2, n_heads: 3, head_dim: 4, mlp_hidden: 8, attention };
    let encoder = policy::EncoderConfig::Gat(gat);
    let network = policy::NetworkConfig { encoder, width: 8, value_hidden: vec![8], ..Default::default() };
    let features = policy::FeatureConfig { n_grippers, ..Default::default() };
    let config = policy::PolicyConfig { network, features, ..Default::default() };
    policy::Policy::new(&Valid::new(config).unwrap())
}

#[test]
fn attention_covers_every_head_and_refuses_other_worlds() {
    let episode = episode();
    let attention = EpisodeAttention::new(&policy(1, true), &episode).unwrap();
    let mut video = AttentionVideo::new(&attention, 640);
    let frames: Vec<Image> = video.frames(10).collect();
    assert_eq!(frames.len(), 5 + 15);
    // Four tiles in a row, (640 − 3 · 6) / 4 = 155 wide and 87 high with 22 pixels of text; three rows, and the legend.
    assert_eq!((frames[0].width(), frames[0].height()), (640, 352));
    assert!(mp4(frames, 10).is_ok());
    // Tiles are (602 − 152) / 5 − 6 = 84 wide and 47 high, 6 pixels between: the world, a gripper, and six heads.
    let strip = attention_strip(&attention, 602);
    assert_eq!((strip.width(), strip.height()), (152 + 5 * 90, 22 + 8 * 53 + 24));
    // The two blocks of the goal are each other's planned neighbors; block 0 is held, and nothing is connected.
    let observation = Observation { scene: &episode.scenes()[2], blueprint: episode.goal() };
    let seen = &policy(1, true).attention(&[observation])[0];
    let [a, b] = [0, 1].map(|i| episode.goal().placements()[i].block);
    let row = |block| seen.row(1, 2, block);
    let shares = attention.shares(1, 2, 2);
    assert!((shares.planned - 0.5 * (row(a)[b.get()] + row(b)[a.get()])).abs() < 1e-5, "{shares:?}");
    assert!((shares.held - 0.5 * (row(a)[0] + row(b)[0])).abs() < 1e-5 && shares.joined == 0.0, "{shares:?}");
    // Of 15 others, one is the neighbor; block 0 is held and belongs to the goal, so one of two receivers sees it.
    let uniform = attention.uniform_shares(2);
    assert!((uniform.planned - 1.0 / 15.0).abs() < 1e-6 && uniform.joined == 0.0, "{uniform:?}");
    assert!((uniform.held - 0.5 / 15.0).abs() < 1e-6, "{uniform:?}");
    let mean = Shares::mean([shares, uniform]);
    assert!((mean.held - 0.5 * (shares.held + uniform.held)).abs() < 1e-6);
    assert_eq!(Shares::mean([]), Shares::default());
    // The episode has one gripper.
    let refused = |policy| EpisodeAttention::new(&policy, &episode).unwrap_err();
    assert_eq!(refused(policy(2, true)), AttentionError::Grippers(1, 2));
    assert_eq!(refused(policy(1, false)), AttentionError::NoAttention);
}
