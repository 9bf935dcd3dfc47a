//! Whether the speed that is measured can be: a loop that believes a broken encoder runs away with the motor.
//!
//! ```text
//! voltage in force, current --(u = R i + L di/dt + Ke w, over a few cycles)--> speed by the back-EMF
//! speed by the encoder ------------------------------------------------------> far from it: frozen, reversed, implausible
//! speed beyond the reference, growing against the torque --------------------> runaway
//! ```
//!
//! The inertia does not come in, nor the load: both may change while the loop runs. The tolerance leaves room for a
//! winding that is warm, a flux of another specimen and the drops of the power stage.

use std::collections::VecDeque;

use crate::bench::guard::{Trip, TripKind};
use crate::bench::limits::Nameplate;
use crate::plant::{Model, MotorKey};

/// Cycles over which the back-EMF is averaged.
const WINDOW: usize = 3;
/// Windows in a row that have to disagree.
const CONFIRM: u32 = 2;
/// Doubt of the voltage balance: of the resistance and the inductance, of the trapezoid of a current that moves within
/// a cycle, of the flux, and of the rated voltage for drops that depend on nothing.
const RESISTANCE_DOUBT: f64 = 0.25;
const INDUCTANCE_DOUBT: f64 = 0.3;
const TRAPEZOID_DOUBT: f64 = 0.15;
const FLUX_DOUBT: f64 = 0.2;
const VOLTAGE_DOUBT: f64 = 0.03;
/// Without current, by this share of the rated one, nothing drives the shaft, and a drive may only be slow to switch its
/// output on: what disagrees then has to go on for so long, s.
const IDLE_SHARE: f64 = 0.02;
const IDLE_S: f64 = 0.3;
/// Readings that are the same to the bit and count as frozen, where the back-EMF has changed meanwhile.
const SAME_READINGS: u32 = 4;
/// Share of the rated voltage by which the back-EMF has to change at least.
const CHANGE_DOUBT: f64 = 0.01;
/// Time for which a sensor that was noisy at rest may read the same to the bit while the shaft turns, s.
const STUCK_S: f64 = 2.0;
/// A runaway: so many cycles in a row the speed grows beyond its reference although the torque is against it, by this
/// share of the speed limit and from this share beyond the reference.
const RUNAWAY_CYCLES: usize = 4;
const RUNAWAY_GROWTH: f64 = 0.01;
const RUNAWAY_BEYOND: f64 = 0.05;

/// One sample as the watch needs it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Seen {
    pub(super) time_s: f64,
    pub(super) speed_rad_s: f64,
    pub(super) current_a: f64,
    /// The voltage that is in force from this sample on, V; `None` where a limit of the drive makes it unknown.
    pub(super) voltage_v: Option<f64>,
    pub(super) reference_rad_s: f64,
}

/// What one cycle adds to the voltage balance.
#[derive(Clone, Copy, Debug)]
struct Row {
    seconds: f64,
    /// Of `u - R i`, Vs.
    volt_seconds: f64,
    current_change: f64,
    mean_current: f64,
    /// Of the measured speed, rad.
    turned: f64,
}

/// The speed over the window, two ways, rad/s.
#[derive(Clone, Copy, Debug)]
struct Balance {
    by_encoder: f64,
    by_voltage: f64,
    /// Difference that is believed.
    doubt: f64,
    mean_current: f64,
}

impl Balance {
    fn disagrees(&self) -> bool {
        (self.by_encoder - self.by_voltage).abs() > self.doubt
    }

    fn is_reversed(&self) -> bool {
        self.by_encoder * self.by_voltage < 0.0
            && (self.by_encoder + self.by_voltage).abs() <= self.doubt
    }

    fn trip(&self, kind: TripKind, now_s: f64, what: &str) -> Trip {
        let figures = (self.by_encoder, self.by_voltage, self.doubt);
        Trip::of_speed(kind, now_s, figures, what)
    }
}

