use super::{Card, Effect, Enters, Instant, ParameterSpec, Terms};

/// Drag proportional to speed.
pub(super) struct ViscousFriction;

struct Drag(f64);

impl Effect for ViscousFriction {
    fn card(&self) -> &'static Card {
        &Card {
            id: "viscous_friction",
            name: "viscous friction",
            enters: Enters::Torque,
            equation: "T = B w",
            causes: "grease and seals, churning oil, eddy currents in iron or a brake disc: the same equation, which \
                     voltage, current and speed cannot tell apart. On the machine: grease and oil fall as they warm \
                     up and differ after a cold night, iron losses hardly do; with the rotor's magnets out (or the \
                     field off) and driven from outside, what stays is mechanical",
            looks_like: "torque error grows in proportion to speed, odd in the direction",
            excite: "long holds at several speeds over the full range, both directions",
            remedy: "check grease quantity and temperature; compensate by feed-forward B w",
            needs_angle: false,
        }
    }

    fn parameters(&self) -> &'static [ParameterSpec] {
        const P: &[ParameterSpec] = &[ParameterSpec::coefficient(
            "viscous_n_m_s_per_rad",
            "N.m.s/rad",
            f64::MAX,
            4e-4,
        )];
        P
    }

    fn terms(&self, values: &[f64]) -> Box<dyn Terms> {
        Box::new(Drag(values[0]))
    }
}

impl Terms for Drag {
    fn torque_n_m(&self, at: &Instant, _own: &[f64]) -> f64 {
        self.0 * at.speed_rad_s
    }
}
