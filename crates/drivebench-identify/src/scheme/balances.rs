//! Both balances as schemes: the weak form, and inverse dynamics, the field's reference.

use super::{Data, Identified, IdentifyError, Scheme};
use crate::balance::{as_ratio, lacks_torque_constant, why_no_regressor};
use crate::misfit::{Misfit, widen_by_forms_of_torque};
use crate::{inverse_dynamics, missing_cells, weak_form};
use drivebench_model::numerics::count::whole;
use drivebench_model::numerics::statistics::median_step;
use drivebench_model::plant::{ActiveEffect, Balance, Input, Model, MotorKey, Scenario};
use drivebench_model::sample::{ParameterEstimate, TWO_SIDED_95, Verdict};

pub(super) const WEAK_FORM: Scheme = Scheme {
    id: "weak-form",
    summary: "balances averaged over smooth windows (default without a voltage)",
    identify: |id, data| {
        let (mut parameters, misfit) = parameters(data.model, data.scenario);
        doubt_coarse_sampling(&mut parameters, data.scenario);
        let electrical = data.scenario.input == Input::Voltage;
        let mut found = Identified::new(id, data.model, parameters).with_note(
            "weak form: windows without standstill; friction values depend on the method by some per cent",
        );
        found.misfit = Some(misfit);
        Ok(found.leaving_out(data.model, of_balances(data.model, electrical)))
    },
};

pub(super) const INVERSE_DYNAMICS: Scheme = Scheme {
    id: "inverse-dynamics",
    summary: "balances low-passed without phase shift, differentiated, decimated: the field's reference",
    identify: filtered_balances,
};

#[expect(
    clippy::unnecessary_wraps,
    reason = "a scheme of the catalogue may fail"
)]
fn filtered_balances(id: &'static str, data: &Data<'_>) -> Result<Identified, IdentifyError> {
    let balances = inverse_dynamics::fit(data.model, data.run, data.scenario);
    let mut notes = Vec::new();
    for balance in &balances {
        if let (Some(processing), Balance::Torque) = (&balance.processing, balance.equation) {
            notes.push(processing.sentence());
            if balance.rows == 0 {
                continue;
            }
            notes.push(format!(
                "{} of {} rows left out: at rest (below {:.3e} rad/s for half the filter's reach or longer), where \
                 friction is not determined, and at the ends; reversals stay in. Error {:.2} % of the torque; the \
                 offsets of the decimation differ by up to {:.2} %",
                balance.rows_left_out,
                balance.rows,
                processing.dead_zone_rad_s,
                balance.relative_error_percent,
                balance.offset_spread_percent
            ));
        }
    }
    let electrical = data.scenario.input == Input::Voltage;
    let rows = balances.last().map_or(0, |torque| torque.rows);
    let of_all = |balances: Vec<inverse_dynamics::Balanced>| {
        let all = balances.into_iter().flat_map(|balance| balance.parameters);
        once_each(all.collect())
    };
    let mut found = of_all(balances);
    if !electrical {
        widen_by_forms_of_torque(&mut found, rows, |form| {
            let with = data.model.with_effect(form).ok()?;
            Some(of_all(inverse_dynamics::fit(
                &with,
                data.run,
                data.scenario,
            )))
        });
    }
    let (weak, _) = parameters(data.model, data.scenario);
    notes.extend(compared(&found, &weak));
    let mut identified = Identified::new(id, data.model, found);
    identified.notes = notes;
    Ok(identified.leaving_out(data.model, of_balances(data.model, electrical)))
}

/// Periods per L/R above which a window's quadrature error is of the order of what it measures.
const COARSE: f64 = 1.0 / 3.0;

