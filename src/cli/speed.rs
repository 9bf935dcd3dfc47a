//! `speed`: the adaptive speed loop over the real link, with the live screen or without.
//!
//! ```text
//! bench file, model -> refused? -> link, checks -> delay measured at rest -> gains -> loop -> run folder, figures
//! ```

use std::fmt::Write as _;
use std::path::PathBuf;

use serde::Serialize;
use serde_json::json;

use super::failure::{Failure, USAGE};
use super::live::{LiveArguments, Rig, SpeedAbout, Strings};
use super::recorded::Recorded;
use super::speed_page::speed_loop;
use super::{data, output, pages, screen};
use crate::bench::{
    BenchFile, CheckReport, ControllerKind, Design, EMBEDDED_NAME, ForwardUse, Limits, LoopDelay,
    Nameplate, PilotSettings, Reference, Regulator, RegulatorError, RunSummary, SpeedPilot,
    SpeedSection, loop_timing,
};
use crate::control::Actuator;
use crate::control::tuning::Rule;
use crate::drive::offer::Purpose;
use crate::plant::{Model, ModelFile};
use crate::recording::RunFile;
use crate::sample::Channel;

/// Standard deviation of a speed sample below which a sensor is not believed to be quieter, rad/s.
const LEAST_NOISE_RAD_S: f64 = 0.02;

/// Regulate the speed over the link and adapt on line; live screen unless --headless
#[derive(clap::Args)]
#[command(after_help = "Examples:
  drivebench speed --headless                            the emulated motor, the reference of the embedded bench
  drivebench speed bench.toml --model model.toml --port /dev/ttyUSB0 --hardware --headless
  drivebench speed --model model.toml --feed-forward compare    what the model's effects are worth
  drivebench speed --port sim: --emulator zk-22fc-changing --controller pi   fixed gains and a load that changes")]
pub(super) struct Arguments {
    #[command(flatten)]
    live: LiveArguments,
    /// Model that the loop is tuned on; without it the nameplate of the bench file
    #[arg(long, value_name = "MODEL")]
    model: Option<PathBuf>,
    /// pi, addc, mrac, paper-b or load-observer; overrides the bench file
    #[arg(long, value_name = "CONTROLLER", value_parser = controller)]
    controller: Option<ControllerKind>,
    /// off, on, or compare: what the model's effects cost is given before the error asks for it; compare follows the
    /// reference twice, without and with, and shows both tracking errors. Overrides the bench file
    #[arg(long, value_name = "USE", value_parser = forward_use)]
    feed_forward: Option<ForwardUse>,
    /// voltage, current or speed: the quantity that is commanded; overrides the bench file
    #[arg(long, value_name = "QUANTITY", value_parser = actuator)]
    actuator: Option<Actuator>,
    /// Only to say why not.
    #[arg(long, hide = true)]
    escalate: bool,
}

fn controller(text: &str) -> Result<ControllerKind, String> {
    ControllerKind::from_id(text).ok_or_else(|| {
        let all = ControllerKind::ALL.map(ControllerKind::id);
        format!("expected one of {}", all.join(", "))
    })
}

fn forward_use(text: &str) -> Result<ForwardUse, String> {
    ForwardUse::from_id(text).ok_or_else(|| {
        let all = ForwardUse::ALL.map(ForwardUse::id);
        format!("expected one of {}", all.join(", "))
    })
}

fn actuator(text: &str) -> Result<Actuator, String> {
    Actuator::from_name(text).ok_or_else(|| {
        let all = Actuator::ALL.map(Actuator::name);
        format!("expected one of {}", all.join(", "))
    })
}

/// The result as JSON.
#[derive(Serialize)]
struct SpeedResult<'a> {
    folder: String,
    rule: Rule,
    /// The model's file, or `nameplate`.
    model: String,
    /// At rest, before the loop was tuned; null where the drive does not say when a command was applied.
    delay_at_rest: Option<LoopDelay>,
    #[serde(flatten)]
    summary: &'a RunSummary,
}

/// A loop that was recorded.
struct Whole {
    recorded: Recorded,
    rule: Rule,
    model: String,
    delay: Option<LoopDelay>,
}

