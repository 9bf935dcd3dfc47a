//! The contract that every effect of the catalogue keeps.

use std::collections::{BTreeMap, BTreeSet};

use super::*;
use crate::numerics::statistics::largest;
use crate::plant::testing::held;
use crate::plant::{
    ActiveEffect, Input, Model, ModelFile, Motor, Plant, RunScales, Scenario, State,
};
use crate::sample::Channel;

/// Ids and keys that model files, JSON and the command line use; a change here breaks files in the field.
const KEYS: &str = "
    viscous_friction viscous_n_m_s_per_rad
    quadratic_load quadratic_n_m_s2_per_rad2
    lagged_load lagged_n_m_s2_per_rad2 time_constant_s
    lagged_drag lagged_n_m_s_per_rad time_constant_s
    stribeck_friction stribeck_n_m stribeck_speed_rad_s
    constant_load constant_n_m
    asymmetric_viscous asymmetry_n_m_s_per_rad
    cogging order sin_n_m cos_n_m
    torque_ripple order sin_ratio cos_ratio
    eccentric_load sin_n_m cos_n_m
    load_dependent_friction ratio
    load_step step_n_m time_s
    one_sided_load load_n_m time_s
    friction_onset viscous_n_m_s_per_rad time_s
    inertia_change ratio time_s
    voltage_drop drop_v
    supply_sag sag_ohm
    winding_heating gain_per_a2_s time_constant_s
    flux_saturation saturation_per_a2
    inductance_saturation saturation_per_a2
    field_change drift_per_s
    discontinuous_conduction boundary_a extra_ohm
    command_delay delay_s
    start_delay delay_s
    restart_delay delay_s
    speed_delay delay_s
    speed_filter time_constant_s
    current_filter time_constant_s
    current_offset offset_a
    speed_offset offset_rad_s
    voltage_offset offset_v
    elastic_coupling frequency_hz inertia_ratio damping_ratio friction_split
    backlash frequency_hz inertia_ratio damping_ratio friction_split gap_rad";

/// Effects without a size that is zero.
fn is_finite_by_nature(effect: &dyn Effect) -> bool {
    couples(effect) || ["start_delay", "restart_delay"].contains(&effect.card().id)
}

/// Effects of a second inertia: no size of one coefficient makes them vanish in the balances.
fn couples(effect: &dyn Effect) -> bool {
    effect.terms(&guesses(effect)).coupling().is_some()
}

fn guesses(effect: &dyn Effect) -> Vec<f64> {
    effect.parameters().iter().map(ParameterSpec::guess).collect()
}

/// The guesses with every coefficient at `share` of its scale.
fn sized(effect: &dyn Effect, share: f64) -> Vec<f64> {
    let value = |spec: &ParameterSpec| match spec.role {
        ParameterRole::Coefficient => share * spec.scale,
        ParameterRole::Shape | ParameterRole::Choice => spec.guess(),
        // In the middle of the run below.
        ParameterRole::EventTime => 1.0,
    };
    effect.parameters().iter().map(value).collect()
}

fn instant() -> Instant {
    Instant {
        time_s: 1.6,
        voltage_v: 40.0,
        supply_v: 60.0,
        current_a: 3.0,
        speed_rad_s: 5.0,
        angle: ShaftAngle::at(0.7),
        ..Instant::of(&Motor::zk_22fc())
    }
}

/// Voltage, torque, friction and the gains on the rates.
fn added(effect: &dyn Effect, share: f64) -> [f64; 5] {
    let terms = effect.terms(&sized(effect, share));
    terms.sums(&instant(), &vec![2.0; terms.states()]).all()
}

fn path_of(effect: &dyn Effect, share: f64) -> [f64; 8] {
    let path = effect.terms(&sized(effect, share)).path();
    [
        path.command_delay_s,
        path.start_delay_s,
        path.restart_delay_s,
        path.speed_delay_s,
        path.speed_filter_s,
        path.current_filter_s,
        path.current_offset_a,
        path.speed_offset_rad_s,
    ]
}

/// Current and speed over steps both ways with a hold at rest before and between: every effect of the catalogue shows in it.
fn run(effects: Vec<ActiveEffect>) -> [Vec<f64>; 2] {
    let times: Vec<f64> = (0..1000).map(|k| 0.002 * f64::from(k)).collect();
    let speeds = times.iter().map(|t| 30.0 * (2.0 * t).sin()).collect();
    let events = held([0.0, 0.1, 0.6, 1.0, 1.5, 1.8], [0.0, 25.0, 50.0, -30.0, 6.0, 0.0]);
    let scenario = Scenario {
        current_a: vec![0.0; times.len()],
        speed_rad_s: speeds,
        ..Scenario::planned("contract", Input::Voltage, Channel::VoltageCmd, events, times)
    };
    let model = Model { effects, ..Model::baseline(Motor::zk_22fc()) };
    let found = Plant::new(&model, Input::Voltage).unwrap().simulate(&scenario, State::default());
    [found.current_a, found.speed_rad_s]
}

