//! Tests of events, which occur once in a run: identified with their time, in the runs in which they occurred only.

use super::kit::{candidate, nameplate, record, truth};
use super::*;
use crate::joint::answer::RunOf;
use drivebench_model::plant::{Model, Scenario, effect, testing};
use drivebench_model::sample::Verdict;

/// Steps of the voltage throughout, in both directions: persistent excitation.
fn steps(model: &Model, shift: usize, seed: u64) -> Scenario {
    let levels = [30.0, 60.0, 45.0, 75.0, 20.0, 70.0, 35.0];
    let step = |step: usize| {
        let level = levels[(step * (1 + shift) + shift) % levels.len()];
        let is_forward = (step / 16).is_multiple_of(2);
        let sign = if is_forward { 1.0 } else { -1.0 };
        (0.3 + 0.09 * step as f64, sign * level)
    };
    let events = std::iter::once((0.0, 0.0)).chain((0..80).map(step));
    testing::record(model, events.collect(), PERIOD_S, 7.5, seed)
}

fn with(id: &str, size: f64, time_s: Option<f64>) -> Model {
    time_s.map_or_else(nameplate, |time_s| truth(id, &[size, time_s]))
}

/// Fit run and hold-out with the event at these times, or without it.
fn evidence(id: &str, size: f64, [fit, holdout]: [Option<f64>; 2], seed: u64) -> Evidence {
    let training = steps(&with(id, size, fit), 0, 10 * seed);
    let holdout = steps(&with(id, size, holdout), 1, 10 * seed + 1);
    Evidence::new(training, Some(holdout), None)
}

const PERIOD_S: f64 = 0.01;
/// Samples by which an onset may be off.
const FEW: f64 = 2.5;

#[test]
fn an_event_is_named_with_its_time_and_its_runs() {
    for (id, size, times_s) in [
        ("load_step", 0.1, [Some(5.02), None]),
        ("one_sided_load", 0.1, [None, Some(3.13)]),
        ("friction_onset", 6e-4, [Some(2.6), Some(5.1)]),
        ("load_step", 0.1, [Some(5.02), Some(3.13)]),
        ("inertia_change", 0.3, [Some(5.02), Some(5.02)]),
    ] {
        let found = diagnose(&nameplate(), evidence(id, size, times_s, 3)).unwrap();
        assert_eq!(found.effects, [id], "{times_s:?}");
        assert_eq!(found.verdict, DiagnosisVerdict::Effect, "{id} {times_s:?}");
        assert!(found.holdout_after < 1.2, "{id} {times_s:?}: {}", found.holdout_after);
        let first = &found.candidates[0];
        let expected = times_s.into_iter().zip([RunOf::Fit, RunOf::Holdout]);
        let expected = expected.filter_map(|(time_s, run)| Some((time_s?, run)));
        let expected: Vec<(f64, RunOf)> = expected.collect();
        assert_eq!(first.onsets.len(), expected.len(), "{:?}", first.onsets);
        for (onset, (time_s, run)) in first.onsets.iter().zip(expected) {
            assert_eq!(onset.run, run);
            let off_s = (onset.time_s - time_s).abs();
            assert!(off_s < FEW * PERIOD_S, "{id} at {time_s}: {onset:?}");
            let deviations = (onset.size - size).abs() / onset.size_std;
            assert!(deviations < 3.0, "{onset:?}");
        }
        if times_s[0].is_none() {
            let own = &first.parameters[0];
            assert!((own.value.unwrap() / size - 1.0).abs() < 0.1, "{own:?}");
        }
    }
    // The same rule for `add`.
    let data = evidence("inertia_change", 0.3, [Some(5.02), None], 4);
    let change = effect::find("inertia_change").unwrap();
    let added = add(change, &nameplate(), data).unwrap();
    assert!(added.accepted, "{:?}", added.finding);
}

