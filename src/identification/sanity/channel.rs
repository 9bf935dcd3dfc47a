//! One signal that contradicts itself: frozen for a while, cut off at a limit, or without its direction.

use std::ops::Range;

use super::balance::{Roles, voltage_at_rest};
use super::still::AT_REST;
use super::table::{Activity, Table};
use super::{Finding, Kind};
use crate::plant::MotorKey;

/// Rows of one and the same value from which a live signal counts as frozen.
const FROZEN_ROWS: usize = 20;
/// Share of equal neighbours up to which a signal counts as live (a coarse quantum repeats values too).
const LIVE: f64 = 0.5;
/// Share of its range by which another signal moves meanwhile.
const MEANWHILE: f64 = 0.1;
/// Rows at the very same extreme value that make a plateau, and the share of the range by which a clipped signal
/// enters it in one row: a settling signal creeps.
const PLATEAU_ROWS: usize = 3;
const STEEP: f64 = 0.03;
/// Share of the rows from which clipping forbids an identification.
const CLIPPED: f64 = 0.01;
/// Share of the largest value that is none.
const ROUNDING: f64 = 1e-9;
/// Share of the largest voltage from which its direction counts.
const CLEARLY: f64 = 0.2;
/// Share of the largest value below which a signal has come through zero.
const THROUGH_ZERO: f64 = 0.1;
/// Share of the largest value that a signal may be negative by, through noise or offset.
const NEARLY_NONE: f64 = 0.05;

pub(super) fn check(table: &Table) -> Vec<Finding> {
    let mut findings = Vec::new();
    let speed_moves = Activity::of(&table.speed_rad_s).moves;
    for (key, values, others) in [
        (
            "current_a",
            &table.current_a,
            [&table.speed_rad_s, &table.voltage_v],
        ),
        (
            "speed_rad_s",
            &table.speed_rad_s,
            [&table.current_a, &table.voltage_v],
        ),
    ] {
        let activity = Activity::of(values);
        if !activity.moves {
            continue;
        }
        // A winding at rest, sampled slowly and without noise, does follow the voltage in jumps.
        if speed_moves && let Some(held) = held(key, values, &activity) {
            findings.push(held);
            continue;
        }
        // A plateau at the limit is no freezing.
        match clipped(key, values, &activity) {
            Some(clipped) => findings.push(clipped),
            None => findings.extend(frozen(table, key, values, others)),
        }
        findings.extend(unsigned(table, key, &activity, values));
    }
    if speed_moves {
        findings.extend(dead_at_zero(table));
    }
    findings.extend(unsigned_voltage(table));
    findings
}

/// The longest stretch of a speed of exactly zero over which the winding takes a back-EMF: the shaft turns, and its sensor is
/// dead. At rest resistance and inductance take the voltage.
fn dead_at_zero(table: &Table) -> Option<Finding> {
    // A slope of equal angles is zero but for rounding.
    let zero_rad_s = ROUNDING * Activity::of(&table.speed_rad_s).largest();
    let mut longest = 0..0;
    let mut begin = 0;
    for row in 0..=table.speed_rad_s.len() {
        let speed = table.speed_rad_s.get(row);
        if speed.is_none_or(|speed| speed.abs() > zero_rad_s || speed.is_nan()) {
            if row - begin > longest.len() {
                longest = begin..row;
            }
            begin = row + 1;
        }
    }
    let inside = |window: &&Range<usize>| longest.start <= window.start && window.end < longest.end;
    let windows: Vec<Range<usize>> = table.windows.iter().filter(inside).cloned().collect();
    let largest = |values: &[f64]| Activity::of(values).largest();
    if longest.len() < FROZEN_ROWS
        || largest(&table.voltage_v[longest.clone()]) < CLEARLY * largest(&table.voltage_v)
    {
        return None;
    }
    let roles = Roles {
        windows: &windows,
        ..Roles::of(table)
    };
    let unexplained = voltage_at_rest(&roles).filter(|share| *share > AT_REST)?;
    Some(Finding::refusal(
        Kind::Frozen,
        format!(
            "speed_rad_s is exactly 0 from {:.3} to {:.3} s, but resistance and inductance leave {:.0} % of the voltage there \
             unexplained: the shaft turns and its sensor is dead",
            table.time_s[longest.start],
            table.time_s[longest.end - 1],
            100.0 * unexplained
        ),
        "check the encoder and its cable; cut the stretch out of the file",
    ))
}

