//! Runs and models that a command judges: read, checked for implausible data and against each other; and the bench, limits
//! and bench file of the recommended next run.
//!
//! ```text
//! run, model, hold-out, confirming run --> sanity of the data --> can the others judge it? --> Evidence, notes, cautions
//! ```

use std::cell::OnceCell;
use std::path::{Path, PathBuf};

use serde::Serialize;
use serde_json::{Map, Value, json};

use crate::report::wording::limits::{last_part, set_aside};
use crate::report::wording::next_run::next_run;
use crate::report::wording::versus::motor_match;
use crate::report::wording::{json as found_json, record, sanity as words};
use crate::runtime::{Failure, Terminal, output, read_model, read_text};
use crate::workflow::{bench_for, experiment_limits, next_bench};
use drivebench_bench::BenchFile;
use drivebench_bench::recording::LoadedRun;
use drivebench_diagnose::{
    Diagnosis, ErrorOf, Evidence, ExperimentLimits, Fingerprint, HoldoutFrom, Kinship,
    NextExperiment, RecordedChannels, fingerprint, fitted_baseline, matches, recommend,
    shared_samples,
};
use drivebench_identify::sanity::{self, Finding, Kind};
use drivebench_identify::{lost_rows, start};
use drivebench_model::numerics::statistics::median;
use drivebench_model::plant::{Input, Model, ModelFile, Motor, Scenario, Slot};
use drivebench_model::sample::{Channel, ParameterEstimate, Reason, Run, Side, Verdict};

/// Fewest samples of a hold-out: its errors are compared by blocks.
const FEWEST_HELD_OUT: usize = 20;
/// Share of a hold-out's samples that may be those of the fitted run.
const MOST_SHARED: f64 = 0.5;

#[derive(Clone, Copy)]
pub(crate) struct EvidenceFiles<'a> {
    pub(crate) terminal: &'a Terminal,
    pub(crate) run: &'a Path,
    /// Without it the run folder's, else a fitted baseline.
    pub(crate) model: Option<&'a Path>,
    pub(crate) holdout: Option<&'a Path>,
    pub(crate) confirm: Option<&'a Path>,
    /// Later runs of the same machine, fitted together with the first.
    pub(crate) later: &'a [PathBuf],
    /// Whether every channel is kept, not only those that the model needs.
    pub(crate) for_screen: bool,
}

impl<'a> EvidenceFiles<'a> {
    /// One run alone, with its own model.
    pub(crate) const fn of(run: &'a Path, terminal: &'a Terminal) -> Self {
        let (model, holdout, confirm) = (None, None, None);
        Self { terminal, run, model, holdout, confirm, later: &[], for_screen: false }
    }
}

/// How a command uses the model that it judges.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Judging {
    /// Compares the model as given.
    AsGiven,
    /// Refits the given model; a record without excitation is accepted, for a diagnosis without a finding.
    Refits,
    /// Fits the baseline to the data first.
    FitsFirst,
}

impl Judging {
    /// Of a comparison: what was given is not refitted.
    pub(crate) const fn of(model: Option<&Path>) -> Self {
        if model.is_some() { Self::AsGiven } else { Self::Refits }
    }
}

pub(crate) struct ChosenModel {
    pub(crate) file: ModelFile,
    pub(crate) from: String,
    /// None was given: the five parameters, yet to be found.
    pub(crate) is_baseline: bool,
}

/// Value of --model that selects the baseline even where the run folder has a model, unless a file has this name.
pub(crate) const BASELINE: &str = "baseline";

/// The model file, else the run folder's, else the five-parameter baseline with values yet to be found.
pub(crate) fn model(
    path: Option<&Path>,
    run: &LoadedRun,
    terminal: &Terminal,
) -> Result<ChosenModel, Failure> {
    let is_requested = path.is_some_and(|path| path == Path::new(BASELINE) && !path.exists());
    let in_folder = run.folder.as_ref().map(|folder| folder.join("model.toml"));
    let path = path.map(Path::to_owned).or(in_folder.filter(|file| file.exists()));
    let Some(path) = path.filter(|_| !is_requested) else {
        let given = if is_requested { "" } else { "no model given: " };
        terminal.message(&format!("{given}the five-parameter baseline is fitted to the run first"));
        let file =
            ModelFile { model: Model::baseline(Motor::new("fitted")), ..ModelFile::default() };
        return Ok(ChosenModel { file, from: BASELINE.to_owned(), is_baseline: true });
    };
    Ok(ChosenModel {
        file: read_model(&path)?,
        from: path.display().to_string(),
        is_baseline: false,
    })
}

