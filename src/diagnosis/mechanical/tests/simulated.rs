//! An axis under random torques, with a background that no model of the tests has: a coloured disturbing torque, cogging,
//! and noise of the speed.

use super::*;
use crate::plant::{Input, Motor, MotorKey, Plant, State};
use crate::sample::Channel;
use rand_distr::StandardNormal;

const PERIOD_S: f64 = 0.002;
const DURATION_S: f64 = 12.0;

pub(super) fn axis() -> Model {
    let motor = Motor::new("axis")
        .with(MotorKey::Inertia, 0.0045)
        .with(MotorKey::LoadTorque, 0.35);
    let mut model = with_effects(Model::baseline(motor), &["viscous_friction"]);
    model.effects[0].values = vec![Some(0.004)];
    model
}

/// What a user starts from.
pub(super) fn nameplate() -> Model {
    let mut model = axis();
    model.effects[0].values = vec![None];
    model
}

pub(super) fn truth(id: &str, values: &[f64]) -> Model {
    let mut model = with_effects(axis(), &[id]);
    let last = model.effects.len() - 1;
    model.effects[last].values = values.iter().copied().map(Some).collect();
    model
}

/// A record with `mess` times the usual background.
fn record(truth: &Model, seed: u64, mess: f64) -> Scenario {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let samples = crate::numerics::count::whole(DURATION_S / PERIOD_S);
    let sample_time_s: Vec<f64> = (0..samples).map(|k| k as f64 * PERIOD_S).collect();
    let (mut level, mut disturbance) = (0.0, 0.0_f64);
    let (mut given, mut acting) = (Vec::new(), Vec::new());
    for (k, time_s) in sample_time_s.iter().enumerate() {
        if k % 250 == 25 {
            level = rng.random_range(-1.9..1.9);
        }
        // 0.75 % of the largest torque, remembered for 50 ms.
        let kept = (-PERIOD_S / 0.05_f64).exp();
        disturbance = kept * disturbance
            + 0.014 * mess * (1.0 - kept * kept).sqrt() * rng.sample::<f64, _>(StandardNormal);
        given.push((*time_s, level));
        acting.push((*time_s, level + disturbance));
    }
    let mut scenario = Scenario {
        name: format!("axis {seed}"),
        input: Input::Torque,
        input_channel: Channel::Torque,
        events: acting,
        current_a: vec![f64::NAN; samples],
        speed_rad_s: vec![],
        angle: vec![],
        time_half_width_s: vec![],
        unknown_input: vec![],
        scored: 0..samples,
        sample_time_s,
    };
    let mut real = with_effects(truth.clone(), &["cogging"]);
    let last = real.effects.len() - 1;
    real.effects[last].values = vec![Some(0.01 * mess), Some(0.0), Some(7.0)];
    let out = Plant::new(&real, Input::Torque)
        .unwrap()
        .simulate(&scenario, State::default());
    scenario.speed_rad_s = out
        .speed_rad_s
        .iter()
        .map(|speed| speed + 0.15 * rng.sample::<f64, _>(StandardNormal))
        .collect();
    scenario.events = given;
    scenario
}

pub(super) fn evidence(truth: &Model, seed: u64) -> Evidence {
    Evidence::new(
        record(truth, 10 * seed, 1.0),
        Some(record(truth, 10 * seed + 1, 1.0)),
        None,
    )
}

/// Sizes that this background leaves visible. Stribeck friction of 12 rad/s only just: the z of the paired test hardly
/// depends on the size, it counts the blocks in which an effect shows, and these records pass zero fast and seldom.
pub(super) const KNOWN: [(&str, &[f64]); 5] = [
    ("quadratic_load", &[4e-5]),
    ("asymmetric_viscous", &[1.5e-3]),
    ("constant_load", &[0.08]),
    ("stribeck_friction", &[0.25, 25.0]),
    ("stribeck_friction", &[0.25, 12.0]),
];

