//! Scheme 1 as `identify` calls it.
#![cfg(test)]

use super::*;
use crate::plant::testing::record;
use crate::plant::{Motor, MotorKey};
use crate::sample::{Channel, Origin, Verdict};

fn levels() -> Vec<(f64, f64)> {
    let levels = [30.0, 60.0, 20.0, -30.0, -60.0, -20.0, 40.0, 10.0, 50.0];
    std::iter::once((0.0, 0.0))
        .chain((0..80_u16).map(|k| {
            (
                0.5 + 0.07 * f64::from(k),
                levels[usize::from(k) * 4 % levels.len()],
            )
        }))
        .collect()
}

fn run_of(scenario: &Scenario) -> Run {
    let mut run = Run::new(scenario.name.clone(), scenario.sample_time_s.clone()).unwrap();
    let held = scenario.sample_time_s.iter().map(|time_s| {
        let next = scenario
            .events
            .partition_point(|event| event.0 <= *time_s + 1e-9);
        scenario.events[next.max(1) - 1].1
    });
    run.set_column(Channel::Voltage, held.collect(), Origin::Unknown)
        .unwrap();
    run.set_column(
        Channel::Speed,
        scenario.speed_rad_s.clone(),
        Origin::Measured,
    )
    .unwrap();
    run
}

fn identify(id: &str, run: &Run, model: &Model) -> Result<Identified, IdentifyError> {
    let scenario = Scenario::from_run(run).unwrap();
    let data = Data {
        run,
        scenario: &scenario,
        model,
    };
    find(id).unwrap().identify(&data)
}

fn only_resistance() -> Model {
    Model::baseline(Motor::new("m").with(MotorKey::Resistance, 1.1))
}

const FORMS: [&str; 3] = ["1", "1-exact", "1-iv"];

fn bench(period_s: f64) -> Run {
    run_of(&record(
        &Model::baseline(Motor::zk_22fc()),
        levels(),
        period_s,
        6.2,
        3,
    ))
}

fn of<'a>(found: &'a Identified, key: &str) -> &'a crate::sample::ParameterEstimate {
    let named = |parameter: &&crate::sample::ParameterEstimate| parameter.key == key;
    found.parameters.iter().find(named).unwrap()
}

#[test]
fn the_instruments_settle_the_whole_motor_on_a_noisy_run_at_ten_milliseconds() {
    let found = identify("1-iv", &bench(0.01), &only_resistance()).unwrap();
    for (key, truth) in [
        ("electrical_time_constant_s", 0.009),
        ("mechanical_time_constant_s", 0.039_54),
        ("back_emf_v_s_per_rad", 0.3538),
        ("inductance_h", 0.0099),
        ("inertia_kg_m2", 0.0045),
        ("load_torque_n_m", 0.455),
    ] {
        let parameter = of(&found, key);
        assert_eq!(parameter.verdict, Verdict::Settled, "{parameter:?}");
        let (value, std) = (parameter.value.unwrap(), parameter.std.unwrap());
        assert!((value / truth - 1.0).abs() < 0.01, "{parameter:?}");
        assert!(
            (value - truth).abs() < 4.0 * std + 1e-3 * truth,
            "{parameter:?}"
        );
    }
    assert_eq!(of(&found, "resistance_ohm").verdict, Verdict::Fixed);
    assert!(found.notes.iter().any(|note| note.contains("batch")));
}

#[test]
fn the_printed_form_at_ten_milliseconds_says_that_the_period_is_too_long() {
    let found = identify("1", &bench(0.01), &only_resistance()).unwrap();
    for key in ["electrical_time_constant_s", "inertia_kg_m2"] {
        let parameter = of(&found, key);
        assert_eq!(parameter.verdict, Verdict::Invalid, "{parameter:?}");
        let reason = parameter.reason.as_deref().unwrap();
        assert!(
            reason.contains("T/Ta = 1.1") && reason.contains("1-exact"),
            "{reason}"
        );
    }
    assert!(
        found.notes.iter().any(|note| note.contains("T << Ta")),
        "{:?}",
        found.notes
    );
}

#[test]
fn noise_that_biases_least_squares_is_named_and_settles_nothing() {
    let found = identify("1-exact", &bench(0.002), &only_resistance()).unwrap();
    let parameter = of(&found, "electrical_time_constant_s");
    assert_eq!(parameter.verdict, Verdict::Searching, "{parameter:?}");
    assert!(
        parameter
            .reason
            .as_deref()
            .unwrap()
            .contains("noise of the speed"),
        "{parameter:?}"
    );
    for id in ["1", "1-exact"] {
        let found = identify(id, &bench(0.001), &only_resistance()).unwrap();
        for parameter in &found.parameters {
            let truth = match parameter.key.as_str() {
                "electrical_time_constant_s" => 0.009,
                "mechanical_time_constant_s" => 0.039_54,
                "inertia_kg_m2" => 0.0045,
                _ => continue,
            };
            let off = parameter
                .value
                .map_or(0.0, |value| (value / truth - 1.0).abs());
            assert!(
                off < 0.04 || parameter.verdict != Verdict::Settled,
                "{id} {parameter:?}"
            );
        }
    }
}

