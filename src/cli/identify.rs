//! `identify`: parameters with confidence and verdict, from one run or several of the same machine.

mod answer;
mod write;

use std::fmt::Write as _;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use super::data::{self, MapArguments, model, read_text};
use super::failure::{Failure, NOT_IDENTIFIABLE, USAGE};
use super::sanity_report;
use super::{output, signals};
use crate::bench::MotorSection;
use crate::config_text;
use crate::identification::added_inertia::{self, Seen};
use crate::identification::nameplate::{self, Comparison};
use crate::identification::repeat::{self, Repeated};
use crate::identification::scheme::{self, Data, Identified};
use crate::identification::{claims, lost_rows, temperature, voltage_departure};
use crate::plant::{Model, Motor, MotorKey, Scenario};
use crate::recording::LoadedRun;
use crate::sample::{Channel, ParameterEstimate, Verdict};

/// Kt over Ke of real direct-current machines: iron loss takes some of the torque (ZK-22FC: 0.85), sensor gains add some
/// per cent either way.
const PLAUSIBLE_RATIO: RangeInclusive<f64> = 0.7..=1.1;

/// Gearboxes that exist, with room.
const GEAR_RATIOS: RangeInclusive<f64> = 1e-3..=1e5;

/// Find the motor's parameters in a recorded run, each with its uncertainty and verdict
#[derive(clap::Args)]
#[command(after_help = after_help())]
pub(super) struct Arguments {
    /// Run folder, samples.csv, or any CSV with --map; several runs of one machine also give the spread between them
    #[arg(required = true, value_name = "RUN")]
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

/// One run with what was found in it.
struct OneRun {
    loaded: LoadedRun,
    scenario: Scenario,
    found: Identified,
}

/// Everything that the command answers.
struct Answer {
    runs: Vec<OneRun>,
    combined: Vec<Repeated>,
    /// Torque constant, inertia and load torque on the absolute scale of a known inertia.
    absolute: Option<Vec<ParameterEstimate>>,
    gear_ratio: Option<f64>,
    nameplate: Option<Comparison>,
    /// What the found values, each sound by itself, say together that cannot be.
    caution: Option<String>,
}

impl Answer {
    /// What the model file, `--require` and the exit status go by.
    fn parameters(&self) -> Vec<ParameterEstimate> {
        let of_runs = self.combined.iter().map(|repeated| &repeated.estimate);
        let sound = |p: &&ParameterEstimate| p.value.is_some() && p.verdict != Verdict::Invalid;
        let absolute = self.absolute.iter().flatten().filter(sound);
        let replaced = |key: &str| absolute.clone().any(|p| p.key == key);
        of_runs
            .filter(|p| !replaced(&p.key))
            .chain(absolute.clone())
            .cloned()
            .collect()
    }
}

pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    let _endable = signals::endable()?;
    if let Some(ratio) = arguments
        .gear_ratio
        .filter(|ratio| !GEAR_RATIOS.contains(ratio))
    {
        return Err(Failure::with_help(
            USAGE,
            format!("--gear-ratio {ratio} is not allowed (expected 0.001 to 100000)"),
            "give motor turns per turn of the load, as --gear-ratio 10",
        ));
    }
    for (place, path) in arguments.runs.iter().enumerate() {
        if arguments.runs[..place].contains(path) {
            return Err(Failure::with_help(
                USAGE,
                format!("{}: given twice", path.display()),
                "several runs count as independent records: give each once",
            ));
        }
    }
    let mut file = None;
    let mut runs = Vec::new();
    for path in &arguments.runs {
        let loaded = open(path, arguments)?;
        let file = match &mut file {
            Some(file) => file,
            none => none.insert(model(arguments.model.as_ref(), &loaded)?.file),
        };
        if let Some(trace) = &arguments.load_torque {
            if arguments.runs.len() > 1 {
                return Err(Failure::with_help(
                    USAGE,
                    format!(
                        "--load-torque with {} runs is not allowed (expected one)",
                        arguments.runs.len()
                    ),
                    "a trace over time belongs to one run",
                ));
            }
            let scenario = Scenario::from_run(&loaded.run)?;
            let mut run = loaded.run;
            sanity_report::before_identify(&mut run, &scenario, &file.model, &[], arguments.json)?;
            return super::load_torque::execute(trace, &run, &file.model, arguments.json);
        }
        runs.push(identify(loaded, &file.model, arguments)?);
    }
    let commanded = |run: &&OneRun| run.scenario.input_channel == Channel::VoltageCmd;
    if let Some(run) = runs.iter().find(commanded).or(runs.first()) {
        data::name_voltage(&run.loaded.run, &run.scenario);
    }
    let file = file.ok_or_else(|| Failure::new(USAGE, "no run is given"))?;
    let per_run: Vec<Vec<ParameterEstimate>> = runs
        .iter()
        .map(|run| run.found.parameters.clone())
        .collect();
    let mut absolute = absolute(arguments, &file.model, &runs)?;
    let combined = repeat::combine(&per_run);
    let caution = caution(&combined, absolute.as_deref());
    if let Some(caution) = &caution {
        for parameter in absolute.iter_mut().flatten() {
            parameter.verdict = Verdict::Invalid;
            parameter.reason = Some(caution.clone());
        }
    }
    let mut answer = Answer {
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
    output::result(&answer.json(), arguments.json, |_| answer.text())?;
    if let Some(path) = &arguments.output {
        write::model(path, file, &answer)?;
    }
    verdict(&arguments.require, &answer.parameters())
}

fn plate(path: &Path) -> Result<Motor, Failure> {
    let file: MotorSection = config_text::parse(&path.display().to_string(), &read_text(path)?)?;
    Ok(file.motor())
}

fn open(path: &Path, arguments: &Arguments) -> Result<LoadedRun, Failure> {
    arguments.map.load(path)
}

fn identify(
    mut loaded: LoadedRun,
    model: &Model,
    arguments: &Arguments,
) -> Result<OneRun, Failure> {
    let scenario = Scenario::from_run(&loaded.run)?;
    let findings = sanity_report::before_identify(
        &mut loaded.run,
        &scenario,
        model,
        &arguments.require,
        arguments.json,
    )?;
    let scheme = match &arguments.scheme {
        Some(id) => scheme::find(id)?,
        None => scheme::default_for(&scenario),
    };
    let mut found = scheme.identify(&Data {
        run: &loaded.run,
        scenario: &scenario,
        model,
    })?;
    if scenario.input_channel == Channel::VoltageCmd
        && let Some(departure) = voltage_departure::find(&loaded.run)
    {
        departure.limit(&mut found.parameters);
        found.notes.push(departure.sentence());
    }
    claims::doubt(&mut found.parameters, &findings);
    found
        .notes
        .extend(claims::limit(&mut found.parameters, &loaded.run, &scenario));
    found
        .notes
        .extend(lost_rows::sentence(&loaded.run, &scenario));
    let found = temperature::complete(found, &loaded.run, &scenario);
    Ok(OneRun {
        loaded,
        scenario,
        found,
    })
}

/// The absolute scale from the run with the added inertia, where one is given.
fn absolute(
    arguments: &Arguments,
    model: &Model,
    runs: &[OneRun],
) -> Result<Option<Vec<ParameterEstimate>>, Failure> {
    let (Some(text), Some(without)) = (&arguments.added_inertia, runs.first()) else {
        return Ok(None);
    };
    let wrong = || {
        Failure::with_help(
            USAGE,
            format!("--added-inertia {text:?} is not allowed (expected RUN=KG_M2, above 0)"),
            "name the run with the disc and the disc's inertia, as --added-inertia runs/disc=0.002",
        )
    };
    let (path, added) = text.rsplit_once('=').ok_or_else(wrong)?;
    let added: f64 = added.parse().map_err(|_| wrong())?;
    if !(added.is_finite() && added > 0.0) {
        return Err(wrong());
    }
    let with = identify(open(Path::new(path), arguments)?, model, arguments)?;
    let seen = |run: &OneRun| run.found.model.motor.torque_constant();
    let (Some(kt_without), Some(kt_with)) = (seen(without), seen(&with)) else {
        return Err(Failure::with_help(
            NOT_IDENTIFIABLE,
            "neither run carries a torque constant to start from",
            "give torque_n_m_per_a or back_emf_v_s_per_rad in the model file: any value will do, the added inertia corrects it",
        ));
    };
    let without = Seen {
        parameters: &without.found.parameters,
        torque_n_m_per_a: kt_without,
    };
    let with = Seen {
        parameters: &with.found.parameters,
        torque_n_m_per_a: kt_with,
    };
    Ok(Some(added_inertia::absolute(&without, &with, added)))
}

/// Kt above Ke would be a machine that gives more power than it takes; far below, most of it would be lost in the iron.
fn caution(combined: &[Repeated], absolute: Option<&[ParameterEstimate]>) -> Option<String> {
    let of = |key: MotorKey| move |p: &&ParameterEstimate| p.key == key.key();
    let kt = absolute?.iter().find(of(MotorKey::TorqueConstant))?.value?;
    let mut found = combined.iter().map(|repeated| &repeated.estimate);
    let ke = found.find(of(MotorKey::BackEmf))?.value?;
    let ratio = kt / ke;
    (!PLAUSIBLE_RATIO.contains(&ratio)).then(|| {
        format!(
            "Kt is {ratio:.2} times Ke, {:.2} to {:.2} is plausible: check the added inertia, the shaft it is given on, \
             and that both runs are of the same machine",
            PLAUSIBLE_RATIO.start(),
            PLAUSIBLE_RATIO.end()
        )
    })
}

/// A value that may be used: found or given, and not forbidden by physics or by where its signals come from.
fn is_told(parameter: &ParameterEstimate) -> bool {
    parameter.value.is_some() && parameter.verdict != Verdict::Invalid
}

/// Status 5 when nothing, or not everything that was required, could be found.
fn verdict(require: &[String], parameters: &[ParameterEstimate]) -> Result<(), Failure> {
    let find = |key: &String| parameters.iter().find(|parameter| parameter.key == *key);
    let missing = |key: &&String| !find(key).is_some_and(is_told);
    if let Some(key) = require.iter().find(missing) {
        let reason = find(key).and_then(|parameter| parameter.reason.clone());
        let reason = reason.unwrap_or_else(|| "it is not a parameter of this model".to_owned());
        return Err(Failure::new(
            NOT_IDENTIFIABLE,
            format!("{key} could not be identified: {reason}"),
        ));
    }
    let found = |p: &ParameterEstimate| is_told(p) && p.verdict != Verdict::Fixed;
    if !parameters.iter().any(found) {
        if parameters.iter().any(|p| p.verdict == Verdict::Invalid) {
            return Err(Failure::new(
                NOT_IDENTIFIABLE,
                "no parameter can be identified soundly: the values found are invalid",
            ));
        }
        return Err(Failure::with_help(
            NOT_IDENTIFIABLE,
            "no parameter can be identified from these data",
            "excite the motor: steps of voltage in both directions, with some time at rest first",
        ));
    }
    Ok(())
}
