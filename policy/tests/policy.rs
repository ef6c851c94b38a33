//! Inference: refused weights, the inputs of a decision, and the initial values.

#![allow(clippy::unwrap_used)]

use std::collections::BTreeMap;

use blueprints::{BlockIdx, Blueprint, Catalog};
use burn::tensor::Device;
use policy::mixture::{ActionRows, MixtureDistribution, N_READOUTS};
use policy::normalization::FeatureMoments;
use policy::parameters;
use policy::proposals::Proposals;
use policy::{
    BlockMask, EncoderConfig, FeatureBatch, GatConfig, Network, NetworkConfig, Policy, PolicyConfig, ResnetConfig,
};
use proto::{
    ActionMode, Agent, CanonicalSettings, Decision, Joint, Normalization, Observation, Pose, Scene, Valid, Weights,
    WeightsVersion,
};
use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};

/// A small network, for tests that do not depend on its size.
fn small() -> Valid<PolicyConfig> {
    let gat = GatConfig { n_layers: 1, n_heads: 2, head_dim: 8, mlp_hidden: 16, ..GatConfig::default() };
    let network = NetworkConfig {
        encoder: EncoderConfig::Gat(gat),
        width: 8,
        value_hidden: vec![16],
        ..NetworkConfig::default()
    };
    Valid::new(PolicyConfig { network, ..PolicyConfig::default() }).unwrap()
}

/// The same, with the blueprint's mask.
fn masked() -> Valid<PolicyConfig> {
    small().with(|config| config.mask = BlockMask::Blueprint).unwrap()
}

fn weights(config: &PolicyConfig, seed: u64) -> Weights {
    let network = Network::init(&config.network, &config.sizes(), seed, &Device::flex());
    Weights {
        version: WeightsVersion(seed),
        n_env_steps: 0,
        network_hash: config.hash(),
        settings: CanonicalSettings::default().with("policy", config),
        parameters: parameters::flatten(&network),
        normalization: Normalization::default(),
        task_probabilities: BTreeMap::new(),
    }
}

fn blueprint() -> &'static Blueprint {
    Catalog::builtin().iter().next().unwrap()
}

fn scene(seed: u64) -> Scene {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    Scene::at_rest(std::array::from_fn(|_| Pose {
        position: [rng.random_range(-1.0..1.0), rng.random_range(-1.0..1.0), 0.05],
        orientation: [0.0, 0.0, 0.0, 1.0],
    }))
}

fn scenes(seeds: &[u64]) -> Vec<Scene> {
    seeds.iter().map(|seed| scene(*seed)).collect()
}

/// The scenes, each with the first goal of the catalog.
fn observations(scenes: &[Scene]) -> Vec<Observation<'_>> {
    scenes.iter().map(|scene| Observation { scene, blueprint: blueprint() }).collect()
}

/// Acts in the scenes of these seeds, each with its own generator.
fn act(policy: &mut Policy, seeds: &[u64]) -> Vec<Decision> {
    let modes = vec![ActionMode::Sampled; seeds.len()];
    policy.act(&observations(&scenes(seeds)), &modes, &mut rngs(seeds)).unwrap()
}

fn values(policy: &mut Policy, seeds: &[u64]) -> Vec<f32> {
    act(policy, seeds).iter().map(|decision| decision.value).collect()
}

fn rngs(seeds: &[u64]) -> Vec<ChaCha8Rng> {
    seeds.iter().map(|seed| ChaCha8Rng::seed_from_u64(*seed)).collect()
}

