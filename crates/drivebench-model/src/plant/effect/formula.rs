//! The law of an effect as a formula for other programs.
//!
//! The laws of the simulation are code, for speed; each card has its law a second time, as text in the notation of `custom`,
//! and a test compares both. An export to another language translates the tree of the formula.

use super::grammar::{self, Tree};

/// Where a formula enters the equations, with the signs that [`Terms`](super::Terms) defines.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// Voltage drop, V: subtracted in the voltage balance.
    Voltage,
    /// Torque against positive motion, N.m: subtracted in the torque balance.
    Torque,
    /// Addition to the Coulomb level, N.m.
    Friction,
    /// Relative addition to the rate of the current.
    CurrentRate,
    /// Relative addition to the inertia.
    Inertia,
    /// Time derivative of the effect's one state `x`, which starts at zero.
    StateRate,
    /// Offset of the current sensor, A.
    CurrentReading,
    /// Offset of the speed sensor, rad/s.
    SpeedReading,
}

/// Names in a formula before the parameters of its effect: voltage, current, speed, angle, time since the
/// first command; resistance of the cold winding, back-EMF and torque constant; full voltage of the supply; the state.
pub const SYMBOLS: [&str; 10] = ["u", "i", "w", "theta", "t", "R", "Ke", "Kt", "U", "x"];
/// Index of the speed among them.
pub(super) const SPEED: usize = 2;

/// A term of an effect. A name in the tree is an index into [`SYMBOLS`], beyond them into the effect's parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct Formula {
    pub place: Place,
    pub tree: Tree,
}

