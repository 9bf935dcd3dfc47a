//! `speed`: the adaptive speed loop. Checks, the delay at rest, gains, the loop, its record.
//!
//! ```text
//! bench file, model -> refused? -> link, checks -> delay measured at rest -> gains -> loop -> run folder, figures
//! ```

use std::path::PathBuf;

use serde::Serialize;
use serde_json::json;

use crate::commands::arguments::{LiveArguments, by_name};
use crate::commands::run::print_checks;
use crate::commands::{by_hand, cards, pages};
use crate::runtime::{
    Controls, Failure, Recorded, Rig, RigOptions, SpeedAbout, Terminal, conduct, files, nameplate,
    output, wired_profile,
};
use drivebench_bench::recording::RunFile;
use drivebench_bench::{
    BenchFile, CheckReport, ControllerKind, Design, EMBEDDED_NAME, ForwardUse, Limits, LoopDelay,
    Nameplate, PilotSettings, Reference, Regulator, RegulatorError, SpeedPilot, SpeedSection,
    loop_timing,
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
  drivebench speed --model model.toml --feed-forward compare    the gain by feed-forward of the model
  drivebench speed --port sim: --emulator zk-22fc-changing --controller pi   fixed gains and a load that changes")]
pub(super) struct Arguments {
    #[command(flatten)]
    live: LiveArguments,
    #[command(flatten)]
    own: LoopArguments,
    /// Refused, with the reason
    #[arg(long, hide = true)]
    escalate: bool,
}

/// The loop, where it differs from that of the bench file.
#[derive(clap::Args, Default)]
pub(crate) struct LoopArguments {
    /// Model that the loop is tuned on; without it the nameplate of the bench file
    #[arg(long, value_name = "MODEL")]
    pub(crate) model: Option<PathBuf>,
    /// The regulator; overrides the bench file
    #[arg(long, value_name = "CONTROLLER", value_parser = by_name(ControllerKind::ALL, ControllerKind::id))]
    pub(crate) controller: Option<ControllerKind>,
    /// Whether the torque of the motion and of the model's effects is fed forward, ahead by the delay of the
    /// loop; compare follows the reference twice, without and with it, and shows both tracking errors. Overrides the bench file
    #[arg(long, value_name = "USE", value_parser = by_name(ForwardUse::ALL, ForwardUse::name))]
    pub(crate) feed_forward: Option<ForwardUse>,
    /// Friction or cogging as measured (`export --torque-map`, CSV), instead of the model's wherever it has a value; at most
    /// one of each
    #[arg(long, value_name = "MAP.csv")]
    pub(crate) feed_forward_map: Vec<PathBuf>,
    /// The quantity that is commanded; overrides the bench file
    #[arg(long, value_name = "QUANTITY", value_parser = by_name(Actuator::ALL, Actuator::name))]
    pub(crate) actuator: Option<Actuator>,
}

pub(super) fn execute(arguments: Arguments, terminal: &Terminal) -> Result<(), Failure> {
    if arguments.escalate {
        return Err(Failure::usage(
            "--escalate finds an unknown motor, and a speed loop needs one that is known",
            "`drivebench run --escalate` first, then --model with the model.toml of its run folder",
        ));
    }
    let live = &arguments.live;
    let form = live.form();
    let options = live.words();
    let request = SpeedRequest {
        rig: live.options(false, terminal)?,
        source: live.source()?,
        own: arguments.own,
    };
    let done = conduct(terminal, live.audience(None), move |controls| speed(request, controls))?;
    let result = &done.work;
    let document = cards::speed(result, &options);
    by_hand::finish(done.screen, &result.recorded, result, document, form, terminal)
}

/// Least standard deviation of a speed sample, rad/s: at rest a sensor may show no noise.
const LEAST_NOISE_RAD_S: f64 = 0.02;

pub(crate) struct SpeedRequest {
    pub rig: RigOptions,
    /// Name and text of the bench file, for its errors.
    pub source: (String, String),
    pub own: LoopArguments,
}

/// A loop that was recorded.
#[derive(Serialize)]
pub(crate) struct SpeedDone {
    rule: Rule,
    /// The model's file, or `nameplate`.
    model: String,
    /// Motor that the loop was tuned on.
    #[serde(skip)]
    pub(super) motor: Motor,
    /// At rest, before the loop was tuned; null where the drive does not report when a command was applied.
    pub(super) delay_at_rest: Option<LoopDelay>,
    #[serde(flatten)]
    pub(super) recorded: Recorded,
}

impl SpeedDone {
    /// The model's file as a shell takes it; none where the loop was tuned on the nameplate.
    pub(super) fn model_file(&self) -> Option<String> {
        (self.model != NAMEPLATE).then(|| output::quoted_word(&self.model))
    }
}

/// Name of the model where none was given.
const NAMEPLATE: &str = "nameplate";

/// All of a loop that is known before the link is opened.
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
        let own = &request.own;
        section.controller = own.controller.unwrap_or(section.controller);
        section.feed_forward = own.feed_forward.unwrap_or(section.feed_forward);
        section.actuator = own.actuator.or(section.actuator);
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
                "motor.unknown is set: no speed loop is closed around a motor that is not verified",
                "`drivebench run` finds it from small steps; write the values that it found into [motor] and remove `unknown`",
            ));
        }
        let motor = nameplate(bench)?;
        let reference = bench
            .reference(&section)
            .map_err(|error| Failure::usage(error.to_string(), "see [speed] of the bench file"))?;
        let model = match &own.model {
            Some(path) => files::read_model(path)?,
            None => ModelFile { model: Model::baseline(motor.motor()), ..ModelFile::default() },
        };
        let maps = maps(&own.feed_forward_map, section.feed_forward)?;
        let limits = bench.limits();
        if limits.quadrants < 4
            && let Some(speed) = reference.reverse_rad_s()
        {
            let quadrants = limits.quadrants;
            return Err(Failure::usage(
                format!(
                    "the reference goes to {speed} rad/s, and the drive's converter has {quadrants} of 4 quadrants: it drives in one direction only"
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
        let help = "add --feed-forward on, or compare to see both tracking errors";
        return Err(Failure::usage("a feed-forward map is given, and feed-forward is off", help));
    }
    let mut maps: Vec<TorqueMap> = Vec::new();
    for path in paths {
        let map = TorqueMap::from_csv(&files::read_text(path)?).map_err(|error| {
            let help = "`drivebench export --torque-map friction ... --to csv` writes one";
            Failure::usage(format!("{}: {error}", path.display()), help)
        })?;
        if maps.iter().any(|other| other.torque == map.torque) {
            let headline = format!("{}: a second {} map", path.display(), map.torque.name());
            return Err(Failure::usage(headline, "give one of each torque"));
        }
        maps.push(map);
    }
    Ok(maps)
}

/// Regulates the speed; fails where no run begins, for the end of a run that began is in its record.
pub(crate) fn speed(request: SpeedRequest, controls: &Controls) -> Result<SpeedDone, Failure> {
    let mut bench = request.rig.bench.clone();
    let parts = LoopParts::new(&request, &mut bench)?;
    // With the least delay that an exchange can have: what is refused now is refused before anything is opened.
    parts.regulator(parts.period_s, LEAST_NOISE_RAD_S)?;
    let mut rig = Rig::open(request.rig, None, Purpose::SpeedLoop)?;
    rig.bench.speed = Some(parts.section.clone());
    let report = rig.check(controls, false)?;
    let delay = rig.measure_delay(controls)?;
    let delay_s = delay.map_or(parts.period_s, |delay| delay.median_s);
    let mut regulator = parts.regulator(delay_s, noise(&report))?;
    let history = &parts.model.history;
    let bench = &rig.bench.name;
    if request.source.0 == EMBEDDED_NAME && history.is_of_another_bench(bench) {
        let runs = history.fitted_on.join(", ");
        let text = format!(
            "no bench file is given, so this is the embedded bench {bench:?}; the model was fitted on {runs}"
        );
        rig.options.terminal.message(&format!("warning: {text}"));
        regulator.reasons.push(text);
    }
    regulator.reasons.extend(unchecked_encoder(&report, parts.actuator));
    regulator.reasons.extend(converter(&parts.limits));
    if rig.options.switches.headless {
        let by_nameplate = request.own.model.is_none();
        print_loop(&report, delay.as_ref(), &regulator, by_nameplate, &rig.options.terminal);
    }
    let model =
        request.own.model.map_or_else(|| NAMEPLATE.to_owned(), |path| path.display().to_string());
    let rule = parts.section.rule(parts.actuator);
    let maps: Vec<_> =
        request.own.feed_forward_map.iter().map(|path| path.display().to_string()).collect();
    let about = SpeedAbout {
        model: parts.model.to_toml(),
        manifest: json!({
            "controller": parts.section.controller,
            "actuator": parts.actuator,
            "rule": rule,
            "feed_forward": parts.section.feed_forward,
            "feed_forward_maps": maps,
            "model": model,
            "delay_at_rest": delay,
            "timing": regulator.timing,
            "reasons": regulator.reasons,
            "limiter": regulator.limiter,
        }),
    };
    let settings = PilotSettings {
        slew_v_per_s: parts.section.slew_v_per_s(&parts.motor, &parts.limits, parts.period_s),
        silence_s: parts.limits.link_silence_s,
        hold: hold(&parts),
    };
    let pilot = SpeedPilot::new(regulator, parts.reference, settings);
    let name = format!("{}-speed", rig.bench.name);
    let mut done = SpeedDone {
        recorded: rig.record_loop(&name, pilot, about, controls)?,
        rule,
        model,
        motor: parts.model.model.motor.clone(),
        delay_at_rest: delay,
    };
    done.recorded.write(RunFile::Model, &parts.model.to_toml());
    let result = serde_json::to_value(&done).unwrap_or_default();
    done.recorded.write_result(&result);
    if let Some(report) = done.recorded.summary.speed.as_ref() {
        if let Some(text) = report.adaptation.clone() {
            done.recorded.write(RunFile::Adaptation, &text);
        }
        let page = cards::speed_loop(&done);
        pages::write_run(
            &mut done.recorded,
            None,
            &parts.motor.motor(),
            Some(&page),
            &rig.options.terminal,
        );
    }
    Ok(done)
}

/// Why the speed sensor is not checked against voltage and current.
fn unchecked_encoder(report: &CheckReport, actuator: Actuator) -> Option<String> {
    let missing = |channel| !report.signals.contains(&channel);
    let because = match actuator {
        _ if missing(Channel::Current) => "the drive measures no current",
        Actuator::Current if missing(Channel::Voltage) => "the drive measures no voltage",
        Actuator::Speed => "the drive's own speed loop sets the voltage",
        Actuator::Voltage | Actuator::Current => return None,
    };
    Some(format!(
        "a broken encoder is detected only by the runaway check and the speed limit: {because}"
    ))
}

fn converter(limits: &Limits) -> Option<String> {
    let dead_ms = 1e3 * limits.dead_time_s;
    (dead_ms > 0.0).then(|| {
        format!(
            "thyristor bridge: {dead_ms:.1} ms of dead time are in the delay that the loop is tuned for"
        )
    })
}

/// The command that holds a load at rest.
fn hold(parts: &LoopParts) -> f64 {
    let hold_a = parts.limits.load.brake().map_or(0.0, |brake| brake.hold_current_a);
    match parts.actuator {
        Actuator::Voltage => parts.motor.resistance_ohm * hold_a,
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

fn print_loop(
    report: &CheckReport,
    delay: Option<&LoopDelay>,
    regulator: &Regulator,
    by_nameplate: bool,
    terminal: &Terminal,
) {
    print_checks(report, terminal);
    if by_nameplate {
        terminal.message("no --model: the loop is tuned on the nameplate of the bench file");
    }
    let text = match delay {
        Some(delay) => {
            format!("{}; measured at rest on {} commands", delay_text(delay), delay.measured)
        }
        None => {
            "1 cycle is assumed: the drive does not report when a command was applied".to_owned()
        }
    };
    terminal.message(&format!("{:<18} {text}", "loop delay"));
    let controller = regulator.controller.id();
    for reason in &regulator.reasons {
        terminal.message(&format!("{controller:<18} {reason}"));
    }
}

pub(crate) fn delay_text(delay: &LoopDelay) -> String {
    let (median, p99) = (delay.median_cycles, delay.p99_cycles);
    let median_ms = 1e3 * delay.median_s;
    format!("{median:.2} cycles ({median_ms:.2} ms), 99 % within {p99:.2}")
}
