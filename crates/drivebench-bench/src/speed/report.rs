//! Report of a closed loop: timing, gains with their reasons, and the response to each step of the reference.

use serde::Serialize;

use super::delay::LoopDelay;
use super::reference::ReferenceStep;
use drivebench_control::{Actuator, Adapted, LoopTiming, Response, SETTLED_SHARE, response};

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct GainChange {
    /// Since the begin of the reference, s.
    pub time_s: f64,
    pub reason: String,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Watched {
    /// Since the begin of the reference, s.
    pub time_s: f64,
    pub found: &'static str,
    /// Amplitude, rad/s; of a loop at its limit the error that does not fall.
    pub error_rad_s: f64,
    pub gain_share: f64,
    pub reason: String,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct StepFigures {
    #[serde(flatten)]
    pub step: ReferenceStep,
    /// When the output began to change, rad/s: the response counts from there, its times from the instant of the step on, its
    /// error against the reference of each instant.
    pub speed_rad_s: f64,
    #[serde(flatten)]
    pub response: Response,
    /// The settling band is narrower than 2.5 standard deviations of a sample: there is no settling time.
    pub settles_in_noise: bool,
    /// Largest output, actuator's unit, and share of the cycles in which a limit held it.
    pub peak_output: f64,
    pub limited_share: f64,
}

/// How the reference was followed in one pass over it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Tracking {
    pub feed_forward: bool,
    pub from_s: f64,
    pub until_s: f64,
    /// Root of the mean square of the error, its largest size, its mean size, rad/s.
    pub rms_rad_s: f64,
    pub peak_rad_s: f64,
    pub mean_abs_rad_s: f64,
    /// Root of the mean square while the reference passes zero, 0.1 s to either side; null where it never does.
    pub reversal_rms_rad_s: Option<f64>,
}

/// One cycle of the record that figures are made of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Cycle {
    pub(super) time_s: f64,
    pub(super) reference_rad_s: f64,
    pub(super) speed_rad_s: f64,
    pub(super) output: f64,
    pub(super) limited: bool,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SpeedReport {
    pub controller: &'static str,
    pub actuator: Actuator,
    pub timing: LoopTiming,
    /// While it ran.
    pub delay: Option<LoopDelay>,
    /// Before the motor moved.
    pub reasons: Vec<String>,
    /// At the end.
    pub gains: Vec<String>,
    pub gain_changes: Vec<GainChange>,
    pub watch: Vec<Watched>,
    /// Gains and estimates, cycle by cycle, as CSV; `None`: fixed gains.
    #[serde(skip)]
    pub adaptation: Option<String>,
    /// Cycles without a speed, in which the last output was held.
    pub held_cycles: u64,
    /// One for each pass over the reference that came to its end.
    pub tracking: Vec<Tracking>,
    pub steps: Vec<StepFigures>,
}

/// Gains and estimates over the drive's time: one row for each sample of the controller; an empty cell is not known, or not
/// settled.
pub(super) fn adaptation_csv(actuator: Actuator, rows: &[(f64, Adapted)]) -> Option<String> {
    let unit = match actuator {
        Actuator::Voltage => "v_s_per_rad",
        Actuator::Current => "a_s_per_rad",
        Actuator::Speed => "1",
    };
    let head = format!("time_s,kp_{unit},tn_s,tm_s,ta_s,inertia_kg_m2,load_torque_n_m\n");
    (!rows.is_empty()).then(|| {
        rows.iter().fold(head, |mut text, (time_s, now)| {
            let cells = [
                Some(*time_s),
                Some(now.proportional),
                Some(now.integral_time_s),
                now.mechanical_s,
                now.electrical_s,
                now.inertia_kg_m2,
                now.load_torque_n_m,
            ];
            let cells = cells.map(|cell| cell.map_or_else(String::new, |value| value.to_string()));
            text.push_str(&cells.join(","));
            text.push('\n');
            text
        })
    })
}

/// The cycles from one instant to another, s; `None` where the record does not reach the end of it, or has none.
fn cycles(record: &[Cycle], from_s: f64, until_s: f64) -> Option<&[Cycle]> {
    let end_s = record.last().map_or(0.0, |cycle| cycle.time_s);
    let period_s = end_s / record.len().max(1) as f64;
    let at = |time_s| record.partition_point(|cycle| cycle.time_s < time_s);
    let cycles = record.get(at(from_s)..at(until_s))?;
    (until_s <= end_s + 2.0 * period_s && !cycles.is_empty()).then_some(cycles)
}

/// Within 0.1 s of the instants at which the reference changes its direction.
fn around_reversals(cycles: &[Cycle]) -> impl Iterator<Item = &Cycle> {
    let mut turning = cycles.iter().filter(|cycle| cycle.reference_rad_s != 0.0).peekable();
    let mut at_s = Vec::new();
    while let (Some(before), Some(after)) = (turning.next(), turning.peek()) {
        if before.reference_rad_s * after.reference_rad_s < 0.0 {
            at_s.push(0.5 * (before.time_s + after.time_s));
        }
    }
    let near = move |cycle: &&Cycle| {
        let next = at_s.partition_point(|at| *at < cycle.time_s - 0.1);
        at_s.get(next).is_some_and(|at| *at <= cycle.time_s + 0.1)
    };
    cycles.iter().filter(near)
}

/// The error of each pass that the record reaches the end of.
pub(super) fn tracking(record: &[Cycle], passes: &[(bool, (f64, f64))]) -> Vec<Tracking> {
    let track = |&(feed_forward, (from_s, until_s)): &(bool, (f64, f64))| {
        let cycles = cycles(record, from_s, until_s)?;
        let error = |cycle: &Cycle| (cycle.reference_rad_s - cycle.speed_rad_s).abs();
        let rms = |errors: &[f64]| {
            (errors.iter().map(|error| error * error).sum::<f64>() / errors.len() as f64).sqrt()
        };
        let errors: Vec<f64> = cycles.iter().map(error).collect();
        let reversing: Vec<f64> = around_reversals(cycles).map(error).collect();
        Some(Tracking {
            feed_forward,
            from_s,
            until_s,
            rms_rad_s: rms(&errors),
            peak_rad_s: errors.iter().copied().fold(0.0, f64::max),
            mean_abs_rad_s: errors.iter().sum::<f64>() / errors.len() as f64,
            reversal_rms_rad_s: (!reversing.is_empty()).then(|| rms(&reversing)),
        })
    };
    passes.iter().filter_map(track).collect()
}

/// Figures of the steps that the record reaches; a step that a stop cut short has none. `leads_s`: the time before a change of
/// the reference at an instant at which its output begins to change.
pub(super) fn figures(
    record: &[Cycle],
    steps: &[ReferenceStep],
    leads_s: &dyn Fn(f64) -> f64,
    noise_rad_s: f64,
) -> Vec<StepFigures> {
    let figure = |step: &ReferenceStep| {
        let until_s = step.until_s - leads_s(step.until_s);
        let cycles = cycles(record, step.at_s - leads_s(step.at_s), until_s)?;
        let Cycle { time_s: begin_s, speed_rad_s, .. } = *cycles.first()?;
        let trace: Vec<(f64, f64)> =
            cycles.iter().map(|cycle| (cycle.time_s, cycle.speed_rad_s)).collect();
        let early_s = (step.at_s - begin_s).max(0.0);
        let response = response(&trace, speed_rad_s, step.to_rad_s);
        let errors = cycles.windows(2).map(|pair| {
            let error = pair[0].reference_rad_s - pair[0].speed_rad_s;
            error.abs() * (pair[1].time_s - pair[0].time_s)
        });
        let limited = cycles.iter().filter(|cycle| cycle.limited).count();
        let peak = cycles.iter().map(|cycle| cycle.output.abs());
        let band_rad_s = SETTLED_SHARE * (step.to_rad_s - speed_rad_s).abs();
        let settles_in_noise = band_rad_s < 2.5 * noise_rad_s;
        let settling_s = response.settling_s.filter(|_| !settles_in_noise);
        Some(StepFigures {
            step: *step,
            speed_rad_s,
            settles_in_noise,
            response: Response {
                settling_s: settling_s.map(|time_s| (time_s - early_s).max(0.0)),
                absolute_error_rad: errors.sum(),
                ..response
            },
            peak_output: peak.fold(0.0, f64::max),
            limited_share: limited as f64 / cycles.len() as f64,
        })
    };
    steps.iter().filter_map(figure).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::near;

    #[test]
    fn unknown_cells_of_the_adaptation_are_empty() {
        let now = Adapted {
            proportional: 1.5,
            integral_time_s: 0.25,
            mechanical_s: Some(0.2),
            electrical_s: None,
            inertia_kg_m2: Some(0.0225),
            load_torque_n_m: None,
        };
        let text = adaptation_csv(Actuator::Voltage, &[(10.25, now)]).unwrap();
        assert_eq!(
            text,
            "time_s,kp_v_s_per_rad,tn_s,tm_s,ta_s,inertia_kg_m2,load_torque_n_m\n10.25,1.5,0.25,0.2,,0.0225,\n"
        );
        assert_eq!(adaptation_csv(Actuator::Voltage, &[]), None);
    }

    fn step((at_s, until_s, from_rad_s, to_rad_s): (f64, f64, f64, f64)) -> ReferenceStep {
        ReferenceStep { at_s, until_s, from_rad_s, to_rad_s }
    }

    /// Reference and speed over the time, in cycles of 10 ms; output and limit from the number of the cycle.
    fn record(cycles: i32, at: impl Fn(f64) -> (f64, f64)) -> Vec<Cycle> {
        let cycle = |n: i32| {
            let time_s = f64::from(n) * 0.01;
            let (reference_rad_s, speed_rad_s) = at(time_s);
            Cycle { time_s, reference_rad_s, speed_rad_s, output: f64::from(n), limited: n < 25 }
        };
        (0..cycles).map(cycle).collect()
    }

    #[test]
    fn each_step_has_the_figures_of_its_own_time() {
        let steps = [(0.0, 1.0, 0.0, 10.0), (1.0, 2.0, 10.0, 20.0), (2.0, 9.0, 20.0, 0.0)];
        let steps = steps.map(step);
        // A lag of 0.1 s, and 20 % beyond at one instant of the second step; the third is cut short.
        let record = record(250, |time_s| {
            let to = if time_s < 1.0 { 10.0 } else { 20.0 };
            let lag = to - 10.0 * (-(time_s % 1.0) / 0.1).exp();
            (to, if (time_s - 1.5).abs() < 1e-9 { 22.0 } else { lag })
        });
        let found = figures(&record, &steps, &|_| 0.0, 0.0);
        assert_eq!(found.len(), 2);
        assert!(found[0].response.overshoot_percent < 1e-9);
        assert!((found[0].response.settling_s.unwrap() - 0.3).abs() < 0.011);
        assert!((found[0].limited_share - 0.25).abs() < 1e-12);
        assert!((found[1].response.overshoot_percent - 20.0).abs() < 0.1);
        assert!((found[1].response.settling_s.unwrap() - 0.51).abs() < 1e-6);
        assert!((found[1].peak_output - 199.0).abs() < 1e-12);
        let passes = [(false, (0.0, 1.0)), (true, (1.0, 2.0)), (true, (2.0, 9.0))];
        let tracked = tracking(&record, &passes);
        // The third is cut short. Of the lag: the mean of 10 exp(-t/0.1) over a second, and of its square.
        assert_eq!(tracked.len(), 2);
        assert!(!tracked[0].feed_forward && tracked[1].feed_forward);
        near(tracked[0].mean_abs_rad_s, 1.05, 0.01);
        assert!((tracked[0].rms_rad_s - 2.35).abs() < 0.02, "{tracked:?}");
        assert!((tracked[0].peak_rad_s - 10.0).abs() < 1e-9);
        assert_eq!(tracked[0].reversal_rms_rad_s, None);
    }

    #[test]
    fn an_early_response_belongs_to_its_own_step() {
        let steps = [(1.0, 2.0, 0.0, 10.0), (2.0, 3.0, 10.0, 0.0)].map(step);
        // There within 0.04 s, half of them before the reference.
        let record = record(310, |time_s| {
            let ramp = |at_s: f64| 10.0 * ((time_s - at_s + 0.02) / 0.04).clamp(0.0, 1.0);
            let reference = if (1.0..2.0).contains(&time_s) { 10.0 } else { 0.0 };
            (reference, ramp(1.0) - ramp(2.0))
        });
        for found in figures(&record, &steps, &|_| 0.02, 0.1) {
            assert!(found.response.settling_s.unwrap() < 0.021, "{found:?}");
            near(found.response.absolute_error_rad, 0.1, 0.03);
            assert!(found.response.overshoot_percent < 1e-9);
        }
        assert_eq!(figures(&record, &steps, &|_| 0.0, 0.1)[0].response.settling_s, None);
        let noisy = figures(&record, &steps, &|_| 0.02, 0.3);
        assert!(noisy[0].settles_in_noise && noisy[0].response.settling_s.is_none());
    }

    #[test]
    fn the_error_of_a_reversal_is_that_of_the_cycles_about_it() {
        // From 5 to -5 rad/s, at rest in between; off by 2 for 0.1 s about zero and by 1 elsewhere.
        let record = record(200, |time_s| {
            let reference = (100.0 - 100.0 * time_s).round().clamp(-5.0, 5.0);
            let is_near = (time_s - 1.0).abs() < 0.104;
            (reference, reference - if is_near { 2.0 } else { 1.0 })
        });
        let tracked = tracking(&record, &[(false, (0.0, 1.99))]);
        near(tracked[0].reversal_rms_rad_s.unwrap(), 2.0, 1e-9);
        assert!(tracked[0].rms_rad_s < 1.3);
    }
}