#[test]
fn in_one_direction_a_load_is_not_distinguished_from_friction() {
    let one_way = |size: Option<f64>, shift: usize, seed: u64| {
        let model = with("one_sided_load", 0.15, size);
        let mut events = steps(&model, shift, seed).events;
        for event in &mut events {
            event.1 = event.1.abs();
        }
        testing::record(&model, events, PERIOD_S, 7.5, seed)
    };
    let data = Evidence::new(one_way(Some(4.1), 0, 5), Some(one_way(None, 1, 6)), None);
    let found = diagnose(&nameplate(), data).unwrap();
    assert_eq!(found.verdict, DiagnosisVerdict::Ambiguous, "{:?}", found.effects);
    let mut pair = found.confusable[0];
    pair.sort_unstable();
    assert_eq!(pair, ["load_step", "one_sided_load"]);
    // Being fitted makes neither the likelier one, and no value is settled while the pair is ambiguous.
    for id in pair {
        let own = candidate(&found, id).probability;
        assert!((0.3..0.7).contains(&own), "{id}: {own}");
    }
    let values = found.model.parameters.iter();
    let mut of_pair = values.filter(|own| own.key.starts_with(found.effects[0]));
    assert!(of_pair.all(|own| own.verdict != Verdict::Settled));
}

#[test]
fn without_an_event_none_is_probable() {
    let mut complete = 0;
    for seed in 0..10 {
        let data = evidence("load_step", 0.0, [None, None], 30 + seed);
        let found = diagnose(&nameplate(), data).unwrap();
        assert!(found.effects.is_empty(), "{:?}", found.effects);
        complete += usize::from(found.verdict == DiagnosisVerdict::None);
        for id in ["load_step", "one_sided_load", "friction_onset", "inertia_change"] {
            let event = candidate(&found, id);
            assert!(event.probability < 0.1, "{id}: {}", event.probability);
        }
    }
    // The floor of 28 samples at rest is too low by more than its allowance in about one case of two hundred.
    assert!(complete >= 9, "{complete}");
}

#[test]
fn an_effect_from_before_the_first_motion_is_no_event() {
    // Friction that falls with the speed from the begin: no permanent effect has that sign.
    let machine = truth("friction_onset", &[-3e-4, 0.1]);
    let data = Evidence::new(record(&machine, 0, 71), Some(record(&machine, 1, 72)), None);
    let found = diagnose(&nameplate(), data).unwrap();
    assert!(!found.effects.contains(&"friction_onset"), "{:?}", found.effects);
}

/// A run under the commands `applied` whose record has the commands `events`.
fn run(applied: Vec<(f64, f64)>, events: Vec<(f64, f64)>, end_s: f64, seed: u64) -> Scenario {
    Scenario { events, ..testing::record(&nameplate(), applied, PERIOD_S, end_s, seed) }
}

/// A drive that delays each start from rest, which the recorded commands do not show.
fn waiting(levels: &[f64], delay_s: f64, seed: u64) -> Scenario {
    let commands = |delay_s: f64| {
        let starts = levels.iter().enumerate().flat_map(|(start, level)| {
            let begin_s = 0.3 + 2.9 * start as f64;
            let steps = [(delay_s, 1.0), (1.1, 0.6), (1.9, 0.0)];
            steps.map(|(after_s, share)| (begin_s + after_s, share * level))
        });
        std::iter::once((0.0, 0.0)).chain(starts).collect()
    };
    let end_s = 0.3 + 2.9 * levels.len() as f64;
    run(commands(delay_s), commands(0.0), end_s, seed)
}

/// The same with one start from rest.
fn late(shift: usize, delay_s: f64, seed: u64) -> Scenario {
    let given = steps(&nameplate(), shift, seed).events;
    let begin_s = given[1].0 + delay_s;
    let held = given.iter().rfind(|event| event.0 <= begin_s).unwrap().1;
    let later = given.iter().filter(|event| event.0 > begin_s).copied();
    let applied = [(0.0, 0.0), (begin_s, held)].into_iter().chain(later);
    run(applied.collect(), given, 7.5, seed)
}

