//! The runs that are tried, as parts of a bench file's sequence: everything that `run` knows but the coast-down, for which
//! the model has no open circuit.

use crate::excitation::{Dither, Prbs, Ramp, Segment, Sine, Standstill, Steps, rich};

/// A sequence with the slew limit that it is meant for.
#[derive(Clone, Debug, PartialEq)]
pub struct Recipe {
    pub id: &'static str,
    /// As it stands in a sentence: "a slow ramp over the full range, through zero".
    pub name: &'static str,
    pub segments: Vec<Segment>,
    pub slew_v_per_s: f64,
}

/// Voltages and times that suit the motor and its limits.
#[derive(Clone, Copy, Debug)]
pub(super) struct Reach {
    /// Reaches the largest speed, V.
    pub(super) full_v: f64,
    /// May be put on the winding at rest at once, V.
    pub(super) quick_v: f64,
    /// Just turns the motor over, V.
    pub(super) creep_v: f64,
    /// Draws most of the current when the voltage goes up to full, V/s.
    pub(super) slew_v_per_s: f64,
    /// Changes the sign of `quick_v` within a command period, or as fast as the bench allows, V/s.
    pub(super) quick_slew_v_per_s: f64,
    /// Time between two commands, s.
    pub(super) period_s: f64,
}

type Build = fn(&Reach) -> Vec<Segment>;

/// How fast a recipe's voltage may change.
#[derive(Clone, Copy)]
enum Change {
    /// So that the motor follows within the current that is allowed.
    Slewed,
    /// From one level to another within a command period where the bench allows it: small voltages only.
    Quick,
}

const MENU: &[(&str, &str, Change, Build)] = &[
    (
        "rich",
        "the rich sequence (steps, slow ramp, pseudo-random levels and sine, both ways)",
        Change::Slewed,
        rich_sequence,
    ),
    (
        "slow_ramp",
        "a slow ramp over the full range, through zero",
        Change::Slewed,
        slow_ramp,
    ),
    (
        "fast_dither",
        "a fast dither about zero volts",
        Change::Quick,
        fast_dither,
    ),
    (
        "hard_cycling",
        "hard accelerating and braking, both ways",
        Change::Slewed,
        hard_cycling,
    ),
    (
        "staircase",
        "long holds at several speeds, both ways",
        Change::Slewed,
        staircase,
    ),
    (
        "slow_sine",
        "a slow sine through zero",
        Change::Slewed,
        slow_sine,
    ),
    (
        "standstill",
        "a standstill reading",
        Change::Slewed,
        standstill,
    ),
    (
        "heat_and_repeat",
        "a first part that is repeated after heating the winding",
        Change::Slewed,
        heat_and_repeat,
    ),
    (
        "random_levels",
        "pseudo-random levels of both signs",
        Change::Slewed,
        random_levels,
    ),
    (
        "steady_hold",
        "a steady hold at one speed",
        Change::Slewed,
        steady_hold,
    ),
    (
        "current_reversals",
        "quick reversals of the current at rest",
        Change::Quick,
        current_reversals,
    ),
    (
        "dither_at_speed",
        "a fast dither at rest and at speed, both ways",
        Change::Quick,
        dither_at_speed,
    ),
];

/// Number of recipes.
pub(super) const COUNT: usize = MENU.len();

/// Recipe `index` of the menu for this reach.
pub(super) fn recipe(index: usize, reach: &Reach) -> Recipe {
    let (id, name, change, build) = MENU[index];
    Recipe {
        id,
        name,
        segments: build(reach).into_iter().map(tidy).collect(),
        slew_v_per_s: figures(match change {
            Change::Slewed => reach.slew_v_per_s,
            Change::Quick => reach.quick_slew_v_per_s.max(reach.slew_v_per_s),
        }),
    }
}

/// A value as a person would write it into a bench file: three figures, towards zero, so that it stays within its limit.
fn figures(value: f64) -> f64 {
    if value == 0.0 || !value.is_finite() {
        return value;
    }
    // Whole divisions give the shortest decimal; multiplying by 0.01 does not.
    let places = 2.0 - value.abs().log10().floor();
    let unit = 10_f64.powf(places.abs());
    // A hair up: 9.5 must not become 9.49.
    let hair = value * (1.0 + 1e-12);
    if places >= 0.0 {
        (hair * unit).trunc() / unit
    } else {
        (hair / unit).trunc() * unit
    }
}