#[test]
fn a_single_effect_is_named_in_a_messy_record_and_nothing_where_nothing_is_missing() {
    for (id, values) in KNOWN {
        let diagnosis = diagnose(&nameplate(), &evidence(&truth(id, values), 1)).unwrap();
        assert_eq!(diagnosis.effect, Some(id), "{}", diagnosis.sentence);
        assert_eq!(
            diagnosis.verdict,
            DiagnosisVerdict::Effect,
            "{}",
            diagnosis.sentence
        );
        assert_eq!(status(&diagnosis, id), Status::Supported);
        assert!(diagnosis.holdout_after < diagnosis.holdout_before);
        eprintln!("{}", diagnosis.candidates[0].evidence);
    }
    for seed in 0..6 {
        let plain = Evidence::new(
            record(&axis(), 100 + seed, 0.0),
            Some(record(&axis(), 200 + seed, 0.0)),
            None,
        );
        let diagnosis = diagnose(&nameplate(), &plain).unwrap();
        assert_eq!(diagnosis.effect, None, "{}", diagnosis.sentence);
    }
}

#[test]
fn doses_are_found_within_their_interval_and_in_their_order() {
    let base = evidence(&axis(), 3);
    for (id, values) in KNOWN {
        super::doses_are_found(&nameplate(), &base, id, values);
        for dose in [1.0, 2.0] {
            let mut values = values.to_vec();
            values[0] *= dose;
            let effect = effect::find(id).unwrap();
            let mut dosed_runs = base.clone();
            for run in [&mut dosed_runs.training, &mut dosed_runs.holdout] {
                *run = dosed(run, effect, &values);
            }
            let named = diagnose(&nameplate(), &dosed_runs).unwrap();
            assert_eq!(named.effect, Some(id), "x {dose}: {}", named.sentence);
        }
    }
}

#[test]
fn halves_do_not_change_the_name() {
    for (id, values) in KNOWN {
        let data = evidence(&truth(id, values), 5);
        let swapped = Evidence {
            training: data.holdout.clone(),
            holdout: data.training.clone(),
            ..data.clone()
        };
        for data in [&data, &swapped] {
            let named = diagnose(&nameplate(), data).unwrap();
            assert_eq!(named.effect, Some(id), "{id}: {}", named.sentence);
        }
        let (one, one_std) = size(&nameplate(), &data, effect::find(id).unwrap());
        let (two, two_std) = size(&nameplate(), &swapped, effect::find(id).unwrap());
        assert!(
            (one - two).abs() < 3.0 * one_std.unwrap().hypot(two_std.unwrap()),
            "{id}: {one:.3e} +- {one_std:?} and {two:.3e} +- {two_std:?}"
        );
    }
}

#[test]
fn sizes_of_two_effects_are_those_of_the_fit_with_both() {
    let mut truth = truth("quadratic_load", &[8e-5]);
    truth = with_effects(truth, &["constant_load"]);
    let last = truth.effects.len() - 1;
    truth.effects[last].values = vec![Some(0.12)];
    let data = Evidence::new(record(&truth, 80, 0.0), Some(record(&truth, 81, 0.0)), None);
    let diagnosis = diagnose(&nameplate(), &data).unwrap();
    let mut named = diagnosis.effects.clone();
    named.sort_unstable();
    assert_eq!(
        named,
        ["constant_load", "quadratic_load"],
        "{}",
        diagnosis.sentence
    );
    for (place, id) in diagnosis.effects.iter().enumerate() {
        let candidate = &diagnosis.candidates[place];
        assert_eq!(candidate.effect, *id);
        let size = &candidate.parameters[0];
        let mut joint = diagnosis.model.parameters.iter();
        assert_eq!(joint.find(|own| own.key == size.key), Some(size));
        let true_size = if *id == "constant_load" { 0.12 } else { 8e-5 };
        assert!(
            (size.value.unwrap() / true_size - 1.0).abs() < 0.05,
            "{size:?}"
        );
    }
}

