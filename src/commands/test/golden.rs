//! A suite from recorded runs: the folders read, the bench and the software drive that they were made with written too.

use std::path::{Path, PathBuf};

use crate::runtime::{Failure, Terminal, output, read_text};
use crate::workflow::suite::golden::{Golden, GoldenRun, SuiteTarget, golden};
use drivebench_bench::recording::{Manifest, resolved};

pub(crate) struct Written {
    pub(crate) golden: Golden,
    /// Suite, bench, and the software drive where there was one.
    pub(crate) files: Vec<PathBuf>,
}

/// Writes the suite `out` from run folders.
pub(crate) fn write(
    folders: &[PathBuf],
    out: &Path,
    terminal: &Terminal,
) -> Result<Written, Failure> {
    let mut runs: Vec<GoldenRun> = Vec::new();
    let mut origin: Option<(Manifest, PathBuf)> = None;
    let mut commissionings: Vec<String> = Vec::new();
    for folder in folders {
        let (manifest, run) = read(folder)?;
        // Every run of a commissioning holds its result: it counts once.
        if let Some(first) =
            run.result.pointer("/runs/0/folder").and_then(serde_json::Value::as_str)
        {
            if commissionings.iter().any(|known| known == first) {
                continue;
            }
            commissionings.push(first.to_owned());
        }
        if let Some((other, of)) = &origin {
            same_machine(other, of, &manifest, folder)?;
        } else {
            origin = Some((manifest, folder.clone()));
        }
        runs.push(run);
    }
    let Some((manifest, _)) = origin else {
        return Err(Failure::usage("--suite names no run", "give run folders"));
    };
    let [bench, emulator] = ["bench", "emulator"].map(|kind| file_of(out, kind));
    let config = |key: &str| manifest.configs.get(key);
    let is_emulated = manifest.identity["is_emulator"] == true && config("emulator").is_some();
    let name = |path: &Path| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let serial = manifest.identity["serial_number"].as_str();
    let target = SuiteTarget {
        bench: name(&bench),
        emulator: is_emulated.then(|| name(&emulator)),
        port: match (manifest.link.as_str(), is_emulated) {
            ("sim:", _) => "sim:".to_owned(),
            (_, true) => "emulator".to_owned(),
            (link, false) => link.to_owned(),
        },
        // The serial number of a software drive is its seed.
        seed: serial.filter(|_| is_emulated).and_then(|text| text.parse().ok()),
    };
    let stem = out.file_stem().unwrap_or_default().to_string_lossy();
    let made = golden(&stem, &runs, &target).map_err(|(what, help)| Failure::usage(what, help))?;
    let mut files = vec![(out.to_owned(), made.text.clone())];
    files.push((bench, config("bench").cloned().unwrap_or_default()));
    if is_emulated {
        files.push((emulator, config("emulator").cloned().unwrap_or_default()));
    }
    output::refuse_existing(files.iter().map(|(path, _)| path), "--out")?;
    for (path, text) in &files {
        terminal.file(path, text)?;
    }
    Ok(Written { golden: made, files: files.into_iter().map(|(path, _)| path).collect() })
}

/// `suite-bench.toml` for `suite.toml` and `bench`.
fn file_of(out: &Path, kind: &str) -> PathBuf {
    let stem = out.file_stem().unwrap_or_default().to_string_lossy();
    out.with_file_name(format!("{stem}-{kind}.toml"))
}

fn read(folder: &Path) -> Result<(Manifest, GoldenRun), Failure> {
    let folder = resolved(folder);
    let wrong = |path: &Path, error: serde_json::Error, help| {
        Failure::usage(format!("{}: {error}", path.display()), help)
    };
    let parsed = |name: &str| -> Result<serde_json::Value, Failure> {
        let path = folder.join(name);
        let help = "give the folder of a run that ended";
        serde_json::from_str(&read_text(&path)?).map_err(|error| wrong(&path, error, help))
    };
    let manifest: Manifest = serde_json::from_value(parsed("manifest.json")?)
        .map_err(|error| wrong(&folder, error, "give the folder of a run"))?;
    // A run that was cut short has none, and is refused for that.
    let result = if manifest.finished { parsed("result.json")? } else { serde_json::Value::Null };
    let run = GoldenRun {
        name: folder.display().to_string(),
        is_whole: manifest.finished,
        outcome: manifest.outcome.clone(),
        seed: manifest.seed,
        result,
    };
    Ok((manifest, run))
}

/// Refuses runs of different benches, or of different drives.
fn same_machine(one: &Manifest, of: &Path, other: &Manifest, folder: &Path) -> Result<(), Failure> {
    let differs = ["bench", "drive", "emulator"]
        .into_iter()
        .find(|key| one.configs.get(*key) != other.configs.get(*key));
    let what = differs.or_else(|| {
        let serial = |manifest: &Manifest| manifest.identity["serial_number"].clone();
        // The seed of a software drive without a tolerance draws noise only: the machine is the same.
        let text = one.configs.get("emulator").map_or("", String::as_str);
        let drawn = toml::from_str::<toml::Table>(text)
            .ok()
            .and_then(|table| table.get("tolerance")?.as_float());
        (serial(one) != serial(other) && drawn != Some(0.0)).then_some("drive's serial number")
    });
    what.map_or(Ok(()), |what| {
        let headline = format!("{} and {} differ in their {what}", of.display(), folder.display());
        Err(Failure::usage(
            headline,
            "a suite is for one machine on one bench; give the runs of one only",
        ))
    })
}
