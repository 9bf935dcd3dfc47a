//! Models that lack something, fitted to records of a motor whose truth is known.

use super::*;
use crate::identification::scheme::Identified;
use crate::identification::testing::*;
use crate::plant::Model;
use crate::sample::Run;

/// A small brushed motor: L/R 0.5 ms, R J/Ke^2 19 ms.
const BRUSHED: Truth = [1.2, 6e-4, 0.05, 4e-5, 0.012];
const KEY: [&str; 5] = [
    "resistance_ohm",
    "inductance_h",
    "back_emf_v_s_per_rad",
    "inertia_kg_m2",
    "load_torque_n_m",
];

fn brushed() -> Model {
    Model::baseline(motor(&BRUSHED))
}

fn brushed_with(id: &str, values: &[f64]) -> Model {
    let mut model = brushed().with_effect(id).unwrap();
    model.effects[0].values = values.iter().copied().map(Some).collect();
    model
}

/// Steps up to 12 V in both directions after a rest, sampled at 500 Hz; each falls on a sample.
fn record_of(model: &Model, seconds: f64) -> Run {
    recorded(&record(
        model,
        steps(0.3, seconds, 12.0 / 70.0, 0.2),
        0.002,
        seconds,
        3,
    ))
}

/// Each parameter is within three of its deviations of the truth, or is not called settled; the misfit is given.
#[track_caller]
fn honest(run: &Run, truth: &[f64]) -> Identified {
    let found = identify("output-error", run, &unknown()).unwrap();
    let known = || KEY.iter().zip(truth).filter(|known| known.1.is_finite());
    for (key, truth) in known() {
        let own = of(&found.parameters, key);
        let is_settled = own.verdict == Verdict::Settled;
        assert!(!is_settled || covers(own, *truth, 3.0), "{own:?} {truth}");
    }
    found
}

#[test]
fn a_model_that_lacks_nothing_keeps_its_intervals_and_its_verdicts() {
    let found = honest(&record_of(&brushed(), 4.0), &BRUSHED);
    let misfit = found.misfit.unwrap();
    assert_eq!(misfit.0.len(), 2);
    for left in &misfit.0 {
        assert!((0.9..1.1).contains(&left.times_noise.unwrap()), "{left:?}");
        assert!(left.common_share < 0.1, "{left:?}");
    }
    for key in KEY {
        judged(&found.parameters, key, Verdict::Settled);
    }
}

#[test]
fn a_late_speed_is_no_settled_resistance() {
    let mut run = record_of(&brushed(), 4.0);
    let speed = run.column(Channel::Speed).unwrap().to_vec();
    let late = (0..speed.len())
        .map(|row| speed[row.saturating_sub(6)])
        .collect();
    put(&mut run, Channel::Speed, late);
    let found = honest(&run, &BRUSHED);
    // What the held levels say of it.
    let resistance = judged(&found.parameters, KEY[0], Verdict::Searching);
    assert_covers(resistance, 1.2, 0.05, 3.0);
    let inertia = judged(&found.parameters, KEY[3], Verdict::Searching);
    assert_says(inertia, &["times the noise of"]);
}

#[test]
fn a_long_record_without_its_viscous_friction_is_not_settled_far_off() {
    let truth = brushed_with("viscous_friction", &[1.5e-5]);
    honest(&record_of(&truth, 30.0), &BRUSHED);
}

#[test]
fn a_motor_that_warms_up_has_no_settled_back_emf() {
    // The resistance itself changes: what it was is any of its values.
    let truth = brushed_with("winding_heating", &[2e-3, 20.0]);
    let mut known = BRUSHED;
    known[0] = f64::NAN;
    honest(&record_of(&truth, 20.0), &known);
}
