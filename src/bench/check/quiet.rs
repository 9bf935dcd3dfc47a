//! How fast the link is and how quiet the sensors are, with the output off.

use super::still::{told, unrest, unrest_of_all};
use super::{Checker, NoiseFloor, RATE_CHECK};
use crate::bench::limits::Limits;
use crate::bench::timing::quantile;
use crate::drive::LinkError;
use crate::sample::{Channel, Demand, DriveState, Sample};
use crate::text::number::with_std;

/// Exchanges of the link probe, all with the output disabled.
const PROBES: u64 = 50;
/// Share of probes that may be lost.
const LOST_SHARE: f64 = 0.1;
/// Longest wait for a shaft that coasts, or is braked, after what was before, s.
const COAST_S: f64 = 5.0;

const STANDSTILL: &str = "standstill";
const RUNNING_HELP: &str =
    "stop it where it was started (keypad, terminals, another master or program), then start again";
const STANDSTILL_HELP: &str = "the shaft must stand still and the drive be without a fault: wait until it stands, or clear a latched fault with --reset-fault";

impl Checker<'_> {
    /// Whether the line carries the rate at all, by its baud rate.
    pub(super) fn rate(&mut self, rate_hz: f64) -> bool {
        let most_hz = self.link.shortest_cycle_s().map(|cycle_s| 1.0 / cycle_s);
        let Some(most_hz) = most_hz.filter(|most_hz| *most_hz < rate_hz) else {
            return true;
        };
        let text = format!(
            "the line carries at most {most_hz:.0} Hz at its baud rate, asked {rate_hz} Hz"
        );
        self.note(
            RATE_CHECK,
            false,
            text,
            "lower link.rate_hz, or raise the baud rate",
        )
    }

    /// A drive that was running when it was found is somebody else's; nothing has been asked of it yet.
    pub(super) fn nobody_s(&mut self) -> bool {
        let found = self.link.found();
        let running = found.filter(|sample| sample.state == Some(DriveState::Running));
        running.is_none_or(|sample| self.running(&sample))
    }

    fn running(&mut self, sample: &Sample) -> bool {
        let text = format!("the drive is running; who commands it? {}", told(sample));
        self.note(STANDSTILL, false, text, RUNNING_HELP)
    }

    /// With the output off: waits until the shaft stands, and refuses a drive that runs all the same (`None`).
    fn come_to_rest(
        &mut self,
        first: Sample,
        limits: &Limits,
    ) -> Result<Option<Sample>, LinkError> {
        let mut last = first;
        let begin_s = self.clock.now_s();
        loop {
            if last.state == Some(DriveState::Running) {
                self.running(&last);
                return Ok(None);
            }
            let Some(text) = unrest(&last, limits, true) else {
                return Ok(Some(last));
            };
            let now_s = self.clock.now_s();
            if now_s - begin_s > COAST_S {
                let text = format!("the shaft does not come to rest within {COAST_S} s: {text}");
                self.note(STANDSTILL, false, text, STANDSTILL_HELP);
                return Ok(None);
            }
            self.clock.sleep_until_s(now_s + self.period_s);
            match self.exchange(Demand::Disable) {
                Ok(sample) => last = sample,
                Err(error) if error.is_transient() => {}
                Err(error) => return Err(error),
            }
        }
    }

    /// Set-points that the profile says can be read back, compared with the output off.
    pub(super) fn set_points(&mut self) -> Result<bool, LinkError> {
        Ok(match self.link.compare_set_points()? {
            None => true,
            Some(Ok(text)) => self.note("set-points", true, text, ""),
            Some(Err(text)) => self.note(
                "set-points",
                false,
                text,
                "check address, type and function of the set-point, and whether the drive lets the bus write it",
            ),
        })
    }

    pub(super) fn probe(&mut self, limits: &Limits, rate_hz: f64) -> Result<bool, LinkError> {
        let mut round_trips_s = Vec::new();
        let mut samples = Vec::new();
        let mut last_error = None;
        let mut begin_s = self.clock.now_s();
        for probe in 0..PROBES {
            self.clock
                .sleep_until_s(begin_s + (probe + 1) as f64 * self.period_s);
            let sent_s = self.clock.now_s();
            match self.exchange(Demand::Disable) {
                Ok(mut sample) => {
                    let done_s = if self.clock.is_real() {
                        self.clock.now_s()
                    } else {
                        // Virtual time stands still during an exchange; the link says what the wire would take.
                        sample.host_time_s.unwrap_or(sent_s)
                    };
                    round_trips_s.push(done_s - sent_s);
                    let faulty = sample.state == Some(DriveState::Fault);
                    if samples.is_empty() && !faulty {
                        // What was before is not counted as noise.
                        let from_s = self.clock.now_s();
                        match self.come_to_rest(sample, limits)? {
                            Some(rested) => sample = rested,
                            None => return Ok(false),
                        }
                        begin_s += self.clock.now_s() - from_s;
                    } else if sample.state == Some(DriveState::Running) {
                        return Ok(self.running(&sample));
                    } else if let Some(text) = unrest(&sample, limits, false).filter(|_| !faulty) {
                        let text = format!("the shaft moves with the output off: {text}");
                        return Ok(self.note(STANDSTILL, false, text, STANDSTILL_HELP));
                    }
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
        let line = self.link.line().unwrap_or_default();
        let strays = if line.stale_frames + line.foreign_frames > 0 {
            format!(
                ", {} late and {} foreign frames on the line so far",
                line.stale_frames, line.foreign_frames
            )
        } else {
            String::new()
        };
        let figures = format!(
            "{PROBES} exchanges, {lost} lost, round trip {:.2} ms median, {:.2} ms 99 %, reaches {reachable_hz:.0} Hz, asked {rate_hz} Hz{strays}",
            1e3 * median_s,
            1e3 * tail_s
        );
        let fast = reachable_hz >= rate_hz && lost as f64 <= LOST_SHARE * PROBES as f64;
        if !self.note(
            "link",
            fast,
            figures,
            "lower link.rate_hz, raise the baud rate, or check what adapter and drive take to answer (`drivebench doctor --port PORT`)",
        ) {
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
                // A column of the record, but no signal that has noise.
                continue;
            }
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
                    "{} {} {}",
                    floor.channel.name(),
                    with_std(floor.mean, floor.std),
                    floor.channel.unit()
                )
            })
            .collect();
        let fault = samples
            .last()
            .is_some_and(|sample| sample.state == Some(DriveState::Fault));
        let unrest = unrest_of_all(&self.report.noise, limits);
        let passed = !fault && unrest.is_none();
        let text = match unrest {
            _ if fault => "the drive is in fault".to_owned(),
            Some(unrest) => format!("{unrest} ({})", figures.join(", ")),
            None => figures.join(", "),
        };
        self.note(STANDSTILL, passed, text, STANDSTILL_HELP)
    }

    /// The field of a motor with a separate one: without it a motor at voltage runs away.
    fn field(&mut self, samples: &[Sample], limits: &Limits) -> bool {
        let field_a = samples.iter().rev().find_map(|sample| sample.field_a);
        let (text, passed) = match (field_a, limits.field_min_a) {
            (None, None) => return true,
            (None, Some(least_a)) => (
                format!("the field current is not read, at least {least_a} A are needed"),
                false,
            ),
            (Some(field_a), None) => (
                format!(
                    "{field_a:.3} A; its loss is not watched: the drive's profile gives no limits.field_min_a"
                ),
                true,
            ),
            (Some(field_a), Some(least_a)) => (
                format!("{field_a:.3} A, a trip below {least_a} A"),
                field_a >= least_a,
            ),
        };
        self.note(
            "field",
            passed,
            text,
            "switch the field supply on, check its fuse, and limits.field_min_a of the drive's profile",
        )
    }
}
