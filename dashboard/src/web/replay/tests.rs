//! A replay worked out by hand.

use proto::{Action, EpisodeStats, Gripper, Pose, RewardTerms, Start, Task, Transition, WeightsVersion};

use super::*;

/// An episode of three steps, which succeeds.
pub(crate) fn recording() -> Trajectory {
    let scene = |step: u16| {
        let pose = Pose { position: [0.0, 0.123_456, step.into()], orientation: [0.0, 0.0, 0.0, 1.0] };
        let grippers = [Some(Gripper { held: BlockIdx::all().nth(3), ..Gripper::IDLE }), Some(Gripper::IDLE)];
        Scene { grippers, ..Scene::at_rest([pose; 16]) }
    };
    let reward = RewardTerms { connected: 0.5, ..RewardTerms::default() };
    let transition = |step: u16| Transition {
        scene: scene(step),
        action: Action { choices: [BlockIdx::all().next(); 2], moves: [[0.0; 6]; 16] },
        proposals: [None; 2],
        behavior_log_prob: 0.0,
        reward,
        disturbance: None,
    };
    Trajectory {
        actor: "a".parse().unwrap(),
        epoch: 1,
        seq: 0,
        weights_version: WeightsVersion(7),
        settings_hash: 0,
        task: Task {
            blueprint: "2_000".parse().unwrap(),
            assignment: BlockIdx::array(|block| block),
            start: Start::Scattered,
            seed: 2,
        },
        behavior_policy: proto::BehaviorPolicy::Sampled,
        first_step: 0,
        transitions: (0..3).map(transition).collect(),
        last_scene: scene(3),
        status: Status::Success,
        episode_stats: Some(EpisodeStats { success: true, n_steps: 3, episode_return: reward }),
    }
}

#[test]
fn a_hand_worked_replay() {
    let recording = recording();
    let goal = Catalog::builtin().get(&"2_000".parse().unwrap()).unwrap();
    let json = serde_json::to_value(view(&recording, goal, |_| None).unwrap()).unwrap();
    assert_eq!(
        (&json["blueprint"], &json["end"], &json["weights_version"]),
        (&"2_000".into(), &"success".into(), &7.into())
    );
    assert_eq!(json["goal"].as_array().unwrap().len(), 2);
    // Three steps make four scenes; each step is worth 0.5.
    let scenes = json["scenes"].as_array().unwrap();
    let rewards: Vec<f64> = scenes.iter().map(|scene| scene["reward"].as_f64().unwrap()).collect();
    assert_eq!(rewards, [0.0, 0.5, 1.0, 1.5]);
    assert_eq!(scenes[3]["reward_terms"]["connected"], 1.5);
    assert_eq!(scenes[3]["reward_terms"]["wrong"], 0.0);
    // Nothing is connected, so the block that is placed first determines the goal's frame; here it stands as in the
    // goal.
    let frame = goal_frame(goal, &recording.transitions[0].scene);
    let placement = goal.placements().iter().find(|p| goal.rank(p.block) == Some(0)).unwrap();
    let turn = UnitQuaternion::new_normalize(Quaternion::from([frame[3], frame[4], frame[5], frame[6]]));
    let at = turn * placement.position_m() + Vector3::new(frame[0], frame[1], frame[2]);
    assert!((at - Vector3::new(0.0, 0.1235, 0.0)).norm() < 1e-3, "{at}");
    assert_eq!(json["links"].as_array().unwrap().len(), goal.links().len());
    assert_eq!([&json["names"][0], &json["names"][15]], ["cube 1", "slab 2"]);
    assert_eq!(scenes[0]["held"], serde_json::json!([3, null]));
    let y = scenes[0]["blocks"][0][1].as_f64().unwrap();
    assert!((y - 0.1235).abs() < 1e-6, "{y}");
}
