//! `identify`: parameters with confidence and verdict, from one run or several of the same machine; or the load torque
//! over time.

use std::fmt::Write as _;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use super::arguments::{MapArguments, run_path};
use super::failure::{Failure, NOT_IDENTIFIABLE, USAGE};
use super::output;
use super::{progress, signals};
use crate::app::cards;
use crate::app::evidence::{before_identify, model, name_voltage};
use crate::app::identify::{
    Answer, OneRun, absolute, caution, identify, is_usable, jointly, json_of, plate, schemes,
    trace_load,
};
use drivebench_bench::recording::LoadedRun;
use drivebench_identify::nameplate;
use drivebench_identify::repeat::{self, Repeated};
use drivebench_identify::scheme::{self, Identified};
use drivebench_model::config_text::help_for_unknown;
use drivebench_model::plant::{Model, Scenario};
use drivebench_model::sample::{Channel, ParameterEstimate, Verdict};

/// Gearboxes that exist, with room.
const GEAR_RATIOS: RangeInclusive<f64> = 1e-3..=1e5;

/// Find the motor's parameters in a recorded run, each with its uncertainty and verdict
#[derive(clap::Args)]
#[command(after_help = after_help())]
pub(super) struct Arguments {
    /// Run folder, samples.csv, or any CSV with --map; several runs of one machine are also fitted as one, and give the spread between them
    #[arg(required = true, value_name = "RUN", value_parser = run_path())]
    runs: Vec<PathBuf>,
    /// Model file: which parameters are sought, which are fixed; without it the five-parameter baseline
    #[arg(long)]
    model: Option<PathBuf>,
    /// Method, one of the schemes listed below
    #[arg(long, value_name = "S")]
    scheme: Option<String>,
    /// Exit with status 5 unless each of these keys was found
    #[arg(long, value_name = "KEY,...", value_delimiter = ',')]
    require: Vec<String>,
    /// A run of the same machine with a known inertia added to the motor shaft: fixes Kt, J and Mc absolutely
    #[arg(long, value_name = "RUN=KG_M2")]
    added_inertia: Option<String>,
    /// Motor turns per turn of the load: inertia and load torque are then also given on the load's shaft
    #[arg(long, value_name = "N")]
    gear_ratio: Option<f64>,
    /// Instead of parameters: the load torque over time, with the parameters of --model, into this file
    #[arg(long, value_name = "FILE.csv", requires = "model")]
    load_torque: Option<PathBuf>,
    /// Motor file (as in bench-configs/motors) to compare with: what differs, and what would explain it
    #[arg(long, value_name = "MOTOR.toml")]
    nameplate: Option<PathBuf>,
    /// Write the identified model here
    #[arg(long, value_name = "MODEL2.toml")]
    output: Option<PathBuf>,
    #[command(flatten)]
    map: MapArguments,
    /// Print all there is to say; without it what fits 100 columns and 30 lines
    #[arg(long)]
    full: bool,
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
  drivebench identify runs/a runs/b runs/c
  drivebench identify runs/a --nameplate bench-configs/motors/zk-22fc.toml
  drivebench identify runs/bare --added-inertia runs/disc=0.002
  drivebench identify axis.csv --model axis.toml --map time_s=t,torque_n_m=force,angle_rad=position",
    );
    text
}

pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    let _endable = signals::endable()?;
    let ratio = arguments.gear_ratio;
    if let Some(ratio) = ratio.filter(|ratio| !GEAR_RATIOS.contains(ratio)) {
        return Err(Failure::usage(
            format!("--gear-ratio {ratio} is not allowed (expected 0.001 to 100000)"),
            "give motor turns per turn of the load, as --gear-ratio 10",
        ));
    }
    for (place, path) in arguments.runs.iter().enumerate() {
        if arguments.runs[..place].contains(path) {
            return Err(Failure::usage(
                format!("{}: given twice", path.display()),
                "several runs count as independent records: give each once",
            ));
        }
    }
    let shown = progress::begin("identify");
    progress::stage("identifies the runs", arguments.runs.len());
    let mut file = None;
    let mut runs = Vec::new();
    for path in &arguments.runs {
        let loaded = arguments.map.load(path)?;
        let file = match &mut file {
            Some(file) => file,
            none => none.insert(model(arguments.model.as_deref(), &loaded)?.file),
        };
        if let Some(trace) = &arguments.load_torque {
            if arguments.runs.len() > 1 {
                let runs = arguments.runs.len();
                let headline =
                    format!("--load-torque with {runs} runs is not allowed (expected one)");
                let help = "a trace over time belongs to one run";
                return Err(Failure::usage(headline, help));
            }
            let scenario = Scenario::from_run(&loaded.run)?;
            let mut run = loaded.run;
            before_identify(&mut run, &scenario, &file.model, &[], arguments.json)?;
            drop(shown);
            return trace_load(trace, &run, &file.model, arguments.json);
        }
        runs.push(one(loaded, &file.model, arguments)?);
        progress::at(runs.len());
    }
    let commanded = |run: &&OneRun| run.scenario.input_channel == Channel::VoltageCmd;
    if let Some(run) = runs.iter().find(commanded).or(runs.first()) {
        name_voltage(&run.loaded.run, &run.scenario);
    }
    let file = file.ok_or_else(|| Failure::new(USAGE, "no run is given"))?;
    let mut absolute = with_added_inertia(arguments, &file.model, &runs)?;
    let joint = jointly(&runs, &file.model);
    let combined = combined(&runs, joint.as_ref());
    let caution = caution(&combined, absolute.as_deref());
    if let Some(caution) = &caution {
        for parameter in absolute.iter_mut().flatten() {
            parameter.verdict = Verdict::Invalid;
            parameter.reason = Some(caution.clone());
        }
    }
    let mut answer = Answer {
        joint,
        caution,
        combined,
        absolute,
        gear_ratio: arguments.gear_ratio,
        nameplate: None,
        runs,
    };
    if let Some(path) = &arguments.nameplate {
        answer.nameplate = Some(nameplate::compare(&plate(path)?, &answer.parameters()));
    }
    drop(shown);
    let run = output::quoted(&arguments.runs[0]);
    let mut document = cards::identify(&answer, &schemes(&answer));
    let model = arguments.output.as_deref().or(arguments.model.as_deref());
    let model = model.map_or_else(String::new, |path| {
        format!(" --model {}", output::quoted(path))
    });
    document.go_on(format!(
        "drivebench diagnose {run}{model}{}",
        arguments.map.words()
    ));
    output::document(&json_of(&answer), arguments.json, arguments.full, &document)?;
    if let Some(path) = &arguments.output {
        answer.write(path, file)?;
    }
    verdict(&arguments.require, &answer.parameters())
}

/// What the runs say together, one by one and in one fit.
fn combined(runs: &[OneRun], joint: Option<&Identified>) -> Vec<Repeated> {
    let per_run = runs.iter().map(|run| run.found.parameters.clone());
    let per_run: Vec<Vec<ParameterEstimate>> = per_run.collect();
    repeat::combine(&per_run, joint.map_or(&[], |joint| &joint.parameters))
}

fn one(loaded: LoadedRun, model: &Model, arguments: &Arguments) -> Result<OneRun, Failure> {
    let scheme = arguments.scheme.as_deref();
    identify(loaded, model, scheme, &arguments.require, arguments.json)
}

/// The absolute scale from the run with the added inertia, where one is given.
fn with_added_inertia(
    arguments: &Arguments,
    model: &Model,
    runs: &[OneRun],
) -> Result<Option<Vec<ParameterEstimate>>, Failure> {
    let (Some(text), Some(without)) = (&arguments.added_inertia, runs.first()) else {
        return Ok(None);
    };
    let wrong = || {
        Failure::usage(
            format!("--added-inertia {text:?} is not allowed (expected RUN=KG_M2, above 0)"),
            "name the run with the disc and the disc's inertia, as --added-inertia runs/disc=0.002",
        )
    };
    let (path, added) = text.rsplit_once('=').ok_or_else(wrong)?;
    let added = added
        .parse()
        .ok()
        .filter(|added: &f64| added.is_finite() && *added > 0.0);
    let added = added.ok_or_else(wrong)?;
    let with = one(arguments.map.load(Path::new(path))?, model, arguments)?;
    absolute(without, &with, added).map(Some)
}

/// Status 5 when nothing, or not everything that was required, could be found.
fn verdict(require: &[String], parameters: &[ParameterEstimate]) -> Result<(), Failure> {
    let find = |key: &String| parameters.iter().find(|parameter| parameter.key == *key);
    let missing = |key: &&String| !find(key).is_some_and(is_usable);
    if let Some(key) = require.iter().find(missing) {
        let reason = find(key).and_then(|parameter| parameter.reason.clone());
        let Some(reason) = reason else {
            let headline =
                format!("{key} could not be identified: it is not a parameter of this model");
            let help = help_for_unknown(key, parameters.iter().map(|own| own.key.as_str()));
            return Err(Failure::not_identifiable(headline, help));
        };
        let headline = format!("{key} could not be identified: {reason}");
        return Err(Failure::new(NOT_IDENTIFIABLE, headline));
    }
    let found = |p: &ParameterEstimate| is_usable(p) && p.verdict != Verdict::Fixed;
    if !parameters.iter().any(found) {
        if parameters.iter().any(|p| p.verdict == Verdict::Invalid) {
            let headline = "no parameter can be identified soundly: the values found are invalid";
            return Err(Failure::new(NOT_IDENTIFIABLE, headline));
        }
        return Err(Failure::not_identifiable(
            "no parameter can be identified from these data",
            "excite the motor: steps of voltage in both directions, with some time at rest first",
        ));
    }
    Ok(())
}
