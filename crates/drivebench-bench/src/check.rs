//! The checks before a run: identity, rate of the link, noise of the sensors, the drive's own watchdog, and a small pulse that
//! must turn the shaft in the direction and as far as the nameplate predicts. Each states its figures; each may refuse.
//!
//! ```text
//! identity -> limits -> link, standstill, field -> watchdog -> direction -> plausibility       the first failure ends them
//!                       rest.rs                    rest.rs     first_move.rs, pulse.rs  -> judge.rs
//! ```

mod first_move;
mod judge;
mod motion;
mod pulse;
mod rest;

pub use first_move::FirstMove;
pub(super) use rest::{LONGEST_WATCHDOG_S, WATCHDOG};

use serde::Serialize;
use thiserror::Error;

use self::rest::Still;
use super::clock::Clock;
use super::limits::Limits;
use drivebench_control::Actuator;
use drivebench_link::offer::{self, Purpose};
use drivebench_link::{CommandTimes, DriveLink, DriveProfile, Identity, LinkError};
use drivebench_model::sample::{Channel, Command, Demand, DriveState, Sample};
use drivebench_model::text::number;

/// Why the checks could not be carried out.
#[derive(Debug, Error)]
pub enum CheckError {
    #[error(transparent)]
    Link(#[from] LinkError),
    /// The user stops; nothing is energised any more.
    #[error("interrupted in the checks; nothing is energised")]
    Stopped,
    /// The output was on and the stop is not confirmed; `before`: what had ended the checks.
    #[error("{}stop NOT confirmed by the drive: {stop}", before.as_ref().map_or_else(String::new, |text| format!("{text}; ")))]
    Unstopped { stop: LinkError, before: Option<String> },
}

impl CheckError {
    pub fn help(&self) -> &'static str {
        match self {
            // The drive may have run at zero, or turned the shaft a little.
            Self::Link(LinkError::Gone { .. }) | Self::Unstopped { .. } => {
                "see that the shaft stands still, then check the cable, the adapter and the drive's power"
            }
            Self::Link(error) => error.help(),
            Self::Stopped => "start again when the shaft may turn",
        }
    }
}

/// Checks that the user waives; each is reported and recorded.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Waivers {
    pub watchdog: bool,
    /// No pulse, so the nameplate is not checked either.
    pub direction: bool,
    pub plausibility: bool,
}

#[derive(Clone, Copy)]
pub struct CheckOptions<'a> {
    pub rate_hz: f64,
    /// Real hardware is allowed: by the option, or because a screen is open.
    pub hardware_allowed: bool,
    /// Real hardware is allowed by the option.
    pub hardware_confirmed: bool,
    pub waivers: Waivers,
    /// `None`: the motor is not known; the escalation begins with equally small steps.
    pub first_move: Option<FirstMove<'a>>,
    /// Stop requested: from then on nothing is energised.
    pub stopped: &'a (dyn Fn() -> bool + Send + Sync),
    /// Clear a latched fault, of an identified drive that does not run.
    pub reset_fault: bool,
}

/// Share by which a nameplate may differ from what the drive states before it is remarked: a warm winding and the leads of a
/// small resistance stay below.
const STATED_SHARE: f64 = 0.3;

/// The check of the rate by the arithmetic of the line.
pub const RATE_CHECK: &str = "rate";

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CheckItem {
    pub name: &'static str,
    pub passed: bool,
    /// The figures with units; of a failed check also what is allowed.
    pub text: String,
    pub help: Option<&'static str>,
}

impl CheckItem {
    fn sentence(&self) -> String {
        format!("{}: {}", self.name, self.text)
    }
}

/// Mean and standard deviation of a signal with the output disabled.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct NoiseFloor {
    #[serde(skip)]
    pub channel: Channel,
    pub mean: f64,
    pub std: f64,
    pub samples: usize,
}

#[derive(Clone, Debug, Default, Serialize)]
pub struct CheckReport {
    pub identity: Identity,
    pub items: Vec<CheckItem>,
    pub round_trip_p50_s: f64,
    pub round_trip_p99_s: f64,
    pub reachable_rate_hz: f64,
    /// Silence after which the drive was found stopped, s.
    pub watchdog_proven_s: Option<f64>,
    pub noise: Vec<NoiseFloor>,
    /// Checks that were not passed, or not made, by a waiver.
    pub waived: Vec<&'static str>,
    /// Signals that the drive gives.
    #[serde(skip)]
    pub signals: Vec<Channel>,
    /// Samples at rest with the output off.
    #[serde(skip)]
    pub rest: Vec<Sample>,
    /// Last sequence number that was used.
    #[serde(skip)]
    pub last_seq: u64,
}

