//! A model and the gains of its regulator for other tools: as source text of a language, or as JSON with every effect; and
//! the map of a torque that runs show.

use std::path::Path;

use serde_json::{Value, json};

use super::failure::Failure;
use super::files::read_model;
use super::output;
use super::tune::KeptGains;
use crate::report::export::{Export, ExportError, Regulator, Target, formulas, map_as_c};
use drivebench_bench::recording::{ColumnKind, LoadedRun, RunFolder, write_run};
use drivebench_control::{Actuator, Holding, viscous_n_m_s_per_rad};
use drivebench_diagnose::torque_map;
use drivebench_identify::noise::NoiseFloor;
use drivebench_model::plant::{MappedTorque, ModelFile, Scenario};

/// What is asked to be exported.
pub(crate) struct ExportRequest<'a> {
    pub(crate) model: &'a Path,
    /// `None` for JSON.
    pub(crate) target: Option<Target>,
    /// A tuning, and the voltage that the regulator may give.
    pub(crate) gains: Option<(&'a Path, f64)>,
    /// What it is called; without it by its motor.
    pub(crate) name: Option<&'a str>,
}

/// The text of the file, and one line that says what is in it.
pub(crate) fn export(request: &ExportRequest<'_>) -> Result<(String, String), Failure> {
    let file = read_model(request.model)?;
    let model = &file.model;
    model.require_complete()?;
    let regulator = match request.gains {
        Some((path, limit_v)) => Some(regulator(&file, path, limit_v)?),
        None => None,
    };
    let title = title(&file, request.model);
    let text = match request.target {
        None => as_json(&file, regulator.as_ref(), &title)?,
        Some(target) => {
            let name = request.name.unwrap_or(&model.motor.name);
            Export::new(model, regulator, name, &title)?.written(target)?
        }
    };
    Ok((text, title))
}

/// The map of a torque that runs show, as C or else as CSV, and one line that says what is in it.
pub(crate) fn torque_map_of(
    of: MappedTorque,
    model: &Path,
    runs: &[LoadedRun],
    c_name: Option<&str>,
) -> Result<(String, String), Failure> {
    let file = read_model(model)?;
    file.model.require_complete()?;
    let mut measured = Vec::new();
    for loaded in runs {
        let run = Scenario::from_run(&loaded.run)?;
        let noise =
            NoiseFloor::from_standstill(&run).unwrap_or_else(|| NoiseFloor::from_spread(&run));
        measured.push((run, noise));
    }
    let map = torque_map(of, &file.model, &measured)?
        .map_err(|error| Failure::usage(format!("{} map: {error}", of.name()), error.help()))?;
    let (map, left_out) = (map.map, map.left_out);
    let (mut used, mut unused) = (Vec::new(), Vec::new());
    for (index, loaded) in runs.iter().enumerate() {
        let name = &loaded.run.name;
        match left_out.iter().find(|(place, _)| *place == index) {
            Some((_, signal)) => unused.push(format!("; {name} has no {signal} and was left out")),
            None => used.push(name.as_str()),
        }
    }
    let title = format!(
        "{} of {}, {} of {} bins measured, {} of them not zero, in {}{}: Kt and J of {}, exported by drivebench {}",
        of.name(),
        file.model.motor.name,
        map.known(),
        map.bins.len(),
        map.differ(),
        used.join(", "),
        unused.concat(),
        model.display(),
        env!("CARGO_PKG_VERSION")
    );
    let text = match c_name {
        Some(name) => map_as_c(&map, name, &title),
        None => map.to_csv(),
    };
    Ok((text, title))
}

fn regulator(file: &ModelFile, path: &Path, limit_v: f64) -> Result<Regulator, Failure> {
    if !(limit_v.is_finite() && limit_v > 0.0) {
        let headline =
            format!("--limit-v {limit_v} is not allowed (expected a number of volts above 0)");
        let help = "the largest voltage that the drive may be told to give";
        return Err(Failure::usage(headline, help));
    }
    let kept = KeptGains::read(path, &file.model)?;
    let viscous = viscous_n_m_s_per_rad(&file.model, Actuator::Voltage)?;
    Ok(Regulator {
        gains: kept.gains,
        holding: Holding::of(&file.model, Actuator::Voltage, viscous),
        period_s: kept.timing.period_s,
        leaving_s: kept.timing.leaving_s(),
        limit_v,
    })
}

