//! Diagnosis of runs whose truth is known. Runs of the emulator, whose effects have other forms than the catalogue's,
//! are diagnosed in `tests/`.

use super::*;
use crate::identification::noise::{FloorSource, NoiseFloor};
use crate::plant::{Model, Motor, Scenario, effect, testing};

/// Staircase both ways with slow passages through zero; `shift` makes another run of it.
fn events(shift: usize) -> Vec<(f64, f64)> {
    let levels = [
        0.0, 30.0, 60.0, 90.0, 40.0, 3.0, -3.0, -40.0, -90.0, -50.0, 4.0, 0.0, 70.0, -70.0, 20.0,
    ];
    let mut events = vec![(0.0, 0.0)];
    for (step, _) in levels.iter().enumerate().skip(1) {
        let level = levels[1 + (step + 3 * shift) % (levels.len() - 1)];
        events.push((0.5 * step as f64, level));
        events.push((
            0.5 * step as f64 + 0.25,
            level + if step % 2 == 0 { 5.0 } else { -5.0 },
        ));
    }
    events
}

pub(super) fn record(model: &Model, shift: usize, seed: u64) -> Scenario {
    testing::record(model, events(shift), 0.004, 7.5, seed)
}

pub(super) fn evidence(truth: &Model, seed: u64) -> Evidence {
    let run = |shift: usize| record(truth, shift, 10 * seed + shift as u64);
    Evidence::new(run(0), Some(run(1)), Some(run(2)))
}

pub(super) fn truth(id: &str, values: &[f64]) -> Model {
    let mut model = Model::baseline(Motor::zk_22fc()).with_effect(id).unwrap();
    model.effects[0].values = values.iter().copied().map(Some).collect();
    model
}

pub(super) fn nameplate() -> Model {
    Model::baseline(Motor::zk_22fc())
}

#[test]
fn a_single_effect_is_named_and_the_error_falls_to_the_floor() {
    for (id, values) in [
        ("quadratic_load", &[2e-6][..]),
        ("stribeck_friction", &[0.12, 9.0]),
        ("voltage_drop", &[0.9]),
        ("constant_load", &[0.06]),
    ] {
        let diagnosis = diagnose(&nameplate(), evidence(&truth(id, values), 1)).unwrap();
        assert_eq!(
            diagnosis.verdict,
            DiagnosisVerdict::Effect,
            "{id}: {}",
            diagnosis.sentence
        );
        assert_eq!(diagnosis.effects, vec![id]);
        assert!(
            diagnosis.sufficient && diagnosis.holdout_after < 1.15,
            "{}",
            diagnosis.sentence
        );
        let first = &diagnosis.candidates[0];
        assert_eq!((first.effect, first.status), (id, Status::Supported));
        let size = &first.parameters[0];
        let (value, std) = (size.value.unwrap(), size.std.unwrap());
        assert!(
            (value - values[0]).abs() < 5.0 * std + 0.02 * values[0],
            "{size:?} of {}",
            values[0]
        );
    }
}

#[test]
fn nothing_is_named_when_nothing_is_missing() {
    for seed in 0..4 {
        let diagnosis = diagnose(&nameplate(), evidence(&nameplate(), seed)).unwrap();
        assert_eq!(
            diagnosis.verdict,
            DiagnosisVerdict::None,
            "{}",
            diagnosis.sentence
        );
        assert_eq!((diagnosis.effect, diagnosis.sufficient), (None, true));
    }
}

#[test]
fn an_error_that_no_effect_explains_is_called_unexplained() {
    // A shaker at 5 Hz: nothing in the catalogue depends on time like that.
    let mut data = evidence(&nameplate(), 2);
    for run in [&mut data.training, &mut data.holdout] {
        for (k, time_s) in run.sample_time_s.iter().enumerate().skip(130) {
            run.speed_rad_s[k] += 2.0 * (31.4 * time_s).sin();
        }
    }
    let diagnosis = diagnose(&nameplate(), data).unwrap();
    assert_eq!(
        diagnosis.verdict,
        DiagnosisVerdict::Unexplained,
        "{}",
        diagnosis.sentence
    );
    assert!(!diagnosis.sufficient && diagnosis.effects.is_empty());
}

