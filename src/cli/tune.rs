//! `tune`: from a model and the link's timing to the gains of a speed regulator, with reasons, before the motor moves.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::failure::Failure;
use super::output;
use crate::app::files::read_model;
use crate::control::tuning::{Request, Rule, Tuning, tune};
use crate::control::{LinearPlant, LoopShape, LoopTiming, Margins, Schedule, StepPoint};
use crate::plant::{Model, ModelError, ModelFile, MotorKey};
use crate::report::{Card, Tone};

/// Standard deviations of the inertia at whose ends the loop is looked at.
const DOUBT: f64 = 2.0;
/// Lines of the predicted step response.
const LINES: usize = 16;

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

/// The same gains on a motor whose inertia is at an end of its interval.
#[derive(Serialize)]
struct Corner {
    inertia_kg_m2: f64,
    margins: Margins,
}

#[derive(Serialize)]
struct TuneResult<'a> {
    #[serde(flatten)]
    tuning: &'a Tuning,
    step: &'a [StepPoint],
    /// At the ends of the inertia's interval, where the model file gives its standard deviation.
    corners: Vec<Corner>,
    /// Inertia over the model's between which gains can follow it on line.
    adaptation_range: (f64, f64),
}

pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    let file = read_model(&arguments.model)?;
    let plant = LinearPlant::voltage(&file.model, viscous_n_m_s_per_rad(&file.model)?)?;
    let timing = timing(arguments)?;
    let request = Request {
        rule: arguments.rule.into(),
        bandwidth_rad_s: arguments.bandwidth_hz.map(|hz| std::f64::consts::TAU * hz),
    };
    let tuning = tune(&plant, &timing, &request)?;
    let corners = corners(&file, &plant, &tuning);
    let result = TuneResult {
        step: &tuning.step,
        corners,
        adaptation_range: Schedule::new(&plant, &timing, &request)?.range(),
        tuning: &tuning,
    };
    let (json, full) = (arguments.json, arguments.full);
    output::card(&result, json, full, Vec::new(), || {
        card(&result, &arguments.model)
    })
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

/// Slope of the friction as the model has it.
fn viscous_n_m_s_per_rad(model: &Model) -> Result<f64, ModelError> {
    let mut effects = model.effects.iter();
    let Some(viscous) = effects.find(|active| active.id() == "viscous_friction") else {
        return Ok(0.0);
    };
    viscous.values[0].ok_or_else(|| ModelError::Unset {
        key: format!("{}.{}", viscous.id(), viscous.effect.parameters()[0].key),
    })
}

fn corners(file: &ModelFile, plant: &LinearPlant, tuning: &Tuning) -> Vec<Corner> {
    let key = MotorKey::Inertia.key();
    let std = file.history.fitted.iter().find(|fitted| fitted.key == key);
    let (Some(std), Some(inertia)) = (std, file.model.motor.get(MotorKey::Inertia)) else {
        return Vec::new();
    };
    let ends = [-DOUBT, DOUBT].map(|doubt| inertia + doubt * std.std);
    let corners = ends.into_iter().filter(|value| *value > 0.0).map(|value| {
        let plant = plant.with_inertia_ratio(value / inertia);
        Corner {
            inertia_kg_m2: value,
            margins: LoopShape::new(&plant, &tuning.timing, &tuning.gains).margins(),
        }
    });
    corners.collect()
}

fn card(result: &TuneResult<'_>, model: &Path) -> Card {
    let Tuning {
        rule,
        gains,
        margins,
        response,
        reasons,
        ..
    } = result.tuning;
    let (kp, tn_s) = (gains.proportional, gains.integral_time_s);
    let mut sentence = format!("Kp = {kp:.4} V per rad/s, Tn = {tn_s:.4} s");
    if gains.reference_filter_s > 0.0 {
        let _ = write!(
            sentence,
            ", reference filter {:.4} s",
            gains.reference_filter_s
        );
    }
    let mut card = Card::new(Tone::Good, rule.name(), &sentence);
    card.say("why", reasons.iter().map(String::as_str), 1);
    let corners = result.corners.iter().map(|corner| {
        let margins = margins_text(&corner.margins);
        format!("at {:.5} kg.m2: {margins}", corner.inertia_kg_m2)
    });
    let margins = [margins_text(margins)].into_iter().chain(corners);
    card.say("margins", margins.collect::<Vec<_>>(), 3);
    let (low, high) = result.adaptation_range;
    let range = format!("gains can follow an inertia of {low:.2} to {high:.1} times the model's");
    card.say("range", [range], 1);
    let settling = match response.settling_s {
        None => "does not settle".to_owned(),
        Some(s) => format!("settles within 5 % in {s:.3} s"),
    };
    let overshoot = response.overshoot_percent;
    let step = format!("overshoot {overshoot:.1} %, {settling}; linear, no limit is met");
    card.say("step", [step], 1);
    let shown_s = 2.0 * response.settling_s.unwrap_or(1.0).max(0.01);
    let last = result
        .step
        .partition_point(|point| point.time_s <= shown_s)
        .max(2);
    let points = (0..LINES).map(|n| &result.step[n * (last - 1) / (LINES - 1)]);
    let bars = points.map(|point| {
        let (time_s, speed) = (point.time_s, point.speed);
        (format!("{time_s:>8.3} s"), speed, format!("{speed:.3}"))
    });
    card.bars("", bars.collect(), "speed over its reference");
    let model = output::quoted(model);
    card.go_on(format!("drivebench speed --model {model}"));
    card
}

fn margins_text(margins: &Margins) -> String {
    let bandwidth_rad_s = margins.bandwidth_rad_s;
    let bandwidth = if bandwidth_rad_s.is_finite() {
        let hertz = bandwidth_rad_s / std::f64::consts::TAU;
        format!("bandwidth {bandwidth_rad_s:.2} rad/s ({hertz:.2} Hz)")
    } else {
        "no bandwidth (it never falls by 3 dB)".to_owned()
    };
    format!(
        "phase {:.0} degrees, gain {:.2} times, crossover {:.2} rad/s, {bandwidth}, radius {:.4}",
        margins.phase_margin_deg, margins.gain_margin, margins.crossover_rad_s, margins.radius
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plant::Motor;

    #[test]
    fn a_friction_without_a_value_is_none_to_tune_for() {
        let mut model = Model::baseline(Motor::zk_22fc());
        assert_eq!(viscous_n_m_s_per_rad(&model), Ok(0.0));
        model = model.with_effect("viscous_friction").unwrap();
        let key = "viscous_friction.viscous_n_m_s_per_rad".to_owned();
        assert_eq!(
            viscous_n_m_s_per_rad(&model),
            Err(ModelError::Unset { key })
        );
        model.effects[0].values[0] = Some(2e-4);
        assert_eq!(viscous_n_m_s_per_rad(&model), Ok(2e-4));
    }
}