#[derive(Clone, Debug)]
pub(super) struct EncoderWatch {
    resistance_ohm: f64,
    inductance_h: f64,
    back_emf_v_s_per_rad: f64,
    drop_v: f64,
    speed_limit_rad_s: f64,
    longest_cycle_s: f64,
    idle_a: f64,
    /// Since when there has been a voltage that drives nothing.
    idle_since_s: Option<f64>,
    last: Option<Seen>,
    rows: VecDeque<Row>,
    disagree: u32,
    same: u32,
    /// Time of the first of the same readings.
    same_since_s: f64,
    /// The balance when they began.
    same_balance: Option<Balance>,
    /// The speed sensor was noisy at rest.
    is_noisy: bool,
    change_v: f64,
    /// Speeds of a shaft that runs away, so far.
    away: Vec<f64>,
    /// The encoder has turned as voltage and current say.
    direction_seen: bool,
}

impl EncoderWatch {
    pub(super) fn new(
        model: &Model,
        motor: &Nameplate,
        speed_limit_rad_s: f64,
        period_s: f64,
        is_noisy: bool,
    ) -> Self {
        let value = |key, plate| model.motor.get(key).unwrap_or(plate);
        Self {
            resistance_ohm: value(MotorKey::Resistance, motor.resistance_ohm),
            inductance_h: value(MotorKey::Inductance, motor.inductance_h),
            back_emf_v_s_per_rad: value(MotorKey::BackEmf, motor.back_emf_v_s_per_rad),
            drop_v: VOLTAGE_DOUBT * motor.rated_voltage_v,
            speed_limit_rad_s,
            // Beyond, another command was in force meanwhile.
            longest_cycle_s: 1.5 * period_s,
            idle_a: IDLE_SHARE * motor.rated_current_a,
            idle_since_s: None,
            last: None,
            rows: VecDeque::with_capacity(WINDOW + 1),
            disagree: 0,
            same: 0,
            same_since_s: 0.0,
            same_balance: None,
            is_noisy,
            change_v: CHANGE_DOUBT * motor.rated_voltage_v,
            away: Vec::with_capacity(RUNAWAY_CYCLES + 1),
            direction_seen: false,
        }
    }

    /// A start: what was proven before may have been plugged in anew.
    pub(super) fn begin(&mut self) {
        self.reset();
        self.direction_seen = false;
    }

    /// Whether the encoder has been seen to turn in the right direction since the start.
    pub(super) const fn has_seen_direction(&self) -> bool {
        self.direction_seen
    }

    /// Nothing of before counts.
    pub(super) fn reset(&mut self) {
        self.last = None;
        self.rows.clear();
        (self.disagree, self.same, self.same_balance) = (0, 0, None);
        self.idle_since_s = None;
        self.away.clear();
    }

    /// Looks at one sample.
    pub(super) fn look(&mut self, now_s: f64, seen: Seen) -> Option<Trip> {
        let last = self.last.replace(seen)?;
        let runs_away = self.runs_away(now_s, &last, &seen);
        let balance = self.balance(&last, &seen);
        if seen.speed_rad_s.to_bits() == last.speed_rad_s.to_bits() {
            if self.same == 0 {
                self.same_since_s = last.time_s;
            }
            self.same += 1;
            self.same_balance = self.same_balance.or(balance);
        } else {
            (self.same, self.same_balance) = (0, None);
        }
        let Some(balance) = balance else {
            self.disagree = 0;
            return runs_away.or_else(|| self.drives_nothing(now_s, &last));
        };
        self.idle_since_s = None;
        self.direction_seen |= !balance.disagrees() && balance.by_encoder.abs() > balance.doubt;
        self.frozen(now_s, seen.time_s, &balance)
            .or_else(|| self.disagrees(now_s, &balance))
            .or_else(|| {
                // Seen by a reversed encoder the shaft runs away as soon as it moves.
                let runaway = runs_away?;
                let what = "has the wrong sign:";
                Some(if balance.is_reversed() {
                    balance.trip(TripKind::EncoderReversed, now_s, what)
                } else {
                    runaway
                })
            })
    }

