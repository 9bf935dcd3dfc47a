//! The documents of commands over a live drive and of what is identified.

use crate::commands::identify::{Answer, is_usable};
use crate::commands::report::last_rows;
use crate::commands::run::CompletedRun;
use crate::commands::speed::{SpeedDone, delay_text};
use crate::report::{Cell, Document, Table, Tone, conventions, tables};
use crate::runtime::{Recorded, quoted};
use drivebench_bench::recording::RunFile;
use drivebench_bench::{
    LoopDelay, Outcome, RunSummary, SpeedReport, StepFigures, Stop, Tracking, Watched,
};
use drivebench_identify::misfit::Misfit;
use drivebench_identify::nameplate::{self, Fits};
use drivebench_model::plant::{Model, Motor};
use drivebench_model::sample::{ParameterEstimate, Reason, Verdict};
use drivebench_model::text::number::{fixed, significant, with_std};

pub(crate) fn run(whole: &CompletedRun) -> Document {
    let recorded = &whole.recorded;
    let timing = &recorded.summary.timing;
    let (achieved_hz, requested_hz) = (timing.rate_achieved_hz, timing.rate_asked_hz);
    let mut document =
        outcome_document(&recorded.summary, &format!(" {achieved_hz:.1} of {requested_hz:.0} Hz,"));
    if let Some(found) = &whole.escalation {
        found.put("motor", &mut document);
    }
    let estimates = recorded.summary.estimates.as_slice();
    let nameplate = Model::baseline(whole.nameplate_motor.clone());
    let nameplate = Some(&nameplate);
    let how = if whole.is_by_balances { "balances" } else { "on line" };
    tables::parameter_section(&mut document, how, nameplate, &[], estimates, 5);
    tables::nameplate_section(&mut document, whole.nameplate.as_ref());
    let command = match recorded.summary.outcome {
        Outcome::Done => "diagnose",
        _ => "view",
    };
    document.go_on(format!("drivebench {command} {}", quoted(recorded.folder.path())));
    end_of_run(&mut document, recorded);
    document
}

/// The folder of a run, and last its page, where there is one.
fn end_of_run(document: &mut Document, recorded: &Recorded) {
    let page = recorded.folder.file(RunFile::Report);
    let last = if page.exists() {
        document.rest_is_on_page();
        page.as_path()
    } else {
        recorded.folder.path()
    };
    document.ends_with(last.display().to_string());
}

fn outcome_document(summary: &RunSummary, rate: &str) -> Document {
    let (outcome, rows) = (summary.outcome.name(), summary.rows);
    let (duration_s, missed) = (summary.duration_s, summary.timing.missed_cycles);
    let (lost, sent) = (summary.link.lost(), summary.link.sent);
    let tone = match summary.outcome {
        Outcome::Done => Tone::Good,
        _ => Tone::Attention,
    };
    let sentence = format!(
        "{rows} rows in {duration_s:.1} s,{rate} {missed} cycles missed, {lost} of {sent} exchanges lost"
    );
    let mut document = Document::of(tone, outcome.replace('_', " "), sentence);
    let stop = summary
        .stop
        .as_ref()
        .filter(|stop| summary.outcome != Outcome::Done || stop.confirmed_after_ms.is_none());
    document.say("stopped", stop.map(Stop::sentence), 1);
    document.say("last 2 s", summary.last_seconds.map(last_rows), 1);
    let frozen = &summary.frozen;
    let limited = (frozen.rows as f64 > 0.1 * summary.rows as f64).then(|| {
        let (limited, seconds) = (frozen.rows, frozen.seconds);
        format!(
            "a limit of the drive was active in {limited} of {rows} rows, {seconds:.1} s: nothing is identified from them; use \
            slower or smaller steps"
        )
    });
    document.say("limited", limited, 1);
    document
}

