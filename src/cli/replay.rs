//! `replay`: the on-line estimators over a log, row by row; what the live run said must come out again to the bit.
//!
//! ```text
//! samples.csv --row by row--> estimators (configuration from the manifest) -> compared with result.json
//! ```

use std::path::{Path, PathBuf};

use serde::Serialize;
use serde_json::{Map, Value};

use super::failure::{Failure, INTERNAL, REFUSED, USAGE};
use super::{output, signals};
use crate::bench::{Difference, OnlineResult, OnlineSettings, first_difference, replay};
use crate::identification::online::OnlineConfig;
use crate::recording::{ColumnMap, RunFile, RunFolder, RunRows};

/// Run the on-line estimators over a log again and compare with what they said live
#[derive(clap::Args)]
#[command(after_help = "Examples:
  drivebench replay runs/20260131T120000Z-first      exit status 1 where it differs from the live estimates
  drivebench replay log.csv --map time_s=t,voltage_cmd_v=u,current_a=i,speed_rad_s=w")]
pub(super) struct Arguments {
    /// Run folder, samples.csv, or any CSV with --map
    run: PathBuf,
    /// Columns of a foreign CSV: 'target=header[*factor][+offset],...', as time_s=t,speed_rad_s=rpm*0.104719755
    #[arg(long, value_name = "MAP")]
    #[expect(
        clippy::doc_markdown,
        reason = "the help in a terminal shows backticks as they are"
    )]
    map: Option<String>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// The result as JSON; its estimates have the names that they have in `result.json`.
#[derive(Serialize)]
struct ReplayResult {
    run: String,
    rows_dropped: usize,
    #[serde(flatten)]
    online: OnlineResult,
    configuration: OnlineSettings,
    /// `manifest`, or `default` where nobody has said.
    configuration_from: &'static str,
    /// Null where there is nothing to compare with.
    identical: Option<bool>,
    first_difference: Option<Difference>,
    /// The file compared with, or why there is none.
    compared_with: Option<String>,
    not_compared_because: Option<String>,
}

pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    let _endable = signals::endable()?;
    let map = arguments
        .map
        .as_deref()
        .map(str::parse::<ColumnMap>)
        .transpose()?;
    let mut rows = RunRows::open(&arguments.run, map.as_ref())?;
    let (settings, configuration_from) = settings(&rows)?;
    let estimator = replay(|| rows.rows.next_row(), OnlineConfig::from(settings))?;
    if let Some(dialect) = rows.rows.dialect() {
        output::message(&dialect);
    }
    let mut warnings = rows.warnings();
    warnings.extend(why_silent(&rows));
    output::warn(&warnings);

    let online = estimator.result();
    let live = live_result(&rows, map.is_some());
    let (difference, compared_with, because) = match live {
        Ok(_) if configuration_from == "default" => (
            None,
            None,
            Some("the manifest does not hold the configuration of the live estimators".to_owned()),
        ),
        Ok((path, live)) => {
            let replayed = serde_json::to_value(&online).map_err(|error| {
                Failure::new(INTERNAL, format!("the result has no JSON form: {error}"))
            })?;
            (
                Some(first_difference(&live, &replayed)),
                Some(path.display().to_string()),
                None,
            )
        }
        Err(because) => (None, None, Some(because)),
    };
    let result = ReplayResult {
        run: arguments.run.display().to_string(),
        rows_dropped: rows.rows.rows_dropped(),
        online,
        configuration: settings,
        configuration_from,
        identical: difference.as_ref().map(Option::is_none),
        first_difference: difference.flatten(),
        compared_with,
        not_compared_because: because,
    };
    output::result(&result, arguments.json, text)?;
    match &result.first_difference {
        Some(difference) => Err(Failure::with_help(
            REFUSED,
            format!(
                "the replay differs from the live estimates, first in {}: live {}, replayed {}",
                difference.key, difference.live, difference.replayed
            ),
            "the samples were changed after the run, or another version of the program recorded it: compare program_version in manifest.json",
        )),
        None => Ok(()),
    }
}

/// What the live estimators were configured with.
fn settings(rows: &RunRows) -> Result<(OnlineSettings, &'static str), Failure> {
    let kept = rows
        .manifest
        .as_ref()
        .and_then(|manifest| manifest.configs.get(OnlineSettings::NAME));
    let Some(text) = kept else {
        return Ok((OnlineSettings::from(OnlineConfig::default()), "default"));
    };
    let settings = toml::from_str(text).map_err(|error| {
        Failure::with_help(
            USAGE,
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

/// The file with the live estimates and what it says; or why there is none.
fn live_result(rows: &RunRows, mapped: bool) -> Result<(PathBuf, Value), String> {
    let folder = rows
        .folder
        .as_deref()
        .filter(|_| !mapped)
        .ok_or("a foreign file holds no live estimates")?;
    let path = RunFolder::existing(folder).file(RunFile::Result);
    let text = match read(&path) {
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

fn read(path: &Path) -> Option<String> {
    std::fs::read_to_string(path).ok()
}

/// What the estimators cannot do without.
fn why_silent(rows: &RunRows) -> Option<String> {
    use crate::sample::Channel;
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

fn text(result: &ReplayResult) -> String {
    let mut lines = vec![format!(
        "{}: {} rows replayed",
        result.run, result.online.rows
    )];
    for (key, estimate) in &result.online.parameters {
        lines.push(estimate_line(key, estimate));
    }
    lines.push(match (result.identical, &result.not_compared_because) {
        (Some(true), _) => "identical to the live estimates, to the bit".to_owned(),
        (Some(false), _) => "not identical to the live estimates".to_owned(),
        (None, Some(because)) => format!("nothing to compare with: {because}"),
        (None, None) => "nothing to compare with".to_owned(),
    });
    lines.join("\n")
}

/// Every digit: two replays are compared by eye as well.
fn estimate_line(key: &str, estimate: &Value) -> String {
    let word = |name: &str| estimate[name].as_str().unwrap_or_default();
    match (estimate["value"].as_f64(), estimate["std"].as_f64()) {
        (Some(value), Some(std)) => format!(
            "{:<16} {key} = {value} +- {std:.2e} {}",
            word("verdict"),
            word("unit")
        ),
        (Some(value), None) => format!("{:<16} {key} = {value} {}", word("verdict"), word("unit")),
        _ => format!("{:<16} {key}: {}", word("verdict"), word("reason")),
    }
}
