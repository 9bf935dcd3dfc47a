use super::*;
use crate::drawn;
use crate::testing::{self, *};
use drivebench_model::plant::{FittedValue, Model, Motor};

/// The paper's motor with the inertia that gives a mechanical time constant, s.
fn plant(mechanical_s: f64) -> LinearPlant {
    testing::plant(inertia(mechanical_s))
}

fn request(rule: Rule) -> Request {
    Request { rule, ..Request::default() }
}

#[test]
fn the_modulus_optimum_is_the_textbooks() {
    let tuning = tune(&plant(0.2), &timing(2.0), &request(Rule::ModulusOptimum)).unwrap();
    // Two real poles: 1/large + 1/small = 1/Ta, large + small = TM.
    let small_s = 0.5 * (0.2 - (0.04_f64 - 4.0 * 0.2 * 0.009).sqrt());
    assert_close(tuning.gains.integral_time_s, 0.2 - small_s, 1e-9);
    let expected = 0.3538 * (0.2 - small_s) / (2.0 * (small_s + 0.025));
    assert_close(tuning.gains.proportional, expected, 1e-9);
    // 4.3 % of a second-order loop; the dead time is a lag only to first order.
    let (response, margins) = (&tuning.response, &tuning.margins);
    assert!((2.0..8.0).contains(&response.overshoot_percent), "{response:?}");
    assert!(margins.phase_margin_deg > 55.0, "{margins:?}");
}

#[test]
fn every_rule_holds_its_margins_over_motors_and_delays() {
    for rule in Rule::ALL {
        for mechanical_s in [0.01, 0.02, 0.036, 0.05, 0.2, 1.0, 10.0] {
            for cycles in [0.0, 0.7, 1.0, 2.0, 4.5] {
                let tuning = tune(&plant(mechanical_s), &timing(cycles), &request(rule));
                let name = format!("{rule:?}, TM {mechanical_s} s, {cycles} cycles");
                let response = tuning.unwrap_or_else(|error| panic!("{name}: {error}")).response;
                let is_good = response.overshoot_percent < 12.0 && response.settling_s.is_some();
                assert!(is_good, "{name}: {response:?}");
            }
        }
    }
}

#[test]
fn an_untuned_delay_of_two_cycles_costs_overshoot() {
    // Tuned for the hold alone.
    let untuned = tune(&plant(0.2), &timing(0.0), &request(Rule::ModulusOptimum)).unwrap();
    let overshoot = |cycles| {
        let shape = LoopShape::new(&plant(0.2), &timing(cycles), &untuned.gains);
        let trace: Vec<_> = shape.step_response(4.0).iter().map(|p| (p.time_s, p.speed)).collect();
        response(&trace, 0.0, 1.0).overshoot_percent
    };
    let (none, two) = (overshoot(0.0), overshoot(2.0));
    assert!(none < 10.0 && two > 40.0, "{none} {two}");
}

#[test]
fn a_bandwidth_is_met_or_refused_with_the_reachable_one() {
    let tuned = |bandwidth| {
        let bandwidth_rad_s = Some(bandwidth);
        let request = Request { bandwidth_rad_s, ..request(Rule::PolePlacement) };
        tune(&plant(0.2), &timing(2.0), &request)
    };
    assert_close(tuned(3.0).unwrap().margins.bandwidth_rad_s, 3.0, 1e-3);
    let Err(TuningError::Bandwidth { reachable, .. }) = tuned(300.0) else {
        panic!("300 rad/s was not refused");
    };
    assert!(tuned(0.99 * reachable).is_ok() && tuned(1.01 * reachable).is_err());
    assert!(matches!(tuned(f64::NAN), Err(TuningError::NoBandwidth(_))));
}