#[test]
fn a_delay_of_each_start_is_distinguished_from_one_of_the_first() {
    let each = [40.0, 70.0, -50.0, 25.0];
    let other = [60.0, -30.0, 80.0, 45.0];
    let waits = [waiting(&each, 0.25, 1), waiting(&other, 0.25, 2)];
    let begins_late = [late(0, 0.25, 3), late(1, 0.25, 4)];
    for ([fit, holdout], name) in [(waits, "restart_delay"), (begins_late, "start_delay")] {
        let data = Evidence::new(fit, Some(holdout), None);
        let found = diagnose(&nameplate(), data.clone()).unwrap();
        assert_eq!(found.effects, [name]);
        let delay = &found.candidates[0].parameters[0];
        assert!((delay.value.unwrap() - 0.25).abs() < 0.01, "{delay:?}");
        let added = add(effect::find(name).unwrap(), &nameplate(), data).unwrap();
        assert!(added.accepted, "{:?}", added.finding);
    }
}

#[test]
fn a_start_delay_seen_in_one_small_command_only_is_not_named() {
    let machine = truth("stribeck_friction", &[0.16, 10.0]);
    // A pulse that the drive ignores, long before the others: its current would be less than the sensor's noise.
    let with_ignored_pulse = |shift: usize, seed: u64| {
        let mut run = record(&machine, shift, seed);
        run.events.splice(1..1, [(0.1, 0.03), (0.112, 0.0)]);
        run
    };
    let data = Evidence::new(with_ignored_pulse(0, 51), Some(with_ignored_pulse(1, 52)), None);
    let found = diagnose(&nameplate(), data).unwrap();
    assert_eq!(found.effects, ["stribeck_friction"]);
    // More probable than not by the innovations, it is vetoed because it lowers no error, and it is not detectable in the
    // run; the veto leaves the mean of posterior and prior.
    let late = candidate(&found, "start_delay");
    assert!(
        (0.3..0.55).contains(&late.probability) && late.status == Status::NotExcited,
        "{}",
        late.probability
    );
    assert!(late.not_named.is_some(), "{late:?}");
}

#[test]
fn runs_that_cannot_be_concatenated_are_set_aside() {
    let first = |model: &Model| steps(model, 0, 31);
    for (id, values) in [("load_step", &[0.1, 3.02][..]), ("winding_heating", &[3e-3, 60.0])] {
        let machine = truth(id, values);
        let evidence = Evidence::new(first(&machine), Some(steps(&machine, 1, 32)), None);
        let alone = diagnose(&nameplate(), evidence.clone()).unwrap();
        assert!(alone.effects.contains(&id), "{:?}", alone.effects);
        let several = evidence.with_run(steps(&machine, 2, 33));
        let found = diagnose(&nameplate(), several.clone()).unwrap();
        let is_aside =
            |own: &Limit| matches!(own, Limit::RunsSetAside(aside) if aside.effects.contains(&id));
        assert!(found.limits.iter().any(is_aside), "{:?}", found.limits);
        // The answer is that of the first run alone, to the last digit.
        assert_eq!((found.answer(), &found.effects), (alone.answer(), &alone.effects));
        assert!((found.holdout_after - alone.holdout_after).abs() < 1e-9);
        let effect = effect::find(id).unwrap();
        assert!(add(effect, &nameplate(), several.clone()).unwrap().aside.is_some());
        let compared = compare(&found.model.model, &several, ErrorOf::Structure).unwrap();
        assert!(compared.limits.iter().any(is_aside));
    }
    // An effect of every run is fitted to both.
    let machine = truth("quadratic_load", &[2e-6]);
    let evidence = Evidence::new(first(&machine), Some(steps(&machine, 1, 32)), None);
    let found = diagnose(&nameplate(), evidence.with_run(steps(&machine, 2, 33))).unwrap();
    let is_aside = |own: &Limit| matches!(own, Limit::RunsSetAside(_));
    assert!(!found.limits.iter().any(is_aside), "{:?}", found.limits);
    assert!(found.effects.contains(&"quadratic_load"), "{:?}", found.effects);
}