pub(super) fn execute(arguments: Arguments) -> Result<(), Failure> {
    let json = arguments.live.json;
    let (strings, intents) = Strings::new()?;
    let whole = if arguments.live.is_headless() {
        record(&arguments, &strings)?
    } else {
        let work = move |strings: &Strings| record(&arguments, strings);
        screen::watch(strings, intents, None, work)?.0
    };
    let shown = result(&whole);
    output::result(&shown, json, text)?;
    whole.recorded.failure().map_or(Ok(()), Err)
}

/// What a loop is made from, all of it known before the link is opened.
struct Request {
    section: SpeedSection,
    actuator: Actuator,
    reference: Reference,
    motor: Nameplate,
    limits: Limits,
    model: ModelFile,
    period_s: f64,
}

impl Request {
    fn new(arguments: &Arguments, bench: &mut BenchFile) -> Result<Self, Failure> {
        if arguments.escalate {
            return Err(Failure::with_help(
                USAGE,
                "--escalate finds an unknown motor, and a speed loop needs one that is known",
                "`drivebench run --escalate` first, then --model with the model.toml of its run folder",
            ));
        }
        let (profile, _) = super::live_link::wired_profile(bench)?;
        let Some(section) = &mut bench.speed else {
            return Err(Failure::with_help(
                USAGE,
                format!(
                    "the bench {:?} has no [speed]: there is no reference to follow",
                    bench.name
                ),
                "see [speed] in bench-configs/benches/zk-22fc-emulated.toml",
            ));
        };
        section.controller = arguments.controller.unwrap_or(section.controller);
        section.feed_forward = arguments.feed_forward.unwrap_or(section.feed_forward);
        section.actuator = arguments.actuator.or(section.actuator);
        let section = section.clone();
        let (file, text) = match &arguments.live.bench {
            Some(path) => (path.display().to_string(), data::read_text(path)?),
            None => (EMBEDDED_NAME.to_owned(), String::new()),
        };
        bench.check_speed(&file, &text)?;
        let actuator = section.actuator(&profile.capabilities).ok_or_else(|| {
            let wanted = section.actuator.map_or("", Actuator::name);
            Failure::with_help(
                USAGE,
                format!(
                    "the drive {:?} takes no {wanted} command that a speed loop could act with",
                    bench.drive.profile
                )
                .replace("  ", " "),
                if profile.registers.is_some() {
                    "see quantity and unit of the [setpoints] in the drive's profile, and speed.actuator of the bench file"
                } else {
                    "see [capabilities] of the drive's profile, and speed.actuator of the bench file"
                },
            )
        })?;
        let motor = super::live::nameplate(bench)?;
        let reference = bench.reference(&section).map_err(|error| {
            Failure::with_help(USAGE, error.to_string(), "see [speed] of the bench file")
        })?;
        let model = match &arguments.model {
            Some(path) => data::read_model(path)?,
            None => ModelFile {
                model: Model::baseline(motor.motor()),
                ..ModelFile::default()
            },
        };
        let limits = bench.limits();
        if limits.quadrants < 4
            && let Some(speed) = reference.reverse_rad_s()
        {
            return Err(Failure::with_help(
                USAGE,
                format!(
                    "the reference asks for {speed} rad/s, and the drive's converter has {} of 4 quadrants: it goes one way only",
                    limits.quadrants
                ),
                "use references that are not negative; see [converter] of the drive's profile",
            ));
        }
        Ok(Self {
            section,
            actuator,
            reference,
            limits,
            motor,
            model,
            period_s: bench.period_s(),
        })
    }

    /// The loop for a delay of the link.
    fn regulator(&self, delay_s: f64, noise_rad_s: f64) -> Result<Regulator, RegulatorError> {
        Design {
            model: &self.model.model,
            motor: &self.motor,
            limits: &self.limits,
            section: &self.section,
            actuator: self.actuator,
            // A bridge that has just fired takes a command with its next firing only.
            timing: loop_timing(
                &self.model.model,
                self.period_s,
                delay_s + self.limits.dead_time_s,
            ),
            noise_rad_s,
            peak_reference_rad_s: self.reference.peak_rad_s(),
        }
        .regulator()
    }
}

