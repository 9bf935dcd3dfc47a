//! Slopes of a run's innovations over what is free in its model: tangents along the run where they hold, without a simulation.

use super::tangent::{Tangent, Wave};
use crate::numerics::statistics::median;
use crate::plant::{Effect, Input, Model, ParameterSpec, Path, Scenario};

/// Share of the armature's time constant up to which a current's rate counts as the same over an interval between samples.
const SHORT_SHARE: f64 = 0.5;

/// Whether tangents are slopes of the whole model: what lies between motion and measurement, a second inertia and a current
/// that settles between two samples are none of theirs.
pub(super) fn are_tangents(model: &Model, scenario: &Scenario) -> bool {
    let path = path_of(model);
    let lags_s = path.speed_delay_s + path.speed_filter_s + path.current_filter_s;
    let effects = model.effects.iter();
    let mut terms = effects.map(|active| active.effect.terms(&active.values_or_guess()));
    lags_s <= 0.0 && terms.all(|terms| terms.coupling().is_none()) && is_short(model, scenario)
}

fn path_of(model: &Model) -> Path {
    let effects = model.effects.iter();
    effects.fold(Path::default(), |path, active| {
        path.plus(active.effect.terms(&active.values_or_guess()).path())
    })
}

fn only_offsets(path: Path) -> bool {
    let Path {
        current_offset_a,
        speed_offset_rad_s,
        ..
    } = path;
    let offsets = Path {
        current_offset_a,
        speed_offset_rad_s,
        ..Path::default()
    };
    path == offsets
}

fn is_short(model: &Model, scenario: &Scenario) -> bool {
    if scenario.input != Input::Voltage {
        return true;
    }
    let times = scenario.sample_time_s.windows(2);
    let interval_s = median(&times.map(|pair| pair[1] - pair[0]).collect::<Vec<_>>());
    let constant_s = model.motor.electrical_time_constant_s();
    constant_s.is_some_and(|constant_s| interval_s < SHORT_SHARE * constant_s)
}

/// The slope over a parameter of an effect with these values, for each `unit` of a coefficient; of a shape from a step of
/// `step`, which is `over` of its units. `None` where the effect remembers.
pub(super) fn of_effect(
    effect: &'static dyn Effect,
    values: &[f64],
    index: usize,
    unit: f64,
    (step, over): (f64, f64),
) -> Option<Tangent> {
    let specs = effect.parameters();
    if specs[index].is_coefficient() {
        let mut alone = values.to_vec();
        let coefficients = alone.iter_mut().zip(specs);
        for (value, _) in coefficients.filter(|(_, spec)| spec.is_coefficient()) {
            *value = 0.0;
        }
        alone[index] = unit;
        let late_s = effect.terms(&alone).path().command_delay_s;
        if late_s > 0.0 {
            return Some(Tangent::LateCommands(late_s));
        }
        return alone_at(effect, &alone, index);
    }
    let mut moved = values.to_vec();
    moved[index] += step;
    let (from, to) = (effect.terms(values), effect.terms(&moved));
    let is_wave = wave_of_current(effect).is_some();
    let acts_on_path = from.path() != Path::default();
    (from.states() == 0 && !is_wave && !acts_on_path).then_some(Tangent::Change { from, to, over })
}

/// Whether the effect is a wave over the angle, and then whether in proportion to the current.
fn wave_of_current(effect: &dyn Effect) -> Option<bool> {
    match effect.card().id {
        "cogging" => Some(false),
        "torque_ripple" => Some(true),
        _ => None,
    }
}

/// What one coefficient of an effect does by itself, all others at zero; `None` where that is no small forcing.
pub(super) fn alone_at(
    effect: &'static dyn Effect,
    values: &[f64],
    index: usize,
) -> Option<Tangent> {
    if let Some(of_current) = wave_of_current(effect) {
        let order = effect.parameters().iter().position(is_order)?;
        return Some(Tangent::Wave(Wave {
            order: values[order],
            sine: index == 0,
            size: values[index],
            of_current,
        }));
    }
    let terms = effect.terms(values);
    let path = terms.path();
    if path.measures_directly() && !path.delays_command() && terms.coupling().is_none() {
        return Some(Tangent::Terms(terms));
    }
    only_offsets(path).then_some(Tangent::Offset([
        path.current_offset_a,
        path.speed_offset_rad_s,
    ]))
}

fn is_order(spec: &ParameterSpec) -> bool {
    spec.key == "order"
}
