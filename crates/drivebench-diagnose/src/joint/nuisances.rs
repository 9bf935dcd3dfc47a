//! Nuisance parameters beside the effects of the catalogue: always the motor's parameters, errors of the stamps, other forms of the
//! model's effects; and curves of torque and voltage that no effect gives, where what is left goes by what it follows.

use std::mem::{self, Discriminant};

use nalgebra::DVector;

use super::acting::constants;
use super::columns::{Column, Form, LinearisedRun, Part, SLAB, Source, columns_of};
use super::tangent::{Tangent, Wave, are_tangents};
use drivebench_model::numerics::statistics::largest;
use drivebench_model::plant::effect::{Axis, Harmonic, TermKind};
use drivebench_model::plant::{
    ActiveEffect, Effect, Input, Instant, Model, MotorKey, ParameterSpec, Scenario, Slot, Terms,
    typical_size,
};

/// Prior standard deviation of the logarithm of a motor's parameter.
const MOTOR_LOG_SIGMA: f64 = 0.3;
/// Step of a difference of two runs with a motor's parameter, relative.
const STEP: f64 = 2e-3;
/// The same in standard deviations beforehand.
const LINEAR_STEP: f64 = 0.02;
/// Error of the stamps of commands and samples beforehand, as a share of the period: where the host stamped them, and where
/// the drive did.
const STAMP_SHARE: f64 = 0.05;
const OWN_STAMP_SHARE: f64 = 0.01;
/// What the form of an effect may differ from its equation by.
const FORM_SHARE: f64 = 0.1;
/// Powers of its own size that its form may have beside itself.
const POWERS: [f64; 2] = [1.0, 2.0];
/// By what factor the shapes of what an effect is made of may differ from the one that its equation has, either way, and how
/// much of it may have another shape.
const SPREAD_RATIO: f64 = 2.0;
const SHARE_OF_SPREAD: f64 = 0.25;
/// How many times more slowly than in its equation what has reached its level may build up, and how much of it may.
const SLOWER: [f64; 3] = [2.0, 4.0, 8.0];
const SLOW_SHARE: f64 = 0.5;
/// Time constants of the intermediate circuit's capacitor with the resistance of what feeds it, s.
const CAPACITOR_S: [f64; 2] = [1e-3, 4e-3];
/// Share of its level from which on it has been reached, and the share of the largest current where it has.
const REACHED_SHARE: f64 = 0.99;
const SMALL_SHARE: f64 = 0.1;

/// What is known of a motor's parameter beforehand.
pub(super) enum MotorPrior {
    /// Of the logarithm: its standard deviation.
    Logarithm(f64),
    /// Of the value itself.
    Linear(f64),
}

/// `None` for a parameter that the run says nothing of. Where a torque drives, friction starts from a balance that lacks
/// what is missing, so that it may be off by an effect's slab.
pub(super) fn motor_prior(key: MotorKey, model: &Model, scenario: &Scenario) -> Option<MotorPrior> {
    if scenario.input == Input::Voltage {
        return Some(MotorPrior::Logarithm(MOTOR_LOG_SIGMA));
    }
    match key {
        MotorKey::Inertia => Some(MotorPrior::Logarithm(MOTOR_LOG_SIGMA)),
        MotorKey::LoadTorque => {
            let constant = TermKind::TorqueOffset.effect();
            let slab = SLAB * typical_size(constant, 0, model, scenario);
            Some(MotorPrior::Linear(
                slab.max(MOTOR_LOG_SIGMA * model.motor.get(key)?),
            ))
        }
        _ => None,
    }
}

/// What is always in: the motor's parameters, and what the stamps of command, current and speed may be wrong by, for all
/// samples alike; each with its standard deviation beforehand.
pub(super) fn nuisances(model: &Model, scenario: &Scenario) -> Option<Vec<(Source, f64)>> {
    let along = are_tangents(model, scenario);
    let mut nuisances = Vec::new();
    for slot in model.free_slots() {
        let Slot::Motor(key) = slot else { continue };
        let Some(prior) = motor_prior(key, model, scenario) else {
            continue;
        };
        let value = model.get(&slot)?;
        let (unit, step, sd) = match prior {
            MotorPrior::Logarithm(sd) => (value, STEP, sd),
            MotorPrior::Linear(unit) => (unit, LINEAR_STEP, 1.0),
        };
        let source = if along {
            Source::Tangent(Tangent::Motor(key, unit))
        } else {
            let mut moved = model.clone();
            moved.set(&slot, value + step * unit);
            Source::Difference { model: moved, step }
        };
        nuisances.push((source, sd));
    }
    nuisances.extend(stamps(model, scenario).map(|source| (source, 1.0)));
    Some(nuisances)
}

