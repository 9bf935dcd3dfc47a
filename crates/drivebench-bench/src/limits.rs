//! Limits that the bench never lets a motor go beyond, and the nameplate from which the defaults come.

use serde::{Deserialize, Serialize};

use super::mechanics::LoadSection;
use drivebench_identify::belief::Plate;
use drivebench_model::plant::{Motor, MotorKey};
use drivebench_model::units::rad_s_from_rpm;

/// Default over-speed limit, in rated speeds: below the usual mechanical test speed.
pub(super) const OVER_SPEED_IN_RATED: f64 = 1.25;

/// A complete nameplate of a direct-current motor, on its own shaft.
#[derive(Clone, Debug, Serialize, PartialEq)]
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

pub(super) const POSITIVE: &str = "a positive number; load_torque_n_m may be 0";

/// `[motor]` of a bench file: the rated values, from which the limits follow, are required; the parameters of the motor may be
/// left out.
#[derive(Clone, Debug, Deserialize, Serialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct MotorSection {
    pub name: String,
    /// Only the rated values are used: the motor is found from small steps first.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub unknown: bool,
    pub rated_voltage_v: f64,
    pub rated_current_a: f64,
    pub rated_speed_rad_s: f64,
    pub resistance_ohm: Option<f64>,
    pub inductance_h: Option<f64>,
    pub back_emf_v_s_per_rad: Option<f64>,
    pub inertia_kg_m2: Option<f64>,
    pub load_torque_n_m: Option<f64>,
}

impl MotorSection {
    pub fn values(&self) -> Vec<(&'static str, f64)> {
        let mut values = vec![
            ("rated_voltage_v", self.rated_voltage_v),
            ("rated_current_a", self.rated_current_a),
            ("rated_speed_rad_s", self.rated_speed_rad_s),
        ];
        let others = MODEL_KEYS.map(|key| Some((key.key(), self.get(key)?)));
        values.extend(others.into_iter().flatten());
        values
    }

    pub fn get(&self, key: MotorKey) -> Option<f64> {
        match key {
            MotorKey::Resistance => self.resistance_ohm,
            MotorKey::Inductance => self.inductance_h,
            MotorKey::BackEmf => self.back_emf_v_s_per_rad,
            MotorKey::Inertia => self.inertia_kg_m2,
            MotorKey::LoadTorque => self.load_torque_n_m,
            MotorKey::TorqueConstant => None,
        }
    }

    /// The given parameters, complete or not.
    pub fn motor(&self) -> Motor {
        let mut motor = Motor::new(self.name.clone());
        for key in MODEL_KEYS {
            if let Some(value) = self.get(key) {
                motor.set(key, value);
            }
        }
        motor
    }

    /// Whether the motor has to be found before anything can be planned.
    pub fn is_unknown(&self) -> bool {
        self.unknown || self.nameplate().is_none()
    }

    /// The complete nameplate; `None` where a value is left out.
    pub fn nameplate(&self) -> Option<Nameplate> {
        self.with_found(&self.motor())
    }

    /// The first number that is not allowed, with its key.
    pub(super) fn refused(&self) -> Option<(&'static str, f64)> {
        self.values().into_iter().find(|(key, value)| {
            let zero_too = *key == "load_torque_n_m" && *value == 0.0;
            !(value.is_finite() && (*value > 0.0 || zero_too))
        })
    }

    /// Contradictions in the nameplate, most likely by another unit, in sentences. The values are used all the same.
    pub fn contradictions(&self) -> Vec<String> {
        let rated_v = self.rated_voltage_v;
        let mut contradictions = Vec::new();
        if let Some(back_emf) = self.back_emf_v_s_per_rad {
            let emf_v = back_emf * self.rated_speed_rad_s;
            // A correct one is below the rated voltage.
            if emf_v > 1.5 * rated_v {
                contradictions.push(format!(
                    "the nameplate contradicts itself: back_emf_v_s_per_rad x rated_speed_rad_s is {emf_v:.0} V at a rated voltage of {rated_v} V. Was the speed given in r/min? {} r/min would be {:.1} rad/s",
                    self.rated_speed_rad_s,
                    rad_s_from_rpm(self.rated_speed_rad_s)
                ));
            }
        }
        if let Some(resistance) = self.resistance_ohm {
            let drop_v = resistance * self.rated_current_a;
            if drop_v > rated_v {
                contradictions.push(format!(
                    "the nameplate contradicts itself: resistance_ohm x rated_current_a is {drop_v:.0} V at a rated voltage of {rated_v} V. Was the current given in mA, or the resistance in mohm?"
                ));
            }
        }
        contradictions
    }

    /// The nameplate without friction where only `load_torque_n_m` is left out: enough to predict a sequence.
    pub fn without_friction(&self) -> Option<Nameplate> {
        match self.load_torque_n_m {
            None => self.with_found(&self.motor().with(MotorKey::LoadTorque, 0.0)),
            Some(_) => None,
        }
    }

    pub fn missing(&self) -> Option<&'static str> {
        MODEL_KEYS.into_iter().find(|key| self.get(*key).is_none()).map(MotorKey::key)
    }

    /// The rated values with the parameters of `motor`, where it is complete.
    pub fn with_found(&self, motor: &Motor) -> Option<Nameplate> {
        let value = |key| motor.get(key);
        Some(Nameplate {
            name: self.name.clone(),
            rated_voltage_v: self.rated_voltage_v,
            rated_current_a: self.rated_current_a,
            rated_speed_rad_s: self.rated_speed_rad_s,
            resistance_ohm: value(MotorKey::Resistance)?,
            inductance_h: value(MotorKey::Inductance)?,
            back_emf_v_s_per_rad: value(MotorKey::BackEmf)?,
            inertia_kg_m2: value(MotorKey::Inertia)?,
            load_torque_n_m: value(MotorKey::LoadTorque)?,
        })
    }
}

