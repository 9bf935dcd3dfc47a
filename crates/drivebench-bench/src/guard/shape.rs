//! Command shaping: slew, voltage, winding and supply limits, and the way down to zero.
//!
//! While stopping the output goes towards what is wanted and never away from it. The bound of the winding and the one of
//! the supply may slow it, as long as they rest on a speed that is fresh, believed and falling, and a silent link holds it;
//! both until the planned time of the ramp is over: neither a broken encoder nor a lost reply keeps the motor on.

use std::collections::VecDeque;

use serde::Serialize;

use super::{Limits, Nameplate, REST_SPEED_SHARE};
use drivebench_model::sample::Demand;

/// Longest time over which a slew limit is counted, s: after a longer pause the output does not jump further.
const LONGEST_SLEW_TIME_S: f64 = 0.05;
/// Periods for which a measured speed stands for the shaft. On a link that answers it is one period old at most.
const FRESH_PERIODS: f64 = 1.5;

/// While stopping, a speed that is older than this is not believed whatever the period, s.
const FRESH_STOP_S: f64 = 0.3;
/// Readings over which a speed has to have fallen to be believed while stopping.
const FALLING: usize = 6;

/// Why a demand was changed; more than one may hold.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[expect(clippy::struct_excessive_bools, reason = "independent flags, reported one by one")]
pub struct Causes {
    /// Beyond the voltage, current or speed limit.
    pub limit: bool,
    /// The voltage across the winding would drive a current beyond the limit.
    pub winding: bool,
    pub slew: bool,
    /// Braking would return more than the supply takes.
    pub supply: bool,
    /// The converter cannot: it drives or conducts one way only.
    pub quadrant: bool,
    /// Not a finite number: zero was sent.
    pub not_finite: bool,
}

impl Causes {
    pub const fn any(self) -> bool {
        self.limit || self.winding || self.slew || self.supply || self.quadrant || self.not_finite
    }
}

/// A demand that may leave, and why it is not the one that was wanted.
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

/// The memory that shaping needs.
#[derive(Clone, Debug, Default)]
pub(super) struct Shaper {
    slew_v_per_s: f64,
    back_emf_v_s_per_rad: f64,
    /// Largest voltage across the winding, current limit times R; `None`: the drive limits the current itself.
    winding_v: Option<f64>,
    /// Last speed that was measured: a missing one must not make the back-EMF vanish at full speed.
    speed_rad_s: f64,
    /// Speed below which the shaft counts as at rest, and its back-EMF as the sensor's noise.
    rest_rad_s: f64,
    /// When it came; `None`: the drive gives none.
    speed_at_s: Option<f64>,
    /// The last of them, the newest at the end.
    speeds: VecDeque<f64>,
    /// Time for which it stands for the shaft, s.
    fresh_s: f64,
    /// Host time of the last valid reply, with a speed or without.
    heard_s: f64,
    /// Host time at which a ramp down has reached what is wanted, whatever is measured; `None`: not stopping.
    stop_by_s: Option<f64>,
    /// What the load's torque takes of the voltage in rest and motion alike, V.
    pub(super) load_v: f64,
    /// Lowest and highest back-EMF that the voltages sent while the speed was older lead to, V.
    unseen_v: Option<(f64, f64)>,
    /// `None`: the supply takes back what braking returns.
    pub(super) braking: Option<Braking>,
    output_v: f64,
    /// Last speed that was asked for, rad/s.
    asked_rad_s: f64,
    last_s: f64,
    was_off: bool,
}

impl Shaper {
    pub(super) fn new(limits: &Limits, back_emf_v_s_per_rad: f64, winding_v: Option<f64>) -> Self {
        Self {
            slew_v_per_s: limits.slew_v_per_s,
            back_emf_v_s_per_rad,
            winding_v,
            rest_rad_s: REST_SPEED_SHARE * limits.speed_rad_s,
            fresh_s: f64::INFINITY,
            was_off: true,
            ..Self::default()
        }
    }

    pub(super) fn set_period(&mut self, period_s: f64) {
        self.fresh_s = FRESH_PERIODS * period_s;
    }