/// What the stamps of command, current and speed may be wrong by, at one standard deviation each.
fn stamps(model: &Model, scenario: &Scenario) -> impl Iterator<Item = Source> {
    let by_voltage = scenario.input == Input::Voltage;
    let along = by_voltage && are_tangents(model, scenario);
    let late = [
        TermKind::LateCommand,
        TermKind::LateCurrent,
        TermKind::LateSpeed,
    ];
    let count = if by_voltage { late.len() } else { 1 };
    let period_s = scenario.mean_period_s();
    let half_width_s = scenario.typical_half_width_s();
    let of_samples_s = half_width_s.map(|half| half / 3f64.sqrt());
    let of_commands_s = scenario.input_delay_s().map(|(_, deviation)| deviation);
    late.into_iter().take(count).map(move |kind| {
        let is_command = kind == TermKind::LateCommand;
        let known_s = if is_command {
            of_commands_s
        } else {
            of_samples_s
        };
        // Of a torque nobody knows where in its period it stands.
        let least_s = match known_s {
            _ if !by_voltage => period_s,
            None => OWN_STAMP_SHARE * period_s,
            Some(_) => STAMP_SHARE * period_s,
        };
        let error_s = least_s.max(known_s.unwrap_or(0.0));
        if along {
            return Source::Tangent(match kind {
                TermKind::LateCommand => Tangent::LateCommands(error_s),
                TermKind::LateCurrent => Tangent::LateReadings([error_s, 0.0]),
                _ => Tangent::LateReadings([0.0, error_s]),
            });
        }
        let effect = kind.effect();
        let mut moved = model.clone();
        let mut own = moved.effects.iter_mut();
        match own.find(|active| active.id() == kind.id()) {
            Some(active) => active.values = vec![Some(active.values_or_guess()[0] + error_s)],
            None => moved.effects.push(ActiveEffect::with(effect, &[error_s])),
        }
        Source::Difference {
            model: moved,
            step: 1.0,
        }
    })
}

/// What a column is of: the error of one stamp, or of one form of an effect.
#[derive(Clone, Copy, PartialEq)]
pub(super) struct ErrorOf {
    /// The number of the effect; none of a stamp.
    pub(super) effect: Option<usize>,
    kind: Option<Discriminant<Tangent>>,
    /// Among those of the kind.
    number: usize,
}

/// What may be wrong with the equations of the model that a run is followed by, at one standard deviation each: its stamps,
/// and the forms of its effects. Which forms there are is a matter of the run.
pub(super) fn of_equations(run: &LinearisedRun<'_>) -> Vec<(ErrorOf, Vec<f32>)> {
    let of_effects = run.model.effects.iter().enumerate();
    let forms = of_effects.flat_map(|(number, active)| {
        let values = active.values_or_guess();
        let forms = bends(&run.model, active.effect, &values, run.scenario);
        forms.into_iter().map(move |form| (Some(number), form))
    });
    let stamps = stamps(&run.model, run.scenario).map(|stamp| (None, stamp));
    let mut errors: Vec<ErrorOf> = Vec::new();
    let mut sources = Vec::new();
    for (effect, source) in stamps.chain(forms) {
        let kind = effect.and(source.tangent(0)).map(mem::discriminant);
        let same = errors
            .iter()
            .filter(|own| (own.effect, own.kind) == (effect, kind));
        let number = same.count();
        errors.push(ErrorOf {
            effect,
            kind,
            number,
        });
        sources.push(source);
    }
    let sources: Vec<&Source> = sources.iter().collect();
    let columns = columns_of(&sources, std::slice::from_ref(run));
    let columns = columns.into_iter().flat_map(|whitened| whitened.columns);
    errors.into_iter().zip(columns).collect()
}

