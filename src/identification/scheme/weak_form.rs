//! Weak form of both balances.

use super::left_out::{of_balances, once_each};
use super::{Data, Identified, IdentifyError, Scheme};
use crate::identification::balance::{as_ratio, lacks_torque_constant};
use crate::identification::{missing_cells, weak_form};
use crate::numerics::statistics::median;
use crate::plant::{Input, Model, MotorKey, Scenario};
use crate::sample::{ParameterEstimate, Verdict};

pub(super) struct WeakForm;

impl Scheme for WeakForm {
    fn id(&self) -> &'static str {
        "weak-form"
    }

    fn summary(&self) -> &'static str {
        "balances averaged over smooth windows (default without a voltage)"
    }

    fn identify(&self, data: &Data<'_>) -> Result<Identified, IdentifyError> {
        let mut parameters = parameters(data.model, data.scenario)?;
        doubt_coarse_sampling(&mut parameters, data.scenario);
        let electrical = data.scenario.input == Input::Voltage;
        let found = Identified::new(self.id(), data.model, parameters).with_note(
            "weak form: windows without standstill; friction values depend on the method by some per cent",
        );
        Ok(found.leaving_out(data.model, of_balances(data.model, electrical)))
    }
}

/// Periods per L/R above which a window's quadrature error is of the order of what it measures.
const COARSE: f64 = 1.0 / 3.0;

/// Where the samples do not resolve the armature circuit nothing from it is settled, and nothing that rests on it: every
/// second sample left out then moves the values by chance more than by what is wrong with them.
fn doubt_coarse_sampling(parameters: &mut [ParameterEstimate], scenario: &Scenario) {
    if scenario.input != Input::Voltage {
        return;
    }
    let value = |key: MotorKey| parameters.iter().find(|p| p.key == key.key())?.value;
    let time_constant_s = value(MotorKey::Inductance)
        .zip(value(MotorKey::Resistance))
        .map(|(l, r)| l / r);
    let steps: Vec<f64> = scenario
        .sample_time_s
        .windows(2)
        .map(|pair| pair[1] - pair[0])
        .collect();
    let period_s = median(&steps);
    if time_constant_s.is_some_and(|ta| period_s <= COARSE * ta) {
        return;
    }
    let ta = time_constant_s.map_or_else(
        || "L/R is not resolved".to_owned(),
        |ta| format!("L/R is {:.1} ms", 1e3 * ta),
    );
    for parameter in parameters.iter_mut() {
        if parameter.verdict == Verdict::Settled {
            parameter.verdict = Verdict::Searching;
            parameter.reason = Some(format!(
                "{ta} against a period of {:.1} ms: windows need three samples in it; use the output-error fit",
                1e3 * period_s
            ));
        }
    }
}

/// Values of both balances: over whole rows, and as ratios in the reasons where the torque constant is unknown.
pub(super) fn parameters(
    model: &Model,
    scenario: &Scenario,
) -> Result<Vec<ParameterEstimate>, IdentifyError> {
    let bridged = missing_cells::bridged(scenario);
    let scenario = bridged.as_ref().unwrap_or(scenario);
    let relative = lacks_torque_constant(model, scenario);
    let mut model = model.clone();
    if relative {
        // With a torque constant of one the values are ratios to it.
        model.motor.set(MotorKey::TorqueConstant, 1.0);
    }
    let balances = weak_form::fit(&model, scenario)?;
    let told = |found: ParameterEstimate| match found.verdict {
        Verdict::Fixed => found,
        _ if relative => as_ratio(found),
        _ => found,
    };
    let found = balances
        .into_iter()
        .flat_map(|balance| balance.parameters)
        .map(told);
    Ok(once_each(found.collect()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plant::Motor;
    use crate::plant::testing::record;

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
        let truth = Model::baseline(Motor::zk_22fc());
        let mut scenario = record(&truth, events, 0.002, 4.0, 7);
        scenario.input = Input::Current;
        scenario
    }

    fn near(parameters: &[ParameterEstimate], key: &str, truth: f64, within: f64) {
        let found = parameters.iter().find(|p| p.key == key).unwrap();
        let (value, std) = (found.value.unwrap(), found.std.unwrap());
        let near = (value / truth - 1.0).abs() < within && (value - truth).abs() < 4.0 * std;
        assert!(near, "{within} {found:?} {truth}");
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
        let model = Model::baseline(Motor::zk_22fc());
        for (scenario, within) in [(&whole, 0.01), (&holed, 0.02), (&apart, 0.03)] {
            let found = parameters(&model, scenario).unwrap();
            near(&found, "inertia_kg_m2", 0.0045, within);
            near(&found, "load_torque_n_m", 0.455, within);
        }
    }

    #[test]
    fn without_a_torque_constant_the_ratio_stands_in_the_reason() {
        let found = parameters(&Model::baseline(Motor::new("?")), &mechanical()).unwrap();
        let inertia = found.iter().find(|p| p.key == "inertia_kg_m2").unwrap();
        assert_eq!(
            (inertia.value, inertia.verdict),
            (None, Verdict::NotObservable)
        );
        let reason = inertia.reason.as_deref().unwrap();
        let ratio = reason
            .split_whitespace()
            .find_map(|word| word.parse::<f64>().ok());
        assert!(
            (ratio.unwrap() * 0.3538 / 0.0045 - 1.0).abs() < 0.02,
            "{reason}"
        );
    }
}
