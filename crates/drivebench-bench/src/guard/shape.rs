//! Command shaping: slew, voltage, winding and supply limits, and the ramp down to zero.
//!
//! While stopping the output only approaches the wanted one. The bounds of the winding and of the supply may slow it while the
//! measured speed is fresh, plausible and falling, and a silent link holds it; both until the planned time of the ramp is over:
//! neither a broken encoder nor a lost reply keeps the motor on.

use std::collections::VecDeque;

use serde::Serialize;

use super::{Limits, Nameplate};
use crate::push_within;
use drivebench_model::sample::Demand;

/// Longest time over which a slew limit is counted, s: after a longer pause the output does not jump further.
const LONGEST_SLEW_TIME_S: f64 = 0.05;
/// Periods for which a measured speed is valid. Without lost replies it is one period old at most.
pub(super) const FRESH_PERIODS: f64 = 1.5;

/// Why a demand was changed; more than one may hold.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[expect(clippy::struct_excessive_bools, reason = "independent flags, reported one by one")]
pub struct Causes {
    /// Beyond the voltage, current or speed limit.
    pub limit: bool,
    /// The voltage across the winding would drive a current beyond the limit.
    pub winding: bool,
    pub slew: bool,
    /// Braking would return more power than the supply takes.
    pub supply: bool,
    /// The converter drives or conducts one way only.
    pub quadrant: bool,
    /// Not a finite number: zero was sent.
    pub not_finite: bool,
}

impl Causes {
    pub const fn any(self) -> bool {
        self.limit || self.winding || self.slew || self.supply || self.quadrant || self.not_finite
    }
}

/// A demand to be sent, and why it differs from the requested one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shaped {
    pub demand: Demand,
    pub causes: Causes,
}

impl Shaped {
    pub(super) fn unchanged(demand: Demand) -> Self {
        Self { demand, causes: Causes::default() }
    }
}

#[derive(Clone, Debug, Default)]
pub(super) struct Shaper {
    slew_v_per_s: f64,
    back_emf_v_s_per_rad: f64,
    /// Largest voltage across the winding, current limit times R; `None`: the drive limits the current itself.
    winding_v: Option<f64>,
    /// Last measured speed: a missing one must not make the back-EMF vanish at full speed.
    speed_rad_s: f64,
    /// Speed below which the shaft counts as at rest, and its back-EMF as the sensor's noise.
    pub(super) rest_rad_s: f64,
    /// Host time of that speed, s; `None`: the drive gives none.
    speed_at_s: Option<f64>,
    /// The last six measured speeds, the newest at the end.
    speeds: VecDeque<f64>,
    /// Time for which it is valid, s.
    pub(super) fresh_s: f64,
    /// Host time of the last valid reply, with a speed or without.
    replied_s: f64,
    /// Host time at which a ramp down has reached the wanted output, whatever is measured; `None`: not stopping.
    stop_by_s: Option<f64>,
    /// Voltage of the load's torque, V.
    pub(super) load_v: f64,
    /// Lowest and highest back-EMF that the voltages since the last valid speed may have led to, V.
    stale_back_emf_v: Option<(f64, f64)>,
    /// `None`: the supply takes back what braking returns.
    pub(super) braking: Option<Braking>,
    output_v: f64,
    demand_rad_s: f64,
    last_s: f64,
    was_off: bool,
}

impl Shaper {
    pub(super) fn new(limits: &Limits, back_emf_v_s_per_rad: f64, winding_v: Option<f64>) -> Self {
        Self {
            slew_v_per_s: limits.slew_v_per_s,
            back_emf_v_s_per_rad,
            winding_v,
            rest_rad_s: 0.01 * limits.speed_rad_s,
            fresh_s: f64::INFINITY,
            was_off: true,
            ..Self::default()
        }
    }

    /// Time in which the slew limit takes a voltage back, s.
    pub(super) fn ramp_s(&self, volts: f64) -> f64 {
        // Of a longer period only a part counts in each cycle.
        let period_s = if self.fresh_s.is_finite() { self.fresh_s / FRESH_PERIODS } else { 0.0 };
        volts / self.slew_v_per_s * (period_s / LONGEST_SLEW_TIME_S).max(1.0)
    }

    /// From here on the output only approaches the wanted one, and has reached it at this time.
    pub(super) const fn stop_by(&mut self, at_s: f64) {
        self.stop_by_s = Some(at_s);
    }

