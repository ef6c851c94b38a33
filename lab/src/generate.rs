//! `lab generate`.

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::io::Write;
use std::path::PathBuf;

use anyhow::Context;
use blueprints::{Blueprint, Catalog};
use deploy::live::Terminal;

use crate::cli::GenerateArgs;
use crate::generator::{Request, generate_many};

/// Writes one file per blueprint and prints a line for each; never replaces a file.
pub(crate) fn run(args: &GenerateArgs, terminal: &Terminal) -> anyhow::Result<()> {
    let known: BTreeSet<u64> = Catalog::builtin().iter().map(Blueprint::canonical_hash).collect();
    let made = generate_many(args.style, args.seed, usize::from(args.size), usize::from(args.count), &known)?;
    let path = |blueprint: &Blueprint| args.out.join(format!("{}.toml", blueprint.id()));
    // Check all paths before writing the first file, so that a refusal leaves the folder unchanged.
    let paths: Vec<PathBuf> = made.iter().map(path).collect();
    if let Some(taken) = paths.iter().find(|path| path.exists()) {
        anyhow::bail!("{} exists already; nothing was written", taken.display());
    }
    let writing = |path: &PathBuf| format!("cannot write {}", path.display());
    fs::create_dir_all(&args.out).with_context(|| writing(&args.out))?;
    for (blueprint, path) in made.iter().zip(&paths) {
        let request = Request::from_id(blueprint.id()).expect("the id of a generated blueprint names its request");
        let mut file = File::create_new(path).with_context(|| writing(path))?;
        file.write_all(blueprint.to_toml(&request.provenance()).as_bytes()).with_context(|| writing(path))?;
        terminal.print_rows(&[line(blueprint)]);
    }
    Ok(())
}

/// Id, height × length × width in units, and title; the id and the title contain the number of blocks.
fn line(blueprint: &Blueprint) -> String {
    let [x, y, height] = blueprint.extent_u();
    let size = format!("{height} × {} × {} u", x.max(y), x.min(y));
    format!("{:<28}{size:<18}{}", blueprint.id(), blueprint.title())
}

#[cfg(test)]
mod tests {
    use blueprints::catalog::read_files;
    use blueprints::checks::{Report, check_all};
    use clap::Parser;

    use super::*;
    use crate::cli::{Cli, Command};

    #[test]
    fn generated_blueprints_pass_the_checks_and_replace_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("made");
        let args = ["lab", "generate", "--size", "4", "--count", "2", "--style", "arch", "--out"];
        let cli = Cli::parse_from(args.into_iter().map(Into::into).chain([out.clone().into_os_string()]));
        let Command::Generate(args) = &cli.command else { panic!("{cli:?}") };
        run(args, &Terminal::default()).unwrap();
        let files = read_files(&out).unwrap();
        let reports = check_all(files.iter().map(|(file, text)| (file.as_str(), text.as_str())));
        assert!(reports.len() == 2 && reports.iter().all(Report::passed), "{reports:?}");
        let error = run(args, &Terminal::default()).unwrap_err().to_string();
        assert!(error.ends_with("exists already; nothing was written"), "{error}");
    }
}
