//! The runs that a command line names: folders of runs, runs, files and patterns, each run once, in the order of their paths.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Component, Path, PathBuf};

use crate::runtime::{Failure, names_in};
use drivebench_bench::fits_pattern;
use drivebench_bench::recording::{RunFile, RunFolder, resolved};

/// Depth of the search below a folder of runs; a suite keeps its runs three levels down.
const DEEPEST: usize = 8;

/// Every run that is named, sorted by its path.
pub(super) fn runs(named: &[PathBuf]) -> Result<Vec<PathBuf>, Failure> {
    // By canonical path: a run that is named twice, or also by a link, is one run.
    let mut found: BTreeMap<PathBuf, PathBuf> = BTreeMap::new();
    let mut add = |path: PathBuf| {
        found.entry(fs::canonicalize(&path).unwrap_or_else(|_| path.clone())).or_insert(path);
    };
    for path in named {
        if path.exists() {
            let inside = if path.is_dir() { below(path, DEEPEST) } else { Vec::new() };
            if inside.is_empty() {
                // A folder without a run gets a row too, which gives the reason.
                add(resolved(path));
            }
            inside.into_iter().for_each(&mut add);
            continue;
        }
        let text = path.to_string_lossy();
        if !is_pattern(&text) {
            let headline = format!("{}: there is no such run or folder of runs", path.display());
            return Err(Failure::usage(headline, "check the path"));
        }
        let matched = expanded(path).into_iter().flat_map(|path| below(&path, DEEPEST));
        let matched: Vec<PathBuf> = matched.collect();
        if matched.is_empty() {
            let headline = format!("{text}: no run matches this pattern");
            let help = "* and ? match characters of one name, ** any folders between";
            return Err(Failure::usage(headline, help));
        }
        matched.into_iter().for_each(&mut add);
    }
    let mut runs: Vec<PathBuf> = found.into_values().collect();
    runs.sort();
    Ok(runs)
}

/// The path itself where it is a run, else the runs in so many floors of folders below it.
fn below(path: &Path, floors: usize) -> Vec<PathBuf> {
    if is_run(path) {
        return vec![resolved(path)];
    }
    folders_in(path, floors).flat_map(|folder| below(&folder, floors - 1)).collect()
}

/// The folders directly in this one, none where there are no floors. Links to folders are not followed.
fn folders_in(base: &Path, floors: usize) -> impl Iterator<Item = PathBuf> {
    let inside = names_in(base).into_iter().map(|name| base.join(name));
    inside.filter(move |path| floors > 0 && path.is_dir() && !path.is_symlink())
}

fn is_run(path: &Path) -> bool {
    if path.is_file() {
        return path.extension().is_some_and(|ending| ending == "csv");
    }
    let folder = RunFolder::existing(path);
    folder.samples().exists() || folder.file(RunFile::Manifest).exists()
}

fn is_pattern(text: &str) -> bool {
    text.contains(['*', '?'])
}

fn expanded(pattern: &Path) -> Vec<PathBuf> {
    let mut found = vec![PathBuf::new()];
    for part in pattern.components() {
        let text = part.as_os_str().to_string_lossy();
        found = match part {
            Component::Normal(_) if text == "**" => {
                found.iter().flat_map(|base| with_folders_below(base, DEEPEST)).collect()
            }
            Component::Normal(_) if is_pattern(&text) => found
                .iter()
                .flat_map(|base| names_in(base).into_iter().map(move |name| (base, name)))
                .filter(|(_, name)| matches(name, &text))
                .map(|(base, name)| base.join(name))
                .collect(),
            part => found.iter().map(|base| base.join(part)).collect(),
        };
    }
    found.retain(|path| path.exists());
    found
}

/// The folder and so many floors of folders below it.
fn with_folders_below(base: &Path, floors: usize) -> Vec<PathBuf> {
    let inside = folders_in(base, floors).flat_map(|path| with_folders_below(&path, floors - 1));
    std::iter::once(base.to_owned()).chain(inside).collect()
}

/// Whether a name fits a pattern; one that begins with a dot is hidden.
fn matches(name: &str, pattern: &str) -> bool {
    (!name.starts_with('.') || pattern.starts_with('.')) && fits_pattern(pattern, name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hidden_name_needs_a_dot_in_its_pattern() {
        assert!(!matches(".git", "*") && matches(".git", ".*") && matches("2026-a", "2026-*"));
    }

    #[test]
    fn each_run_is_listed_once_and_in_order() {
        let root = tempfile::tempdir().unwrap();
        for run in ["b/2", "b/1", "a/deep/3", "c"] {
            fs::create_dir_all(root.path().join(run)).unwrap();
        }
        for run in ["b/2/samples.csv", "b/1/samples.csv", "a/deep/3/manifest.json"] {
            fs::write(root.path().join(run), "").unwrap();
        }
        std::os::unix::fs::symlink("1", root.path().join("b/latest")).unwrap();
        let named = |names: &[&str]| {
            let paths: Vec<PathBuf> = names.iter().map(|name| root.path().join(name)).collect();
            let found = runs(&paths).map_err(|error| error.headline().to_owned())?;
            let short =
                |path: PathBuf| path.strip_prefix(root.path()).unwrap().display().to_string();
            Ok::<_, String>(found.into_iter().map(short).collect::<Vec<_>>())
        };
        assert_eq!(named(&[""]).unwrap(), ["a/deep/3", "b/1", "b/2"]);
        assert_eq!(named(&["b/2", "b", "b/latest"]).unwrap(), ["b/1", "b/2"]);
        assert_eq!(named(&["b/*"]).unwrap(), ["b/1", "b/2"]);
        assert_eq!(named(&["**/3"]).unwrap(), ["a/deep/3"]);
        assert_eq!(named(&["c"]).unwrap(), ["c"], "its row gives the reason");
        assert!(named(&["c*"]).is_err() && named(&["d"]).is_err());
    }
}
