//! `blueprints …`.

use std::path::PathBuf;

use blueprints::generator::Style;
use blueprints::{N_BLOCKS, Split};
use clap::builder::RangedU64ValueParser;
use clap::{Args, Subcommand};

/// What to do with blueprints.
#[derive(Debug, Subcommand)]
pub enum BlueprintsCommand {
    /// List the catalog, or that in a folder.
    List(BlueprintsArgs),
    /// Check blueprint files or folders of them, or the catalog.
    Check(CheckArgs),
    /// Generate blueprints that are not in the catalog, one file each.
    Generate(GenerateArgs),
    /// Draw blueprints as PNG files: one with four views of each, and contact sheets of all.
    Show(ShowArgs),
}

/// Arguments of `blueprints check`.
#[derive(Debug, Args)]
pub struct CheckArgs {
    /// Which.
    #[command(flatten)]
    pub files: BlueprintsArgs,
    /// Write the one file that is checked, with all that it leaves open and that was found, to this file, which must not be
    /// there yet.
    #[arg(long, value_name = "FILE", requires = "paths")]
    pub write: Option<PathBuf>,
}

/// Files for `blueprints list` and `blueprints check`.
#[derive(Debug, Args)]
pub struct BlueprintsArgs {
    /// Files or folders [default: the catalog that comes with the program].
    #[arg(value_name = "PATH")]
    pub paths: Vec<PathBuf>,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

/// Arguments of `blueprints generate`.
#[derive(Debug, Args)]
pub struct GenerateArgs {
    /// Blocks of each.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(2..=N_BLOCKS as i64))]
    pub size: u8,
    /// How many; the most different of about four times as many.
    #[arg(long, value_name = "K", default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=500))]
    pub count: u16,
    /// Another seed gives other structures, the same seed the same.
    #[arg(long, value_name = "S", default_value_t = 0)]
    pub seed: u64,
    /// What they look like: any, tower, wall, arch, bridge, stairs, pyramid, table, ring, cross, letter, spine, longest or
    /// tallest.
    #[arg(long, value_name = "STYLE", default_value_t = Style::Any)]
    pub style: Style,
    /// Folder for the files, made if there is none.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
}

/// Arguments of `blueprints show`.
#[derive(Debug, Args)]
pub struct ShowArgs {
    /// Which blueprints: ids, for example 6_005, files, or folders of files [default: all].
    #[arg(value_name = "FILE|ID", conflicts_with = "split")]
    pub ids: Vec<String>,
    /// The same; may be repeated.
    #[arg(long, value_name = "FILE|ID", conflicts_with_all = ["split", "path"])]
    pub blueprint: Vec<String>,
    /// All of this part of the catalog: train, test, test-literal, test-longest, test-tallest or
    /// validation.
    #[arg(long, value_name = "S")]
    pub split: Option<Split>,
    /// Width of a blueprint's picture in pixels.
    #[arg(long, value_name = "N", default_value_t = 960, value_parser = RangedU64ValueParser::<usize>::new().range(320..=4000))]
    pub size: usize,
    /// Folder for the pictures; made if it is not there.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Folder of blueprint files, or one file [default: the catalog that comes with the program].
    #[arg(long, value_name = "FILE_OR_DIR")]
    pub path: Option<PathBuf>,
    /// Write the contact sheets only.
    #[arg(long)]
    pub only_sheets: bool,
}
