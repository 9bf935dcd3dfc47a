//! Diagnosis of runs whose truth is known. Runs of the emulator, whose effects have other forms than the catalogue's,
//! are diagnosed in `tests/`.

use super::kit::{candidate, evidence, held, nameplate, names, record, truth, with};
use super::*;
use drivebench_identify::noise::{FloorSource, NoiseFloor};
use drivebench_model::numerics::statistics::largest;
use drivebench_model::plant::{
    ActiveEffect, Card, Enters, Instant, Model, MotorKey, Scenario, Terms, effect, testing,
};

/// Whether a size is the true one but for its uncertainty.
fn is_of_size(candidate: &Candidate, truth: f64) -> bool {
    let size = &candidate.parameters[0];
    let (value, std) = (size.value.unwrap(), size.std.unwrap());
    (value - truth).abs() < 5.0 * std + 0.02 * truth
}

#[test]
fn a_single_effect_is_named_and_reduces_the_error_to_the_floor() {
    for (id, values) in [
        ("quadratic_load", &[2e-6][..]),
        ("lagged_load", &[3e-6, 0.4]),
        ("lagged_drag", &[8e-4, 0.15]),
        ("stribeck_friction", &[0.12, 9.0]),
        ("voltage_drop", &[0.9]),
        ("constant_load", &[0.06]),
    ] {
        let found = diagnose(&nameplate(), evidence(&truth(id, values), 1)).unwrap();
        assert_eq!(found.answer(), Answer::Found, "{id}");
        assert_eq!(found.effects, vec![id]);
        assert!(found.sufficient && found.holdout_after < 1.15, "{id}: {}", found.holdout_after);
        let first = &found.candidates[0];
        assert_eq!((first.effect, first.status), (id, Status::Supported));
        assert!(is_of_size(first, values[0]), "{first:?} of {}", values[0]);
    }
}

/// Friction that rises while the shaft is slow, and falls while it turns: an effect that the catalogue does not have.
struct Dwell;

impl Terms for Dwell {
    fn torque_n_m(&self, at: &Instant, own: &[f64]) -> f64 {
        0.3 * own[0] * (at.speed_rad_s / 2.0).tanh()
    }

    fn states(&self) -> usize {
        1
    }

    fn derivative(&self, at: &Instant, own: &[f64], out: &mut [f64]) {
        out[0] = ((-(at.speed_rad_s / 15.0).powi(2)).exp() - own[0]) / 0.5;
    }
}

#[test]
fn an_unknown_memory_is_left_unexplained_and_nothing_false_is_named() {
    static EFFECT: Card =
        Card { id: "dwell", enters: Enters::Torque, terms: |_| Box::new(Dwell), ..Card::PLAIN };
    let mut machine = nameplate();
    machine.effects.push(ActiveEffect::with(&EFFECT, &[]));
    let run = |turn: usize, seed: u64| {
        let mut levels_v = [50.0, 0.0, -50.0, 0.0, 90.0, 5.0, -90.0, -4.0, 30.0, 0.0, 70.0, -30.0];
        levels_v.rotate_left(5 * turn);
        let levels_v = [levels_v, levels_v.map(|level_v| 0.8 * level_v)].concat();
        testing::record(&machine, held(&levels_v, 0.5), 0.004, 12.5, seed)
    };
    let data = Evidence::new(run(1, 1), Some(run(2, 2)), None);
    let found = diagnose(&nameplate(), data).unwrap();
    assert_eq!(found.answer(), Answer::Unexplained, "{:?}", found.effects);
    assert!(found.effects.is_empty() && !found.sufficient, "{:?}", found.effects);
    let kinds: Vec<UnknownKind> = found.unknown.iter().map(|own| own.kind).collect();
    assert_eq!(kinds, [UnknownKind::TorqueOverPastSpeed], "{:?}", found.unknown);
}

#[test]
fn a_complete_model_has_no_missing_effect() {
    for seed in 0..4 {
        let found = diagnose(&nameplate(), evidence(&nameplate(), seed)).unwrap();
        assert_eq!(found.verdict, DiagnosisVerdict::None, "{:?}", found.effects);
        assert_eq!((found.effect, found.sufficient), (None, true));
    }
}