impl From<&Nameplate> for MotorSection {
    fn from(nameplate: &Nameplate) -> Self {
        Self {
            name: nameplate.name.clone(),
            unknown: false,
            rated_voltage_v: nameplate.rated_voltage_v,
            rated_current_a: nameplate.rated_current_a,
            rated_speed_rad_s: nameplate.rated_speed_rad_s,
            resistance_ohm: Some(nameplate.resistance_ohm),
            inductance_h: Some(nameplate.inductance_h),
            back_emf_v_s_per_rad: Some(nameplate.back_emf_v_s_per_rad),
            inertia_kg_m2: Some(nameplate.inertia_kg_m2),
            load_torque_n_m: Some(nameplate.load_torque_n_m),
        }
    }
}

pub(super) const MODEL_KEYS: [MotorKey; 5] = [
    MotorKey::Resistance,
    MotorKey::Inductance,
    MotorKey::BackEmf,
    MotorKey::Inertia,
    MotorKey::LoadTorque,
];

impl Nameplate {
    /// The values that the balances need.
    pub fn plate(&self) -> Plate {
        Plate {
            resistance_ohm: self.resistance_ohm,
            inductance_h: self.inductance_h,
            back_emf_v_s_per_rad: self.back_emf_v_s_per_rad,
            inertia_kg_m2: self.inertia_kg_m2,
            friction_n_m: self.load_torque_n_m.abs(),
        }
    }

    /// The baseline motor with the values of the nameplate.
    pub fn motor(&self) -> Motor {
        MotorSection::from(self).motor()
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
    /// Largest braking power into the supply, W.
    pub braking_w: Option<f64>,
    /// Of the converter. 1: one direction and no braking; 2: one direction of current; 4: all.
    pub quadrants: u8,
    /// Longest time until the converter fires next, s.
    pub dead_time_s: f64,
    /// Least field current, A; `None`: not watched.
    pub field_min_a: Option<f64>,
    /// What pulls at the shaft when the motor does not.
    pub load: LoadSection,
}

impl Limits {
    /// The defaults for a motor: what applies where a bench file leaves a limit out.
    pub fn for_motor(motor: &Nameplate, rate_hz: f64) -> Self {
        Self {
            slew_v_per_s: default_slew_v_per_s(motor),
            ..Self::for_rated(&motor.into(), rate_hz)
        }
    }

    /// The defaults where only the rated values are known: the slew is a placeholder until the motor is found.
    pub fn for_rated(motor: &MotorSection, rate_hz: f64) -> Self {
        Self {
            // A direct-current motor commutates four times its rated current for seconds without harm.
            current_a: 4.0 * motor.rated_current_a,
            speed_rad_s: OVER_SPEED_IN_RATED * motor.rated_speed_rad_s,
            voltage_v: motor.rated_voltage_v,
            // Rated voltage within 1 s.
            slew_v_per_s: motor.rated_voltage_v,
            travel_rad: None,
            bus_min_v: None,
            bus_max_v: None,
            time_s: 60.0,
            // Three cycles, and not below 100 ms.
            link_silence_s: (3.0 / rate_hz).max(0.1),
            braking_w: None,
            quadrants: 4,
            dead_time_s: 0.0,
            field_min_a: None,
            load: LoadSection::default(),
        }
    }
}

/// The slew at which a ramp of voltage draws twice the rated current for acceleration: while the voltage rises at `s`, the
/// back-EMF lags by `s` times the mechanical time constant, and that lag over R is the current.
fn default_slew_v_per_s(motor: &Nameplate) -> f64 {
    let mechanical_s = motor.resistance_ohm * motor.inertia_kg_m2
        / (motor.back_emf_v_s_per_rad * motor.back_emf_v_s_per_rad);
    2.0 * motor.rated_current_a * motor.resistance_ohm / mechanical_s
}

/// Rounded down to four digits: a limit must not grow.
pub(super) fn short(value: f64) -> f64 {
    if !(value.is_finite() && value > 0.0) {
        return value;
    }
    let step = 10_f64.powf(value.log10().floor() - 3.0);
    let whole = (value / step + 1e-6).floor();
    // A step below one has a whole inverse, and a division by it gives the shortest decimal.
    if step < 1.0 { whole / (1.0 / step).round() } else { whole * step }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench_file::BenchFile;
    use crate::testing::{has, near, within};

    #[test]
    fn a_nameplate_in_other_units_is_doubted() {
        let nameplate = BenchFile::embedded_default().motor;
        assert_eq!(nameplate.contradictions(), Vec::<String>::new());
        let in_rpm = MotorSection { rated_speed_rad_s: 2800.0, ..nameplate.clone() };
        has(in_rpm.contradictions().join(" "), "2800 r/min would be 293.2 rad/s");
        has(
            &MotorSection { rated_current_a: 5700.0, ..nameplate }.contradictions()[0],
            "given in mA",
        );
    }

    #[test]
    fn the_default_slew_of_the_paper_motor_is_the_recommended_one() {
        let motor = Nameplate::zk_22fc();
        let limits = Limits::for_motor(&motor, 100.0);
        // 2 I Ke^2/J = 317 V/s; 300 to 500 V/s are advisable for 0.0045 kg.m2.
        within(limits.slew_v_per_s, 300.0..500.0);
        near(limits.link_silence_s, 0.1, 1e-12);
        near(Limits::for_motor(&motor, 10.0).link_silence_s, 0.3, 1e-12);
    }
}