/// The longest stretch of one non-zero value in a signal that is live elsewhere, while another signal moves.
fn frozen(table: &Table, key: &str, values: &[f64], others: [&Vec<f64>; 2]) -> Option<Finding> {
    let mut stretches = Stretches::default();
    for (row, value) in values.iter().enumerate() {
        stretches.push(row, *value);
    }
    let longest = stretches.longest;
    let rows = longest.end - longest.start;
    let elsewhere = (values.len() - rows).max(1) as f64;
    let equal_elsewhere = (stretches.equal + 1).saturating_sub(rows) as f64;
    if rows < FROZEN_ROWS || equal_elsewhere > LIVE * elsewhere {
        return None;
    }
    let moved = others.iter().any(|other| {
        let (whole, part) = (
            Activity::of(other),
            Activity::of(&other[longest.start..longest.end]),
        );
        part.moves && part.range() > MEANWHILE * whole.range()
    });
    moved.then(|| {
        Finding::refusal(
            Kind::Frozen,
            format!(
                "{key} repeats {} for {rows} rows from {:.3} to {:.3} s while the other signals move: its source froze",
                values[longest.start],
                table.time_s[longest.start],
                table.time_s[longest.end - 1]
            ),
            "leave such cells empty (a missing value is never a repeat), or cut the stretch out of the file",
        )
    })
}

/// Stretches of equal values.
#[derive(Default)]
struct Stretches {
    begin: usize,
    last: Option<f64>,
    equal: usize,
    longest: std::ops::Range<usize>,
}

impl Stretches {
    fn push(&mut self, row: usize, value: f64) {
        let same = self
            .last
            .is_some_and(|last| last.to_bits() == value.to_bits());
        if same {
            self.equal += 1;
        } else {
            self.begin = row;
        }
        let length = row + 1 - self.begin;
        // At rest an encoder says exactly 0, rightly.
        if value.abs() > 0.0 && length > self.longest.end - self.longest.start {
            self.longest = self.begin..row + 1;
        }
        self.last = Some(value);
    }
}

/// Share of neighbours that are equal in a held signal, jumps that it has at least, and their size as a share of the range.
const HELD: f64 = 0.8;
const JUMPS: usize = 3;
const JUMP: f64 = 0.1;

/// A measured signal that stands still between jumps is a command: no shaft and no winding does that.
fn held(key: &str, values: &[f64], activity: &Activity) -> Option<Finding> {
    let present: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
    let pairs = || present.windows(2).map(|pair| (pair[0], pair[1]));
    // At rest any signal stands still.
    let lively = pairs().filter(|(_, b)| b.abs() > JUMP * activity.largest());
    let equal = lively
        .clone()
        .filter(|(a, b)| a.to_bits() == b.to_bits())
        .count();
    let jumps: Vec<f64> = pairs()
        .map(|(a, b)| (b - a).abs())
        .filter(|jump| *jump > 0.0)
        .collect();
    let large = jumps
        .iter()
        .filter(|jump| **jump > JUMP * activity.range())
        .count();
    let is_held =
        equal as f64 > HELD * lively.count() as f64 && large >= JUMPS && 2 * large > jumps.len();
    is_held.then(|| {
        Finding::refusal(
            Kind::Swapped,
            format!(
                "{key} stands exactly still between {large} jumps of up to {:.4}, as a command does and no measurement: is it \
                 in another signal's column?",
                jumps.iter().copied().fold(0.0, f64::max)
            ),
            "map the measured column; a commanded voltage is voltage_cmd_v, a commanded speed reference_rad_s",
        )
    })
}