#[test]
fn a_model_without_predictive_power_has_no_conclusion() {
    // The hold-out has the voltage of another run.
    let mut data = evidence(&nameplate(), 2);
    data.holdout.events = record(&nameplate(), 4, 5).events;
    let mut model = nameplate();
    model.fixed = vec!["resistance_ohm".to_owned()];
    let found = diagnose(&model, data).unwrap();
    assert_eq!(found.verdict, DiagnosisVerdict::NotFitted, "{:?}", found.effects);
    assert!(found.effects.is_empty() && found.candidates.is_empty() && found.unknown.is_empty());
    assert!(found.reason.is_some() && !found.sufficient, "{:?}", found.reason);
    // All lists agree on each parameter, and a given value stays.
    for parameters in [&found.parameters, &found.baseline.parameters, &found.model.parameters] {
        for own in parameters {
            let is_given = own.key == "resistance_ohm";
            assert_eq!(own.value.is_some(), is_given, "{own:?}");
        }
    }
}

/// Steps at these instants, in periods of a log that has the voltage of its rows only.
fn logged(truth: &Model, begins: impl Iterator<Item = f64>, seed: u64) -> Scenario {
    let period_s = 6e-3;
    let level = |step: u64| 12.0 * ((step + seed) * (step + seed) % 17) as f64 - 90.0;
    let steps = begins.zip(1..).map(|(begin, step)| (begin * period_s, level(step)));
    let events = std::iter::once((0.0, 0.0)).chain(steps).collect();
    let run = testing::record(truth, events, period_s, 8.0, seed);
    Scenario::from_run(&testing::with_rows_lost(&run, |_| false)).unwrap()
}

#[test]
fn steps_between_two_rows_of_a_log_are_no_effect() {
    for (truth, expected) in
        [(nameplate(), &[][..]), (truth("voltage_drop", &[4.0]), &["voltage_drop"])]
    {
        let run = |seed: u64| {
            let begin = |step: u64| (40 * step + 100) as f64 + (step as f64 * 0.618_034).fract();
            logged(&truth, (0..30).map(begin), seed)
        };
        let found = diagnose(&nameplate(), Evidence::new(run(1), Some(run(2)), None)).unwrap();
        assert!(run(1).has_sampled_input() && found.sufficient, "{:?}", found.verdict);
        assert_eq!(names(&found), expected);
        let more = found.candidates.iter().filter(|own| !expected.contains(&own.effect));
        assert!(more.clone().all(|own| own.probability < 0.5), "{:?}", found.candidates);
    }
}

#[test]
fn an_error_without_an_effect_is_unexplained() {
    // A shaker at 5 Hz: nothing in the catalogue depends on time like that.
    let mut data = evidence(&nameplate(), 2);
    for run in [&mut data.training, &mut data.holdout] {
        for (k, time_s) in run.sample_time_s.iter().enumerate().skip(130) {
            run.speed_rad_s[k] += 2.0 * (31.4 * time_s).sin();
        }
    }
    let found = diagnose(&nameplate(), data).unwrap();
    assert_eq!(found.verdict, DiagnosisVerdict::Unexplained, "{:?}", found.effects);
    assert!(!found.sufficient && found.effects.is_empty());
    // Between the frequencies that were tried a coupling may be what is left.
    let coupling = candidate(&found, "elastic_coupling");
    assert!(coupling.is_open && coupling.status != Status::RuledOut, "{coupling:?}");
}

