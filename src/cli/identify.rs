//! `identify`: parameters with confidence and verdict.

use std::fmt::Write as _;
use std::path::PathBuf;

use serde_json::{Map, Value, json};

use super::data::{MapArguments, load, model};
use super::failure::{Failure, NOT_IDENTIFIABLE, USAGE};
use super::output;
use crate::identification::scheme::{self, Data, Identified};
use crate::plant::{FittedValue, ModelFile, MotorKey, Scenario};
use crate::recording::LoadedRun;
use crate::sample::Channel;

/// Find the motor's parameters in a recorded run, each with its uncertainty and verdict
#[derive(clap::Args)]
#[command(after_help = after_help())]
pub(super) struct Arguments {
    /// Run folder, samples.csv, or any CSV with --map
    run: PathBuf,
    /// Model file: which parameters are sought, which are fixed; without it the five-parameter baseline
    #[arg(long)]
    model: Option<PathBuf>,
    /// Method, one of the schemes listed below
    #[arg(long, value_name = "S")]
    scheme: Option<String>,
    /// Exit with status 5 unless each of these keys was found
    #[arg(long, value_name = "KEY,...", value_delimiter = ',')]
    require: Vec<String>,
    /// Instead of parameters: the load torque over time, with the parameters of --model, into this file
    #[arg(long, value_name = "FILE.csv", requires = "model")]
    load_torque: Option<PathBuf>,
    /// Write the identified model here
    #[arg(long, value_name = "MODEL2.toml")]
    output: Option<PathBuf>,
    #[command(flatten)]
    map: MapArguments,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// The schemes as the catalogue has them, then examples.
fn after_help() -> String {
    let mut text = "Schemes:\n".to_owned();
    for scheme in scheme::CATALOGUE {
        let _ = writeln!(text, "  {:<17} {}", scheme.id(), scheme.summary());
    }
    text.push_str(
        "
Examples:
  drivebench identify runs/a --model runs/a/model.toml --require inertia_kg_m2
  drivebench identify axis.csv --model axis.toml --map time_s=t,torque_n_m=force,angle_rad=position",
    );
    text
}

pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    let run = load(&arguments.run, arguments.map.of_run()?.as_ref())?;
    let file = model(arguments.model.as_ref(), &run)?.file;
    if let Some(path) = &arguments.load_torque {
        return super::load_torque::execute(path, &run.run, &file.model, arguments.json);
    }
    let scenario = Scenario::from_run(&run.run)?;
    if scenario.input_channel == Channel::VoltageCmd {
        output::message("voltage_cmd_v serves as the voltage");
    }
    let scheme = match &arguments.scheme {
        Some(id) => scheme::find(id)?,
        None => scheme::default_for(&scenario),
    };
    let found = scheme.identify(&Data {
        run: &run.run,
        scenario: &scenario,
        model: &file.model,
    })?;
    print(arguments, &found, &run, &scenario)?;
    if let Some(path) = &arguments.output {
        write_model(path, file, &found, &run)?;
    }
    verdict(arguments, &found)
}

fn print(
    arguments: &Arguments,
    found: &Identified,
    run: &LoadedRun,
    scenario: &Scenario,
) -> Result<(), Failure> {
    let parameters: Map<String, Value> = found
        .parameters
        .iter()
        .map(|parameter| {
            (
                parameter.key.clone(),
                serde_json::to_value(parameter).unwrap_or_default(),
            )
        })
        .collect();
    let measured = [Channel::Current, Channel::Speed]
        .into_iter()
        .find_map(|channel| run.run.period_s(channel));
    let value = json!({
        "scheme": found.scheme,
        "parameters": parameters,
        "rows": run.run.rows(),
        "rows_used": scenario.samples(),
        "rows_dropped": run.run.rows_dropped,
        "period_s": measured,
        "input": scenario.input_channel.key(),
        "notes": run.run.notes.iter().chain(&found.notes).collect::<Vec<_>>(),
    });
    output::result(&value, arguments.json, |_| text(found))
}

fn text(found: &Identified) -> String {
    let mut text = format!("scheme {}\n", found.scheme);
    for parameter in &found.parameters {
        let number = match (parameter.value, parameter.std) {
            (Some(value), Some(std)) => format!("{value:>12.5e} +- {std:.1e} {}", parameter.unit),
            (Some(value), None) => format!("{value:>12.5e} {}", parameter.unit),
            (None, _) => format!("{:>12}", "-"),
        };
        let reason = parameter
            .reason
            .as_deref()
            .map_or_else(String::new, |reason| format!(": {reason}"));
        let _ = writeln!(
            text,
            "{:<44} {number:<36} {}{reason}",
            parameter.key,
            parameter.verdict.name()
        );
    }
    if let Some(constant) = found
        .parameters
        .iter()
        .find(|p| p.key == MotorKey::BackEmf.key())
        .and_then(|p| p.value)
    {
        let volts = crate::units::v_per_krpm_from_v_s_per_rad(constant);
        let _ = writeln!(
            text,
            "back-EMF {volts:.2} V per 1000 r/min; torque constant {constant:.4} N.m/A (equal in SI)"
        );
    }
    for note in &found.notes {
        let _ = writeln!(text, "{note}");
    }
    text
}

fn write_model(
    path: &PathBuf,
    mut file: ModelFile,
    found: &Identified,
    run: &LoadedRun,
) -> Result<(), Failure> {
    if path.exists() {
        let headline = format!(
            "{}: exists already, and models are never overwritten",
            path.display()
        );
        return Err(Failure::with_help(
            USAGE,
            headline,
            "choose another name for --output",
        ));
    }
    file.model = found.model.clone();
    file.history.fitted_on = vec![run.run.name.clone()];
    file.history.fitted = found
        .parameters
        .iter()
        .filter_map(|p| {
            Some(FittedValue {
                key: p.key.clone(),
                std: p.std.filter(|std| *std > 0.0)?,
            })
        })
        .collect();
    std::fs::write(path, file.to_toml()).map_err(|error| {
        Failure::with_help(
            USAGE,
            format!("{}: cannot write: {error}", path.display()),
            "check the folder",
        )
    })
}

/// Status 5 when nothing, or not everything that was required, could be found.
fn verdict(arguments: &Arguments, found: &Identified) -> Result<(), Failure> {
    let missing = |key: &String| {
        !found
            .parameters
            .iter()
            .any(|parameter| parameter.key == *key && parameter.value.is_some())
    };
    if let Some(key) = arguments.require.iter().find(|key| missing(key)) {
        let known = found
            .parameters
            .iter()
            .find(|parameter| parameter.key == *key);
        let reason = known.and_then(|parameter| parameter.reason.clone());
        let reason = reason.unwrap_or_else(|| "it is not a parameter of this model".to_owned());
        return Err(Failure::new(
            NOT_IDENTIFIABLE,
            format!("{key} could not be identified: {reason}"),
        ));
    }
    if found
        .parameters
        .iter()
        .all(|parameter| parameter.value.is_none())
    {
        return Err(Failure::with_help(
            NOT_IDENTIFIABLE,
            "no parameter can be identified from these data",
            "excite the motor: steps of voltage in both directions, with some time at rest first",
        ));
    }
    Ok(())
}
