//! `tune`: the gains of a speed regulator from a model and the timing of the link, with reasons, margins over the uncertainty
//! of the parameters, and the predicted step; gains from a file, which belong to the model that they were tuned on.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::commands::arguments::by_name;
use crate::report::{Bars, Document, Tone};
use crate::runtime::{Failure, Form, Terminal, read_model, read_text, speed_command};
use drivebench_control::tuning::{NotchUse, Request, Rule, Tuning, TuningError, tune_over};
use drivebench_control::{
    Actuator, LinearPlant, LoopShape, LoopTiming, Margins, PiGains, PlantError, Schedule,
    StepPoint, drawn,
};
use drivebench_model::plant::{FileHistory, Model, ModelFile};

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
    /// Tuning rule: the large time constant is cancelled (Kessler 1955), the symmetrical one for a plant that integrates
    /// (Kessler 1958), or natural frequency and damping of the slow poles
    #[arg(long, default_value = Rule::default().id(), value_parser = by_name(Rule::ALL, Rule::id))]
    rule: Rule,
    /// Cycles of the loop per second
    #[arg(long, value_name = "HZ", default_value_t = 100.0)]
    rate_hz: f64,
    /// From a sample to the instant at which the command computed from it is applied, in cycles: as measured by `speed`
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
    #[command(flatten)]
    form: Form,
}

pub(super) fn execute(arguments: &Arguments, terminal: &Terminal) -> Result<(), Failure> {
    let file = read_model(&arguments.model)?;
    let timing = timing(arguments)?;
    let request = Request {
        rule: arguments.rule,
        bandwidth_rad_s: arguments.bandwidth_hz.map(|hz| std::f64::consts::TAU * hz),
        notch: NotchUse::unless(arguments.no_notch),
    };
    let result = TuneResult::of(&file, &timing, &request)?;
    terminal.document(&result, arguments.form, &result.document(&arguments.model))
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
            return Err(Failure::usage(headline, "drivebench tune --help shows the defaults"));
        }
    }
    let period_s = 1.0 / arguments.rate_hz;
    Ok(LoopTiming {
        period_s,
        delay_s: arguments.delay_cycles * period_s,
        filter_s: 1e-3 * arguments.filter_ms,
    })
}

#[derive(Serialize)]
struct TuneResult {
    #[serde(flatten)]
    tuning: Tuning,
    step: Vec<StepPoint>,
    /// Range of the inertia, relative to the model's, in which gains can be adapted on line.
    adaptation_range: (f64, f64),
    /// Why the range ends below and above, where the tuning rule refuses a larger one.
    adaptation_ends: [Option<String>; 2],
    #[serde(skip)]
    history: FileHistory,
}

impl TuneResult {
    pub(crate) fn of(
        file: &ModelFile,
        timing: &LoopTiming,
        request: &Request,
    ) -> Result<Self, Failure> {
        let own = plant(&file.model)?;
        let draws = drawn(&file.model, &file.history.fitted, plant);
        let mut tuning = tune_over(&own, &draws, timing, request)?;
        tuning.put_band(&draws);
        let schedule = Schedule::new(&own, &draws, timing, request)?;
        let why = |error: &Option<TuningError>| error.as_ref().map(ToString::to_string);
        Ok(Self {
            step: tuning.step.clone(),
            adaptation_range: schedule.range(),
            adaptation_ends: schedule.refused().each_ref().map(why),
            history: file.history.clone(),
            tuning,
        })
    }

