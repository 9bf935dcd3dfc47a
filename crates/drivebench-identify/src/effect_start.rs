//! Starting values of a fit by a grid search over the order, shape or event time of an effect.
//!
//! The cost is nearly quadratic in a coefficient, but has local minima over an integer order or an event time. So the values of
//! a grid are compared first by a score test: the residual of the model without the effect is regressed on the sensitivities of
//! the motor's parameters and of the effect's coefficients; fits start at the values that explain most.

use nalgebra::{DMatrix, DVector};

use super::noise::NoiseFloor;
use super::output_error::{self, FitError, FreeRun, cannot_simulate};
use drivebench_model::numerics::least_squares;
use drivebench_model::plant::{
    ActiveEffect, Model, ParameterRole, ParameterSpec, Scenario, typical_size,
};

/// Models to start from, the best first.
#[derive(Clone, Debug)]
pub struct Starts {
    pub models: Vec<Model>,
    /// Parameters chosen from a grid: `(key, reason to doubt it)`.
    pub chosen: Vec<(String, Option<String>)>,
}

/// Searches the grids of `model`, whose motor values are all given. Given values stay, except event times, which differ from run to
/// run, unless they are fixed.
pub fn scan(model: &Model, scenario: &Scenario, noise: &NoiseFloor) -> Result<Starts, FitError> {
    let mut starts = Starts { models: vec![model.clone()], chosen: Vec::new() };
    let has_grid = |active: &&ActiveEffect| {
        (0..active.values.len()).any(|index| is_searched(model, active, index))
    };
    let searched: Vec<&ActiveEffect> = model.effects.iter().filter(has_grid).collect();
    if searched.is_empty() {
        return Ok(starts);
    }
    let mut known = model.clone();
    (known.effects).retain(|active| searched.iter().all(|other| other.id() != active.id()));
    let prefixes: Vec<String> = searched.iter().map(|e| format!("{}.", e.id())).collect();
    (known.fixed).retain(|key| !prefixes.iter().any(|prefix| key.starts_with(prefix)));
    for active in searched {
        let tried = Trial::new(&known, scenario, noise)?.all(model, active)?;
        let Some(best) = tried.first() else { return Err(cannot_simulate(scenario)) };
        starts.chosen.extend(choices(active, &tried));
        known.effects.push(best.active.clone());
        for start in &mut starts.models {
            put(start, &best.active);
        }
        // Further starts only for the last effect, so that their number does not multiply.
        starts.models.truncate(1);
        for other in tried.iter().skip(1).take(2) {
            let mut start = starts.models[0].clone();
            put(&mut start, &other.active);
            starts.models.push(start);
        }
    }
    Ok(starts)
}

fn is_searched(model: &Model, active: &ActiveEffect, index: usize) -> bool {
    let is_open = active.values[index].is_none();
    match active.effect.parameters()[index].role {
        ParameterRole::Coefficient => false,
        ParameterRole::Shape | ParameterRole::Choice => is_open,
        ParameterRole::EventTime => is_open || !is_fixed(model, active, index),
    }
}

fn is_fixed(model: &Model, active: &ActiveEffect, index: usize) -> bool {
    let key = active.effect.parameters()[index].key;
    model.fixed.contains(&format!("{}.{key}", active.id()))
}

fn put(model: &mut Model, found: &ActiveEffect) {
    if let Some(active) = model.effects.iter_mut().find(|a| a.id() == found.id()) {
        active.values.clone_from(&found.values);
    }
}

/// The parameters that a fit does not change, with a doubt where another value is nearly as good.
fn choices(active: &ActiveEffect, tried: &[Tried]) -> Vec<(String, Option<String>)> {
    let best = &tried[0];
    let chosen = |(index, spec): (usize, &ParameterSpec)| {
        let (value, key) = (best.active.values[index]?, spec.key);
        let rival = tried.iter().find(|other| other.active.values[index] != Some(value));
        let rival = rival.filter(|other| other.gain > 0.95 * best.gain);
        let rival = rival.and_then(|other| other.active.values[index]);
        let doubt = rival.map(|rival| {
            format!("{key} {value} and {rival} explain this run nearly equally well: record more turns, at low speed")
        });
        Some((format!("{}.{key}", active.id()), doubt))
    };
    let specs = active.effect.parameters();
    (0..specs.len())
        .filter(|index| specs[*index].role == ParameterRole::Choice)
        .filter(|index| active.values[*index].is_none())
        .filter_map(|index| chosen((index, &specs[index])))
        .collect()
}

/// One point of the grid with its coefficients.
struct Tried {
    active: ActiveEffect,
    /// Reduction of the cost, to first order.
    gain: f64,
}

/// The model without the effect, fitted.
struct Trial<'a> {
    model: Model,
    scenario: &'a Scenario,
    noise: &'a NoiseFloor,
    residual: Vec<f64>,
    jacobian: DMatrix<f64>,
}

impl<'a> Trial<'a> {
    fn new(model: &Model, scenario: &'a Scenario, noise: &'a NoiseFloor) -> Result<Self, FitError> {
        let (model, residual, jacobian) =
            match output_error::fit(std::slice::from_ref(model), scenario, noise) {
                Ok(fit) => (fit.model, fit.minimum.residual, fit.minimum.jacobian),
                Err(FitError::NothingFree) => {
                    let residual = residual_of(model, scenario, noise)?;
                    let rows = residual.len();
                    (model.clone(), residual, DMatrix::zeros(rows, 0))
                }
                Err(error) => return Err(error),
            };
        Ok(Self { model, scenario, noise, residual, jacobian })
    }

