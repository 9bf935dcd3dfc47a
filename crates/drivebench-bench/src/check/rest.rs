//! Output off, then running at zero: rate of the link, noise of the sensors, standstill, and the drive's own watchdog.
//!
//! The shaft stands still while every signal is below a share of the bench's limit, or below a multiple of its noise at rest
//! where that is more.

use super::{CheckError, Checker, NoiseFloor, RATE_CHECK, Reached, floor};
use crate::limits::Limits;
use crate::timing::quantile;
use drivebench_control::Actuator;
use drivebench_identify::belief::Settings;
use drivebench_model::numerics::statistics::{mean, variance};
use drivebench_model::sample::{Channel, Demand, DriveState, Sample};
use drivebench_model::text::number::with_std;

/// Exchanges of the link probe, all with the output disabled.
const PROBES: u64 = 50;

const STANDSTILL: &str = "standstill";
const RUNNING_HELP: &str =
    "stop it where it was started (keypad, terminals, another master or program), then start again";
const STANDSTILL_HELP: &str = "the shaft must stand still and the drive be without a fault: wait until it stands, or clear a latched fault with --reset-fault";
/// Longest watchdog that is accepted, s.
pub(crate) const LONGEST_WATCHDOG_S: f64 = 1.0;

pub(crate) const WATCHDOG: &str = "watchdog";

pub(super) const AT_ZERO_HELP: &str = "the drive was stopped at once: check the set-points' address, scale and word order, and what the profile's enable command writes; an output with an offset does this too";

/// The watched signals, with the bench's limit of each and its share that mean and standard deviation may have at rest.
fn watched(limits: &Limits) -> [(Channel, f64, f64); 3] {
    [
        (Channel::Speed, limits.speed_rad_s, Settings::REST),
        (Channel::Current, limits.current_a, Settings::CLEAR),
        (Channel::Voltage, limits.voltage_v, Settings::CLEAR),
    ]
}

/// The first watched signal with a value beyond so many times its share.
fn beyond(
    limits: &Limits,
    factor: f64,
    what: &str,
    value: impl Fn(Channel) -> Option<f64>,
) -> Option<String> {
    watched(limits).into_iter().find_map(|(channel, limit, share)| {
        let most = factor * share * limit;
        let value = value(channel).filter(|value| value.abs() > most)?;
        Some(figure(channel, what, value, most))
    })
}

fn figure(channel: Channel, what: &str, value: f64, most: f64) -> String {
    let (name, unit) = (channel.name(), channel.unit());
    format!("{name} {what}{value:.4} {unit}, at most {most:.4} {unit}")
}

/// The signal of one sample that exceeds rest; `settled`: by the bound of a mean, else by three times that.
fn beyond_rest(sample: &Sample, limits: &Limits, settled: bool) -> Option<String> {
    let factor = if settled { 1.0 } else { Settings::SIGMAS };
    beyond(limits, factor, "", |channel| sample.get(channel))
}

/// The signal whose mean or spread exceeds rest.
fn means_beyond_rest(noise: &[NoiseFloor], limits: &Limits) -> Option<String> {
    let of = |channel| noise.iter().find(|floor| floor.channel == channel);
    beyond(limits, 1.0, "mean ", |channel| Some(of(channel)?.mean))
        .or_else(|| beyond(limits, 1.0, "spread ", |channel| Some(of(channel)?.std)))
}

/// Bounds of the signals while the drive runs at zero.
#[derive(Clone, Debug)]
pub(super) struct Still {
    /// Mean at rest and the largest deviation from it.
    bounds: [(Channel, f64, f64); 3],
    /// The first angle.
    angle_rad: Option<f64>,
}

impl Still {
    /// `hold`: what holds a load, in the unit of the commanded quantity and as current.
    pub(super) fn of(
        noise: &[NoiseFloor],
        limits: &Limits,
        kind: Actuator,
        hold: (f64, f64),
    ) -> Self {
        let bounds = watched(limits).map(|(channel, limit, _)| {
            let (mean, std) = floor(noise, channel);
            let most = match (channel, kind) {
                (Channel::Speed, _) => Settings::REST * limit,
                // A drive that controls the speed to zero needs any voltage and current for it.
                (_, Actuator::Speed) => limit,
                (Channel::Current, _) => 0.15 * limit + hold.1.abs(),
                (_, Actuator::Voltage) => 0.15 * limit + hold.0.abs(),
                (_, Actuator::Current) => limit,
            };
            (channel, mean, most.max(Settings::CLEAR_STD * std))
        });
        Self { bounds, angle_rad: None }
    }

