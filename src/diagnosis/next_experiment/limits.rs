//! What a recommended run may reach.

use crate::diagnosis::Evidence;
use crate::numerics::statistics::median;
use crate::plant::Scenario;

/// Largest magnitudes of a run that is still to be made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExperimentLimits {
    pub voltage_v: f64,
    pub current_a: f64,
    pub speed_rad_s: f64,
    /// Root mean square of the current over the run: the heat in the winding.
    pub rms_current_a: f64,
    /// Distance from the angle at the start; none: the shaft turns freely.
    pub travel_rad: Option<f64>,
    pub duration_s: f64,
    /// Largest change of the voltage; infinite: as fast as the current allows.
    pub slew_v_per_s: f64,
    /// Time between two commands.
    pub period_s: f64,
}

/// Longest run where nothing else limits it, s.
const LONGEST_RUN_S: f64 = 60.0;

impl ExperimentLimits {
    /// Nothing beyond what the runs in hand have reached, with the heat of all of them in the time of one.
    pub fn seen_in(evidence: &Evidence) -> Self {
        let mut limits = Self {
            voltage_v: 0.0,
            current_a: 0.0,
            speed_rad_s: 0.0,
            rms_current_a: 0.0,
            travel_rad: None,
            duration_s: LONGEST_RUN_S,
            slew_v_per_s: 0.0,
            period_s: period_s(&evidence.training),
        };
        let mut runs = vec![&evidence.training];
        // A split hold-out is the same run.
        if evidence.holdout_from == crate::diagnosis::HoldoutFrom::Run {
            runs.push(&evidence.holdout);
        } else {
            runs[0] = &evidence.holdout;
        }
        runs.extend(&evidence.confirm);
        let (mut heat, mut longest_s) = (0.0, 0.0_f64);
        for run in runs {
            let voltages: Vec<f64> = run.events.iter().map(|event| event.1).collect();
            limits.voltage_v = limits.voltage_v.max(largest(&voltages));
            limits.slew_v_per_s = limits.slew_v_per_s.max(slew_v_per_s(run));
            limits.current_a = limits.current_a.max(largest(&run.current_a));
            limits.speed_rad_s = limits.speed_rad_s.max(largest(&run.speed_rad_s));
            let duration_s = duration_s(run);
            heat += mean_square(&run.current_a) * duration_s;
            longest_s = longest_s.max(duration_s);
        }
        limits.rms_current_a = (heat / longest_s.max(f64::MIN_POSITIVE)).sqrt();
        // A signal that was not recorded limits nothing that can be checked.
        for limit in [
            &mut limits.current_a,
            &mut limits.speed_rad_s,
            &mut limits.rms_current_a,
            &mut limits.slew_v_per_s,
        ] {
            if *limit <= 0.0 {
                *limit = f64::INFINITY;
            }
        }
        limits
    }
}

fn largest(values: &[f64]) -> f64 {
    // `max` drops NaN, a missing value.
    values
        .iter()
        .fold(0.0, |most, value| f64::max(most, value.abs()))
}

/// Time between two samples, s.
fn period_s(run: &Scenario) -> f64 {
    let steps: Vec<f64> = run
        .sample_time_s
        .windows(2)
        .map(|pair| pair[1] - pair[0])
        .collect();
    // A stamp carries rounding; nobody asks for more than microseconds.
    (median(&steps) * 1e6).round() * 1e-6
}

/// Largest change of the voltage from one event to the next, which is made within a sample.
fn slew_v_per_s(run: &Scenario) -> f64 {
    let changes: Vec<f64> = run
        .events
        .windows(2)
        .map(|pair| pair[1].1 - pair[0].1)
        .collect();
    largest(&changes) / period_s(run).max(f64::MIN_POSITIVE)
}

fn mean_square(values: &[f64]) -> f64 {
    let present: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
    present.iter().map(|v| v * v).sum::<f64>() / present.len().max(1) as f64
}

fn duration_s(run: &Scenario) -> f64 {
    run.sample_time_s[run.samples() - 1] - run.sample_time_s[0]
}
