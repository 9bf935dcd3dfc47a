//! `[speed]` of a bench file: which controller follows which reference within which limits.

use drivebench_model::tabulated;
use serde::{Deserialize, Serialize};

use super::reference::{Reference, ReferenceError, ReferencePart};
use crate::bench_file::Refused;
use crate::limits::{Limits, Nameplate};
use drivebench_control::tuning::Rule;
use drivebench_control::{Actuator, Addc, LoadObserving, Mrac, PaperB, Pi};
use drivebench_link::Capabilities;

tabulated! {
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
    #[serde(rename_all = "kebab-case")]
    pub enum ControllerKind {
        Pi = Pi::ID,
        #[default]
        Addc = Addc::ID,
        Mrac = Mrac::ID,
        PaperB = PaperB::ID,
        LoadObserver = LoadObserving::ID,
    }
    pub const fn id(self) -> &'static str;
}

impl ControllerKind {
    /// Through a speed command the inertia is not observable, which ADDC adapts to; the other regulators are designed for the
    /// voltage of a winding.
    pub const fn actuators(self) -> &'static [Actuator] {
        match self {
            Self::Pi => &[Actuator::Voltage, Actuator::Current, Actuator::Speed],
            Self::Addc => &[Actuator::Voltage, Actuator::Current],
            Self::Mrac | Self::PaperB | Self::LoadObserver => &[Actuator::Voltage],
        }
    }
}

tabulated! {
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
    #[serde(rename_all = "snake_case")]
    pub enum ForwardUse {
        #[default]
        Off = "off",
        On = "on",
        /// The reference is followed twice from the same beginning, first without, then with.
        Compare = "compare",
    }
    pub const fn name(self) -> &'static str;
}