#[test]
fn weights_that_do_not_fit_are_refused_and_the_old_ones_stay() {
    let config = small();
    let mut policy = Policy::with_weights(&config, &weights(&config, 1)).unwrap();
    let before = values(&mut policy, &[1, 2]);
    type Spoil = fn(&mut Weights);
    let cases: [(Spoil, &str); 10] = [
        (|w| w.settings = CanonicalSettings::default().with("policy", &PolicyConfig::default()), "other settings"),
        (|w| w.network_hash ^= 1, "this process runs"),
        // Finite, but their sums overflow or are far beyond any trained network's output.
        (|w| w.parameters.fill(1e30), "must be a number in −1e6..=1e6"),
        (|w| w.parameters.fill(1e6), "must be a number in −1e6..=1e6"),
        (|w| w.normalization.value_std = 1e38, "give a value = "),
        (|w| w.parameters.truncate(3), "do not fit"),
        (|w| w.parameters[5] = f32::NAN, "do not fit"),
        (|w| w.normalization.feature_mean[0] = vec![0.0; 3], "normalization.feature_mean[0] = 3 numbers: expected 10"),
        (|w| w.normalization.value_std = 0.0, "normalization.value_std = 0: expected above 0"),
        (|w| w.normalization.value_mean = f32::INFINITY, "normalization.value_mean = inf"),
    ];
    for (spoil, message) in cases {
        let mut spoilt = weights(&config, 2);
        spoil(&mut spoilt);
        let error = policy.load(&spoilt).unwrap_err().to_string();
        assert!(error.contains(message), "{error}");
        assert_eq!(policy.version(), Some(WeightsVersion(1)));
        assert_eq!(values(&mut policy, &[1, 2]), before);
    }
}

#[test]
fn a_scene_without_a_distribution_is_an_error() {
    let config = small();
    let mut policy = Policy::new(&config);
    // Global features 9..25 are the one-hot of the block that the first gripper holds; in the trial scene it is a goal
    // block.
    let stray = BlockIdx::all().find(|block| !blueprint().contains(*block)).unwrap();
    let mut trap = weights(&config, 1);
    let network = Network::init(&config.network, &config.sizes(), 1, &Device::flex());
    for (spec, span) in parameters::spans(network.table()) {
        if spec.name.ends_with("input_global.w") {
            let row = span.start + (9 + stray.get()) * spec.shape[1];
            trap.parameters[row..row + spec.shape[1]].fill(1e30);
        }
    }
    policy.load(&trap).unwrap();
    act(&mut policy, &[1]);
    let mut holding = scene(1);
    holding.grippers[0].as_mut().unwrap().held = Some(stray);
    let sprung = observations(std::slice::from_ref(&holding));
    let mut generators = rngs(&[1]);
    let error = policy.act(&sprung, &[ActionMode::Sampled], &mut generators).unwrap_err();
    assert!(error.is_of_weights() && error.to_string().contains("weights 1 give"), "{error}");
    assert_eq!(generators, rngs(&[1]), "nothing was drawn");
}

#[test]
fn a_decision_depends_on_its_own_scene_and_generator_alone() {
    let config = small();
    let mut policy = Policy::with_weights(&config, &weights(&config, 3)).unwrap();
    let seeds = [4, 5, 6];
    let together = act(&mut policy, &seeds);
    for (seed, decision) in seeds.iter().zip(&together) {
        let alone = &act(&mut policy, &[*seed])[0];
        assert_eq!(alone.action.choices, decision.action.choices);
        assert!((alone.log_prob - decision.log_prob).abs() < 1e-4);
        assert!((alone.value - decision.value).abs() < 1e-5);
    }
    let mut generators = rngs(&seeds);
    policy.act(&observations(&scenes(&seeds)), &[ActionMode::Greedy; 3], &mut generators).unwrap();
    assert_eq!(generators, rngs(&seeds), "the mode draws nothing");
    assert!(act(&mut policy, &[]).is_empty());
}

#[test]
fn the_mask_keeps_choices_in_the_blueprint() {
    let config = masked();
    let mut policy = Policy::new(&config);
    for decision in act(&mut policy, &(0..64).collect::<Vec<_>>()) {
        assert!(decision.action.choices.iter().flatten().all(|block| blueprint().contains(*block)));
        assert!(decision.log_prob.is_finite());
    }
}

#[test]
fn the_mask_admits_blocks_that_may_have_to_be_taken_apart() {
    let inside = blueprint().placements()[0].block;
    let relative = blueprint().relative(inside, blueprint().placements()[1].block).unwrap();
    let strays: [BlockIdx; 3] = {
        let mut outside = BlockIdx::all().filter(|block| !blueprint().contains(*block));
        std::array::from_fn(|_| outside.next().unwrap())
    };
    let joint = |a, b| Joint { a, b, relative };
    let mut batch = FeatureBatch::new(&small().features);
    let scene = Scene { joints: vec![joint(strays[0], inside), joint(strays[1], strays[2])], ..scene(1) };
    batch.push(&Observation { scene: &scene, blueprint: blueprint() });
    let allowed = BlockIdx::all().filter(|block| batch.allowed[0][block.get()]);
    assert!(allowed.eq(BlockIdx::all().filter(|block| blueprint().contains(*block) || strays.contains(block))));
}