pub(super) fn read(text: &str, parameters: &[&str]) -> Option<Tree> {
    let names = |name: &str| {
        let all = || SYMBOLS.iter().chain(parameters);
        let found = all().position(|known| *known == name);
        found.ok_or_else(|| all().copied().collect::<Vec<_>>().join(", "))
    };
    grammar::read(text, &names).ok()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::plant::effect::{CATALOGUE, Effect, Instant, Path, ShaftAngle, define};
    use crate::plant::{Motor, ParameterRole, ParameterSpec};

    /// A value of a parameter, from a share of its range.
    fn value((spec, share): (&ParameterSpec, &f64)) -> f64 {
        match spec.role {
            // A delay or a filter of zero is no time to divide by.
            ParameterRole::Coefficient if spec.min >= 0.0 => spec.scale * (0.1 + 3.0 * share),
            ParameterRole::Coefficient => {
                (spec.scale * 6.0 * (share - 0.5)).clamp(spec.min, spec.max)
            }
            ParameterRole::Choice => (1.0 + 40.0 * share).round(),
            ParameterRole::EventTime => 4.0 * share,
            ParameterRole::Shape => {
                let (first, last) = (spec.shapes[0], spec.shapes[spec.shapes.len() - 1]);
                (first + share * (last - first).max(first)).clamp(spec.min, spec.max)
            }
        }
    }

    fn check(effect: &dyn Effect, formulas: &[Formula], at: &Instant, shares: &[f64], x: f64) {
        let values: Vec<f64> = effect.parameters().iter().zip(shares).map(value).collect();
        let (u, i, w) = (at.voltage_v, at.current_a, at.speed_rad_s);
        let (theta, t, supply) = (at.angle.rad(), at.time_s, at.supply_v);
        let (ke, kt) = (at.back_emf_v_s_per_rad, at.torque_n_m_per_a);
        let symbols = [u, i, w, theta, t, at.resistance_ohm, ke, kt, supply, x];
        let all = [&symbols[..], &values].concat();
        let terms = effect.terms(&values);
        let own = vec![x; terms.states()];
        let mut rates = vec![0.0; terms.states()];
        terms.derivative(at, &own, &mut rates);
        let (sums, path) = (terms.sums(at, &own), terms.path());
        // A filter's state is the reading; elsewhere the law has none.
        let lag = |tau: f64, truth: f64| if tau > 0.0 { x - truth } else { 0.0 };
        let lags = [
            (path.current_filter_s, lag(path.current_filter_s, i)),
            (path.speed_filter_s, lag(path.speed_filter_s, w)),
        ];
        let filtered = lags.map(|(tau, lag)| if tau > 0.0 { -lag / tau } else { 0.0 });
        let rate = rates.iter().chain(&filtered).sum::<f64>();
        for (place, law) in [
            (Place::Voltage, sums.voltage_v),
            (Place::Torque, sums.torque_n_m),
            (Place::Friction, sums.friction_n_m),
            (Place::CurrentRate, sums.current_rate_gain),
            (Place::Inertia, sums.inertia_gain),
            (Place::StateRate, rate),
            (Place::CurrentReading, path.current_offset_a + lags[0].1),
            (Place::SpeedReading, path.speed_offset_rad_s + lags[1].1),
        ] {
            let here = formulas.iter().filter(|formula| formula.place == place);
            let written: f64 = here.map(|formula| formula.tree.value(&all)).sum();
            let is_same = (written - law).abs() <= 1e-9 * law.abs().max(1e-6);
            let id = effect.card().id;
            assert!(
                is_same,
                "{id}: {place:?} is {law}, written {written}, for {values:?} at {at:?}"
            );
        }
    }

    fn instants() -> impl Strategy<Value = (Instant, Vec<f64>, f64)> {
        let shares = proptest::collection::vec(0.0..1.0_f64, 6);
        let at = proptest::array::uniform5(-1.0..1.0_f64);
        (at, shares, 0.0..50.0_f64).prop_map(|([u, i, w, theta, t], shares, x)| {
            let at = Instant {
                time_s: 2.5 * (1.0 + t),
                voltage_v: 120.0 * u,
                supply_v: 110.0,
                current_a: 20.0 * i,
                speed_rad_s: 300.0 * w,
                angle: ShaftAngle::at(9.0 * theta),
                ..Instant::of(&Motor::zk_22fc())
            };
            (at, shares, x)
        })
    }

    #[test]
    fn every_effect_of_the_catalogue_has_its_law_or_is_more() {
        let unwritten = CATALOGUE.iter().filter(|effect| effect.formula().is_none());
        let unwritten: Vec<&str> = unwritten.map(|effect| effect.card().id).collect();
        let delays = "command_delay start_delay restart_delay speed_delay";
        let expected = format!("{delays} elastic_coupling backlash");
        assert_eq!(unwritten.join(" "), expected);
        for effect in CATALOGUE {
            let (id, stated) = (effect.card().id, effect.card().formula.len());
            assert_eq!(effect.formula().map_or(0, |own| own.len()), stated, "{id} is not read");
            let terms = effect.terms(&vec![1.0; effect.parameters().len()]);
            assert!(terms.states() <= 1, "{id} has one state `x`");
            let is_more = terms.coupling().is_some() || terms.path() != Path::default();
            assert!(stated > 0 || is_more, "{id}");
        }
        proptest!(|((at, shares, x) in instants())| {
            for effect in CATALOGUE {
                if let Some(formulas) = effect.formula() {
                    check(*effect, &formulas, &at, &shares, x);
                    // Near rest and at small currents, where the humps are.
                    let near = Instant {
                        current_a: 0.01 * at.current_a,
                        speed_rad_s: 0.02 * at.speed_rad_s,
                        ..at
                    };
                    check(*effect, &formulas, &near, &shares, x);
                }
            }
        });
    }

    #[test]
    fn effects_of_users_and_data_have_their_laws() {
        for (id, equation, law, list) in [
            ("custom", "torque", "a*abs(w)*w + b*sin(3*theta)", "a b"),
            ("custom", "torque", "(a + b*exp(-(w/9)^2))*sgn(w)", "a b"),
            ("custom", "voltage", "a*sgn(i)*u", "a"),
            ("table", "torque", "speed_rad_s", "-200.0 -10.0 0.0 30.0"),
            ("table", "voltage", "current_a", "-9.0 9.0"),
            ("table", "torque", "angle_rad", "1.0 2.0"),
        ] {
            let text = if id == "custom" {
                let names = list.replace(' ', "\", \"");
                format!("expression = \"{law}\"\nparameters = [\"{names}\"]")
            } else {
                format!("axis = \"{law}\"\nknots = [{}]", list.replace(' ', ", "))
            };
            let text = format!("equation = \"{equation}\"\n{text}");
            let (effect, _) = define(id, &text.parse().unwrap()).unwrap();
            // A curve that closes over a turn has none.
            let formulas = effect.formula();
            assert_eq!(formulas.is_none(), law == "angle_rad", "{text}");
            if let Some(formulas) = formulas {
                proptest!(|((at, shares, x) in instants())| {
                    check(effect, &formulas, &at, &shares, x);
                });
            }
        }
    }
}
