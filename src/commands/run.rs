//! `run`: excite the motor, record the run and identify on line. The order of work: check, find the motor where it is unknown,
//! plan, record, keep what was found.

use std::path::Path;

use serde::Serialize;
use serde_json::{Map, Value};

use crate::commands::arguments::{LiveArguments, UnknownMotor};
use crate::commands::{by_hand, cards, identify, pages};
use crate::report::wording::{json, nameplate as words};
use crate::report::{Document, tables};
use crate::runtime::{
    Audience, Controls, Failure, Form, LINK, NOT_IDENTIFIABLE, OpenRig, Recorded, Rig, RigOptions,
    Terminal, conduct,
};
use crate::workflow::{Escalate, EscalationResult, compared, scaled_sentence};
use drivebench_bench::recording::RunFile;
use drivebench_bench::{BenchFile, CheckReport, CurrentsSection, Plan, RunSummary};
use drivebench_diagnose::{Evidence, Score};
use drivebench_identify::escalation::Ending;
use drivebench_identify::nameplate::{Comparison, NameplateDoubt};
use drivebench_identify::noise::FloorSource;
use drivebench_identify::scheme::{self, Data};
use drivebench_identify::start;
use drivebench_model::plant::{FittedValue, Model, ModelFile, Motor, MotorKey, Scenario};
use drivebench_model::sample::{ParameterEstimate, Verdict};
use drivebench_model::text::number::significant;

/// Excite the motor, record the run and identify on line; live screen unless --headless
#[derive(clap::Args)]
#[command(after_help = "Examples:
  drivebench run                            the emulated motor, on the live screen
  drivebench run bench.toml --port /dev/ttyUSB0 --hardware --check      all that can be checked before the shaft turns
  drivebench run bench.toml --port /dev/ttyUSB0 --hardware --headless
  drivebench run --escalate --port sim: --emulator small-servo-behind-zk-22fc   find the motor first")]
pub(super) struct Arguments {
    #[command(flatten)]
    live: LiveArguments,
    #[command(flatten)]
    unknown: UnknownMotor,
    /// Seed of the random parts of the sequence and of the emulator's noise, as runs.fit, select or confirm in the bench file;
    /// not the number of a run. Without it runs.fit
    #[arg(long, value_name = "N")]
    run_seed: Option<u64>,
    /// Only the checks before the first move: identity, limits, rate, noise at rest, the drive's watchdog; and whether the
    /// sequence would be refused. No screen, nothing moves, no run is made. The watchdog is proven with the output on at zero
    #[arg(long)]
    check: bool,
}

pub(super) fn execute(arguments: &Arguments, terminal: &Terminal) -> Result<(), Failure> {
    let live = &arguments.live;
    let run_seed = arguments.run_seed;
    let mut options = live.options(arguments.unknown.escalate, terminal)?;
    if arguments.check {
        // Without a screen, whatever stdout is: there is nothing to watch.
        options.switches.headless = true;
        let done = conduct(terminal, Audience::Headless, move |controls| {
            connect(options, run_seed, controls)
        })?;
        return terminal.result(&done.work, live.json, Connection::text);
    }
    let done = conduct(terminal, live.audience(None), move |controls| {
        run(options, run_seed, Box::new(Rig::open), controls)
    })?;
    match &done.work {
        RunDone::NotFound(escalation) => {
            let mut document = Document::new("", "");
            escalation.put("motor", &mut document);
            tables::nameplate_section(&mut document, escalation.nameplate.as_ref());
            terminal.document(escalation.as_ref(), Form::full(live.json), &document)?;
            done.screen.conclude(escalation_failure(escalation))
        }
        RunDone::Run(whole) => {
            let document = cards::run(whole);
            by_hand::finish(done.screen, &whole.recorded, whole, document, live.form(), terminal)
        }
    }
}

pub(super) const BETWEEN_RUNS: &str =
    "interrupted; nothing is energised, what was recorded is kept";

pub(crate) enum RunDone {
    NotFound(Box<EscalationResult>),
    Run(Box<CompletedRun>),
}

#[derive(Serialize)]
pub(crate) struct CompletedRun {
    plan: Plan,
    #[serde(flatten)]
    pub recorded: Recorded,
    /// The estimates are of the balances over the whole record, and not on line.
    #[serde(skip)]
    pub(super) is_by_balances: bool,
    /// How an unknown motor was found.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) escalation: Option<EscalationResult>,
    /// The motor of the bench file.
    #[serde(skip)]
    pub(super) nameplate_motor: Motor,
    /// The found values compared with it, where it has any.
    #[serde(skip_serializing_if = "Option::is_none", serialize_with = "json::plate")]
    pub(super) nameplate: Option<Comparison>,
    /// The estimates with their keys.
    parameters: Map<String, Value>,
}