#[test]
fn attention_is_shared_out_in_full_and_choices_are_those_of_the_policy() {
    let config = masked();
    let mut policy = Policy::with_weights(&config, &weights(&config, 5)).unwrap();
    let scenes = scenes(&[7, 8]);
    let attention = policy.attention(&observations(&scenes));
    let decisions = policy.act(&observations(&scenes), &[ActionMode::Greedy; 2], &mut rngs(&[7, 8])).unwrap();
    assert_eq!(attention.len(), 2);
    for (seen, decision) in attention.iter().zip(decisions) {
        assert_eq!((seen.n_layers(), seen.n_heads(), seen.n_grippers()), (1, 2, 2));
        let is_whole = |row: &[f32]| (row.iter().sum::<f32>() - 1.0).abs() < 1e-5 && row.iter().all(|w| *w >= 0.0);
        for (receiver, head) in BlockIdx::all().flat_map(|receiver| [0, 1].map(|head| (receiver, head))) {
            let row = seen.row(0, head, receiver);
            assert!(is_whole(row) && row[receiver.get()] == 0.0, "{row:?}");
        }
        for (gripper, chosen) in decision.action.choices.into_iter().enumerate() {
            let row = seen.choice(gripper);
            let likeliest = BlockIdx::all().max_by(|a, b| row[a.get()].total_cmp(&row[b.get()]));
            assert!(is_whole(row) && chosen == likeliest, "{row:?}");
            assert!(BlockIdx::all().all(|block| blueprint().contains(block) || row[block.get()] == 0.0));
        }
    }
    assert!(policy.attention(&[]).is_empty());
}

#[test]
fn values_come_back_in_reward_units() {
    let config = small();
    let mut scaled = weights(&config, 1);
    let mut policy = Policy::with_weights(&config, &scaled).unwrap();
    let raw = values(&mut policy, &[1])[0];
    scaled.normalization.value_mean = -2.0;
    scaled.normalization.value_std = 3.0;
    policy.load(&scaled).unwrap();
    assert!((values(&mut policy, &[1])[0] - (raw * 3.0 - 2.0)).abs() < 1e-5);
}

#[test]
fn statistics_leave_bits_alone_and_center_the_rest() {
    let config = small();
    let mut data = FeatureBatch::new(&config.features);
    data.fill(&observations(&scenes(&(0..50).collect::<Vec<_>>())));
    let mut moments = FeatureMoments::default();
    moments.push(&data);
    let mut statistics = Normalization::default();
    moments.freeze_into(&mut statistics);
    // Globals 9..25 are a one-hot, edge 23 is a bit; edge 18 is an offset.
    assert_eq!((statistics.feature_mean[2][12], statistics.feature_std[2][12]), (0.0, 1.0));
    assert_eq!((statistics.feature_mean[1][23], statistics.feature_std[1][23]), (0.0, 1.0));
    let mut normalized = data.clone();
    policy::normalization::normalize(&mut normalized, &statistics);
    let offsets: Vec<f32> = normalized.edges.chunks(data.sizes.edge).map(|edge| edge[18]).collect();
    let mean = offsets.iter().sum::<f32>() / offsets.len() as f32;
    let variance = offsets.iter().map(|x| (x - mean).powi(2)).sum::<f32>() / offsets.len() as f32;
    assert!(mean.abs() < 1e-3 && (variance - 1.0).abs() < 1e-2, "{mean} {variance}");
    let mut scaled = weights(&config, 1);
    scaled.normalization = statistics;
    Policy::new(&config).load(&scaled).unwrap();
}

