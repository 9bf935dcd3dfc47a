//! `identify`: parameters with confidence and verdict.

use std::fmt::Write as _;
use std::path::PathBuf;

use serde_json::{Map, Value, json};

use super::data::{MapArguments, load, model};
use super::failure::{Failure, NOT_IDENTIFIABLE, USAGE};
use super::output;
use crate::identification::noise::NoiseFloor;
use crate::identification::online::{Online, OnlineConfig};
use crate::identification::output_error;
use crate::identification::{start, weak_form};
use crate::plant::{FittedValue, Input, Model, ModelFile, MotorKey, Scenario};
use crate::recording::LoadedRun;
use crate::sample::{Channel, ParameterEstimate};

/// Find the motor's parameters in a recorded run, each with its uncertainty and verdict
#[derive(clap::Args)]
#[command(after_help = "Examples:
  drivebench identify runs/a --model runs/a/model.toml --require inertia_kg_m2
  drivebench identify axis.csv --model axis.toml --map time_s=t,torque_n_m=force,angle_rad=position")]
pub(super) struct Arguments {
    /// Run folder, samples.csv, or any CSV with --map
    run: PathBuf,
    /// Model file: which parameters are sought, which are fixed; without it the five-parameter baseline
    #[arg(long)]
    model: Option<PathBuf>,
    /// Method: output-error (default with voltage), weak-form (default without), 2 or 3 (on line, as the bench runs them)
    #[arg(long, value_name = "S")]
    scheme: Option<String>,
    /// Exit with status 5 unless each of these keys was found
    #[arg(long, value_name = "KEY,...", value_delimiter = ',')]
    require: Vec<String>,
    /// Write the identified model here
    #[arg(long, value_name = "MODEL2.toml")]
    output: Option<PathBuf>,
    #[command(flatten)]
    map: MapArguments,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// What a scheme found.
struct Found {
    scheme: &'static str,
    parameters: Vec<ParameterEstimate>,
    note: Option<String>,
}

pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    let run = load(&arguments.run, arguments.map.of_run()?.as_ref())?;
    let mut file = model(arguments.model.as_ref(), &run)?.file;
    let scenario = Scenario::from_run(&run.run)?;
    if scenario.input_channel == Channel::VoltageCmd {
        output::message("voltage_cmd_v serves as the voltage");
    }
    let found = identify(
        arguments.scheme.as_deref(),
        &mut file.model,
        &run,
        &scenario,
    )?;
    print(arguments, &found, &run, &scenario)?;
    if let Some(path) = &arguments.output {
        write_model(path, file, &found, &run)?;
    }
    verdict(arguments, &found)
}

fn identify(
    scheme: Option<&str>,
    model: &mut Model,
    run: &LoadedRun,
    scenario: &Scenario,
) -> Result<Found, Failure> {
    let default = if scenario.input == Input::Voltage {
        "output-error"
    } else {
        "weak-form"
    };
    match scheme.unwrap_or(default) {
        "output-error" if scenario.input == Input::Voltage => {
            *model = start::complete(model, scenario)?;
            let noise = NoiseFloor::from_standstill(scenario)
                .unwrap_or_else(|| NoiseFloor::from_spread(scenario));
            let fit = output_error::fit(std::slice::from_ref(model), scenario, &noise)?;
            *model = fit.model;
            Ok(Found {
                scheme: "output-error",
                parameters: fit.parameters,
                note: None,
            })
        }
        "output-error" => Err(Failure::with_help(
            USAGE,
            "scheme output-error needs a voltage, and this run has none",
            "use --scheme weak-form",
        )),
        "weak-form" => {
            let parameters: Vec<ParameterEstimate> = weak_form::fit(model, scenario)?
                .into_iter()
                .flat_map(|balance| balance.parameters)
                .collect();
            adopt(model, &parameters);
            let note = "weak form: windows without standstill; friction values depend on the method by some per cent";
            Ok(Found {
                scheme: "weak-form",
                parameters,
                note: Some(note.to_owned()),
            })
        }
        scheme @ ("2" | "3") => {
            let config = OnlineConfig::from_model(model);
            let mut online = Online::new(config);
            for sample in run.run.samples() {
                online.push(&sample);
            }
            let (scheme, parameters) = if scheme == "2" {
                ("2", online.scheme_2())
            } else {
                ("3", online.estimates())
            };
            adopt(model, &parameters);
            Ok(Found {
                scheme,
                parameters,
                note: None,
            })
        }
        other => Err(Failure::with_help(
            USAGE,
            format!("scheme {other:?} is not known"),
            "allowed: 2, 3, weak-form, output-error",
        )),
    }
}

/// Takes found values over into the model.
fn adopt(model: &mut Model, parameters: &[ParameterEstimate]) {
    for slot in model.slots() {
        let found = parameters
            .iter()
            .find(|parameter| parameter.key == slot.key());
        if let Some(value) = found.and_then(|parameter| parameter.value) {
            model.set(&slot, value);
        }
    }
}

fn print(
    arguments: &Arguments,
    found: &Found,
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
        "notes": run.run.notes.iter().cloned().chain(found.note.clone()).collect::<Vec<_>>(),
    });
    output::result(&value, arguments.json, |_| text(found))
}

fn text(found: &Found) -> String {
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
    if let Some(note) = &found.note {
        let _ = writeln!(text, "{note}");
    }
    text
}

fn write_model(
    path: &PathBuf,
    mut file: ModelFile,
    found: &Found,
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
    adopt(&mut file.model, &found.parameters);
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
fn verdict(arguments: &Arguments, found: &Found) -> Result<(), Failure> {
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