#[test]
fn a_current_command_needs_a_rule_for_integrators() {
    let plant = LinearPlant::current(&Model::baseline(Motor::zk_22fc()), 0.0, 0.002).unwrap();
    let error = tune(&plant, &timing(1.0), &request(Rule::ModulusOptimum)).unwrap_err();
    assert!(matches!(error, TuningError::Integrates { .. }));
    for rule in [Rule::SymmetricalOptimum, Rule::PolePlacement] {
        let response = tune(&plant, &timing(1.0), &request(rule)).unwrap().response;
        assert!(response.overshoot_percent < 12.0, "{rule:?} {response:?}");
    }
}

#[test]
fn an_invalid_timing_is_refused() {
    let nonsense = LoopTiming { period_s: f64::NAN, ..timing(0.0) };
    let error = tune(&plant(0.2), &nonsense, &Request::default()).unwrap_err();
    assert!(matches!(error, TuningError::Timing { .. }));
}

/// A loop of 500 Hz.
fn quick(cycles: f64) -> LoopTiming {
    LoopTiming { period_s: 0.002, delay_s: 0.002 * cycles, filter_s: 0.0 }
}

/// The paper's motor behind a current command, with half of its inertia behind a coupling of 22 Hz.
fn elastic_over_current(damping_ratio: f64) -> LinearPlant {
    LinearPlant::current(&elastic(0.5, damping_ratio), 0.0, 0.002).unwrap()
}

#[test]
fn a_notch_is_used_where_it_keeps_bandwidth() {
    for (damping_ratio, cycles) in [(0.02, 1.0), (0.02, 2.0), (0.005, 2.0)] {
        let plant = elastic_over_current(damping_ratio);
        let with = request(Rule::SymmetricalOptimum);
        let both = [with, Request { notch: NotchUse::Off, ..with }]
            .map(|request| tune(&plant, &quick(cycles), &request).unwrap());
        for tuning in &both {
            assert!(is_safe(&tuning.margins), "{:?}", tuning.margins);
            assert!(tuning.response.settling_s.is_some());
        }
        let [with_hz, without_hz] =
            both.each_ref().map(|one| one.margins.bandwidth_rad_s / std::f64::consts::TAU);
        assert!(with_hz > 1.1 * without_hz, "{with_hz} {without_hz}");
        let [with, without] = both;
        assert!(without.gains.notch.is_none());
        let reason = format!(
            "a notch at 22.0 Hz keeps {with_hz:.1} Hz of bandwidth; without it {without_hz:.1} Hz"
        );
        assert!(with.reasons.iter().any(|one| one.contains(&reason)), "{:?}", with.reasons);
    }
}

#[test]
fn a_loop_far_below_its_resonance_needs_no_notch() {
    let plant = LinearPlant::voltage(&elastic(0.5, 0.02), 0.0).unwrap();
    let rule = request(Rule::ModulusOptimum);
    let tuning = tune(&plant, &quick(1.0), &rule).unwrap();
    let rigid = tune(&plant.rigid(), &quick(1.0), &rule).unwrap();
    assert_eq!(tuning.gains, rigid.gains);
    assert!(tuning.margins.gain_margin < 0.5 * rigid.margins.gain_margin);
    let reason = |reason: &String| reason.contains("no notch is needed");
    assert!(tuning.reasons.iter().any(reason), "{:?}", tuning.reasons);
}