    pub(crate) fn document(&self, model: &Path) -> Document {
        let Tuning { rule, gains, margins, response, reasons, .. } = &self.tuning;
        let (kp, tn_s) = (gains.proportional, gains.integral_time_s);
        let mut sentence = format!("Kp = {kp:.4} V per rad/s, Tn = {tn_s:.4} s");
        if let Some(notch) = &gains.notch {
            let _ = write!(sentence, ", notch at {:.1} Hz", notch.frequency_hz);
        }
        if gains.reference_filter_s > 0.0 {
            let _ = write!(sentence, ", reference filter {:.4} s", gains.reference_filter_s);
        }
        let mut document = Document::of(Tone::Good, rule.name(), sentence);
        document.say("why", reasons.iter().map(String::as_str), 1);
        let drawn = self.tuning.draws.as_ref().map(|draws| {
            let (count, stable) = (draws.count, 100.0 * draws.stable_share);
            let worst = margins_text(&draws.worst);
            format!("worst of {count} draws of the parameters ({stable:.0} % stable): {worst}")
        });
        let margins = [margins_text(margins)].into_iter().chain(drawn);
        document.say("margins", margins, 2);
        let (low, high) = self.adaptation_range;
        let range = format!(
            "gains can be adapted to an inertia of {low:.2} to {high:.1} times the model's"
        );
        let ends = ["below", "above"].into_iter().zip(&self.adaptation_ends);
        let ends = ends.filter_map(|(side, why)| Some(format!("{side}: {}", why.as_ref()?)));
        document.say("range", [range].into_iter().chain(ends), 2);
        let settling = match response.settling_s {
            None => "does not settle".to_owned(),
            Some(s) => format!("settles within 5 % in {s:.3} s"),
        };
        let overshoot = response.overshoot_percent;
        let step =
            format!("overshoot {overshoot:.1} %, {settling}; linear prediction without limits");
        document.say("step", [step], 1);
        // Sixteen lines of the predicted step response.
        let shown_s = 2.0 * response.settling_s.unwrap_or(1.0).max(0.01);
        let last = self.step.partition_point(|point| point.time_s <= shown_s).max(2);
        let bars = (0..16).map(|n| &self.step[n * (last - 1) / 15]).map(|point| {
            let (time_s, speed) = (point.time_s, point.speed);
            let band = point
                .low
                .zip(point.high)
                .map_or_else(String::new, |(low, high)| format!("  {low:.3} to {high:.3}"));
            (format!("{time_s:>8.3} s"), speed, format!("{speed:.3}{band}"))
        });
        document.bars("", Bars::new(bars.collect(), "speed over its reference"));
        document.go_on(speed_command(&self.history, model, ""));
        document
    }
}

/// The plant of a regulator that sets the voltage.
fn plant(model: &Model) -> Result<LinearPlant, PlantError> {
    LinearPlant::of(model, Actuator::Voltage, 0.0)
}

/// What `tune --json` prints, as far as a regulator needs it.
#[derive(Deserialize)]
pub(crate) struct KeptGains {
    pub(crate) gains: PiGains,
    pub(crate) timing: LoopTiming,
    margins: KeptMargins,
}

#[derive(Deserialize)]
struct KeptMargins {
    phase_margin_deg: f64,
    crossover_rad_s: f64,
}

impl KeptGains {
    /// Reads gains; refuses them where their margins with this model differ from those at tuning.
    pub(crate) fn read(path: &Path, model: &Model) -> Result<Self, Failure> {
        let name = path.display();
        let kept: Self = serde_json::from_str(&read_text(path)?).map_err(|error| {
            let headline = format!("{name}: not the result of a tuning: {error}");
            Failure::usage(headline, "write it with `drivebench tune --model MODEL.toml --json`")
        })?;
        let present = LoopShape::new(&plant(model)?, &kept.timing, &kept.gains).margins();
        let tuned = &kept.margins;
        let phase = (present.phase_margin_deg - tuned.phase_margin_deg).abs();
        let crossover = (present.crossover_rad_s / tuned.crossover_rad_s - 1.0).abs();
        // Rounding of the file, in degrees and as a share.
        if phase <= 1e-3 && crossover <= 1e-3 {
            return Ok(kept);
        }
        let headline = format!(
            "{name}: gains of another model: phase margin {:.1} degrees at {:.1} rad/s when tuned, {:.1} degrees at {:.1} rad/s with this model",
            tuned.phase_margin_deg,
            tuned.crossover_rad_s,
            present.phase_margin_deg,
            present.crossover_rad_s
        );
        let help = "tune this model: `drivebench tune --model MODEL.toml --json`";
        Err(Failure::usage(headline, help))
    }
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
