//! Plausibility without a balance: set-point against measured value, exchanged readings, angle against speed, and a speed that
//! grows beyond its reference.

use super::{Agreement, CHECK_ENCODER, CHECK_SET_POINT, Departure, Plausibility, Runaway};
use crate::trip::{Trip, TripKind};
use drivebench_identify::belief::{Range, Reading, Row, Settings};
use drivebench_model::sample::Demand;

impl Plausibility {
    /// Two readings that fit only when exchanged.
    pub(crate) fn swapped(&self) -> Option<Trip> {
        let plate = self.plate.filter(|_| !self.waived)?;
        let last = self.history.last()?;
        let (current, speed) = (last.current_a?, last.speed_rad_s?);
        let swapped =
            |figures, what: &str| Some(self.trip(TripKind::SignalsSwapped, figures, what));
        if let (Some((Demand::Voltage(_), set_point)), Some(volts)) =
            (self.history.set_points(self.cycles()), last.voltage_v)
            && !last.limited
        {
            let wanted = set_point.middle();
            let about = set_point.times(Settings::KNOWN_SCALE).wider(self.rest_v());
            let is_near = |value: f64| about.gap(Range::at(value)) <= 0.0;
            let is_far = wanted.abs() > Settings::CLEAR * self.scale.volts;
            if is_near(current) && !is_near(volts) && is_far {
                let what = format!(
                    "the current reads {current:.2} A and the voltage {volts:.2} V, at a set-point of {wanted:.2} V: exchanged, both would fit; check the addresses of voltage and current in the drive's profile"
                );
                return swapped((volts, wanted), &what);
            }
        }
        if speed.abs() > self.bounds.current_a || current.abs() > self.bounds.speed_rad_s {
            return None;
        }
        let floor = 2.0 * Settings::JUDGED * self.scale.volts;
        let both_ways = |row: &Row| {
            let volts = row.volts?;
            let misfit = |a: f64, b: f64| volts.gap(Range::at(plate.steady_v(a, b)));
            let (a, b) = row.ends();
            Some((misfit(a, b), misfit(b, a)))
        };
        let misfits: Vec<(f64, f64)> =
            self.latest(Settings::MOST_ROWS).map_while(both_ways).collect();
        let (as_read, exchanged) = *misfits.first()?;
        // Every row that does not fit as read has to fit when exchanged.
        let explains = |(as_read, exchanged): &(f64, f64)| {
            *exchanged < floor.min(Settings::UNEXPLAINED * as_read)
        };
        let all = misfits.iter().filter(|(as_read, _)| *as_read > floor).all(explains);
        if as_read <= floor || !all {
            return None;
        }
        let what = format!(
            "current {current:.2} A and speed {speed:.2} rad/s miss the voltage by {as_read:.1} V; exchanged, {speed:.2} A and {current:.2} rad/s miss it by {exchanged:.1} V; check the addresses of current and speed in the drive's profile"
        );
        swapped((current, speed), &what)
    }

    /// A trip beyond a limit, with the contradiction to the reading that exceeds it.
    pub(crate) fn explained(&mut self, mut beyond: Trip) -> Trip {
        if let Some(trip) = self.swapped() {
            return trip;
        }
        let contradiction = self.plate.and_then(|plate| {
            let window = self.window(&plate, 1)?;
            window.misfits(self.drop_v()).then(|| self.isolate(&plate, &window))?
        });
        if let Some(contradiction) = contradiction {
            beyond.reason = format!("{}; or {}", beyond.reason, contradiction.reason);
        }
        beyond
    }

