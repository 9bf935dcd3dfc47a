//! The cards of commands over a live drive and of what is identified, and what stands above them with `--full`.

use super::files::Recorded;
use super::identify::{Answer, is_usable};
use super::output::{fitted, quoted};
use super::run::Whole;
use super::speed::SpeedResult;
use crate::report::page::Table;
use crate::report::{Card, Tone, conventions, tables};
use crate::workflow::EscalationResult;
use drivebench_bench::recording::RunFile;
use drivebench_bench::{Outcome, RunSummary, SpeedReport, StepFigures, Stop, Tracking, Watched};
use drivebench_identify::misfit::Misfit;
use drivebench_identify::nameplate::{self, Comparison, Fits};
use drivebench_identify::recursive::INERTIA_HAS_CHANGED;
use drivebench_identify::repeat::Repeated;
use drivebench_model::plant::{Model, Motor};
use drivebench_model::sample::{ParameterEstimate, Verdict};
use drivebench_model::text::number::{fixed, with_std};

/// Share of a run from which on it is worth a word that the drive's own limit held its output.
const MUCH_LIMITED_SHARE: f64 = 0.1;

/// The reasons of all verdicts, and how the motor was found.
pub(crate) fn run_in_full(whole: &Whole, plate: Option<&Comparison>) -> Vec<String> {
    let estimates = whole.recorded.summary.estimates.iter();
    let reasons = estimates.map(|own| format!("{}: {}", own.key, own.verdict_text()));
    let mut rows: Vec<String> = reasons.flat_map(|text| fitted(&text)).collect();
    let escalation = whole.escalation.as_ref().map(EscalationResult::text);
    let text = escalation.or_else(|| plate.map(Comparison::text));
    rows.extend(text.iter().flat_map(|text| fitted(text)));
    rows
}

/// How the run went, what was found on line, and whether the plate fits.
pub(crate) fn run(whole: &Whole, plate: Option<&Comparison>) -> Card {
    let recorded = &whole.recorded;
    let timing = &recorded.summary.timing;
    let (achieved_hz, asked_hz) = (timing.rate_achieved_hz, timing.rate_asked_hz);
    let mut card = account(
        &recorded.summary,
        &format!(" {achieved_hz:.1} of {asked_hz:.0} Hz,"),
    );
    let escalation = whole.escalation.as_ref();
    card.say("motor", escalation.map(|found| found.sentence.as_str()), 1);
    let estimates = recorded.summary.estimates.as_slice();
    let nameplate = Model::baseline(whole.plate.clone());
    let parameters = tables::of_card(Some(&nameplate), &[], estimates);
    card.table("on line", parameters, tables::SPARE, 5);
    let told = estimates
        .iter()
        .filter_map(|own| Some((own, own.reason.as_ref()?)));
    let told = told.map(|(own, reason)| format!("{}: {reason}", own.key));
    card.say("", told.collect::<Vec<_>>(), 0);
    card.say("plate", plate.into_iter().flat_map(Comparison::in_short), 1);
    let folder = recorded.folder.path();
    let run = quoted(folder);
    let word = match recorded.summary.outcome {
        Outcome::Done => "diagnose",
        _ => "view",
    };
    card.go_on(format!("drivebench {word} {run}"));
    end_of_run(&mut card, recorded);
    card
}

/// The folder of a run, and last its page, where there is one.
fn end_of_run(card: &mut Card, recorded: &Recorded) {
    let page = recorded.folder.file(RunFile::Report);
    let last = if page.exists() {
        card.is_of_a_motion();
        page.as_path()
    } else {
        recorded.folder.path()
    };
    card.ends_with(last.display().to_string());
}

