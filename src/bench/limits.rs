//! What the bench never lets a motor go beyond, and the nameplate from which the defaults come.

use serde::{Deserialize, Serialize};

use crate::plant::{Motor, MotorKey};

/// Largest current that an excitation may draw when the bench file does not say, in rated currents: a direct-current
/// motor commutates four times its rated current for seconds without harm (DISCOVERY.md 2.0).
const CURRENT_LIMIT_IN_RATED: f64 = 4.0;
/// Over-speed limit without a given one: rated speed and a quarter, below the usual mechanical test speed.
const SPEED_LIMIT_IN_RATED: f64 = 1.25;

/// `[motor]` of a bench file: the nameplate, on the motor's own shaft; a direct-current machine, so no phase or line
/// basis and no peak or effective value has to be told apart.
#[derive(Clone, Debug, Deserialize, Serialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct Nameplate {
    pub name: String,
    pub rated_voltage_v: f64,
    pub rated_current_a: f64,
    pub rated_speed_rad_s: f64,
    pub resistance_ohm: f64,
    pub inductance_h: f64,
    pub back_emf_v_s_per_rad: f64,
    pub inertia_kg_m2: f64,
    /// Coulomb torque, always against the motion, N.m.
    pub load_torque_n_m: f64,
}

impl Nameplate {
    /// Every number with its key, for validation and messages.
    pub fn values(&self) -> [(&'static str, f64); 8] {
        [
            ("rated_voltage_v", self.rated_voltage_v),
            ("rated_current_a", self.rated_current_a),
            ("rated_speed_rad_s", self.rated_speed_rad_s),
            ("resistance_ohm", self.resistance_ohm),
            ("inductance_h", self.inductance_h),
            ("back_emf_v_s_per_rad", self.back_emf_v_s_per_rad),
            ("inertia_kg_m2", self.inertia_kg_m2),
            ("load_torque_n_m", self.load_torque_n_m),
        ]
    }

    /// The baseline motor with the values of the nameplate.
    pub fn motor(&self) -> Motor {
        Motor::new(self.name.clone())
            .with(MotorKey::Resistance, self.resistance_ohm)
            .with(MotorKey::Inductance, self.inductance_h)
            .with(MotorKey::BackEmf, self.back_emf_v_s_per_rad)
            .with(MotorKey::Inertia, self.inertia_kg_m2)
            .with(MotorKey::LoadTorque, self.load_torque_n_m)
    }
}

/// Limits in force during a run, every one with a value.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Limits {
    /// Armature current, either sign, A.
    pub current_a: f64,
    /// Shaft speed, either sign, rad/s.
    pub speed_rad_s: f64,
    /// Armature voltage, either sign, V.
    pub voltage_v: f64,
    /// Fastest change of the commanded voltage, V/s.
    pub slew_v_per_s: f64,
    /// Largest distance from the angle at arming, rad; `None`: the shaft may turn freely.
    pub travel_rad: Option<f64>,
    pub bus_min_v: Option<f64>,
    pub bus_max_v: Option<f64>,
    /// Longest time that the drive's output may be on in one run, s.
    pub time_s: f64,
    /// Longest time without a valid reply before the run ends at zero output, s.
    pub link_silence_s: f64,
}

impl Limits {
    /// The defaults for a motor: what applies where a bench file leaves a limit out.
    pub fn for_motor(motor: &Nameplate, rate_hz: f64) -> Self {
        Self {
            current_a: CURRENT_LIMIT_IN_RATED * motor.rated_current_a,
            speed_rad_s: SPEED_LIMIT_IN_RATED * motor.rated_speed_rad_s,
            voltage_v: motor.rated_voltage_v,
            slew_v_per_s: default_slew_v_per_s(motor),
            travel_rad: None,
            bus_min_v: None,
            bus_max_v: None,
            time_s: 60.0,
            // LINKS.md 5.2: three cycles, and not below 100 ms.
            link_silence_s: (3.0 / rate_hz).max(0.1),
        }
    }
}

/// The slew at which a ramp of voltage draws the rated current for acceleration twice over: while the voltage rises at
/// `s`, the back-EMF lags by `s` times the mechanical time constant, and that lag over R is the current.
fn default_slew_v_per_s(motor: &Nameplate) -> f64 {
    let mechanical_s = motor.resistance_ohm * motor.inertia_kg_m2
        / (motor.back_emf_v_s_per_rad * motor.back_emf_v_s_per_rad);
    2.0 * motor.rated_current_a * motor.resistance_ohm / mechanical_s
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_slew_of_the_paper_motor_is_the_recommended_one() {
        let motor = Nameplate::zk_22fc();
        let limits = Limits::for_motor(&motor, 100.0);
        // DISCOVERY.md 2.0: 300 to 500 V/s for 0.0045 kg.m2.
        assert!(
            (250.0..500.0).contains(&limits.slew_v_per_s),
            "{}",
            limits.slew_v_per_s
        );
        assert!((limits.link_silence_s - 0.1).abs() < 1e-12);
        assert!((Limits::for_motor(&motor, 10.0).link_silence_s - 0.3).abs() < 1e-12);
    }
}
