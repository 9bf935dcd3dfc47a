//! Runs whose fault is known, at 1 and at 10 ms: the first sentence must say where it is.

use super::*;
use crate::identification::output_error;
use crate::plant::{Motor, MotorKey, testing};

/// Both directions, slow passages through zero, dither of 40 ms; another run for each seed.
fn events(seed: u64) -> Vec<(f64, f64)> {
    let levels = [
        30.0, 80.0, 45.0, 6.0, -6.0, -45.0, -90.0, -20.0, 5.0, 60.0, 100.0, -70.0,
    ];
    let mut events = vec![(0.0, 0.0)];
    for step in 0..150_u64 {
        let level = levels[((step / 12 + 5 * seed) % 12) as usize];
        // A small generator of signs; no two runs dither alike.
        let sign = if (step * step * 7 + step * 3 + seed * 11) % 5 < 2 {
            -1.0
        } else {
            1.0
        };
        events.push((0.4 + 0.04 * step as f64, level + 5.0 * sign));
    }
    events
}

fn record(truth: &Model, period_s: f64, seed: u64) -> Scenario {
    testing::record(truth, events(seed), period_s, 6.4, seed)
}

fn with(id: &str, values: &[f64]) -> Model {
    let mut model = nameplate().with_effect(id).unwrap();
    model.effects[0].values = values.iter().copied().map(Some).collect();
    model
}

fn nameplate() -> Model {
    Model::baseline(Motor::zk_22fc())
}

/// The baseline fitted to one run of the truth and located on another.
fn located(truth: &Model, period_s: f64, error_of: ErrorOf) -> Located {
    let run = record(truth, period_s, 1);
    let noise = NoiseFloor::from_standstill(&run).unwrap();
    let fit = output_error::fit(&[nameplate()], &run, &noise).unwrap();
    locate(&fit.model, &record(truth, period_s, 2), &noise, error_of).unwrap()
}

#[test]
fn a_right_model_has_balances_at_the_noise_and_no_place() {
    for period_s in [0.001, 0.01] {
        let found = located(&nameplate(), period_s, ErrorOf::Model);
        assert_eq!(found.locations, vec![], "{period_s} s");
        assert_eq!(found.balances.len(), 2);
        for balance in &found.balances {
            let nres = balance.nres.unwrap();
            assert!((0.85..1.15).contains(&nres), "{period_s} s: {balance:?}");
            assert!(balance.sentence.contains("holds"), "{}", balance.sentence);
        }
    }
}

#[test]
fn the_first_place_names_equation_and_axis() {
    for (id, values, period_s, equation, variable) in [
        (
            "stribeck_friction",
            &[0.2, 10.0][..],
            0.001,
            "torque",
            "speed_rad_s",
        ),
        ("quadratic_load", &[3e-6], 0.001, "torque", "speed_rad_s"),
        ("quadratic_load", &[3e-6], 0.01, "torque", "speed_rad_s"),
        ("voltage_drop", &[1.0], 0.001, "voltage", "current_a"),
        ("voltage_drop", &[1.0], 0.01, "voltage", "current_a"),
        (
            "winding_heating",
            &[0.004, 20.0],
            0.001,
            "voltage",
            "time_s",
        ),
        ("constant_load", &[0.1], 0.001, "torque", "offset_n_m"),
    ] {
        let found = located(&with(id, values), period_s, ErrorOf::Model);
        let first = &found.locations[0];
        assert_eq!(
            (first.equation, first.variable),
            (equation, variable),
            "{id} at {period_s} s: {:#?}",
            found.locations
        );
        assert_eq!(found.balances[0].equation, equation);
        assert!(found.balances[0].nres.unwrap() > 1.3 && found.balances[0].fails);
        assert!(
            first.from < first.to && first.share_of_error > 0.5,
            "{first:?}"
        );
    }
}

#[test]
fn friction_that_grows_towards_zero_speed_lies_in_a_narrow_range() {
    let found = located(
        &with("stribeck_friction", &[0.2, 10.0]),
        0.001,
        ErrorOf::Structure,
    );
    let first = &found.locations[0];
    assert!(first.to < 30.0 && first.from > -30.0, "{first:?}");
    assert!(
        first.share_of_time < 0.3 && first.share_of_error > 0.6,
        "{first:?}"
    );
}

#[test]
fn a_wrong_value_of_the_motor_is_told_as_one() {
    let run = record(&nameplate(), 0.001, 3);
    let noise = NoiseFloor::from_standstill(&run).unwrap();
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
        let found = locate(&wrong, &run, &noise, ErrorOf::Model).unwrap();
        let first = &found.locations[0];
        assert_eq!(
            (first.equation, first.variable),
            (equation, variable),
            "{first:?}"
        );
        let change = found.balances[0]
            .own_changes
            .iter()
            .find(|c| c.key == key.key())
            .unwrap();
        assert!(
            (change.by / ((1.0 - factor) * value) - 1.0).abs() < 0.05,
            "{change:?}"
        );
        // As a question for the structure it is no fault at all.
        let structure = locate(&wrong, &run, &noise, ErrorOf::Structure).unwrap();
        assert_eq!(structure.locations, vec![], "{key:?}");
    }
}