/// How a run went, in one line.
fn account(summary: &RunSummary, rate: &str) -> Card {
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
    let mut card = Card::new(tone, &outcome.replace('_', " "), &sentence);
    let is_plain =
        |stop: &&Stop| summary.outcome == Outcome::Done && stop.confirmed_after_ms.is_some();
    let stop = summary.stop.as_ref().filter(|stop| !is_plain(stop));
    card.say("stopped", stop.map(Stop::sentence), 1);
    let last = summary.last_seconds.map(|last| {
        let (from, to) = (last.from_row, last.to_row);
        format!("rows {from} to {to} of samples.csv; the page shows them enlarged")
    });
    card.say("last 2 s", last, 1);
    let frozen = &summary.frozen;
    let is_much = frozen.rows as f64 > MUCH_LIMITED_SHARE * summary.rows as f64;
    let limited = is_much.then(|| {
        let (held, seconds) = (frozen.rows, frozen.seconds);
        format!(
            "a limit of the drive held its output in {held} of {rows} rows, {seconds:.1} s: nothing is learnt there; slower or smaller \
             steps stay clear of it"
        )
    });
    card.say("limited", limited, 1);
    card
}

/// What was found by `scheme`, and whether the plate fits.
pub(crate) fn identify(answer: &Answer, scheme: &str) -> Card {
    let combined = || answer.combined.iter();
    let known = combined().filter(|own| is_usable(&own.estimate)).count();
    let all = answer.combined.len();
    let tone = if known == all {
        Tone::Good
    } else {
        Tone::Attention
    };
    let runs = match answer.runs.len() {
        1 => "± is one standard deviation, 1.96 of them hold 95 %".to_owned(),
        runs if answer.joint.is_some() => {
            format!("{runs} runs, fitted one by one and as one; the spread is that from run to run")
        }
        runs => format!("mean of {runs} runs; the spread is that from run to run"),
    };
    let sentence = format!("{known} of {all} parameters by scheme {scheme}; {runs}");
    let mut card = Card::new(tone, "Identified", &sentence);
    let value = |own: &&Repeated| own.estimate.text(1.0);
    let mut table = Table::of(combined())
        .column("parameter", |own| own.estimate.key.clone())
        .column("found ± std", value);
    if answer.runs.len() > 1 {
        table = table.column("spread", |own| {
            own.run_to_run_std
                .map_or_else(|| "-".to_owned(), |std| format!("{std:.1e}"))
        });
    }
    let table = table.column("verdict", |own| own.estimate.verdict.name());
    card.table("motor", table, &[], 5);
    let reasons = combined().filter_map(|own| {
        let reason = own.estimate.reason.as_ref()?;
        Some(format!("{}: {reason}", own.estimate.key))
    });
    card.say("why", reasons.collect::<Vec<_>>(), 1);
    let left = answer.misfit().and_then(Misfit::text);
    card.say(
        "misfit",
        left.map(|left| format!("the model leaves {left}")),
        1,
    );
    let absolute = answer.absolute.as_deref().unwrap_or_default();
    card.table("absolute", tables::of_card(None, &[], absolute), &[], 3);
    if let Some(ratio) = answer.gear_ratio {
        let load = conventions::on_load_shaft(&answer.parameters(), ratio);
        card.table("load shaft", tables::of_card(None, &[], &load), &[], 2);
    }
    let plate = answer.nameplate.iter();
    card.say("plate", plate.flat_map(Comparison::in_short), 1);
    let notes = answer.runs.iter().flat_map(|run| &run.found.notes);
    let notes = answer.caution.iter().chain(notes);
    card.say("note", notes.map(String::as_str), 1);
    card
}

/// The parameters in other units, and the whole plate.
pub(crate) fn identify_in_full(answer: &Answer) -> Vec<String> {
    let plate = answer.nameplate.as_ref().map(Comparison::text);
    let mut rows: Vec<String> = plate.iter().flat_map(|text| fitted(text)).collect();
    let converted = conventions::of(&answer.parameters());
    if !converted.is_empty() {
        rows.push("in other units".to_owned());
        rows.extend(converted.iter().map(|own| {
            let number = with_std(own.value, own.std);
            format!("  {:<42} {number} {}", own.key, own.unit)
        }));
        rows.extend(fitted(&format!("  {}", conventions::RELATION)));
    }
    rows
}

