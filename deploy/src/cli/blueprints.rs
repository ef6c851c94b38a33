//! Arguments of `blueprints`.

use std::ffi::OsString;
use std::path::PathBuf;

use blueprints::Split;
use clap::builder::RangedU64ValueParser;
use clap::{Args, Subcommand};

/// Subcommands of `blueprints`.
#[derive(Debug, Subcommand)]
pub enum BlueprintsCommand {
    /// List the blueprints of the catalog, or those in files and folders.
    List(BlueprintsArgs),
    /// Check the catalog, or blueprint files and folders.
    Check {
        /// The files to check.
        #[command(flatten)]
        files: BlueprintsArgs,
        /// Write the checked file, which must be the only one, to this new file, with everything filled in that it
        /// leaves open.
        #[arg(long, value_name = "FILE", requires = "paths")]
        write: Option<PathBuf>,
    },
    /// Draw blueprints as PNG pictures: one of each, with four views, and contact sheets of all.
    Show(ShowArgs),
}

/// Arguments of `blueprints list`, and the files of `blueprints check`.
#[derive(Debug, Args)]
pub struct BlueprintsArgs {
    /// Files or folders [default: the built-in catalog].
    #[arg(value_name = "PATH")]
    pub(crate) paths: Vec<PathBuf>,
    /// Print JSON.
    #[arg(long)]
    pub(crate) json: bool,
}

/// Arguments of `blueprints show`.
#[derive(Debug, Args)]
pub struct ShowArgs {
    /// Blueprints to draw: ids, for example 6_005, files, or folders of files [default: all].
    #[arg(value_name = "FILE|ID", conflicts_with = "split")]
    pub(crate) ids: Vec<OsString>,
    /// Same as FILE|ID; may be repeated.
    #[arg(long, value_name = "FILE|ID", conflicts_with = "split")]
    pub(crate) blueprint: Vec<OsString>,
    /// All blueprints of this split: train, test, test-literal, test-longest, test-tallest, or validation.
    #[arg(long, value_name = "SPLIT")]
    pub(crate) split: Option<Split>,
    /// Width of each blueprint's picture in pixels.
    #[arg(long, value_name = "N", default_value_t = 960, value_parser = RangedU64ValueParser::<usize>::new().range(320..=4000))]
    pub(crate) size: usize,
    /// Folder for the pictures; created if it does not exist.
    #[arg(long, value_name = "DIR")]
    pub(crate) out: PathBuf,
    /// Write only the contact sheets.
    #[arg(long)]
    pub(crate) only_sheets: bool,
}