/// Voltages of terms at a small part of the run's largest current and at that current, and that part of it, A.
fn small_and_most_v(terms: &dyn Terms, scenario: &Scenario) -> ([f64; 2], f64) {
    let most_a = largest(scenario.current_a.iter().copied());
    let at = |current_a: f64| {
        let at = Instant {
            current_a,
            ..Instant::default()
        };
        terms.voltage_v(&at, &[]).abs()
    };
    ([SMALL_SHARE * most_a, most_a].map(at), SMALL_SHARE * most_a)
}

/// Whether terms have reached a level by a small part of the run's currents, as a drop of brushes: in what range they build
/// up is no part of their equation.
fn has_a_level(terms: &dyn Terms, scenario: &Scenario) -> bool {
    let ([small_v, most_v], _) = small_and_most_v(terms, scenario);
    most_v > 0.0 && small_v > REACHED_SHARE * most_v
}

/// Whether terms lie before the chopper, where a capacitor holds the voltage: the motor's current gets there by the duty.
fn is_before_the_chopper(terms: &dyn Terms, motor: &Instant) -> bool {
    let at = |voltage_v: f64| {
        let at = Instant {
            current_a: 1.0,
            voltage_v,
            ..*motor
        };
        terms.voltage_v(&at, &[])
    };
    (at(motor.supply_v) - at(0.0)).abs() > 0.0
}

/// What the model's effects that begin as a resistance and end, as gaps of the current do, may leave of it where they should
/// have ended, ohm: the motor's resistance is known no better than that.
pub(super) fn left_beyond_ohm(model: &Model, scenario: &Scenario) -> f64 {
    let left = model.effects.iter().map(|active| {
        let terms = active.effect.terms(&active.values_or_guess());
        // What has a state is no matter of the current alone.
        if terms.states() > 0 {
            return 0.0;
        }
        let ([small_v, _], small_a) = small_and_most_v(&*terms, scenario);
        if small_v > 0.0 && !has_a_level(&*terms, scenario) {
            FORM_SHARE * small_v / small_a
        } else {
            0.0
        }
    });
    left.map(|ohm| ohm * ohm).sum::<f64>().sqrt()
}

/// Other forms of an effect of the model, each at one standard deviation.
pub(super) fn bends(
    model: &Model,
    effect: &'static dyn Effect,
    values: &[f64],
    scenario: &Scenario,
) -> Vec<Source> {
    let mut bends = Vec::new();
    let specs = effect.parameters();
    let terms = effect.terms(values);
    let path = terms.path();
    if effect.card().needs_angle {
        let pairs = || specs.iter().zip(values);
        let sizes = pairs().filter(|(spec, _)| spec.is_coefficient());
        let amplitude = sizes.map(|(_, value)| value * value).sum::<f64>().sqrt();
        let order = pairs().find(|(spec, _)| spec.key == "order");
        let order = order.map_or(1.0, |(_, order)| *order);
        // What goes with the current does so in any form.
        let of_current = effect.card().harmonic == Some(Harmonic::OfCurrent);
        for harmonic in [2.0, 3.0] {
            for sine in [true, false] {
                let wave = Wave {
                    order: harmonic * order,
                    sine,
                    size: FORM_SHARE * amplitude,
                    of_current,
                };
                bends.push(Source::Tangent(Tangent::Wave(wave)));
            }
        }
    } else if terms.states() > 0 && terms.coupling().is_none() {
        let hot = HotCopper(effect.terms(values));
        bends.push(Source::Tangent(Tangent::Terms(Box::new(hot))));
    } else if terms.coupling().is_none() && path.measures_directly() && !path.delays_command() {
        let bent = |power| Tangent::Bent {
            terms: effect.terms(values),
            power,
            share: FORM_SHARE,
        };
        // What stands at its level is the same to any power.
        if !has_a_level(&*terms, scenario) {
            bends.extend(POWERS.map(bent).map(Source::Tangent));
        } else if specs.iter().all(ParameterSpec::is_coefficient) {
            let slow = |factor| Tangent::Slow {
                terms: effect.terms(values),
                factor,
                share: SLOW_SHARE,
            };
            bends.extend(SLOWER.map(slow).map(Source::Tangent));
        }
        if is_before_the_chopper(&*terms, &constants(model, scenario)) {
            let lagging = |time_constant_s| Tangent::Lagging {
                terms: effect.terms(values),
                time_constant_s,
            };
            bends.extend(CAPACITOR_S.map(lagging).map(Source::Tangent));
        }
        // Where a torque drives, what forms may be wrong by is random already: friction and the torque itself.
        if scenario.input == Input::Voltage {
            bends.extend(spread(effect, values).map(Source::Tangent));
        }
    }
    bends
}

