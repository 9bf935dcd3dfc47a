use super::*;
use crate::testing::{self, *};
use drivebench_model::plant::MotorKey;
use drivebench_model::sample::Verdict;

/// A run of steps both ways with a creep through zero, simulated with `model` and sampled with white noise.
pub(super) fn record(model: &Model, period_s: f64, seed: u64) -> Scenario {
    let volts = [0.0, 30.0, 60.0, -20.0, -70.0, 4.0, 8.0, -6.0, 0.0, 45.0];
    let events = held([0.0, 0.4, 0.9, 1.5, 2.2, 3.0, 3.4, 3.9, 4.4, 4.8], volts);
    testing::record(model, events, period_s, 6.0, seed)
}

fn off_by(model: &Model, factor: f64) -> Model {
    let mut off = model.clone();
    for key in MotorKey::ALL {
        if let Some(value) = off.motor.get(key) {
            off.motor.set(key, value * factor);
        }
    }
    off
}

#[test]
fn the_truth_is_found_from_thirty_per_cent_off_at_both_rates() {
    let truth = paper();
    for (period_s, tolerance) in [(0.001, 0.003), (0.01, 0.01)] {
        let fit = fit(&[off_by(&truth, 1.3)], &record(&truth, period_s, 1), &NOISE).unwrap();
        for slot in truth.slots() {
            let (found, true_value) = (fit.model.get(&slot).unwrap(), truth.get(&slot).unwrap());
            assert_near(found, true_value, tolerance);
        }
        assert!((fit.nrms - 1.0).abs() < 0.05, "{}", fit.nrms);
        let settled = |estimate: &ParameterEstimate| estimate.verdict == Verdict::Settled;
        assert!(fit.parameters.iter().all(settled), "{:?}", fit.parameters);
    }
}

#[test]
fn intervals_cover_the_truth_and_are_no_wider_than_that_takes() {
    let truth = paper();
    let (mut inside, mut within_half, mut all) = (0_u32, 0_u32, 0_u32);
    for seed in 0..30 {
        let fit = fit(std::slice::from_ref(&truth), &record(&truth, 0.005, seed), &NOISE).unwrap();
        for (slot, estimate) in truth.slots().iter().zip(&fit.parameters) {
            let z = (estimate.value.unwrap() - truth.get(slot).unwrap()) / estimate.std.unwrap();
            inside += u32::from(z.abs() < 2.1);
            // Half of all normal values.
            within_half += u32::from(z.abs() < 0.674);
            all += 1;
        }
    }
    let share = f64::from(inside) / f64::from(all);
    assert!((0.85..=1.0).contains(&share), "{share}");
    // Intervals that are far too wide cover too: half of the errors must lie beyond two thirds of a deviation. With 150
    // values that go together by fives 0.62 is three standard errors away; intervals of twice the width would cover 0.82.
    let half = f64::from(within_half) / f64::from(all);
    assert!((0.30..0.70).contains(&half), "{half}");
}

#[test]
fn a_run_that_starts_in_motion_has_its_initial_state_fitted() {
    let truth = paper();
    let mut scenario = record(&truth, 0.002, 5);
    let cut = 700;
    scenario.events.retain(|(time, _)| *time >= 0.9);
    scenario.events[0].0 = scenario.sample_time_s[cut];
    scenario.sample_time_s.drain(..cut);
    scenario.current_a.drain(..cut);
    scenario.speed_rad_s.drain(..cut);
    scenario.scored = 0..scenario.sample_time_s.len();
    let fit = fit(&[off_by(&truth, 1.1)], &scenario, &NOISE).unwrap();
    assert!(fit.nrms < 1.05, "{}", fit.nrms);
    assert!(fit.start.speed_rad_s > 100.0);
    let as_given = predict(&truth, &scenario, &NOISE).unwrap();
    assert!((as_given.start.speed_rad_s - fit.start.speed_rad_s).abs() < 0.2);
}

#[test]
fn without_motion_or_speed_only_the_winding_is_claimed() {
    let truth = paper();
    let events = held([0.0, 0.4, 2.0, 4.0], [0.0, 1.0, -1.0, 0.5]);
    let still = testing::record(&truth, events, 0.002, 6.0, 7);
    // Current alone fixes Ke^2/J and Ke Mc/J, not Ke, J and Mc.
    let mut without_speed = record(&truth, 0.002, 11);
    without_speed.speed_rad_s.fill(f64::NAN);
    let no_speed = NoiseFloor { speed_rad_s: f64::INFINITY, ..NOISE };
    for (start, scenario, noise) in
        [(&truth, still, NOISE), (&off_by(&truth, 1.2), without_speed, no_speed)]
    {
        for estimate in &fit(std::slice::from_ref(start), &scenario, &noise).unwrap().parameters {
            let electrical = ["resistance_ohm", "inductance_h"].contains(&estimate.key.as_str());
            assert_eq!(estimate.value.is_some(), electrical, "{estimate:?}");
            let is_open = estimate.verdict == Verdict::NotObservable;
            assert_eq!(is_open, !electrical, "{estimate:?}");
        }
    }
}