    /// The voltage balance over the window; `None` until it is full of cycles in which the voltage was known.
    fn balance(&mut self, last: &Seen, seen: &Seen) -> Option<Balance> {
        let seconds = seen.time_s - last.time_s;
        let flows = last.current_a.abs() >= self.idle_a;
        let known = flows && seconds > 0.0 && seconds < self.longest_cycle_s;
        let Some(volts) = last.voltage_v.filter(|_| known) else {
            self.rows.clear();
            return None;
        };
        let mean_current = 0.5 * (last.current_a + seen.current_a);
        self.rows.push_back(Row {
            seconds,
            volt_seconds: seconds * (volts - self.resistance_ohm * mean_current),
            current_change: seen.current_a - last.current_a,
            mean_current,
            turned: 0.5 * seconds * (last.speed_rad_s + seen.speed_rad_s),
        });
        if self.rows.len() > WINDOW {
            self.rows.pop_front();
        }
        if self.rows.len() < WINDOW {
            return None;
        }
        let sum = |of: fn(&Row) -> f64| self.rows.iter().map(of).sum::<f64>();
        let (seconds, rows) = (sum(|row| row.seconds), self.rows.len() as f64);
        let change = sum(|row| row.current_change);
        let by_voltage = (sum(|row| row.volt_seconds) - self.inductance_h * change)
            / (seconds * self.back_emf_v_s_per_rad);
        let moves = sum(|row| row.current_change.abs()) / rows;
        let current = sum(|row| row.mean_current.abs()) / rows;
        let doubt_v = self.drop_v
            + self.resistance_ohm * (RESISTANCE_DOUBT * current + TRAPEZOID_DOUBT * moves)
            + INDUCTANCE_DOUBT * self.inductance_h * change.abs() / seconds;
        Some(Balance {
            by_encoder: sum(|row| row.turned) / seconds,
            by_voltage,
            doubt: doubt_v / self.back_emf_v_s_per_rad + FLUX_DOUBT * by_voltage.abs(),
            mean_current: sum(|row| row.mean_current) / rows,
        })
    }

    /// The same reading again and again, while the back-EMF has changed since it came first, or for too long.
    fn frozen(&self, now_s: f64, time_s: f64, balance: &Balance) -> Option<Trip> {
        if self.same < SAME_READINGS {
            return None;
        }
        let first = self.same_balance.as_ref()?;
        let change = (balance.by_voltage - first.by_voltage).abs();
        let by_current = (balance.mean_current - first.mean_current).abs();
        let doubt_v = self.change_v + RESISTANCE_DOUBT * self.resistance_ohm * by_current;
        let moved = (1.0 - FLUX_DOUBT) * change > doubt_v / self.back_emf_v_s_per_rad;
        let is_stuck = self.is_noisy
            && time_s - self.same_since_s > STUCK_S
            && balance.by_voltage.abs() > balance.doubt;
        (moved || is_stuck).then(|| balance.trip(TripKind::EncoderFrozen, now_s, "stays at"))
    }

    /// No current flows although the voltage is not that of the speed, for too long.
    fn drives_nothing(&mut self, now_s: f64, last: &Seen) -> Option<Trip> {
        let by_voltage = last.voltage_v? / self.back_emf_v_s_per_rad;
        let doubt = self.drop_v / self.back_emf_v_s_per_rad + FLUX_DOUBT * by_voltage.abs();
        let idle = last.current_a.abs() < self.idle_a;
        if !idle || (by_voltage - last.speed_rad_s).abs() <= doubt {
            self.idle_since_s = None;
            return None;
        }
        let since_s = *self.idle_since_s.get_or_insert(last.time_s);
        let figures = (last.speed_rad_s, by_voltage, doubt);
        (last.time_s - since_s > IDLE_S)
            .then(|| Trip::of_speed(TripKind::SpeedImplausible, now_s, figures, "is"))
    }

