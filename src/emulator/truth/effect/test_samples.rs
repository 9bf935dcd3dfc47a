//! Effects of the usual sizes, for tests.

use super::*;

/// One of each in the sizes of the example configuration.
#[expect(clippy::too_many_lines, reason = "one entry per effect: a table")]
pub(in crate::emulator) fn one_of_each() -> Vec<HiddenEffect> {
    use HiddenEffect as H;
    let coupling = ElasticCoupling {
        frequency_hz: 22.0,
        inertia_ratio: 0.4,
        damping_ratio: 0.03,
        friction_split: 0.5,
    };
    vec![
        H::ViscousFriction(ViscousFriction {
            viscous_n_m_s_per_rad: 4e-4,
        }),
        H::QuadraticLoad(QuadraticLoad {
            quadratic_n_m_s2_per_rad2: 1.8e-6,
        }),
        H::StribeckFriction(StribeckFriction {
            stribeck_n_m: 0.16,
            stribeck_speed_rad_s: 10.0,
        }),
        H::ConstantLoad(ConstantLoad { constant_n_m: 0.1 }),
        H::AsymmetricViscous(AsymmetricViscous {
            asymmetry_n_m_s_per_rad: 1e-4,
        }),
        H::Cogging(Cogging {
            order: 7.0,
            sin_n_m: 0.1,
            cos_n_m: 0.0,
        }),
        H::TorqueRipple(TorqueRipple {
            order: 7.0,
            sin_ratio: 0.05,
            cos_ratio: 0.0,
        }),
        H::EccentricLoad(EccentricLoad {
            sin_n_m: 0.1,
            cos_n_m: 0.05,
        }),
        H::LoadDependentFriction(LoadDependentFriction { ratio: 0.08 }),
        H::LoadStep(LoadStep {
            step_n_m: 0.12,
            time_s: 0.6,
        }),
        H::OneSidedLoad(OneSidedLoad {
            load_n_m: 0.1,
            time_s: 0.4,
        }),
        H::FrictionOnset(FrictionOnset {
            viscous_n_m_s_per_rad: 4e-4,
            time_s: 0.6,
        }),
        H::InertiaChange(InertiaChange {
            ratio: 0.3,
            time_s: 0.6,
        }),
        H::ElasticCoupling(coupling),
        H::Backlash(Backlash {
            frequency_hz: 45.0,
            inertia_ratio: 0.4,
            damping_ratio: 0.05,
            friction_split: 0.5,
            gap_rad: 0.04,
        }),
        H::VoltageDrop(VoltageDrop { drop_v: 1.2 }),
        H::SupplySag(SupplySag { sag_ohm: 0.4 }),
        H::WindingHeating(WindingHeating {
            gain_per_a2_s: 2e-3,
            time_constant_s: 20.0,
        }),
        H::FluxSaturation(FluxSaturation {
            saturation_per_a2: 4e-4,
        }),
        H::InductanceSaturation(InductanceSaturation {
            saturation_per_a2: 5e-3,
        }),
        H::FieldChange(FieldChange { drift_per_s: -5e-3 }),
        H::DiscontinuousConduction(DiscontinuousConduction {
            boundary_a: 2.0,
            extra_ohm: 1.0,
        }),
        H::CommandDelay(CommandDelay { delay_s: 2e-3 }),
        H::StartDelay(StartDelay { delay_s: 0.05 }),
        H::RestartDelay(RestartDelay { delay_s: 0.05 }),
        H::SpeedDelay(SpeedDelay { delay_s: 4e-3 }),
        H::SpeedFilter(SpeedFilter {
            time_constant_s: 5e-3,
        }),
        H::CurrentFilter(CurrentFilter {
            time_constant_s: 4e-3,
        }),
        H::CurrentOffset(CurrentOffset { offset_a: 0.2 }),
        H::SpeedOffset(SpeedOffset { offset_rad_s: 1.0 }),
        H::VoltageOffset(VoltageOffset { offset_v: 0.6 }),
        H::Shaker(Shaker {
            amplitude_n_m: 0.1,
            frequency_hz: 4.6,
        }),
        H::TorqueBump(TorqueBump {
            bump_n_m: 0.12,
            speed_rad_s: 95.0,
            width_rad_s: 20.0,
        }),
        H::RandomLoad(RandomLoad {
            std_n_m: 0.06,
            correlation_s: 0.05,
        }),
        H::SoftDrop(SoftDrop { drop_v: 3.0 }),
        H::FanThreeHalves(FanThreeHalves {
            three_halves_n_m_s15_per_rad15: 3e-5,
        }),
        H::ExponentialStribeck(ExponentialStribeck {
            stribeck_n_m: 0.16,
            stribeck_speed_rad_s: 10.0,
        }),
        H::HarmonicCogging(HarmonicCogging {
            order: 7.0,
            sin_n_m: 0.1,
            cos_n_m: 0.0,
        }),
        H::LoadRamp(LoadRamp {
            step_n_m: 0.16,
            time_s: 0.1,
            rise_s: 0.2,
        }),
        H::Messy(Messy { scale: 1.0 }),
    ]
}