/// How closely the reference was followed, and what the gains were at the end.
pub(crate) fn speed(result: &SpeedResult<'_>, recorded: &Recorded, words: &str) -> Card {
    let summary = result.summary;
    let mut card = account(summary, "");
    if let Some(report) = &summary.speed {
        let other = of_another_machine(result.motor, &summary.estimates);
        card.say("machine", other, 2);
        card.say("tracking", report.tracking.iter().map(tracking_text), 2);
        card.say("", softened_text(report), 1);
        let mut steps = steps_text(report);
        if summary.outcome != Outcome::Done
            && let Some(last) = steps.last_mut()
        {
            last.push_str("; of whole steps: the last was cut short");
        }
        card.say("steps", steps, 2);
        let steps = Table::of(&report.steps)
            .column("at s", |step| fixed(step.step.at_s, 2))
            .column("from", |step| fixed(step.speed_rad_s, 1))
            .column("to rad/s", |step| fixed(step.step.to_rad_s, 1))
            .column("overshoot %", |step| {
                fixed(step.response.overshoot_percent, 1)
            })
            .column("settling s", |step| {
                let settling = step.response.settling_s.map(|s| fixed(s, 3));
                let none = if step.settles_in_noise {
                    "in noise"
                } else {
                    "never"
                };
                settling.unwrap_or_else(|| none.to_owned())
            })
            .column("IAE rad", |step| fixed(step.response.absolute_error_rad, 2))
            .column("limited %", |step| fixed(100.0 * step.limited_share, 0));
        card.table("", steps, &["limited %", "IAE rad", "from"], 3);
        let changes = report.gain_changes.iter();
        let changes = changes.map(|change| format!("{:.2} s: {}", change.time_s, change.reason));
        card.say("gains", changes.collect::<Vec<_>>(), 0);
        let found = report.watch.iter();
        let found = found.map(|one| format!("{:.2} s: {}", one.time_s, one.reason));
        card.say("watch", found.collect::<Vec<_>>(), 3);
        card.say("at end", report.gains.iter().map(String::as_str), 1);
    }
    if summary.outcome == Outcome::Done {
        let both = summary
            .speed
            .as_ref()
            .is_some_and(|report| report.tracking.len() > 1);
        card.go_on(match result.model_file() {
            Some(model) if !both => {
                format!("drivebench speed{words} --model {model} --feed-forward compare")
            }
            _ => format!("drivebench replay {}", quoted(recorded.folder.path())),
        });
    } else {
        card.go_on(format!(
            "drivebench view {}",
            quoted(recorded.folder.path())
        ));
    }
    end_of_run(&mut card, recorded);
    card
}

/// The loop, its gains over time and why they are what they are.
pub(crate) fn speed_in_full(result: &SpeedResult<'_>) -> Vec<String> {
    let Some(report) = &result.summary.speed else {
        return Vec::new();
    };
    let mut rows: Vec<String> = report
        .reasons
        .iter()
        .flat_map(|text| fitted(text))
        .collect();
    rows.extend(report.delay.as_ref().map(|delay| {
        let (median, p99) = (delay.median_cycles, delay.p99_cycles);
        let tuned = report.timing.delay_cycles();
        format!("loop delay {median:.2} cycles while running, 99 % within {p99:.2}; tuned for {tuned:.2}")
    }));
    let changes = report.gain_changes.iter();
    let changes = changes.map(|change| format!("{:>8.2} s  {}", change.time_s, change.reason));
    rows.extend(changes.flat_map(|text| fitted(&text)));
    let found = report.watch.iter();
    let found = found.map(|one| format!("{:>8.2} s  {}", one.time_s, one.reason));
    rows.extend(found.flat_map(|text| fitted(&text)));
    rows
}