/// Names of the data for a screen or a page, without runs that were set aside.
pub(crate) struct About {
    /// The fitted run and what is held out, by the last part of their names.
    pub(crate) title: String,
    /// The runs that are used, the one that is fitted first.
    pub(crate) runs: Vec<PathBuf>,
    /// Whether the hold-out is used despite an objection.
    pub(crate) holdout_objected: bool,
}

/// How a comparison judges its model.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Judged {
    /// The model was fitted to the run.
    pub(crate) refitted: bool,
    pub(crate) error_of: ErrorOf,
}

/// Everything that `compare`, `diagnose`, `add` and `remove` need.
pub(crate) struct Prepared {
    pub(crate) run: LoadedRun,
    pub(crate) model: ChosenModel,
    pub(crate) evidence: Evidence,
    pub(crate) about: About,
    /// Every channel of the runs, where a screen is to show them.
    pub(crate) recorded: RecordedChannels,
}

impl Prepared {
    /// Prepares the model that is judged: a file that was named is not refitted; the model of a run folder is refitted as by
    /// `diagnose`; without either the baseline is fitted. `from` then states which.
    pub(crate) fn judge_as_diagnose(
        &mut self,
        is_given: bool,
        terminal: &Terminal,
    ) -> Result<Judged, Failure> {
        let is_baseline = self.model.is_baseline;
        let is_electrical = self.evidence.training.input == Input::Voltage;
        let refitted = is_baseline || !is_given && is_electrical;
        if refitted {
            terminal.stage("fits the model", 0);
            let effects = self.model.file.model.effect_ids();
            let (evidence, aside) = self.evidence.fitted_with(&effects);
            let evidence = evidence.into_owned();
            if let Some(aside) = aside {
                note(&mut self.run.run.notes, set_aside(&aside), terminal);
            }
            (self.evidence, self.model.file.model) =
                fitted_baseline(&self.model.file.model, evidence)?;
        }
        // A torque balance is judged even without an inertia, if the run cannot identify it.
        if !refitted || is_electrical {
            self.model.file.model.require_complete()?;
        }
        let from = &self.model.from;
        self.model.from = match (is_baseline, refitted) {
            (true, _) => "the five-parameter baseline, fitted to this run".to_owned(),
            (_, true) => format!(
                "{from}, refitted to this run, as in diagnose; a file named with --model is not refitted"
            ),
            (_, false) => format!("{from}, not refitted"),
        };
        Ok(Judged {
            refitted,
            error_of: if refitted { ErrorOf::Structure } else { ErrorOf::Model },
        })
    }

    /// A result as JSON, with the notes on the data.
    pub(crate) fn result(&self, found: &impl Serialize) -> Value {
        let mut value = serde_json::to_value(found).unwrap_or_default();
        value["rows_dropped"] = self.run.run.rows_dropped.into();
        value["notes"] = self.run.run.notes.clone().into();
        value
    }
}

impl About {
    /// Names of the fitted run and the later ones, of the hold-out and of the confirming run.
    fn of(
        run: &Path,
        later: &[&PathBuf],
        holdout: Option<&Path>,
        confirm: Option<&Path>,
        part: &str,
    ) -> Self {
        let name =
            |path: &Path| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let judged_by = holdout.map_or_else(
            || format!("{part} held out"),
            |holdout| format!("held out {}", name(holdout)),
        );
        let later = later.iter().map(|path| path.as_path());
        let fitted: Vec<String> = std::iter::once(run).chain(later.clone()).map(name).collect();
        let used = [Some(run), holdout, confirm].into_iter().flatten();
        Self {
            title: format!("{}, {judged_by}", fitted.join(" and ")),
            runs: used.chain(later).map(Path::to_owned).collect(),
            holdout_objected: false,
        }
    }
}

