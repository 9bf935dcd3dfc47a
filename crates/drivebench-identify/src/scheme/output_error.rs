//! Batch output-error fit: the reference among our methods.

use super::{Data, Identified, IdentifyError, Scheme};
use crate::first_order::FirstOrder;
use crate::misfit::Misfit;
use crate::noise::NoiseFloor;
use crate::output_error::{Fit, FitError, fit_delayed};
use crate::{cause, effect_start, plateaus, start};
use drivebench_model::plant::{Input, Model, MotorKey, Scenario};
use drivebench_model::sample::{ParameterEstimate, Reason, Verdict};

pub(super) const OUTPUT_ERROR: Scheme = Scheme {
    id: "output-error",
    summary: "batch fit of the free run (default with a voltage)",
    identify: free_run,
};

fn free_run(id: &'static str, data: &Data<'_>) -> Result<Identified, IdentifyError> {
    if data.scenario.input != Input::Voltage {
        let help = "use --scheme weak-form, or map a voltage with --map voltage_v=HEADER";
        return Err(data.refused(id, "it has no voltage to simulate from", help));
    }
    let noise = NoiseFloor::from_standstill(data.scenario)
        .unwrap_or_else(|| NoiseFloor::from_spread(data.scenario));
    let (fit, chosen) = better_of_two_starts(data, &noise)?;
    let (misfit, deviations) = Misfit::of_fit(&fit, data.scenario)?;
    let mut parameters = fit.parameters.clone();
    misfit.widen(&mut parameters, &deviations, fit.minimum.converged);
    // A value from a grid search is an estimate, not given; it has no standard deviation.
    for (key, doubt) in chosen {
        let chosen = |p: &&mut ParameterEstimate| p.key == key && p.verdict == Verdict::Fixed;
        if let Some(parameter) = parameters.iter_mut().find(chosen) {
            let doubted = doubt.as_ref().map(|_| Verdict::Searching);
            parameter.verdict = doubted.unwrap_or(Verdict::Settled);
            parameter.code = doubt.as_ref().map(|_| Reason::Ambiguous);
            parameter.reason = doubt;
        }
    }
    plateaus::complete(&mut parameters, data.scenario);
    misfit.unsettle(&mut parameters);
    cause::explain(&mut parameters, &fit, &misfit, data.model, data.scenario);
    let has_current = data.scenario.current_a.iter().any(|cell| cell.is_finite());
    if !has_current {
        parameters.extend(FirstOrder::estimates(data.scenario));
    }
    let mut found = Identified::new(id, &fit.model, parameters);
    found.misfit = Some(misfit);
    Ok(found)
}

/// A fit, and what was chosen from grids for it, with a doubt where there is one.
type Found = (Fit, Vec<(String, Option<String>)>);

/// From one set of motor values, with the grids of effects tried.
fn from(model: &Model, scenario: &Scenario, noise: &NoiseFloor) -> Result<Found, FitError> {
    let starts = effect_start::scan(model, scenario, noise)?;
    Ok((fit_delayed(&starts.models, scenario, noise)?, starts.chosen))
}

/// From the values of the model, and where that ends above the floor, so that it may not be the minimum, from the data
/// alone: a nameplate far from the truth, or one distorted by what the model lacks, must not decide in which valley the
/// fit ends.
fn better_of_two_starts(data: &Data<'_>, noise: &NoiseFloor) -> Result<Found, IdentifyError> {
    let given = start::complete(data.model, data.scenario)?;
    let from_given = from(&given, data.scenario, noise);
    if let Ok((found, _)) = &from_given
        && noise.is_at_the_floor(found.nrms)
    {
        return Ok(from_given?);
    }
    let Ok(fresh) = start::complete(&forget(data.model), data.scenario) else {
        return Ok(from_given?);
    };
    Ok(match (from_given, from(&fresh, data.scenario, noise)) {
        (Ok(given), Ok(fresh)) if fresh.0.minimum.cost < given.0.minimum.cost => fresh,
        (Err(_), Ok(fresh)) => fresh,
        (given, _) => given?,
    })
}

/// The model without the motor values that are to be estimated.
fn forget(model: &Model) -> Model {
    let mut model = model.clone();
    for key in MotorKey::ALL {
        let fixed = model.fixed.iter().any(|name| name == key.key());
        // Torque and back-EMF constant are not identifiable together: a given torque constant is kept.
        if !fixed && key != MotorKey::TorqueConstant {
            model.motor.clear(key);
        }
    }
    model
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{self, *};
    use drivebench_model::sample::{Channel, Run};

    #[test]
    fn a_nameplate_wrong_in_every_value_does_not_decide_the_fit() {
        let truth = paper();
        let levels = [40.0, 80.0, 20.0, -40.0, -80.0, 0.0];
        let steps = (0..18_u8).map(|k| (0.4 + 0.2 * f64::from(k), levels[usize::from(k) % 6]));
        let events = std::iter::once((0.0, 0.0)).chain(steps).collect();
        let scenario = record(&truth, events, 0.002, 4.0, 3);
        for factors in
            [[10.0, 0.1, 3.0, 0.1, 5.0], [0.1, 10.0, 0.3, 10.0, 0.2], [5.0, 5.0, 0.2, 20.0, 5.0]]
        {
            let mut start = truth.clone();
            for (key, factor) in KEYS.into_iter().zip(factors) {
                start.motor.set(key, factor * truth.motor.get(key).unwrap());
            }
            let data = Data {
                run: &Run::new("r", scenario.sample_time_s.clone()).unwrap(),
                scenario: &scenario,
                model: &start,
            };
            let found = OUTPUT_ERROR.identify(&data).unwrap().model;
            for key in KEYS {
                let ratio = found.motor.get(key).unwrap() / truth.motor.get(key).unwrap();
                assert!((ratio - 1.0).abs() < 0.03, "{factors:?} {key:?} {ratio}");
            }
        }
    }

    #[test]
    fn the_order_of_cogging_is_found_from_a_wrapped_angle() {
        let start = paper().with_effect("cogging").unwrap();
        let truth = paper_with("cogging", &[0.06, -0.05, 9.0]);
        let events = held([0.0, 0.2, 1.2, 2.0, 3.0, 3.5], [0.0, 7.0, 15.0, -6.0, -20.0, 0.0]);
        let recorded = record(&truth, events, 0.002, 4.0, 5);
        let mut run = testing::recorded(&recorded);
        let (mut angle, mut last) = (0.0, 0.0);
        let wrapped = recorded.speed_rad_s.iter().map(|speed| {
            angle += 0.5 * (speed + last) * 0.002;
            last = *speed;
            f64::rem_euclid(angle, std::f64::consts::TAU)
        });
        put(&mut run, Channel::Angle, wrapped.collect());
        let found = identify(OUTPUT_ERROR.id, &run, &start).unwrap().parameters;
        assert_eq!(judged(&found, "cogging.order", Verdict::Settled).value, Some(9.0));
        let sin = of(&found, "cogging.sin_n_m").value.unwrap();
        assert!((sin - 0.06).abs() < 0.01, "{sin}");
    }
}
