//! Backlash (play) between motor and load.

use super::elastic_coupling::{DAMPING_RATIO, FREQUENCY_HZ, FRICTION_SPLIT, INERTIA_RATIO};
use super::{Card, Coupling, Enters, Measure, ParameterSpec};

pub(super) const EFFECT: Card = Card {
    id: "backlash",
    name: "backlash",
    enters: Enters::Torque,
    equation: "as elastic_coupling, with T = k z + d (w - w2): z is the twist beyond half the gap \
        to either side, zero within",
    causes: "play in a gear, a key, a claw coupling or a spindle nut; a loose grub screw",
    looks_like: "a knock at every reversal of the torque, and ringing of a lower frequency the \
        smaller the motion is",
    excite: "small and large torque reversals about zero; motion in one direction keeps the teeth \
        in contact",
    remedy: "preload or replace the worn part; reverse the torque gently in the loop",
    alternatives: &["elastic_coupling"],
    parameters: &[
        ParameterSpec::shape("gap_rad", "rad", (1e-4, 1.0), &[0.02, 0.04, 0.08]).of(Measure::Angle),
        ParameterSpec::shape("frequency_hz", "Hz", FREQUENCY_HZ, &[35.0, 55.0])
            .of(Measure::Frequency),
        INERTIA_RATIO,
        DAMPING_RATIO,
        FRICTION_SPLIT,
    ],
    terms: |values| {
        Box::new(Coupling {
            gap_rad: values[0],
            frequency_hz: values[1],
            inertia_ratio: values[2],
            damping_ratio: values[3],
            friction_split: values[4],
        })
    },
    ..Card::PLAIN
};