/// Opens the runs of a command, the fitted one first (the flag of `load` is set for the others); fails where the data cannot
/// be judged.
pub(crate) fn prepare(
    files: EvidenceFiles<'_>,
    load: impl Fn(&Path, bool) -> Result<LoadedRun, Failure>,
    judging: Judging,
) -> Result<Prepared, Failure> {
    let terminal = files.terminal;
    terminal.stage("reads the runs", 0);
    let mut run = load(files.run, false)?;
    let mut model = model(files.model, &run, terminal)?;
    let fit_run = Scenario::from_run(&run.run)?;
    let judging = if model.is_baseline { Judging::FitsFirst } else { judging };
    before_judging(&mut run.run, &fit_run, &model.file.model, judging, terminal)?;
    let found = cautions(&run.run, &fit_run);
    terminal.warn(&found);
    run.run.notes.extend(found);
    let mut recorded = RecordedChannels::default();
    if files.for_screen {
        recorded.add(&run.run, &fit_run);
    }
    let mut others = Vec::new();
    let mut other = |path: Option<&Path>| -> Result<Option<(LoadedRun, Scenario)>, Failure> {
        let Some(path) = path else { return Ok(None) };
        let loaded = load(path, true)?;
        let scenario = Scenario::from_run(&loaded.run)?;
        let found = cautions(&loaded.run, &scenario);
        terminal.warn(&found);
        others.extend(found);
        if files.for_screen {
            recorded.add(&loaded.run, &scenario);
        }
        Ok(Some((loaded, scenario)))
    };
    name_voltage(&run.run, &fit_run, terminal);
    let limited = limited_note(&run.run);
    if let Some(note) = limited.filter(|_| fit_run.input_channel == Channel::VoltageCmd) {
        terminal.message(&note);
        run.run.notes.push(note);
    }
    terminal.stage("finds where the fit starts", 0);
    model.file.model = start::complete(&model.file.model, &fit_run)?;
    let (holdout, confirm) = (other(files.holdout)?, other(files.confirm)?);
    let later = files.later.iter().map(|path| other(Some(path)));
    let later = later.collect::<Result<Vec<_>, Failure>>()?;
    let notes = &mut run.run.notes;
    notes.extend(others);
    let judge = Judge {
        terminal,
        model: &model.file.model,
        fitted: &fit_run,
        judging,
        fingerprint: OnceCell::new(),
        refuses_others: true,
    };
    let instead = "the last part of the run is held out instead";
    let (holdout, mut objected) = judge.admit("hold-out", holdout, instead, notes);
    let (confirm, _) = judge.admit("confirming run", confirm, "nothing is confirmed", notes);
    let confirm =
        confirm.filter(|confirm| is_independent(confirm, holdout.as_ref(), notes, terminal));
    let judge = Judge { refuses_others: false, ..judge };
    let judging_runs = [("hold-out", &holdout), ("confirming run", &confirm)];
    let admitted = judge.admit_all_later(files.later, later, judging_runs, notes);
    let by_voltage = fit_run.input == Input::Voltage;
    if let Some((path, _)) = admitted.first().filter(|_| !by_voltage) {
        let headline = format!(
            "--with {}: the fitted run is not driven by a voltage, and no other run can be fitted together with it",
            path.display()
        );
        return Err(Failure::usage(headline, "leave --with out"));
    }
    let (later, admitted): (Vec<&PathBuf>, Vec<Scenario>) = admitted.into_iter().unzip();
    let evidence = Evidence::new(fit_run, holdout, confirm);
    let evidence = admitted.into_iter().fold(evidence, Evidence::with_run);
    let is_run = evidence.holdout_from == HoldoutFrom::Run;
    let holdout = files.holdout.filter(|_| is_run);
    if judging == Judging::AsGiven {
        let fitted = was_fitted_on(&model.file.history.fitted_on, files.run, holdout);
        objected |= fitted.is_some();
        terminal.warn(fitted.as_slice());
        notes.extend(fitted);
    }
    let confirm = files.confirm.filter(|_| evidence.confirm.is_some());
    let about = About {
        holdout_objected: objected && is_run,
        ..About::of(files.run, &later, holdout, confirm, &last_part(evidence.held_out_share()))
    };
    Ok(Prepared { run, model, evidence, about, recorded })
}