/// Whole milliseconds, upwards; a clock to the tenth of one.
fn milliseconds(seconds: f64) -> f64 {
    (seconds * 1e3 - 1e-6).ceil() / 1e3
}

fn clock(seconds: f64) -> f64 {
    (seconds * 1e4).round() / 1e4
}

/// The segment with all its values rounded.
fn tidy(segment: Segment) -> Segment {
    let dithered = |dither: Option<Dither>| {
        dither.map(|dither| Dither {
            amplitude_v: figures(dither.amplitude_v),
            clock_s: clock(dither.clock_s),
            ..dither
        })
    };
    match segment {
        Segment::Steps(steps) => Segment::Steps(Steps {
            levels_v: steps.levels_v.into_iter().map(figures).collect(),
            hold_s: milliseconds(steps.hold_s),
            dither: dithered(steps.dither),
        }),
        Segment::Ramp(ramp) => Segment::Ramp(Ramp {
            from_v: figures(ramp.from_v),
            to_v: figures(ramp.to_v),
            seconds: milliseconds(ramp.seconds),
            dither: dithered(ramp.dither),
        }),
        Segment::Prbs(prbs) => Segment::Prbs(Prbs {
            amplitude_v: figures(prbs.amplitude_v),
            clock_s: clock(prbs.clock_s),
            seconds: milliseconds(prbs.seconds),
            ..prbs
        }),
        Segment::Sine(sine) => Segment::Sine(Sine {
            amplitude_v: figures(sine.amplitude_v),
            ..sine
        }),
        other => other,
    }
}

/// Every run begins at rest, for its own noise floor: the more samples, the surer the floor.
fn rest(reach: &Reach) -> Segment {
    Segment::Standstill(Standstill {
        seconds: (100.0 * reach.period_s).clamp(0.5, 1.0),
    })
}

fn ramp(from_v: f64, to_v: f64, seconds: f64) -> Segment {
    Segment::Ramp(Ramp {
        from_v,
        to_v,
        seconds,
        dither: None,
    })
}

fn steps(levels_v: Vec<f64>, hold_s: f64) -> Segment {
    Segment::Steps(Steps {
        levels_v,
        hold_s,
        dither: None,
    })
}

fn shares(full_v: f64, shares: &[f64]) -> Vec<f64> {
    shares.iter().map(|share| share * full_v).collect()
}

/// Time to full voltage and a little on it.
fn arrival_s(reach: &Reach, share: f64) -> f64 {
    share * reach.full_v / reach.slew_v_per_s
}

/// Time in which a voltage changes its sign under the slew of quick changes, with a little on it, s.
fn reversal_s(reach: &Reach, amplitude_v: f64) -> f64 {
    2.2 * amplitude_v / reach.quick_slew_v_per_s
}

/// 4 ms, or as fast as commands come and the voltage may follow.
fn fast_clock_s(reach: &Reach, amplitude_v: f64) -> f64 {
    let wanted_s = reversal_s(reach, amplitude_v).max(0.004);
    let periods = (wanted_s / reach.period_s).round().max(1.0);
    periods * reach.period_s
}

fn rich_sequence(reach: &Reach) -> Vec<Segment> {
    rich(reach.full_v, reach.slew_v_per_s, 1)
}

fn slow_ramp(reach: &Reach) -> Vec<Segment> {
    let full_v = reach.full_v;
    // No faster than half of what the current allows.
    let quarter_s = (2.0 * arrival_s(reach, 1.0)).max(2.5);
    vec![
        rest(reach),
        ramp(0.0, -full_v, quarter_s),
        ramp(-full_v, full_v, 2.0 * quarter_s),
        ramp(full_v, 0.0, quarter_s),
    ]
}

fn fast_dither(reach: &Reach) -> Vec<Segment> {
    let part = |amplitude_v, seed| {
        let clock_s = fast_clock_s(reach, amplitude_v);
        Segment::Prbs(Prbs {
            amplitude_v,
            clock_s,
            seconds: (30.0 * clock_s).clamp(2.0, 4.0),
            seed,
            offset_v: 0.0,
            levels: 2,
        })
    };
    // Large and small: play in a coupling does not grow with the torque.
    vec![
        rest(reach),
        part(reach.quick_v, 1),
        part(0.4 * reach.quick_v, 2),
    ]
}

