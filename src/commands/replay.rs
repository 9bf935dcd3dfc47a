//! `replay`: the on-line estimators over a log, row by row; the live estimates must be reproduced to the bit.

use std::path::{Path, PathBuf};

use serde::Serialize;
use serde_json::{Map, Value};

use crate::commands::arguments::{FileArguments, run_path};
use crate::runtime::{Failure, REFUSED, Terminal, read_text};
use drivebench_bench::recording::{ReadOptions, RunFile, RunFolder, RunRows};
use drivebench_bench::{Difference, OnlineResult, OnlineSettings, first_difference, replay};
use drivebench_identify::online::OnlineConfig;
use drivebench_model::sample::Channel;

/// Run the on-line estimators over a log again and compare with the live estimates
#[derive(clap::Args)]
#[command(after_help = "Examples:
  drivebench replay runs/20260131T120000Z-first      exit status 1 where it differs from the live estimates
  drivebench replay log.csv --map time_s=t,voltage_cmd_v=u,current_a=i,speed_rad_s=w")]
pub(super) struct Arguments {
    /// Run folder, samples.csv, or any CSV with --map
    #[arg(value_parser = run_path())]
    run: PathBuf,
    #[command(flatten)]
    file: FileArguments,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn execute(arguments: &Arguments, terminal: &Terminal) -> Result<(), Failure> {
    let _endable = terminal.endable()?;
    let map = arguments.file.map()?;
    let shown = terminal.progress("replay");
    terminal.stage("runs the estimators over the record", 0);
    let result = replayed(&arguments.run, arguments.file.options(map.as_ref()), terminal)?;
    drop(shown);
    terminal.result(&result, arguments.json, text)?;
    let Some(Difference { key, live, replayed }) = &result.first_difference else {
        return Ok(());
    };
    Err(Failure::with_help(
        REFUSED,
        format!(
            "the replay differs from the live estimates, first in {key}: live {live}, replayed {replayed}"
        ),
        "the samples were changed after the run, or another version of the program recorded it: compare program_version in manifest.json",
    ))
}

fn text(result: &Replayed) -> String {
    let mut lines = vec![format!("{}: {} rows replayed", result.run, result.online.rows)];
    for (key, estimate) in &result.online.parameters {
        lines.push(estimate_line(key, estimate));
    }
    lines.push(match (result.identical, &result.not_compared_because) {
        (Some(true), _) => "identical to the live estimates, to the bit".to_owned(),
        (Some(false), _) => "not identical to the live estimates".to_owned(),
        (None, Some(reason)) => format!("nothing to compare with: {reason}"),
        (None, None) => "nothing to compare with".to_owned(),
    });
    lines.join("\n")
}

/// Every digit: two replays are compared by eye as well.
fn estimate_line(key: &str, estimate: &Value) -> String {
    let text = |name: &str| estimate[name].as_str().unwrap_or_default();
    match (estimate["value"].as_f64(), estimate["std"].as_f64()) {
        (Some(value), Some(std)) => {
            format!("{:<16} {key} = {value} +- {std:.2e} {}", text("verdict"), text("unit"))
        }
        (Some(value), None) => format!("{:<16} {key} = {value} {}", text("verdict"), text("unit")),
        _ => format!("{:<16} {key}: {}", text("verdict"), text("reason")),
    }
}

/// The result as JSON; its estimates have the keys of `result.json`.
#[derive(Serialize)]
struct Replayed {
    run: String,
    rows_dropped: usize,
    #[serde(flatten)]
    online: OnlineResult,
    configuration: OnlineSettings,
    /// `manifest`, or `default` where there is none.
    configuration_from: &'static str,
    /// Null where there is nothing to compare with.
    identical: Option<bool>,
    first_difference: Option<Difference>,
    /// The file compared with, or why there is none.
    compared_with: Option<String>,
    not_compared_because: Option<String>,
}

fn replayed(
    run: &Path,
    options: ReadOptions<'_>,
    terminal: &Terminal,
) -> Result<Replayed, Failure> {
    let mut rows = RunRows::open(run, options)?;
    let (settings, configuration_from) = settings(&rows)?;
    let estimator = replay(|| rows.rows.next_row(), OnlineConfig::from(settings))?;
    if let Some(dialect) = rows.rows.dialect() {
        terminal.message(&dialect);
    }
    let mut warnings = rows.warnings();
    warnings.extend(missing_channels(&rows));
    terminal.warn(&warnings);
    let online = estimator.result();
    let live = live_result(&rows, options.map.is_some()).and_then(|live| {
        let is_known = configuration_from == "manifest";
        let reason = "the manifest does not hold the configuration of the live estimators";
        is_known.then_some(live).ok_or_else(|| reason.to_owned())
    });
    let (mut difference, mut compared_with, mut reason) = (None, None, None);
    match live {
        Ok((path, live)) => {
            let replayed = serde_json::to_value(&online)?;
            difference = Some(first_difference(&live, &replayed));
            compared_with = Some(path.display().to_string());
        }
        Err(text) => reason = Some(text),
    }
    Ok(Replayed {
        run: run.display().to_string(),
        rows_dropped: rows.rows.rows_dropped(),
        online,
        configuration: settings,
        configuration_from,
        identical: difference.as_ref().map(Option::is_none),
        first_difference: difference.flatten(),
        compared_with,
        not_compared_because: reason,
    })
}

/// Configuration of the live estimators.
fn settings(rows: &RunRows) -> Result<(OnlineSettings, &'static str), Failure> {
    let kept =
        rows.manifest.as_ref().and_then(|manifest| manifest.configs.get(OnlineSettings::NAME));
    let Some(text) = kept else {
        return Ok((OnlineSettings::from(OnlineConfig::default()), "default"));
    };
    let settings = toml::from_str(text).map_err(|error| {
        Failure::usage(
            format!(
                "manifest.json: configs.{} cannot be read: {}",
                OnlineSettings::NAME,
                error.message()
            ),
            "it was written by another version of the program, or changed by hand",
        )
    })?;
    Ok((settings, "manifest"))
}

/// The file with the live estimates and its content; or why there is none.
fn live_result(rows: &RunRows, mapped: bool) -> Result<(PathBuf, Value), String> {
    let folder = rows
        .folder
        .as_deref()
        .filter(|_| !mapped)
        .ok_or("a foreign file holds no live estimates")?;
    let path = RunFolder::existing(folder).file(RunFile::Result);
    let text = match read_text(&path).ok() {
        Some(text) => text,
        None if rows.manifest.as_ref().is_some_and(|m| !m.finished) => {
            return Err("the run was not finished: its live estimates were never written".into());
        }
        None => return Err(format!("there is no {}", path.display())),
    };
    let mut document: Map<String, Value> = serde_json::from_str(&text)
        .map_err(|error| format!("{} cannot be read: {error}", path.display()))?;
    match document.shift_remove("online") {
        Some(live) => Ok((path, live)),
        None => Err(format!("{} holds no live estimates", path.display())),
    }
}

/// Channels that the estimators need and that are not in the run.
fn missing_channels(rows: &RunRows) -> Option<String> {
    let missing: Vec<&str> = [Channel::Current, Channel::Speed]
        .into_iter()
        .filter(|needed| rows.rows.channels().all(|channel| channel != *needed))
        .map(Channel::key)
        .collect();
    (!missing.is_empty()).then(|| {
        format!(
            "no {}: the on-line estimators need measured current and speed",
            missing.join(" and no ")
        )
    })
}