/// Names the column that is used as the voltage, where it is not the only one or not the first choice.
pub(crate) fn name_voltage(run: &Run, scenario: &Scenario, terminal: &Terminal) {
    match scenario.input_channel {
        Channel::VoltageCmd => terminal.message("voltage_cmd_v is used as the voltage"),
        Channel::Voltage if run.column(Channel::VoltageCmd).is_some() => {
            terminal.message("voltage_v is used as the voltage, not voltage_cmd_v");
        }
        _ => {}
    }
}

/// In how many samples the command was not the voltage of the motor.
fn limited_note(run: &Run) -> Option<String> {
    let limited = run.limited_rows().len();
    let instead = if run.points(Channel::Voltage).count() == 0 {
        "the voltage of the motor was not measured: smaller steps avoid the limit"
    } else {
        "there the measured voltage is used"
    };
    (limited > 0)
        .then(|| format!("a limit of the drive was active at {limited} samples; {instead}"))
}

/// Checks a later run before it is fitted together with earlier ones; returns its scenario and notes.
pub(crate) fn admit_later(
    loaded: &LoadedRun,
    model: &Model,
    fitted: &Scenario,
    terminal: &Terminal,
) -> Result<(Scenario, Vec<String>), Failure> {
    let scenario = Scenario::from_run(&loaded.run)?;
    let mut notes = cautions(&loaded.run, &scenario);
    let judge = Judge {
        terminal,
        model,
        fitted,
        judging: Judging::Refits,
        fingerprint: OnceCell::new(),
        refuses_others: false,
    };
    match judge.objection_to_later(&loaded.run, &scenario, std::iter::empty()) {
        Some((reason, true)) => {
            let headline = format!("the new run cannot be used: {reason}");
            return Err(Failure::usage(headline, "correct this, and make the run again"));
        }
        Some((reason, false)) => notes.push(reason),
        None => {}
    }
    Ok((scenario, notes))
}

/// Whether another run can judge the fit: of the same motor, moving, long enough, and not the data that are fitted.
struct Judge<'a> {
    terminal: &'a Terminal,
    model: &'a Model,
    fitted: &'a Scenario,
    judging: Judging,
    fingerprint: OnceCell<Option<Fingerprint>>,
    /// Whether a run that seems to be of another motor is set aside. A run that was recommended to show a missing effect may
    /// seem so because of that effect (an error of 1 V is large in a run of 10 V), and gets a note only.
    refuses_others: bool,
}