impl CheckReport {
    pub fn passed(&self) -> bool {
        self.items.iter().all(|item| item.passed)
    }

    /// The first check that failed.
    pub fn refusal(&self) -> Option<&CheckItem> {
        self.items.iter().find(|item| !item.passed)
    }
}

/// Whether the signals of a drive are enough for the purpose; before anything is sent.
pub fn check_signals(profile: &DriveProfile, purpose: Purpose) -> CheckItem {
    let refusal = offer::refusal(profile, purpose);
    CheckItem {
        name: "signals",
        passed: refusal.is_none(),
        help: refusal.as_ref().map(
            |_| "the profile states what the drive has: docs/drives.md shows how to complete it",
        ),
        text: refusal.unwrap_or_else(|| "they are enough for the purpose".to_owned()),
    }
}

/// Carries out every check in order and stops at the first that fails. The output is off on return, unless the drive was
/// found running, under the command of another master.
pub fn check(
    link: &mut dyn DriveLink,
    clock: &mut dyn Clock,
    limits: &Limits,
    options: CheckOptions<'_>,
) -> Result<CheckReport, CheckError> {
    let identity = link.identify()?;
    let kind = commanded(link.zero());
    let hold =
        options.first_move.map_or((0.0, 0.0), |first| pulse::hold(kind, first.nameplate, limits));
    let mut checker = Checker {
        zero: kind.demand(hold.0),
        hold,
        touched: false,
        energised: false,
        stopped: options.stopped,
        silence_s: limits.link_silence_s,
        link,
        clock,
        period_s: 1.0 / options.rate_hz,
        report: CheckReport { identity, ..CheckReport::default() },
    };
    let result = checker.all(limits, options);
    if !checker.touched {
        // No command was sent, and another master may command the drive.
        result?;
        return Ok(checker.report.clone());
    }
    match (result, checker.link.stop()) {
        (Ok(()), Ok(())) => Ok(checker.report.clone()),
        (Err(error), Ok(())) => Err(error),
        (Err(error), Err(_)) if !checker.energised => Err(error),
        (Ok(()), Err(stop)) if !checker.energised => Err(stop.into()),
        (result, Err(stop)) => {
            let refusal = || Some(checker.report.refusal()?.sentence());
            let before = result.err().map(|error| error.to_string()).or_else(refusal);
            let before = before.filter(|before| *before != stop.to_string());
            Err(CheckError::Unstopped { stop, before })
        }
    }
}

struct Checker<'a> {
    link: &'a mut dyn DriveLink,
    clock: &'a mut dyn Clock,
    period_s: f64,
    /// The demand at which nothing moves: zero, or what holds the load.
    zero: Demand,
    /// What holds a load, in the unit of the commanded quantity and as current.
    hold: (f64, f64),
    /// A command was sent.
    touched: bool,
    /// A command to switch the output on was sent.
    energised: bool,
    stopped: &'a (dyn Fn() -> bool + Send + Sync),
    /// Longest exchange with its repetitions, s.
    silence_s: f64,
    report: CheckReport,
}

impl Drop for Checker<'_> {
    fn drop(&mut self) {
        if self.touched && std::thread::panicking() {
            // The watchdog of this drive may be waived.
            let _ = self.link.stop();
        }
    }
}

/// The quantity that a drive with this zero demand is commanded by.
const fn commanded(zero: Demand) -> Actuator {
    match zero {
        Demand::Current(_) => Actuator::Current,
        Demand::Speed(_) => Actuator::Speed,
        _ => Actuator::Voltage,
    }
}

/// Mean and standard deviation of a signal at rest; zero where it is not measured.
fn floor(noise: &[NoiseFloor], channel: Channel) -> (f64, f64) {
    let floor = noise.iter().find(|floor| floor.channel == channel);
    floor.map_or((0.0, 0.0), |floor| (floor.mean, floor.std))
}

/// How the wait for a state of the drive ended.
enum Reached {
    Yes,
    Never,
    /// What moves.
    Moved(String),
}

