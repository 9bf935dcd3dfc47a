//! Whether the drive does what it is asked, and readings that stand in each other's place.

use super::balance::negative;
use super::history::Range;
use super::{
    ANY, CHECK_SET_POINT, FOLLOWS_CURRENT, FOLLOWS_CURRENT_S, FOLLOWS_SPEED, FOLLOWS_SPEED_S,
    IDLE_A, IDLE_S, KNOWN_SCALE, LATENCY_CYCLES, LATENCY_S, LONGEST_WINDOW, Plausibility,
    REST_SPEED, STAYS_SHARE, STAYS_V,
};
use crate::bench::guard::{Trip, TripKind};
use crate::sample::Demand;

/// A set-point that is not followed.
struct Astray {
    demand: Demand,
    asked: Range,
    /// What would be believed.
    region: Range,
    value: f64,
    unit: &'static str,
    /// Nothing flows and nothing turns.
    idle: bool,
    for_s: f64,
}

impl Plausibility {
    /// Two readings that fit in each other's place and not in their own.
    pub(in crate::bench) fn swapped(&self, now_s: f64) -> Option<Trip> {
        let plate = self.plate.filter(|_| !self.waived)?;
        let last = self.history.last()?;
        let (current, speed) = (last.current_a?, last.speed_rad_s?);
        if let (Some((Demand::Voltage(_), asked)), Some(volts)) =
            (self.history.asked(self.cycles()), last.voltage_v)
            && !last.limited
        {
            let near = |value: f64| {
                asked
                    .times(Range::new(0.9, 1.1))
                    .wider(0.02 * self.scale.volts)
                    .gap(Range::new(value, value))
                    <= 0.0
            };
            let far = asked.middle().abs() > 0.05 * self.scale.volts;
            if near(current) && !near(volts) && far {
                let what = format!(
                    "the current reads {current:.2} A and the voltage {volts:.2} V, where {:.2} V were asked: exchanged, both would fit; check the addresses of voltage and current in the drive's profile",
                    asked.middle()
                );
                return Some(Trip::implausible(
                    TripKind::SignalsSwapped,
                    now_s,
                    (volts, asked.middle()),
                    &what,
                ));
            }
        }
        if speed.abs() > self.current_limit_a || current.abs() > self.speed_limit_rad_s {
            return None;
        }
        let floor = 0.03 * self.scale.volts;
        let last_rows = self.history.rows().iter().rev().take(LONGEST_WINDOW);
        let misfits: Vec<(f64, f64)> = last_rows
            .map_while(|row| {
                let volts = row.volts?;
                let misfit = |current_a: f64, speed_rad_s: f64| {
                    let needed = plate.resistance * current_a + plate.back_emf * speed_rad_s;
                    volts.gap(Range::new(needed, needed))
                };
                let (current_a, speed_rad_s) = row.ends();
                Some((
                    misfit(current_a, speed_rad_s),
                    misfit(speed_rad_s, current_a),
                ))
            })
            .collect();
        let (as_read, exchanged) = *misfits.first()?;
        // Every row that does not fit as it was read has to fit when exchanged.
        let all = misfits
            .iter()
            .filter(|(as_read, _)| *as_read > floor)
            .all(|(as_read, exchanged)| exchanged < &(0.3 * as_read) && *exchanged < floor);
        let what = format!(
            "current {current:.2} A and speed {speed:.2} rad/s miss the voltage by {as_read:.1} V; exchanged, {speed:.2} A and {current:.2} rad/s miss it by {exchanged:.1} V; check the addresses of current and speed in the drive's profile"
        );
        (as_read > floor && all)
            .then(|| Trip::implausible(TripKind::SignalsSwapped, now_s, (current, speed), &what))
    }

    /// A trip beyond a limit, with what speaks against the reading that broke it.
    pub(in crate::bench) fn explained(&mut self, now_s: f64, mut beyond: Trip) -> Trip {
        if let Some(trip) = self.swapped(now_s) {
            return trip;
        }
        let doubt = self.plate.and_then(|plate| {
            let window = self.window(&plate, 1)?;
            let doubted = window.gap(ANY, ANY, self.drop_v()) > 0.0;
            doubted.then(|| self.name(now_s, &plate, &window)).flatten()
        });
        if let Some(doubt) = doubt {
            beyond.reason = format!("{}; or {}", beyond.reason, doubt.reason);
        }
        beyond
    }