    /// A set-point that the drive does not follow.
    pub(super) fn follows(&mut self) -> Option<Trip> {
        let cycles = self.cycles();
        let last = *self.history.last()?;
        let set_point = self.history.set_points(cycles - 2);
        let Some((demand, set_point)) = set_point else {
            self.symptoms.departure = None;
            return None;
        };
        let period_s = self.history.period_s()?;
        let latency_s = Settings::LATENCY_S.max(Settings::LATENCY_CYCLES as f64 * period_s);
        let (speed, current) = (last.speed_rad_s?, last.current_a?);
        let idle = current.abs() < self.idle_a() && speed.abs() < self.rest_rad_s();
        let factors = match demand {
            Demand::Voltage(_) if self.proven.voltage_scale => Settings::KNOWN_SCALE,
            _ if self.waived => Range::new(0.1, 10.0),
            _ => Settings::ANY_FACTOR,
        };
        let mut region = set_point.times(factors);
        let (measured, full, confirm_s, unit) = match demand {
            Demand::Voltage(_) => {
                region = region.wider(self.drop_v());
                let soon_s = if last.exact { 0.6 * latency_s } else { 1.5 * period_s };
                let confirm_s = if idle { Settings::IDLE_S } else { soon_s };
                if last.limited || current.abs() > self.bounds.limiting_a {
                    // A limit brings the voltage nearer to the back-EMF, never beyond it.
                    let emf = self.plate.map(|plate| Range::at(plate.steady_v(0.0, speed)));
                    let plausible =
                        |emf: Range| emf.times(Settings::ANY_FACTOR).wider(self.drop_v());
                    region = emf.map_or(Range::EVERY, |emf| region.union(plausible(emf)));
                }
                (last.voltage_v, self.scale.volts, confirm_s, "V")
            }
            Demand::Current(_) => {
                let amps = self.scale.amps;
                region = region.wider(Settings::FOLLOWS * amps);
                let emf_v = self.plate.map_or(0.0, |plate| plate.steady_v(0.0, speed));
                let has_room = last.voltage_v.unwrap_or(2.0 * emf_v).abs() < 0.9 * self.scale.volts;
                if !self.proven.current_sign {
                    region = region.union(region.negative());
                }
                let measured = Some(current).filter(|_| has_room && !last.limited);
                let confirm_s = latency_s.max(0.4);
                (measured, amps, confirm_s, "A")
            }
            _ => {
                region = region.wider(Settings::FOLLOWS * self.scale.rad_s);
                // With the unknown ramp of the drive.
                let confirm_s = latency_s.max(2.0);
                let measured = Some(speed).filter(|_| !last.limited);
                (measured, self.scale.rad_s, confirm_s, "rad/s")
            }
        };
        let wanted = set_point.middle();
        let not_followed = |watch: &Self, region: Range, value: f64, for_s: f64| {
            let figures = format!(
                "set-point {wanted:.2} {unit}, measured {value:.2} {unit} for {for_s:.2} s, {:.2} to {:.2} {unit} is plausible",
                region.low, region.high
            );
            watch.not_followed(demand, (value, wanted), idle, &figures)
        };
        if let (Demand::Voltage(_), Some(value)) = (demand, measured)
            && let Some(for_s) = self.stays(set_point, value).filter(|for_s| *for_s >= confirm_s)
        {
            let region = set_point.wider(self.drop_v());
            return Some(not_followed(self, region, value, for_s));
        }
        let distance = measured.map_or(0.0, |value| region.gap(Range::at(value)));
        let Some(value) = measured.filter(|_| distance > 0.0) else {
            self.symptoms.departure = None;
            return None;
        };
        let departure = Departure { since_s: last.time_s, distance };
        let first = self.symptoms.departure.get_or_insert(departure);
        if distance < first.distance - 0.01 * full {
            // It approaches.
            *first = departure;
            return None;
        }
        let for_s = last.time_s - first.since_s;
        if for_s < confirm_s {
            return None;
        }
        self.swapped().or_else(|| Some(not_followed(self, region, value, for_s)))
    }

    /// Time for which the measured voltage has not moved although the set-point has, s. A reading of a wrong scale would move
    /// with it, so no tolerance of scale is needed; behind a guard that limits the set-point to the back-EMF nothing else is
    /// observable.
    fn stays(&mut self, set_point: Range, value: f64) -> Option<f64> {
        let last = *self.history.last()?;
        let read = Range::at(value);
        if set_point.wider(self.drop_v()).gap(read) <= 0.0 {
            // The nearest of the set-points that may be in force; while the voltage stays, also of the earlier ones.
            let nearest = value.clamp(set_point.low, set_point.high);
            let agrees = self.symptoms.agreement.is_none_or(|last| {
                let moves = (value - last.measured_v).abs() > self.rest_v();
                moves || (nearest - value).abs() <= (last.set_point_v - last.measured_v).abs()
            });
            if agrees {
                self.symptoms.agreement = Some(Agreement {
                    set_point_v: nearest,
                    measured_v: value,
                    stuck_since_s: None,
                });
            }
            let is_steady = set_point.width() < self.drop_v();
            let is_clear =
                Settings::KNOWN_SCALE.high.mul_add(value.abs(), -value.abs()) > self.drop_v();
            self.proven.voltage_scale |= is_steady && is_clear;
        }
        let beyond = |current: f64| current.abs() > self.bounds.limiting_a;
        let is_limited = last.limited || last.current_a.is_some_and(beyond);
        let agreement = self.symptoms.agreement.as_mut()?;
        let moved = set_point.gap(Range::at(agreement.set_point_v));
        let stays = moved > 1.5 * Settings::DROP * self.scale.volts
            && (value - agreement.measured_v).abs() < Settings::UNEXPLAINED * moved;
        if is_limited || !stays {
            agreement.stuck_since_s = None;
            return None;
        }
        Some(last.time_s - *agreement.stuck_since_s.get_or_insert(last.time_s))
    }

