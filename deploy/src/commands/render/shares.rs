//! `render --attention … --table`: what each head attends to, over many episodes.

use std::ffi::OsStr;

use evaluator::Policy;
use render::video::{Episode, EpisodeAttention, Shares};

use super::recordings::Named;
use crate::cli::RenderArgs;
use crate::commands::files::write_file;
use crate::exit::Failure;
use crate::live::Terminal;

const FILE: &str = "attention.csv";

/// Writes the mean attention shares of each head over all scenes, and those of uniform attention, to a file and to the
/// terminal.
pub(super) fn write(
    episodes: &[Named],
    policy: &Policy,
    args: &RenderArgs,
    terminal: &Terminal,
) -> Result<(), Failure> {
    // Shares of each scene, indexed by layer and head. Those of uniform attention are kept separately.
    let mut heads: Vec<Vec<Shares>> = Vec::new();
    let mut uniform = Vec::new();
    let mut n_heads = 1;
    for (name, episode) in episodes {
        let attention = attention(policy, name, episode)?;
        n_heads = attention.n_heads();
        heads.resize(attention.n_layers() * n_heads, Vec::new());
        for n_done in 0..attention.n_scenes() {
            for (idx, shares) in heads.iter_mut().enumerate() {
                shares.push(attention.shares(idx / n_heads, idx % n_heads, n_done));
            }
            uniform.push(attention.uniform_shares(n_done));
        }
    }
    let n_scenes = uniform.len();
    let named = heads
        .into_iter()
        .enumerate()
        .map(|(idx, shares)| ((idx / n_heads + 1).to_string(), (idx % n_heads + 1).to_string(), Shares::mean(shares)));
    let rows: Vec<_> = named.chain([("uniform".to_owned(), String::new(), Shares::mean(uniform))]).collect();
    let mut csv = "layer,head,partner,connected,held\n".to_owned();
    let mut table = format!("{:<8}{:<6}{:>9}{:>11}{:>8}", "layer", "head", "partner", "connected", "held");
    for (layer, head, shares) in &rows {
        let Shares { planned, joined, held } = shares;
        csv += &format!("{layer},{head},{planned:.4},{joined:.4},{held:.4}\n");
        let [planned, joined, held] = [planned, joined, held].map(|share| 100.0 * share);
        table += &format!("\n{layer:<8}{head:<6}{planned:>7.1} %{joined:>9.1} %{held:>6.1} %");
    }
    write_file(&args.out.join(FILE), csv.as_bytes())?;
    terminal.print(&table);
    terminal.print(&format!(
        "{}: {} files, {n_scenes} scenes; shares of the attention of the goal's blocks",
        args.out.join(FILE).display(),
        episodes.len()
    ));
    Ok(())
}

/// Returns what `policy` attends to in an episode.
pub(super) fn attention<'e>(
    policy: &Policy,
    name: &OsStr,
    episode: &'e Episode,
) -> Result<EpisodeAttention<'e>, Failure> {
    EpisodeAttention::new(policy, episode).map_err(|error| Failure::Input(format!("{}: {error}", name.display())))
}