/// What a resistance that rises does beside itself because copper that is hotter warms up faster: half of its rise squared.
struct HotCopper(Box<dyn Terms>);

impl Terms for HotCopper {
    fn voltage_v(&self, at: &Instant, own: &[f64]) -> f64 {
        let cold = Instant {
            current_a: 1.0,
            resistance_ohm: 1.0,
            ..Instant::default()
        };
        0.5 * self.0.voltage_v(&cold, own) * self.0.voltage_v(at, own)
    }

    fn states(&self) -> usize {
        self.0.states()
    }

    fn derivative(&self, at: &Instant, own: &[f64], out: &mut [f64]) {
        self.0.derivative(at, own, out);
    }
}

/// Parts of an effect whose shapes are others than that of its equation: a corner that is a bend, a peak with long tails.
fn spread(effect: &'static dyn Effect, values: &[f64]) -> impl Iterator<Item = Tangent> {
    let specs = effect.parameters();
    let shapes = (0..specs.len()).filter(|k| specs[*k].logarithmic && !specs[*k].is_coefficient());
    shapes.flat_map(move |shape| {
        [1.0 / SPREAD_RATIO, SPREAD_RATIO].map(|factor| {
            let mut other = values.to_vec();
            other[shape] *= factor;
            Tangent::Change {
                from: effect.terms(values),
                to: effect.terms(&other),
                over: 1.0 / SHARE_OF_SPREAD,
            }
        })
    })
}

/// Log of the odds of an unknown curve beforehand.
const LOG_ODDS_UNKNOWN: f64 = -4.605_170_185_988_091;

/// Torque as a function of the speed that friction, drag and load of the catalogue are no part of, each of this size: what
/// a run that a torque drives is made of is theirs first.
fn beyond_the_catalogue(most: f64, size: f64) -> Vec<Tangent> {
    const KNOTS: usize = 13;
    let at = |knot: usize| 2.0 * knot as f64 / (KNOTS - 1) as f64 - 1.0;
    let shapes: [fn(f64) -> f64; 5] = [
        |_| 1.0,
        |x| x,
        f64::abs,
        |x| x * x.abs(),
        |x| {
            if x == 0.0 { 0.0 } else { x.signum() }
        },
    ];
    let mut basis: Vec<DVector<f64>> = Vec::new();
    let hats =
        (0..KNOTS).map(|knot| DVector::from_fn(KNOTS, |k, _| f64::from(u8::from(k == knot))));
    let shapes = shapes.map(|shape| DVector::from_fn(KNOTS, |k, _| shape(at(k))));
    for vector in shapes.into_iter().chain(hats) {
        let mut left = vector.clone();
        for known in &basis {
            left -= known * known.dot(&left);
        }
        if basis.len() < KNOTS && left.norm() > 0.1 * vector.norm() {
            basis.push(left.normalize());
        }
    }
    let curve = |curve: DVector<f64>| Tangent::Curve {
        most,
        values: (curve * size).iter().copied().collect(),
    };
    basis.into_iter().skip(5).map(curve).collect()
}

