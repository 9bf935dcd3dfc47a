//! `speed`: the adaptive speed loop over the real link, with the live screen or without.

use std::fmt::Write as _;
use std::path::PathBuf;

use super::data;
use super::failure::{Failure, USAGE};
use super::live::LiveArguments;
use super::output;
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

pub(super) fn execute(arguments: Arguments) -> Result<(), Failure> {
    if arguments.escalate {
        return Err(Failure::with_help(
            USAGE,
            "--escalate finds an unknown motor, and a speed loop needs one that is known",
            "`drivebench run --escalate` first, then --model with the model.toml of its run folder",
        ));
    }
    let json = arguments.live.json;
    let source = match &arguments.live.bench {
        Some(path) => (path.display().to_string(), data::read_text(path)?),
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
