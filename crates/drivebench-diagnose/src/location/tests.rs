//! Runs with a known fault, at 1 and at 10 ms: the first location must be that of the fault.

use std::f64::consts::TAU;

use super::*;
use crate::kit::{nameplate, truth};
use drivebench_identify::output_error;
use drivebench_model::plant::{Plant, State, testing};

/// Both directions, slow passages through zero, dither of 40 ms; another run for each seed.
fn record(truth: &Model, period_s: f64, seed: u64) -> Scenario {
    let levels = [30.0, 80.0, 45.0, 6.0, -6.0, -45.0, -90.0, -20.0, 5.0, 60.0, 100.0, -70.0];
    let event = |step: u64| {
        let level = levels[((step / 12 + 5 * seed) % 12) as usize];
        // A small generator of signs; each run has another dither.
        let is_below = (step * step * 7 + step * 3 + seed * 11) % 5 < 2;
        (0.4 + 0.04 * step as f64, level + if is_below { -5.0 } else { 5.0 })
    };
    let events = std::iter::once((0.0, 0.0)).chain((0..150).map(event));
    testing::record(truth, events.collect(), period_s, 6.4, seed)
}

fn floor(run: &Scenario) -> NoiseFloor {
    NoiseFloor::from_standstill(run).unwrap()
}

/// The baseline fitted to one run of the truth and located on another.
fn located(truth: &Model, period_s: f64, error_of: ErrorOf) -> Located {
    let run = record(truth, period_s, 1);
    let fit = output_error::fit(&[nameplate()], &run, &floor(&run)).unwrap();
    locate(&fit.model, &record(truth, period_s, 2), &floor(&run), error_of).unwrap()
}

/// Where the error lies first: in this equation, along this variable.
fn first<'a>(found: &'a Located, place: (&str, &str), case: &str) -> &'a FailureLocation {
    let first = &found.locations[0];
    assert_eq!((first.equation, first.variable), place, "{case}: {found:#?}");
    first
}

#[test]
fn a_right_model_has_balances_at_the_noise_and_no_location() {
    for period_s in [0.001, 0.01] {
        let found = located(&nameplate(), period_s, ErrorOf::Model);
        assert_eq!(found.locations, vec![], "{period_s} s");
        assert_eq!(found.balances.len(), 2);
        for balance in &found.balances {
            assert!((0.85..1.15).contains(&balance.nres.unwrap()), "{period_s} s: {balance:?}");
            assert_eq!(balance.state, EquationState::Holds);
        }
    }
}

#[test]
fn the_first_location_has_equation_and_axis() {
    let cases: [(&str, &[f64], f64, &str, &str); 7] = [
        ("stribeck_friction", &[0.2, 10.0], 0.001, "torque", "speed_rad_s"),
        ("quadratic_load", &[3e-6], 0.001, "torque", "speed_rad_s"),
        ("quadratic_load", &[3e-6], 0.01, "torque", "speed_rad_s"),
        ("voltage_drop", &[1.0], 0.001, "voltage", "current_a"),
        ("voltage_drop", &[1.0], 0.01, "voltage", "current_a"),
        ("winding_heating", &[0.004, 20.0], 0.001, "voltage", "time_s"),
        ("constant_load", &[0.1], 0.001, "torque", "offset_n_m"),
    ];
    for (id, values, period_s, equation, variable) in cases {
        let found = located(&truth(id, values), period_s, ErrorOf::Model);
        let first = first(&found, (equation, variable), &format!("{id} at {period_s} s"));
        assert_eq!(found.balances[0].equation, equation);
        assert!(found.balances[0].nres.unwrap() > 1.3 && found.balances[0].fails);
        assert!(first.from < first.to && first.share_of_error > 0.5, "{first:?}");
    }
}

#[test]
fn stribeck_friction_is_located_at_low_speed() {
    let found = located(&truth("stribeck_friction", &[0.2, 10.0]), 0.001, ErrorOf::Structure);
    let first = &found.locations[0];
    assert!(first.to < 30.0 && first.from > -30.0, "{first:?}");
    assert!(first.share_of_time < 0.3 && first.share_of_error > 0.6, "{first:?}");
}

#[test]
fn a_wrong_value_of_the_motor_is_reported_as_one() {
    let run = record(&nameplate(), 0.001, 3);
    for (key, factor, equation, variable) in [
        (MotorKey::Resistance, 0.8, "voltage", "current_a"),
        (MotorKey::BackEmf, 1.05, "voltage", "speed_rad_s"),
        (MotorKey::Inertia, 1.2, "torque", "acceleration_rad_s2"),
        (MotorKey::LoadTorque, 0.7, "torque", "direction"),
    ] {
        let mut wrong = nameplate();
        // The torque constant stays: a wrong back-EMF constant alone.
        wrong.motor.set(MotorKey::TorqueConstant, 0.3538);
        let value = wrong.motor.get(key).unwrap();
        wrong.motor.set(key, factor * value);
        let found = locate(&wrong, &run, &floor(&run), ErrorOf::Model).unwrap();
        first(&found, (equation, variable), key.key());
        let mut changes = found.balances[0].own_changes.iter();
        let change = changes.find(|change| change.key == key.key()).unwrap();
        let off = change.by / ((1.0 - factor) * value) - 1.0;
        assert!(off.abs() < 0.05, "{change:?}");
        // It is no error of the structure.
        let structure = locate(&wrong, &run, &floor(&run), ErrorOf::Structure).unwrap();
        assert_eq!(structure.locations, vec![], "{key:?}");
    }
}

