//! Braking on a supply that takes nothing back: what comes out of the motor's terminals has to be burnt.
//!
//! With the back-EMF `e` the terminals carry `p = u i`, and braking returns `-p`; the winding has burnt its `R i^2` by
//! then. Without the inductance `i = (u - e)/R`, so `p >= -P` holds for `u^2 - e u + R P >= 0`. Between the two roots lies
//! what is not allowed; the shaper stays on the side of the gentle one, and with it the current `i = (u - e)/R`.

use crate::bench::limits::Nameplate;

/// Share of the rated power that any converter consumes by itself: without it noise at rest would look like braking.
const OWN_CONSUMPTION: f64 = 1e-3;

/// The bound of one motor and its supply.
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

    fn braking(power_w: f64) -> Braking {
        Braking::new(power_w, &Nameplate::zk_22fc())
    }

    #[test]
    fn without_a_resistor_the_voltage_never_falls_below_the_back_emf() {
        let braking = braking(0.0);
        for speed in [200.0, -200.0_f64] {
            let emf = 0.3538 * speed;
            for wanted in [0.0, 0.5 * emf, -emf] {
                // But for the 0.6 W that the converter consumes.
                assert!((braking.voltage(speed, wanted) - emf).abs() < 0.01);
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
