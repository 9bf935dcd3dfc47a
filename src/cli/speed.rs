//! `speed`: the adaptive speed loop over the real link, with the live screen or without.

use std::fmt::Write as _;
use std::path::PathBuf;

use super::arguments::LiveArguments;
use super::failure::Failure;
use super::output::{self, lines};
use super::run::account;
use crate::app::files::read_text;
use crate::app::{Rig, SpeedRequest, SpeedResult, conduct, speed, speed_result};
use crate::bench::{ControllerKind, EMBEDDED_NAME, ForwardUse};
use crate::control::Actuator;

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
    let json = arguments.live.json;
    let source = match &arguments.live.bench {
        Some(path) => (path.display().to_string(), read_text(path)?),
        None => (EMBEDDED_NAME.to_owned(), String::new()),
    };
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
    output::result(&speed_result(&done.work), json, text)?;
    done.left.conclude(done.work.recorded.failure())
}

fn text(result: &SpeedResult<'_>) -> String {
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
