//! Provisional ranking of effects: the share of an equation's residual that each static term explains, to first order.
//!
//! For a run in progress, with a model that is not fitted: it costs one simulation and regresses the residual on each
//! effect alone, at the guess of its shape (marginal screening). The diagnosis weighs all effects jointly.

use serde::Serialize;

use super::regression::Regression;
use super::windows::{FEWEST_HALF, Windows};
use super::{ErrorOf, FEWEST_WINDOWS, refit};
use drivebench_identify::noise::NoiseFloor;
use drivebench_identify::output_error::FitError;
use drivebench_model::plant::effect::{CATALOGUE, ParameterRole};
use drivebench_model::plant::{
    Balance, Effect, Instant, Model, ParameterSpec, Scenario, ShaftAngle, Terms,
};

/// Largest order of the angle.
const ORDERS: usize = 12;
/// Share of an equation's error that an effect must explain to be ranked.
const NAMED_SHARE: f64 = 0.3;

/// One effect and how much of the error it would explain.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RankedEffect {
    pub effect: &'static str,
    pub equation: &'static str,
    /// Share of the equation's squared error beyond the noise that follows the effect, besides the equation's own
    /// parameters.
    pub share: f64,
    /// Windows of the regression.
    pub windows: usize,
}

/// The effects that explain the error of a failing equation, the largest share first; empty where no equation
/// fails, or none explains a good part.
pub fn provisional_ranking(
    model: &Model,
    scenario: &Scenario,
    noise: &NoiseFloor,
) -> Result<Vec<RankedEffect>, FitError> {
    let mut windows = Windows::new(model, scenario, noise, FEWEST_HALF)?;
    let mut found: Vec<(f64, RankedEffect)> = Vec::new();
    if windows.missing_signal().is_some() {
        return Ok(Vec::new());
    }
    for &equation in super::equations(scenario.input) {
        let count = windows.of(equation).count();
        if count < FEWEST_WINDOWS {
            continue;
        }
        let mut balance = windows.balance(equation, noise);
        refit(&mut windows, equation, &mut balance, noise, model, ErrorOf::Structure);
        if !balance.fails {
            continue;
        }
        let badness = super::nres(&balance).unwrap_or(balance.relative);
        let errors = Regression::new(&windows, equation, true);
        let angle = windows.angle_at_samples();
        for effect in CATALOGUE {
            let share = share(&errors, *effect, model, angle.as_deref());
            if let Some(share) = share.filter(|share| *share >= NAMED_SHARE) {
                let (effect, equation) = (effect.card().id, equation.key());
                let ranked = RankedEffect { effect, equation, share, windows: count };
                found.push((badness * share.sqrt(), ranked));
            }
        }
    }
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    Ok(found.into_iter().map(|(_, ranked)| ranked).collect())
}

/// Share of the error that the effect's coefficients explain, each a column at unit size; of an effect of the angle that of
/// its best order.
fn share(
    errors: &Regression<'_>,
    effect: &'static dyn Effect,
    model: &Model,
    angle: Option<&[f64]>,
) -> Option<f64> {
    let card = effect.card();
    let specs = effect.parameters();
    let happens_once = specs.iter().any(|spec| spec.role == ParameterRole::EventTime);
    if happens_once || !card.enters.includes(errors.equation) {
        return None;
    }
    let orders = match (card.needs_angle, angle) {
        (true, None) => return None,
        (true, Some(_)) => ORDERS,
        (false, _) => 1,
    };
    let coefficients = || (0..specs.len()).filter(|unit| specs[*unit].is_coefficient());
    let best = (1..=orders).filter_map(|order| {
        let columns = coefficients().map(|unit| {
            let value = |(index, spec): (usize, &ParameterSpec)| match spec.role {
                _ if spec.is_coefficient() => {
                    if index == unit {
                        spec.scale
                    } else {
                        0.0
                    }
                }
                ParameterRole::Choice => order as f64,
                _ => spec.in_run(&errors.windows.scenario.scales).guess,
            };
            let values: Vec<f64> = specs.iter().enumerate().map(value).collect();
            column(errors, effect.terms(&values).as_ref(), model, angle)
        });
        let columns = columns.collect::<Option<Vec<_>>>()?;
        let row = |row: usize| columns.iter().map(|column| column[row]).collect();
        let rows: Vec<Vec<f64>> = (0..errors.each.len()).map(row).collect();
        errors.reported(&rows).map(|fit| fit.follows)
    });
    best.max_by(f64::total_cmp)
}

