//! Scheme 1 as `identify` calls it.
#![cfg(test)]

use super::*;
use crate::testing::*;
use drivebench_model::plant::{Motor, MotorKey};
use drivebench_model::sample::Verdict;

fn levels() -> Vec<(f64, f64)> {
    let levels = [30.0, 60.0, 20.0, -30.0, -60.0, -20.0, 40.0, 10.0, 50.0];
    let level = |k: u16| levels[usize::from(k) * 4 % levels.len()];
    let steps = (0..80).map(|k| (0.5 + 0.07 * f64::from(k), level(k)));
    std::iter::once((0.0, 0.0)).chain(steps).collect()
}

fn only_resistance() -> Model {
    Model::baseline(Motor::new("m").with(MotorKey::Resistance, 1.1))
}

const FORMS: [&str; 3] = ["1", "1-exact", "1-iv"];

fn bench(period_s: f64) -> Run {
    recorded(&record(&paper(), levels(), period_s, 6.2, 3)).without(Channel::Current)
}

#[test]
fn the_instruments_settle_the_whole_motor_at_ten_milliseconds() {
    let found = identify("1-iv", &bench(0.01), &only_resistance()).unwrap();
    for (key, truth) in [
        ("electrical_time_constant_s", 0.009),
        ("mechanical_time_constant_s", 0.039_54),
        ("back_emf_v_s_per_rad", 0.3538),
        ("inductance_h", 0.0099),
        ("inertia_kg_m2", 0.0045),
        ("load_torque_n_m", 0.455),
    ] {
        let parameter = judged(&found.parameters, key, Verdict::Settled);
        let (value, std) = (parameter.value.unwrap(), parameter.std.unwrap());
        assert_near(value, truth, 0.01);
        let covers = (value - truth).abs() < 4.0 * std + 1e-3 * truth;
        assert!(covers, "{parameter:?}");
    }
    judged(&found.parameters, "resistance_ohm", Verdict::Fixed);
    assert!(found.notes.iter().any(|note| note.contains("batch")));
}

#[test]
fn least_squares_names_its_bias_and_settles_nothing_by_it() {
    let found = identify("1", &bench(0.01), &only_resistance()).unwrap();
    for key in ["electrical_time_constant_s", "inertia_kg_m2"] {
        assert_says(judged(&found.parameters, key, Verdict::Invalid), &["T/Ta = 1.1", "1-exact"]);
    }
    assert!(found.notes.iter().any(|note| note.contains("T << Ta")), "{:?}", found.notes);
    let found = identify("1-exact", &bench(0.002), &only_resistance()).unwrap();
    let key = "electrical_time_constant_s";
    let parameter = judged(&found.parameters, key, Verdict::Searching);
    assert_says(parameter, &["noise of the speed"]);
    for id in ["1", "1-exact"] {
        let found = identify(id, &bench(0.001), &only_resistance()).unwrap();
        for (key, truth) in [
            ("electrical_time_constant_s", 0.009),
            ("mechanical_time_constant_s", 0.039_54),
            ("inertia_kg_m2", 0.0045),
        ] {
            let parameter = of(&found.parameters, key);
            let off = (parameter.value).map_or(0.0, |value| (value / truth - 1.0).abs());
            let honest = off < 0.04 || parameter.verdict != Verdict::Settled;
            assert!(honest, "{id} {parameter:?}");
        }
    }
}

#[test]
fn resistance_torque_constant_and_fixed_values_are_the_models() {
    let found = identify("1-iv", &bench(0.005), &Model::baseline(Motor::new("m"))).unwrap();
    let all = &found.parameters;
    judged(all, "mechanical_time_constant_s", Verdict::Settled);
    for key in ["inertia_kg_m2", "load_torque_n_m", "inductance_h", "resistance_ohm"] {
        assert_says(judged(all, key, Verdict::NotObservable), &["give"]);
    }
    let mut model = only_resistance();
    model.motor.set(MotorKey::TorqueConstant, 0.5);
    model.motor.set(MotorKey::LoadTorque, 0.7);
    model.fixed.push(MotorKey::LoadTorque.key().to_owned());
    // Missing cells cost rows and nothing else.
    let holes =
        changed(
            &bench(0.005),
            Channel::Speed,
            |row, speed| {
                if row % 13 == 5 { f64::NAN } else { speed }
            },
        );
    let found = identify("1-iv", &holes, &model).unwrap();
    let inertia = judged(&found.parameters, "inertia_kg_m2", Verdict::Settled);
    assert_near(inertia.value.unwrap(), 0.0045 * 0.5 / 0.3538, 0.01);
    judged(&found.parameters, "load_torque_n_m", Verdict::Fixed);
    assert_eq!(found.model.motor.get(MotorKey::LoadTorque), Some(0.7));
}

fn refused(run: &Run, words: &str) {
    for id in FORMS {
        match identify(id, run, &only_resistance()) {
            Err(error) => {
                assert!(error.to_string().contains(words), "{id} {error}");
                assert!(!error.help().is_empty() && !error.is_usage());
            }
            Ok(found) => panic!("{id} {:?}", found.parameters),
        }
    }
}

#[test]
fn irregular_stamps_and_missing_signals_are_refused() {
    let run = bench(0.01);
    let mut late = 0.37;
    let times = run.time_s().iter().map(|time_s| {
        late = (late * 7.31 + 0.17) % 1.0;
        time_s + 0.003 * late
    });
    let columns = [Channel::Voltage, Channel::Speed];
    let columns = columns.map(|channel| (channel, run.column(channel).unwrap().to_vec()));
    refused(&run_of(times.collect(), columns), "equidistant");
    let constant = changed(&run, Channel::Voltage, |_, _| 24.0);
    refused(&constant, "24 V throughout");
    let one = vec![1.0; run.rows()];
    let mut current_only = run_of(run.time_s().to_vec(), [(Channel::Current, one)]);
    refused(&current_only, "no voltage");
    put(&mut current_only, Channel::Voltage, run.column(Channel::Voltage).unwrap().to_vec());
    refused(&current_only, "no speed");
}

#[test]
fn a_motor_that_never_turns_has_no_observable_parameter() {
    let noise = |row: usize, _| 0.05 * (row as f64 * 1.7).sin();
    let still = changed(&bench(0.01), Channel::Speed, noise);
    for id in FORMS {
        for parameter in identify(id, &still, &only_resistance()).unwrap().parameters {
            if parameter.key != "resistance_ohm" {
                assert_eq!(parameter.verdict, Verdict::NotObservable, "{id} {parameter:?}");
                assert_says(&parameter, &[]);
            }
        }
    }
}

#[test]
fn the_rectangle_as_printed_is_high_at_ten_milliseconds() {
    let run = recorded(&record(&paper(), levels(), 0.01, 6.2, 3));
    let mut model = only_resistance();
    model.motor.set(MotorKey::TorqueConstant, 0.3538);
    let found = identify("2-rectangle", &run, &model).unwrap();
    let inertia = judged(&found.parameters, "inertia_kg_m2", Verdict::Searching);
    assert!(inertia.value.unwrap() > 1.03 * 0.0045, "{inertia:?}");
    assert_says(inertia, &["trapezoid"]);
    let error = identify("2-rectangle", &run, &only_resistance()).unwrap_err();
    assert!(error.to_string().contains("torque constant"));
}
