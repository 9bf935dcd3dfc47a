//! The documents of a run, a commissioning, a diagnosis and a comparison, from their records.

use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::commands::evidence::{About, Prepared};
use crate::report::{
    CommissionReport, ComparisonReport, ConfirmRun, Context, Document, Facts, LastSeconds,
    RunReport, Target,
};
use crate::runtime::{Failure, Recorded, Rig, Terminal, early_end};
use crate::tui::StoppedAt;
use crate::workflow::{CommissionResult, Truth};
use drivebench_bench::recording::{LoadedRun, Manifest, RunFile};
use drivebench_bench::{self as bench, BenchFile, Plan, Stop, TripKind};
use drivebench_diagnose::{Comparison, Diagnosis, EffectCurve, ErrorOf, compare, error_curve};
use drivebench_identify::noise::NoiseFloor;
use drivebench_model::plant::{Input, Model, Motor, Scenario};
use drivebench_model::sample::Channel;

pub(crate) fn write_run(
    recorded: &mut Recorded,
    plan: Option<&Plan>,
    nameplate: &Motor,
    speed_loop: Option<&Document>,
    terminal: &Terminal,
) {
    match run(recorded, plan, nameplate, speed_loop) {
        Ok(page) => drop(recorded.write(RunFile::Report, &page)),
        Err(failure) => terminal.message(&format!("no report: {}", failure.headline())),
    }
}

fn run(
    recorded: &Recorded,
    plan: Option<&Plan>,
    nameplate: &Motor,
    speed_loop: Option<&Document>,
) -> Result<String, Failure> {
    let loaded = recorded.load()?;
    let manifest = &recorded.manifest;
    let mut context = context(manifest, &[recorded.folder.path()]);
    context.plan = plan.map(plan_facts).unwrap_or_default();
    let model = Model::baseline(nameplate.clone());
    let summary = &recorded.summary;
    let ended = early_end(&summary.outcome, summary.stop_error.as_deref());
    let report = RunReport {
        title: &manifest.name,
        context: &context,
        run: &loaded.run,
        nameplate: Some(&model),
        parameters: &recorded.summary.estimates,
        timing: &timing(manifest),
        early_end: ended.map(|(.., page)| page),
        last_seconds: last_seconds(manifest),
        speed_loop,
    };
    Ok(report.document().html())
}

/// The last seconds of a run that tripped or lost its drive, with the limits of its bench file.
pub(crate) fn last_seconds(manifest: &Manifest) -> Option<LastSeconds> {
    let slice: bench::LastSeconds = serde_json::from_value(manifest.trip.clone()).ok()?;
    let text = manifest.configs.get("bench");
    let bench = text.and_then(|text| BenchFile::parse("bench", text).ok());
    let limits = bench.map(|bench| bench.limits());
    let limits = limits.into_iter().flat_map(|limits| {
        [
            (Channel::Current, Some(limits.current_a)),
            (Channel::Speed, Some(limits.speed_rad_s)),
            (Channel::Voltage, Some(limits.voltage_v)),
            (Channel::Bus, limits.bus_max_v),
        ]
    });
    Some(LastSeconds {
        time_s: slice.time_s,
        rows: slice.from_row.saturating_sub(1)..slice.to_row,
        limits: limits.filter_map(|(channel, limit)| Some((channel, limit?))).collect(),
        stop: stop(manifest).map(|stop| stop.sentence()),
    })
}

/// Free runs of the model before and, where effects were found, after the diagnosis over `run`, where that has a voltage; and
/// the curve of each effect, or where none was found that of the error.
fn shown_on(
    found: &Diagnosis,
    run: Option<&Scenario>,
    noise: &NoiseFloor,
) -> Result<(Option<ConfirmRun>, Vec<EffectCurve>), Failure> {
    let Some(run) = run else {
        return Ok((None, Vec::new()));
    };
    let (before, after) = (&found.baseline.model, &found.model.model);
    let after = Some(after).filter(|_| !found.effects.is_empty());
    let series = ConfirmRun::of(before, after, run, noise)?;
    let effects = found.effects.iter().copied().map(Some);
    let mut curves = Vec::new();
    for effect in effects.chain(found.effects.is_empty().then_some(None)) {
        curves.extend(found.curve_of(effect, run, noise)?);
    }
    Ok((Some(series), curves))
}