/// What a term does in each window; `None` where it is no term, or does nothing.
fn column(
    errors: &Regression<'_>,
    terms: &dyn Terms,
    model: &Model,
    angle: Option<&[f64]>,
) -> Option<Vec<f64>> {
    if terms.why_no_term().is_some() {
        return None;
    }
    let scenario = errors.windows.scenario;
    let motor = Instant::of(&model.motor).in_run(scenario);
    let begin_s = scenario.begin_s();
    let dead_zone = errors.windows.dead_zone_rad_s;
    let at_sample = |(sample, time_s): (usize, &f64)| {
        let speed_rad_s = scenario.speed_rad_s[sample];
        let at = Instant {
            time_s: time_s - begin_s,
            voltage_v: scenario.input_at(*time_s),
            current_a: scenario.current_a.get(sample).copied().unwrap_or(f64::NAN),
            speed_rad_s,
            angle: angle.map_or_else(ShaftAngle::default, |angle| ShaftAngle::at(angle[sample])),
            ..motor
        };
        let sums = terms.sums(&at, &[]);
        let direction = if speed_rad_s.abs() > dead_zone { speed_rad_s.signum() } else { 0.0 };
        match errors.equation {
            Balance::Voltage => sums.voltage_v,
            Balance::Torque => sums.torque_n_m + sums.friction_n_m * direction,
        }
    };
    let values: Vec<f64> = scenario.sample_time_s.iter().enumerate().map(at_sample).collect();
    let rows = errors.averaged(&values, 1, |value, weight, row| row[0] += value * weight);
    let column: Vec<f64> = rows.into_iter().map(|row| row[0]).collect();
    column.iter().any(|value| *value != 0.0).then_some(column)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kit::{held, nameplate, truth};
    use drivebench_model::plant::testing::{self, with_a_fan};

    fn ranking(run: &Scenario) -> Vec<RankedEffect> {
        let noise = NoiseFloor::from_standstill(run).unwrap();
        provisional_ranking(&nameplate(), run, &noise).unwrap()
    }

    #[test]
    fn the_residual_of_a_fan_ranks_the_fan_first() {
        let found = ranking(&with_a_fan(0));
        let first = &found[0];
        assert_eq!((first.effect, first.equation), ("quadratic_load", "torque"));
        assert!(first.share > 0.9, "{found:?}");
    }

    #[test]
    fn a_complete_model_ranks_no_effect() {
        let events = testing::held([0.0, 0.5, 1.5, 2.5, 3.5], [0.0, 40.0, -30.0, 70.0, -80.0]);
        let run = testing::record(&nameplate(), events, 0.005, 4.5, 3);
        assert_eq!(ranking(&run), vec![]);
    }

    #[test]
    fn a_brush_drop_is_ranked_in_the_voltage_equation() {
        let truth = truth("voltage_drop", &[1.5]);
        let events = held(&[30.0, -30.0, 60.0, -15.0, 20.0, -70.0].repeat(5), 0.2);
        let found = ranking(&testing::record(&truth, events, 0.002, 6.5, 4));
        assert_eq!(found[0].equation, "voltage", "{found:?}");
        let drop = found.iter().find(|own| own.effect == "voltage_drop");
        assert!(drop.unwrap().share > 0.7, "{found:?}");
    }
}
