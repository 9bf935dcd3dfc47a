//! What the page of a run says about its speed loop.

use crate::bench::{LoopDelay, SpeedReport};
use crate::report::SpeedLoop;
use crate::report::page::{Cell, Table};
use crate::text::number::{fixed, significant};

pub(crate) fn speed_loop(report: &SpeedReport, at_rest: Option<&LoopDelay>) -> SpeedLoop {
    let cycles = |delay: Option<&LoopDelay>| match delay {
        Some(delay) => format!(
            "{:.2} cycles ({:.2} ms), 99 % within {:.2}",
            delay.median_cycles,
            1e3 * delay.median_s,
            delay.p99_cycles
        ),
        None => "not measured: the drive does not say when a command was applied".to_owned(),
    };
    let fact = |label: &str, value: String| (label.to_owned(), value);
    SpeedLoop {
        facts: vec![
            fact(
                "controller",
                format!(
                    "{} over a {} command",
                    report.controller,
                    report.actuator.name()
                ),
            ),
            fact("delay at rest", cycles(at_rest)),
            fact("delay while running", cycles(report.delay.as_ref())),
            fact(
                "tuned for",
                format!("{:.2} cycles", report.timing.delay_cycles()),
            ),
            fact(
                "cycles without a speed, output held",
                report.held_cycles.to_string(),
            ),
        ],
        tables: vec![tracking(report), steps(report)],
        reasons: report.reasons.clone(),
        changes: report
            .gain_changes
            .iter()
            .map(|change| format!("{:.2} s: {}", change.time_s, change.reason))
            .chain(
                report
                    .gains
                    .iter()
                    .map(|line| format!("at the end: {line}")),
            )
            .collect(),
    }
}

fn tracking(report: &SpeedReport) -> Table {
    let rows = report.tracking.iter().map(|pass| {
        vec![
            Cell::text(if pass.feed_forward { "on" } else { "off" }),
            Cell::text(format!(
                "{} to {} s",
                fixed(pass.from_s, 1),
                fixed(pass.until_s, 1)
            )),
            Cell::text(significant(pass.rms_rad_s, 3)),
            Cell::text(significant(pass.mean_abs_rad_s, 3)),
            Cell::text(significant(pass.peak_rad_s, 3)),
        ]
    });
    Table {
        head: vec![
            "feed-forward",
            "reference followed",
            "error rms, rad/s",
            "mean, rad/s",
            "peak, rad/s",
        ],
        rows: rows.collect(),
    }
}

fn steps(report: &SpeedReport) -> Table {
    let unit = report.actuator.unit();
    let rows = report.steps.iter().map(|step| {
        let response = &step.response;
        vec![
            Cell::text(fixed(step.step.at_s, 2)),
            Cell::text(format!(
                "{} to {}",
                fixed(step.speed_rad_s, 1),
                fixed(step.step.to_rad_s, 1)
            )),
            Cell::text(fixed(response.overshoot_percent, 1)),
            Cell::text(
                response
                    .settling_s
                    .map_or_else(|| "never".to_owned(), |s| fixed(s, 3)),
            ),
            Cell::text(fixed(response.absolute_error_rad, 2)),
            Cell::text(format!("{} {unit}", fixed(step.peak_output, 1))),
            Cell::text(fixed(100.0 * step.limited_share, 0)),
        ]
    });
    Table {
        head: vec![
            "at, s",
            "speed, rad/s",
            "overshoot, %",
            "settling, s",
            "IAE, rad",
            "peak output",
            "limited, %",
        ],
        rows: rows.collect(),
    }
}
