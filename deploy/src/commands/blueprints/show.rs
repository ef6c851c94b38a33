//! `blueprints show`: draws blueprints as PNG files.

use std::collections::BTreeMap;

use anyhow::Context;
use blueprints::{Blueprint, Split};
use render::picture::{MAX_TILES, Painter, card, encode, sheet};

use crate::cli::ShowArgs;
use crate::commands::files::write_files;
use crate::commands::goals::Goals;
use crate::exit::Failure;
use crate::live::Terminal;

/// Number of cards per line of progress.
const LINE_EVERY: usize = 20;

/// Palette sizes of a card and of a contact sheet; the latter should be small enough to keep in a repository.
const CARD_COLORS: usize = 256;
const SHEET_COLORS: usize = 96;

/// Runs the subcommand. Draws everything before it writes the first file.
pub(super) fn run(args: &ShowArgs, terminal: &Terminal) -> Result<(), Failure> {
    let named = [&args.ids[..], &args.blueprint[..]].concat();
    let goals = Goals::open_beside(&named, None)?;
    goals.inferred.iter().for_each(|(file, found)| terminal.print(&format!("{file}: {found}")));
    let shown = select(&goals, args.split);
    let mut painter = Painter::default();
    let mut files = Vec::new();
    if !args.only_sheets {
        for (i, blueprint) in shown.iter().enumerate() {
            let bytes = encode(&card(&mut painter, blueprint, args.size), CARD_COLORS).context("encoding a picture")?;
            files.push((format!("{}.png", blueprint.id()), bytes));
            if (i + 1) % LINE_EVERY == 0 || i + 1 == shown.len() {
                terminal.print(&format!("{} of {} blueprints drawn", i + 1, shown.len()));
            }
        }
    }
    for (name, members) in sheets(&shown) {
        let bytes = encode(&sheet(&mut painter, &members), SHEET_COLORS).context("encoding a contact sheet")?;
        terminal.print(&format!("{name}: {} blueprints{}", members.len(), sizes(&members)));
        files.push((name, bytes));
    }
    write_files(&args.out, &files)?;
    terminal.print(&format!("{} files in {}", files.len(), args.out.display()));
    Ok(())
}

/// The requested blueprints: the named ones in the given order, those of a split, or all.
fn select(goals: &Goals, split: Option<Split>) -> Vec<&Blueprint> {
    match split {
        Some(split) => goals.catalog.of_split(split),
        None if goals.ids.is_empty() => goals.catalog.iter().collect(),
        None => goals.blueprints(),
    }
}

/// The contact sheets by file name: one for all blueprints if they fit, otherwise as few as possible per split, divided
/// between sizes where possible.
fn sheets<'a>(shown: &[&'a Blueprint]) -> Vec<(String, Vec<&'a Blueprint>)> {
    if shown.len() <= MAX_TILES {
        return vec![("sheet.png".to_owned(), shown.to_vec())];
    }
    let mut by_split: BTreeMap<_, BTreeMap<usize, Vec<&Blueprint>>> = BTreeMap::new();
    for blueprint in shown {
        by_split.entry(blueprint.split()).or_default().entry(blueprint.n_blocks()).or_default().push(blueprint);
    }
    let mut sheets = Vec::new();
    for (split, by_size) in by_split {
        let mut pages: Vec<Vec<&Blueprint>> = Vec::new();
        for of_size in by_size.into_values() {
            match pages.last_mut() {
                Some(page) if page.len() + of_size.len() <= MAX_TILES => page.extend(of_size),
                _ => pages.extend(of_size.chunks(MAX_TILES).map(<[_]>::to_vec)),
            }
        }
        let n_pages = pages.len();
        for (i, page) in pages.into_iter().enumerate() {
            let number = if n_pages > 1 { format!("-{}", i + 1) } else { String::new() };
            sheets.push((format!("sheet-{split}{number}.png"), page));
        }
    }
    sheets
}

/// The smallest and the largest number of blocks, in words.
fn sizes(blueprints: &[&Blueprint]) -> String {
    let sizes = blueprints.iter().map(|blueprint| blueprint.n_blocks());
    match (sizes.clone().min(), sizes.max()) {
        (Some(least), Some(most)) if least < most => format!(" of {least} to {most} blocks"),
        (Some(size), _) => format!(" of {size} blocks"),
        (None, _) => String::new(),
    }
}

#[cfg(test)]
mod tests {
    use blueprints::Catalog;

    use super::*;

    /// A training blueprint of `n_blocks` blocks.
    fn of_size(n_blocks: usize) -> &'static Blueprint {
        let mut all = Catalog::builtin().iter();
        all.find(|blueprint| blueprint.split() == Split::Train && blueprint.n_blocks() == n_blocks).unwrap()
    }

    #[test]
    fn sheets_are_cut_between_sizes() {
        let pages = |shown: &[&Blueprint]| -> Vec<(String, usize)> {
            sheets(shown).into_iter().map(|(name, page)| (name, page.len())).collect()
        };
        let named = |name: &str, n_tiles: usize| (name.to_owned(), n_tiles);
        let [two, three, four] = [2, 3, 4].map(|n_blocks| vec![of_size(n_blocks); 20]);
        assert_eq!(pages(&[two.clone(), three.clone()].concat()), [named("sheet.png", 40)]);
        let expected = [named("sheet-train-1.png", 40), named("sheet-train-2.png", 20)];
        assert_eq!(pages(&[two, four, three].concat()), expected);
    }

    #[test]
    fn a_size_with_too_many_for_a_sheet_gets_several() {
        let n_tiles: Vec<usize> = sheets(&[of_size(2); 2 * MAX_TILES + 3]).iter().map(|(_, page)| page.len()).collect();
        assert_eq!(n_tiles, [MAX_TILES, MAX_TILES, 3]);
    }
}
