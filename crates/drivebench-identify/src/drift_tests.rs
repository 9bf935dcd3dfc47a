use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use super::*;
use crate::scheme::{Data, default_for};
use drivebench_model::plant::testing::record;
use drivebench_model::plant::{Model, Motor};

fn run(values: &[(&str, f64, f64)]) -> Vec<ParameterEstimate> {
    let found = values.iter().map(|(key, value, std)| {
        let unit = MotorKey::from_key(key).map_or("", MotorKey::unit);
        ParameterEstimate::found(*key, unit, *value, *std, None)
    });
    found.collect()
}

const KEYS: [&str; 5] = [
    "resistance_ohm",
    "inductance_h",
    "back_emf_v_s_per_rad",
    "inertia_kg_m2",
    "load_torque_n_m",
];

/// `count` runs of a machine whose values are one and move by `spread` from run to run beyond a noise of 1 %.
fn runs(count: usize, spread: f64, rng: &mut ChaCha8Rng) -> Vec<Vec<ParameterEstimate>> {
    let mut one = || {
        let mut value = |key| {
            let (noise, moved): (f64, f64) =
                (rng.sample(StandardNormal), rng.sample(StandardNormal));
            (key, 1.0 + 0.01 * noise + spread * moved, 0.01)
        };
        let values = KEYS.map(&mut value);
        run(&values)
    };
    (0..count).map(|_| one()).collect()
}

#[test]
fn chance_names_a_drift_as_rarely_as_it_is_said() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    // From run to run of itself the machine moves by nothing, or by five times the noise within a run: then repeats say so.
    for (before, after, spread) in [
        (1, 1, 0.0),
        (3, 3, 0.0),
        (3, 3, 0.05),
        (4, 2, 0.05),
        (8, 1, 0.05),
    ] {
        let pairs = 4000;
        let is_alarm = |_: &usize| {
            let drift = between(
                &runs(before, spread, &mut rng),
                &runs(after, spread, &mut rng),
                "May",
            );
            drift.drifted().next().is_some()
        };
        let alarms = (0..pairs).filter(is_alarm).count();
        // 40 of 4,000 is what is said; more than 65 happens to that once in 10,000.
        assert!(
            alarms <= 65,
            "{alarms} of {pairs} with {before} and {after} runs"
        );
        if (before, after) == (1, 1) {
            assert!(
                alarms >= 18,
                "{alarms}: the level is kept by naming nothing"
            );
        }
    }
}

#[test]
fn the_share_holds_the_truth_where_one_side_is_surer_than_the_other() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    // Runs on either side and their deviations; the machine of the last moves from run to run of itself, by five times the noise.
    for (before, after, stds, spread) in [
        (1, 1, [0.005, 0.05], 0.0),
        (1, 1, [0.05, 0.005], 0.0),
        (8, 1, [0.02, 0.02], 0.0),
        (8, 1, [0.01, 0.01], 0.05),
    ] {
        let mut side = |count: usize, value: f64, std: f64| {
            let mut one = || {
                let (noise, moved): (f64, f64) =
                    (rng.sample(StandardNormal), rng.sample(StandardNormal));
                run(&[("load_torque_n_m", value + std * noise + spread * moved, std)])
            };
            (0..count).map(|_| one()).collect::<Vec<_>>()
        };
        let mut is_inside = |_: &usize| {
            let drift = between(
                &side(before, 1.0, stds[0]),
                &side(after, 0.5, stds[1]),
                "May",
            );
            let [low, high] = drift.changes[0]
                .interval_95_percent
                .expect("it is clear of zero");
            (low..=high).contains(&-50.0)
        };
        let inside = (0..4000).filter(&mut is_inside).count();
        // 3,800 are expected; fewer than 3,740 happen once in 100,000.
        assert!(
            inside >= 3740,
            "{inside} of 4000 with {before} and {after} runs, {stds:?}"
        );
    }
}

#[test]
fn one_run_each_does_not_know_the_spread_and_says_so() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let single = between(&runs(1, 0.0, &mut rng), &runs(1, 0.0, &mut rng), "May");
    assert!(
        single
            .caution
            .is_some_and(|caution| caution.contains("from run to run"))
    );
    let repeated = between(&runs(3, 0.0, &mut rng), &runs(1, 0.0, &mut rng), "May");
    assert_eq!(repeated.caution, None);
    // Repeats that do not carry a parameter say nothing of it.
    let bare = || run(&[("inertia_kg_m2", 0.0045, 1e-5)]);
    let both = |torque| {
        run(&[
            ("inertia_kg_m2", 0.0045, 1e-5),
            ("load_torque_n_m", torque, 0.001),
        ])
    };
    let once = between(&[both(0.45), bare(), bare()], &[both(0.45)], "May");
    let caution = once
        .caution
        .expect("one value of the friction on each side");
    assert!(
        caution.contains("each side with friction (load torque):"),
        "{caution}"
    );
}