/// What it is, with its effects, who wrote it and where it comes from, on one line.
fn title(file: &ModelFile, path: &Path) -> String {
    let effects = match file.model.effect_ids().as_slice() {
        [] => "no effect beyond the baseline".to_owned(),
        ids => ids.join(", "),
    };
    let fitted = match file.history.fitted_on.as_slice() {
        [] => String::new(),
        runs => format!(", fitted on {}", runs.join(", ")),
    };
    let (motor, version, path) = (
        &file.model.motor.name,
        env!("CARGO_PKG_VERSION"),
        path.display(),
    );
    format!("{motor} with {effects}: {path}{fitted}, exported by drivebench {version}")
}

/// The tables of the model file as they are, the law of every effect, and the regulator.
fn as_json(
    file: &ModelFile,
    regulator: Option<&Regulator>,
    title: &str,
) -> Result<String, Failure> {
    let internal = |error: &dyn std::fmt::Display| Failure::internal(error.to_string());
    let table: toml::Table = file.to_toml().parse().map_err(|error| internal(&error))?;
    let mut value = serde_json::to_value(&table).map_err(|error| internal(&error))?;
    value["title"] = title.into();
    let laws = file.model.effects.iter().map(|active| {
        let written = formulas(active).map(|all| {
            let all = all.into_iter();
            all.map(|(place, text)| json!({ "adds_to": place, "formula": text }))
                .collect::<Vec<Value>>()
        });
        json!({ "id": active.id(), "equation": active.effect.card().equation, "terms": written })
    });
    value["laws"] = laws.collect();
    if let Some(regulator) = regulator {
        let values = regulator
            .values()
            .map(|(key, value)| (key.to_owned(), Value::from(value)));
        value["regulator"] = Value::Object(values.into_iter().collect());
        if let Some(notch) = &regulator.gains.notch {
            value["regulator"]["notch"] = json!(notch);
        }
    }
    serde_json::to_string_pretty(&value).map_err(|error| internal(&error))
}

/// The table of a run as Parquet: of a folder as it stands, else the columns that were read.
pub(crate) fn run_as_parquet(
    loaded: &LoadedRun,
    folder: Option<&Path>,
) -> Result<Vec<u8>, Failure> {
    let table = match folder.filter(|_| loaded.run.rows_dropped == 0) {
        None => {
            output::message(
                "the file is not the log of a run as it was recorded: the quantities that are known are written, other columns not",
            );
            write_run(&loaded.run).into_bytes()
        }
        Some(folder) => {
            let samples = RunFolder::existing(folder).samples();
            let cannot = |error| format!("{}: cannot read: {error}", samples.display());
            std::fs::read(&samples)
                .map_err(|error| Failure::usage(cannot(error), "check the path"))?
        }
    };
    samples_as_parquet(&table).map_err(Failure::internal)
}

/// The table of `samples.csv` as Parquet.
pub(crate) fn samples_as_parquet(table: &[u8]) -> Result<Vec<u8>, String> {
    parquet(table, ColumnKind::of_samples)
}

/// The table of a CSV as Parquet.
#[cfg(feature = "parquet")]
pub(crate) fn parquet(
    table: impl std::io::Read,
    kind: impl Fn(&str) -> ColumnKind,
) -> Result<Vec<u8>, String> {
    drivebench_bench::recording::parquet(table, kind).map_err(|error| error.to_string())
}

#[cfg(not(feature = "parquet"))]
pub(crate) fn parquet(
    _table: impl std::io::Read,
    _kind: impl Fn(&str) -> ColumnKind,
) -> Result<Vec<u8>, String> {
    Err(NO_PARQUET.to_owned())
}

const NO_PARQUET: &str = "this program was built without Parquet";

/// Refuses Parquet where this program was built without it; to be asked before the work.
pub(crate) fn require_parquet() -> Result<(), Failure> {
    let help = "pandas, Polars and DuckDB read the CSV as it is; or install with `cargo install --path . --features parquet`";
    let refused = Failure::usage(NO_PARQUET, help);
    cfg!(feature = "parquet").then_some(()).ok_or(refused)
}

impl From<ExportError> for Failure {
    fn from(error: ExportError) -> Self {
        Self::usage(error.to_string(), error.help())
    }
}
