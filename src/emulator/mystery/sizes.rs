//! How large the effect of a mystery is.
//!
//! Torques are 3 to 15 % of the rated torque. Voltages are 1 to 4 % of the rated voltage (the resistance itself drops
//! 6 %); offsets stay within what a host's checks at rest allow. Delays and filters are of a size that a sample every 10 ms can see.

use rand::Rng;
use rand_chacha::ChaCha8Rng;

use crate::emulator::truth::effect::{
    AsymmetricViscous, Backlash, Cogging, CommandDelay, ConstantLoad, CurrentFilter, CurrentOffset,
    DiscontinuousConduction, EccentricLoad, ElasticCoupling, FieldChange, FluxSaturation,
    FrictionOnset, HiddenEffect, InductanceSaturation, InertiaChange, LoadDependentFriction,
    LoadStep, OneSidedLoad, QuadraticLoad, RandomLoad, RestartDelay, Shaker, Site, SpeedDelay,
    SpeedFilter, SpeedOffset, StartDelay, StribeckFriction, SupplySag, TorqueBump, TorqueRipple,
    ViscousFriction, VoltageDrop, VoltageOffset, WindingHeating,
};

/// What is drawn from where the host's catalogue has the answer.
pub(super) const KNOWN: &[&str] = &[
    "viscous_friction",
    "quadratic_load",
    "stribeck_friction",
    "constant_load",
    "asymmetric_viscous",
    "cogging",
    "torque_ripple",
    "eccentric_load",
    "load_dependent_friction",
    "load_step",
    "one_sided_load",
    "friction_onset",
    "inertia_change",
    "elastic_coupling",
    "backlash",
    "voltage_drop",
    "supply_sag",
    "winding_heating",
    "flux_saturation",
    "inductance_saturation",
    "field_change",
    "discontinuous_conduction",
    "command_delay",
    "start_delay",
    "restart_delay",
    "speed_delay",
    "speed_filter",
    "current_filter",
    "current_offset",
    "speed_offset",
    "voltage_offset",
];

/// What is drawn from where nothing known is the answer. Known effects in a wrong shape are not drawn: for them the name of
/// the next of kin would be right too.
pub(super) const FOREIGN: &[&str] = &["shaker", "torque_bump", "random_load"];

/// A dice with the ranges that the sizes need.
struct Dice<'a>(&'a mut ChaCha8Rng);

impl Dice<'_> {
    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.0.random::<f64>()
    }

    /// Small sizes as often as large ones.
    fn size(&mut self, low: f64, high: f64) -> f64 {
        self.between(low.ln(), high.ln()).exp()
    }

    fn sign(&mut self) -> f64 {
        if self.0.random() { 1.0 } else { -1.0 }
    }

    fn signed(&mut self, low: f64, high: f64) -> f64 {
        self.sign() * self.size(low, high)
    }

    /// `amplitude` at any phase, as its sine and cosine part.
    fn wave(&mut self, amplitude: f64) -> (f64, f64) {
        let phase = self.between(0.0, std::f64::consts::TAU);
        (amplitude * phase.cos(), amplitude * phase.sin())
    }

    fn order(&mut self) -> f64 {
        f64::from(self.0.random_range(3..=16_u8))
    }

    /// Whole ticks of the drive.
    fn delay_s(&mut self, low_ms: f64, high_ms: f64) -> f64 {
        (self.size(low_ms, high_ms) * 20.0).round() * 50e-6
    }
}