#[test]
fn an_exact_model_of_a_run_without_noise_fails_nowhere() {
    let mut run = record(&nameplate(), 0.001, 4);
    let exact = crate::plant::Plant::new(&nameplate(), Input::Voltage)
        .unwrap()
        .simulate(&run, crate::plant::State::default());
    (run.current_a, run.speed_rad_s) = (exact.current_a, exact.speed_rad_s);
    let noise = NoiseFloor::from_spread(&run);
    let found = locate(&nameplate(), &run, &noise, ErrorOf::Model).unwrap();
    assert_eq!(found.locations, vec![]);
    assert!(
        found.balances.iter().all(|b| b.nres.is_none() && !b.fails),
        "{:?}",
        found.balances
    );
}

#[test]
fn a_missing_signal_and_a_short_run_are_said() {
    let mut run = record(&nameplate(), 0.001, 5);
    let noise = NoiseFloor::from_standstill(&run).unwrap();
    run.current_a.fill(f64::NAN);
    let found = locate(&nameplate(), &run, &noise, ErrorOf::Model).unwrap();
    assert!(
        found.balances.is_empty() && found.notes[0].contains("no current"),
        "{:?}",
        found.notes
    );
    let (short, _) = record(&nameplate(), 0.001, 6).split(0.1);
    let found = locate(&nameplate(), &short, &noise, ErrorOf::Model).unwrap();
    assert!(
        found.notes.iter().any(|note| note.contains("longer run")),
        "{:?}",
        found.notes
    );
}

#[test]
fn the_map_counts_every_window_once() {
    let run = record(&nameplate(), 0.001, 7);
    let noise = NoiseFloor::from_standstill(&run).unwrap();
    let map = locate(&nameplate(), &run, &noise, ErrorOf::Model)
        .unwrap()
        .map
        .unwrap();
    let counted: usize = map.count.iter().flatten().sum();
    let windows = Windows::new(&nameplate(), &run, &noise).unwrap().each.len();
    assert_eq!(counted, windows);
    for (counts, errors) in map.count.iter().zip(&map.voltage_rms_v) {
        for (count, error) in counts.iter().zip(errors) {
            assert_eq!(*count > 0, error.is_some());
        }
    }
}

/// A torque that no model has: a shaker at 7.3 Hz, put into the run by hand.
#[test]
fn a_shaker_is_a_line_at_its_frequency() {
    let shaken = |torque: f64| {
        let mut run = record(&nameplate(), 0.001, 8);
        // The speed that such a torque alone adds: amplitude / (J w), a quarter of a period late.
        let w = std::f64::consts::TAU * 7.3;
        for (speed, time_s) in run.speed_rad_s.iter_mut().zip(&run.sample_time_s) {
            *speed += torque / (0.0045 * w) * (w * time_s).cos();
        }
        run
    };
    let run = shaken(0.15);
    let mut noise = NoiseFloor::from_standstill(&record(&nameplate(), 0.001, 8)).unwrap();
    noise.samples = 400;
    let found = locate(&nameplate(), &run, &noise, ErrorOf::Structure).unwrap();
    let line = found
        .locations
        .iter()
        .find(|l| l.variable == "frequency_hz")
        .unwrap();
    assert!(
        line.from <= 7.32 && line.to >= 7.28 && line.to - line.from < 0.3,
        "{line:?}"
    );
    assert_eq!(line.equation, "torque");
}

/// A failing balance of so many times its noise over 200 windows, and the variables that its error follows.
fn failing(
    equation: Equation,
    size: f64,
    follows: &[(&'static str, f64)],
) -> (EquationBalance, Vec<FailureLocation>) {
    let balance = EquationBalance {
        equation: equation.name(),
        unit: equation.unit(),
        nres: Some(size),
        nres_refitted: Some(size),
        own_changes: Vec::new(),
        rms: 0.1,
        relative: 0.1,
        share_of_error: None,
        forward_share_of_error: None,
        forward_share_of_time: None,
        windows: 200,
        refitted: true,
        fails: true,
        sentence: String::new(),
    };
    let location = |&(variable, follows): &(&'static str, f64)| FailureLocation {
        equation: equation.name(),
        variable,
        from: 0.0,
        to: 1.0,
        share_of_error: 0.8,
        share_of_time: 0.2,
        follows,
        strength: 30.0,
        sentence: String::new(),
    };
    (balance, follows.iter().map(location).collect())
}

#[test]
fn neither_of_two_that_are_alike_is_said_to_be_the_one() {
    let says = |torque: (f64, &[(&'static str, f64)]), voltage: (f64, &[(&'static str, f64)])| {
        let (first, mut locations) = failing(Equation::Torque, torque.0, torque.1);
        let (second, more) = failing(Equation::Voltage, voltage.0, voltage.1);
        locations.extend(more);
        undecided(&[first, second], &locations)
    };
    let speed: &[_] = &[("speed_rad_s", 0.9)];
    // Sizes of 3.0 and 2.9 from 200 windows that overlap are one size, whichever comes first in the next run.
    let alike = says((3.0, speed), (2.9, speed)).unwrap();
    assert!(
        alike.starts_with("the torque and the voltage equation fail alike"),
        "{alike}"
    );
    assert_eq!(says((3.0, speed), (1.5, speed)), None);
    let both: &[_] = &[("speed_rad_s", 0.92), ("angle_rad", 0.9)];
    let alike = says((3.0, both), (1.5, speed)).unwrap();
    assert_eq!(
        alike,
        "the torque error follows the speed and the angle alike (92 and 90 %): which of them these runs do not tell"
    );
    let one: &[_] = &[("speed_rad_s", 0.92), ("time_s", 0.4)];
    assert_eq!(says((3.0, one), (1.5, speed)), None);
}