pub(crate) fn identify(answer: &Answer, scheme: &str) -> Document {
    let combined = || answer.combined.iter();
    let known = combined().filter(|own| is_usable(&own.estimate)).count();
    let all = answer.combined.len();
    let tone = if known == all { Tone::Good } else { Tone::Attention };
    let runs = match answer.runs.len() {
        1 => "± is one standard deviation; the 95 % interval is 1.96 of them".to_owned(),
        runs if answer.joint.is_some() => {
            format!(
                "{runs} runs, fitted one by one and together; the spread is that from run to run"
            )
        }
        runs => format!("mean of {runs} runs; the spread is that from run to run"),
    };
    let sentence = format!("{known} of {all} parameters by scheme {scheme}; {runs}");
    let mut document = Document::of(tone, "Identified", sentence);
    let mut table = Table::of(combined())
        .column("parameter", |own| own.estimate.key.clone())
        .column("found ± std", |own| own.estimate.text(1.0));
    if answer.runs.len() > 1 {
        table = table.column("spread", |own| {
            own.run_to_run_std.map_or_else(|| "-".to_owned(), |std| format!("{std:.1e}"))
        });
    }
    let table = table.column("verdict", |own| own.estimate.verdict.name());
    document.table_on_card("motor", table, &[], 5);
    let reasons = combined().filter_map(|own| {
        let reason = own.estimate.reason.as_ref()?;
        Some(format!("{}: {reason}", own.estimate.key))
    });
    document.say("why", reasons, 1);
    let misfit = answer.misfit().and_then(Misfit::text);
    document.say("misfit", misfit.map(|misfit| format!("the model leaves {misfit}")), 1);
    let absolute = answer.absolute.as_deref().unwrap_or_default();
    tables::parameter_section(&mut document, "absolute", None, &[], absolute, 3);
    let parameters = answer.parameters();
    if let Some(ratio) = answer.gear_ratio {
        let load = conventions::on_load_shaft(&parameters, ratio);
        tables::parameter_section(&mut document, "at load", None, &[], &load, 2);
    }
    tables::nameplate_section(&mut document, answer.nameplate.as_ref());
    let of_runs = answer.runs.iter().flat_map(|run| &run.found.notes);
    document.say("note", answer.caution.iter().chain(of_runs).map(String::as_str), 1);
    let converted = conventions::of(&parameters);
    if !converted.is_empty() {
        document.section("In other units");
        document.table(
            Table::of(&converted)
                .column("value", |own| Cell::code(own.key))
                .column("found ± std", |own| {
                    format!("{} {}", with_std(own.value, own.std), own.unit)
                }),
        );
        document.paragraph(conventions::RELATION);
    }
    document
}

/// Figures of a speed loop, for the card of `speed` and the page of its run.
pub(crate) fn speed_loop(done: &SpeedDone) -> Document {
    let mut document = Document::new("", "");
    let summary = &done.recorded.summary;
    let Some(report) = &summary.speed else {
        return document;
    };
    let cycles = |delay: Option<&LoopDelay>| match delay {
        Some(delay) => delay_text(delay),
        None => "not measured: the drive does not report when a command was applied".to_owned(),
    };
    let facts = [
        ("controller", format!("{} over a {} command", report.controller, report.actuator.name())),
        ("delay at rest", cycles(done.delay_at_rest.as_ref())),
        ("delay while running", cycles(report.delay.as_ref())),
        ("tuned for", format!("{:.2} cycles", report.timing.delay_cycles())),
        ("cycles without a speed, output held", report.held_cycles.to_string()),
    ];
    document.facts(facts.map(|(label, value)| (label.to_owned(), value)).into());
    document.say("machine", changed_parameters(&done.motor, &summary.estimates), 2);
    document.table_on_card("tracking", tracking(report), &["reference followed"], 2);
    document.say("", reduced_gain_text(report), 1);
    let mut all = steps_text(report);
    if summary.outcome != Outcome::Done
        && let Some(last) = all.last_mut()
    {
        last.push_str("; complete steps only: the last was interrupted");
    }
    document.say("steps", all, 2);
    document.table_on_card(
        "",
        steps(report),
        &["peak output", "limited, %", "IAE, rad", "from"],
        3,
    );
    document.section("Gains");
    document.labelled("why", report.reasons.iter().map(String::as_str));
    let at = |time_s: f64, reason: &str| format!("{time_s:.2} s: {reason}");
    document.say("gains", report.gain_changes.iter().map(|one| at(one.time_s, &one.reason)), 0);
    document.say("watch", report.watch.iter().map(|one| at(one.time_s, &one.reason)), 3);
    document.say("at end", report.gains.iter().map(String::as_str), 1);
    document
}

fn tracking(report: &SpeedReport) -> Table {
    let error = |value: f64| significant(value, 3);
    Table::of(&report.tracking)
        .column("feed-forward", |pass| if pass.feed_forward { "on" } else { "off" })
        .column("reference followed", |pass| {
            format!("{} to {} s", fixed(pass.from_s, 1), fixed(pass.until_s, 1))
        })
        .column("error rms, rad/s", |pass| error(pass.rms_rad_s))
        .column("mean, rad/s", |pass| error(pass.mean_abs_rad_s))
        .column("peak, rad/s", |pass| error(pass.peak_rad_s))
        .column("rms of reversals, rad/s", |pass| {
            pass.reversal_rms_rad_s.map_or_else(|| "-".to_owned(), error)
        })
        .into()
}

fn steps(report: &SpeedReport) -> Table {
    let unit = report.actuator.unit();
    Table::of(&report.steps)
        .column("at, s", |step| fixed(step.step.at_s, 2))
        .column("from", |step| fixed(step.speed_rad_s, 1))
        .column("to, rad/s", |step| fixed(step.step.to_rad_s, 1))
        .column("overshoot, %", |step| fixed(step.response.overshoot_percent, 1))
        .column("settling, s", |step| {
            let none = if step.settles_in_noise { "in noise" } else { "never" };
            step.response.settling_s.map_or_else(|| none.to_owned(), |s| fixed(s, 3))
        })
        .column("IAE, rad", |step| fixed(step.response.absolute_error_rad, 2))
        .column("peak output", |step| format!("{} {unit}", fixed(step.peak_output, 1)))
        .column("limited, %", |step| fixed(100.0 * step.limited_share, 0))
        .into()
}

