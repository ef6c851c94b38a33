//! `blueprints generate`.

use std::collections::BTreeSet;
use std::fs;
use std::path::PathBuf;

use blueprints::generator::{Request, generate_many};
use blueprints::{Blueprint, Catalog};

use crate::cli::GenerateArgs;
use crate::commands::files::{exists, write_new};
use crate::exit::Failure;
use crate::live::Terminal;

/// Writes one file per blueprint and prints a line for each; never replaces a file.
pub(super) fn run(args: &GenerateArgs, terminal: &Terminal) -> Result<(), Failure> {
    let known: BTreeSet<u64> = Catalog::builtin().iter().map(Blueprint::canonical_hash).collect();
    let made = generate_many(args.style, args.seed, usize::from(args.size), usize::from(args.count), &known)?;
    let path = |blueprint: &Blueprint| args.out.join(format!("{}.toml", blueprint.id()));
    // Check all paths before writing the first file, so that a refusal leaves the folder unchanged.
    let paths: Vec<PathBuf> = made.iter().map(path).collect();
    if let Some(taken) = paths.iter().find(|path| path.exists()) {
        return Err(exists(taken));
    }
    fs::create_dir_all(&args.out)
        .map_err(|error| Failure::Input(format!("cannot write {}: {error}", args.out.display())))?;
    for (blueprint, path) in made.iter().zip(&paths) {
        let request = Request::from_id(blueprint.id()).expect("the id of a generated blueprint names its request");
        write_new(path, &blueprint.to_toml(&request.provenance()))?;
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
