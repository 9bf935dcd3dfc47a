//! `speed`: the adaptive speed loop. Checks, the delay at rest, gains, the loop, its record.
//!
//! ```text
//! bench file, model -> refused? -> link, checks -> delay measured at rest -> gains -> loop -> run folder, figures
//! ```

use std::path::PathBuf;

use serde::Serialize;
use serde_json::json;

use crate::commands::arguments::LiveArguments;
use crate::commands::run::{tell_checks, with_model};
use crate::commands::{by_hand, cards, pages};
use crate::runtime::controls::Controls;
use crate::runtime::ending::conduct;
use crate::runtime::failure::Failure;
use crate::runtime::files::Recorded;
use crate::runtime::opening::wired_profile;
use crate::runtime::rig::{OpenRig, Rig, RigOptions, SpeedAbout, nameplate};
use crate::runtime::{files, output};
use drivebench_bench::recording::RunFile;
use drivebench_bench::{
    BenchFile, CheckReport, ControllerKind, Design, EMBEDDED_NAME, ForwardUse, Limits, LoopDelay,
    Nameplate, PilotSettings, Reference, Regulator, RegulatorError, RunSummary, SpeedPilot,
    SpeedSection, loop_timing,
};
use drivebench_control::Actuator;
use drivebench_control::tuning::Rule;
use drivebench_link::offer::Purpose;
use drivebench_model::plant::{Model, ModelFile, Motor, TorqueMap};
use drivebench_model::sample::Channel;

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
    /// off, on, or compare: what motion and the model's effects cost is given as far ahead as it takes to act; compare
    /// follows the reference twice, without and with, and shows both tracking errors. Overrides the bench file
    #[arg(long, value_name = "USE", value_parser = forward_use)]
    feed_forward: Option<ForwardUse>,
    /// Friction or cogging as measured (`export --torque-map`, CSV), in the place of the model's wherever it has a value;
    /// one of each
    #[arg(long, value_name = "MAP.csv")]
    feed_forward_map: Vec<PathBuf>,
    /// voltage, current or speed: the quantity that is commanded; overrides the bench file
    #[arg(long, value_name = "QUANTITY", value_parser = actuator)]
    actuator: Option<Actuator>,
    /// Only to say why not.
    #[arg(long, hide = true)]
    escalate: bool,
}

fn controller(text: &str) -> Result<ControllerKind, String> {
    let all = ControllerKind::ALL.map(ControllerKind::id);
    ControllerKind::from_id(text).ok_or_else(|| expected(&all))
}

fn forward_use(text: &str) -> Result<ForwardUse, String> {
    let all = ForwardUse::ALL.map(ForwardUse::id);
    ForwardUse::from_id(text).ok_or_else(|| expected(&all))
}

fn actuator(text: &str) -> Result<Actuator, String> {
    let all = Actuator::ALL.map(Actuator::name);
    Actuator::from_name(text).ok_or_else(|| expected(&all))
}

fn expected(all: &[&str]) -> String {
    format!("expected one of {}", all.join(", "))
}

pub(super) fn execute(arguments: Arguments) -> Result<(), Failure> {
    if arguments.escalate {
        return Err(Failure::usage(
            "--escalate finds an unknown motor, and a speed loop needs one that is known",
            "`drivebench run --escalate` first, then --model with the model.toml of its run folder",
        ));
    }
    let (json, full) = (arguments.live.json, arguments.live.full);
    let words = arguments.live.words();
    let source = arguments.live.source()?;
    let request = SpeedRequest {
        rig: arguments.live.options(false)?,
        source,
        model: arguments.model,
        controller: arguments.controller,
        feed_forward: arguments.feed_forward,
        maps: arguments.feed_forward_map,
        actuator: arguments.actuator,
    };
    let done = conduct(arguments.live.audience(None), move |strings| {
        speed(request, Box::new(Rig::open), strings)
    })?;
    let (result, recorded) = (speed_result(&done.work), &done.work.recorded);
    let seen = by_hand::go_on(&done.left, recorded.folder.path());
    let written = seen.as_ref().ok().cloned().flatten();
    let document = with_model(cards::speed(&result, recorded, &words), written);
    output::document(&result, json, full, &document)?;
    done.left.conclude(done.work.recorded.failure()).and(seen.map(drop))
}

