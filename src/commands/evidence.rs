//! Runs and models that a command judges: read, checked against what cannot be true, and against each other; and the run
//! that is recommended next: whose limits it keeps, and its bench file.
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
use crate::runtime::failure::Failure;
use crate::runtime::files::{read_model, read_text};
use crate::runtime::output;
use crate::runtime::output::Terminal;
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
use drivebench_model::sample::{Channel, ParameterEstimate, Run, Side, Verdict};

/// Shortest hold-out, as a share of the run that is fitted, and fewest samples of it: the blocks by which errors are compared.
const SHORTEST_SHARE: f64 = 0.1;
const FEWEST_HELD_OUT: usize = 20;
/// Share of a hold-out's samples that may be those of the fitted run.
const MOST_SHARED: f64 = 0.5;
/// One sample of so many without a value is worth a word.
const MANY_MISSING: usize = 10;
/// A time without rows that is worth a word: so many mean periods, and so many seconds.
const LONG_GAP: f64 = 50.0;
const LONG_GAP_S: f64 = 0.2;

/// The files that a command names.
#[derive(Clone, Copy)]
pub(crate) struct EvidenceFiles<'a> {
    pub(crate) terminal: &'a Terminal,
    pub(crate) run: &'a Path,
    /// Without it the run folder's, else a fitted baseline.
    pub(crate) model: Option<&'a Path>,
    pub(crate) holdout: Option<&'a Path>,
    pub(crate) confirm: Option<&'a Path>,
    /// Later runs of the same machine, fitted behind the first.
    pub(crate) later: &'a [PathBuf],
    /// Every channel is kept beside what the model needs.
    pub(crate) for_screen: bool,
}

/// What a command that judges a model does with it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Judging {
    /// Compares the model as given.
    AsGiven,
    /// Refits the given model: a record that excites nothing still has the verdict that nothing can be said.
    Refits,
    /// Has no model but the one that it fits to the data.
    FitsFirst,
}

impl Judging {
    /// Of a comparison: what was given is not refitted.
    pub(crate) const fn of(model: Option<&Path>) -> Self {
        if model.is_some() { Self::AsGiven } else { Self::Refits }
    }
}

/// A model with the place it came from.
pub(crate) struct ChosenModel {
    pub(crate) file: ModelFile,
    pub(crate) from: String,
    /// None was given: the five parameters, yet to be found.
    pub(crate) is_baseline: bool,
}

/// What asks for the baseline where the run folder has a model, unless a file is called so.
pub(crate) const BASELINE: &str = "baseline";

