//! A static copy of the page for any web server: every response that a browser could request becomes a file.

use proto::Valid;
use std::ffi::OsString;
use std::path::{Component, Path, PathBuf};
use std::{fs, io};

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
    let unfinished = Unfinished::create(folder).with_context(unmade)?;
    let bases: Vec<String> = (0..=others.len()).map(base).collect();
    let is_sweep = sweep.is_some();
    let routes = TowerToHyperService::new(routes::routes(first, others, sweep, Places::default(), Valid::default()));
    let mut copy = Copy { routes, folder: &unfinished.0, n_files: 0 };
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
    fs::rename(&unfinished.0, folder).with_context(|| format!("cannot rename the copy to {}", folder.display()))?;
    Ok(n_files)
}

/// The folder of a copy that is not complete, beside its final place; removed when dropped.
struct Unfinished(PathBuf);

impl Unfinished {
    fn create(folder: &Path) -> io::Result<Self> {
        let mut name = OsString::from(".");
        name.push(folder.file_name().ok_or(io::ErrorKind::InvalidInput)?);
        name.push(".part");
        let path = folder.with_file_name(name);
        // Left by a process that was killed.
        match fs::remove_dir_all(&path) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
            _ => {}
        }
        fs::create_dir(&path)?;
        Ok(Self(path))
    }
}

impl Drop for Unfinished {
    fn drop(&mut self) {
        // Nothing is there after the copy was renamed.
        if let Err(error) = fs::remove_dir_all(&self.0)
            && error.kind() != io::ErrorKind::NotFound
        {
            tracing::warn!(%error, folder = %self.0.display(), "an incomplete copy was left behind");
        }
    }
}

impl Copy<'_> {
    /// Copies all responses of one run.
    async fn run(&mut self, base: &str, goals: &[BlueprintId]) -> anyhow::Result<()> {
        let mut about: Value = serde_json::from_slice(&self.ask(&format!("{base}/api/about")).await?.1)?;
        let mut recorded = Vec::new();
        // Empty if nothing can play.
        let snapshots = self.list(base, "snapshots").await?.into_iter();
        let snapshots = snapshots.map(|n| (format!("agent=policy&snapshot={n}"), format!("policy-{n}")));
        let agents = AGENTS.into_iter().map(|agent| (format!("agent={agent}"), agent.to_owned()));
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
