//! Motors far from what the loop was told, each with a load and an effect that it does not know.

use super::*;
use crate::emulator::mystery;

/// Motors that are tried, and how far R, L, Ke, J and the load lie from the nameplate at most.
const MOTORS: u64 = 200;
const TOLERANCE: f64 = 0.5;
/// Doubt of what was identified, either way in turn.
const DOUBT: f64 = 0.05;
/// What a level may still swing by when it ends, peak to peak, rad/s: effects that push with the angle or hold and let
/// go move the shaft, whatever the loop does.
const STILL_RAD_S: f64 = 7.0;

/// How one motor fared.
#[derive(Debug)]
struct Fate {
    #[expect(dead_code, reason = "shown where a motor fails")]
    seed: u64,
    hidden: String,
    outcome: Option<Outcome>,
    largest_a: f64,
    largest_rad_s: f64,
    largest_v: f64,
    /// Largest swing over the last fifth of a level.
    swing_rad_s: f64,
}

/// Runs the embedded reference on the motor that `seed` draws. The electrical half of the model is what identification
/// gives; inertia and load are the nameplate's, wrong by up to a half.
fn fare(seed: u64) -> Fate {
    let mut config = mystery::draw(seed).config;
    config.tolerance = TOLERANCE;
    let bench = bench();
    let specimen = config.motor.specimen(TOLERANCE, seed);
    let doubt = 1.0
        + if seed.is_multiple_of(2) {
            DOUBT
        } else {
            -DOUBT
        };
    let mut plate = bench.clone();
    plate.motor.resistance_ohm = Some(specimen.resistance_ohm * doubt);
    plate.motor.inductance_h = Some(specimen.inductance_h / doubt);
    plate.motor.back_emf_v_s_per_rad = Some(specimen.back_emf_v_s_per_rad * (2.0 - doubt).sqrt());
    let model = Model::baseline(plate.motor.motor());
    let hidden = config
        .hidden
        .first()
        .map_or("nothing", |effect| effect.id());
    let hidden = hidden.to_owned();
    let mut lab = lab_of(&config, seed, session_on(&plate, &model), healthy);
    lab.start();
    lab.cycles(1600);
    let end: Vec<(f64, f64)> = lab
        .log
        .iter()
        .filter_map(|action| match action {
            Action::Row(sample) => Some((sample.time_s, sample.get(Channel::Speed)?)),
            _ => None,
        })
        .collect();
    let begin_s = end.first().map_or(0.0, |row| row.0);
    // On the first level a loop that swings may still be made softer.
    let swings = (1..6_u32).map(|level| {
        let until_s = begin_s + 2.0 * f64::from(level + 1);
        let rows = end
            .iter()
            .filter(|row| (until_s - 0.4..until_s).contains(&row.0));
        let (low, high) = rows.fold((f64::MAX, f64::MIN), |(low, high), row| {
            (low.min(row.1), high.max(row.1))
        });
        (high - low).max(0.0)
    });
    Fate {
        seed,
        hidden,
        outcome: lab.outcome().cloned(),
        largest_a: lab.largest(Channel::Current),
        largest_rad_s: lab.largest(Channel::Speed),
        largest_v: lab
            .volts()
            .into_iter()
            .fold(0.0, |most, volts| volts.abs().max(most)),
        swing_rad_s: swings.fold(0.0, f64::max),
    }
}

#[test]
fn two_hundred_motors_with_a_hidden_effect_stay_stable_and_within_every_limit() {
    let limits = bench().limits();
    let fates: Vec<Fate> = (1..=MOTORS).map(fare).collect();
    for fate in &fates {
        assert!(fate.largest_a <= limits.current_a, "{fate:?}");
        assert!(fate.largest_rad_s <= limits.speed_rad_s, "{fate:?}");
        assert!(fate.largest_v <= limits.voltage_v + 1e-9, "{fate:?}");
    }
    // A sensor that shows a current at rest is refused before anything moves.
    let (started, refused): (Vec<Fate>, Vec<Fate>) =
        fates.into_iter().partition(|fate| fate.largest_v > 0.0);
    assert!(started.len() >= 190, "{refused:?}");
    assert!(
        refused.iter().all(|fate| fate.hidden == "current_offset"),
        "{refused:?}"
    );
    for fate in &started {
        assert_eq!(fate.outcome, Some(Outcome::Done), "{fate:?}");
        assert!(fate.swing_rad_s < STILL_RAD_S, "{fate:?}");
    }
}
