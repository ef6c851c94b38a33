//! Lanes of toy worlds whose endings are scripted.

use environment::StepResult;
use policy::PolicyConfig;
use proto::{Gripper, Pose, Scene};

use super::*;

/// A world in which nothing moves and a script says how each step ends.
struct Toy {
    ends: Vec<Status>,
    n_steps: usize,
    diverged: bool,
    scene: Scene,
    blueprint: Blueprint,
}

impl Env for Toy {
    fn reset(&mut self, task: &Task, _: &Catalogue) -> Result<(), ResetError> {
        if task.start == Start::AsItIs && self.diverged {
            return Err(ResetError::NothingToKeep);
        }
        self.diverged = false;
        Ok(())
    }

    fn step(&mut self, action: &Action) -> StepResult {
        // The steps in which a success may settle do not count as steps of an episode.
        if action.moves == [[0.0; 6]; blueprints::N_BLOCKS] {
            return StepResult { reward: RewardTerms::default(), status: Status::Running };
        }
        let status = self.ends[self.n_steps % self.ends.len()];
        self.n_steps += 1;
        self.diverged = status == Status::Diverged;
        StepResult { reward: RewardTerms { wrong: -1.0, ..RewardTerms::default() }, status }
    }

    fn scene(&self) -> &Scene {
        &self.scene
    }

    fn blueprint(&self) -> &Blueprint {
        &self.blueprint
    }
}

fn goal() -> &'static Blueprint {
    Catalogue::builtin().of_split(Split::Train)[0]
}

fn toy(ends: &[Status]) -> Toy {
    let orientation = [0.0, 0.0, 0.0, 1.0];
    let gripper = Gripper { held: None, orientation, linear_velocity: [0.0; 3], angular_velocity: [0.0; 3] };
    let scene = Scene {
        blocks: std::array::from_fn(|i| Pose { position: [i as f32, 0.0, 0.05], orientation }),
        speeds_mps: [0.0; blueprints::N_BLOCKS],
        joints: Vec::new(),
        grippers: [Some(gripper), Some(gripper)],
        n_heavy_contacts: 0,
    };
    Toy { ends: ends.to_vec(), n_steps: 0, diverged: false, scene, blueprint: goal().clone() }
}

fn run(worlds: Vec<Toy>, lanes: &[Vec<Job>], keep_going: bool) -> Result<Vec<Vec<Played>>, EvalError> {
    let policy = Policy::new(&PolicyConfig::default()).unwrap();
    let rules = Rules {
        catalogue: Catalogue::builtin(),
        acting: Acting::Sampled,
        success: &SuccessConfig::default(),
        keep_going: &|| keep_going,
        films: None,
    };
    let mut waiting = lanes.iter().map(|lane| Arc::from(lane.as_slice())).enumerate();
    let mut results = vec![Vec::new(); lanes.len()];
    run_lanes(&rules, &policy, worlds, || waiting.next(), |lane_idx, played| results[lane_idx] = played)?;
    Ok(results)
}

fn lane(starts: &[Start]) -> Vec<Job> {
    starts.iter().zip(0..).map(|(start, idx)| Job::new(goal(), start.clone(), 1, idx)).collect()
}

#[test]
fn worlds_share_more_lanes_than_there_are_worlds() {
    use Status::{Running, Success, TimeLimit};
    let worlds = vec![toy(&[Success]), toy(&[Running, Running, TimeLimit])];
    let lanes = vec![lane(&[Start::Scattered]); 5];
    let played = run(worlds, &lanes, true).unwrap();
    let steps: Vec<u32> = played.iter().map(|lane| lane[0].episode.n_steps).collect();
    // The first world ends an episode at every step, the second at the third, when the last lane is taken already.
    assert_eq!(steps, [1, 3, 1, 1, 1]);
    // Nothing is connected in the toy's scene, so its success proves unstable.
    assert_eq!(played[0][0].episode.end, End::Success { stable: false });
    assert_eq!((played[1][0].episode.end, played[1][0].episode.episode_return.wrong), (End::TimeLimit, -3.0));
}

#[test]
fn a_lane_keeps_its_world_until_that_diverges() {
    use Status::{Diverged, Success, TimeLimit};
    let lanes = [lane(&[Start::Scattered, Start::AsItIs, Start::AsItIs, Start::AsItIs])];
    let played = run(vec![toy(&[Success, TimeLimit, Diverged, Success])], &lanes, true).unwrap();
    let ends: Vec<(End, bool)> = played[0].iter().map(|played| (played.episode.end, played.forced_reset)).collect();
    let success = End::Success { stable: false };
    assert_eq!(ends, [(success, false), (End::TimeLimit, false), (End::Diverged, false), (success, true)]);
}

#[test]
fn an_interruption_has_no_result() {
    let result = run(vec![toy(&[Status::Running])], &[lane(&[Start::Scattered])], false);
    assert!(matches!(result, Err(EvalError::Interrupted)));
}

#[test]
fn start_states_depend_on_seed_goal_and_number_only() {
    let job = |seed, idx| Job::new(goal(), Start::Scattered, seed, idx).task;
    assert_eq!(job(1, 2), job(1, 2));
    assert_ne!(job(1, 2).seed, job(1, 3).seed);
    assert_ne!(job(1, 2).seed, job(2, 2).seed);
    let other = Job::new(Catalogue::builtin().of_split(Split::Train)[1], Start::Scattered, 1, 2).task;
    assert_ne!(job(1, 2).seed, other.seed);
}

#[test]
fn the_kind_of_start_leaves_the_rest_of_a_task_alone() {
    let catalogue = Catalogue::builtin();
    let jobs = |starts| (0..40).map(|idx| Job::one_of(catalogue, goal(), starts, 1, idx).task).collect::<Vec<_>>();
    let scattered = jobs(Starts::Scattered);
    assert!(scattered.iter().all(|task| task.start == Start::Scattered));
    for (starts, n_prebuilt) in [(Starts::Prebuilt, 40), (Starts::Mixed, 8)] {
        let tasks = jobs(starts);
        let others = tasks.iter().filter(|task| matches!(&task.start, Start::Prebuilt(other) if other != goal().id()));
        assert_eq!(others.count(), n_prebuilt);
        assert!(tasks.iter().zip(&scattered).all(|(task, plain)| task.seed == plain.seed));
    }
    assert!(jobs(Starts::NearGoal).iter().all(|task| task.start == Start::NearGoal { undone: 1 }));
}
