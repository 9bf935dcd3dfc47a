//! The commands that energise a motor, each with the live screen or without: `run` (excite, log, and identify on line),
//! `commission` (the whole loop, guided; the screen and the headless run drive the same state machine) and `speed` (the
//! adaptive speed loop over the real link).

use std::path::PathBuf;

use super::arguments::{LiveArguments, UnknownMotor};
use super::failure::Failure;
use super::output;
use super::progress;
use crate::app::guided;
use crate::app::{
    Audience, Connection, Rig, RigOptions, RunDone, SpeedRequest, by_hand, cards, commission,
    conduct, connect, escalation_failure, run, run_result, speed, speed_result,
};
use crate::report::{Document, tables};
use crate::workflow::{Called, Progress, ProgressCell, StepState};
use drivebench_bench::{ControllerKind, ForwardUse};
use drivebench_control::Actuator;

/// Excite the motor, record the run and identify on line; live screen unless --headless
#[derive(clap::Args)]
#[command(after_help = "Examples:
  drivebench run                            the emulated motor, on the live screen
  drivebench run bench.toml --port /dev/ttyUSB0 --hardware --check      everything that can be told before the shaft turns
  drivebench run bench.toml --port /dev/ttyUSB0 --hardware --headless
  drivebench run --escalate --port sim: --emulator small-servo-behind-zk-22fc   find the motor first")]
pub(super) struct Arguments {
    #[command(flatten)]
    live: LiveArguments,
    #[command(flatten)]
    unknown: UnknownMotor,
    /// Seed of the sequence's random parts, and of the emulator's noise on that day (no number of a run): as runs.fit, select
    /// or confirm of the bench file. Without it runs.fit
    #[arg(long, value_name = "N")]
    run_seed: Option<u64>,
    /// Only the checks before the first move: who is there, limits, rate, noise at rest, the drive's watchdog; and whether the
    /// sequence would be refused. No screen, nothing moves, no run is made. The watchdog is proven with the output on at zero
    #[arg(long)]
    check: bool,
}

pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    if arguments.check {
        return check(arguments);
    }
    let live = &arguments.live;
    let json = live.json;
    let options = live.options(arguments.unknown.escalate)?;
    let run_seed = arguments.run_seed;
    let done = conduct(arguments.live.audience(None), move |controls| {
        run(options, run_seed, Box::new(Rig::open), controls)
    })?;
    let left = done.left;
    match &done.work {
        RunDone::Named(escalation) => {
            let mut document = Document::new("", "");
            escalation.put("motor", &mut document);
            tables::plate(&mut document, escalation.nameplate.as_ref());
            output::document(escalation.as_ref(), json, true, &document)?;
            left.conclude(escalation_failure(escalation))
        }
        RunDone::Run(whole) => {
            let result = run_result(whole);
            let plate = result.nameplate.as_ref();
            let seen = by_hand::go_on(&left, whole.recorded.folder.path());
            // However it was left: the result of the run is there all the same.
            let written = seen.as_ref().ok().cloned().flatten();
            let document = with_model(cards::run(whole, plate), written);
            output::document(&result, json, live.full, &document)?;
            // A trip or a lost drive is said before anything that became of the look at its record.
            left.conclude(whole.recorded.failure()).and(seen.map(drop))
        }
    }
}

/// Without a screen, whatever stdout is: there is nothing to watch.
fn check(arguments: &Arguments) -> Result<(), Failure> {
    let options = RigOptions {
        headless: true,
        ..arguments.live.options(arguments.unknown.escalate)?
    };
    let run_seed = arguments.run_seed;
    let done = conduct(Audience::Headless, move |controls| {
        connect(options, run_seed, Box::new(Rig::open), controls)
    })?;
    output::result(&done.work, arguments.live.json, Connection::text)
}

/// With the command that goes on from a model that was written by hand.
fn with_model(mut document: Document, model: Option<String>) -> Document {
    if let Some(model) = model {
        let model = output::quoted_word(&model);
        document.go_on(format!("drivebench tune --model {model}"));
    }
    document
}

/// The whole loop: check, plan, excite, identify, compare, name the missing effect, add it, report
#[derive(clap::Args)]
#[command(after_help = "Examples:
  drivebench commission --headless                       the emulated motor with a hidden effect
  drivebench commission --headless --emulator zk-22fc-plain   the same motor without one
  drivebench commission bench.toml --port /dev/ttyUSB0   a real drive, on the screen")]
pub(super) struct CommissionArguments {
    #[command(flatten)]
    live: LiveArguments,
    #[command(flatten)]
    unknown: UnknownMotor,
}

pub(super) fn execute_commission(arguments: CommissionArguments) -> Result<(), Failure> {
    let live = arguments.live;
    let options = live.options(arguments.unknown.escalate)?;
    let source = live.source()?;
    let file = live.bench.as_ref().map(|_| source.0.as_str());
    let called = Called::new(&options.bench, file, live.words());
    let cell = ProgressCell::default();
    let shown = live.is_headless().then(|| progress::begin("commission"));
    let mut told = shown.is_some().then(StepLog::default);
    let audience = live.audience(Some(cell.clone()));
    let asked = options.clone();
    let done = conduct(audience, move |strings| {
        commission(asked, called, Box::new(Rig::open), strings, |latest| {
            cell.publish(latest.clone());
            if let Some(told) = &mut told {
                told.tell(latest);
            }
        })
    })?;
    drop(shown);
    let followed = guided::follow(done.work, done.left, &options, &source);
    // However it was left: the result of the loop is there all the same.
    let mut done = followed.done;
    done.document.say("then", followed.said, 4);
    output::document(&done.result, live.json, live.full, &done.document)?;
    followed.outcome
}

/// Progress on stderr: each step once when it begins and once with its figure.
#[derive(Default)]
struct StepLog {
    lines: Vec<(StepState, String)>,
}

impl StepLog {
    fn tell(&mut self, progress: &Progress) {
        let total = progress.steps.len();
        self.lines
            .resize(total, (StepState::Waiting, String::new()));
        for (index, step) in progress.steps.iter().enumerate() {
            let now = (step.state, step.line.clone());
            if now == self.lines[index] {
                continue;
            }
            let head = format!("[{:>2}/{total}] {}", index + 1, step.step.title());
            match step.state {
                StepState::Waiting | StepState::Offered | StepState::Withheld => {}
                StepState::Active => {
                    output::message(&format!("{head} ..."));
                    progress::stage(step.step.title(), 0);
                }
                StepState::Done => output::message(&format!("{head}: {}", step.line)),
                StepState::Failed => output::message(&format!("{head} failed")),
            }
            self.lines[index] = now;
        }
    }
}

/// Regulate the speed over the link and adapt on line; live screen unless --headless
#[derive(clap::Args)]
#[command(after_help = "Examples:
  drivebench speed --headless                            the emulated motor, the reference of the embedded bench
  drivebench speed bench.toml --model model.toml --port /dev/ttyUSB0 --hardware --headless
  drivebench speed --model model.toml --feed-forward compare    what the model's effects are worth
  drivebench speed --port sim: --emulator zk-22fc-changing --controller pi   fixed gains and a load that changes")]
pub(super) struct SpeedArguments {
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

pub(super) fn execute_speed(arguments: SpeedArguments) -> Result<(), Failure> {
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
    done.left
        .conclude(done.work.recorded.failure())
        .and(seen.map(drop))
}