    /// Longest time from a speed to rest where the supply takes nothing back, s.
    pub(super) fn coast_s(&self, speed_rad_s: f64) -> f64 {
        self.braking.map_or(0.0, |braking| braking.coast_s(speed_rad_s))
    }

    pub(super) const fn is_off(&self) -> bool {
        self.was_off
    }

    pub(super) fn rest(&mut self, now_s: f64) {
        self.output_v = 0.0;
        self.demand_rad_s = 0.0;
        self.last_s = now_s;
        self.was_off = true;
        self.stop_by_s = None;
    }

    pub(super) const fn set_slew(&mut self, v_per_s: f64) {
        self.slew_v_per_s = v_per_s;
    }

    pub(super) const fn reply(&mut self, now_s: f64) {
        self.replied_s = now_s;
    }

    pub(super) fn measured(&mut self, now_s: f64, speed_rad_s: f64) {
        self.speed_rad_s = speed_rad_s;
        self.speed_at_s = Some(now_s);
        self.stale_back_emf_v = None;
        push_within(&mut self.speeds, speed_rad_s, 6);
    }

    /// Whether the measured speed may slow a ramp down: it is fresh (whatever the period 0.3 s at most), plausible, and falls
    /// over the last readings.
    fn may_slow(&self, now_s: f64, is_plausible: bool) -> bool {
        let is_fresh = self.speed_at_s.is_some_and(|at_s| now_s - at_s <= self.fresh_s.min(0.3));
        let falls = |(old, new): (&f64, &f64)| new.abs() < old.abs() && new * old > 0.0;
        is_plausible && is_fresh && self.speeds.front().zip(self.speeds.back()).is_some_and(falls)
    }

    /// The next output while stopping: between the present and the wanted one, which it reaches by the planned time.
    fn approach(&self, now_s: f64, next: f64, before: f64, wanted: f64, fall_per_s: f64) -> f64 {
        let Some(by_s) = self.stop_by_s else {
            return next;
        };
        let most = fall_per_s * (by_s - now_s).max(0.0);
        next.clamp(wanted - most, wanted + most).clamp(before.min(wanted), before.max(wanted))
    }

    /// Lowest and highest back-EMF that is possible. Without a fresh speed it has moved towards the voltages since, by up to
    /// the voltage of the load's torque beyond.
    fn back_emf_range_v(&mut self, now_s: f64, back_emf_v: f64) -> (f64, f64) {
        if self.speed_at_s.map_or(0.0, |at_s| now_s - at_s) > self.fresh_s {
            let (low, high) = self.stale_back_emf_v.unwrap_or((back_emf_v, back_emf_v));
            self.stale_back_emf_v =
                Some((low.min(self.output_v - self.load_v), high.max(self.output_v + self.load_v)));
        }
        self.stale_back_emf_v.unwrap_or((back_emf_v, back_emf_v))
    }

    /// `is_plausible`: the measured speed.
    pub(super) fn shape(
        &mut self,
        now_s: f64,
        wanted: Demand,
        limits: &Limits,
        is_plausible: bool,
    ) -> Shaped {
        // With one quadrant nothing is negative, with two no current is.
        let bounded = |value: f64, limit: f64, quadrants: u8| {
            let mut causes = Causes::default();
            let finite = if value.is_finite() { value } else { 0.0 };
            causes.not_finite = !value.is_finite();
            causes.limit = finite.abs() > limit;
            causes.quadrant = finite < 0.0 && limits.quadrants < quadrants;
            let least = if causes.quadrant { 0.0 } else { -limit };
            (finite.clamp(least, limit), causes)
        };
        let (demand, causes) = match wanted {
            Demand::Voltage(volts) => {
                let (volts, mut causes) = bounded(volts, limits.voltage_v, 2);
                let bound = self.stop_by_s.is_none() || self.may_slow(now_s, is_plausible);
                let volts = self.voltage(now_s, volts, limits.voltage_v, bound, &mut causes);
                (Demand::Voltage(volts), causes)
            }
            Demand::Current(amps) => {
                let (wanted_a, mut causes) = bounded(amps, limits.current_a, 4);
                let amps = self
                    .braking
                    .map_or(wanted_a, |braking| braking.current(self.speed_rad_s, wanted_a));
                causes.supply = (amps - wanted_a).abs() > 1e-9 * limits.current_a;
                self.was_off = false;
                (Demand::Current(amps), causes)
            }
            Demand::Speed(speed) => {
                let (speed, mut causes) = bounded(speed, limits.speed_rad_s, 2);
                let speed = self.speed(now_s, speed, limits.speed_rad_s, &mut causes);
                (Demand::Speed(speed), causes)
            }
            off => {
                self.rest(now_s);
                return Shaped::unchanged(off);
            }
        };
        Shaped { demand, causes }
    }

