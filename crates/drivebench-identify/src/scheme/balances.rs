//! Both balances as schemes: the weak form, and inverse dynamics, the field's reference.

use super::{Data, Identified, IdentifyError, Scheme};
use crate::balance::{as_ratio, lacks_torque_constant, why_no_regressor};
use crate::misfit::{Misfit, widen_by_forms_of_torque, widen_by_sampled_current};
use crate::{inverse_dynamics, missing_cells, weak_form, winding_balance};
use drivebench_model::numerics::count::whole;
use drivebench_model::numerics::statistics::median_step;
use drivebench_model::plant::{ActiveEffect, Balance, Input, Model, MotorKey, Scenario};
use drivebench_model::sample::{ParameterEstimate, Reason, TWO_SIDED_95, Verdict};

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

#[expect(clippy::unnecessary_wraps, reason = "a scheme of the catalogue may fail")]
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
        once_each(balances.into_iter().flat_map(|balance| balance.parameters).collect())
    };
    let mut found = of_all(balances);
    if !electrical {
        widen_by_forms_of_torque(&mut found, rows, |form| {
            let with = data.model.with_effect(form).ok()?;
            Some(of_all(inverse_dynamics::fit(&with, data.run, data.scenario)))
        });
        widen_by_sampled_current(&mut found, &data.model.motor, data.scenario);
    }
    let (weak, _) = parameters(data.model, data.scenario);
    notes.extend(compared(&found, &weak));
    let mut identified = Identified::new(id, data.model, found);
    identified.notes = notes;
    Ok(identified.leaving_out(data.model, of_balances(data.model, electrical)))
}

/// Where the samples do not resolve the armature circuit nothing from it is settled, and nothing that rests on it: every
/// second sample left out then moves the values by chance more than by what is wrong with them.
fn doubt_coarse_sampling(parameters: &mut [ParameterEstimate], scenario: &Scenario) {
    if scenario.input != Input::Voltage {
        return;
    }
    let value = |key: MotorKey| ParameterEstimate::value_of(parameters, key.key());
    let time_constant_s =
        value(MotorKey::Inductance).zip(value(MotorKey::Resistance)).map(|(l, r)| l / r);
    let period_s = median_step(&scenario.sample_time_s);
    if time_constant_s.is_some_and(|ta| period_s <= 1.0 / 3.0 * ta) {
        return;
    }
    let resolved = |ta: f64| format!("L/R is {:.1} ms", 1e3 * ta);
    let ta = time_constant_s.map_or_else(|| "L/R is not resolved".to_owned(), resolved);
    for parameter in parameters.iter_mut() {
        parameter.unsettle(Reason::SampledTooSlowly, format!(
            "{ta} against a period of {:.1} ms: windows need three samples in it; use the output-error fit",
            1e3 * period_s
        ));
    }
}