#[test]
fn saturation_of_an_inductance_that_no_run_determines_stays_open() {
    // Currents settle within L/R: a hundredth of the period, and four of them.
    for (inductance_h, is_open) in [(1e-4, true), (0.044, false)] {
        let mut motor = nameplate();
        motor.motor.set(MotorKey::Inductance, inductance_h);
        let run = |seed: u64| {
            let level = |step: u64| 12.0 * ((step + seed) * (step + seed) % 17) as f64 - 90.0;
            let steps = (0..30).map(|step| (0.6 + 0.45 * step as f64, level(step)));
            let events = std::iter::once((0.0, 0.0)).chain(steps).collect();
            testing::record(&motor, events, 0.01, 14.1, seed)
        };
        let found = diagnose(&motor, Evidence::new(run(1), Some(run(2)), None)).unwrap();
        assert!(found.effects.is_empty(), "{:?}", found.effects);
        let own = candidate(&found, "inductance_saturation");
        assert_eq!(own.status != Status::RuledOut, is_open, "{inductance_h} {own:?}");
    }
}

#[test]
fn two_effects_are_both_found() {
    let both: [(&str, &[f64]); 2] = [("voltage_drop", &[1.2]), ("quadratic_load", &[2.5e-6])];
    let data = evidence(&with(nameplate(), &both), 3);
    let found = diagnose(&nameplate(), data.clone()).unwrap();
    assert_eq!(names(&found), ["quadratic_load", "voltage_drop"]);
    assert!(found.ladder.windows(2).all(|rungs| rungs[1].holdout_rmse < rungs[0].holdout_rmse));
    // They come first, in the order of the answer, and their sizes are those of the fit with both.
    for (place, id) in found.effects.iter().enumerate() {
        let candidate = &found.candidates[place];
        assert_eq!((candidate.effect, candidate.rank), (*id, place + 1));
        assert_eq!(candidate.status, Status::Supported);
        let true_size = both.iter().find(|(known, _)| known == id).unwrap().1[0];
        assert!(is_of_size(candidate, true_size), "{candidate:?} of {true_size}");
        let size = &candidate.parameters[0];
        let mut joint = found.model.parameters.iter();
        assert_eq!(joint.find(|own| own.key == size.key), Some(size));
        let reached = candidate.reached.unwrap();
        let fastest = largest(data.training.speed_rad_s.iter().copied());
        let (peak, true_peak) = match reached.voltage_v {
            Some(voltage) => (voltage, true_size),
            None => (reached.torque_n_m.unwrap(), true_size * fastest * fastest),
        };
        assert!((peak.value / true_peak - 1.0).abs() < 0.05, "{peak:?}");
        assert!(candidate.probability > 0.99);
        assert!(matches!(candidate.finding, CandidateFinding::Named { .. }));
    }
}

#[test]
fn one_run_alone_is_split() {
    let run = record(&truth("voltage_drop", &[1.2]), 0, 4);
    let found = diagnose(&nameplate(), Evidence::new(run, None, None)).unwrap();
    assert_eq!(found.holdout_from, HoldoutFrom::Split);
    assert_eq!(found.effect, Some("voltage_drop"));
}

#[test]
fn an_absent_effect_is_refused_and_a_present_one_is_kept() {
    let fan = effect::find("quadratic_load").unwrap();
    let refused = add(fan, &nameplate(), evidence(&nameplate(), 5)).unwrap();
    assert!(!refused.accepted, "{:?}", refused.finding);
    assert!(matches!(refused.finding, ChangeFinding::NotThere { .. }), "{:?}", refused.finding);
    let data = evidence(&truth("quadratic_load", &[2e-6]), 5);
    let accepted = add(fan, &nameplate(), data.clone()).unwrap();
    assert!(accepted.accepted && accepted.probability > 0.99, "{:?}", accepted.finding);
    assert!(matches!(accepted.finding, ChangeFinding::There { .. }), "{:?}", accepted.finding);
    let [before, after] = accepted.confirm.as_ref().unwrap();
    assert!(after.holdout_rmse < 0.6 * before.holdout_rmse);
    let needed = remove(fan, &accepted.fit.model, data).unwrap();
    assert_eq!((needed.accepted, needed.finding), (false, ChangeFinding::Needed));
}

