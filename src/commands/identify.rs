//! `identify`: parameters with uncertainty and verdict, from one run or several of the same machine, each by its scheme and
//! then combined; or the load torque over time.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use serde::Serialize;
use serde_json::{Map, Value, json};

use crate::commands::arguments::{MapArguments, model_words, run_path};
use crate::commands::cards;
use crate::commands::evidence::{before_identify, model, name_voltage, signals};
use crate::report::conventions;
use crate::report::wording::change::along;
use crate::report::wording::{json, record, sanity as words};
use crate::runtime::{Failure, Form, NOT_IDENTIFIABLE, Terminal, USAGE, output, read_text};
use drivebench_bench::MotorSection;
use drivebench_bench::recording::LoadedRun;
use drivebench_diagnose::known_along;
use drivebench_identify::added_inertia::ScaledRun;
use drivebench_identify::kalman::{LoadTrace, load_torque_trace};
use drivebench_identify::misfit::Misfit;
use drivebench_identify::nameplate::Comparison;
use drivebench_identify::repeat::Repeated;
use drivebench_identify::sanity::Finding;
use drivebench_identify::scheme::{Data, Identified, Scheme};
use drivebench_identify::{
    added_inertia, claims, lost_rows, nameplate, physical, repeat, sanity, scheme, temperature,
    voltage_departure,
};
use drivebench_model::config_text::{self, help_for_unknown};
use drivebench_model::plant::effect::TermKind;
use drivebench_model::plant::{
    ActiveEffect, FittedValue, Model, ModelFile, Motor, MotorKey, Scenario,
};
use drivebench_model::sample::{Channel, ParameterEstimate, Reason, Run, Verdict};

/// Find the motor's parameters in a recorded run, each with its uncertainty and verdict
#[derive(clap::Args)]
#[command(after_help = after_help())]
pub(super) struct Arguments {
    /// Run folder, samples.csv, or any CSV with --map; several runs of one machine are also fitted together, and give the spread between them
    #[arg(required = true, value_name = "RUN", value_parser = run_path())]
    runs: Vec<PathBuf>,
    /// Model file: which parameters are identified, which are fixed; without it the five-parameter baseline
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
    /// A weight of so many kg on an arm of so many m: with voltage and angle, and no current, R, Ke, J and Mc
    #[arg(long, value_name = "KG,M")]
    known_arm: Option<String>,
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
    #[command(flatten)]
    form: Form,
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
  drivebench identify servo.csv --known-arm 0.49,0.1
  drivebench identify axis.csv --model axis.toml --map time_s=t,torque_n_m=force,angle_rad=position",
    );
    text
}