    fn not_followed(
        &self,
        demand: Demand,
        (value, wanted): (f64, f64),
        idle: bool,
        figures: &str,
    ) -> Trip {
        if let (Demand::Voltage(_), Some(plate)) = (demand, &self.plate)
            && let Some(row) = self.history.rows().back().filter(|_| !idle)
        {
            let response = plate.current_v(row) + plate.steady_v(0.0, row.speed_rad_s);
            let distance = |volts: f64| (response - volts).abs();
            if 2.0 * distance(wanted) < distance(value)
                && distance(wanted)
                    < self.drop_v() + (1.0 - Settings::FLUX_FACTOR.low) * wanted.abs()
            {
                let what = format!(
                    "{figures}; current and speed are those of {response:.1} V, so the measured voltage is wrong; check its address, scale and sign in the drive's profile"
                );
                return self.trip(TripKind::VoltageImplausible, (value, wanted), &what);
            }
        }
        let what = format!("{figures}; {CHECK_SET_POINT}");
        self.trip(TripKind::SetPointIgnored, (value, wanted), &what)
    }

    /// The angle turned over the last cycles against the speed.
    pub(super) fn by_angle(&mut self) -> Option<Trip> {
        // An angle that is read less often than once a cycle stays for some cycles; the confirmations come on top.
        let times = if self.is_exact() { 1 } else { 2 };
        let rows = times * self.cycles() - Settings::CONFIRMING_WINDOWS;
        if self.history.rows().len() < rows {
            return None;
        }
        let (mut seconds, mut turned, mut speeds) = (0.0, 0.0, None);
        let (mut by_speed, mut widest) = (0.0, 0.0_f64);
        // A counter that was preset is no motion: the row with the largest misfit is left out.
        let mut worst = (0.0, 0.0, 0.0);
        for row in self.latest(rows) {
            let row_rad = row.turned_rad?;
            let misfit = (row_rad - row.speed_rad_s * row.seconds).abs();
            if misfit >= worst.0 {
                worst = (misfit, row_rad, row.seconds);
            }
            turned += row_rad;
            by_speed += row.speed_rad_s * row.seconds;
            let hidden = row.speed_lead_rad_s.abs();
            widest = widest.max(row.speed_change_rad_s.abs()).max(hidden);
            seconds += row.seconds;
            let range = Range::around(row.speed_rad_s, 0.5 * row.speed_change_rad_s.abs())
                .with(row.speed_rad_s + row.speed_lead_rad_s);
            speeds = Some(speeds.map_or(range, |speeds: Range| speeds.union(range)));
        }
        let rate = (turned - worst.1) / (seconds - worst.2);
        // Of stamped speeds the mean is narrower than their range.
        let speeds =
            if self.is_exact() { Range::around(by_speed / seconds, widest) } else { speeds? };
        let plausible = speeds.times(Settings::ANY_FACTOR).wider(2.0 * self.rest_rad_s());
        if plausible.gap(Range::at(rate)) <= 0.0 {
            self.symptoms.angle_windows = 0;
            return None;
        }
        self.symptoms.angle_windows += 1;
        if self.symptoms.angle_windows < Settings::CONFIRMING_WINDOWS {
            return None;
        }
        let speed = speeds.middle();
        let what = format!(
            "the angle turns by {rate:.1} rad/s, the measured speed is {speed:.1} rad/s, {:.1} to {:.1} rad/s is plausible; {CHECK_ENCODER}",
            plausible.low, plausible.high
        );
        let kind = if self.speed.run() >= Settings::REPEATED {
            TripKind::EncoderFrozen
        } else {
            TripKind::AngleImplausible
        };
        Some(self.trip(kind, (rate, speed), &what))
    }

    /// The speed grows beyond its reference although the torque is against it.
    pub(super) fn runs_away(&mut self) -> Option<Trip> {
        let row = *self.history.rows().back()?;
        let speed = self.history.last()?.speed_rad_s?;
        let reference = self.reference_rad_s?;
        let direction = speed.signum();
        let beyond = direction * (speed - reference);
        let grows = direction * row.speed_change_rad_s > 0.0;
        let braked = direction * row.current_a < 0.0;
        if !(grows && braked && beyond > Settings::CLEAR * self.bounds.speed_rad_s) {
            self.symptoms.runaway = None;
            return None;
        }
        let runaway = self
            .symptoms
            .runaway
            .get_or_insert(Runaway { from_rad_s: speed - row.speed_change_rad_s, cycles: 0 });
        runaway.cycles += 1;
        let growth = direction * (speed - runaway.from_rad_s);
        let long = runaway.cycles >= Settings::REPEATED;
        if !(long && growth > Settings::REST * self.bounds.speed_rad_s) {
            return None;
        }
        // With a reversed encoder the shaft runs away as soon as it moves.
        if let Some(plate) = self.plate
            && let Some(window) = self.window(&plate, Settings::STAMPED_ROWS)
            && window.is_mirrored(Reading::Speed, 0.0, 0.0)
        {
            return Some(self.misread(TripKind::EncoderReversed, &plate, &window));
        }
        let what = format!(
            "the speed grows to {speed:.1} rad/s against the torque, the reference is {reference:.1} rad/s"
        );
        Some(self.trip(TripKind::Runaway, (speed, reference), &what))
    }
}
