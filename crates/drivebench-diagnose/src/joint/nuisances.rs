//! Nuisance parameters of the regression: the motor's parameters, errors of the time stamps and errors of the forms of the model's
//! effects; and unknown functions of torque and voltage over speed, angle and current.

use std::mem::{self, Discriminant};

use nalgebra::DVector;

use super::columns::columns_of;
use super::memory::torque_over_the_past;
use super::process_noise::{constants, terms_of};
use super::regression::{Column, Form, Part, SLAB, Source};
use super::run::LinearisedRun;
use super::tangent::{Tangent, Wave, are_tangents};
use drivebench_model::numerics::statistics::largest;
use drivebench_model::plant::effect::{Axis, Harmonic, TermKind};
use drivebench_model::plant::{
    ActiveEffect, Effect, Enters, Input, Instant, Model, MotorKey, ParameterSpec, Scenario, Slot,
    Terms, typical_size,
};

/// Prior deviation of the logarithm of a motor's parameter.
const MOTOR_LOG_SIGMA: f64 = 0.3;
/// Standard deviation of an error of form as a regressor, as a share of the effect: harmonics, and powers of its own size.
const FORM_SD: f64 = 0.1;
/// The part of the largest current at which a level counts as reached.
const SMALL_SHARE: f64 = 0.1;

/// Prior deviation of a motor's parameter.
pub(super) enum MotorPrior {
    Logarithm(f64),
    /// Of the value itself.
    Linear(f64),
}

/// `None` for a parameter that the run leaves undetermined. Where a torque drives, friction starts from a balance that lacks
/// the missing effect, so that it may be off by its slab.
pub(super) fn motor_prior(key: MotorKey, model: &Model, scenario: &Scenario) -> Option<MotorPrior> {
    if scenario.input == Input::Voltage {
        return Some(MotorPrior::Logarithm(MOTOR_LOG_SIGMA));
    }
    match key {
        MotorKey::Inertia => Some(MotorPrior::Logarithm(MOTOR_LOG_SIGMA)),
        MotorKey::LoadTorque => {
            let constant = TermKind::TorqueOffset.effect();
            let slab = SLAB * typical_size(constant, 0, model, scenario);
            let own = MOTOR_LOG_SIGMA * model.motor.get(key)?;
            Some(MotorPrior::Linear(slab.max(own)))
        }
        _ => None,
    }
}

/// The column of a free parameter of the motor among the nuisances.
pub(super) fn column_of(key: MotorKey, model: &Model, scenario: &Scenario) -> Option<usize> {
    let mut own = model.free_slots().into_iter().filter(|slot| match slot {
        Slot::Motor(key) => motor_prior(*key, model, scenario).is_some(),
        Slot::Effect { .. } => false,
    });
    own.position(|slot| matches!(slot, Slot::Motor(own) if own == key))
}

/// The nuisances that are always included: the motor's parameters, and one error each of the stamps of command, current and speed,
/// equal for all samples; with their prior deviations.
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
            MotorPrior::Logarithm(sd) => (value, 2e-3, sd),
            MotorPrior::Linear(unit) => (unit, 0.02, 1.0),
        };
        let source = if along {
            Source::Tangent(Tangent::Motor(key, unit))
        } else {
            let mut moved = model.clone();
            moved.set(&slot, value + step * unit);
            Source::difference(moved, step)
        };
        nuisances.push((source, sd));
    }
    nuisances.extend(stamps(model, scenario).map(|source| (source, 1.0)));
    Some(nuisances)
}