    /// `bound`: by winding and supply.
    fn voltage(
        &mut self,
        now_s: f64,
        wanted_v: f64,
        limit_v: f64,
        bound: bool,
        causes: &mut Causes,
    ) -> f64 {
        let back_emf_v = (self.back_emf_v_s_per_rad * self.speed_rad_s).clamp(-limit_v, limit_v);
        if self.was_off {
            // The terminals of a coasting motor are at its back-EMF, at which no current flows. At rest they are at zero, and
            // the sensor's noise must not become a first command. Nothing is switched on to stop.
            let coasts = self.speed_rad_s.abs() > self.rest_rad_s;
            self.output_v = if coasts && self.stop_by_s.is_none() { back_emf_v } else { 0.0 };
            self.was_off = false;
        }
        let mut target_v = wanted_v;
        let is_silent = now_s - self.replied_s > self.fresh_s;
        if self.stop_by_s.is_some() && self.winding_v.is_some() && is_silent {
            // The commands since may not have arrived: the rest of the ramp would reach the drive as one step.
            target_v = self.output_v;
            causes.winding = true;
        }
        if let Some(winding_v) = self.winding_v.filter(|_| bound) {
            let (low_v, high_v) = self.back_emf_range_v(now_s, back_emf_v);
            let (least_v, most_v) = (high_v - winding_v, low_v + winding_v);
            // Within the voltage limit, as the back-EMF and the target.
            let bounded_v = if least_v <= most_v {
                target_v.clamp(least_v, most_v)
            } else {
                0.5 * (low_v + high_v)
            };
            causes.winding = (bounded_v - target_v).abs() > 0.0;
            target_v = bounded_v;
        }
        if let Some(braking) = self.braking.filter(|_| bound) {
            let bounded_v = braking.voltage(self.speed_rad_s, target_v).clamp(-limit_v, limit_v);
            causes.supply = (bounded_v - target_v).abs() > 1e-9 * limit_v;
            target_v = bounded_v;
        }
        let step_v = self.slew_v_per_s * (now_s - self.last_s).clamp(0.0, LONGEST_SLEW_TIME_S);
        let next_v = target_v.clamp(self.output_v - step_v, self.output_v + step_v);
        let next_v = self.approach(now_s, next_v, self.output_v, wanted_v, self.slew_v_per_s);
        // Rounding of a designed ramp at exactly the limit is not a limitation.
        causes.slew = (next_v - target_v).abs() > 1e-9 * limit_v;
        self.output_v = next_v;
        self.last_s = now_s;
        next_v
    }

    /// A reference of speed falls no faster than friction and the allowed current brake.
    fn speed(&mut self, now_s: f64, wanted: f64, limit: f64, causes: &mut Causes) -> f64 {
        let step_s = (now_s - self.last_s).clamp(0.0, LONGEST_SLEW_TIME_S);
        let mut next = wanted;
        let before = self.demand_rad_s;
        if let Some(fall) = self.braking.and_then(|braking| braking.deceleration(before)) {
            // Towards the wanted speed, and not through zero in one step.
            let least = (before.abs() - fall * step_s).max(0.0);
            if next * before.signum() < least {
                next = least.copysign(before);
            }
            next = self.approach(now_s, next, before, wanted, fall);
        }
        causes.supply = (next - wanted).abs() > 1e-9 * limit;
        self.demand_rad_s = next;
        self.last_s = now_s;
        self.was_off = false;
        next
    }
}

/// Braking on a supply that takes no power back: the power of the motor's terminals has to be dissipated.
///
/// With the back-EMF `e` the terminals have `p = u i`, and braking returns `-p`, after the loss `R i^2` of the winding.
/// Without the inductance `i = (u - e)/R`, so `p >= -P` holds for `u^2 - e u + R P >= 0`. The voltages between the two roots
/// are not allowed; the shaper stays above the upper one.
#[derive(Clone, Copy, Debug)]
pub(super) struct Braking {
    /// Power that may be dissipated outside of the motor, W.
    power_w: f64,
    resistance_ohm: f64,
    back_emf_v_s_per_rad: f64,
    inertia_kg_m2: f64,
    load_torque_n_m: f64,
}