impl Checker<'_> {
    fn all(&mut self, limits: &Limits, options: CheckOptions<'_>) -> Result<(), CheckError> {
        let go_on = self.identity(options.hardware_allowed, options.hardware_confirmed)
            && self.limits(limits)
            && self.stated_motor(options.first_move)
            && self.rate(options.rate_hz)
            && self.is_not_running()
            && self.reset(options.reset_fault)?
            && self.probe(limits, options.rate_hz)?
            && self.set_points()?
            && self.load(limits)
            && self.watchdog(limits, options.waivers.watchdog)?
            && self.first_move(limits, options)?;
        // Nothing after a failed check is tried.
        debug_assert_eq!(go_on, self.report.passed());
        Ok(())
    }

    fn note(
        &mut self,
        name: &'static str,
        passed: bool,
        text: impl Into<String>,
        help: &'static str,
    ) -> bool {
        let help = (!passed).then_some(help);
        self.report.items.push(CheckItem { name, passed, text: text.into(), help });
        passed
    }

    /// As [`Self::note`]; a waived check passes, and is reported and recorded as waived.
    fn note_or_waive(
        &mut self,
        name: &'static str,
        passed: bool,
        waived: bool,
        text: String,
        help: &'static str,
    ) -> bool {
        if passed || !waived {
            return self.note(name, passed, text, help);
        }
        self.report.waived.push(name);
        self.note(name, true, format!("WAIVED: {text}"), help)
    }

    fn identity(&mut self, hardware_allowed: bool, hardware_confirmed: bool) -> bool {
        let identity = &self.report.identity;
        let who = identity.sentence();
        let passed = identity.is_emulator || hardware_allowed;
        if !identity.is_emulator && hardware_confirmed {
            self.report.waived.push("hardware");
        }
        let help = "this drive does not identify itself as an emulator: pass --hardware if the motor may move";
        self.note("identity", passed, who, help)
    }

    /// Reference and run command are cleared first: without the fault an earlier one could take effect again.
    fn reset(&mut self, wanted: bool) -> Result<bool, CheckError> {
        if !wanted {
            return Ok(true);
        }
        self.touched = true;
        self.link.bring_to_rest()?;
        let mut last = None;
        let cleared = self.until(Demand::ResetFault, |state| {
            last = Some(state);
            state != DriveState::Fault
        })?;
        let text = match last {
            Some(DriveState::Running) => "the drive ran once its fault was reset, and was stopped",
            _ if cleared => "the drive is without a fault",
            _ => "the drive stays in fault",
        };
        let passed = cleared && last != Some(DriveState::Running);
        let help = "remove the cause of the fault, and the run command (keypad, terminals, another master)";
        Ok(self.note("reset", passed, text, help))
    }

    fn load(&mut self, limits: &Limits) -> bool {
        let missing = limits.load.missing();
        let text = match (missing, limits.load.brake()) {
            (Some(key), _) => format!(
                "a vertical load is not moved without its brake described: {key} is left out"
            ),
            (None, Some(brake)) => format!(
                "vertical, held by {} A; brake opens in {} s and closes in {} s, operated by the drive: the bench keeps order and times",
                brake.hold_current_a, brake.release_s, brake.apply_s
            ),
            (None, None) => return true,
        };
        let help = "give load.hold_current_a, load.brake_release_s and load.brake_apply_s";
        self.note("load", missing.is_none(), text, help)
    }

    fn limits(&mut self, limits: &Limits) -> bool {
        let text = |value: Option<f64>, unit| {
            value.map_or_else(|| "not reported".to_owned(), |value| format!("{value} {unit}"))
        };
        let identity = &self.report.identity;
        let mut read = format!(
            "drive limits: current {}, voltage {}; bench limits: {} A, {} V, {} rad/s",
            text(identity.current_limit_a, "A"),
            text(identity.voltage_limit_v, "V"),
            limits.current_a,
            limits.voltage_v,
            limits.speed_rad_s
        );
        if identity.current_limit_a.is_none() && identity.voltage_limit_v.is_none() {
            read.push_str("; only the bench's hold, the drive's own cannot be read back");
        }
        let passed = identity.voltage_limit_v.is_none_or(|volts| volts >= limits.voltage_v);
        let help =
            "the drive cannot give the voltage that the bench may command: lower limits.voltage_v";
        self.note("limits", passed, read, help)
    }

    /// The motor as the drive states it, against the nameplate: a sentence, and no refusal.
    fn stated_motor(&mut self, first: Option<FirstMove<'_>>) -> bool {
        let Some(stated) = self.report.identity.motor else {
            return true;
        };
        let plate = first.map(|first| first.nameplate.plate());
        let rows = [
            ("R", "ohm", stated.resistance_ohm, plate.map(|plate| plate.resistance_ohm)),
            ("L", "H", stated.inductance_h, plate.map(|plate| plate.inductance_h)),
            ("Ke", "V.s/rad", stated.back_emf_v_s_per_rad, plate.map(|p| p.back_emf_v_s_per_rad)),
        ];
        let (mut values, mut stored, mut other) = (Vec::new(), Vec::new(), Vec::new());
        for ((symbol, unit, value, nameplate), own) in rows.into_iter().zip(stated.stored) {
            let Some(value) = value else {
                continue;
            };
            let text = |value| format!("{symbol} {} {unit}", number::shortest(value, 4));
            let differs = |plate: &f64| (value / plate - 1.0).abs() > STATED_SHARE;
            values.push(text(value));
            stored.extend(own.map(|own| number::shortest(own, 4)));
            other.extend(nameplate.filter(differs).map(text));
        }
        let mut parts = vec![format!(
            "the drive states {} between two lines (stored as {})",
            values.join(", "),
            stored.join(", ")
        )];
        if !other.is_empty() {
            let (percent, other) = (100.0 * STATED_SHARE, other.join(", "));
            parts.push(format!("the nameplate differs by more than {percent} %: {other}"));
        }
        self.note("motor", true, parts.join("; "), "")
    }

    /// Longest times of the drive's commands at the rate of these checks.
    fn times(&self) -> CommandTimes {
        self.link.command_times().polled_every(self.period_s)
    }

    /// Sends `demand` once per period until the drive's state is as wanted, for as long as the drive may take.
    fn until(
        &mut self,
        demand: Demand,
        mut wanted: impl FnMut(DriveState) -> bool,
    ) -> Result<bool, CheckError> {
        self.until_sample(demand, |sample| sample.state.is_some_and(&mut wanted))
    }

    fn until_sample(
        &mut self,
        demand: Demand,
        mut wanted: impl FnMut(&Sample) -> bool,
    ) -> Result<bool, CheckError> {
        let mut next_s = self.clock.now_s();
        let times = self.times();
        let longest_s = match demand {
            Demand::Disable | Demand::Stop => times.stop_s,
            // A reset follows the stop of a drive that runs.
            Demand::ResetFault => times.stop_s + times.reset_s,
            Demand::Voltage(_) | Demand::Current(_) | Demand::Speed(_) => times.enable_s,
        };
        let until_s = next_s + longest_s;
        while self.clock.now_s() < until_s {
            next_s += self.period_s;
            self.clock.sleep_until_s(next_s);
            if self.sample(demand)?.is_some_and(|sample| wanted(&sample)) {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// As [`Self::until`]; ends with the first sample in which something moves.
    fn until_still(
        &mut self,
        demand: Demand,
        still: &mut Still,
        wanted: impl Fn(DriveState) -> bool,
    ) -> Result<Reached, CheckError> {
        let mut moved = None;
        let reached = self.until_sample(demand, |sample| {
            moved = still.moved(sample);
            moved.is_some() || sample.state.is_some_and(&wanted)
        })?;
        Ok(match moved {
            Some(text) => Reached::Moved(text),
            None if reached => Reached::Yes,
            None => Reached::Never,
        })
    }

    fn still(&self, limits: &Limits) -> Still {
        Still::of(&self.report.noise, limits, commanded(self.zero), self.hold)
    }

    /// The reply to `demand`, which moves nothing: where the reply is lost it is sent again, for 1 s and three cycles.
    fn answer(&mut self, demand: Demand) -> Result<Sample, CheckError> {
        let until_s = self.clock.now_s() + (3.0 * self.period_s).max(1.0);
        loop {
            let reply = self.exchange(demand);
            let now_s = self.clock.now_s();
            match reply {
                Err(CheckError::Link(error)) if error.is_transient() && now_s < until_s => {
                    self.clock.sleep_until_s(now_s + self.period_s);
                }
                reply => return reply,
            }
        }
    }

    /// As [`Self::exchange`]; `None`: the reply was lost.
    fn sample(&mut self, demand: Demand) -> Result<Option<Sample>, CheckError> {
        match self.exchange(demand) {
            Ok(sample) => Ok(Some(sample)),
            Err(CheckError::Link(error)) if error.is_transient() => Ok(None),
            Err(error) => Err(error),
        }
    }

    fn exchange(&mut self, demand: Demand) -> Result<Sample, CheckError> {
        if demand.energises() {
            if (self.stopped)() {
                return Err(CheckError::Stopped);
            }
            self.energised = true;
        }
        self.touched = true;
        self.report.last_seq += 1;
        self.link.bound(self.silence_s);
        Ok(self.link.exchange(Command { seq: self.report.last_seq, demand })?)
    }
}

#[cfg(test)]
mod specimens;
#[cfg(test)]
mod tests;