/// Makes one run over the rig that `open` gives; fails where none begins, for the end of a run that began is in its record.
/// `run_seed`: that of the sequence's random parts; without it `runs.fit` of the bench file.
pub(crate) fn run(
    options: RigOptions,
    run_seed: Option<u64>,
    open: OpenRig,
    controls: &Controls,
) -> Result<RunDone, Failure> {
    let purpose = options.bench.purpose();
    let mut rig = open(options, run_seed, purpose)?;
    let printed = rig.options.switches.headless.then(|| rig.options.terminal.clone());
    let report = rig.check(controls, false)?;
    if let Some(terminal) = &printed {
        print_checks(&report, terminal);
    }
    let print = |line: &str| printed.iter().for_each(|terminal| terminal.message(line));
    let mut escalation = None;
    if rig.escalates && rig.bench.currents.is_some() {
        find_by_currents(&mut rig, controls, print)?;
    } else if rig.escalates {
        let result = escalate(&mut rig, controls, print)?;
        if result.ending.is_some() {
            return Ok(RunDone::NotFound(Box::new(result)));
        }
        escalation = Some(result);
    }
    let seed = run_seed.unwrap_or(rig.bench.runs.fit);
    let plan = rig.plan(seed)?;
    let name = rig.bench.name.clone();
    let mut recorded = rig.record(&name, seed, controls)?;
    let nameplate = rig.nameplate()?.motor();
    let is_by_balances = of_balances(&rig.bench, &mut recorded)?;
    let mut run = CompletedRun {
        parameters: identify::estimates(&recorded.summary.estimates),
        plan,
        recorded,
        is_by_balances,
        escalation,
        nameplate_motor: rig.nameplate_motor.clone(),
        nameplate: None,
    };
    run.nameplate = match &run.escalation {
        // The fit of the escalation is more accurate than the on-line estimates.
        Some(escalation) => escalation.nameplate.clone(),
        None => compared(&run.nameplate_motor, &run.recorded.summary.estimates),
    };
    judge_nameplate(&mut run, &nameplate);
    write_results(&mut run, &nameplate, &rig.options.terminal);
    Ok(RunDone::Run(Box::new(run)))
}

/// A drive that has answered every check before the first move.
#[derive(Serialize)]
struct Connection {
    link: String,
    /// Where its profile comes from, and how far it is proven.
    profile: String,
    #[serde(flatten)]
    checks: CheckReport,
    /// Of the bench file, Hz.
    rate_hz: f64,
    /// What the sequence would do to the motor of the bench file; `null` where that is not known.
    plan: Option<Plan>,
}

/// Carries out every check before the first move, predicts the sequence, and leaves the drive stopped: nothing has moved.
fn connect(
    options: RigOptions,
    run_seed: Option<u64>,
    controls: &Controls,
) -> Result<Connection, Failure> {
    let purpose = options.bench.purpose();
    let mut rig = Rig::open(options, run_seed, purpose)?;
    let checks = rig.check(controls, true)?;
    let seed = run_seed.unwrap_or(rig.bench.runs.fit);
    let plan = rig.bench.nameplate().is_some().then(|| rig.plan(seed)).transpose()?;
    Ok(Connection {
        link: rig.connection.link.name().to_string(),
        profile: rig.profile.provenance(),
        rate_hz: rig.bench.link.rate_hz,
        checks,
        plan,
    })
}

impl Connection {
    /// For a person: each check, and what a run would do.
    pub(crate) fn text(&self) -> String {
        let line = |name: &str, text: &str| format!("{name:<18} {text}");
        let mut lines = vec![line("link", &self.link), line("profile", &self.profile)];
        lines.extend(self.checks.items.iter().map(|item| line(item.name, &item.text)));
        let sequence = self.plan.as_ref().map_or_else(
            || "the motor is not known: `drivebench run` finds it from small steps first".into(),
            |Plan { duration_s, .. }| {
                format!("`drivebench run` would take {duration_s:.1} s and is within every limit")
            },
        );
        lines.push(line("sequence", &sequence));
        lines.push("ready: the drive is stopped, and nothing has moved".to_owned());
        lines.join("\n")
    }
}