fn hard_cycling(reach: &Reach) -> Vec<Segment> {
    let levels = [1.0, -1.0, 1.0, 0.0, -1.0, 0.0, 0.5, -0.5, 0.0];
    vec![
        rest(reach),
        steps(
            shares(reach.full_v, &levels),
            arrival_s(reach, 2.0).max(0.2) + 0.15,
        ),
    ]
}

fn staircase(reach: &Reach) -> Vec<Segment> {
    let levels = [
        0.25, 0.5, 0.75, 1.0, 0.6, 0.0, -0.25, -0.5, -0.75, -1.0, -0.6, 0.0,
    ];
    vec![
        rest(reach),
        steps(
            shares(reach.full_v, &levels),
            arrival_s(reach, 0.6).max(0.2) + 0.5,
        ),
    ]
}

fn slow_sine(reach: &Reach) -> Vec<Segment> {
    vec![
        rest(reach),
        Segment::Sine(Sine {
            amplitude_v: reach.creep_v,
            frequency_hz: 0.4,
            seconds: 7.5,
        }),
    ]
}

fn standstill(_: &Reach) -> Vec<Segment> {
    vec![Segment::Standstill(Standstill { seconds: 4.0 })]
}

fn heat_and_repeat(reach: &Reach) -> Vec<Segment> {
    let hold_s = arrival_s(reach, 1.0).max(0.2) + 0.15;
    let part = || steps(shares(reach.full_v, &[0.5, -0.5, 0.0]), hold_s);
    let heat = shares(reach.full_v, &[1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 0.0]);
    vec![
        rest(reach),
        part(),
        steps(heat, arrival_s(reach, 2.0).max(0.2) + 0.05),
        part(),
    ]
}

fn random_levels(reach: &Reach) -> Vec<Segment> {
    vec![
        rest(reach),
        Segment::Prbs(Prbs {
            amplitude_v: 0.6 * reach.full_v,
            clock_s: arrival_s(reach, 0.4).max(10.0 * reach.period_s),
            seconds: 6.0,
            seed: 3,
            offset_v: 0.0,
            levels: 7,
        }),
    ]
}

fn steady_hold(reach: &Reach) -> Vec<Segment> {
    vec![rest(reach), steps(vec![0.5 * reach.full_v], 4.0)]
}

fn current_reversals(reach: &Reach) -> Vec<Segment> {
    let levels = [
        1.0, -1.0, 0.5, -0.5, 0.0, 0.7, -0.7, 0.3, -0.3, 0.0, 1.0, 0.0, -1.0, 0.0,
    ];
    vec![
        rest(reach),
        steps(
            shares(reach.quick_v, &levels),
            reversal_s(reach, reach.quick_v).max(0.12),
        ),
        steps(
            shares(reach.quick_v, &levels),
            2.0 * reversal_s(reach, reach.quick_v).max(0.12),
        ),
    ]
}

fn dither_at_speed(reach: &Reach) -> Vec<Segment> {
    // The dither's changes are quick, so the levels are reached by ramps; half of the current is left for each.
    let (level_v, dither_v) = (0.5 * reach.full_v, 0.4 * reach.quick_v);
    let change_s = (2.0 * arrival_s(reach, 0.5)).max(0.5);
    let part = |from_v, to_v, seconds, seed| {
        Segment::Ramp(Ramp {
            from_v,
            to_v,
            seconds,
            dither: Some(Dither {
                amplitude_v: dither_v,
                clock_s: fast_clock_s(reach, dither_v),
                seed,
            }),
        })
    };
    vec![
        rest(reach),
        part(0.0, 0.0, 1.0, 1),
        part(0.0, level_v, change_s, 2),
        part(level_v, level_v, 1.0, 3),
        part(level_v, -level_v, 2.0 * change_s, 4),
        part(-level_v, -level_v, 1.0, 5),
        part(-level_v, 0.0, change_s, 6),
    ]
}
