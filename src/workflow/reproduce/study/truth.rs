//! Truth of a machine: each effect with its right names, its waves in a turn and its size.
//!
//! The emulator's effects have other forms than the catalogue's, so that a size needs a condition at which both are held
//! against each other. It is the key's own meaning where that names one (a saturation at rated current, a delay, an
//! offset, the first harmonic of a wave); for drags the torque at half the rated speed, for friction that falls with
//! speed that at half its own speed, for a drifting field its change six seconds after the start, each divided by that
//! of the catalogue's form with size one.

use crate::emulator::truth::MotorTruth;
use crate::emulator::truth::effect::{HiddenEffect, Moment, Site};
use crate::plant::{Instant, effect};

use super::sizes::right_names;

/// The speed at which drags are compared, as a share of rated speed, and friction near standstill, as one of its own:
/// half of what the excitations reach, half of where it has fallen.
const SPEED_SHARE: f64 = 0.5;
/// The instant at which drifts are compared, s: half of a run.
const TIME_S: f64 = 6.0;

/// One effect that is there, and that the catalogue has a name for.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Truth {
    /// The names that are right for it, each with its size in the unit of the first parameter, the amplitude where that is
    /// one of sine and cosine; none where the parameter is no size.
    pub(super) names: Vec<(&'static str, Option<f64>)>,
    /// Waves in a turn.
    pub(super) order: Option<f64>,
}

/// Everything in a machine that the catalogue has a name for: what is hidden first, as it is listed, with a background
/// taken apart.
pub(super) fn truths(hidden: &[HiddenEffect], motor: &MotorTruth) -> Vec<Truth> {
    let site = Site::of(motor);
    let single = hidden.iter().flat_map(|effect| effect.single(&site));
    single
        .map(|effect| Truth::of(&effect, &site))
        .filter(|truth| !truth.names.is_empty())
        .collect()
}

impl Truth {
    fn of(hidden: &HiddenEffect, site: &Site) -> Self {
        let names = right_names(hidden.id()).into_iter();
        Self {
            names: names.map(|id| (id, size(hidden, id, site))).collect(),
            order: hidden.value("order"),
        }
    }
}

fn at_speed(speed_rad_s: f64) -> Instant {
    Instant {
        speed_rad_s,
        ..Instant::default()
    }
}