/// Standard deviation of a speed sample below which a sensor is not believed to be quieter, rad/s.
const LEAST_NOISE_RAD_S: f64 = 0.02;

/// What is asked of a speed loop.
pub struct SpeedRequest {
    pub rig: RigOptions,
    /// Name and text of the bench file, for what is wrong in it.
    pub source: (String, String),
    /// Model that the loop is tuned on; `None`: the nameplate.
    pub model: Option<PathBuf>,
    pub controller: Option<ControllerKind>,
    pub feed_forward: Option<ForwardUse>,
    /// Measured torques that are given forward in the place of the model's, as `export --torque-map` writes them.
    pub maps: Vec<PathBuf>,
    pub actuator: Option<Actuator>,
}

/// The result as JSON.
#[derive(Serialize)]
pub struct SpeedResult<'a> {
    pub(crate) folder: String,
    rule: Rule,
    /// The model's file, or `nameplate`.
    model: String,
    #[serde(skip)]
    pub(super) motor: &'a Motor,
    /// At rest, before the loop was tuned; null where the drive does not say when a command was applied.
    pub(crate) delay_at_rest: Option<LoopDelay>,
    #[serde(flatten)]
    pub(crate) summary: &'a RunSummary,
}

impl SpeedResult<'_> {
    /// The model's file as a shell takes it; none where the loop was tuned on the nameplate.
    pub(super) fn model_file(&self) -> Option<String> {
        (self.model != NAMEPLATE).then(|| output::quoted_word(&self.model))
    }
}

/// What the loop was tuned on where no model was given.
const NAMEPLATE: &str = "nameplate";

/// A loop that was recorded.
pub struct SpeedDone {
    pub recorded: Recorded,
    rule: Rule,
    model: String,
    /// What the loop was tuned on.
    motor: Motor,
    delay: Option<LoopDelay>,
}

/// What a loop is made from, all of it known before the link is opened.
struct LoopParts {
    section: SpeedSection,
    actuator: Actuator,
    reference: Reference,
    motor: Nameplate,
    limits: Limits,
    model: ModelFile,
    maps: Vec<TorqueMap>,
    period_s: f64,
}