/// The report of a commissioning, with measured and simulated signals of the confirming run.
pub(crate) fn commission(
    scenarios: &[Scenario],
    result: &CommissionResult,
    rig: &Rig,
    records: &[Recorded],
) -> Result<Document, Failure> {
    let runs = result.runs.iter();
    let folders = runs.filter_map(|run| run.folder.as_deref().map(Path::new));
    let manifest = records.first().map(|first| first.manifest.clone());
    let mut context = context(&manifest.unwrap_or_default(), &folders.collect::<Vec<_>>());
    context.plan = plan_facts(&rig.plan(rig.bench.runs.fit)?);
    if let Some(burst) = &result.burst {
        context.plan.push(fact("burst capture", burst.text()));
    }
    let diagnosis = &result.diagnosis;
    let nameplate = Model::baseline(rig.nameplate_motor.clone());
    let (series, curves) = shown_on(diagnosis, scenarios.get(2), &diagnosis.model.noise)?;
    let truth: Vec<String> = result.truth.iter().map(Truth::sentence).collect();
    let report = CommissionReport {
        kind: "Commission",
        title: &rig.bench.name,
        context: &context,
        nameplate: Some(&nameplate),
        before: &result.before,
        after: &result.after,
        diagnosis,
        confirm: Some(&result.confirmed),
        series: series.as_ref(),
        curves: &curves,
        truth: &truth,
    };
    Ok(report.document())
}

/// The report of a diagnosis of recorded runs, with its curves where it `is_whole`: a card has none.
pub(crate) fn diagnosis(
    prepared: &Prepared,
    found: &Diagnosis,
    is_whole: bool,
) -> Result<Document, Failure> {
    let context = of_data(&prepared.about, &prepared.run);
    let mut evidence = prepared.evidence.clone().moved_as(&found.limits);
    let is_electrical = evidence.training.input == Input::Voltage;
    if is_electrical {
        // Without a floor of its own the first fit gave the scale.
        evidence.noise = found.baseline.noise;
    }
    let [before, after] = [
        compare(&found.baseline.model, &evidence, ErrorOf::Structure)?,
        compare(&found.model.model, &evidence, ErrorOf::Structure)?,
    ];
    let shown = evidence.confirm.as_ref().unwrap_or(&evidence.holdout);
    let shown = Some(shown).filter(|_| is_electrical && is_whole);
    let (series, curves) = shown_on(found, shown, &evidence.noise)?;
    let confirm = evidence.confirm.as_ref().filter(|_| is_electrical);
    let confirm = confirm.map(|run| found.rungs_on(run, &evidence.noise)).transpose()?;
    let report = CommissionReport {
        kind: "Diagnosis",
        title: &prepared.about.title,
        context: &context,
        nameplate: None,
        before: &before,
        after: &after,
        diagnosis: found,
        confirm: confirm.as_ref(),
        series: series.as_ref(),
        curves: &curves,
        truth: &[],
    };
    Ok(report.document())
}

/// The report of a comparison of recorded runs, with its curves where it `is_whole`.
pub(crate) fn comparison(
    prepared: &Prepared,
    comparison: &Comparison,
    is_whole: bool,
) -> Result<Document, Failure> {
    let about = &prepared.about;
    let evidence = &prepared.evidence;
    let (run, noise) = (&evidence.holdout, evidence.noise);
    let model = &prepared.model.file.model;
    let has_curves = is_whole && evidence.training.input == Input::Voltage;
    let series = has_curves.then(|| ConfirmRun::of(model, None, run, &noise));
    let curve = has_curves.then(|| error_curve(model, run, &noise));
    let (series, curve) = (series.transpose()?, curve.transpose()?.flatten());
    let report = ComparisonReport {
        title: &about.title,
        context: &of_data(about, &prepared.run),
        comparison,
        model: &prepared.model.from,
        holdout_objected: about.holdout_objected,
        series: series.as_ref(),
        curve: curve.as_ref(),
    };
    Ok(report.document())
}

/// Writes the page of a document where one was requested, and names it at the end of the document.
pub(crate) fn write(
    document: &mut Document,
    path: Option<&Path>,
    terminal: &Terminal,
) -> Result<(), Failure> {
    if let Some(path) = path {
        terminal.file(path, &document.html())?;
        terminal.message(&format!("page written to {}", path.display()));
        document.ends_with(path.display().to_string());
    }
    Ok(())
}

/// The runs that were used, with what is to be known of them.
fn of_data(about: &About, run: &LoadedRun) -> Context {
    let folders: Vec<&Path> = about.runs.iter().map(PathBuf::as_path).collect();
    let manifest = run.manifest.clone().unwrap_or_default();
    Context {
        notes: run.run.notes.clone(),
        rows_dropped: run.run.rows_dropped,
        ..context(&manifest, &folders)
    }
}

/// Entries of a JSON object that are a single value, as labels and values.
pub(crate) fn table(value: &Value) -> Facts {
    let text = |value: &Value| value.as_str().map_or_else(|| value.to_string(), str::to_owned);
    let entries = value.as_object().into_iter().flatten();
    entries
        .filter(|(_, value)| !value.is_null() && !value.is_array())
        .map(|(key, value)| fact(&key.replace('_', " "), text(value)))
        .collect()
}

