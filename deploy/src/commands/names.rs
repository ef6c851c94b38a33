//! Names under which runs are shown.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Returns the name of a run's folder, even if it is given as `.`.
pub(super) fn name(run: &Path) -> String {
    end(&whole(run), 1)
}

/// Returns a name for each of the runs that are shown side by side: its folder, preceded by as many parent folders as
/// it takes to tell different runs apart, for example `compact/seed-1` and `resnet/seed-1`.
pub(super) fn names<'a>(runs: impl IntoIterator<Item = &'a Path>) -> Vec<String> {
    let runs: Vec<PathBuf> = runs.into_iter().map(whole).collect();
    let n_different = runs.iter().collect::<BTreeSet<_>>().len();
    let most = runs.iter().map(|run| run.components().count()).max().unwrap_or(0);
    let named = |n_folders: usize| runs.iter().map(|run| end(run, n_folders)).collect::<Vec<_>>();
    let are_different = |names: &Vec<String>| names.iter().collect::<BTreeSet<_>>().len() == n_different;
    (1..most).map(named).find(are_different).unwrap_or_else(|| named(most))
}

fn whole(run: &Path) -> PathBuf {
    run.canonicalize().unwrap_or_else(|_| run.to_owned())
}

/// Returns the last `n_folders` components of a path.
fn end(path: &Path, n_folders: usize) -> String {
    let n_all = path.components().count();
    let end: PathBuf = path.components().skip(n_all.saturating_sub(n_folders)).collect();
    end.to_string_lossy().into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn different_runs_have_different_names_as_short_as_possible() {
        let names = |runs: &[&str]| super::names(runs.iter().map(Path::new));
        assert_eq!(names(&["/none/runs/a"]), ["a"]);
        assert_eq!(names(&["/none/runs/a", "/none/runs/b"]), ["a", "b"]);
        assert_eq!(names(&["/none/a/seed-1", "/none/b/seed-1"]), ["a/seed-1", "b/seed-1"]);
        assert_eq!(names(&["/none/x/a/seed-1", "/none/y/a/seed-1"]), ["x/a/seed-1", "y/a/seed-1"]);
        // The same run twice, and one that contains the other.
        assert_eq!(names(&["/none/a", "/none/a"]), ["a", "a"]);
        assert_eq!(names(&["/a", "/none/a"]), ["/a", "none/a"]);
    }
}