/// Where the samples do not resolve the armature circuit nothing from it is settled, and nothing that rests on it: every
/// second sample left out then moves the values by chance more than by what is wrong with them.
fn doubt_coarse_sampling(parameters: &mut [ParameterEstimate], scenario: &Scenario) {
    if scenario.input != Input::Voltage {
        return;
    }
    let value = |key: MotorKey| ParameterEstimate::value_of(parameters, key.key());
    let time_constant_s = value(MotorKey::Inductance)
        .zip(value(MotorKey::Resistance))
        .map(|(l, r)| l / r);
    let period_s = median_step(&scenario.sample_time_s);
    if time_constant_s.is_some_and(|ta| period_s <= COARSE * ta) {
        return;
    }
    let ta = time_constant_s.map_or_else(
        || "L/R is not resolved".to_owned(),
        |ta| format!("L/R is {:.1} ms", 1e3 * ta),
    );
    for parameter in parameters.iter_mut() {
        parameter.unsettle(format!(
            "{ta} against a period of {:.1} ms: windows need three samples in it; use the output-error fit",
            1e3 * period_s
        ));
    }
}

/// Values of both balances: over whole rows, and as ratios in the reasons where the torque constant is unknown.
fn parameters(model: &Model, scenario: &Scenario) -> (Vec<ParameterEstimate>, Misfit) {
    let bridged = missing_cells::bridged(scenario);
    let scenario = bridged.as_ref().unwrap_or(scenario);
    let relative = lacks_torque_constant(model, scenario);
    let mut model = model.clone();
    if relative {
        // With a torque constant of one the values are ratios to it.
        model.motor.set(MotorKey::TorqueConstant, 1.0);
    }
    let balances = weak_form::fit(&model, scenario);
    let misfit = Misfit::of_balances(&balances);
    let rows = balances.last().map_or(0, |torque| torque.residual.len());
    let in_ratio = |found: ParameterEstimate| match found.verdict {
        Verdict::Fixed => found,
        _ if relative => as_ratio(found),
        _ => found,
    };
    let found = balances
        .into_iter()
        .flat_map(|balance| balance.parameters)
        .map(in_ratio);
    let mut found = once_each(found.collect());
    if scenario.input != Input::Voltage {
        widen_by_forms_of_torque(&mut found, rows, |form| {
            let with = weak_form::fit(&model.with_effect(form).ok()?, scenario);
            Some(
                with.into_iter()
                    .flat_map(|balance| balance.parameters)
                    .collect(),
            )
        });
    }
    (found, misfit)
}

/// Both methods' values side by side, and why they differ.
fn compared(ours: &[ParameterEstimate], weak: &[ParameterEstimate]) -> Option<String> {
    let pairs: Vec<String> = ours
        .iter()
        .filter_map(|p| {
            let value = p.value.filter(|_| p.std != Some(0.0))?;
            let other = ParameterEstimate::value_of(weak, &p.key)?;
            Some(format!(
                "{} {value:.digits$} here, {other:.digits$} there ({:+.1} %)",
                p.key,
                100.0 * (other / value - 1.0),
                digits = decimals(value)
            ))
        })
        .collect();
    (!pairs.is_empty()).then(|| {
        format!(
            "beside the weak form: {}. It averages over windows, and leaves out every window with a slow sample; this one \
             filters, and keeps reversals. Where the machine's friction is not quite the model's (viscous friction that \
             differs by direction, friction that changes near standstill) the two spread the misfit differently: a \
             difference of some per cent is the model's, not the noise's",
            pairs.join("; ")
        )
    })
}

/// Decimals that show five digits of a value.
fn decimals(value: f64) -> usize {
    let magnitude = value.abs().max(1e-12).log10().floor();
    whole((4.0 - magnitude).max(0.0))
}

/// Why a scheme over balances carries an effect of `model`, or not.
fn of_balances(model: &Model, electrical: bool) -> impl Fn(&ActiveEffect) -> Option<&'static str> {
    move |active| why_no_regressor(active, &model.motor, electrical)
}

