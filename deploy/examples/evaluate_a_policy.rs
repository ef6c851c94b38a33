//! Evaluates the shipped policy on blueprints of two and three blocks.
//!
//! ```sh
//! cargo run --release --example evaluate_a_policy
//! cargo run --release --example evaluate_a_policy -- policy.safetensors   # from `lodestone export`
//! ```

use std::path::PathBuf;

use blueprints::{Blueprint, Catalog, Split};
use deploy::config::{Config, Preset};
use evaluator::{Detail, EpisodeConfig, EvalSetup, N_WORLDS, evaluate, render};
use learner::Model;

fn main() -> anyhow::Result<()> {
    let pretrained = concat!(env!("CARGO_MANIFEST_DIR"), "/pretrained/model.safetensors");
    let path = std::env::args().nth(1).map_or_else(|| PathBuf::from(pretrained), PathBuf::from);
    // A model file holds the weights and the network's configuration, so the weights cannot end up in a different
    // network.
    let model = Model::read(&path)?;

    // Evaluate in the world that the policy was trained in.
    let preset = Preset::find("laptop")?;
    let config = Config::parse(preset.text, preset.name)?.checked()?;

    let catalog = Catalog::builtin();
    let goals: Vec<&Blueprint> =
        catalog.of_split(Split::Train).into_iter().filter(|blueprint| blueprint.n_blocks() <= 3).collect();

    let setup = EvalSetup {
        catalog,
        environment: Config::evaluation_environment(&config),
        episodes: EpisodeConfig { n_episodes: 5, ..config.evaluator.episodes.clone() },
        reset_free: None,
        n_worlds: N_WORLDS,
        // The same seed gives the same start states, so two policies can be compared episode by episode.
        seed: 1,
    };
    // The closure is called regularly; when it returns false, the evaluation stops.
    let report = evaluate(&setup, &model.policy, &model.weights, &goals, &|| true)?;
    println!("{}", render(&report, Detail::Blueprints));
    Ok(())
}
