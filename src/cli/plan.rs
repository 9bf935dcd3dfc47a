//! `plan`: what a sequence will do to the motor, before anything is energised.

use std::fmt::Write as _;
use std::path::PathBuf;

use super::data::read_text;
use super::failure::{Failure, USAGE};
use super::output;
use crate::bench::{BenchFile, BenchFileError, Plan, plan};

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
    let bench = match &arguments.bench {
        Some(path) => BenchFile::parse(&path.display().to_string(), &read_text(path)?)?,
        None => BenchFile::embedded_default(),
    };
    let program = bench
        .program(bench.runs.fit)
        .map_err(|error| BenchFileError::Sequence {
            file: bench.name.clone(),
            error,
        })?;
    let plan = plan(
        &program,
        &super::live::nameplate(&bench)?,
        &bench.limits(),
        bench.link.rate_hz,
        None,
    )?;
    output::result(&plan, arguments.json, text)?;
    match plan.refusals.first() {
        Some(refusal) => Err(Failure::with_help(
            USAGE,
            format!("plan refused: {refusal}"),
            refusal.help(),
        )),
        None => Ok(()),
    }
}

fn text(plan: &Plan) -> String {
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
    for warning in &plan.warnings {
        let _ = writeln!(text, "warning: {warning}");
    }
    text
}