    /// Whether the drive does what it is asked.
    pub(super) fn follows(&mut self, now_s: f64) -> Option<Trip> {
        let cycles = self.cycles();
        let last = *self.history.last()?;
        let asked = self.history.asked(cycles - 2);
        let Some((demand, asked)) = asked else {
            self.astray = None;
            return None;
        };
        let period_s = self.history.period_s()?;
        let latency_s = LATENCY_S.max(LATENCY_CYCLES as f64 * period_s);
        let (speed, current) = (last.speed_rad_s?, last.current_a?);
        let idle =
            current.abs() < IDLE_A * self.scale.amps && speed.abs() < REST_SPEED * self.scale.rad_s;
        let factors = match demand {
            Demand::Voltage(_) if self.scale_seen => KNOWN_SCALE,
            _ if self.waived => Range::new(0.1, 10.0),
            _ => ANY,
        };
        let mut region = asked.times(factors);
        let (measured, full, confirm_s, unit) = match demand {
            Demand::Voltage(_) => {
                region = region.wider(self.drop_v());
                let soon_s = if last.exact {
                    0.6 * latency_s
                } else {
                    1.5 * period_s
                };
                let confirm_s = if idle { IDLE_S } else { soon_s };
                if last.limited || current.abs() > self.limits_from_a {
                    // A limit brings the voltage nearer to the back-EMF, never beyond it.
                    let emf_v = self.plate.map(|plate| plate.back_emf * speed);
                    let emf = emf_v.map(|emf_v| Range::new(emf_v, emf_v).times(ANY));
                    region = emf.map_or(Range::EVERY, |emf| region.hull(emf.wider(self.drop_v())));
                }
                (last.voltage_v, self.scale.volts, confirm_s, "V")
            }
            Demand::Current(_) => {
                let amps = self.scale.amps;
                region = region.wider(FOLLOWS_CURRENT * amps);
                let emf_v = self.plate.map_or(0.0, |plate| plate.back_emf * speed);
                let has_room = last.voltage_v.unwrap_or(2.0 * emf_v).abs() < 0.9 * self.scale.volts;
                if !self.is_signed {
                    region = region.hull(negative(region));
                }
                let measured = Some(current).filter(|_| has_room && !last.limited);
                (measured, amps, FOLLOWS_CURRENT_S.max(latency_s), "A")
            }
            _ => {
                region = region.wider(FOLLOWS_SPEED * self.scale.rad_s);
                let confirm_s = FOLLOWS_SPEED_S.max(latency_s);
                let measured = Some(speed).filter(|_| !last.limited);
                (measured, self.scale.rad_s, confirm_s, "rad/s")
            }
        };
        if let (Demand::Voltage(_), Some(value)) = (demand, measured)
            && let Some(for_s) = self.stays(asked, value).filter(|for_s| *for_s >= confirm_s)
        {
            return Some(self.not_followed(
                now_s,
                &Astray {
                    demand,
                    asked,
                    region: asked.wider(self.drop_v()),
                    value,
                    unit,
                    idle,
                    for_s,
                },
            ));
        }
        let distance = measured.map_or(0.0, |value| region.gap(Range::new(value, value)));
        let Some(value) = measured.filter(|_| distance > 0.0) else {
            self.astray = None;
            return None;
        };
        let (since_s, farthest) = *self.astray.get_or_insert((last.time_s, distance));
        if distance < farthest - 0.01 * full {
            // It is on its way.
            self.astray = Some((last.time_s, distance));
            return None;
        }
        if last.time_s - since_s < confirm_s {
            return None;
        }
        if let Some(trip) = self.swapped(now_s) {
            return Some(trip);
        }
        let for_s = last.time_s - since_s;
        Some(self.not_followed(
            now_s,
            &Astray {
                demand,
                asked,
                region,
                value,
                unit,
                idle,
                for_s,
            },
        ))
    }

    /// For how long the measured voltage has stayed where it was although the set-point has moved, s. A reading whose scale
    /// is wrong moves with it, so this needs none of the room that such a reading is given; a guard that holds the
    /// set-point around the back-EMF leaves no more than this to see.
    fn stays(&mut self, asked: Range, value: f64) -> Option<f64> {
        let last = *self.history.last()?;
        let read = Range::new(value, value);
        if asked.wider(self.drop_v()).gap(read) <= 0.0 {
            // Of the set-points that it may answer to, the nearest.
            self.agreed = Some((value.clamp(asked.low, asked.high), value));
            let is_steady = asked.high - asked.low < self.drop_v();
            let tells = KNOWN_SCALE.high.mul_add(value.abs(), -value.abs()) > self.drop_v();
            self.scale_seen |= is_steady && tells;
        }
        let is_limited = last.limited
            || last
                .current_a
                .is_some_and(|current| current.abs() > self.limits_from_a);
        let stays = self.agreed.is_some_and(|(asked_v, value_v)| {
            let moved = asked.gap(Range::new(asked_v, asked_v));
            moved > STAYS_V * self.scale.volts && (value - value_v).abs() < STAYS_SHARE * moved
        });
        if is_limited || !stays {
            self.stays_since_s = None;
            return None;
        }
        let since_s = *self.stays_since_s.get_or_insert(last.time_s);
        Some(last.time_s - since_s)
    }

    fn not_followed(&self, now_s: f64, astray: &Astray) -> Trip {
        let &Astray {
            demand,
            asked,
            region,
            value,
            unit,
            idle,
            for_s,
        } = astray;
        let wanted = asked.middle();
        let figures = format!(
            "asked {wanted:.2} {unit}, measured {value:.2} {unit} for {:.2} s, {:.2} to {:.2} {unit} would be believed",
            for_s, region.low, region.high
        );
        if let (Demand::Voltage(_), Some(plate)) = (demand, &self.plate)
            && let Some(row) = self.history.rows().back().filter(|_| !idle)
        {
            let answer = plate.current_v(row) + plate.back_emf * row.speed_rad_s;
            let nearer = |volts: f64| (answer - volts).abs();
            if 2.0 * nearer(wanted) < nearer(value)
                && nearer(wanted) < self.drop_v() + 0.3 * wanted.abs()
            {
                let what = format!(
                    "{figures}; current and speed are those of {answer:.1} V, so it is the measured voltage that is wrong; check its address, scale and sign in the drive's profile"
                );
                return Trip::implausible(
                    TripKind::VoltageImplausible,
                    now_s,
                    (value, wanted),
                    &what,
                );
            }
        }
        let what = format!("{figures}; {CHECK_SET_POINT}");
        Trip::implausible(TripKind::SetPointIgnored, now_s, (value, wanted), &what)
    }
}
