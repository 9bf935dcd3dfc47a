//! The law of an effect written down, so that other programs can compute it.
//!
//! The laws that a simulation evaluates are written for speed; each card states its own a second time, as text in the
//! notation of `custom`, and a test holds the two together. Who renders a formula for another language walks its tree.

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
    /// What the sensor of the current adds to the truth, A.
    CurrentReading,
    /// What the sensor of the speed adds to the truth, rad/s.
    SpeedReading,
}

/// Names that a formula may hold before the parameters of its effect: voltage, current, speed, angle, time since the
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

/// Reads a term; `None` where it is none.
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
    fn value(spec: &ParameterSpec, share: f64) -> f64 {
        match spec.role {
            // None of a delay or a filter is no time to divide by.
            ParameterRole::Coefficient if spec.min >= 0.0 => spec.scale * (0.1 + 3.0 * share),
            ParameterRole::Coefficient => {
                (spec.scale * 6.0 * (share - 0.5)).clamp(spec.min, spec.max)
            }
            ParameterRole::Choice => (1.0 + 40.0 * share).round(),
            ParameterRole::EventTime => 4.0 * share,
            ParameterRole::Shape => {
                let first = spec.shapes[0];
                (first + share * (spec.shapes[spec.shapes.len() - 1] - first).max(first))
                    .clamp(spec.min, spec.max)
            }
        }
    }

    /// What the formulas of an effect add in this place.
    fn sum(formulas: &[Formula], place: Place, all: &[f64]) -> f64 {
        let here = formulas.iter().filter(|formula| formula.place == place);
        here.map(|formula| formula.tree.value(&|index| all[index]))
            .sum()
    }

    fn check(effect: &dyn Effect, formulas: &[Formula], at: &Instant, shares: &[f64], x: f64) {
        let id = effect.card().id;
        let specs = effect.parameters();
        let values: Vec<f64> = specs
            .iter()
            .zip(shares)
            .map(|(spec, share)| value(spec, *share))
            .collect();
        let symbols = [
            at.voltage_v,
            at.current_a,
            at.speed_rad_s,
            at.angle.rad(),
            at.time_s,
            at.resistance_ohm,
            at.back_emf_v_s_per_rad,
            at.torque_n_m_per_a,
            at.supply_v,
            x,
        ];
        let all = [&symbols[..], &values].concat();
        let terms = effect.terms(&values);
        let own = vec![x; terms.states()];
        let mut rates = vec![0.0; terms.states()];
        terms.derivative(at, &own, &mut rates);
        let sums = terms.sums(at, &own);
        let path = terms.path();
        // A filter's state is the reading; elsewhere the law has none.
        let filtered = |time_constant_s: f64, truth: f64| (time_constant_s > 0.0).then_some(truth);
        let current = filtered(path.current_filter_s, at.current_a);
        let speed = filtered(path.speed_filter_s, at.speed_rad_s);
        let lag = |tau: f64, truth: f64| if tau > 0.0 { (truth - x) / tau } else { 0.0 };
        let rate = rates.iter().sum::<f64>()
            + lag(path.current_filter_s, at.current_a)
            + lag(path.speed_filter_s, at.speed_rad_s);
        for (place, law) in [
            (Place::Voltage, sums.voltage_v),
            (Place::Torque, sums.torque_n_m),
            (Place::Friction, sums.friction_n_m),
            (Place::CurrentRate, sums.current_rate_gain),
            (Place::Inertia, sums.inertia_gain),
            (Place::StateRate, rate),
            (
                Place::CurrentReading,
                path.current_offset_a + current.map_or(0.0, |truth| x - truth),
            ),
            (
                Place::SpeedReading,
                path.speed_offset_rad_s + speed.map_or(0.0, |truth| x - truth),
            ),
        ] {
            let written = sum(formulas, place, &all);
            let off = (written - law).abs();
            assert!(
                off <= 1e-9 * law.abs().max(1e-6),
                "{id}: {place:?} is {law}, written {written}, for {values:?} at {at:?}"
            );
        }
    }

    fn instants() -> impl Strategy<Value = (Instant, Vec<f64>, f64)> {
        let at = (
            -120.0..120.0_f64,
            -20.0..20.0_f64,
            -300.0..300.0_f64,
            -9.0..9.0_f64,
            0.0..5.0_f64,
        );
        let shares = proptest::collection::vec(0.0..1.0_f64, 6);
        (at, shares, 0.0..50.0_f64).prop_map(|((u, i, w, theta, t), shares, x)| {
            let at = Instant {
                time_s: t,
                voltage_v: u,
                supply_v: 110.0,
                current_a: i,
                speed_rad_s: w,
                angle: ShaftAngle::at(theta),
                ..Instant::of(&Motor::zk_22fc())
            };
            (at, shares, x)
        })
    }

    #[test]
    fn every_effect_is_written_as_its_law_is_or_says_that_it_is_not() {
        let unwritten: Vec<&str> = CATALOGUE
            .iter()
            .filter(|effect| effect.formula().is_none())
            .map(|effect| effect.card().id)
            .collect();
        assert_eq!(
            unwritten,
            [
                "command_delay",
                "start_delay",
                "restart_delay",
                "speed_delay",
                "elastic_coupling",
                "backlash"
            ]
        );
        for effect in CATALOGUE {
            let stated = effect.card().formula.len();
            let read = effect.formula().map_or(0, |formulas| formulas.len());
            assert_eq!(read, stated, "{} is not read", effect.card().id);
            let terms = effect.terms(&vec![1.0; effect.parameters().len()]);
            assert!(
                terms.states() <= 1,
                "{} has one state `x`",
                effect.card().id
            );
            let is_more = terms.coupling().is_some() || terms.path() != Path::default();
            assert!(stated > 0 || is_more, "{} says why", effect.card().id);
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
    fn what_a_user_or_the_data_define_is_written_too() {
        let tables = [
            "equation = \"torque\"\nexpression = \"a*abs(w)*w + c*sin(3*theta)\"\nparameters = [\"a\", \"c\"]",
            "equation = \"torque\"\nexpression = \"(a + b*exp(-(w/9)^2))*sgn(w)\"\nparameters = [\"a\", \"b\"]",
            "equation = \"voltage\"\nexpression = \"a*sgn(i)*u\"\nparameters = [\"a\"]",
        ];
        let curves = [
            "equation = \"torque\"\naxis = \"speed_rad_s\"\nknots = [-200.0, -10.0, 0.0, 30.0]",
            "equation = \"voltage\"\naxis = \"current_a\"\nknots = [-9.0, 9.0]",
        ];
        let own = tables.map(|text| ("custom", text));
        let learned = curves.map(|text| ("table", text));
        for (id, text) in own.into_iter().chain(learned) {
            let (effect, _) = define(id, &text.parse().unwrap()).unwrap();
            let formulas = effect.formula().unwrap();
            proptest!(|((at, shares, x) in instants())| {
                check(effect, &formulas, &at, &shares, x);
            });
        }
        let turn = "equation = \"torque\"\naxis = \"angle_rad\"\nknots = [1.0, 2.0]";
        let (effect, _) = define("table", &turn.parse().unwrap()).unwrap();
        assert!(
            effect.formula().is_none(),
            "a curve that closes over a turn"
        );
    }
}
