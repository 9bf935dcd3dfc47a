//! The on-line estimators over a log, row by row; what the live run said must come out again to the bit.
//!
//! ```text
//! samples.csv --row by row--> estimators (configuration from the manifest) -> compared with result.json
//! ```

use std::path::{Path, PathBuf};

use serde::Serialize;
use serde_json::{Map, Value};

use super::failure::Failure;
use super::output;
use crate::bench::{Difference, OnlineResult, OnlineSettings, first_difference, replay};
use crate::identification::online::OnlineConfig;
use crate::recording::{ColumnMap, RunFile, RunFolder, RunRows};
use crate::sample::Channel;

/// The result as JSON; its estimates have the names that they have in `result.json`.
#[derive(Serialize)]
pub(crate) struct Replayed {
    pub(crate) run: String,
    pub(crate) rows_dropped: usize,
    #[serde(flatten)]
    pub(crate) online: OnlineResult,
    pub(crate) configuration: OnlineSettings,
    /// `manifest`, or `default` where nobody has said.
    pub(crate) configuration_from: &'static str,
    /// Null where there is nothing to compare with.
    pub(crate) identical: Option<bool>,
    pub(crate) first_difference: Option<Difference>,
    /// The file compared with, or why there is none.
    pub(crate) compared_with: Option<String>,
    pub(crate) not_compared_because: Option<String>,
}

/// Runs the estimators over a run and compares with what they said live.
pub(crate) fn replayed(run: &Path, map: Option<&ColumnMap>) -> Result<Replayed, Failure> {
    let mut rows = RunRows::open(run, map)?;
    let (settings, configuration_from) = settings(&rows)?;
    let estimator = replay(|| rows.rows.next_row(), OnlineConfig::from(settings))?;
    if let Some(dialect) = rows.rows.dialect() {
        output::message(&dialect);
    }
    let mut warnings = rows.warnings();
    warnings.extend(why_silent(&rows));
    output::warn(&warnings);
    let online = estimator.result();
    let live = live_result(&rows, map.is_some()).and_then(|live| {
        let is_known = configuration_from == "manifest";
        let reason = "the manifest does not hold the configuration of the live estimators";
        is_known.then_some(live).ok_or_else(|| reason.to_owned())
    });
    let (mut difference, mut compared_with, mut because) = (None, None, None);
    match live {
        Ok((path, live)) => {
            let replayed = serde_json::to_value(&online).map_err(|error| {
                Failure::internal(format!("the result has no JSON form: {error}"))
            })?;
            difference = Some(first_difference(&live, &replayed));
            compared_with = Some(path.display().to_string());
        }
        Err(reason) => because = Some(reason),
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
        not_compared_because: because,
    })
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

/// The file with the live estimates and what it says; or why there is none.
fn live_result(rows: &RunRows, mapped: bool) -> Result<(PathBuf, Value), String> {
    let folder = rows
        .folder
        .as_deref()
        .filter(|_| !mapped)
        .ok_or("a foreign file holds no live estimates")?;
    let path = RunFolder::existing(folder).file(RunFile::Result);
    let text = match std::fs::read_to_string(&path).ok() {
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

/// What the estimators cannot do without.
fn why_silent(rows: &RunRows) -> Option<String> {
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