/// Plateaus at the largest or smallest value that are entered at full slope.
fn clipped(key: &str, values: &[f64], activity: &Activity) -> Option<Finding> {
    let at_limit = |value: f64| {
        (value >= activity.most && activity.most > 0.0)
            || (value <= activity.least && activity.least < 0.0)
    };
    let (mut rows, mut plateaus, mut steep) = (0_usize, 0_usize, 0_usize);
    let mut row = 0;
    while row < values.len() {
        let begin = row;
        while row < values.len() && at_limit(values[row]) {
            row += 1;
        }
        if row - begin >= PLATEAU_ROWS {
            rows += row - begin;
            plateaus += 1;
            let slope = |from: Option<&f64>, to: f64| from.map_or(0.0, |from| (to - from).abs());
            let entry = slope(
                begin.checked_sub(1).and_then(|k| values.get(k)),
                values[begin],
            );
            let leave = slope(values.get(row), values[row - 1]);
            if entry.max(leave) > STEEP * activity.range() {
                steep += 1;
            }
        }
        row = row.max(begin + 1);
    }
    // One plateau may be a stalled motor under one voltage; the very same value several times is a limit.
    if plateaus < 2 || 2 * steep < plateaus {
        return None;
    }
    let share = rows as f64 / activity.count as f64;
    let sentence = format!(
        "{key} stands at exactly {:.6} or {:.6} in {rows} rows ({:.1} %) on {plateaus} plateaus that it enters at full slope: \
         it is cut off there",
        activity.least,
        activity.most,
        100.0 * share
    );
    let help = "raise the range of the instrument or excite less; or leave the cut-off cells empty";
    Some(if share > CLIPPED {
        Finding::refusal(Kind::Clipped, sentence, help)
    } else {
        Finding::caution(Kind::Clipped, &MotorKey::ALL, sentence, help)
    })
}

/// A signal that is never negative although the voltage clearly reverses and it is large there.
fn unsigned(table: &Table, key: &str, activity: &Activity, values: &[f64]) -> Option<Finding> {
    let voltage = Activity::of(&table.voltage_v);
    if !voltage.is_there() || activity.least < -NEARLY_NONE * activity.most {
        return None;
    }
    // A heavy shaft need not follow a short reversal; one that did came through zero.
    let astern_least = table
        .voltage_v
        .iter()
        .zip(values)
        .filter(|(u, x)| **u < -CLEARLY * voltage.largest() && x.is_finite())
        .fold(f64::INFINITY, |least, (_, x)| least.min(x.abs()));
    if astern_least > THROUGH_ZERO * activity.largest() {
        return None;
    }
    // Power of the signal where the voltage is clearly of one direction.
    let power = |direction: f64| -> (f64, usize) {
        let rows = table
            .voltage_v
            .iter()
            .zip(values)
            .filter(|(u, x)| direction * **u > CLEARLY * voltage.largest() && x.is_finite());
        rows.fold((0.0, 0), |(sum, rows), (_, x)| (sum + x * x, rows + 1))
    };
    let [(forward, ahead), (backward, astern)] = [1.0, -1.0].map(power);
    if ahead < FROZEN_ROWS || astern < FROZEN_ROWS {
        return None;
    }
    let [forward, backward] = [forward / ahead as f64, backward / astern as f64];
    (backward > 0.05 * forward).then(|| {
        let help = if key == "current_a" {
            "a supply or rectified current has no direction; map the armature current, with its sign"
        } else {
            "map the speed with its sign, or the angle"
        };
        Finding::refusal(
            Kind::Unsigned,
            format!(
                "{key} is never negative (least {:.4}, largest {:.4}) although {} reverses for {astern} rows: it has lost its sign",
                activity.least, activity.most, table.voltage_key
            ),
            help,
        )
    })
}

/// The speed reverses, the voltage never does: its sign is lost, or it is not the motor's.
fn unsigned_voltage(table: &Table) -> Option<Finding> {
    let voltage = Activity::of(&table.voltage_v);
    let speed = Activity::of(&table.speed_rad_s);
    if !(voltage.is_there() && speed.moves) || voltage.least < -NEARLY_NONE * voltage.most {
        return None;
    }
    let driven_backward = table
        .voltage_v
        .iter()
        .zip(&table.speed_rad_s)
        .filter(|(u, w)| **u > CLEARLY * voltage.most && **w < -CLEARLY * speed.largest())
        .count();
    let share = driven_backward as f64 / table.time_s.len().max(1) as f64;
    let both = speed.most > CLEARLY * speed.largest() && speed.least < -CLEARLY * speed.largest();
    (both && share > 0.1).then(|| {
        Finding::refusal(
            Kind::Unsigned,
            format!(
                "{} is never negative although the speed runs from {:.4} to {:.4} rad/s, and is clearly positive in \
                 {driven_backward} rows that run backward: it has lost its sign",
                table.voltage_key, speed.least, speed.most
            ),
            "map the voltage with its sign (a duty or bus voltage alone has none)",
        )
    })
}
