use super::{Card, Effect, Enters, Instant, ParameterSpec, Terms};

/// Flux that falls as the current rises: back-EMF and torque constant fall together.
pub(super) struct FluxSaturation;

struct Armature(f64);

impl Armature {
    /// Share of the flux that is lost.
    fn lost(&self, at: &Instant) -> f64 {
        let excess = self.0 * at.current_a * at.current_a;
        excess / (1.0 + excess)
    }
}

impl Effect for FluxSaturation {
    fn card(&self) -> &'static Card {
        &Card {
            id: "flux_saturation",
            name: "flux saturation",
            enters: Enters::Both,
            equation: "Ke and Kt times 1/(1 + c i^2)",
            causes: "armature reaction that saturates the pole tips, iron at its limit under overload, a wrong \
                     commutation angle at high current (a sensor's lag). Supply sag looks alike in the voltage but \
                     leaves the torque; a current sensor that saturates shows less current than flows: check with a \
                     clamp meter at full load",
            looks_like: "less torque per ampere and less back-EMF at high current than at low, in the same \
                         proportion",
            excite: "hard acceleration and braking, at low and at high speed; currents up to the largest allowed",
            remedy: "limit the current to where torque still grows; correct the commutation angle; gain schedule \
                     over the current",
            needs_angle: false,
        }
    }

    fn parameters(&self) -> &'static [ParameterSpec] {
        const P: &[ParameterSpec] = &[ParameterSpec::positive(
            "saturation_per_a2",
            "1/A2",
            f64::MAX,
            5e-4,
        )];
        P
    }

    fn terms(&self, values: &[f64]) -> Box<dyn Terms> {
        Box::new(Armature(values[0]))
    }
}

impl Terms for Armature {
    fn voltage_v(&self, at: &Instant, _own: &[f64]) -> f64 {
        -at.back_emf_v_s_per_rad * at.speed_rad_s * self.lost(at)
    }

    fn torque_n_m(&self, at: &Instant, _own: &[f64]) -> f64 {
        at.torque_n_m_per_a * at.current_a * self.lost(at)
    }
}