#[test]
fn effects_with_a_clock_or_a_state_go_on_over_runs() {
    let found = CATALOGUE.iter().filter(|own| own.goes_on_over_runs());
    let found: BTreeSet<&str> = found.map(|own| own.card().id).collect();
    let timed = "friction_onset inertia_change load_step one_sided_load";
    let expected =
        format!("{timed} field_change lagged_drag lagged_load start_delay winding_heating");
    assert_eq!(found, expected.split(' ').collect());
}

#[test]
fn ids_and_keys_are_those_that_files_use_and_are_unique() {
    let rows = KEYS.trim().lines().map(str::split_whitespace);
    let known = rows.map(|mut words| (words.next().unwrap(), words.collect::<BTreeSet<_>>()));
    let known: BTreeMap<_, _> = known.collect();
    assert_eq!(CATALOGUE.len(), known.len(), "an id that files use is gone");
    for effect in CATALOGUE {
        let id = effect.card().id;
        let keys = effect.parameters().iter().map(|spec| spec.key);
        assert_eq!(Some(&keys.collect()), known.get(id), "keys of {id}");
        assert_eq!(CATALOGUE.iter().filter(|other| other.card().id == id).count(), 1, "{id}");
    }
}

#[test]
fn every_card_has_its_texts() {
    for effect in CATALOGUE {
        let card = effect.card();
        assert!(card.name.len() > 4, "{}", card.id);
        assert!(card.equation.len() > 4, "{}: {:?}", card.id, card.equation);
        for text in [card.causes, card.looks_like, card.excite, card.remedy] {
            assert!(text.len() > 20, "{}: {text:?}", card.id);
            assert!(!text.contains("  "), "{}: {text:?}", card.id);
        }
    }
}