    fn disagrees(&mut self, now_s: f64, balance: &Balance) -> Option<Trip> {
        if !balance.disagrees() {
            self.disagree = 0;
            return None;
        }
        self.disagree += 1;
        if self.disagree < CONFIRM {
            return None;
        }
        let (kind, what) = if self.same >= SAME_READINGS {
            (TripKind::EncoderFrozen, "stays at")
        } else if balance.is_reversed() {
            (TripKind::EncoderReversed, "has the wrong sign:")
        } else {
            (TripKind::SpeedImplausible, "is")
        };
        Some(balance.trip(kind, now_s, what))
    }

    fn runs_away(&mut self, now_s: f64, last: &Seen, seen: &Seen) -> Option<Trip> {
        let direction = seen.speed_rad_s.signum();
        let beyond = direction * (seen.speed_rad_s - seen.reference_rad_s);
        let grows = direction * (seen.speed_rad_s - last.speed_rad_s) > 0.0;
        let braked = direction * 0.5 * (last.current_a + seen.current_a) < 0.0;
        if !(grows && braked && beyond > RUNAWAY_BEYOND * self.speed_limit_rad_s) {
            self.away.clear();
            return None;
        }
        if self.away.is_empty() {
            self.away.push(last.speed_rad_s);
        }
        self.away.push(seen.speed_rad_s);
        let growth = direction * (seen.speed_rad_s - self.away[0]);
        let long = self.away.len() > RUNAWAY_CYCLES;
        (long && growth > RUNAWAY_GROWTH * self.speed_limit_rad_s)
            .then(|| Trip::runaway(now_s, seen.speed_rad_s, seen.reference_rad_s))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plant::propagator::LinearPart;

    const PERIOD_S: f64 = 0.01;

    fn watch() -> EncoderWatch {
        let motor = Nameplate::zk_22fc();
        let model = Model::baseline(motor.motor());
        EncoderWatch::new(&model, &motor, 340.0, PERIOD_S, true)
    }

    /// The motor under a voltage; `encoder` says what is read. Returns the trip and the true speed at it.
    fn run(
        voltage: impl Fn(f64) -> f64,
        mut encoder: impl FnMut(f64, f64) -> f64,
        factors: [f64; 2],
        reference: f64,
    ) -> Option<(Trip, f64)> {
        let (r, l, ke, j) = (1.1 * factors[0], 0.0099, 0.3538 * factors[1], 0.0045);
        let part = LinearPart::new(&[[-r / l, -ke / l], [ke / j, 0.0]]);
        let propagator = part.over(PERIOD_S / 50.0);
        let mut x = [0.0, 0.0];
        let mut watch = watch();
        for n in 0..300 {
            let time_s = f64::from(n) * PERIOD_S;
            let volts = voltage(time_s);
            let seen = Seen {
                time_s,
                speed_rad_s: encoder(time_s, x[1]),
                current_a: x[0],
                voltage_v: Some(volts),
                reference_rad_s: reference,
            };
            if let Some(trip) = watch.look(time_s, seen) {
                return Some((trip, x[1]));
            }
            for _ in 0..50 {
                x = propagator.apply(x, [volts / l, -0.455 / j * f64::from(u8::from(x[1] > 0.0))]);
            }
        }
        None
    }

    fn steps(time_s: f64) -> f64 {
        let levels = [0.0, 12.0, 40.0, 20.0, 0.0, -15.0];
        let ends = [0.5, 1.0, 1.5, 2.0, 2.5];
        levels[ends.partition_point(|end_s| *end_s <= time_s)]
    }

    #[test]
    fn a_healthy_encoder_passes_with_a_warm_winding_and_another_flux() {
        for factors in [[1.0, 1.0], [1.3, 1.0], [0.8, 1.15], [1.2, 0.85]] {
            let found = run(steps, |_, speed| speed, factors, 100.0);
            assert!(found.is_none(), "{factors:?}: {found:?}");
        }
    }

    #[test]
    fn a_reversed_encoder_is_found_within_a_few_percent_of_the_speed() {
        let (trip, speed) = run(|_| 11.0, |_, speed| -speed, [1.0, 1.0], 100.0).unwrap();
        assert_eq!(trip.kind, TripKind::EncoderReversed, "{trip:?}");
        assert!(speed < 0.05 * 340.0, "{speed}");
    }

    #[test]
    fn a_frozen_encoder_is_found_at_rest_and_under_way() {
        let (trip, speed) = run(|_| 11.0, |_, _| 0.0, [1.0, 1.0], 100.0).unwrap();
        assert_eq!(trip.kind, TripKind::EncoderFrozen);
        assert!(speed < 0.1 * 340.0, "{speed}");
        let mut held = None;
        let (trip, _) = run(
            steps,
            |time_s, speed| {
                if time_s < 1.4 {
                    speed
                } else {
                    *held.get_or_insert(speed)
                }
            },
            [1.0, 1.0],
            100.0,
        )
        .unwrap();
        assert_eq!(trip.kind, TripKind::EncoderFrozen);
        assert!(trip.at_s < 1.6, "{trip:?}");
    }

    #[test]
    fn a_noisy_sensor_that_says_the_same_for_two_seconds_is_stuck() {
        let stuck = |is_noisy| {
            let mut watch = watch();
            watch.is_noisy = is_noisy;
            (0..400).find_map(|n| {
                let time_s = f64::from(n) * PERIOD_S;
                let seen = Seen {
                    time_s,
                    speed_rad_s: 100.0,
                    current_a: 1.3,
                    voltage_v: Some(36.8),
                    reference_rad_s: 100.0,
                };
                watch.look(time_s, seen).map(|trip| (trip.kind, trip.at_s))
            })
        };
        let (kind, at_s) = stuck(true).unwrap();
        assert_eq!(kind, TripKind::EncoderFrozen);
        assert!((2.0..2.1).contains(&at_s), "{at_s}");
        assert_eq!(stuck(false), None);
    }

    #[test]
    fn a_speed_that_is_none_of_these_is_implausible() {
        let (trip, _) = run(steps, |_, speed| 2.0 * speed, [1.0, 1.0], 100.0).unwrap();
        assert_eq!(trip.kind, TripKind::SpeedImplausible, "{trip:?}");
    }

    #[test]
    fn a_shaft_that_is_driven_beyond_its_reference_against_the_torque_runs_away_within_five_cycles()
    {
        let mut watch = watch();
        let mut found = None;
        for n in 0..20 {
            let t = f64::from(n) * PERIOD_S;
            // A load drives it at 300 rad/s^2 from 100 rad/s on, the current brakes as far as it may.
            let speed = 100.0 + 300.0 * t;
            let seen = Seen {
                time_s: t,
                speed_rad_s: speed,
                current_a: -10.0,
                voltage_v: Some(0.3538 * (speed + 1.5) - 11.0),
                reference_rad_s: 80.0,
            };
            found = watch.look(t, seen).map(|trip| (trip, n));
            if found.is_some() {
                break;
            }
        }
        let (trip, n) = found.unwrap();
        assert_eq!(trip.kind, TripKind::Runaway);
        assert!(n <= 5, "{n}");
        // The same while it is braked from above the reference and slows down is the normal case.
        let mut watch = self::watch();
        for n in 0..30 {
            let t = f64::from(n) * PERIOD_S;
            let speed = 160.0 - 100.0 * t;
            let seen = Seen {
                time_s: t,
                speed_rad_s: speed,
                current_a: -10.0,
                voltage_v: Some(0.3538 * (speed - 0.5) - 11.0),
                reference_rad_s: 80.0,
            };
            assert_eq!(watch.look(t, seen), None);
        }
    }
}
