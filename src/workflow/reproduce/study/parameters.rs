//! Coverage of the motor's parameters: how many 95 % intervals of settled values hold what the machine was made of.

use serde::Serialize;

use super::judge::Answer;
use super::tally::Bounded;
use crate::diagnosis::Diagnosis;
use crate::emulator::truth::MotorTruth;
use crate::numerics::statistics::median;
use crate::plant::MotorKey;
use crate::sample::Verdict;
use crate::workflow::reproduce::lines::KEYS;

/// One parameter of one machine, with every named effect in the model.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ParameterFinding {
    #[serde(serialize_with = "key")]
    pub parameter: MotorKey,
    pub truth: f64,
    pub value: f64,
    pub std: f64,
    pub verdict: Verdict,
}

#[expect(
    clippy::trivially_copy_pass_by_ref,
    reason = "the signature that serde asks for"
)]
fn key<S: serde::Serializer>(parameter: &MotorKey, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(parameter.key())
}

/// Standard deviations on either side of a value: its 95 % interval.
pub(super) const INTERVAL_SIGMAS: f64 = 1.96;

impl ParameterFinding {
    /// By how many of its standard deviations the value is off.
    fn sigmas(&self) -> f64 {
        (self.value - self.truth) / self.std
    }
}

/// What a motor was made of.
pub(super) const fn truths(motor: &MotorTruth) -> [(MotorKey, f64); 5] {
    [
        (MotorKey::Resistance, motor.resistance_ohm),
        (MotorKey::Inductance, motor.inductance_h),
        (MotorKey::BackEmf, motor.back_emf_v_s_per_rad),
        (MotorKey::Inertia, motor.inertia_kg_m2),
        (MotorKey::LoadTorque, motor.load_torque_n_m),
    ]
}

/// What a diagnosis says of the motor; nothing of a parameter that the runs leave undetermined.
pub(super) fn findings(motor: &MotorTruth, diagnosis: &Diagnosis) -> Vec<ParameterFinding> {
    let found = truths(motor).into_iter().filter_map(|(parameter, truth)| {
        let estimates = &diagnosis.model.parameters;
        let own = estimates.iter().find(|own| own.key == parameter.key())?;
        Some(ParameterFinding {
            parameter,
            truth,
            value: own.value?,
            std: own.std?,
            verdict: own.verdict,
        })
    });
    found.collect()
}

/// What the settled values of one parameter are worth.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Coverage {
    #[serde(serialize_with = "key")]
    pub parameter: MotorKey,
    /// Intervals that hold the truth, of those of settled values.
    pub hold: Bounded,
    /// Machines on which it was not settled.
    pub not_settled: usize,
    /// Root mean square of the errors in their standard deviations: one where the intervals are right.
    pub spread: Option<f64>,
    /// Medians of the error and of its standard deviation, %.
    pub error_percent: Option<f64>,
    pub std_percent: Option<f64>,
}

/// Coverage of each parameter over these answers.
pub fn coverage(answers: &[&Answer]) -> Vec<Coverage> {
    let all = answers.iter().flat_map(|answer| &answer.parameters);
    coverage_of(&all.collect::<Vec<_>>())
}

/// The same over what was found, of whatever machines.
pub fn coverage_of(found: &[&ParameterFinding]) -> Vec<Coverage> {
    let of_parameter = |parameter: MotorKey| {
        let (settled, open): (Vec<&ParameterFinding>, Vec<&ParameterFinding>) = found
            .iter()
            .copied()
            .filter(|own| own.parameter == parameter)
            .partition(|own| own.verdict == Verdict::Settled && own.std > 0.0);
        let holds = |own: &&&ParameterFinding| own.sigmas().abs() <= INTERVAL_SIGMAS;
        let squares: f64 = settled.iter().map(|own| own.sigmas().powi(2)).sum();
        let is_some = !settled.is_empty();
        let share = |of: fn(&ParameterFinding) -> f64| {
            let shares = settled.iter().map(|own| 100.0 * of(own) / own.truth);
            is_some.then(|| median(&shares.collect::<Vec<_>>()))
        };
        Coverage {
            parameter,
            hold: Bounded::new(settled.iter().filter(holds).count(), settled.len()),
            not_settled: open.len(),
            spread: is_some.then(|| (squares / settled.len() as f64).sqrt()),
            error_percent: share(|own| (own.value - own.truth).abs()),
            std_percent: share(|own| own.std),
        }
    };
    KEYS.into_iter().map(of_parameter).collect()
}

#[cfg(test)]
mod tests {
    use super::super::Group;
    use super::super::calibration::by_hand::answer;
    use super::*;
    use crate::diagnosis::DiagnosisVerdict;

    #[test]
    fn only_settled_values_count_and_each_by_its_own_interval() {
        let found = |value: f64, verdict: Verdict| ParameterFinding {
            parameter: MotorKey::Inertia,
            truth: 2.0,
            value,
            std: 0.1,
            verdict,
        };
        // 1 and 3 standard deviations off, and 50 that nobody relies on.
        let answer = Answer {
            parameters: vec![
                found(2.1, Verdict::Settled),
                found(1.7, Verdict::Settled),
                found(7.0, Verdict::Searching),
            ],
            ..answer(Group::Single, DiagnosisVerdict::Effect, vec![])
        };
        let all = coverage(&[&answer]);
        let own = all.iter().find(|own| own.parameter == MotorKey::Inertia);
        let own = own.unwrap();
        assert_eq!((own.hold.count, own.hold.of, own.not_settled), (1, 2, 1));
        assert!((own.spread.unwrap() - 5_f64.sqrt()).abs() < 1e-9);
        assert!((own.std_percent.unwrap() - 5.0).abs() < 1e-9);
        assert!(all[0].spread.is_none() && all[0].hold.of == 0);
    }
}
