use super::*;
use crate::testing::{assert_says, covers, judged, of, paper, record, unknown};

fn step(volts: f64, period_s: f64, held_s: f64, seed: u64) -> Scenario {
    let events = vec![(0.0, 0.0), (0.3, volts), (0.3 + held_s, 0.0)];
    record(&paper(), events, period_s, 0.6 + held_s, seed)
}

const TRUTH: [(&str, f64, f64); 7] = [
    ("resistance_ohm", 1.1, 0.08),
    ("inductance_h", 0.0099, 0.08),
    ("back_emf_v_s_per_rad", 0.3538, 0.02),
    ("inertia_kg_m2", 0.0045, 0.12),
    ("load_torque_n_m", 0.455, 0.03),
    ("electrical_time_constant_s", 0.009, 0.2),
    ("mechanical_time_constant_s", 0.039_54, 0.06),
];

#[test]
fn one_step_gives_crude_values_with_intervals_that_hold() {
    let (mut inside, mut all) = (0, 0);
    for seed in 0..20 {
        let volts = [60.0, -40.0, 25.0, -90.0][usize::try_from(seed % 4).unwrap()];
        let (parameters, notes) = estimates(&unknown(), &step(volts, 0.001, 0.5, seed));
        for (key, truth, within) in TRUTH {
            let parameter = judged(&parameters, key, Verdict::Searching);
            let near = (parameter.value.unwrap() / truth - 1.0).abs() < within;
            assert!(near, "{volts} V {parameter:?} {truth}");
            inside += u32::from(covers(parameter, truth, 2.0));
            all += 1;
        }
        assert!(notes[0].contains("friction") && notes[0].contains("63 %"));
    }
    let share = f64::from(inside) / f64::from(all);
    assert!(share > 0.85, "{inside} of {all}");
}

#[test]
fn without_a_current_only_the_time_constants_are_found() {
    let mut run = step(60.0, 0.001, 0.5, 3);
    run.current_a.fill(f64::NAN);
    let mut model = paper();
    model.fixed.push("resistance_ohm".into());
    let (parameters, _) = estimates(&model, &run);
    let tm = of(&parameters, "mechanical_time_constant_s");
    assert!(tm.value.is_some(), "{tm:?}");
    judged(&parameters, "resistance_ohm", Verdict::Fixed);
    let back_emf = judged(&parameters, "back_emf_v_s_per_rad", Verdict::NotObservable);
    assert_says(back_emf, &["at most 0.36"]);
    for key in ["inertia_kg_m2", "load_torque_n_m"] {
        judged(&parameters, key, Verdict::NotObservable);
    }
}

#[test]
fn coarse_samples_lose_the_electrical_half() {
    let (parameters, _) = estimates(&unknown(), &step(60.0, 0.01, 0.8, 4));
    let tm = of(&parameters, "mechanical_time_constant_s");
    assert!((tm.value.unwrap() / 0.039_54 - 1.0).abs() < 0.15, "{tm:?}");
    let resistance = of(&parameters, "resistance_ohm");
    assert!(resistance.reason.is_some() && resistance.verdict != Verdict::Settled);
}

#[test]
fn a_run_without_step_rest_or_steady_state_is_refused() {
    let (model, truth) = (unknown(), paper());
    let random = (0..600_i32).map(|k| 0.2 + 0.005 * f64::from(k));
    let random = random.map(|t| (t, 30.0 * (5.0 * t).sin() + 10.0 * (17.0 * t).cos()));
    let random = std::iter::once((0.0, 0.0)).chain(random).collect();
    for (run, expected) in [
        (record(&truth, vec![(0.0, 40.0), (0.5, 60.0)], 0.001, 1.0, 1), "out of rest"),
        (step(60.0, 0.001, 0.06, 2), "no steady state"),
        (step(1.0, 0.001, 0.5, 3), "does not turn"),
        (record(&truth, random, 0.001, 3.2, 5), ""),
    ] {
        let (parameters, notes) = estimates(&model, &run);
        assert!(notes.is_empty(), "{notes:?}");
        for parameter in parameters {
            assert_eq!(parameter.value, None);
            assert_says(&parameter, &[expected]);
        }
    }
}