#[test]
fn the_first_coefficient_gives_an_effect_its_size() {
    const WIDTH: ParameterSpec = ParameterSpec::shape("width_rad_s", "rad/s", (0.1, 10.0), &[1.0]);
    const HEIGHT: ParameterSpec = ParameterSpec::coefficient("height_n_m", "N.m", 0.1);
    let rows: [(&str, &'static [ParameterSpec], _); 3] = [
        ("height first", &[HEIGHT, WIDTH], 0),
        ("height last", &[WIDTH, HEIGHT], 1),
        ("no height", &[WIDTH], 0),
    ];
    for (name, parameters, index) in rows {
        let card = Card { parameters, ..Card::PLAIN };
        assert_eq!(card.size_index(), index, "{name}");
    }
    for effect in CATALOGUE {
        assert_eq!(effect.size_index(), 0, "{}", effect.card().id);
    }
}

#[test]
fn cards_refer_to_effects_and_parameters_that_are_there() {
    for effect in CATALOGUE {
        let (card, specs) = (effect.card(), effect.parameters());
        let two = card.stands_for.iter().flatten();
        let others = card.alternatives.iter().chain(card.excludes).chain(two);
        for other in others.copied().chain(card.limit.map(|limit| limit.simpler)) {
            let is_another = other != card.id && find(other).is_some();
            assert!(is_another, "{}: {other}", card.id);
        }
        if let Some(limit) = card.limit {
            let spec = &specs[limit.parameter];
            assert!(spec.min < limit.least && limit.least < spec.max);
        }
        let has_order = specs.iter().any(|spec| spec.key == "order");
        assert!(card.harmonic.is_some() || !has_order, "{}", card.id);
    }
    for kind in [
        TermKind::Drag,
        TermKind::TorqueOffset,
        TermKind::LateCommand,
        TermKind::LateCurrent,
        TermKind::LateSpeed,
    ] {
        assert_eq!(kind.effect().parameters().len(), 1, "{kind:?}");
        assert!(find(kind.id()).is_some(), "{kind:?}");
    }
    let slope = TermKind::Drag.effect().parameters()[0].key;
    assert_eq!(VISCOUS_SLOPE, format!("{}.{slope}", TermKind::Drag.id()));
}

#[test]
fn parameters_have_a_unit_bounds_and_grids_inside_them() {
    for effect in CATALOGUE {
        let id = effect.card().id;
        let specs = effect.parameters();
        let has_size = specs.iter().any(ParameterSpec::is_coefficient);
        assert!(has_size || is_finite_by_nature(*effect), "{id} has no size");
        for spec in specs {
            let at = format!("{id}.{}", spec.key);
            assert!(!spec.unit.is_empty() && spec.scale > 0.0, "{at}");
            assert!(spec.min < spec.max, "{at}");
            assert!((spec.min..=spec.max).contains(&spec.guess()), "{at}");
            assert_eq!(spec.is_coefficient(), spec.shapes.is_empty(), "{at}");
            assert!(!spec.logarithmic || spec.min > 0.0, "{at}");
            assert!(spec.shapes.windows(2).all(|pair| pair[0] < pair[1]), "{at}");
            let bounds = match spec.role {
                ParameterRole::EventTime => (0.0, RunScales::REFERENCE.length_s),
                _ => (spec.min, spec.max),
            };
            let is_within = |shape: &f64| (bounds.0..=bounds.1).contains(shape);
            assert!(spec.shapes.iter().all(is_within), "{at}");
        }
    }
}

#[test]
fn size_zero_adds_nothing_and_a_small_size_adds_in_proportion() {
    let vanish = |effect: &&&dyn Effect| !is_finite_by_nature(**effect);
    for effect in CATALOGUE.iter().filter(vanish) {
        let id = effect.card().id;
        let all = |share: f64| [&added(*effect, share)[..], &path_of(*effect, share)].concat();
        assert!(all(0.0).iter().all(|term| term.abs() < 1e-15), "{id}");
        let (once, twice) = (all(0.01), all(0.02));
        assert!(once.iter().any(|one| one.abs() > 1e-9), "{id} adds nothing");
        for (one, two) in once.iter().zip(&twice) {
            assert!((two - 2.0 * one).abs() <= 2e-3 * one.abs(), "{id}");
        }
    }
}

#[test]
fn an_effect_enters_only_the_balance_that_its_card_names() {
    for effect in CATALOGUE.iter().filter(|effect| !couples(**effect)) {
        let card = effect.card();
        let [voltage, torque, friction, rate, inertia] = added(*effect, 1.0).map(f64::abs);
        let entered = (voltage.max(rate) > 1e-6, torque.max(friction).max(inertia) > 1e-6);
        let expected =
            (card.enters.includes(Balance::Voltage), card.enters.includes(Balance::Torque));
        assert_eq!(entered, expected, "{}", card.id);
        let is_in_path = path_of(*effect, 1.0).iter().any(|value| *value != 0.0);
        assert_eq!(is_in_path, card.enters == Enters::Path, "{}", card.id);
    }
}

#[test]
fn effects_that_depend_on_the_angle_are_marked() {
    for effect in CATALOGUE {
        let card = effect.card();
        let terms = effect.terms(&sized(*effect, 1.0));
        let own = vec![2.0; terms.states()];
        let turned = Instant { angle: ShaftAngle::at(instant().angle.rad() + 0.1), ..instant() };
        let (here, there) = (terms.sums(&instant(), &own), terms.sums(&turned, &own));
        let depends = here.all().into_iter().zip(there.all()).any(|(a, b)| (a - b).abs() > 1e-9);
        assert_eq!(depends, card.needs_angle, "{}", card.id);
    }
}

#[test]
fn every_effect_but_one_of_size_zero_changes_a_simulated_run() {
    let baseline = run(vec![]);
    for &effect in CATALOGUE {
        let changes = |share: f64| {
            let found = run(vec![ActiveEffect::with(effect, &sized(effect, share))]);
            let pairs = [0, 1].map(|n| baseline[n].iter().zip(&found[n]));
            pairs.map(|pairs| largest(pairs.map(|(a, b)| a - b)))
        };
        let id = effect.card().id;
        if !is_finite_by_nature(effect) {
            // Sub-steps of another length: equal but for the second order of a reversal.
            let [current, speed] = changes(0.0);
            assert!(current < 1e-3 && speed < 1e-2, "{id} {current} {speed}");
        }
        let [current, speed] = changes(1.0);
        assert!(current > 0.02 || speed > 0.1, "{id} {current} {speed}");
    }
}

#[test]
fn a_model_file_gives_every_effect_back() {
    for effect in CATALOGUE {
        let mut file = ModelFile::default();
        let values = sized(*effect, 1.234_567_890_123);
        file.model.effects = vec![ActiveEffect::with(*effect, &values)];
        let back = ModelFile::parse("m.toml", &file.to_toml()).unwrap();
        assert_eq!(back.model.effects[0].id(), effect.card().id);
        assert_eq!(back.model.effects[0].values, file.model.effects[0].values);
    }
}