/// How large `hidden` is as the effect `id` of the catalogue.
fn size(hidden: &HiddenEffect, id: &str, site: &Site) -> Option<f64> {
    let of_catalogue = effect::find(id)?;
    let main = of_catalogue.parameters()[0].key;
    match id {
        // A frequency is no size.
        "elastic_coupling" => None,
        "viscous_friction" | "quadratic_load" | "asymmetric_viscous" => {
            let speed_rad_s = SPEED_SHARE * site.motor.rated_speed_rad_s;
            let torque_n_m = hidden.mechanism(site)?.drag_torque_n_m(speed_rad_s);
            let of_size_one = of_catalogue
                .terms(&[1.0])
                .torque_n_m(&at_speed(speed_rad_s), &[]);
            Some(torque_n_m / of_size_one)
        }
        "stribeck_friction" => {
            let own_rad_s = hidden.value("stribeck_speed_rad_s")?;
            let speed_rad_s = SPEED_SHARE * own_rad_s;
            let at = Moment {
                speed_rad_s,
                ..Moment::default()
            };
            let terms = of_catalogue.terms(&[1.0, own_rad_s]);
            let of_size_one = terms.friction_n_m(&at_speed(speed_rad_s));
            let friction_n_m = hidden.mechanism(site)?.friction_n_m(&at);
            if friction_n_m > 0.0 {
                Some(friction_n_m / of_size_one)
            } else {
                // A bristle is no function of the speed; at a constant one it settles on the catalogue's curve.
                hidden.value(main)
            }
        }
        "field_change" => {
            let at = Moment {
                time_s: TIME_S,
                ..Moment::default()
            };
            Some((hidden.mechanism(site)?.flux_factor(&at) - 1.0) / TIME_S)
        }
        _ => match main.strip_prefix("sin_") {
            Some(unit) => {
                let cosine = hidden.value(&format!("cos_{unit}"))?;
                Some(hidden.value(main)?.hypot(cosine))
            }
            None => hidden.value(main),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::emulator::EmulatorConfig;
    use crate::workflow::reproduce::study::sizes::{drawn, known, wrong_form};
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    fn motor() -> MotorTruth {
        EmulatorConfig::embedded("zk-22fc-plain").unwrap().motor
    }

    fn hidden(text: &str) -> HiddenEffect {
        toml::from_str(text).unwrap()
    }

    fn size_of(text: &str) -> f64 {
        let truth = truths(&[hidden(text)], &motor()).remove(0);
        truth.names[0].1.unwrap()
    }

    #[test]
    fn everything_that_has_a_name_has_a_size_but_a_frequency() {
        for id in [known(), wrong_form()].concat() {
            let effect = drawn(id, 1.0, &mut ChaCha8Rng::seed_from_u64(3)).unwrap();
            let [truth] = &truths(&[effect], &motor())[..] else {
                panic!("{id} is one thing");
            };
            for (name, size) in &truth.names {
                let is_size = size.is_some_and(|size| size.is_finite() && size.abs() > 0.0);
                assert_eq!(is_size, *name != "elastic_coupling", "{id} as {name}");
            }
        }
    }

    #[test]
    fn a_size_is_what_the_catalogue_would_need_at_the_reference_condition() {
        // Eyring's fluid: asinh(x)/x at a quarter of its speed.
        let drag = 4e-4 * 0.25_f64.asinh() / 0.25;
        let fan = 2e-6 * 0.5_f64.powf(-0.05);
        // Magnets that warm up slowly: (1 - e^-0.1)/0.1 of the drift at first.
        let drift = 4e-3 * (-0.1_f64).exp_m1() / 0.1;
        // e^-0.5 against e^-0.25.
        let film = 0.1 * (-0.25_f64).exp();
        for (id, settings, expected) in [
            ("viscous_friction", "viscous_n_m_s_per_rad = 4e-4", drag),
            ("quadratic_load", "quadratic_n_m_s2_per_rad2 = 2e-6", fan),
            ("field_change", "drift_per_s = -4e-3", drift),
            (
                "exponential_stribeck",
                "stribeck_n_m = 0.1\nstribeck_speed_rad_s = 8.0",
                film,
            ),
            (
                "cogging",
                "order = 6\nsin_n_m = 0.03\ncos_n_m = -0.04",
                0.05,
            ),
        ] {
            let size = size_of(&format!("id = {id:?}\n{settings}"));
            assert!((size - expected).abs() < 1e-12, "{id}: {size}");
        }
    }

    #[test]
    fn a_shape_between_two_names_has_a_size_under_each() {
        let fan = hidden("id = \"fan_three_halves\"\nthree_halves_n_m_s15_per_rad15 = 3e-5");
        let motor = motor();
        let truth = truths(&[fan], &motor).remove(0);
        let speed = 0.5 * motor.rated_speed_rad_s;
        let of = |name: &str| {
            let mut names = truth.names.iter();
            names.find(|(id, _)| *id == name).unwrap().1.unwrap()
        };
        assert!((of("quadratic_load") * speed.sqrt() - 3e-5).abs() < 1e-12);
        assert!((of("viscous_friction") / speed.sqrt() - 3e-5).abs() < 1e-12);
    }

    #[test]
    fn a_background_is_taken_apart_and_what_no_catalogue_has_is_left_out() {
        let motor = motor();
        let both = [
            hidden("id = \"messy\"\nscale = 2.0"),
            hidden("id = \"shaker\"\namplitude_n_m = 0.1\nfrequency_hz = 5.0"),
        ];
        let found = truths(&both, &motor);
        let names: Vec<&str> = found.iter().map(|truth| truth.names[0].0).collect();
        let background = crate::workflow::reproduce::study::sizes::BACKGROUND;
        assert_eq!(names, background);
        assert_eq!(found[1].order, Some(7.0));
        assert!((found[2].names[0].1.unwrap() - 0.8e-3).abs() < 1e-12);
    }
}
