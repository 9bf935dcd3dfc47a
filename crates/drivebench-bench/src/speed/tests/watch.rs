//! Every controller on motors behind a coupling that its model does not have, and on motors that are what it says: what the
//! watch of the loop tells, and how soon after the swing began.

use rand::{Rng as _, SeedableRng as _};
use rayon::iter::{IntoParallelIterator as _, ParallelIterator as _};

use super::*;
use drivebench_model::numerics::count::whole;

/// How long a level of the reference stands, s, how many pairs of levels there are, and on how many motors.
#[derive(Clone, Copy)]
struct Course {
    level_s: f64,
    pairs: u32,
    motors: u64,
}

/// One step up, one down, each as long as it takes to be sure; and the embedded bench's six.
const SHORT: Course = Course { level_s: 1.6, pairs: 1, motors: MOTORS / 2 };
const WHOLE: Course = Course { level_s: 2.0, pairs: 3, motors: MOTORS };

/// A ring is a swing of more than this share of the step, beside the noise of the sensor: peak to peak.
const RING_SHARE: f64 = 0.05;
const NOISE_RAD_S: f64 = 10.0 * 0.15;
/// It goes on for so many cycles, in which it changes sides so often, and its second half has this share of its first.
const RING_CYCLES: usize = 100;
const RING_TURNS: usize = 4;
const RING_LEFT: f64 = 0.6;
/// Cycles within which it shows its size.
const SHOWS_CYCLES: usize = 25;

/// Rows of a level: time since the begin of the reference, s, and speed, rad/s.
type Rows<'a> = &'a [(f64, f64)];

fn extent_rad_s(rows: Rows<'_>) -> f64 {
    let (low, high) = ends(rows);
    high - low
}

fn ends(rows: Rows<'_>) -> (f64, f64) {
    rows.iter()
        .fold((f64::MAX, f64::MIN), |(low, high), &(_, speed)| (low.min(speed), high.max(speed)))
}

/// Whether these rows ring from the first to the last, by so much.
fn rings(rows: Rows<'_>, ring_rad_s: f64) -> bool {
    let (first, last) = rows.split_at(rows.len() / 2);
    let left_rad_s = extent_rad_s(last);
    if left_rad_s < ring_rad_s || left_rad_s < RING_LEFT * extent_rad_s(first) {
        return false;
    }
    let (low, high) = ends(rows);
    let (size, middle) = (high - low, 0.5 * (low + high));
    let beyond = |row: &&(f64, f64)| (row.1 - middle).abs() > 0.25 * size;
    let mut sides: Vec<bool> = rows.iter().filter(beyond).map(|row| row.1 > middle).collect();
    sides.dedup();
    sides.len() > RING_TURNS
}