/// How the run was stopped, where its output was on.
pub(crate) fn stop(manifest: &Manifest) -> Option<Stop> {
    serde_json::from_value(manifest.stop.clone()).ok()
}

/// Where a run that tripped or lost its drive was stopped, for a screen that shows it.
pub(crate) fn stopped_at(prepared: &Prepared) -> Option<StoppedAt> {
    let manifest = prepared.run.manifest.as_ref()?;
    let last: bench::LastSeconds = serde_json::from_value(manifest.trip.clone()).ok()?;
    let at_s = last.time_s - prepared.evidence.training.begin_s();
    let stop = Stop { at_s: Some(at_s), ..stop(manifest)? };
    let shows = stop.trip.and_then(|kind| match kind {
        TripKind::OverCurrent
        | TripKind::CurrentStuck
        | TripKind::CurrentReversed
        | TripKind::CurrentImplausible
        | TripKind::OpenCircuit => Some(Channel::Current),
        TripKind::BusLow | TripKind::BusHigh => Some(Channel::Bus),
        _ => None,
    });
    Some(StoppedAt { run: prepared.run.run.name.clone(), at_s, shows, text: stop.short() })
}

/// Rate and lateness of a run, and how it was stopped.
pub(crate) fn timing(manifest: &Manifest) -> Facts {
    let hz = |period_s: f64| 1.0 / period_s;
    let achieved = manifest.period_achieved_s.map(hz);
    let rate = achieved.zip(manifest.period_asked_s.map(hz));
    let late = manifest.lateness_p50_s.zip(manifest.lateness_p99_s);
    let facts = [
        rate.map(|(achieved, wanted)| fact("rate", format!("{achieved:.1} of {wanted:.0} Hz"))),
        (manifest.missed_cycles).map(|missed| fact("missed cycles", missed.to_string())),
        late.map(|(p50_s, p99_s)| {
            let lateness = format!("{:.2} ms, {:.2} ms", 1e3 * p50_s, 1e3 * p99_s);
            fact("lateness, median and 99 %", lateness)
        }),
        stop(manifest).map(|stop| fact("stop", stop.sentence())),
    ];
    facts.into_iter().flatten().collect()
}

pub(crate) fn context(manifest: &Manifest, folders: &[impl AsRef<Path>]) -> Context {
    let mut link = vec![fact("link", manifest.link.clone())];
    link.extend(table(&manifest.link_statistics));
    link.extend(table(&manifest.wire));
    let folders = folders.iter().map(|folder| folder.as_ref().display().to_string());
    Context {
        target: match manifest.identity["is_emulator"].as_bool() {
            Some(true) => Target::Emulator,
            Some(false) => Target::Hardware,
            None => Target::Unknown,
        },
        // Another stamp as it is.
        date: manifest.began().map_or_else(
            || manifest.stamp.clone(),
            |began| began.replace('T', " ").replace('Z', " UTC"),
        ),
        motor: manifest.machine().motor,
        run_folders: folders.collect(),
        identity: table(&manifest.identity),
        plan: Facts::new(),
        link,
        seed: manifest.seed,
        versions: vec![fact("drivebench", manifest.program_version.clone())],
        ..Context::default()
    }
}

fn plan_facts(plan: &Plan) -> Facts {
    let (peak_a, times) = (plan.peak_current_a, plan.peak_current_ratio);
    vec![
        fact("duration", format!("{:.1} s", plan.duration_s)),
        fact("predicted peak current", format!("{peak_a:.1} A ({times:.1} times rated)")),
        fact("predicted peak speed", format!("{:.0} rad/s", plan.peak_speed_rad_s)),
        fact("predicted copper loss", format!("{:.0} J", plan.copper_loss_j)),
    ]
}

fn fact(label: &str, value: String) -> (String, String) {
    (label.to_owned(), value)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;
    use std::sync::atomic::{AtomicUsize, Ordering};

    #[test]
    fn a_picture_is_drawn_once_and_by_html_alone() {
        let drawn = Arc::new(AtomicUsize::new(0));
        let count = Arc::clone(&drawn);
        let mut document = Document::new("title", "subtitle");
        document.figure(
            move || {
                count.fetch_add(1, Ordering::Relaxed);
                "<svg></svg>".to_owned()
            },
            "a caption",
        );
        let _ = (document.card(100), document.full(100), document.markdown());
        assert_eq!(drawn.load(Ordering::Relaxed), 0);
        assert!(
            document.clone().html().contains("<svg></svg>")
                && document.html().contains("a caption")
        );
        assert_eq!(drawn.load(Ordering::Relaxed), 1);
    }
}
