use super::{Card, Effect, Enters, Instant, ParameterSpec, Terms};

/// Extra friction near standstill.
pub(super) struct StribeckFriction;

struct Hump {
    level_n_m: f64,
    /// One over the Stribeck speed, s/rad.
    per_speed: f64,
}

impl Effect for StribeckFriction {
    fn card(&self) -> &'static Card {
        &Card {
            id: "stribeck_friction",
            name: "Stribeck friction",
            enters: Enters::Torque,
            equation: "T = Ts exp(-(w/ws)^2) sgn(w), added to the Coulomb level, stiction included",
            causes: "boundary lubrication in plain bearings, seals and gears; stiction of a machine that stood \
                     still. By hand: a breakaway that is harder than the motion after it. It falls after some \
                     warm-up and after re-greasing; cogging feels alike when turned by hand but stands at fixed \
                     angles, a compliant drive with backlash jerks only at reversals",
            looks_like: "torque error below a few per cent of speed and at reversals; stick-slip when creeping",
            excite: "repeated slow passages through zero speed in both directions",
            remedy: "lubrication, dither or friction feed-forward at low speed",
            needs_angle: false,
        }
    }

    fn parameters(&self) -> &'static [ParameterSpec] {
        const P: &[ParameterSpec] = &[
            ParameterSpec::coefficient("stribeck_n_m", "N.m", f64::MAX, 0.1),
            ParameterSpec::shape(
                "stribeck_speed_rad_s",
                "rad/s",
                (1.0, 40.0),
                &[4.0, 8.0, 16.0, 30.0],
            ),
        ];
        P
    }

    fn terms(&self, values: &[f64]) -> Box<dyn Terms> {
        Box::new(Hump {
            level_n_m: values[0],
            per_speed: 1.0 / values[1],
        })
    }
}

impl Terms for Hump {
    fn friction_n_m(&self, at: &Instant) -> f64 {
        let ratio = at.speed_rad_s * self.per_speed;
        let square = ratio * ratio;
        // Beyond, what is left is below the rounding of the friction that it is added to.
        if square > 40.0 {
            return 0.0;
        }
        self.level_n_m * (-square).exp()
    }
}