pub(crate) fn speed(done: &SpeedDone, options: &str) -> Document {
    let recorded = &done.recorded;
    let summary = &recorded.summary;
    let mut document = outcome_document(summary, "");
    document.append(speed_loop(done));
    if summary.outcome == Outcome::Done {
        let both = summary.speed.as_ref().is_some_and(|report| report.tracking.len() > 1);
        document.go_on(match done.model_file() {
            Some(model) if !both => {
                format!("drivebench speed{options} --model {model} --feed-forward compare")
            }
            _ => format!("drivebench replay {}", quoted(recorded.folder.path())),
        });
    } else {
        document.go_on(format!("drivebench view {}", quoted(recorded.folder.path())));
    }
    end_of_run(&mut document, recorded);
    document
}

/// Parameters that differ from those that the loop was tuned on; for an inertia that has changed, the present estimate.
fn changed_parameters(tuned_on: &Motor, found: &[ParameterEstimate]) -> Vec<String> {
    let compared = nameplate::compare(tuned_on, found);
    let sentences = compared.rows.iter().filter(|row| row.fits == Fits::No).filter_map(|row| {
        let estimate = ParameterEstimate::find(found, row.key)?;
        let reason = estimate.reason.as_deref().unwrap_or_default();
        let has_changed = estimate.code == Some(Reason::InertiaChanged);
        let is_known = estimate.verdict == Verdict::Settled || has_changed;
        let (value, ratio) = (row.found.filter(|_| is_known)?, row.ratio?);
        let number = with_std(value, row.std);
        let why = if has_changed { format!("; {reason}") } else { String::new() };
        Some(format!(
            "{} is {number} {}, {ratio:.2} times what the loop was tuned on{why}",
            row.key, row.unit
        ))
    });
    sentences.collect()
}

/// Note where a reference was followed twice and an oscillation has lowered the gain: feed-forward is then not the only
/// difference of the passes.
fn reduced_gain_text(report: &SpeedReport) -> Option<String> {
    let least_gain = |pass: &Tracking| {
        let inside = |found: &&Watched| (pass.from_s..pass.until_s).contains(&found.time_s);
        report.watch.iter().filter(inside).map(|found| found.gain_share).fold(1.0, f64::min)
    };
    let shares: Vec<f64> = report.tracking.iter().map(least_gain).collect();
    let is_reduced = shares.len() > 1 && shares.iter().any(|share| *share < 1.0);
    is_reduced.then(|| {
        let each = report.tracking.iter().zip(&shares).map(|(pass, share)| {
            format!("{:.0} % {}", 100.0 * share, feed_forward(pass))
        });
        format!(
            "the loop oscillated and its gain was reduced to {}: the passes differ by the gain too, not only by feed-forward",
            each.collect::<Vec<_>>().join(", ")
        )
    })
}

/// The worst step of the report, or where the reference was followed twice the means of each pass.
fn steps_text(report: &SpeedReport) -> Vec<String> {
    let overshoot = |step: &&StepFigures| step.response.overshoot_percent;
    let mean = |steps: &[&StepFigures], value: fn(&StepFigures) -> Option<f64>| {
        let values: Vec<f64> = steps.iter().filter_map(|step| value(step)).collect();
        (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
    };
    let pass = |pass: &Tracking| {
        let inside = |step: &&StepFigures| (pass.from_s..pass.until_s).contains(&step.step.at_s);
        let steps: Vec<&StepFigures> = report.steps.iter().filter(inside).collect();
        let overshoot = mean(&steps, |step| Some(step.response.overshoot_percent))?;
        let error = mean(&steps, |step| Some(step.response.absolute_error_rad))?;
        let settled = steps.iter().filter(|step| step.response.settling_s.is_some()).count();
        let settled = match mean(&steps, |step| step.response.settling_s) {
            Some(mean) => format!("{settled} settled in {mean:.3} s"),
            None => "none settled".to_owned(),
        };
        Some(format!(
            "{} {}, on average: overshoot {overshoot:.1} %, IAE {error:.2} rad; {settled}",
            steps.len(),
            feed_forward(pass)
        ))
    };
    if report.tracking.len() > 1 {
        return report.tracking.iter().filter_map(pass).collect();
    }
    let worst = report.steps.iter().skip(1).max_by(|a, b| overshoot(a).total_cmp(&overshoot(b)));
    let worst = worst.filter(|_| report.steps.len() > 2).map(|step| {
        format!(
            "largest overshoot at {:.2} s: {:.1} %, {:.2} rad of error (IAE)",
            step.step.at_s, step.response.overshoot_percent, step.response.absolute_error_rad
        )
    });
    worst.into_iter().collect()
}

const fn feed_forward(pass: &Tracking) -> &'static str {
    if pass.feed_forward { "with feed-forward" } else { "without feed-forward" }
}