#[test]
fn an_exact_model_of_a_run_without_noise_fails_nowhere() {
    let mut run = record(&nameplate(), 0.001, 4);
    let exact = Plant::new(&nameplate(), Input::Voltage).unwrap().simulate(&run, State::default());
    (run.current_a, run.speed_rad_s) = (exact.current_a, exact.speed_rad_s);
    let noise = NoiseFloor::from_spread(&run);
    let found = locate(&nameplate(), &run, &noise, ErrorOf::Model).unwrap();
    assert_eq!(found.locations, vec![]);
    let holds = |balance: &EquationBalance| balance.nres.is_none() && !balance.fails;
    assert!(found.balances.iter().all(holds), "{:?}", found.balances);
}

#[test]
fn a_missing_signal_and_a_short_run_are_noted() {
    let mut run = record(&nameplate(), 0.001, 5);
    let noise = floor(&run);
    run.current_a.fill(f64::NAN);
    let found = locate(&nameplate(), &run, &noise, ErrorOf::Model).unwrap();
    assert!(found.balances.is_empty());
    assert_eq!(found.notes, [Limit::NotMeasured { signal: "current" }]);
    let (short, _) = record(&nameplate(), 0.001, 6).split(0.1);
    let found = locate(&nameplate(), &short, &noise, ErrorOf::Model).unwrap();
    let is_short = |note: &Limit| matches!(note, Limit::FewWindows { .. });
    assert!(found.notes.iter().any(is_short), "{:?}", found.notes);
}

#[test]
fn the_map_counts_every_window_once() {
    let run = record(&nameplate(), 0.001, 7);
    let map = locate(&nameplate(), &run, &floor(&run), ErrorOf::Model).unwrap().map.unwrap();
    let windows = Windows::new(&nameplate(), &run, &floor(&run), FEWEST_HALF).unwrap();
    assert_eq!(map.count.iter().flatten().sum::<usize>(), windows.each.len());
    for (counts, errors) in map.count.iter().zip(&map.voltage_rms_v) {
        for (count, error) in counts.iter().zip(errors) {
            assert_eq!(*count > 0, error.is_some());
        }
    }
}

/// A torque outside of every model: a shaker at 7.3 Hz, added to the run.
#[test]
fn a_shaker_is_a_line_at_its_frequency() {
    let mut run = record(&nameplate(), 0.001, 8);
    let mut noise = floor(&run);
    noise.samples = 400;
    // The speed that such a torque alone adds: amplitude / (J w), a quarter of a period late.
    let (w, torque_n_m) = (TAU * 7.3, 0.15);
    for (speed, time_s) in run.speed_rad_s.iter_mut().zip(&run.sample_time_s) {
        *speed += torque_n_m / (0.0045 * w) * (w * time_s).cos();
    }
    let found = locate(&nameplate(), &run, &noise, ErrorOf::Structure).unwrap();
    let line = found.locations.iter().find(|l| l.variable == "frequency_hz").unwrap();
    assert!(line.from <= 7.32 && line.to >= 7.28 && line.to - line.from < 0.3, "{line:?}");
    assert_eq!(line.equation, "torque");
    let ErrorForm::Line { amplitude } = line.form else { panic!("{line:?}") };
    assert!((amplitude - 0.149).abs() < 0.0005, "{line:?}");
}

/// A failing balance of so many times its noise over 200 windows, and the variables that its error follows.
fn failing(
    equation: &'static str,
    size: f64,
    follows: &[(&'static str, f64)],
) -> (EquationBalance, Vec<FailureLocation>) {
    let balance = EquationBalance {
        equation,
        nres: Some(size),
        nres_refitted: Some(size),
        windows: 200,
        refitted: true,
        fails: true,
        ..EquationBalance::default()
    };
    let location = |&(variable, follows): &(&'static str, f64)| FailureLocation {
        equation,
        variable,
        from: 0.0,
        to: 1.0,
        share_of_error: 0.8,
        share_of_time: 0.2,
        follows,
        strength: 30.0,
        form: ErrorForm::Throughout,
    };
    (balance, follows.iter().map(location).collect())
}

#[test]
fn equations_or_variables_without_a_significant_difference_are_undecided() {
    let speed: &[_] = &[("speed_rad_s", 0.9)];
    let both: &[_] = &[("speed_rad_s", 0.92), ("angle_rad", 0.9)];
    let one: &[_] = &[("speed_rad_s", 0.92), ("time_s", 0.4)];
    // Errors of 3.0 and 2.9 from 200 overlapping windows are not significantly different.
    let equations = Undecided::Equations { equations: ["torque", "voltage"] };
    let axes = Undecided::Variables {
        equation: "torque",
        variables: ["speed_rad_s", "angle_rad"],
        follows: [0.92, 0.9],
    };
    for (torque, less, expected) in [
        (speed, 2.9, Some(equations)),
        (speed, 1.5, None),
        (both, 1.5, Some(axes)),
        (one, 1.5, None),
    ] {
        let (first, mut locations) = failing("torque", 3.0, torque);
        let (second, more) = failing("voltage", less, speed);
        locations.extend(more);
        assert_eq!(undecided(&[first, second], &locations), expected, "{torque:?} {less}");
    }
}