pub(super) fn execute(arguments: &Arguments, terminal: &Terminal) -> Result<(), Failure> {
    let _endable = terminal.endable()?;
    let ratio = arguments.gear_ratio;
    if let Some(ratio) = ratio.filter(|ratio| !(1e-3..=1e5).contains(ratio)) {
        return Err(Failure::usage(
            format!("--gear-ratio {ratio} is not allowed (expected 0.001 to 100000)"),
            "give motor turns per turn of the load, as --gear-ratio 10",
        ));
    }
    for (index, path) in arguments.runs.iter().enumerate() {
        if arguments.runs[..index].contains(path) {
            return Err(Failure::usage(
                format!("{}: given twice", path.display()),
                "each run counts as an independent record: give it once",
            ));
        }
    }
    let shown = terminal.progress("identify");
    terminal.stage("identifies the runs", arguments.runs.len());
    let mut file = None;
    let mut runs = Vec::new();
    for path in &arguments.runs {
        let loaded = arguments.map.load(path, terminal)?;
        let file = match &mut file {
            Some(file) => file,
            none => {
                let found = model(arguments.model.as_deref(), &loaded, terminal)?.file;
                none.insert(with_weight(found, arguments.known_arm.as_deref())?)
            }
        };
        if let Some(trace) = &arguments.load_torque {
            if arguments.runs.len() > 1 {
                let runs = arguments.runs.len();
                let headline =
                    format!("--load-torque with {runs} runs is not allowed (expected one)");
                return Err(Failure::usage(headline, "a trace over time belongs to one run"));
            }
            let scenario = Scenario::from_run(&loaded.run)?;
            let mut run = loaded.run;
            before_identify(&mut run, &scenario, &file.model, &[], arguments.form.json, terminal)?;
            drop(shown);
            return trace_load(trace, &run, &file.model, arguments.form.json, terminal);
        }
        runs.push(one(loaded, &file.model, arguments, terminal)?);
        terminal.at(runs.len());
    }
    let commanded = |run: &&OneRun| run.scenario.input_channel == Channel::VoltageCmd;
    if let Some(run) = runs.iter().find(commanded).or(runs.first()) {
        name_voltage(&run.loaded.run, &run.scenario, terminal);
    }
    let file = file.ok_or_else(|| Failure::new(USAGE, "no run is given"))?;
    let mut absolute = with_added_inertia(arguments, &file.model, &runs, terminal)?;
    let joint = jointly(&runs, &file.model);
    let combined = combined(&runs, joint.as_ref());
    let caution = caution(&combined, absolute.as_deref());
    if let Some(caution) = &caution {
        for parameter in absolute.iter_mut().flatten() {
            parameter.set(Verdict::Invalid, Reason::Impossible, caution.as_str());
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
        answer.nameplate = Some(nameplate::compare(&nameplate_motor(path)?, &answer.parameters()));
    }
    drop(shown);
    let run = output::quoted(&arguments.runs[0]);
    let mut document = cards::identify(&answer, &schemes(&answer));
    let model = arguments.output.as_deref().or(arguments.model.as_deref());
    let (model, map) = (model_words(model), arguments.map.words());
    document.go_on(format!("drivebench diagnose {run}{model}{map}"));
    terminal.document(&json_of(&answer), arguments.form, &document)?;
    if let Some(path) = &arguments.output {
        answer.write(path, file, terminal)?;
    }
    verdict(&arguments.require, &answer.parameters())
}

/// The estimates of the single runs and of the joint fit as one each.
fn combined(runs: &[OneRun], joint: Option<&Identified>) -> Vec<Repeated> {
    let per_run: Vec<_> = runs.iter().map(|run| run.found.parameters.clone()).collect();
    repeat::combine(&per_run, joint.map_or(&[], |joint| &joint.parameters))
}

fn one(
    loaded: LoadedRun,
    model: &Model,
    arguments: &Arguments,
    terminal: &Terminal,
) -> Result<OneRun, Failure> {
    let of_arm = arguments.known_arm.as_ref().map(|_| scheme::KNOWN_ARM);
    let scheme = arguments.scheme.as_deref().or(of_arm);
    identify(loaded, model, scheme, &arguments.require, arguments.form.json, terminal)
}

/// The file with the weight of `--known-arm` in its model.
fn with_weight(mut file: ModelFile, arm: Option<&str>) -> Result<ModelFile, Failure> {
    let Some(text) = arm else {
        return Ok(file);
    };
    let number = |own: &str| own.trim().parse().ok().filter(|v: &f64| v.is_finite() && *v > 0.0);
    let numbers: Option<Vec<f64>> = text.split(',').map(number).collect();
    let Some([kg, m]) = numbers.as_deref() else {
        return Err(Failure::usage(
            format!("--known-arm {text:?} is not allowed (expected KG,M, both above 0)"),
            "give the mass and its distance from the shaft, as --known-arm 0.49,0.1",
        ));
    };
    // Standard gravity in m/s2 (ISO 80000-3); on the earth it differs by up to .3 %.
    let (weight, size) = (TermKind::Weight, [9.80665 * kg * m, 0.0]);
    file.model.effects.retain(|active| active.id() != weight.id());
    file.model.effects.push(ActiveEffect::with(weight.effect(), &size));
    Ok(file)
}

/// The absolute scale from the run with the added inertia, where one is given.
fn with_added_inertia(
    arguments: &Arguments,
    model: &Model,
    runs: &[OneRun],
    terminal: &Terminal,
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
    let added = added.parse().ok().filter(|added: &f64| added.is_finite() && *added > 0.0);
    let added = added.ok_or_else(wrong)?;
    let with = one(arguments.map.load(Path::new(path), terminal)?, model, arguments, terminal)?;
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
    if !parameters.iter().any(is_found) {
        if parameters.iter().any(|p| p.verdict == Verdict::Invalid) {
            let headline = "no parameter can be identified: the values found are invalid";
            return Err(Failure::new(NOT_IDENTIFIABLE, headline));
        }
        return Err(Failure::not_identifiable(
            "no parameter can be identified from these data",
            "excite the motor: steps of voltage in both directions, with some time at rest first",
        ));
    }
    Ok(())
}

pub(crate) struct OneRun {
    pub(crate) loaded: LoadedRun,
    pub(crate) scenario: Scenario,
    pub(crate) found: Identified,
    findings: Vec<Finding>,
}

pub(crate) struct Answer {
    pub(crate) runs: Vec<OneRun>,
    /// One fit to all of several runs.
    pub(crate) joint: Option<Identified>,
    pub(crate) combined: Vec<Repeated>,
    /// Torque constant, inertia and load torque on the absolute scale of a known inertia.
    pub(crate) absolute: Option<Vec<ParameterEstimate>>,
    pub(crate) gear_ratio: Option<f64>,
    pub(crate) nameplate: Option<Comparison>,
    /// Why the found values, each plausible by itself, are not plausible together.
    pub(crate) caution: Option<String>,
}

impl Answer {
    /// Misfit of the joint fit, else that of the first run.
    pub(crate) fn misfit(&self) -> Option<&Misfit> {
        self.joint.as_ref().or(self.runs.first().map(|run| &run.found))?.misfit.as_ref()
    }

    /// For the model file, `--require` and the exit status: usable absolute values replace relative ones.
    pub(crate) fn parameters(&self) -> Vec<ParameterEstimate> {
        let of_runs = self.combined.iter().map(|repeated| &repeated.estimate);
        let absolute = self.absolute.iter().flatten().filter(|p| is_usable(p));
        let is_replaced = |key: &str| absolute.clone().any(|p| p.key == key);
        of_runs.filter(|p| !is_replaced(&p.key)).chain(absolute.clone()).cloned().collect()
    }

    /// Writes the model: `file` with the usable values. Other parameters stay as given, or are left out.
    fn write(&self, path: &Path, mut file: ModelFile, terminal: &Terminal) -> Result<(), Failure> {
        output::refuse_existing([path], "--output")?;
        let mut parameters = self.parameters();
        parameters.retain(is_usable);
        file.model = Identified::new("", &file.model, parameters.clone()).model;
        file.history.fitted_on = self.runs.iter().map(|run| run.loaded.run.name.clone()).collect();
        file.history.fitted = FittedValue::all(&parameters);
        terminal.file(path, &file.to_toml())
    }
}

/// Found or given, and not excluded by physics or by the origin of its signals.
pub(crate) fn is_usable(parameter: &ParameterEstimate) -> bool {
    parameter.value.is_some() && parameter.verdict != Verdict::Invalid
}

/// Usable, and not only given.
pub(crate) fn is_found(parameter: &ParameterEstimate) -> bool {
    is_usable(parameter) && parameter.verdict != Verdict::Fixed
}

fn nameplate_motor(path: &Path) -> Result<Motor, Failure> {
    let file: MotorSection = config_text::parse(&path.display().to_string(), &read_text(path)?)?;
    Ok(file.motor())
}

/// Identifies one run by the scheme of this name, else by that which its signals suggest.
pub(crate) fn identify(
    mut loaded: LoadedRun,
    model: &Model,
    scheme: Option<&str>,
    require: &[String],
    json: bool,
    terminal: &Terminal,
) -> Result<OneRun, Failure> {
    let scenario = Scenario::from_run(&loaded.run)?;
    let findings = before_identify(&mut loaded.run, &scenario, model, require, json, terminal)?;
    let scheme = match scheme {
        Some(id) => scheme::find(id)?,
        None => scheme::default_for(&scenario),
    };
    let data = Data { run: &loaded.run, scenario: &scenario, model };
    let found = judged(scheme, &data, &findings)?;
    Ok(OneRun { loaded, scenario, found, findings })
}

/// One fit to several runs of a machine in sequence, where each was fitted by its free run and no effect of the model is an
/// event of a single run.
fn jointly(runs: &[OneRun], model: &Model) -> Option<Identified> {
    let (first, others) = runs.split_first().filter(|(_, others)| !others.is_empty())?;
    let scheme = first.found.scheme;
    let is_fitted = |run: &OneRun| {
        run.found.scheme == scheme && [scheme::FREE_RUN, scheme::KNOWN_ARM].contains(&scheme)
    };
    let is_event = |own: &ActiveEffect| own.effect.goes_on_over_runs();
    if !runs.iter().all(is_fitted) || model.effects.iter().any(is_event) {
        return None;
    }
    let follow = |all: Scenario, next: &OneRun| all.followed_by(&next.scenario);
    let scenario = &others.iter().fold(first.scenario.clone(), follow);
    let data = Data { run: &first.loaded.run, scenario, model };
    let findings: Vec<Finding> = runs.iter().flat_map(|run| run.findings.clone()).collect();
    judged(scheme::find(scheme).ok()?, &data, &findings).ok()
}

/// The estimates of a scheme, limited to those that physics and the origin of the signals allow.
fn judged(scheme: &Scheme, data: &Data<'_>, findings: &[Finding]) -> Result<Identified, Failure> {
    let (run, scenario) = (data.run, data.scenario);
    let mut found = scheme.identify(data)?;
    if scheme.id() == scheme::FREE_RUN {
        let (known, finding) = known_along(scenario, found);
        found = known;
        found.notes.extend(finding.as_ref().map(along));
    }
    physical::refuse(&mut found.parameters, &found.model.motor, scenario);
    if scenario.input_channel == Channel::VoltageCmd
        && let Some(departure) = voltage_departure::find(run)
    {
        let reason = record::departure(&departure);
        voltage_departure::limit(&mut found.parameters, &reason);
        found.notes.push(reason);
    }
    sanity::doubt(&mut found.parameters, findings, words::fault);
    for open in found.parameters.iter_mut().filter(|own| own.value.is_none()) {
        // A fault of a signal may be the only reason.
        let about = |it: &&Finding| it.doubts.iter().any(|key| key.key() == open.key);
        if let (Some(reason), Some(finding)) = (&mut open.reason, findings.iter().find(about)) {
            *reason = format!("{}; {reason}", words::fault(&finding.fault));
            open.code = Some(Reason::FaultyData);
        }
    }
    found.notes.extend(claims::limit(&mut found.parameters, run, scenario));
    found.notes.extend(lost_rows::find(run, scenario).as_ref().map(record::lost_rows));
    found.notes.extend(record::unconfirmed(scenario));
    Ok(temperature::complete(found, run, scenario))
}

/// The absolute scale from a run of the same machine with `added_kg_m2` on its shaft.
fn absolute(
    without: &OneRun,
    with: &OneRun,
    added_kg_m2: f64,
) -> Result<Vec<ParameterEstimate>, Failure> {
    let kt = |run: &OneRun| run.found.model.motor.torque_constant();
    let (Some(kt_without), Some(kt_with)) = (kt(without), kt(with)) else {
        return Err(Failure::not_identifiable(
            "neither run gives a torque constant to start from",
            "give torque_n_m_per_a or back_emf_v_s_per_rad in the model file: any value will do, the added inertia corrects it",
        ));
    };
    let without = ScaledRun { parameters: &without.found.parameters, torque_n_m_per_a: kt_without };
    let with = ScaledRun { parameters: &with.found.parameters, torque_n_m_per_a: kt_with };
    Ok(added_inertia::absolute(&without, &with, added_kg_m2))
}

/// Kt above Ke would give more power than the machine takes; far below, most of it would be lost in the iron. Real machines
/// have 0.7 to 1.1 (ZK-22FC: 0.85), gains of the sensors included.
fn caution(combined: &[Repeated], absolute: Option<&[ParameterEstimate]>) -> Option<String> {
    let of = |key: MotorKey| move |p: &&ParameterEstimate| p.key == key.key();
    let kt = absolute?.iter().find(of(MotorKey::TorqueConstant))?.value?;
    let mut found = combined.iter().map(|repeated| &repeated.estimate);
    let ke = found.find(of(MotorKey::BackEmf))?.value?;
    let ratio = kt / ke;
    (!(0.7..=1.1).contains(&ratio)).then(|| {
        format!(
            "Kt is {ratio:.2} times Ke, 0.70 to 1.10 is plausible: check the added inertia, the shaft that it refers to, \
             and that both runs are of the same machine"
        )
    })
}

fn json_of(answer: &Answer) -> Value {
    let first = answer.runs.first();
    let of_runs = |of: fn(&OneRun) -> usize| answer.runs.iter().map(of).sum::<usize>();
    let mut notes: Vec<&String> = Vec::new();
    for run in &answer.runs {
        for note in run.loaded.run.notes.iter().chain(&run.found.notes) {
            if !notes.contains(&note) {
                notes.push(note);
            }
        }
    }
    notes.extend(&answer.caution);
    let combined = answer.combined.iter().map(|r| (r.estimate.key.as_str(), r));
    let parameters = if answer.runs.len() > 1 {
        keyed(combined)
    } else {
        keyed(combined.map(|(key, r)| (key, &r.estimate)))
    };
    let converted = conventions::of(&answer.parameters());
    let mut value = json!({
        "scheme": schemes(answer),
        "parameters": parameters,
        "rows": of_runs(|run| run.loaded.run.rows()),
        "rows_used": of_runs(|run| run.scenario.samples()),
        "rows_dropped": of_runs(|run| run.loaded.run.rows_dropped),
        "period_s": first.and_then(|run| period_s(&run.loaded.run)),
        "input": first.map(|run| run.scenario.input_channel.key()),
        "signals": first.map(|run| signals(&run.loaded.run)),
        "shaft": "motor",
        "conventions": keyed(converted.iter().map(|c| (c.key, c))),
        "misfit": answer.misfit(),
        "joint": answer.joint.is_some(),
        "notes": notes,
    });
    if answer.runs.len() > 1 {
        let each = answer.runs.iter().map(|run| {
            json!({
                "run": run.loaded.run.name,
                "scheme": run.found.scheme,
                "rows": run.loaded.run.rows(),
                "parameters": estimates(&run.found.parameters),
                "misfit": run.found.misfit,
            })
        });
        value["runs"] = each.collect();
    }
    if let Some(absolute) = &answer.absolute {
        value["absolute"] = estimates(absolute).into();
    }
    if let Some(comparison) = &answer.nameplate {
        value["nameplate"] = json::nameplate(comparison);
    }
    if let Some(ratio) = answer.gear_ratio {
        let load = conventions::on_load_shaft(&answer.parameters(), ratio);
        value["load_shaft"] = json!({ "gear_ratio": ratio, "parameters": estimates(&load) });
    }
    value
}

/// The schemes of the runs, each once.
fn schemes(answer: &Answer) -> String {
    let mut schemes: Vec<&str> = answer.runs.iter().map(|run| run.found.scheme).collect();
    schemes.dedup();
    schemes.join(" and ")
}

/// Median sampling period of the measurements, s.
pub(crate) fn period_s(run: &Run) -> Option<f64> {
    [Channel::Current, Channel::Speed].into_iter().find_map(|channel| run.period_s(channel))
}

pub(crate) fn estimates(parameters: &[ParameterEstimate]) -> Map<String, Value> {
    keyed(parameters.iter().map(|p| (p.key.as_str(), p)))
}

fn keyed<'a, T: Serialize + 'a>(
    entries: impl Iterator<Item = (&'a str, &'a T)>,
) -> Map<String, Value> {
    entries
        .map(|(key, value)| (key.to_owned(), serde_json::to_value(value).unwrap_or_default()))
        .collect()
}

/// Tracks the load torque, writes it to `path` and prints a summary.
fn trace_load(
    path: &Path,
    run: &Run,
    model: &Model,
    json: bool,
    terminal: &Terminal,
) -> Result<(), Failure> {
    output::refuse_existing([path], "--load-torque")?;
    let trace = load_torque_trace(run, model)?;
    terminal.file(path, &trace_csv(&trace))?;
    let extreme = |is_better: fn(f64, f64) -> bool| {
        let found = trace
            .points
            .iter()
            .reduce(|a, b| if is_better(b.load_torque_n_m, a.load_torque_n_m) { b } else { a });
        found.map(|p| {
            json!({ "time_s": p.time_s, "load_torque_n_m": p.load_torque_n_m, "load_torque_std_n_m": p.std_n_m })
        })
    };
    let summary = json!({
        "output": path,
        "rows": trace.points.len(),
        "rows_followed": trace.rows_followed,
        "input": format!("{:?}", trace.input).to_lowercase(),
        "rate_n_m_per_sqrt_s": trace.rate_n_m_per_sqrt_s,
        "rate_from_data": true,
        "median_std_n_m": trace.median_std_n_m(),
        "least": extreme(|a, b| a < b),
        "most": extreme(|a, b| a > b),
        "innovation_over_noise": { "current": trace.consistency[0], "speed": trace.consistency[1] },
        "notes": trace.notes,
    });
    terminal.result(&summary, json, |_| trace_text(&trace, path))
}

fn trace_text(trace: &LoadTrace, path: &Path) -> String {
    let mut text = format!(
        "load torque at {} instants written to {}\nmedian standard deviation {:.2e} N.m; expected change {:.2e} N.m/sqrt(s), found from the run; motor turning at {} rows\n",
        trace.points.len(),
        path.display(),
        trace.median_std_n_m(),
        trace.rate_n_m_per_sqrt_s,
        trace.rows_followed
    );
    output::lines(&mut text, "", &trace.notes);
    text
}

/// The load torque over time as a file.
fn trace_csv(trace: &LoadTrace) -> String {
    let mut csv = "time_s,load_torque_n_m,load_torque_std_n_m\n".to_owned();
    for point in &trace.points {
        let _ = writeln!(csv, "{},{},{}", point.time_s, point.load_torque_n_m, point.std_n_m);
    }
    csv
}
