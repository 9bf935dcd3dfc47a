//! The folder of a run: created once, never overwritten; its small files are replaced atomically.

use drivebench_model::tabulated;
use std::fs::{self, File, OpenOptions};
use std::io::{self, ErrorKind, Read as _, Write};
use std::path::{Path, PathBuf};

use super::{Manifest, RecordingError};

tabulated! {
    /// The files of a run folder that are written in one go.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub enum RunFile {
        Manifest = "manifest.json",
        Model = "model.toml",
        Result = "result.json",
        Report = "report.html",
        /// The recommended next run, as a bench file.
        NextBench = "next-bench.toml",
        /// The samples by columns.
        Parquet = "samples.parquet",
        /// What a controller followed, and its gains, over time.
        Adaptation = "adaptation.csv",
    }
    pub const fn name(self) -> &'static str;
}

/// Reads a whole text. Configurations and results are far shorter than 8 MiB; a longer file must not fill the memory.
///
/// # Errors
/// It cannot be read, or is longer.
pub fn read_text(path: &Path) -> io::Result<String> {
    let most_bytes = 8 << 20;
    let mut text = String::new();
    File::open(path)?.take(most_bytes + 1).read_to_string(&mut text)?;
    if text.len() as u64 > most_bytes {
        return Err(io::Error::new(ErrorKind::FileTooLarge, "it is longer than 8 MiB"));
    }
    Ok(text)
}

pub(super) const SAMPLES: &str = "samples.csv";
const EVENTS: &str = "events.jsonl";
/// The first burst captured by the drive within the run.
pub const FIRST_CAPTURE: &str = "capture-01.csv";

/// The link to the newest run, beside the folders.
pub const LATEST: &str = "latest";

/// `path` with every link `latest` resolved, so that it names the same run after the next one is recorded.
pub fn resolved(path: &Path) -> PathBuf {
    let mut out = PathBuf::new();
    for part in path.components() {
        let is_link = part.as_os_str() == LATEST && out.join(part).is_symlink();
        match fs::read_link(out.join(part)) {
            Ok(target) if is_link => out.push(target),
            _ => out.push(part),
        }
    }
    out
}

/// `runs/<UTC stamp>-<name>/`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RunFolder {
    path: PathBuf,
}

/// The stamp that begins a folder's name, `20260131T235959Z`: it sorts by time and needs no quoting.
pub fn utc_stamp(timestamp: jiff::Timestamp) -> String {
    timestamp.strftime("%Y%m%dT%H%M%SZ").to_string()
}

impl RunFolder {
    /// Makes `root/<stamp>-<name>`, or the same with `-2`, `-3`, ... where it is there already.
    pub fn create(root: &Path, stamp: &str, name: &str) -> Result<Self, RecordingError> {
        Self::make(root, &format!("{}-{}", file_safe(stamp), file_safe(name)))
    }

    /// Creates a deleted folder anew, under its own name or, where that exists, with `-2`, `-3`, ...
    pub(super) fn again(&self) -> Result<Self, RecordingError> {
        let root = self.path.parent().unwrap_or(Path::new("."));
        let base = self.path.file_name().unwrap_or_default();
        Self::make(root, &base.to_string_lossy())
    }

    fn make(root: &Path, base: &str) -> Result<Self, RecordingError> {
        fs::create_dir_all(root).map_err(|error| RecordingError::io(root, "create", &error))?;
        let name = |count| match count {
            1 => root.join(base),
            _ => root.join(format!("{base}-{count}")),
        };
        let ((), path) = first_free(name, |path| fs::create_dir(path))?;
        Ok(Self { path })
    }

    /// A folder that cannot be created for now, under its name.
    pub fn unmade(root: &Path, stamp: &str, name: &str) -> Self {
        Self { path: root.join(format!("{}-{}", file_safe(stamp), file_safe(name))) }
    }