/// The model file, else the run folder's, else the five-parameter baseline with values yet to be found.
pub(crate) fn model(
    path: Option<&Path>,
    run: &LoadedRun,
    terminal: &Terminal,
) -> Result<ChosenModel, Failure> {
    let is_asked = path.is_some_and(|path| path == Path::new(BASELINE) && !path.exists());
    let in_folder = run.folder.as_ref().map(|folder| folder.join("model.toml"));
    let in_folder = in_folder.filter(|file| file.exists());
    let path = path.map(Path::to_owned).or(in_folder);
    let Some(path) = path.filter(|_| !is_asked) else {
        let given = if is_asked { "" } else { "no model given: " };
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

/// What a screen or a page calls the data: runs that were set aside are not among them.
pub(crate) struct About {
    /// The fitted run and what is held out, by the last part of their names.
    pub(crate) title: String,
    /// The runs that are used, the one that is fitted first.
    pub(crate) runs: Vec<PathBuf>,
    /// Whether something speaks against the hold-out that is used all the same.
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
    /// Makes the model the one that is judged. What was given is judged as it is; what the folder of a run keeps is not
    /// given, and is refitted as `diagnose` refits it; without either the baseline is fitted. Its origin says which.
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
        // A balance of torques is judged without the inertia that a run does not show.
        if !refitted || is_electrical {
            self.model.file.model.require_complete()?;
        }
        let from = &self.model.from;
        self.model.from = match (is_baseline, refitted) {
            (true, _) => "the five-parameter baseline, fitted to this run".to_owned(),
            (_, true) => format!(
                "{from}, refitted to this run as diagnose does; --model judges a file as it is"
            ),
            (_, false) => format!("{from}, as it is"),
        };
        Ok(Judged {
            refitted,
            error_of: if refitted { ErrorOf::Structure } else { ErrorOf::Model },
        })
    }

    /// A result as JSON, with what is to be known of the data.
    pub(crate) fn result(&self, found: &impl Serialize) -> Value {
        let mut value = serde_json::to_value(found).unwrap_or_default();
        value["rows_dropped"] = self.run.run.rows_dropped.into();
        value["notes"] = self.run.run.notes.clone().into();
        value
    }
}

impl About {
    /// Of the run that is fitted with those behind it, and of those that are held out and confirm.
    fn of(
        run: &Path,
        later: &[&PathBuf],
        holdout: Option<&Path>,
        confirm: Option<&Path>,
        part: &str,
    ) -> Self {
        let name = |path: &Path| {
            let last = path.file_name().unwrap_or_default();
            last.to_string_lossy().into_owned()
        };
        let judged_by = holdout.map_or_else(
            || format!("{part} held out"),
            |holdout| format!("held out {}", name(holdout)),
        );
        let later = later.iter().map(|path| path.as_path());
        let fitted = std::iter::once(run).chain(later.clone());
        let fitted: Vec<String> = fitted.map(name).collect();
        let used = [Some(run), holdout, confirm].into_iter().flatten();
        Self {
            title: format!("{}, {judged_by}", fitted.join(" and ")),
            runs: used.chain(later).map(Path::to_owned).collect(),
            holdout_objected: false,
        }
    }
}

/// Opens what the command names, the fitted run first (`load` is told whether it is another); data that it cannot judge
/// end it.
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
    let confirm = confirm.filter(|confirm| had_no_part(confirm, holdout.as_ref(), notes, terminal));
    let judge = Judge { refuses_others: false, ..judge };
    let judging_runs = [("hold-out", &holdout), ("confirming run", &confirm)];
    let behind = judge.admit_behind(files.later, later, judging_runs, notes);
    let by_voltage = fit_run.input == Input::Voltage;
    if let Some((path, _)) = behind.first().filter(|_| !by_voltage) {
        let headline = format!(
            "--with {}: the run that is fitted is not driven by a voltage, and nothing is put behind it",
            path.display()
        );
        return Err(Failure::usage(headline, "leave --with out"));
    }
    let (later, behind): (Vec<&PathBuf>, Vec<Scenario>) = behind.into_iter().unzip();
    let evidence = Evidence::new(fit_run, holdout, confirm);
    let evidence = behind.into_iter().fold(evidence, Evidence::with_run);
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

/// Names the column that serves as the voltage, where it is not the only one or not the first choice.
pub(crate) fn name_voltage(run: &Run, scenario: &Scenario, terminal: &Terminal) {
    match scenario.input_channel {
        Channel::VoltageCmd => terminal.message("voltage_cmd_v serves as the voltage"),
        Channel::Voltage if run.column(Channel::VoltageCmd).is_some() => {
            terminal.message("voltage_v serves as the voltage, not the voltage_cmd_v beside it");
        }
        _ => {}
    }
}

/// How often the command was not what the motor had.
fn limited_note(run: &Run) -> Option<String> {
    let limited = run.limited_rows().len();
    let instead = if run.points(Channel::Voltage).count() == 0 {
        "what the motor had was not measured: smaller steps would leave the command in force"
    } else {
        "there the measured voltage serves"
    };
    (limited > 0)
        .then(|| format!("a limit of the drive held its output at {limited} samples; {instead}"))
}

/// What a run that was made after others is worth beside them, before it is put behind them: it, and what is to be said of it.
///
/// # Errors
/// Why nothing can be judged by it.
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
            let headline = format!("the run that was made is not judged: {reason}");
            return Err(Failure::usage(headline, "mend that, and make the run again"));
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
    /// Whether one whose motor seems another is set aside. A run that was made to show what is missing may seem so because
    /// of that: a voltage that is off by a volt is much in a run of ten. There it is said.
    refuses_others: bool,
}