/// Torque and voltage as functions that no effect of the catalogue gives.
pub(super) fn unknown_curves(runs: &[LinearisedRun<'_>]) -> Vec<Part> {
    let run = &runs[0];
    let by_voltage = run.scenario.input == Input::Voltage;
    let most = |k: usize| largest(run.followed.after.iter().map(|state| state[k]));
    let (current, speed) = (most(0), most(1));
    let share = if by_voltage { 0.06 } else { 0.03 };
    let torque = share * constants(&run.model, run.scenario).torque_n_m_per_a * current;
    let volts = 0.06 * largest(run.scenario.events.iter().map(|event| event.1));
    let part = |id: &'static str, curves: Vec<Tangent>| {
        let mut part = Part::named(id, None, LOG_ODDS_UNKNOWN);
        let mut form = Form::new(vec![], 0.0);
        for curve in curves {
            form.column(Source::Tangent(curve), Column::of(None, 1.0, 0.0));
        }
        part.push(form);
        part
    };
    let hats = |axis: Axis, count: i32, most: f64, size: f64| -> Vec<Tangent> {
        let width = 2.0 * most / f64::from(count - 1);
        let hat = |k| Tangent::Hat {
            axis,
            centre: width * f64::from(k) - most,
            width,
            size,
        };
        (0..count).map(hat).collect()
    };
    let wave = |order: i32, sine: bool| {
        Tangent::Wave(Wave {
            order: f64::from(order),
            sine,
            size: torque,
            of_current: false,
        })
    };
    let over_speed = if by_voltage {
        hats(Axis::Speed, 11, speed, torque)
    } else {
        beyond_the_catalogue(speed, torque)
    };
    let waves = (1..=6).flat_map(|order| [true, false].map(|sine| wave(order, sine)));
    let mut parts = vec![
        part("torque over speed", over_speed),
        part("torque over angle", waves.collect()),
    ];
    if by_voltage {
        let volts = hats(Axis::Current, 7, current, volts);
        parts.push(part("voltage over current", volts));
    }
    parts
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kit::{nameplate, record, truth};
    use drivebench_model::plant::effect::CATALOGUE;

    #[test]
    fn only_gaps_of_the_current_leave_something_of_a_resistance_beyond() {
        let run = record(&nameplate(), 0, 7);
        let left = |model: &Model| left_beyond_ohm(model, &run);
        for effect in CATALOGUE {
            let model = nameplate().with_effect(effect.card().id).unwrap();
            assert!(left(&model) <= 0.0, "{}", effect.card().id);
        }
        let gaps = truth("discontinuous_conduction", &[1.4, 20.0]);
        assert!((left(&gaps) / (0.1 * 1.4) - 1.0).abs() < 1e-9);
    }

    #[test]
    fn forms_are_spread_lag_behind_a_capacitor_and_warm_up_faster_where_they_can() {
        let run = record(&nameplate(), 0, 7);
        let counted = |id: &str, values: &[f64]| {
            let model = truth(id, values);
            let forms = bends(&model, model.effects[0].effect, values, &run);
            let is = |of: fn(&Tangent) -> bool| {
                let tangents = forms.iter().filter_map(|form| form.tangent(0));
                tangents.filter(|tangent| of(tangent)).count()
            };
            [
                is(|tangent| matches!(tangent, Tangent::Lagging { .. })),
                is(|tangent| matches!(tangent, Tangent::Change { .. })),
                is(|tangent| matches!(tangent, Tangent::Terms(_))),
            ]
        };
        assert_eq!(counted("supply_sag", &[0.4]), [2, 0, 0]);
        assert_eq!(counted("voltage_drop", &[1.0]), [0, 0, 0]);
        assert_eq!(counted("stribeck_friction", &[0.1, 10.0]), [0, 2, 0]);
        assert_eq!(counted("discontinuous_conduction", &[1.0, 2.0]), [0, 2, 0]);
        assert_eq!(counted("winding_heating", &[1e-3, 20.0]), [0, 0, 1]);
    }

    #[test]
    fn hot_copper_adds_half_the_square_of_its_rise() {
        let model = truth("winding_heating", &[1e-3, 20.0]);
        let terms = model.effects[0].effect.terms(&[1e-3, 20.0]);
        let at = Instant {
            current_a: 5.0,
            resistance_ohm: 2.0,
            ..Instant::default()
        };
        // A rise of a tenth, of ten volts.
        let hot = HotCopper(terms);
        assert!((hot.voltage_v(&at, &[100.0]) - 0.05).abs() < 1e-12);
    }
}