    pub fn existing(path: impl Into<PathBuf>) -> Self {
        Self { path: path.into() }
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    pub fn file(&self, file: RunFile) -> PathBuf {
        self.path.join(file.name())
    }

    pub fn samples(&self) -> PathBuf {
        self.path.join(SAMPLES)
    }

    pub fn events(&self) -> PathBuf {
        self.path.join(EVENTS)
    }

    /// Points the link `latest` beside the folder at it, atomically. Anything else of that name is kept, which is an error.
    pub fn link_latest(&self) -> io::Result<()> {
        let root = self.path.parent().unwrap_or(Path::new("."));
        let link = root.join(LATEST);
        if link.symlink_metadata().is_ok_and(|found| !found.is_symlink()) {
            let reason = "something else has this name, and is kept";
            return Err(io::Error::new(ErrorKind::AlreadyExists, reason));
        }
        let name = self.path.file_name().unwrap_or_default();
        let temporary = root.join(format!(".{LATEST}.{}", std::process::id()));
        std::os::unix::fs::symlink(name, &temporary)?;
        fs::rename(&temporary, &link).inspect_err(|_| drop(fs::remove_file(&temporary)))
    }

    /// Writes a file atomically: to a temporary name, synced, then renamed. A crash leaves the old file or the new one.
    pub fn write(
        &self,
        file: RunFile,
        content: &(impl AsRef<[u8]> + ?Sized),
    ) -> Result<PathBuf, RecordingError> {
        let path = self.file(file);
        let temporary = self.path.join(format!(".{}.part", file.name()));
        let write = || -> io::Result<()> {
            let mut part = File::create(&temporary)?;
            part.write_all(content.as_ref())?;
            part.sync_all()?;
            fs::rename(&temporary, &path)?;
            File::open(&self.path)?.sync_all()
        };
        write().map_err(|error| {
            // It would take space on a full disk.
            let _ = fs::remove_file(&temporary);
            RecordingError::io(&path, "write", &error)
        })?;
        Ok(path)
    }

    pub fn write_manifest(&self, manifest: &Manifest) -> Result<PathBuf, RecordingError> {
        self.write(RunFile::Manifest, &manifest.text())
    }

    /// Writes the next `capture-NN.csv`, from 01.
    pub fn write_capture(&self, text: &str) -> Result<PathBuf, RecordingError> {
        let name = |count| self.path.join(format!("capture-{count:02}.csv"));
        let (mut file, path) = first_free(name, create_new)?;
        file.write_all(text.as_bytes())
            .and_then(|()| file.sync_data())
            .map_err(|error| RecordingError::io(&path, "write", &error))?;
        Ok(path)
    }

    /// The two files that grow during the run; an error where one is there already.
    pub(super) fn create_logs(&self) -> Result<(File, File), RecordingError> {
        let open = |path: PathBuf| {
            create_new(&path).map_err(|error| RecordingError::io(&path, "create", &error))
        };
        Ok((open(self.samples())?, open(self.events())?))
    }
}

/// Creates under the first name, counted from 1, that is not taken.
fn first_free<T>(
    name: impl Fn(u32) -> PathBuf,
    make: impl Fn(&Path) -> io::Result<T>,
) -> Result<(T, PathBuf), RecordingError> {
    let mut count = 1;
    loop {
        let path = name(count);
        match make(&path) {
            Ok(made) => return Ok((made, path)),
            Err(error) if error.kind() == ErrorKind::AlreadyExists => count += 1,
            Err(error) => return Err(RecordingError::io(&path, "create", &error)),
        }
    }
}

fn create_new(path: &Path) -> io::Result<File> {
    OpenOptions::new().read(true).append(true).create_new(true).open(path)
}

/// Letters, digits, `-`, `_` and inner dots stay; everything else becomes `-`.
fn file_safe(name: &str) -> String {
    let is_safe = |letter: char| letter.is_alphanumeric() || "-_.".contains(letter);
    let safe: String = name
        .trim()
        .chars()
        .map(|letter| if is_safe(letter) { letter } else { '-' })
        .take(100)
        .collect();
    match safe.trim_matches('.') {
        "" => "run".to_owned(),
        safe => safe.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_is_never_taken_twice_and_stays_in_its_root() {
        let root = tempfile::tempdir().unwrap();
        let runs = root.path().join("deep/runs");
        let stamp = utc_stamp("2026-01-31T23:59:59.9Z".parse().unwrap());
        for number in ["", "-2", "-3"] {
            let folder = RunFolder::create(&runs, &stamp, "my run/1").unwrap();
            let name = format!("20260131T235959Z-my-run-1{number}");
            assert_eq!(folder.path, runs.join(name));
        }
        for name in ["../../etc", "..", "", "a\0b", "/abs"] {
            let folder = RunFolder::create(&runs, "s", name).unwrap();
            assert_eq!(folder.path().parent().unwrap(), runs, "{name:?}");
        }
    }

    #[test]
    fn latest_names_the_newest_run_and_replaces_only_a_link() {
        let root = tempfile::tempdir().unwrap();
        for name in ["first", "second"] {
            let folder = RunFolder::create(root.path(), "s", name).unwrap();
            folder.link_latest().unwrap();
            let inside = root.path().join("latest/model.toml");
            assert_eq!(resolved(&inside), folder.path().join("model.toml"));
        }
        assert_eq!(fs::read_dir(root.path()).unwrap().count(), 3, "no part is left");
        assert_eq!(resolved(Path::new("runs/latest")), Path::new("runs/latest"));
        let other = tempfile::tempdir().unwrap();
        fs::create_dir(other.path().join(LATEST)).unwrap();
        assert!(RunFolder::create(other.path(), "s", "n").unwrap().link_latest().is_err());
        assert!(other.path().join(LATEST).is_dir());
    }

    #[test]
    fn small_files_are_replaced_and_records_never() {
        let root = tempfile::tempdir().unwrap();
        let folder = RunFolder::create(root.path(), "s", "n").unwrap();
        folder.write(RunFile::Result, "{\"long\": 1}").unwrap();
        folder.write(RunFile::Result, "{}").unwrap();
        assert_eq!(fs::read_to_string(folder.file(RunFile::Result)).unwrap(), "{}");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "no temporary file is left");
        folder.write_capture("a\n").unwrap();
        assert!(folder.write_capture("b\n").unwrap().ends_with("capture-02.csv"));
        folder.create_logs().unwrap();
        assert!(folder.create_logs().is_err());
    }
}