impl Judge<'_> {
    /// `other` where it can serve as what `role` says, and whether something speaks against it. Where it cannot, the reason
    /// goes to stderr and to `notes`, and a command that fits goes on without it; one that compares a model as given
    /// compares all the same.
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

    /// Those of the runs of these files that can be fitted behind the first; `judging_runs` judge the fit.
    fn admit_behind<'p>(
        &self,
        files: &'p [PathBuf],
        later: Vec<Option<(LoadedRun, Scenario)>>,
        judging_runs: [(&'static str, &Option<Scenario>); 2],
        notes: &mut Vec<String>,
    ) -> Vec<(&'p PathBuf, Scenario)> {
        let mut behind: Vec<(&PathBuf, Scenario)> = Vec::new();
        for (path, later) in files.iter().zip(later) {
            let Some((loaded, later)) = later else {
                continue;
            };
            let others = judging_runs.into_iter();
            let others = others.filter_map(|(role, run)| Some((role, run.as_ref()?)));
            let earlier = behind.iter().map(|(_, run)| ("later run before it", run));
            let objection = self.objection_to_later(&loaded.run, &later, others.chain(earlier));
            let forbids = objection.as_ref().is_some_and(|(_, forbids)| *forbids);
            if let Some((reason, _)) = objection {
                let instead =
                    if forbids { "; it is not used, the others are judged without it" } else { "" };
                let text = format!("later run {}: {reason}{instead}", path.display());
                note(notes, text, self.terminal);
            }
            if !forbids {
                behind.push((path, later));
            }
        }
        behind
    }

    /// What speaks against a run that is to be fitted behind the first, beside `others`; and whether that forbids it.
    fn objection_to_later<'s>(
        &self,
        run: &Run,
        scenario: &Scenario,
        others: impl Iterator<Item = (&'static str, &'s Scenario)>,
    ) -> Option<(String, bool)> {
        let [own, fitted] = [scenario.input, self.fitted.input].map(driven_by);
        if scenario.input != self.fitted.input {
            let other = format!(
                "it is driven by a {own} and the run that is fitted by a {fitted}, so that the two are no one record"
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
                    "its samples are those of the {role}: what is fitted twice counts twice, and what is fitted judges nothing"
                );
                return Some((same, true));
            }
        }
        self.objection(run, scenario)
    }

    /// What speaks against it, and whether nothing can be judged by it.
    fn objection(&self, run: &Run, scenario: &Scenario) -> Option<(String, bool)> {
        if shared_samples(self.fitted, scenario) > MOST_SHARED {
            let same = "its samples are those of the run that is fitted, so that it tests nothing";
            return Some((same.to_owned(), true));
        }
        let length_s = |run: &Scenario| run.sample_time_s[run.samples() - 1] - run.sample_time_s[0];
        let (own_s, least_s) = (length_s(scenario), SHORTEST_SHARE * length_s(self.fitted));
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
            let help = finding.help.replace("--map ", "--map-holdout ");
            let help =
                if is_of_map && !help.is_empty() { format!("; {help}") } else { String::new() };
            return Some((format!("{}{help}", finding.sentence), true));
        }
        let (model, fitted) = (self.model, self.fitted);
        let here = *self.fingerprint.get_or_init(|| fingerprint(model, fitted));
        let found = matches(here?, fingerprint(model, scenario)?);
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

/// Says that a model is judged by what it was fitted on, as far as its file tells: `holdout`, or the last part of `run`.
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

/// Whether two paths are of one run; a folder that is no longer there is known by its name.
fn is_same(recorded: &Path, path: &Path) -> bool {
    let folder = |path: &Path| {
        let is_samples = path.file_name().is_some_and(|name| name == "samples.csv");
        let parent = path.parent().filter(|_| is_samples);
        parent.unwrap_or(path).to_owned()
    };
    match (recorded.canonicalize(), path.canonicalize()) {
        (Ok(recorded), Ok(path)) => folder(&recorded) == folder(&path),
        _ => folder(recorded).file_name() == folder(path).file_name(),
    }
}

/// Whether a confirming run is another than the hold-out, which selected; else the reason goes to stderr and to `notes`.
fn had_no_part(
    confirm: &Scenario,
    holdout: Option<&Scenario>,
    notes: &mut Vec<String>,
    terminal: &Terminal,
) -> bool {
    let shared = holdout.map_or(0.0, |holdout| shared_samples(holdout, confirm));
    if shared > MOST_SHARED {
        let sentence = "confirming run: its samples are those of the hold-out, which selected; it is not used, nothing is confirmed";
        note(notes, sentence.to_owned(), terminal);
    }
    shared <= MOST_SHARED
}