/// Errors of the stamps of command, current and speed, at one standard deviation each.
fn stamps(model: &Model, scenario: &Scenario) -> impl Iterator<Item = Source> {
    let by_voltage = scenario.input == Input::Voltage;
    let along = are_tangents(model, scenario);
    let late = [TermKind::LateCommand, TermKind::LateCurrent, TermKind::LateSpeed];
    let count = if by_voltage { late.len() } else { 1 };
    let period_s = scenario.mean_period_s();
    let half_width_s = scenario.typical_half_width_s();
    let of_samples_s = half_width_s.map(|half| half / 3f64.sqrt());
    let is_sampled = scenario.has_sampled_input();
    let of_commands_s = scenario.input_delay_s().map(|(_, deviation)| deviation);
    late.into_iter().take(count).map(move |kind| {
        let is_command = kind == TermKind::LateCommand;
        let known_s = if is_command { of_commands_s } else { of_samples_s };
        let least_periods = match known_s {
            // A torque may be that of any instant of its period.
            _ if !by_voltage => 1.0,
            // What the estimates of its instants have in common.
            _ if is_command && is_sampled => 0.05,
            // Stamped by the drive.
            None => 0.01,
            Some(_) => 0.05,
        };
        let error_s = (least_periods * period_s).max(known_s.unwrap_or(0.0));
        if along {
            return Source::Tangent(match kind {
                TermKind::LateCommand => Tangent::CommandDelay(error_s),
                TermKind::LateCurrent => Tangent::ReadingDelay([error_s, 0.0]),
                _ => Tangent::ReadingDelay([0.0, error_s]),
            });
        }
        let effect = kind.effect();
        let mut moved = model.clone();
        match moved.effects.iter_mut().find(|active| active.id() == kind.id()) {
            Some(active) => active.values = vec![Some(active.values_or_guess()[0] + error_s)],
            None => moved.effects.push(ActiveEffect::with(effect, &[error_s])),
        }
        Source::difference(moved, 1.0)
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

/// Errors of the time stamps and of the forms of the effects of a run's model, as columns at one standard deviation each. Which forms
/// an effect has depends on the run.
pub(super) fn of_equations(run: &LinearisedRun<'_>) -> Vec<(ErrorOf, Vec<f32>)> {
    let of_effects = run.model.effects.iter().enumerate();
    let forms = of_effects.flat_map(|(number, active)| {
        let values = active.values_or_guess();
        let forms = bends(&run.model, active.effect, &values, run.scenario);
        forms.into_iter().map(move |form| (Some(number), Source::Tangent(form)))
    });
    let stamps = stamps(&run.model, run.scenario).map(|stamp| (None, stamp));
    let (mut errors, mut sources): (Vec<ErrorOf>, Vec<Source>) = (vec![], vec![]);
    for (effect, source) in stamps.chain(forms) {
        let kind = effect.and(source.tangent(0)).map(mem::discriminant);
        let same = |own: &&ErrorOf| (own.effect, own.kind) == (effect, kind);
        let number = errors.iter().filter(same).count();
        errors.push(ErrorOf { effect, kind, number });
        sources.push(source);
    }
    let sources: Vec<&Source> = sources.iter().collect();
    let whitened = columns_of(&sources, std::slice::from_ref(run)).into_iter();
    errors.into_iter().zip(whitened.flat_map(|whitened| whitened.columns)).collect()
}

/// Voltages of terms at a small part of the run's largest current and at that current, and that part of it, A.
fn small_and_most_v(terms: &dyn Terms, scenario: &Scenario) -> ([f64; 2], f64) {
    let most_a = largest(scenario.current_a.iter().copied());
    let voltage_at = |current_a: f64| {
        let at = Instant { current_a, ..Instant::default().in_run(scenario) };
        terms.voltage_v(&at, &[]).abs()
    };
    ([SMALL_SHARE * most_a, most_a].map(voltage_at), SMALL_SHARE * most_a)
}

/// Whether terms have reached 0.99 of their level at a tenth of the run's largest current, as a brush drop: how they build up below
/// is no part of their equation.
fn has_a_level(terms: &dyn Terms, scenario: &Scenario) -> bool {
    let ([small_v, most_v], _) = small_and_most_v(terms, scenario);
    most_v > 0.0 && small_v > 0.99 * most_v
}

/// Whether terms act on the supply side of the chopper: there the current is the motor's times the duty cycle, and a capacitor delays
/// the voltage.
fn is_before_the_chopper(terms: &dyn Terms, motor: &Instant) -> bool {
    let drop_at = |voltage_v: f64| {
        let at = Instant { current_a: 1.0, voltage_v, ..*motor };
        terms.voltage_v(&at, &[])
    };
    (drop_at(motor.supply_v) - drop_at(0.0)).abs() > 0.0
}

/// Error of the motor's resistance, ohm, by effects that act as a resistance at small currents (discontinuous conduction): the form of
/// their end is not known.
pub(super) fn left_beyond_ohm(model: &Model, scenario: &Scenario) -> f64 {
    let left = model.effects.iter().map(|active| {
        let terms = terms_of(active);
        // What has a state does not depend on the current alone.
        if terms.states() > 0 {
            return 0.0;
        }
        let ([small_v, _], small_a) = small_and_most_v(&*terms, scenario);
        if small_v > 0.0 && !has_a_level(&*terms, scenario) {
            FORM_SD * small_v / small_a
        } else {
            0.0
        }
    });
    left.map(|ohm| ohm * ohm).sum::<f64>().sqrt()
}

/// Errors of the form of an effect of the model, each at one standard deviation.
pub(super) fn bends(
    model: &Model,
    effect: &'static dyn Effect,
    values: &[f64],
    scenario: &Scenario,
) -> Vec<Tangent> {
    let specs = effect.parameters();
    let terms = effect.terms(values);
    let path = terms.path();
    if effect.card().needs_angle {
        let pairs = || specs.iter().zip(values);
        let sizes = pairs().filter(|(spec, _)| spec.is_coefficient());
        let amplitude = sizes.map(|(_, value)| value * value).sum::<f64>().sqrt();
        let order = pairs().find(|(spec, _)| spec.key == "order").map_or(1.0, |(_, order)| *order);
        // What is in proportion to the current is so in any form.
        let of_current = effect.card().harmonic == Some(Harmonic::OfCurrent);
        let harmonics = [(2.0, true), (2.0, false), (3.0, true), (3.0, false)];
        return Vec::from(harmonics.map(|(harmonic, sine)| {
            Tangent::Wave(Wave {
                order: harmonic * order,
                sine,
                size: FORM_SD * amplitude,
                of_current,
            })
        }));
    }
    if terms.coupling().is_some() {
        return vec![];
    }
    if terms.states() > 0 && effect.card().enters == Enters::Voltage {
        return vec![Tangent::Terms(Box::new(HotCopper(terms)))];
    }
    let mut bends = Vec::new();
    if path.measures_directly() && !path.delays_command() {
        // What stands at its level is the same to any power.
        if !has_a_level(&*terms, scenario) {
            bends.extend([1.0, 2.0].map(|power| Tangent::Power {
                terms: effect.terms(values),
                power,
                share: FORM_SD,
            }));
        } else if specs.iter().all(ParameterSpec::is_coefficient) {
            // Half of it may build up more slowly.
            bends.extend([2.0, 4.0, 8.0].map(|factor| Tangent::Stretched {
                terms: effect.terms(values),
                factor,
                share: 0.5,
            }));
        }
        if is_before_the_chopper(&*terms, &constants(model, scenario)) {
            // The capacitor of the intermediate circuit with the resistance of what feeds it.
            bends.extend([0.025, 0.1].map(|responses| Tangent::Lagging {
                terms: effect.terms(values),
                time_constant_s: scenario.scales.responses(responses),
            }));
        }
        // Where a torque drives, errors of friction and of the torque are process noise already.
        if scenario.input == Input::Voltage {
            bends.extend(spread(effect, values));
        }
    }
    bends
}

/// Second-order term of winding heating, half of the rise squared: hotter copper has more loss.
struct HotCopper(Box<dyn Terms>);

impl Terms for HotCopper {
    fn voltage_v(&self, at: &Instant, own: &[f64]) -> f64 {
        let cold = Instant { current_a: 1.0, resistance_ohm: 1.0, ..Instant::default() };
        0.5 * self.0.voltage_v(&cold, own) * self.0.voltage_v(at, own)
    }

    fn states(&self) -> usize {
        self.0.states()
    }

    fn derivative(&self, at: &Instant, own: &[f64], out: &mut [f64]) {
        self.0.derivative(at, own, out);
    }
}

/// Errors of form: a quarter of the effect with half and with twice its shape parameters.
fn spread(effect: &'static dyn Effect, values: &[f64]) -> impl Iterator<Item = Tangent> {
    let specs = effect.parameters();
    let shapes = (0..specs.len()).filter(|k| specs[*k].logarithmic && !specs[*k].is_coefficient());
    shapes.flat_map(move |shape| {
        [0.5, 2.0].map(|factor| {
            let mut other = values.to_vec();
            other[shape] *= factor;
            Tangent::Change { from: effect.terms(values), to: effect.terms(&other), over: 4.0 }
        })
    })
}

/// Functions of torque over the speed, each of this size, orthogonal (Gram-Schmidt) to those of the catalogue: constant, viscous,
/// asymmetric, quadratic and Coulomb.
fn beyond_the_catalogue(most: f64, size: f64) -> Vec<Tangent> {
    const KNOTS: usize = 13;
    let at = |knot: usize| 2.0 * knot as f64 / (KNOTS - 1) as f64 - 1.0;
    let sign = |x: f64| if x == 0.0 { 0.0 } else { x.signum() };
    let shapes: [fn(f64) -> f64; 5] = [|_| 1.0, |x| x, f64::abs, |x| x * x.abs(), sign];
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

/// Unknown functions of torque and voltage as candidates.
pub(super) fn unknown_curves(runs: &[LinearisedRun<'_>]) -> Vec<Part> {
    let run = &runs[0];
    let by_voltage = run.scenario.input == Input::Voltage;
    let most = |k: usize| largest(run.filtered.after.iter().map(|state| state[k]));
    let (current, speed) = (most(0), most(1));
    let share = if by_voltage { 0.06 } else { 0.03 };
    let torque = share * constants(&run.model, run.scenario).torque_n_m_per_a * current;
    let volts = 0.06 * largest(run.scenario.events.iter().map(|event| event.1));
    let part = |id: &'static str, curves: Vec<Tangent>| {
        // A prior probability of 0.01.
        let mut part = Part::named(id, None, -4.605_170_185_988_091);
        let mut form = Form::new(vec![], 0.0);
        for curve in curves {
            form.column(Source::Tangent(curve), Column::of(None, 1.0, 0.0));
        }
        part.push(form);
        part
    };
    let hats = |axis: Axis, count: i32, most: f64, size: f64| -> Vec<Tangent> {
        let width = 2.0 * most / f64::from(count - 1);
        let hat = |k| Tangent::Hat { axis, centre: width * f64::from(k) - most, width, size };
        (0..count).map(hat).collect()
    };
    let wave = |order: i32, sine: bool| {
        Tangent::Wave(Wave { order: f64::from(order), sine, size: torque, of_current: false })
    };
    let over_speed = if by_voltage {
        hats(Axis::Speed, 11, speed, torque)
    } else {
        beyond_the_catalogue(speed, torque)
    };
    let waves = (1..=6).flat_map(|order| [true, false].map(|sine| wave(order, sine)));
    let mut parts =
        vec![part("torque over speed", over_speed), part("torque over angle", waves.collect())];
    if by_voltage {
        let volts = hats(Axis::Current, 7, current, volts);
        parts.push(part("voltage over current", volts));
        // A shaft that rests has no past.
        if speed > 0.0 {
            let past = torque_over_the_past(run.scenario, speed, torque);
            parts.push(part("torque over past speed", past));
        }
    }
    parts
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kit::{nameplate, record, truth};
    use drivebench_model::plant::effect::CATALOGUE;

    #[test]
    fn only_gaps_of_the_current_leave_a_resistance_beyond() {
        let run = record(&nameplate(), 0, 7);
        for effect in CATALOGUE {
            let model = nameplate().with_effect(effect.card().id).unwrap();
            assert!(left_beyond_ohm(&model, &run) <= 0.0, "{}", effect.card().id);
        }
        let gaps = truth("discontinuous_conduction", &[1.4, 20.0]);
        assert!((left_beyond_ohm(&gaps, &run) / (0.1 * 1.4) - 1.0).abs() < 1e-9);
    }

    #[test]
    fn forms_differ_by_lag_shape_and_warming_where_they_can() {
        let run = record(&nameplate(), 0, 7);
        let cases: [(&str, &[f64], [usize; 3]); 6] = [
            ("supply_sag", &[0.4], [2, 0, 0]),
            ("voltage_drop", &[1.0], [0, 0, 0]),
            ("stribeck_friction", &[0.1, 10.0], [0, 2, 0]),
            ("discontinuous_conduction", &[1.0, 2.0], [0, 2, 0]),
            ("winding_heating", &[1e-3, 20.0], [0, 0, 1]),
            ("lagged_load", &[2e-6, 0.3], [0, 2, 0]),
        ];
        for (id, values, expected) in cases {
            let model = truth(id, values);
            let mut found = [0; 3];
            for form in bends(&model, model.effects[0].effect, values, &run) {
                match form {
                    Tangent::Lagging { .. } => found[0] += 1,
                    Tangent::Change { .. } => found[1] += 1,
                    Tangent::Terms(_) => found[2] += 1,
                    _ => {}
                }
            }
            assert_eq!(found, expected, "{id}");
        }
    }

    #[test]
    fn hot_copper_adds_half_the_square_of_its_rise() {
        let model = truth("winding_heating", &[1e-3, 20.0]);
        let terms = model.effects[0].effect.terms(&[1e-3, 20.0]);
        let at = Instant { current_a: 5.0, resistance_ohm: 2.0, ..Instant::default() };
        // A rise of a tenth, of ten volts.
        let hot = HotCopper(terms);
        assert!((hot.voltage_v(&at, &[100.0]) - 0.05).abs() < 1e-12);
    }
}