impl Judge<'_> {
    /// `other` where it can be used in this role, and whether there is an objection. Where it cannot, the reason goes to stderr
    /// and to `notes`, and a command that fits continues without it; one that compares a model as given compares nevertheless.
    fn admit(
        &self,
        role: &str,
        other: Option<(LoadedRun, Scenario)>,
        instead: &str,
        notes: &mut Vec<String>,
    ) -> (Option<Scenario>, bool) {
        let Some((loaded, scenario)) = other else {
            return (None, false);
        };
        let Some((reason, forbids)) = self.objection(&loaded.run, &scenario) else {
            return (Some(scenario), false);
        };
        let sets_aside = forbids && self.judging != Judging::AsGiven;
        note(
            notes,
            if sets_aside {
                format!("{role}: {reason}; it is not used, {instead}")
            } else {
                format!("{role}: {reason}")
            },
            self.terminal,
        );
        ((!sets_aside).then_some(scenario), true)
    }

    /// Those of the runs of these files that can be fitted together with the first; `judging_runs` judge the fit.
    fn admit_all_later<'p>(
        &self,
        files: &'p [PathBuf],
        later: Vec<Option<(LoadedRun, Scenario)>>,
        judging_runs: [(&'static str, &Option<Scenario>); 2],
        notes: &mut Vec<String>,
    ) -> Vec<(&'p PathBuf, Scenario)> {
        let mut admitted: Vec<(&PathBuf, Scenario)> = Vec::new();
        for (path, later) in files.iter().zip(later) {
            let Some((loaded, later)) = later else {
                continue;
            };
            let others = judging_runs.into_iter();
            let others = others.filter_map(|(role, run)| Some((role, run.as_ref()?)));
            let earlier = admitted.iter().map(|(_, run)| ("later run before it", run));
            let objection = self.objection_to_later(&loaded.run, &later, others.chain(earlier));
            let forbids = objection.as_ref().is_some_and(|(_, forbids)| *forbids);
            if let Some((reason, _)) = objection {
                let instead =
                    if forbids { "; it is not used, the others are judged without it" } else { "" };
                let text = format!("later run {}: {reason}{instead}", path.display());
                note(notes, text, self.terminal);
            }
            if !forbids {
                admitted.push((path, later));
            }
        }
        admitted
    }

    /// The objection to a run that is to be fitted together with the first, also compared with `others`; and whether it forbids
    /// the run.
    fn objection_to_later<'s>(
        &self,
        run: &Run,
        scenario: &Scenario,
        others: impl Iterator<Item = (&'static str, &'s Scenario)>,
    ) -> Option<(String, bool)> {
        let [own, fitted] = [scenario.input, self.fitted.input].map(driven_by);
        if scenario.input != self.fitted.input {
            let other = format!(
                "it is driven by a {own} and the fitted run by a {fitted}: they cannot be fitted together"
            );
            return Some((other, true));
        }
        let is_same = |other: &Scenario| {
            let shared = shared_samples(scenario, other).max(shared_samples(other, scenario));
            shared > MOST_SHARED
        };
        for (role, other) in others {
            if is_same(other) {
                let same = format!(
                    "its samples are those of the {role}: data must not be fitted twice, nor judge their own fit"
                );
                return Some((same, true));
            }
        }
        self.objection(run, scenario)
    }

    /// The objection to a run, and whether it forbids to judge by the run.
    fn objection(&self, run: &Run, scenario: &Scenario) -> Option<(String, bool)> {
        if shared_samples(self.fitted, scenario) > MOST_SHARED {
            let same = "its samples are those of the run that is fitted, so that it tests nothing";
            return Some((same.to_owned(), true));
        }
        let length_s = |run: &Scenario| run.sample_time_s[run.samples() - 1] - run.sample_time_s[0];
        let (own_s, least_s) = (length_s(scenario), 0.1 * length_s(self.fitted));
        let samples = scenario.samples();
        if own_s < least_s || samples < FEWEST_HELD_OUT {
            let short = format!(
                "it has {samples} samples in {own_s:.3} s, and at least {FEWEST_HELD_OUT} in {least_s:.3} s, a tenth of the run \
                 that is fitted, are needed"
            );
            return Some((short, true));
        }
        let findings = sanity::examine(run, scenario, self.model);
        if let Some(finding) = findings.iter().find(|finding| finding.refuses) {
            let is_of_map = matches!(finding.kind, Kind::Unit | Kind::Swapped | Kind::Reversed);
            let help = is_of_map.then(|| words::help(&finding.fault, "--map-holdout"));
            let help = help.map_or_else(String::new, |help| format!("; {help}"));
            return Some((words::fault(&finding.fault) + &help, true));
        }
        let (model, fitted) = (self.model, self.fitted);
        let of_fitted = *self.fingerprint.get_or_init(|| fingerprint(model, fitted));
        let found = matches(of_fitted?, fingerprint(model, scenario)?);
        let is_other = found.kinship == Kinship::Other && self.refuses_others;
        (found.kinship != Kinship::Same).then(|| (motor_match(&found), is_other))
    }
}

const fn driven_by(input: Input) -> &'static str {
    match input {
        Input::Voltage => "voltage",
        Input::Current => "current",
        Input::Torque => "torque",
    }
}

/// To stderr and into the result.
fn note(notes: &mut Vec<String>, sentence: String, terminal: &Terminal) {
    terminal.warn(std::slice::from_ref(&sentence));
    notes.push(sentence);
}