/// Withdraws the verdict that the nameplate does not fit where the five-parameter model leaves more than the noise on this
/// run, or cannot be compared with it: a missing effect shifts its values, and a brush drop looks like another motor.
fn judge_nameplate(whole: &mut CompletedRun, nameplate: &Motor) {
    let Some(comparison) = whole.nameplate.as_mut().filter(|found| !found.fits) else {
        return;
    };
    let residual = || -> Result<Option<f64>, Failure> {
        let loaded = whole.recorded.load()?;
        let run = Scenario::from_run(&loaded.run)?;
        let start = Model::baseline(nameplate.clone());
        let start = start::complete(&start, &run)?;
        let (evidence, fit) = Evidence::new(run, None, None).with_baseline(&start)?;
        // A model that holds where the excitation is slow may not hold where it is fast.
        let [fitted, held_out] = [&evidence.training, &evidence.holdout]
            .map(|part| Score::of(&fit.model, part, &evidence.noise).map(|score| score.nrms));
        let error = fitted?.max(held_out?);
        let is_explained = evidence.noise.is_at_the_floor(error);
        Ok((evidence.noise.source != FloorSource::None && !is_explained).then_some(error))
    };
    match residual() {
        Ok(Some(times_noise)) => comparison.doubt(NameplateDoubt::ModelMisses { times_noise }),
        Ok(None) => {}
        Err(error) => {
            let message = error.headline().to_owned();
            comparison.doubt(NameplateDoubt::NotCompared { message });
        }
    }
}

/// Writes model and result to the run folder, also after a trip.
fn write_results(whole: &mut CompletedRun, nameplate: &Motor, terminal: &Terminal) {
    let recorded = &mut whole.recorded;
    let model = online_model(&recorded.summary, nameplate, recorded.folder.path());
    recorded.write(RunFile::Model, &model.to_toml());
    let result = serde_json::to_value(&*whole).unwrap_or_default();
    whole.recorded.write_result(&result);
    pages::write_run(&mut whole.recorded, Some(&whole.plan), nameplate, None, terminal);
}

pub(super) fn print_checks(report: &CheckReport, terminal: &Terminal) {
    for item in &report.items {
        terminal.message(&format!("{:<18} {}", item.name, item.text));
    }
}

/// The baseline with what the on-line estimators settled on; the nameplate's value where they did not.
fn online_model(summary: &RunSummary, nameplate: &Motor, folder: &Path) -> ModelFile {
    let mut file = ModelFile { model: Model::baseline(nameplate.clone()), ..ModelFile::default() };
    file.history.fitted_on = vec![folder.display().to_string()];
    for estimate in &summary.estimates {
        let settled = estimate.value.filter(|_| estimate.verdict == Verdict::Settled);
        if let (Some(key), Some(value)) = (MotorKey::from_key(&estimate.key), settled) {
            file.model.motor.set(key, value);
            let fitted = estimate.std.map(|std| FittedValue { key: estimate.key.clone(), std });
            file.history.fitted.extend(fitted);
        }
    }
    file
}

/// Finds an unknown motor by small currents that rise, and fits the currents of the bench to it; what was found, in a sentence.
pub(crate) fn find_by_currents(
    rig: &mut Rig,
    controls: &Controls,
    mut print: impl FnMut(&str),
) -> Result<String, Failure> {
    let (limits, period_s) = (rig.bench.limits(), rig.bench.period_s());
    let section = CurrentsSection::search(&rig.bench.motor, &limits, period_s);
    let most_a = section.levels_a.last().copied().unwrap_or_default();
    print(&format!(
        "search: currents that rise to {most_a:.3} A, for {:.0} s",
        section.duration_s()
    ));
    let name = format!("{}-search", rig.bench.name);
    let recorded = rig.record_search(&name, &section, controls)?;
    if let Some(failure) = recorded.run_failure() {
        return Err(failure);
    }
    let mut motor = rig.bench.motor.motor();
    let mut reason = None;
    for own in &balanced(&recorded, &motor)? {
        match (MotorKey::from_key(&own.key), own.value) {
            (Some(key), Some(value)) => motor.set(key, value),
            (Some(MotorKey::Inertia | MotorKey::LoadTorque), None) => {
                reason = reason.or_else(|| own.reason.clone());
            }
            _ => {}
        }
    }
    // The drive controls the current: the inductance is in no result, and only the watch over the voltage takes it.
    if let (Some(ohm), None) = (motor.get(MotorKey::Resistance), motor.get(MotorKey::Inductance)) {
        motor.set(MotorKey::Inductance, ASSUMED_TIME_CONSTANT_S * ohm);
    }
    let Some(nameplate) = rig.bench.motor.with_found(&motor).filter(|_| reason.is_none()) else {
        let why = reason.unwrap_or_else(|| "the drive gives no voltage".to_owned());
        return Err(Failure::with_help(
            NOT_IDENTIFIABLE,
            format!("the motor was not found by small currents: {why}"),
            "give the motor's data in [motor]; of a drive without a voltage resistance_ohm and back_emf_v_s_per_rad are needed",
        ));
    };
    let sentence = format!(
        "found: J {} kg.m2, Mc {} N.m, Ke {} V.s/rad, R {} ohm",
        significant(nameplate.inertia_kg_m2, 3),
        significant(nameplate.load_torque_n_m, 3),
        significant(nameplate.back_emf_v_s_per_rad, 3),
        significant(nameplate.resistance_ohm, 3)
    );
    print(&sentence);
    rig.bench.motor = (&nameplate).into();
    let mut fitted = CurrentsSection::for_motor(&nameplate, &limits, period_s);
    let ends_s = fitted.duration_s() - fitted.seconds;
    fitted.seconds = fitted.seconds.min(limits.time_s - ends_s - period_s).max(period_s);
    rig.bench.currents = Some(fitted);
    Ok(sentence)
}