#[test]
fn two_effects_are_both_found() {
    let mut both = truth("voltage_drop", &[1.2])
        .with_effect("quadratic_load")
        .unwrap();
    both.effects[1].values = vec![Some(2.5e-6)];
    let data = evidence(&both, 3);
    let diagnosis = diagnose(&nameplate(), data.clone()).unwrap();
    let mut found = diagnosis.effects.clone();
    found.sort_unstable();
    assert_eq!(
        found,
        ["quadratic_load", "voltage_drop"],
        "{}",
        diagnosis.sentence
    );
    assert!(
        diagnosis
            .ladder
            .windows(2)
            .all(|rungs| rungs[1].holdout_rmse < rungs[0].holdout_rmse)
    );
    // They come first, in the order of the answer, and their sizes are those of the fit with both.
    for (place, id) in diagnosis.effects.iter().enumerate() {
        let candidate = &diagnosis.candidates[place];
        assert_eq!((candidate.effect, candidate.rank), (*id, place + 1));
        assert_eq!(candidate.status, Status::Supported);
        let size = &candidate.parameters[0];
        let true_size = if *id == "voltage_drop" { 1.2 } else { 2.5e-6 };
        let (value, std) = (size.value.unwrap(), size.std.unwrap());
        assert!(
            (value - true_size).abs() < 5.0 * std + 0.02 * true_size,
            "{size:?} of {true_size}"
        );
        let mut joint = diagnosis.model.parameters.iter();
        assert_eq!(joint.find(|own| own.key == size.key), Some(size));
        let reached = candidate.reached.unwrap();
        let (peak, true_peak) = if *id == "voltage_drop" {
            (reached.voltage_v.unwrap(), 1.2)
        } else {
            let torque = reached.torque_n_m.unwrap();
            let fastest = data.training.speed_rad_s.iter();
            let fastest = fastest.fold(0.0, |most: f64, speed| most.max(speed.abs()));
            (torque, 2.5e-6 * fastest * fastest)
        };
        assert!((peak.value / true_peak - 1.0).abs() < 0.05, "{peak:?}");
        assert!(candidate.probability > 0.99 && candidate.evidence.contains("99 %"));
    }
}

#[test]
fn one_run_alone_is_split_and_says_so() {
    let run = record(&truth("voltage_drop", &[1.2]), 0, 4);
    let diagnosis = diagnose(&nameplate(), Evidence::new(run, None, None)).unwrap();
    assert_eq!(diagnosis.holdout_from, HoldoutFrom::Split);
    assert_eq!(
        diagnosis.effect,
        Some("voltage_drop"),
        "{}",
        diagnosis.sentence
    );
}

#[test]
fn an_effect_that_does_not_pay_is_refused_and_one_that_does_can_be_taken_out_again() {
    let data = evidence(&truth("quadratic_load", &[2e-6]), 5);
    let plain = evidence(&nameplate(), 5);
    let refused = add(effect::find("quadratic_load").unwrap(), &nameplate(), plain).unwrap();
    assert!(!refused.accepted, "{}", refused.reason);
    // In words that need no statistics: how much, and how sure.
    assert!(
        refused.reason.contains("the held-out error") && refused.reason.contains("is there with"),
        "{}",
        refused.reason
    );
    let fan = effect::find("quadratic_load").unwrap();
    let accepted = add(fan, &nameplate(), data.clone()).unwrap();
    assert!(accepted.accepted, "{}", accepted.reason);
    let falls = 100.0 * (1.0 - accepted.after.holdout_rmse / accepted.before.holdout_rmse);
    for words in [&format!("falls by {falls:.1} %"), "with more than 99 %"] {
        assert!(accepted.reason.contains(words), "{}", accepted.reason);
    }
    let [before, after] = accepted.confirm.as_ref().unwrap();
    assert!(after.holdout_rmse < 0.6 * before.holdout_rmse);
    let needed = remove(fan, &accepted.fit.model, data).unwrap();
    assert!(!needed.accepted, "{}", needed.reason);
}

