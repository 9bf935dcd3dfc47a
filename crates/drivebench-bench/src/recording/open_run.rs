//! Opens a run: a run folder, its `samples.csv`, or any CSV with a map.

use std::fs::File;
use std::io::{BufReader, Cursor, Read as _, Take};
use std::path::{Path, PathBuf};

use super::csv_cells::whole_rows;
use super::run_folder::{SAMPLES, read_text};
use super::{CsvRows, Manifest, ReadOptions, RecordingError, RunFile, RunFolder, csv_read};
use drivebench_model::sample::{Channel, Origin, Run};

#[derive(Clone, Debug)]
pub struct LoadedRun {
    pub run: Run,
    /// `None` for foreign files, and where the manifest is lost or cannot be read.
    pub manifest: Option<Manifest>,
    /// The run folder of the samples.
    pub folder: Option<PathBuf>,
    /// Torn rows, an unfinished run, ignored columns, in sentences.
    pub warnings: Vec<String>,
    /// How a foreign file differs from comma and decimal point.
    pub dialect: Option<String>,
}

/// A run that is read row by row, of which only the last line is in memory.
pub struct RunRows {
    pub rows: CsvRows<BufReader<Take<File>>>,
    name: String,
    /// `None` for foreign files, and where the manifest is lost or cannot be read.
    pub manifest: Option<Manifest>,
    /// The run folder of the samples.
    pub folder: Option<PathBuf>,
    warnings: Vec<String>,
}

impl RunRows {
    /// Opens a run and reads its header. Without a map the headers must be those of our own `samples.csv`.
    pub fn open(path: &Path, options: ReadOptions<'_>) -> Result<Self, RecordingError> {
        let is_folder = path.is_dir();
        if is_folder && !path.join(SAMPLES).exists() {
            return Err(no_run(path));
        }
        let samples = if is_folder { path.join(SAMPLES) } else { path.to_owned() };
        let mut warnings = Vec::new();
        let (folder, manifest) = folder_of(&samples, is_folder, &mut warnings);

        let io = |doing, error| RecordingError::io(&samples, doing, &error);
        let mut file = File::open(&samples).map_err(|error| io("open", error))?;
        let name = path.display().to_string();
        let options = ReadOptions { in_run_folder: folder.is_some(), ..options };
        // Only a record ends every row with a line feed; another file may be a pipe.
        let (length, ends_torn) = match folder {
            Some(_) => whole_rows(&mut file).map_err(|error| io("read", error))?,
            None => (u64::MAX, false),
        };
        let mut rows = CsvRows::new(BufReader::new(file.take(length)), &name, options)?;
        rows.set_ends_torn(ends_torn);
        Ok(Self { rows, name, manifest, folder, warnings })
    }

    /// Complete after the last row.
    pub fn warnings(&self) -> Vec<String> {
        let mut warnings = self.warnings.clone();
        warnings.extend(self.rows.warnings());
        let (name, rows) = (&self.name, self.rows.rows());
        if let Some(manifest) = &self.manifest {
            if !manifest.finished {
                warnings.push(format!(
                    "{name}: the run was not finished; it was read to its last whole row ({rows} rows)"
                ));
            } else if let Some(expected) = manifest.rows
                && expected != rows
            {
                warnings.push(format!("{name}: {rows} rows, {expected} by the manifest"));
            }
        }
        warnings
    }
}

/// The error of a folder without samples, most likely one of many runs.
fn no_run(folder: &Path) -> RecordingError {
    let path = folder.display().to_string();
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    // A link names one of the folders once more; stamps sort by time.
    let is_run = |path: &PathBuf| !path.is_symlink() && path.join(SAMPLES).exists();
    let runs: Vec<PathBuf> = entries.map(|entry| entry.path()).filter(is_run).collect();
    match runs.iter().max() {
        None => RecordingError::NoRun { path },
        Some(latest) => {
            let latest = latest.display().to_string();
            RecordingError::FolderOfRuns { path, runs: runs.len(), latest }
        }
    }
}

/// Opens a run and reads all of it. Without a map the headers must be those of our own `samples.csv`.
///
/// A run that was not finished is read to its last whole row, with a warning. Origins of signals come from the
/// manifest; without one they are unknown, but for the commands of our own files.
pub fn open_run(path: &Path, options: ReadOptions<'_>) -> Result<LoadedRun, RecordingError> {
    let mut source = RunRows::open(path, options)?;
    let mut run = csv_read::collect(&mut source.rows, &source.name, options.map.is_none())?;
    if options.map.is_none()
        && let Some(manifest) = &source.manifest
    {
        set_origins(&mut run, manifest);
    }
    Ok(LoadedRun {
        run,
        warnings: source.warnings(),
        dialect: source.rows.dialect(),
        manifest: source.manifest,
        folder: source.folder,
    })
}

/// The run of a record in memory, as [`open_run`] would read it from its folder.
pub fn run_from_memory(
    folder: &Path,
    samples: &[u8],
    manifest: &Manifest,
) -> Result<LoadedRun, RecordingError> {
    let name = folder.display().to_string();
    let options = ReadOptions { in_run_folder: true, ..ReadOptions::default() };
    // A read from memory does not fail.
    let (length, ends_torn) = whole_rows(&mut Cursor::new(samples)).unwrap_or_default();
    let mut rows = CsvRows::new(samples.take(length), &name, options)?;
    rows.set_ends_torn(ends_torn);
    let mut run = csv_read::collect(&mut rows, &name, true)?;
    set_origins(&mut run, manifest);
    Ok(LoadedRun {
        run,
        warnings: rows.warnings(),
        dialect: None,
        manifest: Some(manifest.clone()),
        folder: Some(folder.to_owned()),
    })
}

