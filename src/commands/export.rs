//! `export`: a model and the gains of its regulator for other tools, as source text of a language or as JSON with every
//! effect; a torque map measured in runs; a run as columns.

use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use crate::commands::arguments::{MapArguments, by_name, run_path};
use crate::commands::tune::KeptGains;
use crate::report::export::{Export, Regulator, Target, formulas, map_as_c};
use crate::report::wording::effects;
use crate::runtime::{Failure, Terminal, output, read_model, require_parquet, samples_as_parquet};
use drivebench_bench::recording::{LoadedRun, RunFolder, write_run};
use drivebench_control::{Actuator, Holding, viscous_n_m_s_per_rad};
use drivebench_diagnose::torque_map;
use drivebench_identify::noise::NoiseFloor;
use drivebench_model::plant::{MappedTorque, ModelFile, Scenario};

/// Write a model, with the gains of its regulator, as JSON, C, Python, MATLAB/Octave or Modelica; friction or cogging as
/// measured in runs, as CSV or C; or a run as Parquet
#[derive(clap::Args)]
#[command(after_help = "Examples:
  drivebench export --model model.toml --to c --output motor.h
  drivebench tune --model model.toml --json > gains.json
  drivebench export --model model.toml --to python --gains gains.json --limit-v 110 --output motor.py
  drivebench export --torque-map friction --run runs/a --run runs/b --model model.toml --to c --output friction.h
  drivebench export --run runs/latest --to parquet --output run.parquet")]
pub(super) struct Arguments {
    /// Model file, complete
    #[arg(long, value_parser = run_path(), required_unless_present = "run")]
    model: Option<PathBuf>,
    /// Run folder, samples.csv, or any CSV with --map; several for a torque map
    #[arg(long, value_parser = run_path(), conflicts_with = "gains")]
    run: Vec<PathBuf>,
    /// friction (over the speed, both directions) or cogging (over a turn): measured from the torque balance of the runs
    /// with Kt and J of the model, not with the friction or cogging of the model; a bin without data is empty
    #[arg(long, value_name = "TORQUE", value_parser = by_name(MappedTorque::ALL, MappedTorque::name), requires = "run", requires = "model")]
    torque_map: Option<MappedTorque>,
    #[command(flatten)]
    map: MapArguments,
    /// Format
    #[arg(long, value_enum)]
    to: Format,
    /// Gains of this model, as `tune --json` prints them
    #[arg(long, value_name = "GAINS.json", requires = "limit_v")]
    gains: Option<PathBuf>,
    /// Largest voltage that the regulator may give, V
    #[arg(long, value_name = "V", requires = "gains")]
    limit_v: Option<f64>,
    /// Write here instead of to stdout; never overwritten. The model has the name of the file
    #[arg(long, value_name = "FILE")]
    output: Option<PathBuf>,
}

#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Format {
    /// The model file's tables, every effect with its law
    Json,
    /// One header: C99, no heap, a step function
    C,
    /// A class on numpy
    Python,
    /// A function file for MATLAB and GNU Octave
    Matlab,
    /// A model with an input of the voltage
    Modelica,
    /// The torque map: a row for each bin, with its 95 % interval
    Csv,
    /// The run as columns, for pandas and others; in programs that were built with the feature parquet
    Parquet,
}

pub(super) fn execute(arguments: &Arguments, terminal: &Terminal) -> Result<(), Failure> {
    output::refuse_existing(&arguments.output, "--output")?;
    let stem = arguments.output.as_ref().and_then(|path| path.file_stem());
    let name = stem.map(|stem| stem.to_string_lossy());
    let name = name.as_deref();
    let (runs, to) = (arguments.run.as_slice(), arguments.to);
    let (text, title) = match (&arguments.model, runs, arguments.torque_map) {
        (Some(model), [], None) if !matches!(to, Format::Csv | Format::Parquet) => {
            export(arguments, model, name)?
        }
        (Some(model), [_, ..], Some(of)) if matches!(to, Format::C | Format::Csv) => {
            let loaded: Vec<LoadedRun> = runs
                .iter()
                .map(|run| arguments.map.load(run, terminal))
                .collect::<Result<_, _>>()?;
            let name = name.unwrap_or(of.name());
            torque_map_of(of, model, &loaded, (to == Format::C).then_some(name))?
        }
        (None, [run], None) if to == Format::Parquet => return columns(arguments, run, terminal),
        _ => {
            let headline = "a run is written as parquet, a torque map as csv or c, and a model as anything else";
            let help = "give --run RUN --to parquet, --torque-map TORQUE --run RUN --model MODEL.toml --to csv, or --model MODEL.toml with another format";
            return Err(Failure::usage(headline, help));
        }
    };
    let Some(path) = &arguments.output else {
        return terminal.line(text.trim_end());
    };
    terminal.file(path, &text)?;
    terminal.text(&format!("{}: {title}", path.display()))
}

