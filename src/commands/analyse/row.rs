//! One run as one row of the table: its record, its parameters with interval and verdict, the residual of its model and, on
//! request, the effects that a diagnosis names.

use std::fs::File;
use std::io::Read as _;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

use serde_json::Value;

use super::Analysis;
use crate::commands::evidence::{BASELINE, EvidenceFiles, Judging, prepare};
use crate::commands::identify::{OneRun, identify, is_found, period_s};
use crate::runtime::{Failure, INTERNAL, Terminal};
use drivebench_bench::recording::{
    ColumnKind, LoadedRun, Machine, Manifest, RunFile, RunFolder, number_text,
};
use drivebench_diagnose::{Diagnosis, Score, diagnose};
use drivebench_identify::noise::NoiseFloor;
use drivebench_identify::temperature;
use drivebench_model::numerics::checksum::{EMPTY, fnv_1a};
use drivebench_model::plant::{Input, Model, MotorKey, Slot};
use drivebench_model::sample::ParameterEstimate;

/// A text in one line, as a row is; null where it is empty.
fn one_line(text: impl Into<String>) -> Value {
    let text: String = text.into();
    let text = text.replace(['\n', '\r'], " ");
    if text.is_empty() { Value::Null } else { text.into() }
}

/// A value of a row as a cell of a CSV.
pub(super) fn cell(value: &Value) -> String {
    match value {
        Value::Null => String::new(),
        Value::String(text) => text.clone(),
        number if number.is_f64() => number.as_f64().map(number_text).unwrap_or_default(),
        other => other.to_string(),
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Status {
    Ok,
    /// It was read; nothing can be identified from it.
    NotIdentified,
    /// It could not be read, or not as a run.
    Unread,
}

impl Status {
    const fn name(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::NotIdentified => "not_identified",
            Self::Unread => "unread",
        }
    }

    pub(super) fn named(name: &str) -> Option<Self> {
        [Self::Ok, Self::NotIdentified, Self::Unread]
            .into_iter()
            .find(|status| status.name() == name)
    }
}

/// The columns of the parameters: all of a motor, the resistance at 20 °C, and those of the effects of the model that all
/// runs are identified with. They depend on no run, so that tables of any runs can be joined.
#[derive(Clone, Debug)]
pub(super) struct Columns {
    model: Model,
    keys: Vec<String>,
}

impl Columns {
    pub(super) fn of(model: Model) -> Self {
        let motor = MotorKey::ALL.map(|key| key.key().to_owned());
        let slots = model.slots();
        let effects = slots.iter().filter(|slot| matches!(slot, Slot::Effect { .. }));
        let resistance = [temperature::KEY.to_owned()];
        let keys = motor.into_iter().chain(resistance).chain(effects.map(Slot::key)).collect();
        Self { model, keys }
    }

    pub(super) fn all(&self) -> Vec<(String, ColumnKind)> {
        let nothing = Found::default();
        let columns = self.of_run(("", "", ""), (Status::Unread, ""), &nothing, Vec::new());
        columns.into_iter().map(|(name, kind, _)| (name, kind)).collect()
    }

    /// The columns of one run with name, kind and cell: run and status first, program, analysis and content last.
    fn of_run(
        &self,
        (run, analysis, content): (&str, &str, &str),
        (status, reason): (Status, &str),
        found: &Found,
        messages: Vec<String>,
    ) -> Vec<(String, ColumnKind, Value)> {
        let (about, one) = (found.about.as_ref(), found.one.as_ref());
        let answer = found.answer.as_ref();
        let text = |name: &str, text: &str| (name.to_owned(), ColumnKind::Word, one_line(text));
        let quantity = |name: &str, value: Option<f64>| {
            (name.to_owned(), ColumnKind::Quantity, Value::from(value))
        };
        let count = |name: &str, value: Option<u64>| {
            (name.to_owned(), ColumnKind::Count, Value::from(value))
        };
        let fact = |of: fn(&About) -> &str| about.map_or("", of);
        let rows = |of: fn(&About) -> usize| about.map(|about| of(about) as u64);
        let statistic = |key: &str| about?.manifest.link_statistics.get(key)?.as_u64();
        let began = about.and_then(|about| about.manifest.began()).unwrap_or_default();
        let lost = statistic("sent").zip(statistic("ok")).map(|(sent, ok)| sent.saturating_sub(ok));
        let mut columns = vec![
            text("run", run),
            text("status", status.name()),
            text("reason", reason),
            text("name", fact(|about| &about.manifest.name)),
            ("begin".to_owned(), ColumnKind::Instant, one_line(began)),
            text("drive", fact(|about| &about.machine.drive)),
            text("drive_serial", fact(|about| &about.machine.drive_serial)),
            text("motor", fact(|about| &about.machine.motor)),
            text("link", fact(|about| &about.manifest.link)),
            text("outcome", fact(|about| about.manifest.outcome.as_deref().unwrap_or_default())),
            text("recorded_by", fact(|about| &about.manifest.program_version)),
            count("rows", rows(|about| about.rows)),
            count("rows_used", one.map(|one| one.rows_used as u64)),
            count("rows_dropped", rows(|about| about.rows_dropped)),
            count("rows_limited", rows(|about| about.rows_limited)),
            count("exchanges", statistic("sent")),
            count("exchanges_lost", lost),
            count("missed_cycles", about.and_then(|about| about.manifest.missed_cycles)),
            quantity("duration_s", about.and_then(|about| about.duration_s)),
            quantity("period_s", about.and_then(|about| about.period_s)),
            text("input", one.map_or("", |one| one.input)),
            text("scheme", one.map_or("", |one| one.scheme)),
        ];
        for key in &self.keys {
            let name = key.replace('.', "_");
            let parameter = one.and_then(|one| ParameterEstimate::find(&one.parameters, key));
            let interval = parameter.and_then(ParameterEstimate::interval_95);
            let verdict = parameter.map(|p| p.verdict.name().replace(' ', "_"));
            columns.extend([
                quantity(&name, parameter.and_then(|p| p.value)),
                quantity(&format!("{name}_std"), parameter.and_then(|p| p.std)),
                quantity(&format!("{name}_low"), interval.map(|interval| interval[0])),
                quantity(&format!("{name}_high"), interval.map(|interval| interval[1])),
                text(&format!("{name}_verdict"), verdict.as_deref().unwrap_or_default()),
            ]);
        }
        let mut notes: Vec<String> = Vec::new();
        let of_run = about.into_iter().flat_map(|about| &about.notes);
        let known = of_run.chain(one.into_iter().flat_map(|one| &one.notes)).cloned();
        for note in known.chain(messages) {
            if !notes.contains(&note) {
                notes.push(note);
            }
        }
        let residual = one.and_then(|one| one.residual);
        let verdict = answer.and_then(|answer| serde_json::to_value(answer.verdict).ok());
        let named = || answer.into_iter().flat_map(|answer| answer.effects.iter().copied());
        let probability = |id: &str| {
            let mut candidates = answer.into_iter().flat_map(|answer| &answer.candidates);
            let candidate = candidates.find(|candidate| candidate.effect == id);
            format!("{:.4}", candidate.map_or(f64::NAN, |candidate| candidate.probability))
        };
        let effects = named().collect::<Vec<_>>().join(";");
        let probabilities = named().map(probability).collect::<Vec<_>>().join(";");
        columns.extend([
            quantity("residual", residual.map(|(size, _)| size)),
            text("residual_in", residual.map_or("", |(_, unit)| unit)),
            text("verdict", verdict.as_ref().and_then(Value::as_str).unwrap_or_default()),
            text("effects", &effects),
            text("effect_probabilities", &probabilities),
            quantity("held_out_error", answer.map(|answer| answer.holdout_after)),
            quantity("explained_percent", answer.map(|answer| answer.explained_percent)),
            text("notes", &notes.join(" | ")),
            text("program", env!("CARGO_PKG_VERSION")),
            text("analysis", analysis),
            text("content", content),
        ]);
        columns
    }
}

/// The checksum of what a run holds: its samples and its manifest.
pub(super) fn content(run: &Path) -> String {
    let folder = RunFolder::existing(run);
    let files = if run.is_dir() {
        vec![folder.samples(), folder.file(RunFile::Manifest)]
    } else {
        vec![run.to_owned()]
    };
    let mut hash = EMPTY;
    let mut buffer = vec![0; 1 << 16];
    for path in files {
        let Ok(mut file) = File::open(path) else {
            continue;
        };
        while let Ok(count @ 1..) = file.read(&mut buffer) {
            hash = fnv_1a(hash, buffer[..count].iter().copied());
        }
        // Separates the files.
        hash = fnv_1a(hash, [0]);
    }
    format!("{hash:016x}")
}

/// The run as the column `run` names it.
pub(super) fn name(run: &Path) -> String {
    cell(&one_line(run.display().to_string()))
}

/// The results of a run, as far as its analysis came.
#[derive(Default)]
struct Found {
    about: Option<About>,
    one: Option<Identified>,
    answer: Option<Diagnosis>,
}

#[derive(Default)]
struct About {
    manifest: Manifest,
    machine: Machine,
    rows: usize,
    rows_dropped: usize,
    rows_limited: usize,
    duration_s: Option<f64>,
    period_s: Option<f64>,
    notes: Vec<String>,
}

struct Identified {
    rows_used: usize,
    input: &'static str,
    scheme: &'static str,
    parameters: Vec<ParameterEstimate>,
    residual: Option<(f64, &'static str)>,
    notes: Vec<String>,
}

/// Analyses one run; every failure of it stands in its row.
pub(super) fn row(run: &Path, content: &str, request: &Analysis<'_>) -> (Vec<Value>, Status) {
    let mut found = Found::default();
    let terminal = Terminal::collecting();
    let ended = catch_unwind(AssertUnwindSafe(|| analyse(run, request, &mut found, &terminal)))
        .unwrap_or_else(|_| {
            Err(Failure::new(INTERNAL, "a fault of the program, which this run brings about"))
        });
    let (status, reason) = judged(ended, &found);
    let known = (&*name(run), &*request.checksum, content);
    let columns = request.columns.of_run(known, (status, &reason), &found, terminal.collected());
    (columns.into_iter().map(|(_, _, value)| value).collect(), status)
}

/// How far it came, and why no further. A run that was read keeps that status whatever fails behind it.
fn judged(ended: Result<(), Failure>, found: &Found) -> (Status, String) {
    let reason = ended.err().map(|failure| match (failure.headline(), &found.one) {
        (headline, Some(_)) => format!("no diagnosis: {headline}"),
        (headline, None) => headline.to_owned(),
    });
    let parameters = || found.one.iter().flat_map(|one| &one.parameters);
    if found.about.is_none() {
        (Status::Unread, reason.unwrap_or_default())
    } else if parameters().any(is_found) {
        (Status::Ok, reason.unwrap_or_default())
    } else {
        let own = || parameters().find_map(|parameter| parameter.reason.clone());
        (Status::NotIdentified, reason.or_else(own).unwrap_or_default())
    }
}

fn analyse(
    run: &Path,
    request: &Analysis<'_>,
    found: &mut Found,
    terminal: &Terminal,
) -> Result<(), Failure> {
    let arguments = request.arguments;
    let load = |path: &Path| arguments.map.load(path, terminal);
    let loaded = load(run)?;
    found.about = Some(About::of(&loaded));
    let scheme = arguments.scheme.as_deref();
    let one = identify(loaded, &request.columns.model, scheme, &[], false, terminal)?;
    found.one = Some(Identified::of(&one));
    drop(one);
    if arguments.diagnose {
        let model = arguments.model.as_deref().unwrap_or(Path::new(BASELINE));
        let files = EvidenceFiles { model: Some(model), ..EvidenceFiles::of(run, terminal) };
        let prepared = prepare(files, |path, _| load(path), Judging::Refits)?;
        found.answer = Some(diagnose(&prepared.model.file.model, prepared.evidence)?);
    }
    Ok(())
}

impl About {
    fn of(loaded: &LoadedRun) -> Self {
        let run = &loaded.run;
        let manifest = loaded.manifest.clone().unwrap_or_default();
        let (times, rows) = (run.time_s(), run.rows());
        Self {
            machine: manifest.machine(),
            rows,
            rows_dropped: run.rows_dropped,
            rows_limited: run.limited_rows().len(),
            duration_s: times.first().zip(times.last()).map(|(begin, end)| end - begin),
            period_s: period_s(run),
            notes: loaded.warnings.clone(),
            manifest,
        }
    }
}

impl Identified {
    fn of(one: &OneRun) -> Self {
        Self {
            rows_used: one.scenario.samples(),
            input: one.scenario.input_channel.key(),
            scheme: one.found.scheme,
            parameters: one.found.parameters.clone(),
            residual: residual(one),
            notes: one.loaded.run.notes.iter().chain(&one.found.notes).cloned().collect(),
        }
    }
}

/// Error of the free run of the identified model, in multiples of the noise at rest; where the run shows no rest, of the
/// signals' own spread.
fn residual(one: &OneRun) -> Option<(f64, &'static str)> {
    let scenario = &one.scenario;
    if scenario.input != Input::Voltage {
        return None;
    }
    one.found.model.require_complete().ok()?;
    let at_rest = NoiseFloor::from_standstill(scenario);
    let unit = if at_rest.is_some() { "noise_at_rest" } else { "share_of_spread" };
    let noise = at_rest.unwrap_or_else(|| NoiseFloor::from_spread(scenario));
    let score = Score::of(&one.found.model, scenario, &noise).ok()?;
    Some((score.nrms, unit))
}

#[cfg(test)]
mod tests {
    use super::*;
    use drivebench_model::sample::Reason;

    #[test]
    fn a_cell_is_one_line_and_a_finite_number() {
        assert_eq!(cell(&one_line("a\nb")), "a b");
        assert_eq!((cell(&one_line("")), one_line("")), (String::new(), Value::Null));
        assert_eq!(Value::from(Some(f64::NAN)), Value::Null);
        assert_eq!((cell(&0.1.into()), cell(&7.into())), ("0.1".to_owned(), "7".to_owned()));
    }

    #[test]
    fn a_failed_diagnosis_leaves_the_status_of_the_run() {
        let refused = || Err(Failure::usage("the hold-out is short", ""));
        let mut found = Found::default();
        assert_eq!(judged(refused(), &found), (Status::Unread, "the hold-out is short".to_owned()));
        found.about = Some(About::default());
        let (status, _) = judged(refused(), &found);
        assert_eq!(status, Status::NotIdentified);
        let of = |parameter| Identified {
            rows_used: 1,
            input: "",
            scheme: "",
            parameters: vec![parameter],
            residual: None,
            notes: Vec::new(),
        };
        let reason = "no diagnosis: the hold-out is short".to_owned();
        let nothing = ParameterEstimate::not_observable(
            "inductance_h",
            "H",
            Reason::SampledTooSlowly,
            "sample faster",
        );
        found.one = Some(of(nothing));
        assert_eq!(judged(Ok(()), &found), (Status::NotIdentified, "sample faster".to_owned()));
        assert_eq!(judged(refused(), &found), (Status::NotIdentified, reason.clone()));
        let inertia = ParameterEstimate::found("inertia_kg_m2", "kg.m2", 0.004, 1e-5, None);
        found.one = Some(of(inertia));
        assert_eq!(judged(Ok(()), &found), (Status::Ok, String::new()));
        assert_eq!(judged(refused(), &found), (Status::Ok, reason));
    }
}
