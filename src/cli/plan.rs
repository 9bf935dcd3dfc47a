//! `plan`: what a sequence will do to the motor, before anything is energised.

use std::fmt::Write as _;
use std::path::PathBuf;

use super::failure::Failure;
use super::output::{self, lines};
use crate::app::files::read_text;
use crate::app::forecast::{Forecast, Forward, Known, Unknown, forecast};
use drivebench_bench::{EMBEDDED_DEFAULT, EMBEDDED_NAME, Plan};
use drivebench_link::LineBudget;

/// Predict peak current, speed, travel, heat and duration of a bench file's sequence
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  drivebench plan bench-configs/benches/zk-22fc-emulated.toml\n\n\
A motor that is not known (motor.unknown = true, or values left out) is found from small steps first: then the plan tells the\n\
first of them and what follows. Where only load_torque_n_m is left out, the sequence is predicted without friction."
)]
pub(super) struct Arguments {
    /// Bench file; without it the embedded one
    bench: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    let (file, source) = match &arguments.bench {
        Some(path) => (path.display().to_string(), read_text(path)?),
        None => (EMBEDDED_NAME.to_owned(), EMBEDDED_DEFAULT.to_owned()),
    };
    let found = forecast(&file, &source)?;
    output::result(&found, arguments.json, |found| match found {
        Forecast::Known(known) => known_text(known),
        Forecast::Unknown(unknown) => unknown_text(unknown),
    })?;
    let refusal = match &found {
        Forecast::Known(known) => known.plan.refusals.first(),
        Forecast::Unknown(_) => None,
    };
    refusal.map_or(Ok(()), |refusal| {
        let headline = format!("plan refused: {refusal}");
        Err(Failure::usage(headline, refusal.help()))
    })
}

fn unknown_text(unknown: &Unknown) -> String {
    let mut text = "the motor is not known: before the sequence it is found from small steps, each as large as the one before allows\n".to_owned();
    if let Some(told) = &unknown.escalation {
        let first = &told.first;
        let _ = writeln!(
            text,
            "\nfirst stage ({}): up to {:.3} V, {:.1} V/s, {:.1} s; ends with {:.2} A or {:.2} rad/s",
            first.kind.name(),
            first.peak_v,
            first.slew_v_per_s,
            told.duration_s,
            first.stop_current_a,
            first.stop_speed_rad_s
        );
        lines(&mut text, "then ", &told.next);
        let _ = writeln!(
            text,
            "in every stage a run ends beyond {:.1} A, {:.0} rad/s, {:.0} V, or after {:.2} s without a reply. What the sequence does \
             is planned for the motor that was found, and made smaller where that asks for it",
            told.current_limit_a, told.speed_limit_rad_s, told.voltage_limit_v, told.link_silence_s
        );
    }
    lines(&mut text, "\n", unknown.line.as_ref().map(line_text));
    lines(&mut text, "warning: ", &unknown.warnings);
    text
}

fn known_text(forecast: &Known) -> String {
    let mut text = match &forecast.reference {
        Some(reference) => reference_text(reference),
        None => sequence_text(&forecast.plan),
    };
    lines(&mut text, "\n", forecast.line.as_ref().map(line_text));
    lines(&mut text, "warning: ", &forecast.plan.warnings);
    text
}

/// What moves a drive that takes no voltage.
fn reference_text(reference: &Forward) -> String {
    format!(
        "this drive takes no voltage: only the reference of [speed] moves the motor, with `drivebench speed`: {:.1} s, up to {:.0} rad/s either way; \
         the limits are {:.0} rad/s, {:.1} A and {:.0} s. What the drive's own loop draws is not predicted\n",
        reference.duration_s,
        reference.peak_speed_rad_s,
        reference.speed_limit_rad_s,
        reference.current_limit_a,
        reference.time_limit_s
    )
}

fn sequence_text(plan: &Plan) -> String {
    let mut text = format!(
        "{:.1} s, {} rows, peak {:.1} A ({:.1} times rated), {:.0} rad/s, {:.0} V, copper loss {:.0} J\n\n",
        plan.duration_s,
        plan.rows,
        plan.peak_current_a,
        plan.peak_current_ratio,
        plan.peak_speed_rad_s,
        plan.peak_voltage_v,
        plan.copper_loss_j
    );
    let _ = writeln!(
        text,
        "{:<14} {:>7} {:>7} {:>8} {:>8} {:>9}",
        "segment", "from s", "to s", "peak V", "peak A", "rad/s"
    );
    for segment in &plan.segments {
        let _ = writeln!(
            text,
            "{:<14} {:>7.2} {:>7.2} {:>8.1} {:>8.1} {:>9.1}",
            segment.name,
            segment.start_s,
            segment.end_s,
            segment.peak_voltage_v,
            segment.peak_current_a,
            segment.peak_speed_rad_s
        );
    }
    let _ = writeln!(text);
    for parameter in &plan.parameters {
        let prospect = format!("{:?}", parameter.prospect).to_lowercase();
        let (key, reason) = (&parameter.key, &parameter.reason);
        let _ = writeln!(text, "{key:<24} {prospect:<14} {reason}");
    }
    text
}

/// The arithmetic of the line, a rate for each kind of adapter.
fn line_text(line: &LineBudget) -> String {
    let mut text = format!(
        "{} at {} baud: {} + {} bytes in {} request{} take {:.2} ms, silences {:.2} ms, the drive up to {:.2} ms\n",
        line.protocol.name(),
        line.baud,
        line.request_bytes,
        line.reply_bytes,
        line.exchanges,
        if line.exchanges == 1 { "" } else { "s" },
        line.wire_ms,
        line.gaps_ms,
        line.reply_ms
    );
    for rate in &line.rates {
        let _ = writeln!(text, "  {:<34} {:>6.0} Hz", rate.adapter, rate.rate_hz);
    }
    lines(&mut text, "", line.reply_text());
    text
}
