//! The plan of a sweep, `sweep.json`: everything that its runs follow from.

use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow};
use blueprints::Catalog;
use serde::{Deserialize, Serialize};

use super::axes::{self, Axis};
use crate::cli::{ConfigArgs, SweepArgs};
use crate::commands::files::{read_json, write_file};
use crate::commands::services;
use crate::config::{Config, ConfigError, MAX_SEED, Override};
use crate::exit::Failure;

/// Name of the plan in the folder of a sweep.
pub(super) const FILE: &str = "sweep.json";

/// The axis that varies the ablation instead of a key.
const ABLATION: &str = "ablation";

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Plan {
    pub(super) lodestone_version: String,
    pub(super) command: Vec<String>,
    /// The seeds of each point.
    pub(super) seeds: Vec<u64>,
    /// The points, each with a folder `point-<i>` from 1 on.
    pub(super) points: Vec<PlannedPoint>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct PlannedPoint {
    /// What differs between the points: keys and values as on the command line.
    pub(super) settings: Vec<(String, String)>,
    /// All of its settings but the seed, as a file for `train --config`.
    pub(super) config: String,
}

/// A run of a sweep: one point with one seed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(super) struct Run {
    pub(super) point: usize,
    pub(super) seed: u64,
    #[serde(skip)]
    pub(super) folder: PathBuf,
}

impl Run {
    /// What its training prints.
    pub(super) fn log(&self) -> PathBuf {
        self.folder.with_extension("log")
    }

    /// How it ended.
    pub(super) fn result(&self) -> PathBuf {
        self.folder.with_extension("json")
    }
}

impl Plan {
    /// Makes the plan that the arguments ask for; `None` if the configuration was to be printed instead.
    pub(super) fn of(args: &SweepArgs, terminal: &crate::live::Terminal) -> Result<Option<Self>, Failure> {
        let Some(base) = crate::commands::common::configure(&args.config, None, flags(args), terminal)? else {
            return Ok(None);
        };
        if args.grid.is_empty() && args.seeds.is_none() && args.random.is_none() {
            return Err(Failure::Usage("there is nothing to vary: give --grid KEY=V,V, or --seeds N".to_owned()));
        }
        let first = base.config.seed;
        let last = first.checked_add(u64::from(args.seeds.unwrap_or(1)) - 1).filter(|last| *last <= MAX_SEED);
        let last =
            last.ok_or_else(|| Failure::Usage(format!("--seeds from seed {first} on goes beyond {MAX_SEED}")))?;
        let axes: Vec<Axis> = args.grid.iter().map(|text| Axis::parse(text)).collect::<Result<_, _>>()?;
        let points = axes::points(&axes, args.random.map(usize::from), first)?;
        let points = points.into_iter().map(|settings| planned(settings, args)).collect::<Result<_, _>>()?;
        Ok(Some(Self {
            lodestone_version: env!("CARGO_PKG_VERSION").to_owned(),
            command: std::env::args_os().map(|argument| argument.to_string_lossy().into_owned()).collect(),
            seeds: (first..=last).collect(),
            points,
        }))
    }

    pub(super) fn read(folder: &Path) -> Result<Self, Failure> {
        let path = folder.join(FILE);
        crate::run_dir::check_exists(folder)?;
        if !path.exists() {
            return Err(Failure::NothingToShow(format!(
                "{} is no folder of a sweep: it has no {FILE}",
                folder.display()
            )));
        }
        read_json(&path)
    }

    /// Writes the plan to `folder`, or checks that it is the one in it.
    pub(super) fn keep(&self, folder: &Path) -> Result<(), Failure> {
        if folder.join(FILE).exists() {
            return Self::read(folder)?.check_same(self, folder);
        }
        let bytes = serde_json::to_vec_pretty(self).map_err(anyhow::Error::from)?;
        for (i, point) in self.points.iter().enumerate() {
            let path = folder.join(folder_of(i)).join("config.toml");
            write_file(&path, point.config.as_bytes()).map_err(Failure::Checkpoint)?;
        }
        // Last, so that a folder with a plan has all that the plan speaks of.
        write_file(&folder.join(FILE), &bytes).map_err(Failure::Checkpoint)
    }

    /// Checks that `other` has the same points and seeds.
    fn check_same(&self, other: &Self, folder: &Path) -> Result<(), Failure> {
        let differs = |what: String| {
            let shown = folder.display();
            Failure::Usage(format!("{shown} holds another sweep, {what}: choose another --out, or repeat its command"))
        };
        if self.seeds != other.seeds {
            return Err(differs(format!("with the seeds {:?}", self.seeds)));
        }
        if self.points.len() != other.points.len() {
            return Err(differs(format!("with {} points", self.points.len())));
        }
        // Parsed, so that a setting that a newer version has added makes no difference.
        let parsed = |point: &PlannedPoint| Config::parse(&point.config, FILE);
        for (i, (kept, new)) in self.points.iter().zip(&other.points).enumerate() {
            if kept.settings != new.settings || parsed(kept)? != parsed(new)? {
                return Err(differs(format!("whose point {} ({}) has other settings", i + 1, kept.name())));
            }
        }
        Ok(())
    }

    /// All runs, seed by seed, so that every point has a result early.
    pub(super) fn runs(&self, folder: &Path) -> Vec<Run> {
        let of_seed = |&seed: &u64| {
            let run =
                move |point| Run { point, seed, folder: folder.join(folder_of(point)).join(format!("seed-{seed}")) };
            (0..self.points.len()).map(run)
        };
        self.seeds.iter().flat_map(of_seed).collect()
    }