    /// Time in which the slew limit takes a voltage back, s.
    pub(super) fn ramp_s(&self, volts: f64) -> f64 {
        // Of a longer period only a part is counted in each cycle.
        let period_s = if self.fresh_s.is_finite() { self.fresh_s / FRESH_PERIODS } else { 0.0 };
        volts / self.slew_v_per_s * (period_s / LONGEST_SLEW_TIME_S).max(1.0)
    }

    /// From here on the output only goes towards what is wanted, and is there at this time.
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
        self.asked_rad_s = 0.0;
        self.last_s = now_s;
        self.was_off = true;
        self.stop_by_s = None;
    }

    pub(super) const fn set_slew(&mut self, v_per_s: f64) {
        self.slew_v_per_s = v_per_s;
    }

    pub(super) const fn hear(&mut self, now_s: f64) {
        self.heard_s = now_s;
    }

    pub(super) fn see_speed(&mut self, now_s: f64, speed_rad_s: f64) {
        self.speed_rad_s = speed_rad_s;
        self.speed_at_s = Some(now_s);
        self.unseen_v = None;
        if self.speeds.len() == FALLING {
            self.speeds.pop_front();
        }
        self.speeds.push_back(speed_rad_s);
    }

    /// Whether the measured speed may slow a ramp down: it is fresh, nothing speaks against it, and it falls.
    fn may_slow(&self, now_s: f64, is_believed: bool) -> bool {
        let fresh_s = self.fresh_s.min(FRESH_STOP_S);
        let is_fresh = self.speed_at_s.is_some_and(|at_s| now_s - at_s <= fresh_s);
        let falls = |(old, new): (&f64, &f64)| new.abs() < old.abs() && new * old > 0.0;
        let ends = self.speeds.front().zip(self.speeds.back());
        is_believed && is_fresh && ends.is_some_and(falls)
    }

    /// The next output while stopping: between the one before and the wanted one, and there in time.
    fn towards(&self, now_s: f64, next: f64, before: f64, wanted: f64, fall_per_s: f64) -> f64 {
        let Some(by_s) = self.stop_by_s else {
            return next;
        };
        let left = fall_per_s * (by_s - now_s).max(0.0);
        next.clamp(wanted - left, wanted + left).clamp(before.min(wanted), before.max(wanted))
    }

    /// Where the back-EMF may be, lowest and highest. Unseen for some periods it has moved from where it was towards
    /// what the drive was sent since, up to what the load takes of it.
    fn back_emf_range_v(&mut self, now_s: f64, back_emf_v: f64) -> (f64, f64) {
        let age_s = self.speed_at_s.map_or(0.0, |at_s| now_s - at_s);
        if age_s > self.fresh_s {
            let (low, high) = self.unseen_v.unwrap_or((back_emf_v, back_emf_v));
            self.unseen_v =
                Some((low.min(self.output_v - self.load_v), high.max(self.output_v + self.load_v)));
        }
        self.unseen_v.unwrap_or((back_emf_v, back_emf_v))
    }

    /// `is_believed`: nothing speaks against the measured speed.
    pub(super) fn shape(
        &mut self,
        now_s: f64,
        wanted: Demand,
        limits: &Limits,
        is_believed: bool,
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
                let bound = self.stop_by_s.is_none() || self.may_slow(now_s, is_believed);
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

    /// `bound`: winding and supply have a say.
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
            // The terminals of a coasting motor stand at its back-EMF: from there no current flows. At rest they stand at
            // zero, and what the sensor's noise makes of it would be a first command that nobody gave. Nothing is switched
            // on to stop.
            let coasts = self.speed_rad_s.abs() > self.rest_rad_s;
            self.output_v = if coasts && self.stop_by_s.is_none() { back_emf_v } else { 0.0 };
            self.was_off = false;
        }
        let mut target_v = wanted_v;
        let is_unheard = now_s - self.heard_s > self.fresh_s;
        if self.stop_by_s.is_some() && self.winding_v.is_some() && is_unheard {
            // What was sent since may not have arrived: the drive would see the whole way down as one step.
            target_v = self.output_v;
            causes.winding = true;
        }
        if let Some(winding_v) = self.winding_v.filter(|_| bound) {
            let (low_v, high_v) = self.back_emf_range_v(now_s, back_emf_v);
            let (least_v, most_v) = (high_v - winding_v, low_v + winding_v);
            // Still within the voltage limit: the back-EMF is, and so was the target.
            let inside = if least_v <= most_v {
                target_v.clamp(least_v, most_v)
            } else {
                0.5 * (low_v + high_v)
            };
            causes.winding = (inside - target_v).abs() > 0.0;
            target_v = inside;
        }
        if let Some(braking) = self.braking.filter(|_| bound) {
            let inside = braking.voltage(self.speed_rad_s, target_v).clamp(-limit_v, limit_v);
            causes.supply = (inside - target_v).abs() > 1e-9 * limit_v;
            target_v = inside;
        }
        let step_v = self.slew_v_per_s * (now_s - self.last_s).clamp(0.0, LONGEST_SLEW_TIME_S);
        let next_v = target_v.clamp(self.output_v - step_v, self.output_v + step_v);
        let next_v = self.towards(now_s, next_v, self.output_v, wanted_v, self.slew_v_per_s);
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
        let asked = self.asked_rad_s;
        if let Some(fall) = self.braking.and_then(|braking| braking.deceleration(asked)) {
            // Towards the speed that is asked, and not through zero in one step.
            let least = (self.asked_rad_s.abs() - fall * step_s).max(0.0);
            if next * self.asked_rad_s.signum() < least {
                next = least.copysign(self.asked_rad_s);
            }
            next = self.towards(now_s, next, self.asked_rad_s, wanted, fall);
        }
        causes.supply = (next - wanted).abs() > 1e-9 * limit;
        self.asked_rad_s = next;
        self.last_s = now_s;
        self.was_off = false;
        next
    }
}