/// Parameters by the balances over the record.
fn balanced(recorded: &Recorded, motor: &Motor) -> Result<Vec<ParameterEstimate>, Failure> {
    let run = recorded.load()?.run;
    let scenario = Scenario::from_run(&run)?;
    let model = Model::baseline(motor.clone());
    let scheme = scheme::default_for(&scenario);
    Ok(scheme.identify(&Data { run: &run, scenario: &scenario, model: &model })?.parameters)
}

/// Replaces the on-line estimates of a run that a current drives, whose voltage changes between two samples, by those of its
/// balances; returns whether it did.
pub(crate) fn of_balances(bench: &BenchFile, recorded: &mut Recorded) -> Result<bool, Failure> {
    if bench.currents.is_none() || recorded.run_failure().is_some() {
        return Ok(false);
    }
    recorded.summary.estimates = balanced(recorded, &bench.motor.motor())?;
    Ok(true)
}

/// L/R of a winding that no run shows, s.
const ASSUMED_TIME_CONSTANT_S: f64 = 1e-3;

/// Runs the stages until the motor is found or the reason why not is named. A motor that is found becomes the nameplate of
/// the rig. `print` gets a line for each stage.
pub(crate) fn escalate(
    rig: &mut Rig,
    controls: &Controls,
    mut print: impl FnMut(&str),
) -> Result<EscalationResult, Failure> {
    let mut workflow = Escalate::new(&rig.bench);
    let mut number = 0;
    while let Some(stage) = workflow.stage().cloned() {
        if controls.is_stopped() {
            return Err(Failure::interrupted(BETWEEN_RUNS));
        }
        number += 1;
        print(&format!(
            "{} {number}: up to {:.3} V ({})",
            stage.kind.name(),
            stage.peak_v,
            stage.reason
        ));
        let name = format!("{}-escalation-{number:02}", rig.bench.name);
        let mut recorded = rig.record_stage(&name, &stage, number > 1, controls)?;
        if let Some(failure) = recorded.run_failure() {
            return Err(failure);
        }
        let folder = recorded.folder.path().display().to_string();
        let record = workflow.ran(&recorded.load()?.run, Some(folder))?;
        recorded.write_result(&record);
        print(&record.stage.line);
    }
    let mut result = workflow.result();
    if let Some(found) = result.found(&rig.bench) {
        print(&result.sentence);
        let is_stated = !rig.bench.motor.is_unknown();
        if let Some(refusal) = result.scale(&rig.bench, rig.drive_current_limit_a())? {
            let headline = format!("plan refused for the motor that was found: {refusal}");
            return Err(Failure::usage(headline, refusal.help()));
        }
        let nothing = || Failure::internal("a motor was found and nothing planned");
        let scaled = result.scaled.as_ref().ok_or_else(nothing)?;
        let nameplate = result.nameplate.as_ref();
        let fits = nameplate.is_none_or(|comparison| comparison.fits);
        if let Some(refusal) = scaled.refusal.as_ref().filter(|_| is_stated && !fits) {
            // The sequence was written for the nameplate: as written it would be too much.
            if let Some(comparison) = nameplate {
                print(&words::nameplate(comparison));
                comparison.rows.iter().for_each(|row| print(&words::row(row)));
                let causes = comparison.causes.iter().map(words::cause);
                causes.for_each(|cause| print(&format!("likely: {cause}")));
            }
            return Err(Failure::usage(
                format!(
                    "the nameplate does not fit, and with the motor that was found the sequence is refused: {refusal}"
                ),
                "correct [motor], or set motor.unknown = true to have the sequence made smaller",
            ));
        }
        print(&scaled_sentence(scaled));
        rig.bench = scaled.bench.clone();
        rig.bench.motor = (&found).into();
    }
    Ok(result)
}

pub(crate) fn escalation_failure(result: &EscalationResult) -> Option<Failure> {
    let ending = result.ending.as_ref()?;
    let status = match ending {
        Ending::NotIdentified { .. } => NOT_IDENTIFIABLE,
        _ => LINK,
    };
    Some(Failure::with_help(status, ending.sentence(), ending.help()))
}