fn record(arguments: &Arguments, strings: &Strings) -> Result<Whole, Failure> {
    let mut bench = arguments.live.bench()?;
    let request = Request::new(arguments, &mut bench)?;
    // With the least delay that an exchange can have: what is refused now is refused before anything is opened.
    request.regulator(request.period_s, LEAST_NOISE_RAD_S)?;
    let mut rig = Rig::open(&arguments.live, None, Purpose::SpeedLoop)?;
    rig.bench.speed = Some(request.section.clone());
    let report = rig.check(strings)?;
    let delay = rig.measure_delay()?;
    let noise_rad_s = noise(&report);
    let mut regulator = request.regulator(
        delay.map_or(request.period_s, |delay| delay.median_s),
        noise_rad_s,
    )?;
    regulator
        .reasons
        .extend(unwatched(&report, request.actuator));
    regulator.reasons.extend(converter(&request.limits));
    let model = match &arguments.model {
        Some(path) => path.display().to_string(),
        None => "nameplate".to_owned(),
    };
    if rig.is_headless() {
        tell(
            &report,
            delay.as_ref(),
            &regulator,
            arguments.model.is_none(),
        );
    }
    let about = SpeedAbout {
        model: request.model.to_toml(),
        manifest: json!({
            "controller": request.section.controller,
            "actuator": request.actuator,
            "rule": request.section.rule(request.actuator),
            "feed_forward": request.section.feed_forward,
            "model": model,
            "delay_at_rest": delay,
            "timing": regulator.timing,
            "reasons": regulator.reasons,
            "limiter": regulator.limiter,
        }),
    };
    let settings = PilotSettings {
        slew_v_per_s: request.section.slew_v_per_s(
            &request.motor,
            &request.limits,
            request.period_s,
        ),
        silence_s: request.limits.link_silence_s,
        hold: hold(&request),
    };
    let rule = request.section.rule(request.actuator);
    let pilot = SpeedPilot::new(regulator, request.reference, settings);
    let name = format!("{}-speed", rig.bench.name);
    let whole = Whole {
        recorded: rig.record_loop(&name, pilot, about, strings)?,
        rule,
        model,
        delay,
    };
    let folder = &whole.recorded.folder;
    folder.write(RunFile::Model, &request.model.to_toml())?;
    whole.recorded.write_result(&result(&whole))?;
    if let Some(report) = &whole.recorded.summary.speed {
        let page = speed_loop(report, whole.delay.as_ref());
        let plate = request.motor.motor();
        folder.write(
            RunFile::Report,
            &pages::run(&whole.recorded, None, &plate, Some(&page))?,
        )?;
    }
    Ok(whole)
}

/// Why the speed sensor cannot be held against voltage and current, where that is so.
fn unwatched(report: &CheckReport, actuator: Actuator) -> Option<String> {
    let missing = |channel| !report.signals.contains(&channel);
    let because = match actuator {
        _ if missing(Channel::Current) => "the drive measures no current",
        Actuator::Current if missing(Channel::Voltage) => "the drive measures no voltage",
        Actuator::Speed => "the drive's own speed loop sets the voltage",
        Actuator::Voltage | Actuator::Current => return None,
    };
    Some(format!(
        "a broken encoder is noticed by a runaway and the speed limit only: {because}"
    ))
}

/// What the converter does to the loop.
fn converter(limits: &Limits) -> Option<String> {
    (limits.dead_time_s > 0.0).then(|| {
        format!(
            "thyristor bridge: {:.1} ms of dead time are in the delay that the loop is tuned for",
            1e3 * limits.dead_time_s
        )
    })
}

/// What holds a load at rest, in the unit of the command.
fn hold(request: &Request) -> f64 {
    let brake = request.limits.load.brake();
    let hold_a = brake.map_or(0.0, |brake| brake.hold_current_a);
    match request.actuator {
        Actuator::Voltage => request.motor.resistance_ohm * hold_a,
        Actuator::Current => hold_a,
        Actuator::Speed => 0.0,
    }
}