/// Warning that a model is judged on data to which it was fitted according to its file: `holdout`, or the last part of `run`.
pub(crate) fn was_fitted_on(
    fitted_on: &[String],
    run: &Path,
    holdout: Option<&Path>,
) -> Option<String> {
    let judge = holdout.unwrap_or(run);
    let mut names = fitted_on.iter();
    let name = names.find(|name| is_same(Path::new(name), judge))?;
    Some(if holdout.is_some() {
        format!(
            "hold-out: the model was fitted on it (its file names {name}), so that its held-out figures are those of a fit and \
             test nothing"
        )
    } else {
        format!(
            "the model was fitted on this run (its file names {name}): what is held out, its last part, may have been fitted \
             too; give another run with --holdout"
        )
    })
}

/// Whether two paths are of one run; a folder that does not exist any more is compared by name.
fn is_same(recorded: &Path, path: &Path) -> bool {
    let folder = |path: &Path| {
        let is_samples = path.file_name().is_some_and(|name| name == "samples.csv");
        path.parent().filter(|_| is_samples).unwrap_or(path).to_owned()
    };
    match (recorded.canonicalize(), path.canonicalize()) {
        (Ok(recorded), Ok(path)) => folder(&recorded) == folder(&path),
        _ => folder(recorded).file_name() == folder(path).file_name(),
    }
}

/// Whether the confirming run is not the hold-out, by which effects are selected; else the reason goes to stderr and to
/// `notes`.
fn is_independent(
    confirm: &Scenario,
    holdout: Option<&Scenario>,
    notes: &mut Vec<String>,
    terminal: &Terminal,
) -> bool {
    let shared = holdout.map_or(0.0, |holdout| shared_samples(holdout, confirm));
    if shared > MOST_SHARED {
        let sentence = "confirming run: its samples are those of the hold-out, by which effects are selected; it is not used, nothing is confirmed";
        note(notes, sentence.to_owned(), terminal);
    }
    shared <= MOST_SHARED
}

/// Cautions about gaps: rows without a voltage, signals without values, times without rows.
pub(crate) fn cautions(run: &Run, scenario: &Scenario) -> Vec<String> {
    let (mut cautions, name) = (Vec::new(), &run.name);
    let channel = scenario.input_channel;
    cautions.extend(lost_rows::find(run, scenario).as_ref().map(record::lost_rows));
    cautions.extend(record::unconfirmed(scenario));
    let whole = scenario.unknown_input.iter().all(|hole| hole.lost_rows == 0);
    if scenario.has_sampled_input() {
        let key = channel.key();
        cautions.push(format!(
            "{name}: {key} is known at the rows only, and changed at unknown instants between them, which are estimated from the current"
        ));
    }
    if let (true, Channel::Voltage, Some(cells)) = (whole, channel, run.column(channel)) {
        let begin_s = scenario.begin_s();
        let rows = run.time_s().iter().zip(cells);
        let rows = rows.filter(|(time_s, _)| **time_s >= begin_s);
        let missing = rows.clone().filter(|(_, cell)| !cell.is_finite()).count();
        if missing > 0 {
            let (key, rows) = (channel.key(), rows.count());
            cautions.push(format!(
                "{name}: {key} is empty in {missing} of {rows} rows: the value before it is held"
            ));
        }
    }
    for (channel, cells) in
        [(Channel::Current, &scenario.current_a), (Channel::Speed, &scenario.speed_rad_s)]
    {
        let missing = cells.iter().filter(|cell| !cell.is_finite()).count();
        if run.column(channel).is_none() || missing * 10 < cells.len() {
            continue;
        }
        let (key, samples) = (channel.key(), cells.len());
        cautions.push(if missing == samples {
            format!("{name}: {key} has no value in any sample: it counts as not measured")
        } else {
            format!("{name}: {key} is missing in {missing} of {samples} samples: they are left out")
        });
    }
    let times = &scenario.sample_time_s;
    let period_s = (times[times.len() - 1] - times[0]) / (times.len() - 1) as f64;
    let longest = times.windows(2).max_by(|a, b| (a[1] - a[0]).total_cmp(&(b[1] - b[0])));
    if let Some([from_s, to_s]) = longest
        && whole
        && to_s - from_s > f64::max(50.0 * period_s, 0.2)
    {
        cautions.push(format!(
            "{name}: no rows between {from_s:.3} s and {to_s:.3} s: the voltage is held over the gap, and the motion in it counts \
            as an error of the model; cut the file there"
        ));
    }
    cautions
}

