use super::elastic_coupling::{DAMPING_RATIO, FREQUENCY_HZ, FRICTION_SPLIT, INERTIA_RATIO, Shaft};
use super::{Card, Coupling, Effect, Enters, ParameterSpec, Terms};

/// Play between motor and load.
pub(super) struct Backlash;

impl Effect for Backlash {
    fn card(&self) -> &'static Card {
        &Card {
            id: "backlash",
            name: "backlash",
            enters: Enters::Torque,
            equation: "as elastic_coupling, with T = k z + d (w - w2): z is the twist beyond half the gap to either side, \
                       zero within",
            causes: "play in a gear, a key, a claw coupling or a spindle nut; a loose grub screw",
            looks_like: "a knock at every reversal of the torque, and ringing of a lower frequency the smaller the motion is",
            excite: "small and large torque reversals about zero; motion in one direction keeps the teeth in contact",
            remedy: "preload or replace the worn part; reverse the torque gently in the loop",
            needs_angle: false,
        }
    }

    fn parameters(&self) -> &'static [ParameterSpec] {
        const P: &[ParameterSpec] = &[
            ParameterSpec::shape("gap_rad", "rad", (1e-4, 1.0), &[0.02, 0.04, 0.08]),
            ParameterSpec::shape("frequency_hz", "Hz", FREQUENCY_HZ, &[35.0, 55.0]),
            INERTIA_RATIO,
            DAMPING_RATIO,
            FRICTION_SPLIT,
        ];
        P
    }

    fn terms(&self, values: &[f64]) -> Box<dyn Terms> {
        Box::new(Shaft(Coupling {
            gap_rad: values[0],
            frequency_hz: values[1],
            inertia_ratio: values[2],
            damping_ratio: values[3],
            friction_split: values[4],
        }))
    }
}