impl Braking {
    pub(super) fn new(power_w: f64, motor: &Nameplate) -> Self {
        Self {
            // Any converter consumes some power itself: without it noise at rest would count as braking.
            power_w: power_w.max(1e-3 * motor.rated_voltage_v * motor.rated_current_a),
            resistance_ohm: motor.resistance_ohm,
            back_emf_v_s_per_rad: motor.back_emf_v_s_per_rad,
            inertia_kg_m2: motor.inertia_kg_m2,
            load_torque_n_m: motor.load_torque_n_m,
        }
    }

    /// Least voltage in the direction of motion that is allowed at this speed, V, for a positive back-EMF; `None`: any.
    fn least_v(&self, back_emf_v: f64) -> Option<f64> {
        let root = back_emf_v * back_emf_v - 4.0 * self.resistance_ohm * self.power_w;
        (root > 0.0).then(|| 0.5 * (back_emf_v + root.sqrt()))
    }

    /// The voltage that is allowed instead of `wanted_v`.
    pub(super) fn voltage(&self, speed_rad_s: f64, wanted_v: f64) -> f64 {
        let back_emf_v = self.back_emf_v_s_per_rad * speed_rad_s;
        match self.least_v(back_emf_v.abs()) {
            Some(least_v) if wanted_v * back_emf_v.signum() < least_v => {
                least_v.copysign(back_emf_v)
            }
            _ => wanted_v,
        }
    }

    /// The current that is allowed instead of `wanted_a`.
    pub(super) fn current(&self, speed_rad_s: f64, wanted_a: f64) -> f64 {
        let back_emf_v = self.back_emf_v_s_per_rad * speed_rad_s;
        let Some(least_v) = self.least_v(back_emf_v.abs()) else {
            return wanted_a;
        };
        let least_a = (least_v - back_emf_v.abs()) / self.resistance_ohm;
        if wanted_a * back_emf_v.signum() < least_a {
            least_a * back_emf_v.signum()
        } else {
            wanted_a
        }
    }

    /// Fastest fall of the speed that friction and the allowed current bring about, rad/s2; `None`: any.
    pub(super) fn deceleration(&self, speed_rad_s: f64) -> Option<f64> {
        let back_emf_v = (self.back_emf_v_s_per_rad * speed_rad_s).abs();
        let least_v = self.least_v(back_emf_v)?;
        let braking_a = (back_emf_v - least_v) / self.resistance_ohm;
        let torque = self.load_torque_n_m + self.back_emf_v_s_per_rad * braking_a;
        Some(torque / self.inertia_kg_m2)
    }

    /// Longest time from a speed to rest by friction alone, s.
    pub(super) fn coast_s(&self, speed_rad_s: f64) -> f64 {
        self.inertia_kg_m2 * speed_rad_s / self.load_torque_n_m
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::near;

    fn braking(power_w: f64) -> Braking {
        Braking::new(power_w, &Nameplate::zk_22fc())
    }

    #[test]
    fn without_a_resistor_voltage_stays_above_the_back_emf() {
        let braking = braking(0.0);
        for speed in [200.0, -200.0_f64] {
            let emf = 0.3538 * speed;
            for wanted in [0.0, 0.5 * emf, -emf] {
                // But for the 0.6 W that the converter consumes.
                near(braking.voltage(speed, wanted), emf, 0.01);
            }
            near(braking.voltage(speed, 1.2 * emf), 1.2 * emf, 1e-9);
            near(braking.current(speed, -speed.signum()), 0.0, 0.01);
            near(braking.current(speed, speed.signum()), speed.signum(), 1e-12);
        }
    }

    #[test]
    fn braking_returns_the_power_of_the_resistor() {
        let braking = braking(60.0);
        let (speed, emf) = (200.0, 0.3538 * 200.0);
        let volts = braking.voltage(speed, 0.0);
        let amps = (volts - emf) / 1.1;
        near(volts * amps, -60.0, 1e-6);
        near(braking.current(speed, -10.0), amps, 1e-9);
        // At low speed the winding dissipates all of it: e^2 < 4 R P.
        near(braking.voltage(20.0, 0.0), 0.0, 1e-12);
        assert_eq!(braking.deceleration(20.0), None);
        let fall = (0.455 - 0.3538 * amps) / 0.0045;
        near(braking.deceleration(speed).unwrap(), fall, 1e-6);
    }
}