#[test]
fn the_confirming_run_has_the_last_word() {
    let (id, values) = KNOWN[1];
    let truth = truth(id, values);
    let mut data = evidence(&truth, 1);
    for (third, holds) in [(&truth, true), (&axis(), false)] {
        data.confirm = Some(record(third, 12, 1.0));
        let diagnosis = diagnose(&nameplate(), &data).unwrap();
        assert_eq!(diagnosis.effect, Some(id), "{}", diagnosis.sentence);
        let confirm = diagnosis.confirm.unwrap();
        assert_eq!(confirm.confirmed, Some(holds), "{}", confirm.sentence);
        assert_eq!(
            confirm.error_after.unwrap() < confirm.error_before.unwrap(),
            holds,
            "{}",
            confirm.sentence
        );
    }
}

#[test]
fn add_and_remove_tell_both_processings_and_refuse_what_does_not_pay() {
    let (id, values) = KNOWN[1];
    let effect = effect::find(id).unwrap();
    let truth = truth(id, values);
    let data = Evidence::new(record(&truth, 70, 0.0), Some(record(&truth, 71, 0.0)), None);
    let with_offset = with_effects(nameplate(), &["constant_load"]);
    let added = add(effect, &with_offset, &data).unwrap();
    assert!(added.accepted, "{}", added.reason);
    assert!(
        added.reason.contains("constant_load is superfluous"),
        "{} {:?}",
        added.reason,
        added.fit.parameters
    );
    let (before, after) = (
        added.before.signals.torque_n_m.as_ref().unwrap(),
        added.after.signals.torque_n_m.as_ref().unwrap(),
    );
    assert_eq!(before.processing.len(), 2);
    for (before, after) in before.processing.iter().zip(&after.processing) {
        assert!(
            after.holdout_relative_error_percent < before.holdout_relative_error_percent,
            "{:?}",
            before.method
        );
    }
    assert!(
        added.after.signals.speed_rad_s.unwrap().rmse
            < added.before.signals.speed_rad_s.unwrap().rmse
    );
    let needed = crate::diagnosis::remove(effect, &added.fit.model, data.clone()).unwrap();
    assert!(!needed.accepted, "{}", needed.reason);
    let offset = effect::find("constant_load").unwrap();
    let gone = crate::diagnosis::remove(offset, &added.fit.model, data.clone()).unwrap();
    assert!(gone.accepted, "{}", gone.reason);
    let nothing = add(offset, &nameplate(), &evidence(&axis(), 7)).unwrap();
    assert!(!nothing.accepted, "{}", nothing.reason);
}

#[test]
fn a_run_in_one_direction_does_not_name_what_only_two_would_show() {
    let mut data = evidence(&truth("constant_load", &[0.08]), 9);
    for run in [&mut data.training, &mut data.holdout] {
        // What lies below zero is cut out of the record.
        for speed in &mut run.speed_rad_s {
            if *speed < 5.0 {
                *speed = f64::NAN;
            }
        }
    }
    let diagnosis = diagnose(&nameplate(), &data).unwrap();
    for id in ["constant_load", "asymmetric_viscous"] {
        assert_eq!(
            status(&diagnosis, id),
            Status::NotExcited,
            "{}",
            diagnosis.sentence
        );
    }
}

#[test]
fn a_run_without_motion_or_torque_constant_is_refused_with_the_reason() {
    let mut still = evidence(&axis(), 1);
    still.training.speed_rad_s.fill(0.0);
    let error = diagnose(&nameplate(), &still).unwrap_err();
    assert!(
        error.to_string().contains("0 rows of the torque balance"),
        "{error}"
    );
    let mut by_current = evidence(&axis(), 1);
    by_current.training.input = Input::Current;
    let error = diagnose(&nameplate(), &by_current).unwrap_err();
    assert!(error.to_string().contains("torque_n_m_per_a"), "{error}");
}
