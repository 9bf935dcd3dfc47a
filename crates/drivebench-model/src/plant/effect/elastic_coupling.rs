//! Elastic coupling: a two-mass system.

use super::{Card, Coupling, Enters, Measure, ParameterSpec};

/// Share of the load in the inertia. At either end one of the two masses vanishes.
pub(super) const INERTIA_RATIO: ParameterSpec =
    ParameterSpec::shape("inertia_ratio", "-", (0.02, 0.98), &[0.35, 0.55]);
/// Metal shafts have 0.005 to 0.02, rubber couplings 0.05 to 0.2; one is aperiodic.
pub(super) const DAMPING_RATIO: ParameterSpec =
    ParameterSpec::linear_shape("damping_ratio", "-", (0.0, 1.0), 0.05, &[0.03]);
pub(super) const FRICTION_SPLIT: ParameterSpec =
    ParameterSpec::linear_shape("friction_split", "-", (0.0, 1.0), 0.2, &[0.5]);
/// A lower frequency needs a longer run; a higher one is not observable in samples at 1 kHz.
pub(super) const FREQUENCY_HZ: (f64, f64) = (1.0, 200.0);

pub(super) const EFFECT: Card = Card {
    id: "elastic_coupling",
    name: "elastic coupling",
    enters: Enters::Torque,
    equation: "J1 dw/dt = ... - T, J2 dw2/dt = T - Mc2 sgn(w2), T = k (th - th2) + d (w - w2); J2 \
        = r J, k = (2 pi f)^2 J r (1 - r), d = 2 zeta sqrt(k J r (1 - r)), Mc2 = split Mc",
    causes: "a compliant coupling, a long shaft, a belt or a gear between motor and load",
    looks_like: "speed that rings at one frequency after every step of the voltage, whatever its \
        size",
    excite: "fast dither about zero speed and steps of several sizes; slow ramps do not show it",
    remedy: "stiffen the coupling, keep the speed loop's bandwidth below a third of f, or a notch \
        filter at f",
    parameters: &[
        ParameterSpec::shape(
            "frequency_hz",
            "Hz",
            FREQUENCY_HZ,
            &[9.0, 10.5, 12.2, 14.2, 16.5, 19.2, 22.3, 26.0, 30.0, 35.0, 40.6, 47.0, 55.0],
        )
        .of(Measure::Frequency),
        INERTIA_RATIO,
        DAMPING_RATIO,
        FRICTION_SPLIT,
    ],
    terms: |values| {
        Box::new(Coupling {
            frequency_hz: values[0],
            inertia_ratio: values[1],
            damping_ratio: values[2],
            friction_split: values[3],
            gap_rad: 0.0,
        })
    },
    ..Card::PLAIN
};
