//! Fills in the report pages from what a run or a commissioning left.

use std::path::Path;

use super::failure::Failure;
use super::recorded::Recorded;
use super::rig::Rig;
use crate::bench::{Outcome, Plan};
use crate::identification::output_error;
use crate::plant::{Model, Motor, Scenario};
use crate::recording::Manifest;
use crate::report::{CommissionReport, ConfirmRun, Context, Facts, RunReport, SpeedLoop, Target};
use crate::workflow::CommissionResult;

/// A report in both of its forms.
pub(crate) struct Report {
    pub(crate) html: String,
    pub(crate) text: String,
}

/// The page of one run, from its folder.
pub(crate) fn run(
    recorded: &Recorded,
    plan: Option<&Plan>,
    nameplate: &Motor,
    speed_loop: Option<&SpeedLoop>,
) -> Result<String, Failure> {
    let loaded = recorded.load()?;
    let manifest = &recorded.manifest;
    let mut context = context(manifest, &[recorded.folder.path()]);
    context.plan = plan.map(plan_facts).unwrap_or_default();
    let trip = match &recorded.summary.outcome {
        Outcome::Tripped(trip) => Some(trip.reason.as_str()),
        _ => None,
    };
    let timing = &recorded.summary.timing;
    let facts = vec![
        fact(
            "rate",
            format!(
                "{:.1} of {:.0} Hz",
                timing.rate_achieved_hz, timing.rate_asked_hz
            ),
        ),
        fact("missed cycles", timing.missed_cycles.to_string()),
        fact(
            "lateness, median and 99 %",
            format!(
                "{:.2} ms, {:.2} ms",
                1e3 * timing.lateness_p50_s,
                1e3 * timing.lateness_p99_s
            ),
        ),
    ];
    let model = Model::baseline(nameplate.clone());
    let report = RunReport {
        title: &manifest.name,
        context: &context,
        run: &loaded.run,
        nameplate: Some(&model),
        parameters: &recorded.summary.estimates,
        timing: &facts,
        trip,
        speed_loop,
    };
    Ok(report.html())
}

/// The page of a commissioning, with measured and simulated signals of the confirming run.
pub(crate) fn commission(
    scenarios: &[Scenario],
    result: &CommissionResult,
    rig: &Rig,
    records: &[Recorded],
) -> Result<Report, Failure> {
    let folders: Vec<&Path> = result
        .runs
        .iter()
        .filter_map(|run| run.folder.as_deref().map(Path::new))
        .collect();
    let manifest = records.first().map(|first| first.manifest.clone());
    let manifest = manifest.unwrap_or_default();
    let mut context = context(&manifest, &folders);
    context.plan = plan_facts(&rig.plan(rig.bench.runs.fit)?);
    if let Some(burst) = &result.burst {
        context.plan.push(fact("burst capture", burst.text()));
    }
    let diagnosis = &result.diagnosis;
    let (noise, added) = (diagnosis.model.noise, !diagnosis.effects.is_empty());
    let nameplate = Model::baseline(rig.plate.clone());
    let confirm = scenarios.get(2);
    let simulated = |model: &Model| match confirm {
        Some(run) => output_error::predict(model, run, &noise).map(|done| Some(done.trajectory)),
        None => Ok(None),
    };
    let (before, after) = (
        simulated(&diagnosis.baseline.model)?,
        simulated(&diagnosis.model.model)?,
    );
    let series = match (confirm, &before) {
        (Some(scenario), Some(before)) => Some(ConfirmRun {
            scenario,
            before,
            after: after.as_ref().filter(|_| added),
            noise: &noise,
        }),
        _ => None,
    };
    let truth: Vec<String> = result.truth.iter().map(truth_sentence).collect();
    let report = CommissionReport {
        kind: "Commission",
        title: &rig.bench.name,
        context: &context,
        nameplate: Some(&nameplate),
        parameters_before: &result.parameters_before,
        parameters_after: &result.parameters,
        before: &result.before,
        after: added.then_some(&result.after),
        diagnosis,
        ladder: &result.ladder,
        confirm: Some(&result.confirmed),
        series,
        truth: &truth,
    };
    Ok(Report {
        html: report.html(),
        text: report.text(),
    })
}

fn truth_sentence(truth: &crate::workflow::Truth) -> String {
    let carried = if truth.effects.is_empty() {
        "no hidden effect".to_owned()
    } else {
        truth.effects.join(", ")
    };
    let verdict = if truth.named_correctly {
        "the answer is right"
    } else {
        "the answer is wrong"
    };
    format!("the emulator carries {carried}: {verdict}")
}

pub(crate) fn context(manifest: &Manifest, folders: &[&Path]) -> Context {
    let emulator = manifest.identity["is_emulator"].as_bool();
    let text = |value: &serde_json::Value| {
        value
            .as_str()
            .map_or_else(|| value.to_string(), str::to_owned)
    };
    let table = |value: &serde_json::Value| -> Facts {
        let entries = value.as_object().into_iter().flatten();
        entries
            .filter(|(_, value)| !value.is_null() && !value.is_array())
            .map(|(key, value)| fact(&key.replace('_', " "), text(value)))
            .collect()
    };
    let mut link = vec![fact("link", manifest.link.clone())];
    link.extend(table(&manifest.link_statistics));
    link.extend(table(&manifest.wire));
    Context {
        target: match emulator {
            Some(true) => Target::Emulator,
            Some(false) => Target::Hardware,
            None => Target::Unknown,
        },
        run_folders: folders
            .iter()
            .map(|folder| folder.display().to_string())
            .collect(),
        identity: table(&manifest.identity),
        plan: Facts::new(),
        link,
        seed: manifest.seed,
        versions: vec![fact("drivebench", manifest.program_version.clone())],
        ..Context::default()
    }
}

fn plan_facts(plan: &Plan) -> Facts {
    vec![
        fact("duration", format!("{:.1} s", plan.duration_s)),
        fact(
            "predicted peak current",
            format!(
                "{:.1} A ({:.1} times rated)",
                plan.peak_current_a, plan.peak_current_ratio
            ),
        ),
        fact(
            "predicted peak speed",
            format!("{:.0} rad/s", plan.peak_speed_rad_s),
        ),
        fact(
            "predicted copper loss",
            format!("{:.0} J", plan.copper_loss_j),
        ),
    ]
}

fn fact(label: &str, value: String) -> (String, String) {
    (label.to_owned(), value)
}