#[test]
fn a_signal_without_rest_samples_is_named_with_the_reason_and_the_other_answers() {
    let mut data = evidence(&truth("quadratic_load", &[2e-6]), 8);
    for run in [&mut data.training, &mut data.holdout] {
        // Of the 125 samples at rest only the last ten show the current.
        run.current_a[..115].fill(f64::NAN);
    }
    let data = Evidence::new(data.training, Some(data.holdout), None);
    assert!(data.noise.current_a.is_infinite() && data.noise.speed_rad_s.is_finite());
    let diagnosis = diagnose(&nameplate(), data.clone()).unwrap();
    let [limit] = &diagnosis.limits[..] else {
        panic!("{:?}", diagnosis.limits);
    };
    for word in ["current_a", "10 samples", "20 are needed", "speed alone"] {
        assert!(limit.contains(word), "{word}: {limit}");
    }
    assert_eq!(
        diagnosis.effect,
        Some("quadratic_load"),
        "{}",
        diagnosis.sentence
    );
    let (data, baseline) = data.with_baseline(&nameplate()).unwrap();
    let compared = compare(&baseline.model, &data, ErrorOf::Structure).unwrap();
    assert!(compared.limits.contains(limit), "{:?}", compared.limits);
    // How good the model is for it can still be said; only not in units of its noise.
    let current = compared.signals.current_a.unwrap();
    assert!(
        current.noise_floor.is_none() && current.holdout.rmse > 0.0 && current.fit_percent > 50.0,
        "{current:?}"
    );
    // Nothing is said of runs that lack nothing.
    let whole = evidence(&nameplate(), 8);
    assert_eq!(whole.unjudged(), Vec::<String>::new());
}

#[test]
fn the_location_names_equation_and_axis() {
    let data = evidence(&truth("stribeck_friction", &[0.3, 12.0]), 6);
    let (data, baseline) = data.with_baseline(&nameplate()).unwrap();
    let comparison = compare(&baseline.model, &data, ErrorOf::Structure).unwrap();
    let first = &comparison.locations[0];
    assert_eq!(
        (first.equation, first.variable),
        ("torque", "speed_rad_s"),
        "{first:?}"
    );
    assert!(first.from < 0.0 && first.to > 0.0, "{first:?}");
    assert!(!comparison.residual.white);
    let drop = evidence(&truth("voltage_drop", &[1.5]), 6);
    let (drop, baseline) = drop.with_baseline(&nameplate()).unwrap();
    assert_eq!(
        compare(&baseline.model, &drop, ErrorOf::Structure)
            .unwrap()
            .locations[0]
            .equation,
        "voltage"
    );
}

#[test]
fn a_repeat_gives_the_floor_that_the_standstill_gives_when_only_sensors_are_noisy() {
    let data = evidence(&nameplate(), 7);
    let unknown = Evidence {
        noise: NoiseFloor::from_spread(&data.training),
        ..data.clone()
    };
    let repeated = unknown
        .with_repeat(&nameplate(), record(&nameplate(), 0, 99))
        .unwrap();
    assert_eq!(repeated.noise.source, FloorSource::Repeat);
    assert!((repeated.noise.speed_rad_s / data.noise.speed_rad_s - 1.0).abs() < 0.2);
}

/// The same record with a reading of the speed that drifts otherwise in each run.
fn wandering(seed: u32) -> Scenario {
    let mut run = record(&nameplate(), 0, u64::from(seed));
    let mut state = seed;
    let mut wander = 0.0;
    for speed in &mut run.speed_rad_s {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        wander = 0.999 * wander + 0.05 * (f64::from(state >> 8) / f64::from(1 << 24) - 0.5);
        *speed += if *speed == 0.0 { 0.0 } else { wander };
    }
    run
}

#[test]
fn a_machine_that_does_not_repeat_is_not_called_complete() {
    let still = evidence(&nameplate(), 8);
    let repeats = still
        .clone()
        .with_repeat(&nameplate(), record(&nameplate(), 0, 98))
        .unwrap();
    let found = diagnose(&nameplate(), repeats).unwrap();
    assert_eq!(
        (found.verdict, found.repeats),
        (DiagnosisVerdict::None, Some(true))
    );
    let data = Evidence::new(wandering(3), Some(wandering(4)), None)
        .with_repeat(&nameplate(), wandering(5))
        .unwrap();
    let found = diagnose(&nameplate(), data).unwrap();
    assert_eq!(found.repeats, Some(false), "{:?}", found.repeat_floor);
    assert_eq!(
        found.verdict,
        DiagnosisVerdict::Unexplained,
        "{}",
        found.sentence
    );
    assert!(
        found.sentence.contains("does not repeat"),
        "{}",
        found.sentence
    );
    // It follows nothing that repeats: the time alone.
    let follows = &found.repeat_follows[0];
    assert_eq!(follows.variable, "time_s", "{}", found.sentence);
}