/// Share of the rated power that any converter consumes by itself: without it noise at rest would look like braking.
const OWN_CONSUMPTION: f64 = 1e-3;

/// Braking on a supply that takes nothing back: what comes out of the motor's terminals has to be burnt.
///
/// With the back-EMF `e` the terminals carry `p = u i`, and braking returns `-p`; the winding has burnt its `R i^2` by
/// then. Without the inductance `i = (u - e)/R`, so `p >= -P` holds for `u^2 - e u + R P >= 0`. Between the two roots lies
/// what is not allowed; the shaper stays on the side of the gentle one, and with it the current `i = (u - e)/R`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Braking {
    /// What may be burnt outside of the motor, W.
    power_w: f64,
    resistance_ohm: f64,
    back_emf_v_s_per_rad: f64,
    inertia_kg_m2: f64,
    load_torque_n_m: f64,
}

impl Braking {
    pub(super) fn new(power_w: f64, motor: &Nameplate) -> Self {
        Self {
            power_w: power_w.max(OWN_CONSUMPTION * motor.rated_voltage_v * motor.rated_current_a),
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
            assert!((braking.voltage(speed, 1.2 * emf) - 1.2 * emf).abs() < 1e-9);
            assert!(braking.current(speed, -speed.signum()).abs() < 0.01);
            assert!((braking.current(speed, speed.signum()) - speed.signum()).abs() < 1e-12);
        }
    }

    #[test]
    fn what_comes_back_is_what_the_resistor_burns() {
        let braking = braking(60.0);
        let (speed, emf) = (200.0, 0.3538 * 200.0);
        let volts = braking.voltage(speed, 0.0);
        let amps = (volts - emf) / 1.1;
        assert!((volts * amps + 60.0).abs() < 1e-6, "{volts} V {amps} A");
        assert!((braking.current(speed, -10.0) - amps).abs() < 1e-9);
        // Slow enough that the winding burns all of it: e^2 < 4 R P.
        assert!((braking.voltage(20.0, 0.0)).abs() < 1e-12);
        assert_eq!(braking.deceleration(20.0), None);
        let fall = braking.deceleration(speed).unwrap();
        let expected = (0.455 - 0.3538 * amps) / 0.0045;
        assert!((fall - expected).abs() < 1e-6, "{fall}");
    }
}