/// Noise of the speed sensor, as the checks have found it at rest.
fn noise(report: &CheckReport) -> f64 {
    let of_speed = report
        .noise
        .iter()
        .find(|floor| floor.channel == Channel::Speed);
    of_speed.map_or(LEAST_NOISE_RAD_S, |floor| floor.std.max(LEAST_NOISE_RAD_S))
}

/// Checks, delay and gains, for who reads along.
fn tell(
    report: &CheckReport,
    delay: Option<&LoopDelay>,
    regulator: &Regulator,
    by_nameplate: bool,
) {
    for item in &report.items {
        output::message(&format!("{:<18} {}", item.name, item.text));
    }
    if by_nameplate {
        output::message("no --model: the loop is tuned on the nameplate of the bench file");
    }
    output::message(&match delay {
        Some(delay) => format!(
            "{:<18} {:.2} cycles ({:.2} ms), 99 % within {:.2}; measured at rest on {} commands",
            "loop delay",
            delay.median_cycles,
            1e3 * delay.median_s,
            delay.p99_cycles,
            delay.measured
        ),
        None => format!(
            "{:<18} 1 cycle is taken: the drive does not say when a command was applied",
            "loop delay"
        ),
    });
    let controller = regulator.passes.first().map_or("", |(_, first)| first.id());
    for reason in &regulator.reasons {
        output::message(&format!("{controller:<18} {reason}"));
    }
}

fn result(whole: &Whole) -> SpeedResult<'_> {
    SpeedResult {
        folder: whole.recorded.folder.path().display().to_string(),
        rule: whole.rule,
        model: whole.model.clone(),
        delay_at_rest: whole.delay,
        summary: &whole.recorded.summary,
    }
}

fn text(result: &SpeedResult<'_>) -> String {
    let summary = result.summary;
    let mut text = format!("{}\n", result.folder);
    let _ = writeln!(
        text,
        "{}: {} rows in {:.1} s, {} cycles missed, {} of {} exchanges lost",
        summary.outcome.name(),
        summary.rows,
        summary.duration_s,
        summary.timing.missed_cycles,
        summary.link.lost(),
        summary.link.sent
    );
    let Some(report) = &summary.speed else {
        return text;
    };
    if let Some(delay) = &report.delay {
        let _ = writeln!(
            text,
            "loop delay {:.2} cycles while running, 99 % within {:.2}; tuned for {:.2}",
            delay.median_cycles,
            delay.p99_cycles,
            report.timing.delay_cycles()
        );
    }
    for change in &report.gain_changes {
        let _ = writeln!(text, "{:>8.2} s  {}", change.time_s, change.reason);
    }
    for line in &report.gains {
        let _ = writeln!(text, "at the end  {line}");
    }
    for pass in &report.tracking {
        let with = if pass.feed_forward { "with" } else { "without" };
        let _ = writeln!(
            text,
            "tracking error {with} feed-forward {:.2} rad/s rms, {:.2} mean, {:.2} at most",
            pass.rms_rad_s, pass.mean_abs_rad_s, pass.peak_rad_s
        );
    }
    if !report.steps.is_empty() {
        let _ = writeln!(
            text,
            "{:>8} {:>9} {:>9} {:>11} {:>11} {:>9} {:>9}",
            "at s", "from", "to rad/s", "overshoot %", "settling s", "IAE rad", "limited %"
        );
    }
    for step in &report.steps {
        let settling = step
            .response
            .settling_s
            .map_or_else(|| "never".to_owned(), |seconds| format!("{seconds:.3}"));
        let _ = writeln!(
            text,
            "{:>8.2} {:>9.1} {:>9.1} {:>11.1} {settling:>11} {:>9.2} {:>9.0}",
            step.step.at_s,
            step.speed_rad_s,
            step.step.to_rad_s,
            step.response.overshoot_percent,
            step.response.absolute_error_rad,
            100.0 * step.limited_share
        );
    }
    text
}

impl From<RegulatorError> for Failure {
    fn from(error: RegulatorError) -> Self {
        let help = error.help();
        Self::with_help(USAGE, error.to_string(), help)
    }
}