/// Values of both balances: over whole rows, and as ratios in the reasons where the torque constant is unknown.
fn parameters(model: &Model, scenario: &Scenario) -> (Vec<ParameterEstimate>, Misfit) {
    let bridged = missing_cells::bridged(scenario);
    let scenario = bridged.as_ref().unwrap_or(scenario);
    let (mut model, _) = winding_balance::with_constants(model, scenario);
    let relative = lacks_torque_constant(&model, scenario);
    if relative {
        // With a torque constant of one the values are ratios to it.
        model.motor.set(MotorKey::TorqueConstant, 1.0);
    }
    let balances = weak_form::fit(&model, scenario);
    let misfit = Misfit::of_balances(&balances);
    let rows = balances.last().map_or(0, |torque| torque.residual.len());
    let of_all = |balances: Vec<weak_form::Balanced>| -> Vec<ParameterEstimate> {
        balances.into_iter().flat_map(|balance| balance.parameters).collect()
    };
    let mut found = of_all(balances);
    if relative {
        let unknown = found.iter_mut().filter(|found| found.verdict != Verdict::Fixed);
        unknown.for_each(|found| *found = as_ratio(found.clone()));
    }
    let mut found = once_each(found);
    if scenario.input != Input::Voltage {
        widen_by_forms_of_torque(&mut found, rows, |form| {
            Some(of_all(weak_form::fit(&model.with_effect(form).ok()?, scenario)))
        });
        widen_by_sampled_current(&mut found, &model.motor, scenario);
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
            // Five digits of the value.
            let digits = whole((4.0 - value.abs().max(1e-12).log10().floor()).max(0.0));
            let (key, percent) = (&p.key, 100.0 * (other / value - 1.0));
            Some(format!("{key} {value:.digits$} here, {other:.digits$} there ({percent:+.1} %)"))
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
        match (earlier.value.zip(weight(earlier)), next.value.zip(weight(&next))) {
            (Some((a, wa)), Some((b, wb))) => {
                let (value, std) = ((wa * a + wb * b) / (wa + wb), (wa + wb).sqrt().recip());
                // Balances that disagree: the spread is the better measure.
                let spread = (a - b).abs() / 2.0;
                let (surer, other) =
                    if wb > wa { (next, earlier.clone()) } else { (earlier.clone(), next) };
                let disagree = 2.0 * spread > TWO_SIDED_95 * (wa.recip() + wb.recip()).sqrt();
                let doubt = if disagree {
                    let (a, b) = (surer.text(1.0), other.text(1.0));
                    let reason = format!("the balances do not agree: {a} and {b}");
                    Some((Reason::Disagree, reason))
                } else {
                    other.code.zip(other.reason).filter(|_| other.verdict != Verdict::Settled)
                };
                *earlier =
                    ParameterEstimate { value: Some(value), std: Some(std.max(spread)), ..surer };
                if let Some((code, doubt)) = doubt {
                    earlier.unsettle(code, doubt);
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

    /// Current and speed alone, as a drive in torque mode leaves them.
    #[test]
    fn rows_of_their_own_and_missing_cells_cost_little() {
        let events =
            held([0.0, 0.3, 0.8, 1.4, 2.0, 2.7, 3.3], [0.0, 40.0, -50.0, 15.0, -20.0, 60.0, 5.0]);
        let mut whole = record(&paper(), events, 0.002, 4.0, 7);
        whole.input = Input::Current;
        let (mut apart, mut holed) = (whole.clone(), whole.clone());
        for k in 0..whole.samples() {
            [&mut apart.current_a, &mut apart.speed_rad_s][k % 2][k] = f64::NAN;
            if k % 13 == 5 {
                holed.current_a[k] = f64::NAN;
            }
        }
        for (scenario, within) in [(&whole, 0.01), (&holed, 0.02), (&apart, 0.03)] {
            let (found, _) = parameters(&paper(), scenario);
            assert_found(&found, "inertia_kg_m2", 0.0045, within);
            assert_found(&found, "load_torque_n_m", 0.455, within);
        }
        // Without a torque constant the ratio to it stands in the reason.
        let (found, _) = parameters(&unknown(), &whole);
        let inertia = judged(&found, "inertia_kg_m2", Verdict::NotObservable);
        let mut words = inertia.reason.as_deref().unwrap().split_whitespace();
        let ratio = words.find_map(|word| word.parse::<f64>().ok()).unwrap();
        assert_near(ratio, 0.0045 / 0.3538, 0.02);
    }

    #[test]
    fn a_coefficient_of_both_balances_is_settled_where_they_agree() {
        for (other, doubt, verdict) in [
            (1.01, None, Verdict::Settled),
            (1.2, None, Verdict::Searching),
            (1.01, Some((Reason::TooFewRows, "few samples".to_owned())), Verdict::Searching),
        ] {
            let of = |value, doubt| ParameterEstimate::found("e.x", "-", value, 0.02, doubt);
            let merged = once_each(vec![of(1.0, None), of(other, doubt)]);
            assert_eq!(merged.len(), 1);
            assert_eq!(merged[0].verdict, verdict, "{merged:?}");
            assert!((merged[0].value.unwrap() - 0.5 * (1.0 + other)).abs() < 1e-12);
        }
    }
}