/// Values that are not those that the loop was tuned on, as far as they are known; of an inertia that changed what is known so far.
fn of_another_machine(tuned_on: &Motor, found: &[ParameterEstimate]) -> Vec<String> {
    let compared = nameplate::compare(tuned_on, found);
    let rows = compared.rows.iter().filter(|row| row.fits == Fits::No);
    let sentences = rows.filter_map(|row| {
        let estimate = ParameterEstimate::find(found, row.key)?;
        let reason = estimate.reason.as_deref().unwrap_or_default();
        let has_changed = reason.starts_with(INERTIA_HAS_CHANGED);
        let is_known = estimate.verdict == Verdict::Settled || has_changed;
        let (value, ratio) = (row.found.filter(|_| is_known)?, row.ratio?);
        let number = with_std(value, row.std);
        let why = if has_changed {
            format!("; {reason}")
        } else {
            String::new()
        };
        Some(format!(
            "{} is {number} {}, {ratio:.2} times what the loop was tuned on{why}",
            row.key, row.unit
        ))
    });
    sentences.collect()
}

/// Where a reference is followed twice and the watch lowered the gains, what the passes differ by is not only what is given
/// forward.
fn softened_text(report: &SpeedReport) -> Option<String> {
    let softest = |pass: &Tracking| {
        let inside = |found: &&Watched| (pass.from_s..pass.until_s).contains(&found.time_s);
        let shares = report
            .watch
            .iter()
            .filter(inside)
            .map(|found| found.gain_share);
        shares.fold(1.0, f64::min)
    };
    let shares: Vec<f64> = report.tracking.iter().map(softest).collect();
    let is_softened = shares.len() > 1 && shares.iter().any(|share| *share < 1.0);
    is_softened.then(|| {
        let each = report.tracking.iter().zip(&shares);
        let each = each.map(|(pass, share)| {
            format!("{:.0} % {} feed-forward", 100.0 * share, forward_word(pass))
        });
        format!(
            "the loop swung and its gain fell to {}: the passes are those of two loops, not of feed-forward alone",
            each.collect::<Vec<_>>().join(", ")
        )
    })
}

/// The worst step of the report, or where it was followed twice the means of each pass, so that both are seen.
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
        let settled = steps
            .iter()
            .filter(|step| step.response.settling_s.is_some());
        let settled = match mean(&steps, |step| step.response.settling_s) {
            Some(mean) => format!("{} settled in {mean:.3} s", settled.count()),
            None => "none settled".to_owned(),
        };
        let (with, count) = (forward_word(pass), steps.len());
        Some(format!(
            "{count} {with} feed-forward, on the mean: overshoot {overshoot:.1} %, IAE {error:.2} rad; {settled}"
        ))
    };
    if report.tracking.len() > 1 {
        return report.tracking.iter().filter_map(pass).collect();
    }
    let mut steps = report.steps.iter();
    let worst = steps
        .by_ref()
        .skip(1)
        .max_by(|a, b| overshoot(a).total_cmp(&overshoot(b)));
    let worst = worst.filter(|_| report.steps.len() > 2);
    let text = worst.map(|step| {
        format!(
            "most overshoot at {:.2} s: {:.1} %, {:.2} rad of error (IAE)",
            step.step.at_s, step.response.overshoot_percent, step.response.absolute_error_rad
        )
    });
    text.into_iter().collect()
}

const fn forward_word(pass: &Tracking) -> &'static str {
    if pass.feed_forward { "with" } else { "without" }
}

fn tracking_text(pass: &Tracking) -> String {
    let with = forward_word(pass);
    let (rms, mean, peak) = (pass.rms_rad_s, pass.mean_abs_rad_s, pass.peak_rad_s);
    let reversals = pass.reversal_rms_rad_s;
    let reversals =
        reversals.map_or_else(String::new, |rms| format!("; {rms:.2} rms at reversals"));
    format!(
        "error {with} feed-forward {rms:.2} rad/s rms, {mean:.2} mean, {peak:.2} at most{reversals}"
    )
}
