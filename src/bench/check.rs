//! Before anything moves: who is there, how fast the link is, how quiet the sensors are, and whether the drive's own
//! watchdog works. Each with the figures that were measured, each a reason to refuse.

use serde::Serialize;
use thiserror::Error;

use super::clock::Clock;
use super::limits::Limits;
use super::timing::quantile;
use crate::drive::offer::{self, Purpose};
use crate::drive::{DriveLink, DriveProfile, Identity, LinkError};
use crate::sample::{Channel, Command, Demand, DriveState, Sample};

/// Exchanges of the link probe, all with the output disabled.
const PROBES: u64 = 50;
/// Longest watchdog that is accepted, s (LINKS.md 5.2).
const LONGEST_WATCHDOG_S: f64 = 1.0;
/// Silence of the proof, in watchdog times.
const SILENCE_IN_WATCHDOGS: f64 = 1.5;
/// Cycles that the drive may take to run at zero, or to clear its fault.
const PATIENCE: u32 = 100;
/// Share of probes that may be lost.
const LOST_SHARE: f64 = 0.1;
/// Speed at which a shaft counts as standing still, as a share of the limit.
const REST_SHARE: f64 = 0.02;

/// Why the checks could not be carried out.
#[derive(Debug, Error)]
pub enum CheckError {
    #[error(transparent)]
    Link(#[from] LinkError),
}

impl CheckError {
    pub const fn help(&self) -> &'static str {
        match self {
            Self::Link(error) => error.help(),
        }
    }
}

#[derive(Clone, Copy, Debug)]
pub struct CheckOptions {
    pub rate_hz: f64,
    /// The user has said that this is real hardware and may move.
    pub hardware_allowed: bool,
    /// Goes on without a proven watchdog; the manifest has to say so.
    pub waive_watchdog: bool,
}

/// One check with its figures.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CheckItem {
    pub name: &'static str,
    pub passed: bool,
    /// What was measured or read, with units; for a failed check also what is allowed.
    pub text: String,
    pub help: Option<&'static str>,
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

#[derive(Clone, Debug, Serialize)]
pub struct CheckReport {
    pub identity: Identity,
    pub items: Vec<CheckItem>,
    pub round_trip_p50_s: f64,
    pub round_trip_p99_s: f64,
    pub reachable_rate_hz: f64,
    /// Silence after which the drive was found stopped, s.
    pub watchdog_proven_s: Option<f64>,
    pub noise: Vec<NoiseFloor>,
    /// Signals that the drive gave.
    #[serde(skip)]
    pub signals: Vec<Channel>,
    /// Last sequence number that was used.
    #[serde(skip)]
    pub last_seq: u64,
}

impl CheckReport {
    pub fn passed(&self) -> bool {
        self.items.iter().all(|item| item.passed)
    }

    /// The first check that failed: the root cause belongs in the headline.
    pub fn refusal(&self) -> Option<&CheckItem> {
        self.items.iter().find(|item| !item.passed)
    }
}

/// Whether the signals of a drive can carry what is to be done with it; asked before anything is sent.
pub fn check_signals(profile: &DriveProfile, purpose: Purpose) -> CheckItem {
    let refusal = offer::refusal(profile, purpose);
    CheckItem {
        name: "signals",
        passed: refusal.is_none(),
        help: refusal.as_ref().map(|_| {
            "the profile says what the drive has: docs/adding-a-drive.md tells how to complete it"
        }),
        text: refusal.unwrap_or_else(|| "they carry what is asked".to_owned()),
    }
}

/// Carries out every check in order and stops at the first that fails. The output is off on return.
pub fn check(
    link: &mut dyn DriveLink,
    clock: &mut dyn Clock,
    limits: &Limits,
    options: CheckOptions,
) -> Result<CheckReport, CheckError> {
    let identity = link.identify()?;
    let mut checker = Checker {
        link,
        clock,
        period_s: 1.0 / options.rate_hz,
        report: CheckReport {
            identity,
            items: Vec::new(),
            round_trip_p50_s: 0.0,
            round_trip_p99_s: 0.0,
            reachable_rate_hz: 0.0,
            watchdog_proven_s: None,
            noise: Vec::new(),
            signals: Vec::new(),
            last_seq: 0,
        },
    };
    let result = checker.all(limits, options);
    let stopped = checker.link.stop();
    result?;
    stopped?;
    Ok(checker.report)
}

struct Checker<'a> {
    link: &'a mut dyn DriveLink,
    clock: &'a mut dyn Clock,
    period_s: f64,
    report: CheckReport,
}