#[test]
fn without_a_resistance_the_time_constants_are_told_and_the_rest_says_why_not() {
    let found = identify("1-iv", &bench(0.005), &Model::baseline(Motor::new("m"))).unwrap();
    assert_eq!(
        of(&found, "mechanical_time_constant_s").verdict,
        Verdict::Settled
    );
    for key in [
        "inertia_kg_m2",
        "load_torque_n_m",
        "inductance_h",
        "resistance_ohm",
    ] {
        let parameter = of(&found, key);
        assert_eq!(parameter.verdict, Verdict::NotObservable);
        assert!(
            parameter.reason.as_deref().unwrap().contains("give"),
            "{parameter:?}"
        );
    }
}

#[test]
fn a_torque_constant_is_taken_from_the_model_and_fixed_values_stay() {
    let mut model = only_resistance();
    model.motor.set(MotorKey::TorqueConstant, 0.5);
    model.motor.set(MotorKey::LoadTorque, 0.7);
    model.fixed.push(MotorKey::LoadTorque.key().to_owned());
    let found = identify("1-iv", &bench(0.005), &model).unwrap();
    let inertia = of(&found, "inertia_kg_m2").value.unwrap();
    assert!(
        (inertia / (0.0045 * 0.5 / 0.3538) - 1.0).abs() < 0.01,
        "{inertia}"
    );
    assert_eq!(of(&found, "load_torque_n_m").verdict, Verdict::Fixed);
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

fn changed(run: &Run, channel: Channel, cells: impl Fn(usize, f64) -> f64) -> Run {
    let mut other = run.clone();
    let values = run.column(channel).unwrap().iter().enumerate();
    let values = values.map(|(row, value)| cells(row, *value)).collect();
    other.set_column(channel, values, Origin::Measured).unwrap();
    other
}

#[test]
fn irregular_stamps_a_constant_voltage_and_missing_signals_are_refused_with_the_reason() {
    let run = bench(0.01);
    let mut late = 0.37;
    let times = run.time_s().iter().map(|time_s| {
        late = (late * 7.31 + 0.17) % 1.0;
        time_s + 0.003 * late
    });
    let mut jittered = Run::new("jittered", times.collect()).unwrap();
    for channel in [Channel::Voltage, Channel::Speed] {
        let cells = run.column(channel).unwrap().to_vec();
        jittered
            .set_column(channel, cells, Origin::Measured)
            .unwrap();
    }
    refused(&jittered, "equidistant");
    refused(
        &changed(&run, Channel::Voltage, |_, _| 24.0),
        "24 V throughout",
    );
    let mut current_only = Run::new("i", run.time_s().to_vec()).unwrap();
    current_only
        .set_column(Channel::Current, vec![1.0; run.rows()], Origin::Measured)
        .unwrap();
    refused(&current_only, "no voltage");
    let volts = run.column(Channel::Voltage).unwrap().to_vec();
    current_only
        .set_column(Channel::Voltage, volts, Origin::Measured)
        .unwrap();
    refused(&current_only, "no speed");
}

#[test]
fn missing_cells_and_dropped_rows_cost_rows_and_nothing_else() {
    let holes = changed(&bench(0.005), Channel::Speed, |row, speed| {
        if row % 13 == 5 { f64::NAN } else { speed }
    });
    let found = identify("1-iv", &holes, &only_resistance()).unwrap();
    let inertia = of(&found, "inertia_kg_m2");
    assert_eq!(inertia.verdict, Verdict::Settled, "{inertia:?}");
    assert!(
        (inertia.value.unwrap() / 0.0045 - 1.0).abs() < 0.01,
        "{inertia:?}"
    );
}

#[test]
fn a_motor_that_never_turns_is_told_nothing_about() {
    let still = changed(&bench(0.01), Channel::Speed, |row, _| {
        0.05 * (row as f64 * 1.7).sin()
    });
    for id in FORMS {
        let found = identify(id, &still, &only_resistance()).unwrap();
        for parameter in found
            .parameters
            .iter()
            .filter(|p| p.key != "resistance_ohm")
        {
            assert_eq!(
                parameter.verdict,
                Verdict::NotObservable,
                "{id} {parameter:?}"
            );
            assert!(!parameter.reason.as_deref().unwrap().is_empty());
        }
    }
}

#[test]
fn the_rectangle_as_printed_is_high_at_ten_milliseconds_and_says_so() {
    let mut run = bench(0.01);
    let scenario = record(&Model::baseline(Motor::zk_22fc()), levels(), 0.01, 6.2, 3);
    run.set_column(Channel::Current, scenario.current_a, Origin::Measured)
        .unwrap();
    let mut model = only_resistance();
    model.motor.set(MotorKey::TorqueConstant, 0.3538);
    let found = identify("2-rectangle", &run, &model).unwrap();
    let inertia = of(&found, "inertia_kg_m2");
    assert!(inertia.value.unwrap() > 1.03 * 0.0045, "{inertia:?}");
    assert_eq!(inertia.verdict, Verdict::Searching, "{inertia:?}");
    assert!(inertia.reason.as_deref().unwrap().contains("trapezoid"));
    let error = identify("2-rectangle", &run, &only_resistance()).unwrap_err();
    assert!(error.to_string().contains("torque constant"));
}