    /// The file with the settings of a run's point.
    pub(super) fn config(&self, run: &Run) -> anyhow::Result<(PathBuf, Config)> {
        let point = self.points.get(run.point).ok_or_else(|| anyhow!("there is no point {}", run.point + 1))?;
        let path = run.folder.parent().context("a run is in the folder of its point")?.join("config.toml");
        Ok((path, Config::parse(&point.config, FILE)?))
    }
}

impl PlannedPoint {
    /// The settings in words; `all` without any.
    pub(super) fn name(&self) -> String {
        let pairs: Vec<String> = self.settings.iter().map(|(key, value)| format!("{key}={value}")).collect();
        if pairs.is_empty() { "all".to_owned() } else { pairs.join(", ") }
    }
}

fn folder_of(point: usize) -> String {
    format!("point-{}", point + 1)
}

fn flags(args: &SweepArgs) -> Vec<Override> {
    let steps = args.steps.map(|steps| Override::flag("--steps", "n_env_steps", steps));
    // Without a last evaluation, there would be nothing to compare.
    steps.into_iter().chain([Override::flag("sweep", "evaluator.evaluate_last", true)]).collect()
}

/// A point with all of its settings.
fn planned(settings: axes::Point, args: &SweepArgs) -> Result<PlannedPoint, Failure> {
    let mut of_point = ConfigArgs { ..args.config.clone() };
    for (key, value) in &settings {
        match (key.as_str(), value.as_str()) {
            (ABLATION, "none") => of_point.ablation = None,
            (ABLATION, name) => of_point.ablation = Some(name.to_owned()),
            _ => of_point.set.push(format!("{key}={value}")),
        }
    }
    let mut point = PlannedPoint { settings, config: String::new() };
    let named = |error: Failure| Failure::Usage(format!("point {}: {error}", point.name()));
    let loaded = of_point.load(None, flags(args)).map_err(|error| match error {
        ConfigError::Invalid(_) => named(error.into()),
        error => error.into(),
    });
    let config = loaded?.config;
    services::check_evaluator(&config, Catalog::builtin()).map_err(named)?;
    point.config = config.to_toml();
    Ok(point)
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;
    use crate::cli::{Cli, Command};
    use crate::live::Terminal;

    fn plan(args: &[&str]) -> Result<Plan, Failure> {
        let words = ["lodestone", "sweep", "--out", "x"].iter().chain(args);
        let Command::Sweep(args) = Cli::try_parse_from(words).unwrap().command else { panic!("not sweep") };
        Plan::of(&args, &Terminal::default()).map(Option::unwrap)
    }

    #[test]
    fn every_point_has_all_settings_and_every_seed_a_run_of_each() {
        let args = ["--preset=smoke", "--set=learner.gae_lambda=0.9", "--steps=1e3", "--seed=7", "--seeds=2"];
        let plan = plan(&[&args[..], &["--grid", "learner.gamma=0.9,0.95", "--grid", "ablation=none,resnet"]].concat());
        let plan = plan.unwrap();
        let config = |i: usize| Config::parse(&plan.points[i].config, "point").unwrap();
        assert_eq!(plan.points.len(), 4);
        let first = config(0);
        assert_eq!((first.learner.gamma, first.learner.gae_lambda, first.n_env_steps), (0.9, 0.9, 1000));
        assert!(first.evaluator.evaluate_last);
        assert_eq!(config(3).learner.gamma, 0.95);
        assert_ne!(config(3).policy.network.encoder, first.policy.network.encoder);
        assert_eq!(plan.points[3].name(), "learner.gamma=0.95, ablation=resnet");
        let runs = plan.runs(Path::new("x"));
        assert_eq!(runs.len(), 8);
        assert_eq!((runs[5].point, runs[5].seed, runs[5].log()), (1, 8, PathBuf::from("x/point-2/seed-8.log")));
    }

    #[test]
    fn what_no_training_would_take_is_refused_before_any_begins() {
        for (args, words) in [
            (&["--grid", "learner.gama=0.9"][..], "gamma"),
            (&["--grid", "learner.gamma=0.9,2"], "learner.gamma = 2"),
            (&["--grid", "learner.gamma=0.9,x"], "--set learner.gamma=x"),
            (&["--grid", "ablation=resnets"], "resnet"),
            (&[], "nothing to vary"),
            (&["--seed", "9223372036854775807", "--seeds", "2"], "goes beyond"),
            (&["--grid", "evaluator.selection.splits=[]"], "leaves nothing to evaluate"),
        ] {
            let message = plan(args).unwrap_err().to_string();
            assert!(message.contains(words), "{args:?}: {message}");
        }
    }

    #[test]
    fn a_folder_holds_one_sweep() {
        let folder = tempfile::tempdir().unwrap();
        let kept = plan(&["--grid", "learner.gamma=0.9,0.95"]).unwrap();
        kept.keep(folder.path()).unwrap();
        kept.keep(folder.path()).unwrap();
        assert_eq!(Plan::read(folder.path()).unwrap(), kept);
        let (path, config) = kept.config(&kept.runs(folder.path())[1]).unwrap();
        assert_eq!(Config::parse(&std::fs::read_to_string(path).unwrap(), "file").unwrap(), config);
        for (args, words) in [
            (&["--grid", "learner.gamma=0.9"][..], "with 2 points"),
            (&["--grid", "learner.gamma=0.9,0.96"], "whose point 2 (learner.gamma=0.95)"),
            (&["--grid", "learner.gamma=0.9,0.95", "--seeds", "2"], "with the seeds [1]"),
            (&["--grid", "learner.gamma=0.9,0.95", "--steps", "5"], "whose point 1"),
        ] {
            let message = plan(args).unwrap().keep(folder.path()).unwrap_err().to_string();
            assert!(message.contains("holds another sweep") && message.contains(words), "{message}");
        }
    }
}