impl Format {
    /// The language of a model; none for JSON, of a torque map and of a run.
    const fn target(self) -> Option<Target> {
        match self {
            Self::C => Some(Target::C),
            Self::Python => Some(Target::Python),
            Self::Matlab => Some(Target::Matlab),
            Self::Modelica => Some(Target::Modelica),
            Self::Json | Self::Csv | Self::Parquet => None,
        }
    }
}

/// The table of a run as Parquet: all columns of a run folder, else the columns that were read.
fn columns(arguments: &Arguments, run: &Path, terminal: &Terminal) -> Result<(), Failure> {
    let Some(path) = &arguments.output else {
        let help = "add --output FILE: Parquet is binary and is not printed";
        return Err(Failure::usage("--output is missing", help));
    };
    require_parquet()?;
    let loaded = arguments.map.load(run, terminal)?;
    let is_whole = run.is_dir() && !arguments.map.is_given() && loaded.run.rows_dropped == 0;
    let table = if is_whole {
        let samples = RunFolder::existing(run).samples();
        std::fs::read(&samples).map_err(|error| output::cannot_read(&samples, &error))?
    } else {
        terminal.message(
            "the file is not a recorded log: only the columns that drivebench reads are written",
        );
        write_run(&loaded.run).into_bytes()
    };
    terminal.file(path, &samples_as_parquet(&table).map_err(Failure::internal)?)?;
    let rows = loaded.run.rows();
    terminal.text(&format!("{}: {rows} rows", path.display()))
}

/// The text of the file, and its title in one line.
fn export(
    arguments: &Arguments,
    path: &Path,
    name: Option<&str>,
) -> Result<(String, String), Failure> {
    let file = read_model(path)?;
    file.model.require_complete()?;
    let regulator = match arguments.gains.as_deref().zip(arguments.limit_v) {
        Some((gains, limit_v)) => Some(regulator(&file, gains, limit_v)?),
        None => None,
    };
    let title = title(&file, path);
    let text = match arguments.to.target() {
        None => as_json(&file, regulator.as_ref(), &title)?,
        Some(target) => {
            let name = name.unwrap_or(&file.model.motor.name);
            Export::new(&file.model, regulator, name, &title)?.written(target)?
        }
    };
    Ok((text, title))
}

/// A torque map measured in runs, as C or else as CSV, and its title in one line.
fn torque_map_of(
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
        match left_out.iter().find(|(run, _)| *run == index) {
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
        return Err(Failure::usage(headline, "the largest voltage that may be commanded"));
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

/// Motor, effects, file, runs and program in one line.
fn title(file: &ModelFile, path: &Path) -> String {
    let effects = effects(&file.model.effect_ids());
    let fitted = match file.history.fitted_on.as_slice() {
        [] => String::new(),
        runs => format!(", fitted on {}", runs.join(", ")),
    };
    let (motor, version, path) =
        (&file.model.motor.name, env!("CARGO_PKG_VERSION"), path.display());
    format!("{motor} with {effects}: {path}{fitted}, exported by drivebench {version}")
}

/// The tables of the model file as they are, the law of every effect, and the regulator.
fn as_json(
    file: &ModelFile,
    regulator: Option<&Regulator>,
    title: &str,
) -> Result<String, Failure> {
    let internal = |error: toml::de::Error| Failure::internal(error.to_string());
    let table: toml::Table = file.to_toml().parse().map_err(internal)?;
    let mut value = serde_json::to_value(&table)?;
    value["title"] = title.into();
    let laws = file.model.effects.iter().map(|active| {
        let written = formulas(active).map(|all| {
            let all = all.into_iter();
            all.map(|(equation, text)| json!({ "adds_to": equation, "formula": text }))
                .collect::<Vec<Value>>()
        });
        json!({ "id": active.id(), "equation": active.effect.card().equation, "terms": written })
    });
    value["laws"] = laws.collect();
    if let Some(regulator) = regulator {
        let values = regulator.values().map(|(key, value)| (key.to_owned(), Value::from(value)));
        value["regulator"] = Value::Object(values.into_iter().collect());
        if let Some(notch) = &regulator.gains.notch {
            value["regulator"]["notch"] = json!(notch);
        }
    }
    Ok(serde_json::to_string_pretty(&value)?)
}