#[test]
fn a_signal_without_samples_at_rest_is_a_limit_and_the_other_is_judged() {
    let mut data = evidence(&truth("quadratic_load", &[2e-6]), 8);
    for run in [&mut data.training, &mut data.holdout] {
        // Of the 125 samples at rest only the last seven show the current.
        run.current_a[..118].fill(f64::NAN);
    }
    let data = Evidence::new(data.training, Some(data.holdout), None);
    assert!(data.noise.current_a.is_infinite() && data.noise.speed_rad_s.is_finite());
    let found = diagnose(&nameplate(), data.clone()).unwrap();
    let [limit] = &found.limits[..] else {
        panic!("{:?}", found.limits);
    };
    let why = Unjudged::FewAtRest { samples: 7, needed: 8 };
    assert_eq!(*limit, Limit::SignalUnjudged { signal: "current", why });
    assert_eq!(found.effect, Some("quadratic_load"));
    let compared = compared(data);
    assert!(compared.limits.contains(limit), "{:?}", compared.limits);
    // Its error is still known, but not in units of its noise.
    let current = compared.signals.current_a.unwrap();
    assert!(current.noise_floor.is_none() && current.holdout.rmse > 0.0, "{current:?}");
    assert!(current.fit_percent > 50.0, "{current:?}");
    // Complete runs have no such limit.
    assert_eq!(evidence(&nameplate(), 8).unjudged(), []);
}

#[test]
fn the_offset_of_the_hosts_stamps_is_estimated_with_the_named_effects_and_is_no_finding() {
    // Commands that act 0.9 ms after their stamps, each within 0.05 ms; in the confirming run 0.4 ms later.
    let (offset_s, half_width_s, more_s) = (9e-4, 5e-4, 4e-4);
    let stamped = |mut run: Scenario, offset_s: f64| {
        for (number, event) in run.events.iter_mut().enumerate().skip(1) {
            event.0 -= offset_s + 5e-5 * (number as f64 * 2.4).sin();
        }
        run.time_half_width_s = vec![half_width_s; run.samples()];
        run
    };
    for machine in [nameplate(), truth("current_filter", &[6e-3])] {
        let Evidence { training, holdout, confirm, .. } = evidence(&machine, 4);
        let confirm = confirm.map(|run| stamped(run, offset_s + more_s));
        let holdout = stamped(holdout, offset_s);
        let data = Evidence::new(stamped(training, offset_s), Some(holdout), confirm);
        let found = diagnose(&nameplate(), data.clone()).unwrap();
        assert_eq!(found.effects, machine.effect_ids());
        let model = &found.model.model;
        assert!((model.input_delay_s.unwrap() / offset_s - 1.0).abs() < 0.2, "{model:?}");
        let is_offset = |limit: &Limit| matches!(limit, Limit::StampsOffset { .. });
        assert!(found.limits.iter().any(is_offset), "{:?}", found.limits);
        let of_runs = found.limits.iter().filter_map(|limit| match limit {
            Limit::OffsetOfRun { offset_s, .. } => Some(*offset_s),
            _ => None,
        });
        let of_runs: Vec<f64> = of_runs.collect();
        assert!(
            matches!(of_runs[..], [one_s] if (one_s / more_s - 1.0).abs() < 0.2),
            "{of_runs:?}"
        );
        let step_s = |data: &Evidence| data.confirm.as_ref().unwrap().events[2].0;
        let moved_s = step_s(&data.clone().moved_as(&found.limits)) - step_s(&data);
        assert!((moved_s - of_runs[0]).abs() < 1e-9, "{moved_s}");
        assert!(found.confirm.as_ref().unwrap().error_after.unwrap() < 1.6, "{:?}", found.confirm);
        // What the stamps err at random and the fit's share of the offset leave.
        assert!(found.holdout_after < 1.6, "{}", found.holdout_after);
    }
}

/// Comparison of the fitted nameplate with the runs.
fn compared(data: Evidence) -> Comparison {
    let (data, baseline) = data.with_baseline(&nameplate()).unwrap();
    compare(&baseline.model, &data, ErrorOf::Structure).unwrap()
}

