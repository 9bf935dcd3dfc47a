//! `tune`: from a model and the link's timing to the gains of a speed regulator, with reasons, before the motor moves.

use std::path::PathBuf;

use super::failure::Failure;
use super::output;
use crate::app::files::read_model;
use crate::app::tune::TuneResult;
use drivebench_control::LoopTiming;
use drivebench_control::tuning::{NotchUse, Request, Rule};

/// Gains of a speed regulator from an identified model, with reasons, margins and the predicted step response
#[derive(clap::Args)]
#[command(after_help = "Examples:
  drivebench tune --model model.toml                          100 Hz, one cycle of delay
  drivebench tune --model model.toml --delay-cycles 2 --rule symmetrical-optimum
  drivebench tune --model model.toml --rule pole-placement --bandwidth-hz 0.5")]
pub(super) struct Arguments {
    /// Model file with every value of the motor (drivebench identify writes one)
    #[arg(long)]
    model: PathBuf,
    /// Tuning rule
    #[arg(long, value_enum, default_value_t = RuleName::ModulusOptimum)]
    rule: RuleName,
    /// Cycles of the loop per second
    #[arg(long, value_name = "HZ", default_value_t = 100.0)]
    rate_hz: f64,
    /// From a sample to the instant at which its answer is applied, in cycles: what `speed` measures on the link
    #[arg(long, value_name = "N", default_value_t = 1.0)]
    delay_cycles: f64,
    /// Time constant of the speed's filter in the drive, ms
    #[arg(long, value_name = "MS", default_value_t = 0.0)]
    filter_ms: f64,
    /// Bandwidth of the closed loop; without it the rule's own
    #[arg(long, value_name = "HZ")]
    bandwidth_hz: Option<f64>,
    /// No notch at the frequency of a coupling: for a regulator that has none; the loop is slowed down instead
    #[arg(long)]
    no_notch: bool,
    /// Print all there is to say; without it what fits 100 columns and 30 lines
    #[arg(long)]
    full: bool,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum RuleName {
    /// Kessler 1955: the large time constant is cancelled
    ModulusOptimum,
    /// Kessler 1958: for a plant that integrates
    SymmetricalOptimum,
    /// Natural frequency and damping of the slow poles
    PolePlacement,
}

impl From<RuleName> for Rule {
    fn from(name: RuleName) -> Self {
        match name {
            RuleName::ModulusOptimum => Self::ModulusOptimum,
            RuleName::SymmetricalOptimum => Self::SymmetricalOptimum,
            RuleName::PolePlacement => Self::PolePlacement,
        }
    }
}

pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    let file = read_model(&arguments.model)?;
    let timing = timing(arguments)?;
    let request = Request {
        rule: arguments.rule.into(),
        bandwidth_rad_s: arguments.bandwidth_hz.map(|hz| std::f64::consts::TAU * hz),
        notch: NotchUse::unless(arguments.no_notch),
    };
    let result = TuneResult::of(&file, &timing, &request)?;
    let (json, full) = (arguments.json, arguments.full);
    output::document(&result, json, full, &result.document(&arguments.model))
}

fn timing(arguments: &Arguments) -> Result<LoopTiming, Failure> {
    for (what, value, least, most, unit) in [
        ("rate-hz", arguments.rate_hz, 1.0, 20_000.0, " Hz"),
        ("delay-cycles", arguments.delay_cycles, 0.0, 64.0, ""),
        ("filter-ms", arguments.filter_ms, 0.0, 10_000.0, " ms"),
    ] {
        if !(least..=most).contains(&value) {
            let range = format!("{least} to {most}{unit}");
            let headline = format!("--{what} {value} is not allowed (expected {range})");
            let help = "drivebench tune --help shows the defaults";
            return Err(Failure::usage(headline, help));
        }
    }
    let period_s = 1.0 / arguments.rate_hz;
    Ok(LoopTiming {
        period_s,
        delay_s: arguments.delay_cycles * period_s,
        filter_s: 1e-3 * arguments.filter_ms,
    })
}