/// Coefficients of an effect that enters both balances come once from each: brought together by their variances.
fn once_each(parameters: Vec<ParameterEstimate>) -> Vec<ParameterEstimate> {
    let mut merged: Vec<ParameterEstimate> = Vec::with_capacity(parameters.len());
    for next in parameters {
        let twin = merged.iter_mut().find(|earlier| earlier.key == next.key);
        let Some(earlier) = twin.filter(|_| MotorKey::from_key(&next.key).is_none()) else {
            merged.push(next);
            continue;
        };
        let weight = |p: &ParameterEstimate| p.std.filter(|std| *std > 0.0).map(|std| std.powi(-2));
        match (
            earlier.value.zip(weight(earlier)),
            next.value.zip(weight(&next)),
        ) {
            (Some((a, wa)), Some((b, wb))) => {
                let (value, std) = ((wa * a + wb * b) / (wa + wb), (wa + wb).sqrt().recip());
                // Balances that disagree: the spread is the better measure.
                let spread = (a - b).abs() / 2.0;
                let (surer, other) = if wb > wa {
                    (next, &*earlier)
                } else {
                    (earlier.clone(), &next)
                };
                let doubt = if 2.0 * spread > TWO_SIDED_95 * (wa.recip() + wb.recip()).sqrt() {
                    Some(format!(
                        "the balances do not agree: {} and {}",
                        surer.text(1.0),
                        other.text(1.0)
                    ))
                } else {
                    other
                        .reason
                        .clone()
                        .filter(|_| other.verdict != Verdict::Settled)
                };
                *earlier = ParameterEstimate {
                    value: Some(value),
                    std: Some(std.max(spread)),
                    ..surer
                };
                if let Some(doubt) = doubt {
                    earlier.unsettle(doubt);
                }
            }
            (None, Some(_)) => *earlier = next,
            _ => {}
        }
    }
    merged
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::*;

    /// A record of current and speed alone, as a drive in torque mode leaves it.
    fn mechanical() -> Scenario {
        let steps = [
            (0.3, 40.0),
            (0.8, -50.0),
            (1.4, 15.0),
            (2.0, -20.0),
            (2.7, 60.0),
            (3.3, 5.0),
        ];
        let events = std::iter::once((0.0, 0.0)).chain(steps).collect();
        let mut scenario = record(&paper(), events, 0.002, 4.0, 7);
        scenario.input = Input::Current;
        scenario
    }

    #[test]
    fn rows_of_their_own_and_missing_cells_cost_little() {
        let whole = mechanical();
        let (mut apart, mut holed) = (whole.clone(), whole.clone());
        for k in 0..whole.samples() {
            let cells = if k % 2 == 0 {
                &mut apart.current_a
            } else {
                &mut apart.speed_rad_s
            };
            cells[k] = f64::NAN;
            if k % 13 == 5 {
                holed.current_a[k] = f64::NAN;
            }
        }
        let model = paper();
        for (scenario, within) in [(&whole, 0.01), (&holed, 0.02), (&apart, 0.03)] {
            let (found, _) = parameters(&model, scenario);
            assert_found(&found, "inertia_kg_m2", 0.0045, within);
            assert_found(&found, "load_torque_n_m", 0.455, within);
        }
    }

    #[test]
    fn what_both_balances_tell_is_settled_where_both_do_and_agree() {
        for (other, doubt, verdict) in [
            (1.01, None, Verdict::Settled),
            (1.2, None, Verdict::Searching),
            (1.01, Some("few samples".to_owned()), Verdict::Searching),
        ] {
            let of = |value, doubt| ParameterEstimate::found("e.x", "-", value, 0.02, doubt);
            let merged = once_each(vec![of(1.0, None), of(other, doubt)]);
            assert_eq!(merged.len(), 1);
            assert_eq!(merged[0].verdict, verdict, "{merged:?}");
            assert!((merged[0].value.unwrap() - 0.5 * (1.0 + other)).abs() < 1e-12);
        }
    }

    #[test]
    fn without_a_torque_constant_the_ratio_stands_in_the_reason() {
        let (found, _) = parameters(&unknown(), &mechanical());
        let inertia = of(&found, "inertia_kg_m2");
        let told = (inertia.value, inertia.verdict);
        assert_eq!(told, (None, Verdict::NotObservable));
        let mut words = inertia.reason.as_deref().unwrap().split_whitespace();
        let ratio = words.find_map(|word| word.parse::<f64>().ok()).unwrap();
        assert_near(ratio, 0.0045 / 0.3538, 0.02);
    }
}
