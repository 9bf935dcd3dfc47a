//! `plan`: what a sequence will do to the motor, before anything is energised.

use std::fmt::Write as _;
use std::path::PathBuf;

use serde::Serialize;

use super::data::read_text;
use super::failure::{Failure, USAGE};
use super::opening::wired_profile;
use super::output;
use crate::bench::{
    BenchFile, BenchFileError, EMBEDDED_DEFAULT, EMBEDDED_NAME, Plan, Port, Reference, plan,
};
use crate::drive::{LineBudget, offer};

/// Predict peak current, speed, travel, heat and duration of a bench file's sequence
#[derive(clap::Args)]
#[command(after_help = "Example:\n  drivebench plan bench-configs/benches/zk-22fc-emulated.toml")]
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
    let mut bench = BenchFile::parse(&file, &source)?;
    let program = bench
        .program(bench.runs.fit)
        .map_err(|error| BenchFileError::Sequence {
            file: bench.name.clone(),
            error,
        })?;
    let (profile, _) = wired_profile(&mut bench)?;
    let line = match bench.port() {
        Port::Tcp(_) => None,
        Port::Emulator | Port::Sim | Port::Serial(_) => LineBudget::of(&profile),
    };
    let asked_hz = bench.link.rate_hz;
    let rate_hz = line
        .as_ref()
        .map_or(asked_hz, |line| asked_hz.min(line.rate_hz()));
    let mut plan = plan(
        &program,
        &crate::app::nameplate(&bench)?,
        &bench.limits(),
        rate_hz,
        None,
    )?;
    if rate_hz < asked_hz {
        plan.warnings.push(format!(
            "{asked_hz} Hz is asked, the line carries {rate_hz:.0} Hz: cycles will be missed, and the prospects above are \
             those of {rate_hz:.0} Hz"
        ));
    }
    plan.warnings.extend(bench.motor.doubts());
    let only_speed = offer::refusal(&profile, offer::Purpose::Voltages).is_some();
    let reference = match bench.speed.as_ref().filter(|_| only_speed) {
        Some(speed) => {
            bench.check_speed(&file, &source)?;
            let reference = bench.reference(speed);
            reference
                .ok()
                .map(|reference| Forward::of(&reference, &bench))
        }
        None => None,
    };
    let forecast = Forecast {
        plan,
        reference,
        line,
    };
    output::result(&forecast, arguments.json, text)?;
    match forecast.plan.refusals.first() {
        Some(refusal) => Err(Failure::with_help(
            USAGE,
            format!("plan refused: {refusal}"),
            refusal.help(),
        )),
        None => Ok(()),
    }
}

/// The plan of the motor and that of the line.
#[derive(Serialize)]
struct Forecast {
    #[serde(flatten)]
    plan: Plan,
    /// Of a drive that takes no voltage: the plan of the sequence then moves nothing. `null`: the sequence is what moves.
    reference: Option<Forward>,
    /// `null` where no serial line is involved.
    line: Option<LineBudget>,
}

/// What the reference of a speed run asks for, and what bounds it.
#[derive(Serialize)]
struct Forward {
    duration_s: f64,
    peak_speed_rad_s: f64,
    speed_limit_rad_s: f64,
    current_limit_a: f64,
    time_limit_s: f64,
}

impl Forward {
    fn of(reference: &Reference, bench: &BenchFile) -> Self {
        let limits = bench.limits();
        Self {
            duration_s: reference.duration_s(),
            peak_speed_rad_s: reference.peak_rad_s(),
            speed_limit_rad_s: limits.speed_rad_s,
            current_limit_a: limits.current_a,
            time_limit_s: limits.time_s,
        }
    }

    fn text(&self) -> String {
        format!(
            "this drive takes no voltage: only the reference of [speed] moves the motor, with `drivebench speed`: {:.1} s, up to {:.0} rad/s either way; \
             the limits are {:.0} rad/s, {:.1} A and {:.0} s. What the drive's own loop draws is not predicted\n",
            self.duration_s,
            self.peak_speed_rad_s,
            self.speed_limit_rad_s,
            self.current_limit_a,
            self.time_limit_s
        )
    }
}

fn text(forecast: &Forecast) -> String {
    let mut text = match &forecast.reference {
        Some(reference) => reference.text(),
        None => sequence_text(&forecast.plan),
    };
    if let Some(line) = &forecast.line {
        let _ = writeln!(text, "\n{}", line_text(line));
    }
    for warning in &forecast.plan.warnings {
        let _ = writeln!(text, "warning: {warning}");
    }
    text
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
        let _ = writeln!(
            text,
            "{:<24} {prospect:<14} {}",
            parameter.key, parameter.reason
        );
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
    text
}