    /// The signal that exceeds its bound, or an angle more than 3 rad from the first.
    pub(super) fn moved(&mut self, sample: &Sample) -> Option<String> {
        let moved = |(channel, mean, most): (Channel, f64, f64)| {
            let value = sample.get(channel).filter(|value| (value - mean).abs() > most)?;
            Some(figure(channel, "", value, most))
        };
        if let Some(text) = self.bounds.into_iter().find_map(moved) {
            return Some(text);
        }
        let angle_rad = sample.get(Channel::Angle)?;
        let turned_rad = angle_rad - *self.angle_rad.get_or_insert(angle_rad);
        (turned_rad.abs() > 3.0).then(|| figure(Channel::Angle, "by ", turned_rad, 3.0))
    }
}

impl Checker<'_> {
    /// Whether the line carries the rate at all, by its baud rate.
    pub(super) fn rate(&mut self, rate_hz: f64) -> bool {
        let most_hz = self.link.shortest_cycle_s().map(|cycle_s| 1.0 / cycle_s);
        let Some(most_hz) = most_hz.filter(|most_hz| *most_hz < rate_hz) else {
            return true;
        };
        let text = format!(
            "the line carries at most {most_hz:.0} Hz at its baud rate, requested {rate_hz} Hz"
        );
        self.note(RATE_CHECK, false, text, "lower link.rate_hz, or raise the baud rate")
    }

    /// A drive that already runs belongs to another master: no command has been sent to it yet.
    pub(super) fn is_not_running(&mut self) -> bool {
        let running = self.link.found().filter(|sample| sample.state == Some(DriveState::Running));
        running.is_none_or(|sample| self.running(&sample))
    }

    fn running(&mut self, sample: &Sample) -> bool {
        let figure = |channel: Channel| {
            let value = sample.get(channel)?;
            Some(format!("{} {value:.2} {}", channel.name(), channel.unit()))
        };
        let channels = [Channel::Speed, Channel::Current, Channel::Voltage];
        let figures: Vec<String> = channels.into_iter().filter_map(figure).collect();
        let figures = match &figures[..] {
            [] => "it reports no speed, current or voltage".to_owned(),
            figures => figures.join(", "),
        };
        let text = format!("the drive is running; who commands it? {figures}");
        self.note(STANDSTILL, false, text, RUNNING_HELP)
    }

    /// With the output off: waits up to 5 s until the shaft stands; `None`: refused, as is a drive that runs.
    fn come_to_rest(
        &mut self,
        first: Sample,
        limits: &Limits,
    ) -> Result<Option<Sample>, CheckError> {
        let mut last = first;
        let begin_s = self.clock.now_s();
        loop {
            if last.state == Some(DriveState::Running) {
                self.running(&last);
                return Ok(None);
            }
            let Some(text) = beyond_rest(&last, limits, true) else {
                return Ok(Some(last));
            };
            let now_s = self.clock.now_s();
            if now_s - begin_s > 5.0 {
                let text = format!("the shaft does not come to rest within 5 s: {text}");
                self.note(STANDSTILL, false, text, STANDSTILL_HELP);
                return Ok(None);
            }
            self.clock.sleep_until_s(now_s + self.period_s);
            if let Some(sample) = self.sample(Demand::Disable)? {
                last = sample;
            }
        }
    }

    /// Set-points that can be read back, compared with the output off.
    pub(super) fn set_points(&mut self) -> Result<bool, CheckError> {
        let Some(compared) = self.link.compare_set_points()? else {
            return Ok(true);
        };
        let help = "check address, type and function of the set-point, and whether the drive lets the bus write it";
        let passed = compared.is_ok();
        let (Ok(text) | Err(text)) = compared;
        Ok(self.note("set-points", passed, text, help))
    }

    pub(super) fn probe(&mut self, limits: &Limits, rate_hz: f64) -> Result<bool, CheckError> {
        let mut round_trips_s = Vec::new();
        let mut samples = Vec::new();
        let mut last_error = None;
        let mut begin_s = self.clock.now_s();
        for probe in 0..PROBES {
            self.clock.sleep_until_s(begin_s + (probe + 1) as f64 * self.period_s);
            let sent_s = self.clock.now_s();
            match self.exchange(Demand::Disable) {
                Ok(mut sample) => {
                    let done_s = if self.clock.is_real() {
                        self.clock.now_s()
                    } else {
                        // Virtual time stands still during an exchange; the link stamps what the wire would take.
                        sample.host_time_s.unwrap_or(sent_s)
                    };
                    round_trips_s.push(done_s - sent_s);
                    let faulty = sample.state == Some(DriveState::Fault);
                    if samples.is_empty() && !faulty {
                        // Coasting is not counted as noise.
                        let from_s = self.clock.now_s();
                        match self.come_to_rest(sample, limits)? {
                            Some(rested) => sample = rested,
                            None => return Ok(false),
                        }
                        begin_s += self.clock.now_s() - from_s;
                    } else if sample.state == Some(DriveState::Running) {
                        return Ok(self.running(&sample));
                    } else if let Some(text) =
                        beyond_rest(&sample, limits, false).filter(|_| !faulty)
                    {
                        let text = format!("the shaft moves with the output off: {text}");
                        return Ok(self.note(STANDSTILL, false, text, STANDSTILL_HELP));
                    }
                    samples.push(sample);
                }
                Err(CheckError::Link(error)) if error.is_transient() => last_error = Some(error),
                Err(error) => return Err(error),
            }
        }
        if samples.is_empty()
            && let Some(error) = last_error
        {
            return Err(error.into());
        }
        let median_s = quantile(&mut round_trips_s, 0.5);
        let tail_s = quantile(&mut round_trips_s, 0.99);
        let shortest_s = self.link.shortest_cycle_s().unwrap_or(0.0);
        // The quicker exchanges show the rate of the link; the slower ones a busy host, whose missed cycles are counted.
        let reachable_hz = 1.0 / quantile(&mut round_trips_s, 0.25).max(shortest_s).max(1e-6);
        self.report.round_trip_p50_s = median_s;
        self.report.round_trip_p99_s = tail_s;
        self.report.reachable_rate_hz = reachable_hz;
        let lost = PROBES - samples.len() as u64;
        let line = self.link.line().unwrap_or_default();
        let (late, foreign) = (line.stale_frames, line.foreign_frames);
        let strays = match late + foreign {
            0 => String::new(),
            _ => format!(", {late} late and {foreign} foreign frames on the line so far"),
        };
        let strays = match line.stray_replies {
            0 => strays,
            count => format!("{strays}, {count} replies with stray bytes so far"),
        };
        let figures = format!(
            "{PROBES} exchanges, {lost} lost, round trip {:.2} ms median, {:.2} ms 99 %, reaches {reachable_hz:.0} Hz, requested {rate_hz} Hz{strays}",
            1e3 * median_s,
            1e3 * tail_s
        );
        let fast = reachable_hz >= rate_hz && lost as f64 <= 0.1 * PROBES as f64;
        let help = "lower link.rate_hz, raise the baud rate, or check what adapter and drive take to answer (`drivebench doctor --port PORT`)";
        if !self.note("link", fast, figures, help) {
            return Ok(false);
        }
        let rests = self.standstill(&samples, limits) && self.field(&samples, limits);
        self.report.rest = samples;
        Ok(rests)
    }

    fn standstill(&mut self, samples: &[Sample], limits: &Limits) -> bool {
        for channel in Channel::ALL {
            let values: Vec<f64> = samples.iter().filter_map(|s| s.get(channel)).collect();
            if values.is_empty() {
                continue;
            }
            self.report.signals.push(channel);
            if channel == Channel::TimeHalfWidth {
                // A stamp, not a signal with noise.
                continue;
            }
            // One value has no deviation.
            let (mean, std) = (mean(&values), variance(&values).max(0.0).sqrt());
            self.report.noise.push(NoiseFloor { channel, mean, std, samples: values.len() });
        }
        let wanted = [Channel::Current, Channel::Speed, Channel::Voltage];
        let figure = |floor: &NoiseFloor| {
            let (name, unit) = (floor.channel.name(), floor.channel.unit());
            format!("{name} {} {unit}", with_std(floor.mean, floor.std))
        };
        let floors = self.report.noise.iter().filter(|floor| wanted.contains(&floor.channel));
        let figures: Vec<String> = floors.map(figure).collect();
        let fault = samples.last().and_then(|sample| sample.state) == Some(DriveState::Fault);
        let beyond_rest = means_beyond_rest(&self.report.noise, limits);
        let passed = !fault && beyond_rest.is_none();
        let text = match beyond_rest {
            _ if fault => "the drive is in fault".to_owned(),
            Some(beyond_rest) => format!("{beyond_rest} ({})", figures.join(", ")),
            None => figures.join(", "),
        };
        self.note(STANDSTILL, passed, text, STANDSTILL_HELP)
    }

    /// The field of a motor with a separate one: without it a motor at voltage runs away.
    fn field(&mut self, samples: &[Sample], limits: &Limits) -> bool {
        let field_a = samples.iter().rev().find_map(|sample| sample.field_a);
        let text = match (field_a, limits.field_min_a) {
            (None, None) => return true,
            (None, Some(least_a)) => {
                format!("the field current is not read, at least {least_a} A are needed")
            }
            (Some(field_a), None) => format!(
                "{field_a:.3} A; its loss is not watched: the drive's profile gives no limits.field_min_a"
            ),
            (Some(field_a), Some(least_a)) => format!("{field_a:.3} A, a trip below {least_a} A"),
        };
        let enough = |least_a: f64| field_a.is_some_and(|field_a| field_a >= least_a);
        let passed = limits.field_min_a.is_none_or(enough);
        let help = "switch the field supply on, check its fuse, and limits.field_min_a of the drive's profile";
        self.note("field", passed, text, help)
    }

    /// Enables at zero, sends nothing for one and a half watchdog times, and requires the drive to have tripped.
    pub(super) fn watchdog(&mut self, limits: &Limits, waived: bool) -> Result<bool, CheckError> {
        const HELP: &str = "set the drive's command watchdog to 1 s or less (watchdog.set_ms of its profile), or waive it explicitly (--waive-watchdog)";
        let Some(watchdog_s) = self.report.identity.watchdog_s else {
            let text = "the drive reports no watchdog".to_owned();
            return Ok(self.note_or_waive(WATCHDOG, false, waived, text, HELP));
        };
        if !(watchdog_s > 0.0 && watchdog_s <= LONGEST_WATCHDOG_S) {
            let text = format!("{watchdog_s} s, at most {LONGEST_WATCHDOG_S} s is allowed");
            return Ok(self.note_or_waive(WATCHDOG, false, waived, text, HELP));
        }
        let mut still = self.still(limits);
        match self.runs_at_zero(&mut still)? {
            Reached::Yes => {}
            Reached::Never => {
                let waited_s = self.times().enable_s;
                let text = format!("the drive does not run at zero within {waited_s:.2} s");
                return Ok(self.note(WATCHDOG, false, text, "check the drive's enable input"));
            }
            Reached::Moved(text) => return Ok(self.moved_at_zero("", &text)),
        }
        let silence_s = 1.5 * watchdog_s + self.period_s;
        self.clock.sleep_until_s(self.clock.now_s() + silence_s);
        let after = self.answer(Demand::Disable)?;
        if let Some(text) = still.moved(&after) {
            return Ok(self.moved_at_zero(&format!(", after {silence_s:.3} s of silence"), &text));
        }
        // 0 is no code.
        let code = after.fault.filter(|code| *code != 0);
        let tripped = after.state == Some(DriveState::Fault) || code.is_some();
        let text = format!(
            "set to {watchdog_s} s; after {silence_s:.3} s of silence at zero the drive was in {}{}",
            after.state.map_or("no known state", DriveState::name),
            code.map_or_else(String::new, |code| format!(", code {code:#06x}"))
        );
        if tripped {
            self.report.watchdog_proven_s = Some(silence_s);
            // The pulse begins with a drive whose stop has ended.
            let cleared = |state| !matches!(state, DriveState::Fault | DriveState::Running);
            match self.until_still(Demand::ResetFault, &mut still, cleared)? {
                Reached::Yes => {}
                Reached::Never => {
                    let waited_s = self.times().stop_s + self.times().reset_s;
                    let text = format!("{text}; it does not reset within {waited_s:.2} s");
                    return Ok(self.note(WATCHDOG, false, text, "reset the drive by hand"));
                }
                Reached::Moved(text) => return Ok(self.moved_at_zero(" with the reset", &text)),
            }
        }
        Ok(self.note_or_waive(WATCHDOG, tripped, waived, text, HELP))
    }

    /// Enables at zero, and watches for 0.1 s and three cycles whether the shaft stands.
    fn runs_at_zero(&mut self, still: &mut Still) -> Result<Reached, CheckError> {
        let reached = self.until_still(self.zero, still, |state| state == DriveState::Running)?;
        if !matches!(reached, Reached::Yes) {
            return Ok(reached);
        }
        let end_s = self.clock.now_s() + (3.0 * self.period_s).max(0.1);
        while self.clock.now_s() < end_s {
            self.clock.sleep_until_s(self.clock.now_s() + self.period_s);
            if let Some(text) = self.sample(self.zero)?.and_then(|sample| still.moved(&sample)) {
                return Ok(Reached::Moved(text));
            }
        }
        Ok(Reached::Yes)
    }

    /// Cannot be waived; the caller of the checks stops the drive.
    fn moved_at_zero(&mut self, when: &str, what: &str) -> bool {
        let text = format!("the shaft moved at zero reference{when}: {what}");
        self.note(WATCHDOG, false, text, AT_ZERO_HELP)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::has;

    fn sample(speed_rad_s: f64, current_a: f64, voltage_v: f64) -> Sample {
        Sample::at(0.0)
            .with(Channel::Speed, speed_rad_s)
            .with(Channel::Current, current_a)
            .with(Channel::Voltage, voltage_v)
    }

    #[test]
    fn a_braking_of_zero_mean_is_no_noise() {
        let floor = |channel, mean, std| NoiseFloor { channel, mean, std, samples: 50 };
        // Of a drive that was stopped while it turned at 105 rad/s.
        let braking =
            [floor(Channel::Speed, 2.1551, 11.3723), floor(Channel::Current, -0.4720, 2.0936)];
        has(means_beyond_rest(&braking, &Limits::zk_22fc()).unwrap(), "spread 11.37");
        let quiet = [floor(Channel::Speed, 0.02, 0.15), floor(Channel::Current, 0.1, 0.03)];
        assert_eq!(means_beyond_rest(&quiet, &Limits::zk_22fc()), None);
        assert!(beyond_rest(&sample(30.0, 0.0, 0.0), &Limits::zk_22fc(), false).is_some());
        assert_eq!(beyond_rest(&sample(0.5, 0.2, 0.5), &Limits::zk_22fc(), true), None);
    }

    #[test]
    fn motion_or_current_at_zero_is_found() {
        let (voltage, speed) = (Actuator::Voltage, Actuator::Speed);
        // Free, and with a load that is held by 2.5 V and 2.3 A.
        let (free, held) = ((0.0, 0.0), (2.5, 2.3));
        for (kind, hold, sample, words) in [
            (voltage, free, sample(0.5, 0.3, 1.0), None),
            (voltage, free, sample(10.2, 0.0, 0.0), Some("speed 10.2")),
            (voltage, free, sample(0.0, 11.2, 0.0), Some("current 11.2")),
            (voltage, free, sample(0.0, 0.0, 60.0), Some("voltage 60.0")),
            (voltage, held, sample(0.0, 2.3, 2.5), None),
            (speed, free, sample(0.0, 3.0, 30.0), None),
            (speed, free, sample(10.2, 3.0, 30.0), Some("speed 10.2")),
        ] {
            let moved = Still::of(&[], &Limits::zk_22fc(), kind, hold).moved(&sample);
            match words {
                Some(words) => has(moved.unwrap_or_default(), words),
                None => assert_eq!(moved, None),
            }
        }
        let mut still = Still::of(&[], &Limits::zk_22fc(), voltage, free);
        let at = |angle| sample(0.0, 0.0, 0.0).with(Channel::Angle, angle);
        assert_eq!(still.moved(&at(7.0)), None);
        has(still.moved(&at(12.0)).unwrap(), "by 5.0");
    }
}