#[test]
fn initial_values_follow_haiku() {
    for encoder in [EncoderConfig::default(), EncoderConfig::Resnet(ResnetConfig { hidden: 96, n_blocks: 1 })] {
        let config = NetworkConfig { encoder, ..NetworkConfig::default() };
        let sizes = PolicyConfig::default().sizes();
        let network = Network::init(&config, &sizes, 11, &Device::flex());
        let values = parameters::flatten(&network);
        assert_eq!(values, parameters::flatten(&Network::init(&config, &sizes, 11, &Device::flex())));
        assert_ne!(values, parameters::flatten(&Network::init(&config, &sizes, 12, &Device::flex())));
        for (spec, span) in parameters::spans(network.table()) {
            let part = &values[span];
            let fan_in = spec.shape[0] as f32;
            let fan_out = spec.shape[spec.shape.len() - 1] as f32;
            // A unit normal truncated at ±2 has standard deviation 0.8796.
            let (std, limit) = match spec.name.as_str() {
                name if spec.shape.len() == 1 => {
                    let expected = if name.ends_with(".scale") { 1.0 } else { 0.0 };
                    assert!(part.iter().all(|x| *x == expected), "{name}");
                    continue;
                }
                "head.act_loc.w" | "head.act_scale.w" => {
                    ((1e-4 / fan_in).sqrt(), (1e-4 / fan_in).sqrt() * 2.0 / 0.8796)
                }
                name if name.starts_with("resnet.block") => ((0.333 / fan_out).sqrt(), (0.999 / fan_out).sqrt()),
                _ => (0.8796 / fan_in.sqrt(), 2.0 / fan_in.sqrt()),
            };
            let n = part.len() as f32;
            let ours = (part.iter().map(|x| x * x).sum::<f32>() / n).sqrt();
            assert!((ours / std - 1.0).abs() < 4.0 / n.sqrt(), "{}: {ours}, not {std}", spec.name);
            assert!(part.iter().all(|x| x.abs() <= limit * 1.0001), "{}", spec.name);
        }
    }
}

#[test]
fn the_initial_standard_deviation_is_as_configured() {
    for (init_std, expected) in [(None, 2.0_f32.ln()), (Some(0.5), 0.5), (Some(0.05), 0.05)] {
        let config = small().with(|config| config.network.init_std = init_std).unwrap();
        let decisions = act(&mut Policy::new(&config), &(0..200).collect::<Vec<_>>());
        let squares: Vec<f32> =
            decisions.iter().flat_map(|d| d.action.moves.into_iter().flatten()).map(|x| x * x).collect();
        let std = (squares.iter().sum::<f32>() / squares.len() as f32).sqrt();
        assert!((std / expected - 1.0).abs() < 0.03, "{std}, not {expected}");
    }
}

/// Blocks outside the goal can only be held. At a meter, that moves nothing; from the ground, it lifts them.
#[test]
fn a_greedy_action_that_moves_nothing_gives_way_to_the_next_two_blocks() {
    let mut scene = scene(0);
    let outside = |k: usize| BlockIdx::all().filter(|&block| !blueprint().contains(block)).nth(k).unwrap();
    let [high, higher, highest, low] = std::array::from_fn(outside);
    for block in [high, higher, highest] {
        scene.blocks[block.get()].position[2] = 1.0;
    }
    let proposals = Proposals::new(&Observation { scene: &scene, blueprint: blueprint() });
    let greedy = |order: &[BlockIdx]| {
        let mut logits = [0.0; 32];
        order.iter().enumerate().for_each(|(k, block)| logits[block.get()] = 4.0 - k as f32);
        logits[16 + high.get()] = 4.0;
        let readouts = [0.0; 16 * N_READOUTS];
        let distribution = MixtureDistribution { logits: &logits, readouts: &readouts, proposals: &proposals };
        let drawn = distribution.act(ActionMode::Greedy, &mut ChaCha8Rng::seed_from_u64(0)).unwrap();
        let rows = ActionRows::new(&proposals, &drawn.action.choices, &drawn.slots).unwrap();
        assert_eq!(drawn.log_prob, distribution.log_prob(&drawn.action, &drawn.slots, &rows));
        drawn.action.choices
    };
    assert_eq!(greedy(&[low, high]), [Some(low), Some(high)]);
    assert_eq!(greedy(&[high, low]), [Some(low), Some(high)]);
    assert_eq!(greedy(&[high, higher, low]), [Some(low), Some(high)]);
    assert_eq!(greedy(&[high, higher, highest, low]), [Some(high), Some(high)]);
}
