//! The commands that energise a motor, each with the live screen or without: `run` (excite, log, and identify on line),
//! `commission` (the whole loop, guided; the screen and the headless run drive the same state machine) and `speed` (the
//! adaptive speed loop over the real link).

use std::fmt::Write as _;
use std::path::PathBuf;

use super::arguments::{LiveArguments, UnknownMotor};
use super::diagnose::parameter_text;
use super::failure::Failure;
use super::output::{self, lines};
use super::progress;
use crate::app::guided;
use crate::app::{
    Recorded, Rig, RunDone, SpeedRequest, SpeedResult, commission, conduct, escalation_failure,
    run, run_result, speed, speed_result,
};
use crate::bench::{ControllerKind, ForwardUse, RunSummary};
use crate::control::Actuator;
use crate::workflow::{
    Called, CommissionResult, EscalationResult, Progress, ProgressCell, StepState,
};

/// Excite the motor, record the run and identify on line; live screen unless --headless
#[derive(clap::Args)]
#[command(after_help = "Examples:
  drivebench run                            the emulated motor, on the live screen
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
}

pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    let json = arguments.live.json;
    let options = arguments.live.options(arguments.unknown.escalate)?;
    let run_seed = arguments.run_seed;
    let done = conduct(arguments.live.audience(None), move |controls| {
        run(options, run_seed, Box::new(Rig::open), controls)
    })?;
    let left = done.left;
    match &done.work {
        RunDone::Named(escalation) => {
            output::result(escalation.as_ref(), json, EscalationResult::text)?;
            left.conclude(escalation_failure(escalation))
        }
        RunDone::Run(whole) => {
            output::result(&run_result(whole), json, |result| {
                let mut text = text(&whole.recorded);
                if let Some(escalation) = &whole.escalation {
                    text.push_str(&escalation.text());
                } else if let Some(comparison) = &result.nameplate {
                    text.push_str(&comparison.text());
                }
                text
            })?;
            left.conclude(whole.recorded.failure())
        }
    }
}

fn text(recorded: &Recorded) -> String {
    let (summary, timing) = (&recorded.summary, &recorded.summary.timing);
    let (achieved_hz, asked_hz) = (timing.rate_achieved_hz, timing.rate_asked_hz);
    let rate = format!(" {achieved_hz:.1} of {asked_hz:.0} Hz,");
    let folder = recorded.folder.path().display();
    let mut text = format!("{folder}\n{}\n", account(summary, &rate));
    for estimate in &summary.estimates {
        let verdict = estimate.verdict.name();
        let _ = writeln!(text, "{verdict:<24} {}", parameter_text(estimate));
    }
    text
}

/// How a run went, in one line.
pub(super) fn account(summary: &RunSummary, rate: &str) -> String {
    let (outcome, rows) = (summary.outcome.name(), summary.rows);
    let (duration_s, missed) = (summary.duration_s, summary.timing.missed_cycles);
    let (lost, sent) = (summary.link.lost(), summary.link.sent);
    format!(
        "{outcome}: {rows} rows in {duration_s:.1} s,{rate} {missed} cycles missed, {lost} of {sent} exchanges lost"
    )
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
    let json = live.json;
    let options = live.options(arguments.unknown.escalate)?;
    let source = live.source()?;
    let file = live.bench.as_ref().map(|_| source.0.as_str());
    let called = Called::new(&options.bench, file, live.port.as_deref());
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
    let mut text = followed.done.text;
    lines(&mut text, "", &followed.said);
    finish(json, &followed.done.result, &text)?;
    followed.outcome
}

fn finish(json: bool, result: &CommissionResult, text: &str) -> Result<(), Failure> {
    output::result(result, json, |_| text.to_owned())
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
                StepState::Waiting | StepState::Offered => {}
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
    let json = arguments.live.json;
    let source = arguments.live.source()?;
    let request = SpeedRequest {
        rig: arguments.live.options(false)?,
        source,
        model: arguments.model,
        controller: arguments.controller,
        feed_forward: arguments.feed_forward,
        actuator: arguments.actuator,
    };
    let done = conduct(arguments.live.audience(None), move |strings| {
        speed(request, Box::new(Rig::open), strings)
    })?;
    output::result(&speed_result(&done.work), json, speed_text)?;
    done.left.conclude(done.work.recorded.failure())
}

fn speed_text(result: &SpeedResult<'_>) -> String {
    let summary = result.summary;
    let mut text = format!("{}\n{}\n", result.folder, account(summary, ""));
    let Some(report) = &summary.speed else {
        return text;
    };
    if let Some(delay) = &report.delay {
        let (median, p99) = (delay.median_cycles, delay.p99_cycles);
        let tuned = report.timing.delay_cycles();
        let _ = writeln!(
            text,
            "loop delay {median:.2} cycles while running, 99 % within {p99:.2}; tuned for {tuned:.2}"
        );
    }
    for change in &report.gain_changes {
        let _ = writeln!(text, "{:>8.2} s  {}", change.time_s, change.reason);
    }
    lines(&mut text, "at the end  ", &report.gains);
    for pass in &report.tracking {
        let with = if pass.feed_forward { "with" } else { "without" };
        let (rms, mean, peak) = (pass.rms_rad_s, pass.mean_abs_rad_s, pass.peak_rad_s);
        let _ = writeln!(
            text,
            "tracking error {with} feed-forward {rms:.2} rad/s rms, {mean:.2} mean, {peak:.2} at most"
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
        let settling = step.response.settling_s.map(|s| format!("{s:.3}"));
        let settling = settling.unwrap_or_else(|| "never".to_owned());
        let (at_s, from, to) = (step.step.at_s, step.speed_rad_s, step.step.to_rad_s);
        let (overshoot, error) = (
            step.response.overshoot_percent,
            step.response.absolute_error_rad,
        );
        let limited = 100.0 * step.limited_share;
        let _ = writeln!(
            text,
            "{at_s:>8.2} {from:>9.1} {to:>9.1} {overshoot:>11.1} {settling:>11} {error:>9.2} {limited:>9.0}"
        );
    }
    text
}