#[test]
fn nothing_free_and_nothing_measured_are_errors() {
    let mut truth = paper();
    let mut scenario = record(&truth, 0.01, 9);
    truth.fixed = truth.slots().iter().map(Slot::key).collect();
    let refused = fit(&[truth.clone()], &scenario, &NOISE).unwrap_err();
    assert_eq!(refused, FitError::NothingFree);
    scenario.current_a.fill(f64::NAN);
    scenario.speed_rad_s.fill(f64::NAN);
    assert!(matches!(predict(&truth, &scenario, &NOISE), Err(FitError::NothingMeasured { .. })));
}

/// Steps both ways and, before them, a dither about zero speed, which makes a shaft ring.
fn ringing(model: &Model, seed: u64) -> Scenario {
    let dither = (0..60_u32).map(|k| {
        let level_v = if (k * k + k / 3) % 5 < 2 { 9.0 } else { -8.0 };
        (0.4 + 0.03 * f64::from(k), level_v)
    });
    let steps = [(2.2, 30.0), (2.7, -25.0), (3.2, 3.0), (3.6, 0.0)];
    let events = std::iter::once((0.0, 0.0)).chain(dither).chain(steps);
    testing::record(model, events.collect(), 0.001, 4.0, seed)
}

#[test]
fn a_second_inertia_is_found_from_the_neighbour_on_the_grid() {
    let truth = [25.3, 0.47, 0.02, 0.35];
    let record = ringing(&paper_with("elastic_coupling", &truth), 4);
    // The motor as a fit without the effect leaves it.
    let start = off_by(&paper_with("elastic_coupling", &[22.0, 0.55, 0.03, 0.5]), 1.1);
    let fit = fit(&[start], &record, &NOISE).unwrap();
    let found = fit.model.effects[0].values_or_guess();
    for ((value, truth), within) in found.iter().zip(truth).zip([0.005, 0.02, 0.1, 0.1]) {
        assert_near(*value, truth, within);
    }
    assert!((fit.nrms - 1.0).abs() < 0.03, "{}", fit.nrms);
}

#[test]
fn a_speed_that_the_model_does_not_follow_is_no_steady_state() {
    // A voltage that has nothing to do with it.
    let events =
        (0..600).map(|k| (0.01 * f64::from(k), 2.0 + 2.0 * (0.37 * f64::from(k)).sin())).collect();
    let mut run = testing::record(&paper(), events, 0.01, 6.0, 3);
    for (k, speed) in run.speed_rad_s.iter_mut().enumerate() {
        let noise = 3.0 * (k as f64 * 7919.0).sin();
        *speed = 1633.0 * (1.0 - (0.02 * k as f64).cos()) + noise;
    }
    for (k, current) in run.current_a.iter_mut().enumerate() {
        *current = 0.2 + 0.3 * (k as f64 * 104_729.0).sin();
    }
    let fit = fit(&[paper()], &run, &NoiseFloor::from_spread(&run)).unwrap();
    let reasons: String = fit.parameters.into_iter().filter_map(|p| p.reason).collect();
    assert!(!reasons.contains("steady state"), "{reasons}");
    assert!(reasons.contains("does not follow them"), "{reasons}");
}

/// Without a current R and L times any factor, J and Mc over it, are the same machine.
#[test]
fn a_scale_that_no_current_tells_changes_no_residual() {
    let truth = paper();
    let mut scenario = record(&truth, 0.005, 2);
    scenario.current_a.fill(f64::NAN);
    let scaled = |factor: f64| {
        let mut model = truth.clone();
        for (key, over) in [
            (MotorKey::Resistance, 1.0),
            (MotorKey::Inductance, 1.0),
            (MotorKey::Inertia, -1.0),
            (MotorKey::LoadTorque, -1.0),
        ] {
            model.motor.set(key, truth.motor.get(key).unwrap() * factor.powf(over));
        }
        let problem = FreeRun::new(&model, &scenario, NOISE).unwrap();
        let found = problem.residuals(&problem.start()).unwrap();
        found.iter().map(|cell| cell * cell).sum::<f64>()
    };
    for factor in [1e-6, 1e6] {
        assert_near(scaled(factor), scaled(1.0), 1e-6);
    }
}
