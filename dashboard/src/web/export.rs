//! A static copy of the page for any web server: every response that a browser could request becomes a file.

use proto::Valid;
use std::fs;
use std::path::{Component, Path, PathBuf};

use anyhow::{Context, ensure};
use axum::Router;
use axum::body::{Body, Bytes, to_bytes};
use axum::http::{Request, StatusCode, header::HOST};
use blueprints::BlueprintId;
use hyper::service::Service;
use hyper_util::service::TowerToHyperService;
use serde_json::{Value, json};

use super::about::base;
use super::assets;
use super::events::Places;
use super::{Finished, routes};

/// Maximum size of a response. A video has a few hundred kilobytes, an episode less.
const MAX_ANSWER_BYTES: usize = 64 << 20;

/// Agents that play the recorded episodes, by their names in a query.
const AGENTS: [&str; 2] = ["policy", "expert"];

/// The routes to copy and the target folder.
struct Copy<'d> {
    routes: TowerToHyperService<Router>,
    folder: &'d Path,
    n_files: usize,
}

/// Writes the page of finished runs to `folder`, which must not exist yet, for any web server to serve. If the run has
/// weights, the copy includes an episode for each of `goals` by the policy and by the expert. Returns the number of
/// files.
///
/// # Errors
/// Returns an error if the folder cannot be created or written.
pub async fn export(finished: Finished, goals: &[BlueprintId], folder: &Path) -> anyhow::Result<usize> {
    let (first, others, sweep) = finished.into_shown();
    let unmade = || format!("cannot make the folder {}, which must be new", folder.display());
    ensure!(!folder.exists(), unmade());
    // Beside its final place, because a rename works only within a file system; removed unless the copy is complete.
    let beside = folder.parent().unwrap_or(Path::new(""));
    let unfinished = tempfile::Builder::new().prefix(".").suffix(".part").tempdir_in(beside).with_context(unmade)?;
    let bases: Vec<String> = (0..=others.len()).map(base).collect();
    let is_sweep = sweep.is_some();
    let routes = TowerToHyperService::new(routes::routes(first, others, sweep, Places::default(), Valid::default()));
    let mut copy = Copy { routes, folder: unfinished.path(), n_files: 0 };
    for (path, _, text) in assets::all() {
        let text = text.replacen("<html ", "<html data-copy ", usize::from(path == "/"));
        copy.write(if path == "/" { "/index.html" } else { path }, text.as_bytes())?;
    }
    copy.take("/api/blueprints", "/api/blueprints.json").await?;
    if is_sweep {
        copy.take("/api/sweep", "/api/sweep.json").await?;
    }
    for base in bases {
        copy.run(&base, goals).await?;
    }
    for id in goals {
        copy.take(&format!("/api/picture?id={id}"), &format!("/api/picture/{id}.png")).await?;
    }
    let n_files = copy.n_files;
    fs::rename(unfinished.path(), folder).with_context(|| format!("cannot rename the copy to {}", folder.display()))?;
    // There is nothing to remove any more.
    let _ = unfinished.keep();
    Ok(n_files)
}

impl Copy<'_> {
    /// Copies all responses of one run.
    async fn run(&mut self, base: &str, goals: &[BlueprintId]) -> anyhow::Result<()> {
        let mut about: Value = serde_json::from_slice(&self.ask(&format!("{base}/api/about")).await?.1)?;
        let mut recorded = Vec::new();
        // Empty if nothing can play.
        let snapshots = self.list(base, "snapshots").await?.into_iter();
        // As the page shows them: with the actions that are evaluated.
        let is_sampled = about["origin"]["settings"]["evaluator"]["episodes"]["acting"] == json!(["sampled"]);
        let mode = if is_sampled { "sampled" } else { "greedy" };
        let snapshots = snapshots.map(|n| (format!("agent=policy&mode={mode}&snapshot={n}"), format!("policy-{n}")));
        let agents = AGENTS.into_iter().map(|agent| (format!("agent={agent}&mode={mode}"), agent.to_owned()));
        let builders: Vec<_> = agents.chain(snapshots).collect();
        for goal in goals.iter().filter(|_| about["can_play"] == true) {
            let mut has_all = true;
            for (query, name) in &builders {
                let question = format!("{base}/api/play?blueprint={goal}&{query}");
                has_all &= self.take(&question, &format!("{base}/api/play/{goal}-{name}.json")).await?;
            }
            recorded.extend(has_all.then(|| goal.to_string()));
        }
        about["recorded"] = json!(recorded);
        // Nothing serves the copy, and others need not know the paths of this machine.
        about["farewell"] = Value::Null;
        if let Some(origin) = about["origin"].as_object_mut() {
            origin.retain(|name, _| !["command", "resumed_from"].contains(&name.as_str()));
        }
        self.write(&format!("{base}/api/about.json"), about.to_string().as_bytes())?;
        self.take(&format!("{base}/api/history"), &format!("{base}/api/history.json")).await?;
        for video in self.list(base, "videos").await? {
            let id = video["id"].as_str().unwrap_or_default();
            for (kind, ending) in [("video", "mp4"), ("recording", "json"), ("poster", "png")] {
                self.take(&format!("{base}/api/{kind}?id={id}"), &format!("{base}/api/{kind}/{id}.{ending}")).await?;
            }
        }
        Ok(())
    }

    /// Writes a response that lists something under its own name, and returns the list.
    async fn list(&mut self, base: &str, name: &str) -> anyhow::Result<Vec<Value>> {
        let (_, answer) = self.ask(&format!("{base}/api/{name}")).await?;
        self.write(&format!("{base}/api/{name}.json"), &answer)?;
        Ok(serde_json::from_slice::<Value>(&answer)?[name].as_array().cloned().unwrap_or_default())
    }

    /// Writes a response to a file. Returns false unless its status is 200.
    async fn take(&mut self, question: &str, file: &str) -> anyhow::Result<bool> {
        let (status, answer) = self.ask(question).await?;
        if status != StatusCode::OK {
            tracing::warn!(%status, question, "left out of the copy");
            return Ok(false);
        }
        self.write(file, &answer)?;
        Ok(true)
    }

    async fn ask(&self, question: &str) -> anyhow::Result<(StatusCode, Bytes)> {
        let request = Request::builder().uri(question).header(HOST, "localhost").body(Body::empty())?;
        let answer = self.routes.call(request).await?;
        Ok((answer.status(), to_bytes(answer.into_body(), MAX_ANSWER_BYTES).await?))
    }

    fn write(&mut self, file: &str, bytes: &[u8]) -> anyhow::Result<()> {
        let relative = PathBuf::from(file.trim_start_matches('/'));
        ensure!(relative.components().all(|part| matches!(part, Component::Normal(_))), "{file} is no file");
        let path = self.folder.join(relative);
        if let Some(folder) = path.parent() {
            fs::create_dir_all(folder)?;
        }
        fs::write(&path, bytes).with_context(|| format!("cannot write {}", path.display()))?;
        self.n_files += 1;
        Ok(())
    }
}