/// The effect `id` on a motor with this nameplate; `None` for an id that is in neither list.
#[expect(
    clippy::too_many_lines,
    reason = "one arm per effect: a table of ranges"
)]
pub(super) fn sized(id: &str, rng: &mut ChaCha8Rng, nameplate: &Site) -> Option<HiddenEffect> {
    use HiddenEffect as H;
    let mut dice = Dice(rng);
    let motor = &nameplate.motor;
    let rated_torque = nameplate.rated_torque_n_m();
    let (volts, amps, speed) = (
        motor.rated_voltage_v,
        motor.rated_current_a,
        motor.rated_speed_rad_s,
    );
    let torque = dice.size(0.03, 0.15) * rated_torque;
    Some(match id {
        "viscous_friction" => H::ViscousFriction(ViscousFriction {
            viscous_n_m_s_per_rad: torque / speed,
        }),
        "quadratic_load" => H::QuadraticLoad(QuadraticLoad {
            quadratic_n_m_s2_per_rad2: torque / (speed * speed),
        }),
        "stribeck_friction" => H::StribeckFriction(StribeckFriction {
            stribeck_n_m: torque,
            stribeck_speed_rad_s: dice.between(5.0, 20.0),
        }),
        "constant_load" => H::ConstantLoad(ConstantLoad {
            constant_n_m: dice.sign() * torque,
        }),
        "asymmetric_viscous" => H::AsymmetricViscous(AsymmetricViscous {
            asymmetry_n_m_s_per_rad: dice.sign() * torque / speed,
        }),
        "cogging" => {
            let order = dice.order();
            let (sin_n_m, cos_n_m) = dice.wave(torque);
            H::Cogging(Cogging {
                order,
                sin_n_m,
                cos_n_m,
            })
        }
        "torque_ripple" => {
            let order = dice.order();
            let ratio = dice.size(0.05, 0.15);
            let (sin_ratio, cos_ratio) = dice.wave(ratio);
            H::TorqueRipple(TorqueRipple {
                order,
                sin_ratio,
                cos_ratio,
            })
        }
        "eccentric_load" => {
            let (sin_n_m, cos_n_m) = dice.wave(torque);
            H::EccentricLoad(EccentricLoad { sin_n_m, cos_n_m })
        }
        "load_dependent_friction" => H::LoadDependentFriction(LoadDependentFriction {
            ratio: dice.size(0.04, 0.15),
        }),
        "load_step" => H::LoadStep(LoadStep {
            step_n_m: torque,
            time_s: dice.between(3.0, 9.0),
        }),
        "one_sided_load" => H::OneSidedLoad(OneSidedLoad {
            load_n_m: dice.sign() * torque,
            time_s: dice.between(3.0, 9.0),
        }),
        "friction_onset" => H::FrictionOnset(FrictionOnset {
            viscous_n_m_s_per_rad: torque / speed,
            time_s: dice.between(3.0, 9.0),
        }),
        "inertia_change" => H::InertiaChange(InertiaChange {
            ratio: dice.size(0.1, 0.5),
            time_s: dice.between(3.0, 9.0),
        }),
        "elastic_coupling" => H::ElasticCoupling(ElasticCoupling {
            frequency_hz: dice.between(10.0, 30.0),
            inertia_ratio: dice.between(0.3, 0.6),
            damping_ratio: dice.between(0.02, 0.08),
            friction_split: dice.between(0.2, 0.8),
        }),
        "backlash" => H::Backlash(Backlash {
            frequency_hz: dice.between(25.0, 45.0),
            inertia_ratio: dice.between(0.3, 0.6),
            damping_ratio: dice.between(0.02, 0.08),
            friction_split: dice.between(0.2, 0.8),
            gap_rad: dice.size(0.02, 0.1),
        }),
        "voltage_drop" => H::VoltageDrop(VoltageDrop {
            drop_v: dice.size(0.01, 0.04) * volts,
        }),
        "supply_sag" => H::SupplySag(SupplySag {
            sag_ohm: dice.size(0.02, 0.06) * volts / amps,
        }),
        "winding_heating" => H::WindingHeating(WindingHeating {
            gain_per_a2_s: dice.size(1e-3, 4e-3),
            time_constant_s: dice.between(10.0, 40.0),
        }),
        // By so much at rated current. From 2 % on, the back-EMF at full speed falls faster with the current than the
        // resistance's voltage grows, and the current runs away.
        "flux_saturation" => H::FluxSaturation(FluxSaturation {
            // Above 0.0128 the weakest specimen runs away at full speed.
            saturation_per_a2: dice.size(0.005, 0.0125) / (amps * amps),
        }),
        // By so much at rated current.
        "inductance_saturation" => H::InductanceSaturation(InductanceSaturation {
            saturation_per_a2: dice.size(0.2, 0.6) / (amps * amps),
        }),
        // Warm magnets lose flux: 3 to 10 % in ten seconds.
        "field_change" => H::FieldChange(FieldChange {
            drift_per_s: -dice.size(0.003, 0.01),
        }),
        "discontinuous_conduction" => H::DiscontinuousConduction(DiscontinuousConduction {
            boundary_a: dice.between(1.0, 3.0),
            extra_ohm: dice.size(0.5, 2.0),
        }),
        "command_delay" => H::CommandDelay(CommandDelay {
            delay_s: dice.delay_s(2.0, 10.0),
        }),
        "start_delay" => H::StartDelay(StartDelay {
            delay_s: dice.delay_s(30.0, 200.0),
        }),
        "restart_delay" => H::RestartDelay(RestartDelay {
            delay_s: dice.delay_s(30.0, 200.0),
        }),
        "speed_delay" => H::SpeedDelay(SpeedDelay {
            delay_s: dice.delay_s(4.0, 15.0),
        }),
        "speed_filter" => H::SpeedFilter(SpeedFilter {
            time_constant_s: dice.delay_s(5.0, 20.0),
        }),
        "current_filter" => H::CurrentFilter(CurrentFilter {
            time_constant_s: dice.delay_s(4.0, 15.0),
        }),
        // A host refuses to arm where more than this flows at rest, or where a voltage at zero reference moves the shaft.
        "current_offset" => H::CurrentOffset(CurrentOffset {
            offset_a: dice.signed(0.015, 0.03) * amps,
        }),
        "speed_offset" => H::SpeedOffset(SpeedOffset {
            offset_rad_s: dice.signed(0.003, 0.01) * speed,
        }),
        "voltage_offset" => H::VoltageOffset(VoltageOffset {
            offset_v: dice.signed(0.004, 0.009) * volts,
        }),
        "shaker" => H::Shaker(Shaker {
            amplitude_n_m: torque,
            frequency_hz: dice.between(2.0, 8.0),
        }),
        "torque_bump" => H::TorqueBump(TorqueBump {
            bump_n_m: dice.size(0.08, 0.2) * rated_torque,
            speed_rad_s: dice.between(60.0, 180.0),
            width_rad_s: dice.between(10.0, 30.0),
        }),
        "random_load" => H::RandomLoad(RandomLoad {
            std_n_m: dice.size(0.03, 0.08) * rated_torque,
            correlation_s: dice.between(0.03, 0.2),
        }),
        _ => return None,
    })
}