/// Origin and side of each signal that the run has, for JSON.
pub(crate) fn signals(run: &Run) -> Value {
    let is_present = |channel: &Channel| run.column(*channel).is_some();
    let entries = Channel::ALL.into_iter().filter(is_present).map(|channel| {
        let origin = run.origin(channel).name();
        let side = run.side(channel).map(Side::name);
        (channel.key().to_owned(), json!({ "origin": origin, "side": side }))
    });
    Value::Object(entries.collect::<Map<_, _>>())
}

/// Checks the data before `identify`. A finding that forbids identification ends the command, with a result in which every
/// parameter is null; cautions go to stderr and to the notes of the run.
pub(crate) fn before_identify(
    run: &mut Run,
    scenario: &Scenario,
    model: &Model,
    require: &[String],
    json: bool,
    terminal: &Terminal,
) -> Result<Vec<Finding>, Failure> {
    let findings = sanity::examine(run, scenario, model);
    let Some(refusal) = findings.iter().find(|finding| finding.refuses) else {
        caution(run, &findings, terminal);
        return Ok(findings);
    };
    let slots = model.slots();
    let parameters = slots.iter().map(|slot| {
        let value = serde_json::to_value(not_identified(slot, model, refusal));
        (slot.key(), value.unwrap_or_default())
    });
    let value = json!({
        "scheme": null,
        "parameters": parameters.collect::<Map<_, _>>(),
        "rows": run.rows(),
        "rows_used": scenario.samples(),
        "rows_dropped": run.rows_dropped,
        "input": scenario.input_channel.key(),
        "signals": signals(run),
        "findings": found_json::sanity(&findings),
        "notes": notes(run, &findings),
    });
    if json {
        terminal.json(&value)?;
    }
    let others = findings.iter().filter(|finding| *finding != refusal);
    terminal.warn(&others.map(|other| words::fault(&other.fault)).collect::<Vec<_>>());
    let what = match require {
        [] => "nothing".to_owned(),
        keys => keys.join(", "),
    };
    Err(cannot_identify(&what, refusal))
}

/// Checks the data before a command that judges a model; a finding that forbids it ends the command, others are cautions.
fn before_judging(
    run: &mut Run,
    scenario: &Scenario,
    model: &Model,
    judging: Judging,
    terminal: &Terminal,
) -> Result<(), Failure> {
    let findings = sanity::examine(run, scenario, model);
    let forbids = |finding: &&Finding| {
        let excites_nothing = matches!(finding.kind, Kind::Steady | Kind::Standstill);
        finding.refuses
            && match judging {
                Judging::AsGiven => false,
                Judging::Refits => !excites_nothing,
                Judging::FitsFirst => true,
            }
    };
    if let Some(refusal) = findings.iter().find(forbids) {
        return Err(cannot_identify("nothing", refusal));
    }
    caution(run, &findings, terminal);
    Ok(())
}

fn cannot_identify(what: &str, refusal: &Finding) -> Failure {
    let can = if what == "nothing" { "can" } else { "cannot" };
    let headline = format!("{what} {can} be identified: {}", words::fault(&refusal.fault));
    Failure::not_identifiable(headline, words::help(&refusal.fault, words::MAP))
}

fn notes(run: &Run, findings: &[Finding]) -> Vec<String> {
    let found = findings.iter().map(|finding| words::fault(&finding.fault));
    run.notes.iter().cloned().chain(found).collect()
}

fn caution(run: &mut Run, findings: &[Finding], terminal: &Terminal) {
    for (finding, help) in findings.iter().zip(words::helps(findings)) {
        let help = if help.is_empty() { help } else { format!("; {help}") };
        terminal.warn(&[words::fault(&finding.fault) + &help]);
    }
    run.notes = notes(run, findings);
}

/// No value, with the reason; a parameter that the user fixed stays as given.
fn not_identified(slot: &Slot, model: &Model, refusal: &Finding) -> ParameterEstimate {
    let key = slot.key();
    match model.get(slot) {
        Some(value) if model.fixed.contains(&key) => ParameterEstimate {
            key,
            value: Some(value),
            std: Some(0.0),
            unit: slot.unit(),
            verdict: Verdict::Fixed,
            reason: None,
            code: None,
        },
        _ => {
            let reason = words::fault(&refusal.fault);
            ParameterEstimate::not_observable(&key, slot.unit(), Reason::FaultyData, reason)
        }
    }
}

