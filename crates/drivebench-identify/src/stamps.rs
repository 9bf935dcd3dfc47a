//! Uncertainty of the time stamps and its effect on the estimates.
//!
//! The instant of a sample with a stamp of the host is uniformly distributed within plus or minus its half-width, so that a
//! signal of slope y' has the additional variance (y' half-width)^2 / 3. All signals of a sample have the same stamp: their
//! errors are correlated, for which the fits have block covariances.

use super::verdict::{self, judge};
use drivebench_model::plant::{MotorKey, Scenario, Slot};
use drivebench_model::sample::{ParameterEstimate, Reason, Verdict};

/// Standard deviation of one sample of a signal by its stamp; zero for a stamp of the drive.
pub fn spread(scenario: &Scenario, values: &[f64], sample: usize) -> f64 {
    let half_width_s = scenario.half_width_s(sample);
    if half_width_s <= 0.0 {
        return 0.0;
    }
    let times = &scenario.sample_time_s;
    let slope = |a: usize, b: usize| (values[b] - values[a]) / (times[b] - times[a]);
    let before = sample.checked_sub(1).map(|before| slope(before, sample));
    let after = (sample + 1 < times.len()).then(|| slope(sample, sample + 1));
    // The steeper side, because the other one may be before or after a step; a missing neighbour has no slope.
    let steepest = before.into_iter().chain(after).filter(|slope| slope.is_finite());
    let steepest = steepest.fold(0.0, |most, slope| f64::max(most, slope.abs()));
    steepest * half_width_s / 3f64.sqrt()
}

/// Refuses the inductance or the inertia where the half-width of the stamps exceeds a quarter of its time constant.
pub fn refuse(parameters: &mut [ParameterEstimate], half_width_s: f64) {
    let of = |key: MotorKey| ParameterEstimate::find(parameters, key.key())?.value;
    let resistance = of(MotorKey::Resistance);
    let electrical_s = of(MotorKey::Inductance).zip(resistance).map(|(l, r)| l / r);
    let mechanical = resistance.zip(of(MotorKey::Inertia)).zip(of(MotorKey::BackEmf));
    let mechanical_s = mechanical.map(|((r, j), ke)| r * j / (ke * ke));
    for (key, name, constant_s) in
        [(MotorKey::Inductance, "L/R", electrical_s), (MotorKey::Inertia, "R J/Ke^2", mechanical_s)]
    {
        let Some(constant_s) = constant_s.filter(|s| half_width_s > 0.25 * s.abs()) else {
            continue;
        };
        let reason = format!(
            "the stamps of the samples are uncertain by +-{:.1} ms, and {name} is about {:.1} ms: use the clock of the drive, or a faster line",
            1e3 * half_width_s,
            1e3 * constant_s
        );
        for parameter in parameters.iter_mut().filter(|p| p.key == key.key()) {
            verdict::refuse(parameter, Reason::StampsUncertain, reason.clone());
        }
    }
}

/// Increases each deviation by the change of the value under a voltage that is `late` by the half-width, for a method that takes the
/// stamps as exact. `period_s`: of the samples.
pub fn widen(parameters: &mut [ParameterEstimate], late: &[ParameterEstimate], period_s: f64) {
    for parameter in parameters.iter_mut() {
        let shifted = late.iter().find(|other| other.key == parameter.key);
        let Some(((value, std), shifted)) =
            parameter.value.zip(parameter.std).zip(shifted.and_then(|other| other.value))
        else {
            continue;
        };
        let Some(key) = MotorKey::from_key(&parameter.key) else { continue };
        let wider = std.hypot((shifted - value) / 3f64.sqrt());
        let judged = judge(&Slot::Motor(key), value, Some(wider), period_s);
        if parameter.verdict == Verdict::Settled || judged.value.is_none() {
            *parameter = judged;
        } else {
            parameter.std = Some(wider);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{KEYS, PAPER, assert_says, judged};

    fn found(half_width_s: f64) -> Vec<ParameterEstimate> {
        let values = KEYS.into_iter().zip(PAPER).take(4);
        let mut parameters: Vec<ParameterEstimate> = values
            .map(|(key, value)| judge(&Slot::Motor(key), value, Some(1e-3 * value), 0.01))
            .collect();
        refuse(&mut parameters, half_width_s);
        parameters
    }

    #[test]
    fn stamps_as_vague_as_l_over_r_refuse_the_inductance() {
        assert!(found(1e-3).iter().all(|p| p.verdict == Verdict::Settled));
        let vague = found(10e-3);
        judged(&vague, "inductance_h", Verdict::NotObservable);
        assert_says(&vague[1], &["10.0 ms", "9.0 ms"]);
        assert!(vague[1].value.is_none() && vague[0].value.is_some());
    }

    #[test]
    fn a_value_is_widened_by_what_a_later_voltage_makes_of_it() {
        let mut parameters = found(0.0);
        let mut late = parameters.clone();
        late[1].value = Some(0.0099 + 1.1 * 2e-3);
        late[2].value = None;
        let mut undone = parameters.clone();
        widen(&mut parameters, &late, 0.01);
        late[1].value = Some(0.03);
        widen(&mut undone, &late, 0.01);
        assert_says(&undone[1], &["at a period of 10.0 ms"]);
        let std = parameters[1].std.unwrap();
        assert!((std - 1.1 * 2e-3 / 3f64.sqrt()).abs() < 1e-4, "{std}");
        assert_eq!(parameters[1].verdict, Verdict::Searching);
        for same in [0, 2, 3] {
            assert_eq!(parameters[same], found(0.0)[same]);
        }
    }
}