#[test]
fn a_change_is_told_with_its_interval_and_a_cause_that_is_only_possible() {
    let before = run(&[
        ("load_torque_n_m", 0.45, 0.003),
        ("inertia_kg_m2", 0.0045, 1e-5),
    ]);
    let after = run(&[
        ("load_torque_n_m", 0.504, 0.003),
        ("inertia_kg_m2", 0.0045, 1e-5),
    ]);
    let drift = between(&[before], &[after], "2026-03-01");
    let [friction, inertia] = &drift.changes[..] else {
        panic!("{drift:?}")
    };
    assert!(friction.drifted && !inertia.drifted);
    assert_eq!(
        friction.sentence,
        "friction (load torque) +12 % (95 % interval +10 to +14 %) since 2026-03-01, less than 1 % by chance; possible cause: \
         bearing, lubrication, brushes, or another load"
    );
    assert_eq!(
        inertia.sentence,
        "inertia: no change larger than 0.62 % is left open (95 %) since 2026-03-01"
    );
    assert_eq!(inertia.possible_cause, None);
    assert_eq!(
        drift.sentence,
        "drifted since 2026-03-01: friction (load torque) +12 % (95 % interval +10 to +14 %)"
    );
    assert!((drift.largest_percent().unwrap() - 12.0).abs() < 1e-9);
    assert!((drift.open_percent().unwrap() - 14.0).abs() < 0.1);
}

#[test]
fn what_is_near_zero_is_told_in_its_unit_and_what_was_given_is_not_compared() {
    let mut before = run(&[("load_torque_n_m", 0.001, 0.01)]);
    let after = run(&[("load_torque_n_m", 0.2, 0.01)]);
    before.push(ParameterEstimate::fixed("inertia_kg_m2", "kg.m2", 0.004));
    before.push(ParameterEstimate::not_observable(
        "inductance_h",
        "H",
        "sample faster",
    ));
    let drift = between(&[before], &[after], "May");
    let change = &drift.changes[0];
    assert!(change.drifted && change.percent.is_none());
    assert!(
        change
            .sentence
            .contains("+0.20 N.m (95 % interval +0.17 to +0.23 N.m)"),
        "{}",
        change.sentence
    );
    assert_eq!(
        (drift.largest_percent(), drift.open_percent()),
        (None, None)
    );
    assert_eq!(drift.not_compared.len(), 1);
    assert!(!drift.not_compared[0].carried_before);
    assert!(
        drift.not_compared[0]
            .reason
            .contains("either date: sample faster")
    );
    let nothing = between(&[Vec::new()], &[Vec::new()], "May");
    assert!(nothing.sentence.starts_with("nothing can be said"));
    assert_eq!(
        (nothing.largest_percent(), nothing.open_percent()),
        (None, None)
    );
}

#[test]
fn what_is_not_carried_any_more_is_open_whatever_the_others_say() {
    let before = run(&[
        ("load_torque_n_m", 0.45, 0.003),
        ("inertia_kg_m2", 0.0045, 1e-5),
    ]);
    let mut after = run(&[("inertia_kg_m2", 0.0045, 1e-5)]);
    after.push(ParameterEstimate::not_observable(
        "load_torque_n_m",
        "N.m",
        "it never turns back",
    ));
    let drift = between(&[before], &[after], "May");
    assert_eq!(drift.in_question().count(), 0);
    assert_eq!(
        (drift.largest_percent(), drift.open_percent()),
        (None, None)
    );
    let lost: Vec<&str> = drift.lost().map(|one| one.key.as_str()).collect();
    assert_eq!(lost, ["load_torque_n_m"]);
    assert!(
        drift
            .sentence
            .ends_with("; not compared: friction (load torque)"),
        "{}",
        drift.sentence
    );
}