    /// Every combination of the grids, the best first.
    fn all(&self, given: &Model, active: &ActiveEffect) -> Result<Vec<Tried>, FitError> {
        let mut tried = Vec::new();
        for values in self.combinations(given, active) {
            // A point at which the model cannot be simulated is left out.
            match self.one(given, active, &values) {
                Ok(found) => tried.push(found),
                Err(FitError::CannotSimulate { .. }) => {}
                Err(error) => return Err(error),
            }
        }
        tried.sort_by(|a, b| b.gain.total_cmp(&a.gain));
        Ok(tried)
    }

    /// Values with free coefficients at zero.
    fn combinations(&self, given: &Model, active: &ActiveEffect) -> Vec<Vec<f64>> {
        let mut grid = vec![Vec::new()];
        for (index, spec) in active.effect.parameters().iter().enumerate() {
            let value = active.values[index];
            let mut values = if is_searched(given, active, index) {
                spec.in_run(&self.scenario.scales).shapes().collect()
            } else if is_free_coefficient(given, active, index) {
                vec![0.0]
            } else {
                Vec::new()
            };
            if !spec.is_coefficient() || values.is_empty() {
                values.extend(value);
            }
            grid = grid
                .into_iter()
                .flat_map(|before: Vec<f64>| {
                    values.iter().map(move |value| {
                        let mut longer = before.clone();
                        longer.push(*value);
                        longer
                    })
                })
                .collect();
        }
        grid
    }

    /// All free coefficients at once, by linear least squares together with the motor's parameters.
    fn one(&self, given: &Model, active: &ActiveEffect, values: &[f64]) -> Result<Tried, FitError> {
        let specs = active.effect.parameters();
        let free: Vec<usize> =
            (0..specs.len()).filter(|index| is_free_coefficient(given, active, *index)).collect();
        let with = |values: &[f64]| {
            let mut model = self.model.clone();
            model.effects.push(ActiveEffect {
                effect: active.effect,
                values: values.iter().copied().map(Some).collect(),
            });
            residual_of(&model, self.scenario, self.noise)
        };
        let coefficients = specs.iter().filter(|spec| spec.is_coefficient()).count();
        let is_zero = free.iter().all(|index| values[*index] == 0.0) && free.len() == coefficients;
        let has_no_effect = is_zero && !free.is_empty();
        let before =
            DVector::from_vec(if has_no_effect { self.residual.clone() } else { with(values)? });
        let of_motor = self.jacobian.ncols();
        let mut columns = (self.jacobian.clone()).resize_horizontally(of_motor + free.len(), 0.0);
        for (column, index) in free.iter().enumerate() {
            let size = typical_size(active.effect, *index, &self.model, self.scenario);
            let mut changed = values.to_vec();
            changed[*index] = size;
            let after = DVector::from_vec(with(&changed)?);
            columns.set_column(of_motor + column, &((after - &before) / size));
        }
        let (solution, explained) = least_squares::ridge(columns, &before);
        let mut found = active.clone();
        for (index, value) in values.iter().enumerate() {
            found.values[index] = Some(*value);
        }
        for (column, index) in free.iter().enumerate() {
            let range = specs[*index].in_run(&self.scenario.scales);
            let value = -solution[of_motor + column];
            found.values[*index] = Some(value.clamp(range.min, range.max));
        }
        let cost: f64 = self.residual.iter().map(|r| r * r).sum();
        Ok(Tried { active: found, gain: cost - (before.norm_squared() - explained) })
    }
}

fn is_free_coefficient(model: &Model, active: &ActiveEffect, index: usize) -> bool {
    active.effect.parameters()[index].is_coefficient() && !is_fixed(model, active, index)
}

fn residual_of(
    model: &Model,
    scenario: &Scenario,
    noise: &NoiseFloor,
) -> Result<Vec<f64>, FitError> {
    let problem = FreeRun::new(model, scenario, *noise)?;
    problem.residuals(&problem.start())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{self, *};

    /// Slow turns both ways, so that effects of position show.
    fn record(truth: &Model) -> Scenario {
        let events = held([0.0, 0.2, 1.2, 2.0, 3.0, 3.5], [0.0, 6.0, 12.0, -5.0, -20.0, 0.0]);
        testing::record(truth, events, 0.002, 4.0, 3)
    }

    #[test]
    fn order_shape_and_event_time_are_found() {
        for (id, values, index, within) in [
            ("cogging", vec![0.05, -0.08, 7.0], 2, 0.0),
            ("load_step", vec![0.12, 2.4], 1, 0.02),
            ("stribeck_friction", vec![0.15, 20.0], 1, 3.0),
        ] {
            let scenario = record(&paper_with(id, &values));
            let starts = scan(&paper().with_effect(id).unwrap(), &scenario, &NOISE).unwrap();
            let fit = output_error::fit(&starts.models, &scenario, &NOISE).unwrap();
            let found = fit.model.effects[0].values[index].unwrap();
            assert!((found - values[index]).abs() <= within, "{id} {found}");
            assert!(fit.nrms < 1.08, "{id} {}", fit.nrms);
        }
    }

    #[test]
    fn given_values_stay_except_an_event_time() {
        let truth = paper_with("load_step", &[0.12, 2.4]);
        let scenario = record(&truth);
        let mut start = truth.clone();
        start.effects[0].values[1] = Some(0.3);
        let moved = scan(&start, &scenario, &NOISE).unwrap();
        let found = moved.models[0].effects[0].values[1].unwrap();
        assert!((found - 2.4).abs() < 0.2, "{found}");
        start.fixed.push("load_step.time_s".to_owned());
        let fixed = scan(&start, &scenario, &NOISE).unwrap();
        assert_eq!(fixed.models.len(), 1);
        assert_eq!(fixed.models[0].effects[0].values[1], Some(0.3));
    }
}