/// What of a level comes after its reference was reached.
fn settled(level: Rows<'_>, reference_rad_s: f64) -> Rows<'_> {
    let begins_below = level.first().is_some_and(|row| row.1 < reference_rad_s);
    let there = |row: &(f64, f64)| (row.1 < reference_rad_s) != begins_below;
    let from = level.iter().position(there).unwrap_or(level.len());
    &level[from..]
}

/// How long the speed has been swinging by so much when these rows end, s.
fn swinging_s(rows: Rows<'_>, ring_rad_s: f64) -> f64 {
    let swings = |chunk: &Rows<'_>| extent_rad_s(chunk) > ring_rad_s;
    let chunks = rows.windows(SHOWS_CYCLES.min(rows.len().max(1)));
    let cycles = chunks.rev().take_while(swings).count();
    PERIOD_S * (cycles + SHOWS_CYCLES.min(rows.len())) as f64
}

/// What the watch said of one motor under one controller, how it ended, and how it rang.
#[derive(Debug)]
struct Heard {
    kind: ControllerKind,
    #[expect(dead_code, reason = "shown where one fails")]
    about: String,
    outcome: Option<Outcome>,
    watch: Vec<Watched>,
    /// Some second rang; and one did before the watch had said anything.
    rang: bool,
    unnoticed: bool,
    /// How long it had been swinging at the first word, s.
    after_s: Option<f64>,
}

impl Heard {
    fn found(&self, what: &str) -> bool {
        self.watch.iter().any(|one| one.found == what)
    }

    fn is_done(&self) -> bool {
        self.outcome == Some(Outcome::Done)
    }

    /// The watch ended it, with its reason.
    fn is_ended(&self) -> bool {
        let trips = [TripKind::LoopSwings, TripKind::LoopSaturated];
        matches!(&self.outcome, Some(Outcome::Tripped(trip)) if trips.contains(&trip.kind))
            && !self.watch.is_empty()
    }
}

/// This controller, tuned on the embedded bench's model, on this motor.
fn heard(config: &EmulatorConfig, kind: ControllerKind, seed: u64, course: Course) -> Heard {
    let mut bench = bench();
    let section = bench.speed.as_mut().unwrap();
    section.controller = kind;
    section.reference = vec![ReferencePart::Square {
        low_rad_s: 90.0,
        high_rad_s: 110.0,
        half_period_s: course.level_s,
        periods: course.pairs,
    }];
    let levels = 2 * course.pairs;
    let duration_s = course.level_s * f64::from(levels);
    let cycles = u32::try_from(whole(duration_s / PERIOD_S) + 100).unwrap();
    let model = baseline(&bench);
    let lab = Lab::new(session(&bench, &model), in_memory(config, seed), unspoilt).started(cycles);
    let watch = lab.session.report().unwrap().watch;
    let outcome = lab.outcome().cloned();
    let rows: Vec<(f64, f64)> = lab.recorded(Channel::Speed).collect();
    let begin_s = rows.first().map_or(0.0, |row| row.0);
    let until_s = match (&outcome, watch.last()) {
        (Some(Outcome::Done), _) | (_, None) => duration_s,
        (_, Some(last)) => last.time_s,
    };
    let rows = rows.into_iter().map(|(time_s, speed)| (time_s - begin_s, speed));
    let rows: Vec<(f64, f64)> = rows.filter(|row| row.0 < until_s).collect();
    let first_s = watch.first().map(|found| found.time_s);
    let (mut rang, mut unnoticed, mut after_s) = (false, false, None);
    for level in 0..levels {
        let (from_s, to_s) =
            (course.level_s * f64::from(level), course.level_s * f64::from(level + 1));
        // The first step comes from rest.
        let step_rad_s = if level == 0 { 110.0 } else { 20.0 };
        let ring_rad_s = RING_SHARE * step_rad_s + NOISE_RAD_S;
        let of_level = |until_s: f64| {
            let from = rows.partition_point(|row| row.0 < from_s);
            let to = rows.partition_point(|row| row.0 < until_s.min(to_s));
            let reference_rad_s = if level % 2 == 0 { 110.0 } else { 90.0 };
            settled(&rows[from..to.max(from)], reference_rad_s)
        };
        for second in of_level(to_s).windows(RING_CYCLES).filter(|rows| rings(rows, ring_rad_s)) {
            rang = true;
            unnoticed |=
                first_s.is_none_or(|first_s| first_s > second[RING_CYCLES - 1].0 + PERIOD_S);
        }
        if let Some(first_s) = first_s.filter(|first_s| (from_s..to_s).contains(first_s)) {
            after_s = Some(swinging_s(of_level(first_s), ring_rad_s));
        }
    }
    Heard {
        kind,
        about: format!("{} on {seed}: {:?}", kind.id(), config.hidden),
        outcome,
        watch,
        rang,
        unnoticed,
        after_s,
    }
}

/// Every controller on every motor, in the order of the controllers.
fn heard_on_all(config: impl Fn(u64) -> EmulatorConfig + Sync, course: Course) -> Vec<Heard> {
    let on = |kind: ControllerKind| (1..=course.motors).map(move |seed| (kind, seed));
    let runs: Vec<(ControllerKind, u64)> = ControllerKind::ALL.into_iter().flat_map(on).collect();
    let all: Vec<Heard> =
        runs.into_par_iter().map(|(kind, seed)| heard(&config(seed), kind, seed, course)).collect();
    for kind in ControllerKind::ALL {
        let own = || all.iter().filter(|heard| heard.kind == kind);
        let count = |counts: &dyn Fn(&Heard) -> bool| own().filter(|heard| counts(heard)).count();
        let mut after_s: Vec<f64> = own()
            .filter(|heard| !heard.found("saturated"))
            .filter_map(|heard| heard.after_s)
            .collect();
        after_s.sort_by(f64::total_cmp);
        eprintln!(
            "{:13} {} motors: {} rang for a second, {} unnoticed; told of {} (softened {}, given back {}, ended swinging {}, ended at a limit {}, told only {}); swinging for {:.2} s at the first word, at most {:.2} s; {} ended otherwise",
            kind.id(),
            own().count(),
            count(&|heard| heard.rang),
            count(&|heard| heard.unnoticed),
            count(&|heard| !heard.watch.is_empty()),
            count(&|heard| heard.found("softened")),
            count(&|heard| heard.found("given_back")),
            count(&|heard| heard.found("swings_on")),
            count(&|heard| heard.found("saturated")),
            count(&|heard| heard.found("swings") && heard.is_done()),
            after_s.get(after_s.len() / 2).unwrap_or(&f64::NAN),
            after_s.last().unwrap_or(&f64::NAN),
            count(&|heard| !heard.is_done() && !heard.is_ended()),
        );
    }
    all
}

/// The motor of the embedded bench with another inertia behind a coupling, every third with play in it.
fn behind_some_coupling(seed: u64) -> EmulatorConfig {
    let mut dice = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
    let mut values = vec![
        ("frequency_hz", dice.random_range(8.0..60.0)),
        ("inertia_ratio", dice.random_range(0.1..0.8)),
        ("damping_ratio", dice.random_range(0.005..0.1)),
        ("friction_split", dice.random_range(0.0..1.0)),
    ];
    let mut id = "elastic_coupling";
    if seed.is_multiple_of(3) {
        id = "backlash";
        values.push(("gap_rad", dice.random_range(0.005..0.08)));
    }
    let mut config = exact("zk-22fc-plain");
    config.motor.inertia_kg_m2 *= dice.random_range(0.5..4.0);
    config.hidden = vec![HiddenEffect::new(id, &values).unwrap()];
    config
}

/// The motor of the embedded bench within a tolerance of 10 %, three of four with something that swings nothing.
fn as_the_model_says(seed: u64) -> EmulatorConfig {
    let mut config = EmulatorConfig::embedded("zk-22fc-plain").unwrap();
    config.tolerance = 0.1;
    let hidden = match seed % 4 {
        0 => Some(("viscous_friction", ("viscous_n_m_s_per_rad", 4e-4))),
        1 => Some(("quadratic_load", ("quadratic_n_m_s2_per_rad2", 1.8e-6))),
        2 => Some(("voltage_drop", ("drop_v", 1.2))),
        _ => None,
    };
    config.hidden =
        hidden.map(|(id, value)| HiddenEffect::new(id, &[value]).unwrap()).into_iter().collect();
    config
}

fn no_controller_rings_unnoticed(course: Course) {
    let all = heard_on_all(behind_some_coupling, course);
    for heard in &all {
        assert!(!heard.unnoticed, "{heard:#?}");
        assert!(heard.is_done() || heard.is_ended(), "{heard:#?}");
    }
    // pi and mrac are too slow for any of these couplings.
    let told = all.iter().filter(|heard| !heard.watch.is_empty());
    assert!(told.count() > all.len() / 10);
}

/// What the noise of the sensor makes of a quick loop may be told of, as a swing, in so many runs; nothing is done against it.
fn no_controller_is_suspected(course: Course, most_told: usize) {
    let all = heard_on_all(as_the_model_says, course);
    let told: Vec<&Heard> = all.iter().filter(|heard| !heard.watch.is_empty()).collect();
    for heard in &all {
        assert!(heard.is_done(), "{heard:#?}");
        let is_only_told = heard.watch.iter().all(|one| one.found == "swings");
        assert!(is_only_told, "{heard:#?}");
    }
    assert!(told.len() <= most_told, "{told:#?}");
}

#[test]
fn no_controller_rings_unnoticed_for_a_second_behind_a_coupling() {
    no_controller_rings_unnoticed(SHORT);
}

#[test]
fn no_controller_is_suspected_on_a_modelled_motor() {
    no_controller_is_suspected(SHORT, 1);
}

#[test]
#[ignore = "the two above over the whole reference, on twice as many motors: minutes"]
fn no_controller_rings_unnoticed_over_the_reference() {
    no_controller_rings_unnoticed(WHOLE);
    no_controller_is_suspected(WHOLE, 2);
}