#[test]
fn a_fitted_model_without_predictive_power_has_no_locations_and_a_given_one_has() {
    let data = evidence(&nameplate(), 6);
    let mut heavy = nameplate();
    heavy.motor.set(MotorKey::Inertia, 10.0);
    let fitted = compare(&heavy, &data, ErrorOf::Structure).unwrap();
    assert!(
        fitted.not_fitted.is_some() && fitted.locations.is_empty() && fitted.balances.is_empty()
    );
    assert_eq!(fitted.where_it_fails().0, Where::NotFitted);
    let given = compare(&heavy, &data, ErrorOf::Model).unwrap();
    assert!(given.not_fitted.is_none() && !given.balances.is_empty());
    assert_eq!(compared(data).not_fitted, None);
}

#[test]
fn a_repeat_gives_the_floor_that_the_standstill_gives_when_only_sensors_are_noisy() {
    let data = evidence(&nameplate(), 7);
    let unknown = Evidence { noise: NoiseFloor::from_spread(&data.training), ..data.clone() };
    let repeat = record(&nameplate(), 0, 99);
    let repeated = unknown.with_repeat(&nameplate(), repeat).unwrap();
    assert_eq!(repeated.noise.source, FloorSource::Repeat);
    assert!((repeated.noise.speed_rad_s / data.noise.speed_rad_s - 1.0).abs() < 0.2);
}

/// The same record with another drift of the speed sensor in each run.
fn drifting(seed: u32) -> Scenario {
    let mut run = record(&nameplate(), 0, u64::from(seed));
    let mut state = seed;
    let mut drift = 0.0;
    for speed in &mut run.speed_rad_s {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        drift = 0.999 * drift + 0.05 * (f64::from(state >> 8) / f64::from(1 << 24) - 0.5);
        *speed += if *speed == 0.0 { 0.0 } else { drift };
    }
    run
}

#[test]
fn a_machine_that_does_not_repeat_is_not_called_complete() {
    let repeated = |data: Evidence, repeat: Scenario| {
        diagnose(&nameplate(), data.with_repeat(&nameplate(), repeat).unwrap()).unwrap()
    };
    let found = repeated(evidence(&nameplate(), 8), record(&nameplate(), 0, 98));
    let expected = (DiagnosisVerdict::None, Some(true));
    assert_eq!((found.verdict, found.repeats), expected);
    let data = Evidence::new(drifting(3), Some(drifting(4)), None);
    let found = repeated(data, drifting(5));
    assert_eq!(found.repeats, Some(false), "{:?}", found.repeat_floor);
    assert_eq!(found.verdict, DiagnosisVerdict::Unexplained, "{:?}", found.effects);
    // It depends on the time alone.
    assert_eq!(found.repeat_follows[0].variable, "time_s", "{:?}", found.repeat_follows);
}

#[test]
fn the_location_combines_windows_and_the_residual_of_the_whole_run() {
    let whole = compared(evidence(&nameplate(), 6));
    let place = |change: &dyn Fn(&mut Comparison)| {
        let mut found = whole.clone();
        found.locations.clear();
        found.balances.iter_mut().for_each(|own| own.fails = false);
        found.residual = ResidualLights {
            white: true,
            enough_samples: true,
            independent_of_input: Some(true),
            ..ResidualLights::default()
        };
        change(&mut found);
        found.where_it_fails().0
    };
    assert_eq!(place(&|_| {}), Where::Nowhere);
    // The windows find nothing, the whole run does.
    assert_eq!(place(&|found| found.residual.white = false), Where::OverTheWholeRun);
    assert_eq!(place(&|found| found.residual.enough_samples = false), Where::Nowhere);
    assert_eq!(place(&|found| found.balances[0].nres = None), Where::NoNoiseFloor);
    assert_eq!(place(&|found| found.balances[0].fails = true), Where::AlongNothing);
    assert_eq!(place(&|found| found.balances.clear()), Where::NoBalance);
    // The first location is not among the others.
    let missing = compared(evidence(&truth("stribeck_friction", &[0.3, 12.0]), 6));
    let (first, others) = missing.where_it_fails();
    let named = usize::from(first == Where::First);
    assert_eq!(others.len() + named, missing.locations.len());
}