#[test]
fn the_worst_draw_keeps_margins_that_the_mean_would_lose() {
    // Lighter and heavier motors, other frequencies.
    let nominal = elastic_over_current(0.02);
    let scaled = |n: u32| nominal.with_inertia_ratio(0.6 + 0.02 * f64::from(n));
    let draws: Vec<LinearPlant> = (0..40).map(scaled).collect();
    let rule = request(Rule::SymmetricalOptimum);
    let margins = |plant: &LinearPlant, tuning: &Tuning| {
        LoopShape::new(plant, &quick(2.0), &tuning.gains).margins()
    };
    let untuned = tune(&nominal, &quick(2.0), &rule).unwrap();
    assert!(draws.iter().any(|plant| !is_safe(&margins(plant, &untuned))));
    let mut tuning = tune_over(&nominal, &draws, &quick(2.0), &rule).unwrap();
    let drawn = tuning.draws.clone().unwrap();
    assert_eq!((drawn.count, drawn.hardest.len()), (40, 8));
    assert!(is_safe(&drawn.worst) && drawn.stable_share > 0.999, "{drawn:?}");
    assert!(drawn.worst.gain_margin < tuning.margins.gain_margin);
    for plant in &draws {
        let margins = margins(plant, &tuning);
        assert!(margins.phase_margin_deg >= drawn.worst.phase_margin_deg);
        assert!(is_safe(&margins), "{margins:?}");
    }
    tuning.put_band(&draws);
    for point in &tuning.step {
        let (low, high) = (point.low.unwrap(), point.high.unwrap());
        assert!(low <= high && low < point.speed + 0.05 && high > point.speed - 0.05);
    }
    assert!(tuning.step.iter().any(|point| point.high.unwrap() > point.low.unwrap() + 0.1));
}

#[test]
fn draws_without_common_gains_are_refused_with_their_number() {
    let draws = [0.001, 1.0, 1000.0].map(|ratio| plant(0.2).with_inertia_ratio(ratio));
    let error = tune_over(&plant(0.2), &draws, &timing(1.0), &Request::default()).unwrap_err();
    assert!(matches!(error, TuningError::Margins { draws: 3, .. }), "{error:?}");
    assert!(error.to_string().contains("in the worst of 3 draws of the parameters (needed"));
}

#[test]
fn a_motor_within_its_backlash_is_stable_too() {
    // Nine tenths of the inertia are behind the backlash: alone the motor is ten times as quick.
    let model = with(&testing::model(0.0045), "backlash", &[0.02, 60.0, 0.9, 0.1, 0.5]);
    let loose = LinearPlant::current(&model, 0.0, 0.002).unwrap();
    let alone = |plant: &LinearPlant| {
        let tuning = tune(plant, &timing(2.0), &request(Rule::SymmetricalOptimum)).unwrap();
        LoopShape::new(&loose.uncoupled().unwrap(), &timing(2.0), &tuning.gains).radius()
    };
    assert!(alone(&loose) < 1.0);
    assert!(alone(&loose.rigid()) > 1.0);
}

/// The coupling as it is, and as a fit has it: frequency 1 %, share 5 %, damping 20 % away, either way.
#[test]
fn a_fitted_model_gives_nearly_the_bandwidth_of_the_true_one() {
    let plant = |model: &Model| LinearPlant::current(model, 0.0, 0.002);
    let truth = plant(&elastic(0.5, 0.02)).unwrap();
    let fitted = [
        ("elastic_coupling.frequency_hz", 0.22),
        ("elastic_coupling.inertia_ratio", 0.025),
        ("elastic_coupling.damping_ratio", 0.004),
        ("inertia_kg_m2", 0.00005),
    ]
    .map(|(key, std)| FittedValue { key: key.to_owned(), std });
    for (cycles, sign) in [(1.0, -1.0), (1.0, 1.0), (2.0, -1.0), (2.0, 1.0)] {
        let mut model = elastic(0.5, 0.02);
        for (value, error) in model.effects[0].values.iter_mut().zip([0.01, 0.05, 0.2]) {
            *value = value.map(|value| value * (1.0 + sign * error));
        }
        let rule = request(Rule::SymmetricalOptimum);
        let known = tune(&truth, &quick(cycles), &rule).unwrap();
        let draws = drawn(&model, &fitted, plant);
        let found = tune_over(&plant(&model).unwrap(), &draws, &quick(cycles), &rule).unwrap();
        let there = LoopShape::new(&truth, &quick(cycles), &found.gains).margins();
        let [full, reached] = [known.margins, there].map(|margins| margins.bandwidth_rad_s);
        assert!(is_safe(&there), "{there:?}");
        assert!((reached / full - 1.0).abs() < 0.2, "{cycles} {sign}: {reached} {full}");
    }
}