pub(crate) struct RecommendationBench {
    bench: Option<BenchFile>,
    limits: ExperimentLimits,
    rate_hz: f64,
}

impl RecommendationBench {
    /// `bench`, else that of the run folder; without either the ranges that the runs have reached are the limits.
    pub(crate) fn of(
        bench: Option<&Path>,
        prepared: &Prepared,
        terminal: &Terminal,
    ) -> Result<Self, Failure> {
        let bench = match bench {
            Some(path) => Some(BenchFile::parse(&path.display().to_string(), &read_text(path)?)?),
            None => recorded_bench(prepared, terminal),
        };
        let mut limits = bench
            .as_ref()
            .map_or_else(|| ExperimentLimits::seen_in(&prepared.evidence), experiment_limits);
        if let Some(amps) = drive_limit_a(prepared) {
            limits.current_a = limits.current_a.min(amps);
        }
        Ok(Self { bench, limits, rate_hz: rate_hz(&prepared.evidence.training) })
    }

    /// Writes the bench file, where there is a run to recommend; `then` diagnoses that run.
    pub(crate) fn write(
        &self,
        path: &Path,
        diagnosis: &Diagnosis,
        then: &str,
        terminal: &Terminal,
    ) -> Result<(), Failure> {
        let (next, path_text) = (diagnosis.next_experiment.as_ref(), path.display());
        let Some(text) = next.and_then(|next| next.bench.as_ref()) else {
            terminal.message(&format!("{path_text} is not written: there is no run to recommend"));
            return Ok(());
        };
        terminal.file(path, text)?;
        let port = if self.bench.is_some() {
            ""
        } else {
            " --port PORT (the drive of the runs is not recorded)"
        };
        let file = output::quoted(path);
        terminal
            .message(&format!("{path_text} is written: drivebench run {file}{port}, then {then}"));
        Ok(())
    }

    pub(crate) const fn limits(&self) -> ExperimentLimits {
        self.limits
    }

    pub(crate) fn recommend(
        &self,
        diagnosis: &mut Diagnosis,
        prepared: &Prepared,
    ) -> Result<(), Failure> {
        if let Some(next) = recommend(diagnosis, &prepared.evidence, &self.limits)? {
            self.take_over(diagnosis, next);
        }
        Ok(())
    }

    /// Puts a run that was recommended for it within the same limits into the diagnosis.
    pub(crate) fn take_over(&self, diagnosis: &mut Diagnosis, mut next: NextExperiment) {
        let model = &diagnosis.model.model;
        next.bench = next.recipe.as_ref().map(|recipe| {
            let unknown = || bench_for(model, &self.limits, self.rate_hz);
            let bench = self.bench.clone().unwrap_or_else(unknown);
            next_bench(&bench, recipe, model, &next_run(&next))
        });
        diagnosis.next_experiment = Some(next);
    }
}

/// The bench of the run folder, from its manifest. A bench that this version cannot read is left out, with a warning.
fn recorded_bench(prepared: &Prepared, terminal: &Terminal) -> Option<BenchFile> {
    let manifest = prepared.run.manifest.as_ref()?;
    let text = manifest.configs.get("bench")?;
    match BenchFile::parse("manifest.json: configs.bench", text) {
        Ok(bench) => Some(bench),
        Err(error) => {
            terminal.warn(&[format!("the run's bench is not used: {error}")]);
            None
        }
    }
}

/// The current limit that the drive of the run reported.
fn drive_limit_a(prepared: &Prepared) -> Option<f64> {
    let manifest = prepared.run.manifest.as_ref()?;
    manifest.identity.get("current_limit_a")?.as_f64()
}

/// Rows per second, as a whole number for a bench file.
fn rate_hz(run: &Scenario) -> f64 {
    let periods: Vec<f64> = run.sample_time_s.windows(2).map(|pair| pair[1] - pair[0]).collect();
    (1.0 / median(&periods)).round()
}

#[cfg(test)]
#[path = "evidence_tests.rs"]
mod tests;