impl Checker<'_> {
    fn all(&mut self, limits: &Limits, options: CheckOptions) -> Result<(), LinkError> {
        let go_on = self.identity(options.hardware_allowed)
            && self.limits(limits)
            && self.probe(limits, options.rate_hz)?
            && self.watchdog(options.waive_watchdog)?;
        // The order is the point: nothing after a failed check is tried.
        debug_assert_eq!(go_on, self.report.passed());
        Ok(())
    }

    fn note(&mut self, name: &'static str, passed: bool, text: String, help: &'static str) -> bool {
        self.report.items.push(CheckItem {
            name,
            passed,
            text,
            help: (!passed).then_some(help),
        });
        passed
    }

    fn identity(&mut self, hardware_allowed: bool) -> bool {
        let identity = &self.report.identity;
        let who = format!(
            "{} {}, serial {}, firmware {}, protocol {}, {}",
            identity.vendor,
            identity.product,
            identity.serial_number,
            identity.firmware,
            identity.protocol_version,
            if identity.is_emulator {
                "emulator"
            } else {
                "hardware"
            }
        );
        let passed = identity.is_emulator || hardware_allowed;
        self.note(
            "identity",
            passed,
            who,
            "this drive does not say that it is an emulator: pass --hardware if the motor may move",
        )
    }

    fn limits(&mut self, limits: &Limits) -> bool {
        let text = |value: Option<f64>, unit| {
            value.map_or_else(|| "not told".to_owned(), |value| format!("{value} {unit}"))
        };
        let identity = &self.report.identity;
        let read = format!(
            "drive limits: current {}, voltage {}; bench limits: {} A, {} V, {} rad/s",
            text(identity.current_limit_a, "A"),
            text(identity.voltage_limit_v, "V"),
            limits.current_a,
            limits.voltage_v,
            limits.speed_rad_s
        );
        let passed = identity
            .voltage_limit_v
            .is_none_or(|volts| volts >= limits.voltage_v);
        self.note(
            "limits",
            passed,
            read,
            "the drive cannot give the voltage that the bench may ask for: lower limits.voltage_v",
        )
    }

    fn probe(&mut self, limits: &Limits, rate_hz: f64) -> Result<bool, LinkError> {
        let mut round_trips_s = Vec::new();
        let mut samples = Vec::new();
        let mut last_error = None;
        let begin_s = self.clock.now_s();
        for probe in 0..PROBES {
            self.clock
                .sleep_until_s(begin_s + (probe + 1) as f64 * self.period_s);
            let sent_s = self.clock.now_s();
            match self.exchange(Demand::Disable) {
                Ok(sample) => {
                    let done_s = if self.clock.is_real() {
                        self.clock.now_s()
                    } else {
                        // Virtual time stands still during an exchange; the link says what the wire would take.
                        sample.host_time_s.unwrap_or(sent_s)
                    };
                    round_trips_s.push(done_s - sent_s);
                    samples.push(sample);
                }
                Err(error) if error.is_transient() => last_error = Some(error),
                Err(error) => return Err(error),
            }
        }
        if samples.is_empty()
            && let Some(error) = last_error
        {
            return Err(error);
        }
        let median_s = quantile(&mut round_trips_s, 0.5);
        let tail_s = quantile(&mut round_trips_s, 0.99);
        let shortest_s = self.link.shortest_cycle_s().unwrap_or(0.0);
        // The quicker exchanges tell what the link carries; the slower ones what else the host was doing meanwhile,
        // which costs missed cycles, and those are counted.
        let unhindered_s = quantile(&mut round_trips_s, 0.25);
        let reachable_hz = 1.0 / unhindered_s.max(shortest_s).max(1e-6);
        self.report.round_trip_p50_s = median_s;
        self.report.round_trip_p99_s = tail_s;
        self.report.reachable_rate_hz = reachable_hz;
        let lost = PROBES - samples.len() as u64;
        let figures = format!(
            "{PROBES} exchanges, {lost} lost, round trip {:.2} ms median, {:.2} ms 99 %, reaches {reachable_hz:.0} Hz, asked {rate_hz} Hz",
            1e3 * median_s,
            1e3 * tail_s
        );
        let fast = reachable_hz >= rate_hz && lost as f64 <= LOST_SHARE * PROBES as f64;
        if !self.note(
            "link",
            fast,
            figures,
            "lower link.rate_hz, raise the baud rate, or check the latency of the adapter",
        ) {
            return Ok(false);
        }
        Ok(self.standstill(&samples, limits))
    }

    fn standstill(&mut self, samples: &[Sample], limits: &Limits) -> bool {
        for channel in Channel::ALL {
            let values: Vec<f64> = samples.iter().filter_map(|s| s.get(channel)).collect();
            if values.is_empty() {
                continue;
            }
            self.report.signals.push(channel);
            let mean = values.iter().sum::<f64>() / values.len() as f64;
            let square: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
            self.report.noise.push(NoiseFloor {
                channel,
                mean,
                std: (square / (values.len().max(2) - 1) as f64).sqrt(),
                samples: values.len(),
            });
        }
        let wanted = [Channel::Current, Channel::Speed, Channel::Voltage];
        let figures: Vec<String> = self
            .report
            .noise
            .iter()
            .filter(|floor| wanted.contains(&floor.channel))
            .map(|floor| {
                format!(
                    "{} {:.4} +- {:.4} {}",
                    floor.channel.name(),
                    floor.mean,
                    floor.std,
                    floor.channel.unit()
                )
            })
            .collect();
        let speed = self
            .report
            .noise
            .iter()
            .find(|floor| floor.channel == Channel::Speed)
            .map_or(0.0, |floor| floor.mean.abs());
        let fault = samples
            .last()
            .is_some_and(|sample| sample.state == Some(DriveState::Fault));
        let text = if fault {
            "the drive is in fault".to_owned()
        } else {
            figures.join(", ")
        };
        self.note(
            "standstill",
            !fault && speed <= REST_SHARE * limits.speed_rad_s,
            text,
            "the shaft must stand still and the drive be without a fault: wait until it stands, or clear a latched fault with --reset-fault",
        )
    }

    /// Enables at zero, stops talking on purpose, and wants to hear that the drive gave up by itself.
    fn watchdog(&mut self, waived: bool) -> Result<bool, LinkError> {
        const HELP: &str =
            "set the drive's command watchdog to 1 s or less, or waive it explicitly";
        let Some(watchdog_s) = self.report.identity.watchdog_s else {
            let text = "the drive tells of no watchdog".to_owned();
            return Ok(self.note("watchdog", waived, text, HELP));
        };
        if !(watchdog_s > 0.0 && watchdog_s <= LONGEST_WATCHDOG_S) {
            let text = format!("{watchdog_s} s, at most {LONGEST_WATCHDOG_S} s is allowed");
            return Ok(self.note("watchdog", waived, text, HELP));
        }
        let zero = self.link.zero();
        if !self.until(zero, |state| state == DriveState::Running)? {
            let text = format!("the drive does not run at zero within {PATIENCE} cycles");
            return Ok(self.note("watchdog", false, text, "check the drive's enable input"));
        }
        let silence_s = SILENCE_IN_WATCHDOGS * watchdog_s + self.period_s;
        let quiet_from_s = self.clock.now_s();
        self.clock.sleep_until_s(quiet_from_s + silence_s);
        let after = self.exchange(Demand::Disable)?;
        let tripped = after.state == Some(DriveState::Fault) || after.fault.is_some();
        let text = format!(
            "set to {watchdog_s} s; after {silence_s:.3} s of silence at zero the drive was {}{}",
            after.state.map_or("in no known state", DriveState::name),
            after
                .fault
                .map_or_else(String::new, |code| format!(", fault {code:#06x}"))
        );
        if tripped {
            self.report.watchdog_proven_s = Some(silence_s);
            let reset = self.until(Demand::ResetFault, |state| state != DriveState::Fault)?;
            if !reset {
                let text = format!("{text}; it does not reset");
                return Ok(self.note("watchdog", false, text, "reset the drive by hand"));
            }
        }
        Ok(self.note("watchdog", tripped || waived, text, HELP))
    }

    /// Sends `demand` once per period until the drive's state is as wanted.
    fn until(
        &mut self,
        demand: Demand,
        wanted: impl Fn(DriveState) -> bool,
    ) -> Result<bool, LinkError> {
        let begin_s = self.clock.now_s();
        for cycle in 0..PATIENCE {
            self.clock
                .sleep_until_s(begin_s + f64::from(cycle + 1) * self.period_s);
            match self.exchange(demand) {
                Ok(sample) if sample.state.is_some_and(&wanted) => return Ok(true),
                Ok(_) => {}
                Err(error) if error.is_transient() => {}
                Err(error) => return Err(error),
            }
        }
        Ok(false)
    }

    fn exchange(&mut self, demand: Demand) -> Result<Sample, LinkError> {
        self.report.last_seq += 1;
        self.link.exchange(Command {
            seq: self.report.last_seq,
            demand,
        })
    }
}

#[cfg(test)]
mod tests;