impl LoopParts {
    fn new(request: &SpeedRequest, bench: &mut BenchFile) -> Result<Self, Failure> {
        let (profile, _) = wired_profile(bench)?;
        let Some(section) = &mut bench.speed else {
            let name = &bench.name;
            let headline =
                format!("the bench {name:?} has no [speed]: there is no reference to follow");
            let help = "see [speed] in bench-configs/benches/zk-22fc-emulated.toml";
            return Err(Failure::usage(headline, help));
        };
        section.controller = request.controller.unwrap_or(section.controller);
        section.feed_forward = request.feed_forward.unwrap_or(section.feed_forward);
        section.actuator = request.actuator.or(section.actuator);
        let section = section.clone();
        let (file, text) = &request.source;
        bench.check_speed(file, text)?;
        let actuator = section.actuator(&profile.capabilities).ok_or_else(|| {
            let wanted = section.actuator.map_or("", Actuator::name);
            Failure::usage(format!(
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
        if bench.motor.is_unknown() && bench.nameplate().is_some() {
            return Err(Failure::usage(
                "motor.unknown is set: no speed loop is closed around a motor that nobody has checked",
                "`drivebench run` finds it from small steps; put what it found into [motor] and take `unknown` out",
            ));
        }
        let motor = nameplate(bench)?;
        let reference = bench
            .reference(&section)
            .map_err(|error| Failure::usage(error.to_string(), "see [speed] of the bench file"))?;
        let model = match &request.model {
            Some(path) => files::read_model(path)?,
            None => ModelFile { model: Model::baseline(motor.motor()), ..ModelFile::default() },
        };
        let maps = maps(&request.maps, section.feed_forward)?;
        let limits = bench.limits();
        if limits.quadrants < 4
            && let Some(speed) = reference.reverse_rad_s()
        {
            let quadrants = limits.quadrants;
            return Err(Failure::usage(
                format!(
                    "the reference asks for {speed} rad/s, and the drive's converter has {quadrants} of 4 quadrants: it goes one way only"
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
            maps,
            period_s: bench.period_s(),
        })
    }

    /// The loop for a delay of the link.
    fn regulator(&self, delay_s: f64, noise_rad_s: f64) -> Result<Regulator, RegulatorError> {
        // A bridge that has just fired takes a command with its next firing only.
        let delay_s = delay_s + self.limits.dead_time_s;
        Design {
            model: &self.model.model,
            fitted: &self.model.history.fitted,
            motor: &self.motor,
            limits: &self.limits,
            section: &self.section,
            maps: &self.maps,
            actuator: self.actuator,
            timing: loop_timing(&self.model.model, self.period_s, delay_s),
            noise_rad_s,
            peak_reference_rad_s: self.reference.peak_rad_s(),
        }
        .regulator()
    }
}

/// The maps of the files, one of each torque.
fn maps(paths: &[PathBuf], used: ForwardUse) -> Result<Vec<TorqueMap>, Failure> {
    if !paths.is_empty() && used == ForwardUse::Off {
        let help = "add --feed-forward on, or compare to see what it is worth";
        return Err(Failure::usage("a feed-forward map is given, and feed-forward is off", help));
    }
    let mut maps: Vec<TorqueMap> = Vec::new();
    for path in paths {
        let text = files::read_text(path)?;
        let map = TorqueMap::from_csv(&text).map_err(|error| {
            let help = "`drivebench export --torque-map friction ... --to csv` writes one";
            Failure::usage(format!("{}: {error}", path.display()), help)
        })?;
        if maps.iter().any(|other| other.torque == map.torque) {
            let name = map.torque.name();
            let headline = format!("{}: a second {name} map", path.display());
            return Err(Failure::usage(headline, "give one of each torque"));
        }
        maps.push(map);
    }
    Ok(maps)
}

/// Regulates the speed over the rig that `open` gives.
///
/// # Errors
/// What stood in the way of a run; how a run that began went is in its record.
pub fn speed(
    asked: SpeedRequest,
    open: OpenRig,
    controls: &Controls,
) -> Result<SpeedDone, Failure> {
    let mut bench = asked.rig.bench.clone();
    let request = LoopParts::new(&asked, &mut bench)?;
    // With the least delay that an exchange can have: what is refused now is refused before anything is opened.
    request.regulator(request.period_s, LEAST_NOISE_RAD_S)?;
    let mut rig = open(asked.rig, None, Purpose::SpeedLoop)?;
    rig.bench.speed = Some(request.section.clone());
    let report = rig.check(controls)?;
    let delay = rig.measure_delay(controls)?;
    let noise_rad_s = noise(&report);
    let delay_s = delay.map_or(request.period_s, |delay| delay.median_s);
    let mut regulator = request.regulator(delay_s, noise_rad_s)?;
    let reasons = &mut regulator.reasons;
    let history = &request.model.history;
    let bench = &rig.bench.name;
    if asked.source.0 == EMBEDDED_NAME && history.is_of_another_bench(bench) {
        let runs = history.fitted_on.join(", ");
        let text = format!(
            "no bench file is given, so this is the embedded bench {bench:?}; the model was fitted on {runs}"
        );
        output::message(&format!("warning: {text}"));
        reasons.push(text);
    }
    reasons.extend(unwatched(&report, request.actuator));
    reasons.extend(converter(&request.limits));
    let model = match &asked.model {
        Some(path) => path.display().to_string(),
        None => NAMEPLATE.to_owned(),
    };
    if rig.asked.headless {
        tell(&report, delay.as_ref(), &regulator, asked.model.is_none());
    }
    let about = SpeedAbout {
        model: request.model.to_toml(),
        manifest: json!({
            "controller": request.section.controller,
            "actuator": request.actuator,
            "rule": request.section.rule(request.actuator),
            "feed_forward": request.section.feed_forward,
            "feed_forward_maps": asked.maps.iter().map(|path| path.display().to_string()).collect::<Vec<_>>(),
            "model": model,
            "delay_at_rest": delay,
            "timing": regulator.timing,
            "reasons": regulator.reasons,
            "limiter": regulator.limiter,
        }),
    };
    let (section, limits) = (&request.section, &request.limits);
    let settings = PilotSettings {
        slew_v_per_s: section.slew_v_per_s(&request.motor, limits, request.period_s),
        silence_s: request.limits.link_silence_s,
        hold: hold(&request),
    };
    let rule = request.section.rule(request.actuator);
    let pilot = SpeedPilot::new(regulator, request.reference, settings);
    let name = format!("{}-speed", rig.bench.name);
    let mut whole = SpeedDone {
        recorded: rig.record_loop(&name, pilot, about, controls)?,
        rule,
        model,
        motor: request.model.model.motor.clone(),
        delay,
    };
    whole.recorded.write(RunFile::Model, &request.model.to_toml());
    let result = serde_json::to_value(speed_result(&whole)).unwrap_or_default();
    whole.recorded.write_result(&result);
    let loop_report = whole.recorded.summary.speed.as_ref();
    let adaptation = loop_report.and_then(|report| report.adaptation.clone());
    if let Some(text) = adaptation {
        whole.recorded.write(RunFile::Adaptation, &text);
    }
    if whole.recorded.summary.speed.is_some() {
        let page = cards::speed_loop(&speed_result(&whole));
        let plate = request.motor.motor();
        pages::write_run(&mut whole.recorded, None, &plate, Some(&page));
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
    Some(format!("a broken encoder is noticed by a runaway and the speed limit only: {because}"))
}

/// What the converter does to the loop.
fn converter(limits: &Limits) -> Option<String> {
    let dead_ms = 1e3 * limits.dead_time_s;
    (dead_ms > 0.0).then(|| {
        format!(
            "thyristor bridge: {dead_ms:.1} ms of dead time are in the delay that the loop is tuned for"
        )
    })
}

/// What holds a load at rest, in the unit of the command.
fn hold(request: &LoopParts) -> f64 {
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
    let mut floors = report.noise.iter();
    let of_speed = floors.find(|floor| floor.channel == Channel::Speed);
    of_speed.map_or(LEAST_NOISE_RAD_S, |floor| floor.std.max(LEAST_NOISE_RAD_S))
}

/// Checks, delay and gains, for who reads along.
fn tell(
    report: &CheckReport,
    delay: Option<&LoopDelay>,
    regulator: &Regulator,
    by_nameplate: bool,
) {
    tell_checks(report);
    if by_nameplate {
        output::message("no --model: the loop is tuned on the nameplate of the bench file");
    }
    let text = match delay {
        Some(delay) => {
            let (text, commands) = (delay_text(delay), delay.measured);
            format!("{text}; measured at rest on {commands} commands")
        }
        None => "1 cycle is taken: the drive does not say when a command was applied".to_owned(),
    };
    output::message(&format!("{:<18} {text}", "loop delay"));
    let controller = regulator.passes.first().map_or("", |(_, first)| first.id());
    for reason in &regulator.reasons {
        output::message(&format!("{controller:<18} {reason}"));
    }
}

pub(crate) fn delay_text(delay: &LoopDelay) -> String {
    let (median, p99) = (delay.median_cycles, delay.p99_cycles);
    let median_ms = 1e3 * delay.median_s;
    format!("{median:.2} cycles ({median_ms:.2} ms), 99 % within {p99:.2}")
}

/// What a loop has to say, for its folder and for whoever asked for it.
pub(crate) fn speed_result(whole: &SpeedDone) -> SpeedResult<'_> {
    SpeedResult {
        folder: whole.recorded.folder.path().display().to_string(),
        rule: whole.rule,
        model: whole.model.clone(),
        motor: &whole.motor,
        delay_at_rest: whole.delay,
        summary: &whole.recorded.summary,
    }
}