/// What a run does not say by itself: rows without a voltage, signals without values, times without rows.
pub(crate) fn cautions(run: &Run, scenario: &Scenario) -> Vec<String> {
    let (mut cautions, name) = (Vec::new(), &run.name);
    let channel = scenario.input_channel;
    cautions.extend(lost_rows::sentence(run, scenario));
    let whole = scenario.unknown_input.is_empty();
    if let (true, Channel::Voltage, Some(cells)) = (whole, channel, run.column(channel)) {
        let begin_s = scenario.begin_s();
        let rows = run.time_s().iter().zip(cells);
        let rows = rows.filter(|(time_s, _)| **time_s >= begin_s);
        let missing = rows.clone().filter(|(_, cell)| !cell.is_finite()).count();
        if missing > 0 {
            let (key, rows) = (channel.key(), rows.count());
            cautions.push(format!(
                "{name}: {key} is empty in {missing} of {rows} rows: the value before is taken as held there"
            ));
        }
    }
    for (channel, cells) in
        [(Channel::Current, &scenario.current_a), (Channel::Speed, &scenario.speed_rad_s)]
    {
        let missing = cells.iter().filter(|cell| !cell.is_finite()).count();
        if run.column(channel).is_none() || missing * MANY_MISSING < cells.len() {
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
    let pairs = times.windows(2);
    let longest = pairs.max_by(|a, b| (a[1] - a[0]).total_cmp(&(b[1] - b[0])));
    if let Some([from_s, to_s]) = longest
        && whole
        && to_s - from_s > LONG_GAP * period_s
        && to_s - from_s > LONG_GAP_S
    {
        cautions.push(format!(
            "{name}: no rows between {from_s:.3} s and {to_s:.3} s: the voltage is taken as held through it, and what the motor \
             really did there is taken for an error of the model; cut the file there"
        ));
    }
    cautions
}

/// Origin and side of each signal that the run has, for JSON.
pub(crate) fn signals(run: &Run) -> Value {
    let there = |channel: &Channel| run.column(*channel).is_some();
    let entries = Channel::ALL.into_iter().filter(there).map(|channel| {
        let origin = run.origin(channel).name();
        let side = run.side(channel).map(Side::name);
        (channel.key().to_owned(), json!({ "origin": origin, "side": side }))
    });
    Value::Object(entries.collect::<Map<_, _>>())
}

/// Looks at the data before `identify` does. What forbids an answer ends the command, with a result in which every
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
        let value = serde_json::to_value(unanswered(slot, model, refusal));
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
        "findings": findings,
        "notes": notes(run, &findings),
    });
    if json {
        terminal.result(&value, true, |_| String::new())?;
    }
    let others = findings.iter().filter(|finding| *finding != refusal);
    terminal.warn(&others.map(|other| other.sentence.clone()).collect::<Vec<_>>());
    let what = match require {
        [] => "nothing".to_owned(),
        keys => keys.join(", "),
    };
    Err(cannot_identify(&what, refusal))
}

/// Looks at the data before a command that judges a model; what cannot be judged ends it, the rest is cautions.
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
    let headline = format!("{what} {can} be identified: {}", refusal.sentence);
    Failure::not_identifiable(headline, &refusal.help)
}

fn notes(run: &Run, findings: &[Finding]) -> Vec<String> {
    let found = findings.iter().map(|finding| finding.sentence.clone());
    run.notes.iter().cloned().chain(found).collect()
}

fn caution(run: &mut Run, findings: &[Finding], terminal: &Terminal) {
    for finding in findings {
        let help =
            if finding.help.is_empty() { String::new() } else { format!("; {}", finding.help) };
        terminal.warn(&[format!("{}{help}", finding.sentence)]);
    }
    run.notes = notes(run, findings);
}

/// No value, with the reason; what the user fixed stays as given.
fn unanswered(slot: &Slot, model: &Model, refusal: &Finding) -> ParameterEstimate {
    let key = slot.key();
    match model.get(slot) {
        Some(value) if model.fixed.contains(&key) => ParameterEstimate {
            key,
            value: Some(value),
            std: Some(0.0),
            unit: slot.unit(),
            verdict: Verdict::Fixed,
            reason: None,
        },
        _ => ParameterEstimate::not_observable(&key, slot.unit(), refusal.sentence.clone()),
    }
}

/// The bench that a recommendation is for, with what it may reach.
pub(crate) struct Place {
    bench: Option<BenchFile>,
    limits: ExperimentLimits,
    rate_hz: f64,
}

impl Place {
    /// Where the next run would be made: on `bench`, else on that of the run folder, else on nothing beyond what the runs
    /// have reached. To be asked before the evidence is used up.
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
            " --port PORT (the runs do not say on which drive they were made)"
        };
        let file = output::quoted(path);
        terminal
            .message(&format!("{path_text} is written: drivebench run {file}{port}, then {then}"));
        Ok(())
    }

    /// What the next run may reach.
    pub(crate) const fn limits(&self) -> ExperimentLimits {
        self.limits
    }

    /// Puts the recommended run into the diagnosis.
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

/// The bench of the run folder, as its manifest keeps it. A bench of another program's version is as good as none.
fn recorded_bench(prepared: &Prepared, terminal: &Terminal) -> Option<BenchFile> {
    let manifest = prepared.run.manifest.as_ref()?;
    let text = manifest.configs.get("bench")?;
    match BenchFile::parse("manifest.json: configs.bench", text) {
        Ok(bench) => Some(bench),
        Err(error) => {
            terminal.message(&format!("warning: the run's bench is not used: {error}"));
            None
        }
    }
}

/// The current limit that the drive of the run said it has.
fn drive_limit_a(prepared: &Prepared) -> Option<f64> {
    let manifest = prepared.run.manifest.as_ref()?;
    manifest.identity.get("current_limit_a")?.as_f64()
}

/// Rows per second, as a bench file may ask for.
fn rate_hz(run: &Scenario) -> f64 {
    let pairs = run.sample_time_s.windows(2);
    let periods: Vec<f64> = pairs.map(|pair| pair[1] - pair[0]).collect();
    (1.0 / median(&periods)).round()
}

#[cfg(test)]
#[path = "evidence_tests.rs"]
mod tests;