#[test]
fn too_few_repeats_leave_a_change_open_and_do_not_hide_it() {
    let at = |torque: f64| run(&[("load_torque_n_m", torque, 0.001)]);
    let two = [at(0.450), at(0.452)];
    let open = between(&two, &[at(0.504)], "May");
    assert!(open.changes[0].unsettled && open.drifted().next().is_none());
    assert!(open.sentence.contains("not settled"), "{}", open.sentence);
    assert!(
        (open.largest_percent().unwrap() - 11.75).abs() < 0.1 && open.in_question().count() == 1
    );
    let more = [at(0.450), at(0.451), at(0.4505), at(0.4495)];
    let named = between(&more, &[at(0.504)], "May");
    assert!(named.changes[0].drifted && !named.changes[0].unsettled);
    // Runs that do not carry it are no repeats of it.
    let bare = || run(&[("inertia_kg_m2", 0.0045, 1e-5)]);
    let beside = [at(0.450), at(0.452), bare(), bare()];
    assert!(between(&beside, &[at(0.504)], "May").changes[0].unsettled);
    // What many repeats show to be its own movement is neither.
    let restless = [at(0.40), at(0.50), at(0.42), at(0.49), at(0.45)];
    let own = between(&restless, &[at(0.504)], "May");
    assert_eq!(own.in_question().count(), 0, "{own:?}");
}

#[test]
fn warmth_that_is_known_is_no_drift() {
    let at = |resistance, at_20| {
        run(&[
            ("resistance_ohm", resistance, 0.001),
            (temperature::KEY, at_20, 0.001),
        ])
    };
    let drift = between(&[at(1.10, 1.10)], &[at(1.30, 1.10)], "May");
    assert_eq!(drift.changes.len(), 1);
    assert!(!drift.changes[0].drifted, "{drift:?}");
    // Without it the winding's own warmth is what is named.
    let warm = between(
        &[run(&[("resistance_ohm", 1.10, 0.001)])],
        &[run(&[("resistance_ohm", 1.31, 0.001)])],
        "May",
    );
    assert!(
        warm.changes[0]
            .sentence
            .contains("a winding some 49 K warmer"),
        "{}",
        warm.changes[0].sentence
    );
}

/// What a simulated run of this motor says of itself.
fn identified(motor: &Motor, seed: u64) -> Vec<ParameterEstimate> {
    let levels = [0.0, 40.0, 70.0, -50.0, 20.0, -80.0, 60.0, -30.0];
    let events = levels
        .iter()
        .enumerate()
        .map(|(k, level)| (0.5 * k as f64, *level))
        .collect();
    let scenario = record(&Model::baseline(motor.clone()), events, 0.005, 4.0, seed);
    let run = crate::testing::recorded(&scenario);
    let model = Model::baseline(Motor::new("unknown"));
    let found = default_for(&scenario).identify(&Data {
        run: &run,
        scenario: &scenario,
        model: &model,
    });
    found.expect("a run that moves").parameters
}

#[test]
fn of_two_hundred_machines_none_drifts_by_chance_and_each_dry_bearing_is_found_in_its_size() {
    let (mut alarms, mut found, mut inside) = (0, 0, 0);
    for machine in 0..200 {
        let mut rng = ChaCha8Rng::seed_from_u64(machine);
        let mut motor = Motor::zk_22fc();
        for key in KEYS.map(|key| MotorKey::from_key(key).expect("a key of a motor")) {
            let value = motor.get(key).expect("a value");
            motor.set(key, value * rng.random_range(0.9..1.1));
        }
        let before = [identified(&motor, 10_000 + machine)];
        let same = between(&before, &[identified(&motor, 20_000 + machine)], "May");
        alarms += usize::from(same.drifted().next().is_some());
        let friction = motor.get(MotorKey::LoadTorque).expect("a value");
        motor.set(MotorKey::LoadTorque, 1.12 * friction);
        let dry = between(&before, &[identified(&motor, 30_000 + machine)], "May");
        let change = dry
            .changes
            .iter()
            .find(|change| change.key == MotorKey::LoadTorque.key());
        let change = change.expect("it is compared");
        found += usize::from(change.drifted);
        let [low, high] = change.interval_95_percent.expect("it is clear of zero");
        inside += usize::from((low..=high).contains(&12.0));
    }
    // Two alarms are expected; more than eight happen to a level of 1 % once in 2,000.
    assert!(alarms <= 8, "{alarms} false alarms");
    assert!(found >= 199, "{found} found");
    // 190 are expected; fewer than 178 happen to 95 % once in 3,000.
    assert!(inside >= 178, "{inside} intervals hold the truth");
}