/// Folder and manifest of a samples file; a CSV of another name next to a manifest has none.
fn folder_of(
    samples: &Path,
    is_folder: bool,
    warnings: &mut Vec<String>,
) -> (Option<PathBuf>, Option<Manifest>) {
    let parent = match samples.parent() {
        Some(parent) if parent.as_os_str().is_empty() => Path::new("."),
        Some(parent) => parent,
        None => return (None, None),
    };
    if !is_folder && samples.file_name().is_none_or(|name| name != SAMPLES) {
        return (None, None);
    }
    let path = RunFolder::existing(parent).file(RunFile::Manifest);
    let read = read_text(&path);
    let is_inside = is_folder || read.is_ok();
    let warning = match read.map(|text| serde_json::from_str(&text)) {
        Ok(Ok(manifest)) => return (Some(parent.to_owned()), Some(manifest)),
        Ok(Err(error)) => format!(
            "{}: cannot be read ({error}); where the signals come from is unknown",
            path.display()
        ),
        Err(_) if is_folder => format!(
            "{}: there is no manifest; where the signals come from is unknown",
            parent.display()
        ),
        Err(_) => format!(
            "{}: it is outside of its run folder: where its signals come from is unknown, and its commands and voltages are taken as sampled, each held until the next row",
            samples.display()
        ),
    };
    warnings.push(warning);
    (is_inside.then(|| parent.to_owned()), None)
}

fn set_origins(run: &mut Run, manifest: &Manifest) {
    for channel in Channel::ALL {
        let origin = manifest.origin(channel).unwrap_or_else(|| {
            if channel.is_commanded() { Origin::Commanded } else { Origin::Unknown }
        });
        run.set_origin(channel, origin);
        if let Some(side) = manifest.side(channel) {
            run.set_side(channel, side);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recording::ColumnMap;
    use drivebench_model::sample::Side;
    use std::fs;

    fn folder(root: &Path, manifest: &Manifest, samples: &str) -> RunFolder {
        let folder = RunFolder::create(root, "s", "n").unwrap();
        folder.write_manifest(manifest).unwrap();
        fs::write(folder.samples(), samples).unwrap();
        folder
    }

    #[test]
    fn a_folder_and_its_samples_are_the_same_run() {
        let root = tempfile::tempdir().unwrap();
        let mut manifest = Manifest { finished: true, rows: Some(2), ..Manifest::default() };
        manifest.set_origin(Channel::Voltage, Origin::Measured);
        manifest.set_side(Channel::Voltage, Side::Terminal);
        let samples = "time_s,voltage_cmd_v,voltage_v\n0,1,0.9\n1,,0.8\n";
        let folder = folder(root.path(), &manifest, samples);
        for path in [folder.path().to_owned(), folder.samples()] {
            let loaded = open_run(&path, ReadOptions::default()).unwrap();
            assert_eq!(loaded.run.rows(), 2);
            assert_eq!(loaded.run.origin(Channel::Voltage), Origin::Measured);
            assert_eq!(loaded.run.origin(Channel::VoltageCmd), Origin::Commanded);
            assert_eq!(loaded.run.side(Channel::Voltage), Some(Side::Terminal));
            assert_eq!(loaded.run.side(Channel::Current), None);
            assert_eq!(loaded.manifest.as_ref(), Some(&manifest));
            assert_eq!(loaded.folder.as_deref(), Some(folder.path()));
            assert!(loaded.warnings.is_empty(), "{:?}", loaded.warnings);
        }
    }

    #[test]
    fn a_lost_or_broken_manifest_is_a_warning() {
        let root = tempfile::tempdir().unwrap();
        let folder = folder(root.path(), &Manifest::default(), "time_s,current_a\n0,1\n");
        fs::write(folder.file(RunFile::Manifest), "{\"name\":").unwrap();
        let loaded = open_run(folder.path(), ReadOptions::default()).unwrap();
        assert!(loaded.manifest.is_none());
        assert_eq!(loaded.warnings.len(), 1);
        fs::remove_file(folder.file(RunFile::Manifest)).unwrap();
        let loaded = open_run(folder.path(), ReadOptions::default()).unwrap();
        assert_eq!(loaded.warnings.len(), 1);
        assert_eq!(loaded.run.rows(), 1);
        // A bare samples.csv is simply a CSV.
        let bare = open_run(&folder.samples(), ReadOptions::default()).unwrap();
        assert!(bare.folder.is_none());
        assert!(bare.warnings[0].contains("outside of its run folder"));
    }

    #[test]
    fn a_foreign_file_needs_no_folder_and_a_missing_one_is_named() {
        let root = tempfile::tempdir().unwrap();
        let path = root.path().join("log.csv");
        fs::write(&path, "t,i\n0,1\n1,2").unwrap();
        let map: ColumnMap = "time_s=t,current_a=i".parse().unwrap();
        let options = ReadOptions::mapped(&map);
        let loaded = open_run(&path, options).unwrap();
        assert_eq!((loaded.run.rows(), loaded.run.rows_dropped), (2, 0));
        assert!(loaded.manifest.is_none() && loaded.folder.is_none());
        let error = open_run(&root.path().join("none.csv"), ReadOptions::default()).unwrap_err();
        assert!(error.to_string().contains("none.csv: cannot open"));
    }
}