impl ForwardUse {
    /// Whether each pass over the reference has it.
    pub const fn passes(self) -> &'static [bool] {
        match self {
            Self::Off => &[false],
            Self::On => &[true],
            Self::Compare => &[false, true],
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GainsSection {
    pub proportional_v_s_per_rad: f64,
    pub integral_time_s: f64,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SpeedSection {
    #[serde(default)]
    pub controller: ControllerKind,
    /// Left out: the modulus optimum, and the symmetrical one for a current command, behind which the shaft integrates.
    pub rule: Option<Rule>,
    /// Closed-loop bandwidth; left out: that of the rule, by the sum of the small time constants.
    pub bandwidth_rad_s: Option<f64>,
    pub current_limit_a: Option<f64>,
    pub slew_v_per_s: Option<f64>,
    /// The quantity that is commanded; left out: the first that the drive takes of voltage, current, speed.
    pub actuator: Option<Actuator>,
    /// Time in which the drive's own loop follows a current or speed command, s.
    pub drive_lag_s: Option<f64>,
    #[serde(default)]
    pub feed_forward: ForwardUse,
    /// No notch filter at the frequency of a coupling: the bandwidth is reduced instead.
    #[serde(default)]
    pub no_notch: bool,
    /// Only for `pi` over a voltage: instead of a rule.
    pub gains: Option<GainsSection>,
    pub reference: Vec<ReferencePart>,
}

impl SpeedSection {
    /// The commanded quantity; `None` where the drive takes none of them, or not the one of the section.
    pub fn actuator(&self, capabilities: &Capabilities) -> Option<Actuator> {
        let taken = [
            (Actuator::Voltage, capabilities.voltage_command),
            (Actuator::Current, capabilities.current_command),
            (Actuator::Speed, capabilities.speed_command),
        ];
        taken.into_iter().find_map(|(actuator, is_taken)| {
            (is_taken && self.actuator.is_none_or(|wanted| wanted == actuator)).then_some(actuator)
        })
    }

    /// How gains follow from the plant behind the actuator.
    pub fn rule(&self, actuator: Actuator) -> Rule {
        self.rule.unwrap_or(match actuator {
            Actuator::Current => Rule::SymmetricalOptimum,
            Actuator::Voltage | Actuator::Speed => Rule::ModulusOptimum,
        })
    }

    /// Current that the controller may draw, A; by default one and a half rated currents.
    pub fn current_limit_a(&self, rated_current_a: f64, limits: &Limits) -> f64 {
        self.current_limit_a.unwrap_or_else(|| (1.5 * rated_current_a).min(limits.current_a))
    }

    /// Fastest change of the voltage while the loop is closed, V/s; by default that of the controller's current limit, from
    /// one end of its range to the other within a cycle.
    pub fn slew_v_per_s(&self, motor: &Nameplate, limits: &Limits, period_s: f64) -> f64 {
        self.slew_v_per_s.unwrap_or_else(|| {
            let amps = self.current_limit_a(motor.rated_current_a, limits);
            2.0 * amps * motor.resistance_ohm / period_s
        })
    }

    /// The first value that is not allowed, but for the reference.
    pub(crate) fn refused(&self, limits: &Limits) -> Option<Refused> {
        let positive = |key, value: Option<f64>| {
            let bad = value.filter(|value| !(value.is_finite() && *value > 0.0))?;
            Some(Refused::new(key, bad, "a positive number"))
        };
        let gains = self.gains.as_ref();
        let proportional = gains.map(|gains| gains.proportional_v_s_per_rad);
        let integral_time_s = gains.map(|gains| gains.integral_time_s);
        let beyond = || {
            let amps = self.current_limit_a?;
            let allowed = format!("up to limits.current_a = {} A", limits.current_a);
            (amps > limits.current_a).then(|| Refused::new("speed.current_limit_a", amps, allowed))
        };
        positive("speed.bandwidth_rad_s", self.bandwidth_rad_s)
            .or_else(|| positive("speed.slew_v_per_s", self.slew_v_per_s))
            .or_else(|| positive("speed.current_limit_a", self.current_limit_a))
            .or_else(|| positive("speed.drive_lag_s", self.drive_lag_s))
            .or_else(beyond)
            .or_else(|| positive("speed.gains.proportional_v_s_per_rad", proportional))
            .or_else(|| positive("speed.gains.integral_time_s", integral_time_s))
    }

    /// The checked reference, once for each pass, within the speed limit and the speed at the voltage limit. Before each of
    /// several passes its first level is held for a second, or for half a second after the acceleration at the current limit.
    pub fn reference(
        &self,
        limits: &Limits,
        motor: Option<&Nameplate>,
    ) -> Result<Reference, ReferenceError> {
        let once = self.reference_once(limits, motor)?;
        let passes = self.feed_forward.passes().len();
        if passes == 1 {
            return Ok(once);
        }
        let lead_in_s = motor.map_or(1.0, |motor| {
            let spare_a = self.current_limit_a(motor.rated_current_a, limits)
                - motor.load_torque_n_m / motor.back_emf_v_s_per_rad;
            let torque_n_m = motor.back_emf_v_s_per_rad * spare_a.max(0.1 * motor.rated_current_a);
            let swing_rad_s = 2.0 * once.peak_rad_s();
            f64::max(1.0, 0.5 + motor.inertia_kg_m2 * swing_rad_s / torque_n_m)
        });
        Ok(once.repeated(passes, lead_in_s))
    }

    fn reference_once(
        &self,
        limits: &Limits,
        motor: Option<&Nameplate>,
    ) -> Result<Reference, ReferenceError> {
        let reach = motor.map(|motor| {
            let friction_v =
                motor.resistance_ohm * motor.load_torque_n_m / motor.back_emf_v_s_per_rad;
            (limits.voltage_v - friction_v) / motor.back_emf_v_s_per_rad
        });
        match reach {
            Some(reach) if reach < limits.speed_rad_s => {
                let is = format!("what limits.voltage_v = {} V reaches", limits.voltage_v);
                Reference::new(&self.reference, reach.max(0.0), &is)
            }
            _ => Reference::new(&self.reference, limits.speed_rad_s, "limits.speed_rad_s"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{has, near};

    fn section(reference: ReferencePart) -> SpeedSection {
        SpeedSection { reference: vec![reference], ..SpeedSection::default() }
    }

    fn constant(speed_rad_s: f64) -> SpeedSection {
        section(ReferencePart::Constant { speed_rad_s, seconds: 1.0 })
    }

    #[test]
    fn a_reference_beyond_a_limit_is_refused_with_it() {
        let (motor, mut limits) = (Nameplate::zk_22fc(), Limits::zk_22fc());
        let at = |speed, limits: &Limits| constant(speed).reference(limits, Some(&motor));
        assert!(at(-300.0, &limits).is_ok());
        // (110 V - 1.1 ohm 0.455 N.m/Kt)/Ke
        has(at(320.0, &limits).unwrap_err(), "306.9");
        limits.speed_rad_s = 200.0;
        has(at(-201.0, &limits).unwrap_err(), "limits.speed_rad_s");
    }

    #[test]
    fn a_comparison_follows_the_reference_twice() {
        let (motor, limits) = (Nameplate::zk_22fc(), Limits::zk_22fc());
        let mut section =
            section(ReferencePart::Ramp { from_rad_s: 20.0, to_rad_s: 80.0, seconds: 3.0 });
        section.feed_forward = ForwardUse::Compare;
        let reference = section.reference(&limits, Some(&motor)).unwrap();
        near(reference.duration_s(), 8.0, 1e-12);
        assert_eq!(reference.passes(), [(1.0, 4.0), (5.0, 8.0)]);
        let at = |time_s| reference.value_at(time_s);
        for time_s in [1.0, 2.5, 3.9] {
            near(at(time_s + 4.0), at(time_s), 1e-9);
        }
        near(at(0.3), 20.0, 1e-12);
        near(at(4.3), 20.0, 1e-12);
        assert_eq!(reference.part_name(reference.part_at(6.0)), "ramp, pass 2");
    }

    #[test]
    fn a_drive_gets_the_first_command_it_takes() {
        let mut section = constant(10.0);
        let mut takes =
            Capabilities { voltage_command: false, current_command: true, speed_command: true };
        assert_eq!(section.actuator(&takes), Some(Actuator::Current));
        section.actuator = Some(Actuator::Speed);
        assert_eq!(section.actuator(&takes), Some(Actuator::Speed));
        takes.speed_command = false;
        assert_eq!(section.actuator(&takes), None);
    }

    #[test]
    fn a_current_beyond_the_guard_is_refused() {
        let limits = Limits::zk_22fc();
        let mut section = constant(10.0);
        assert_eq!(section.refused(&limits), None);
        near(section.current_limit_a(5.7, &limits), 8.55, 1e-12);
        section.current_limit_a = Some(30.0);
        has(section.refused(&limits).unwrap(), "speed.current_limit_a = 30 is not allowed");
        has(section.refused(&limits).unwrap(), "22.8");
    }

    #[test]
    fn the_keys_of_a_bench_file_are_the_ids() {
        for kind in ControllerKind::ALL {
            assert_eq!(toml::Value::try_from(kind).unwrap().as_str(), Some(kind.id()));
        }
    }
}
