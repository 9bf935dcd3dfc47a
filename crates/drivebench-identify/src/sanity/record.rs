//! Faults of a record, signal by signal: nothing moves, single wild values, a signal that froze, was cut off or
//! lost its sign.

use std::ops::Range;

use super::sensor::{is_same, runs_of};
use super::stretches::{FROZEN_ROWS, Watched};
use super::table::{Activity, Roles, Table, correlation, span, voltage_at_rest};
use super::{CLOSE_S, Fault, Finding, Kind, Level, SignalFault};
use crate::belief::Settings;
use drivebench_model::numerics::count::whole;
use drivebench_model::numerics::statistics::{extent, finite, median};
use drivebench_model::plant::MotorKey;
use drivebench_model::sample::Channel;

/// Share of the voltage that resistance and inductance may leave unexplained in a winding at rest.
const AT_REST: f64 = 0.3;

/// Records of one operating point, or in which a signal is constant that has to change.
pub(super) fn still(table: &Table) -> Vec<Finding> {
    let activities = table.columns().map(Activity::of);
    let [voltage, current, speed] = &activities;
    let current_moves = current.moves
        || current.is_there() && correlation(&table.voltage_v, &table.current_a).abs() > 0.3;
    if !speed.moves && !current_moves {
        return vec![nothing_moves(&activities, table.duration_s())];
    }
    let mut findings = Vec::new();
    let voltage_changes =
        voltage.is_there() && voltage.range() > Settings::REST * voltage.largest();
    if current.is_constant() && voltage_changes && speed.moves {
        let fault = SignalFault::CurrentConstant {
            level_a: current.mean,
            rows: current.count,
            voltage: table.voltage_key,
            volts: voltage.extent(),
        };
        findings.push(Finding::refusal(Kind::Frozen, Fault::Signal(fault)));
    } else if current.is_there() && current.is_zero() && voltage.is_there() && !voltage_changes {
        let fault = SignalFault::CoastDown { speeds_rad_s: speed.extent(), volts: voltage.mean };
        findings.push(Finding::refusal(Kind::OpenCircuit, Fault::Signal(fault)));
    }
    if current_moves && speed.is_there() && !speed.moves {
        findings.extend(shaft_at_rest(table, speed));
    }
    if current.moves && speed.moves && voltage.is_there() {
        findings.extend(open_for_a_while(table, &activities));
    }
    findings
}

/// A rotating shorted armature carries `-Ke w/R`; without a current at zero volt it is open.
fn open_for_a_while(table: &Table, [voltage, current, speed]: &[Activity; 3]) -> Option<Finding> {
    // A coarse sensor may alternate by one quantum at rest; by two the shaft turns slowly.
    let clear = (Settings::FAR * speed.largest()).max(3.0 * table.speed.quantum);
    let coasts = |row: usize| {
        table.voltage_v[row].abs() <= 0.002 * voltage.largest()
            && table.speed_rad_s[row].abs() > clear
            && table.current_a[row].is_finite()
    };
    // A coasting shaft slows down; a constant speed is that of a frozen or delayed sensor.
    let slows = |rows: &Range<usize>| {
        let pairs = table.speed_rad_s[rows.clone()].windows(2);
        pairs.filter(|pair| !is_same(pair[0], pair[1])).count() >= 3
    };
    let stretches = runs_of(table.time_s.len(), 20, coasts);
    let rows: Vec<usize> = stretches.into_iter().filter(slows).flatten().collect();
    let currents: Vec<f64> = rows.iter().map(|row| table.current_a[*row].abs()).collect();
    let level_a = median(&currents);
    if rows.is_empty() || level_a > Settings::IDLE_CURRENT * current.largest() {
        return None;
    }
    let (from_s, rows) = (table.time_s[rows[0]], rows.len());
    let fault = SignalFault::CoastDownInside { rows, from_s, level_a };
    let share = rows as f64 / table.time_s.len() as f64;
    Some(Finding::of_all(Kind::OpenCircuit, share > 0.02, Fault::Signal(fault)))
}

/// One operating point, moving or not.
fn nothing_moves([voltage, current, speed]: &[Activity; 3], duration_s: f64) -> Finding {
    let signals = [("voltage", voltage, "V"), ("current", current, "A"), ("speed", speed, "rad/s")];
    let there = signals.iter().filter(|(_, activity, _)| activity.is_there());
    let levels = there.map(|(signal, activity, unit)| {
        let noise = (!activity.is_constant()).then_some(activity.noise);
        Level { signal, unit, mean: activity.mean, noise }
    });
    let levels = levels.collect();
    let (kind, fault) = if speed.is_there() && speed.is_zero() {
        (Kind::Standstill, SignalFault::AtRest { duration_s, levels })
    } else {
        (Kind::Steady, SignalFault::OperatingPoint { duration_s, levels })
    };
    Finding::refusal(kind, Fault::Signal(fault))
}

/// The current moves, the speed does not: a locked rotor, or a speed that is not measured.
fn shaft_at_rest(table: &Table, speed: &Activity) -> Option<Finding> {
    if speed.is_constant() && speed.mean.abs() > 0.0 {
        let (level_rad_s, rows) = (speed.mean, speed.count);
        let fault = SignalFault::SpeedConstant { level_rad_s, rows };
        return Some(Finding::refusal(Kind::Frozen, Fault::Signal(fault)));
    }
    if !speed.is_zero() {
        return None;
    }
    let unexplained = voltage_at_rest(&Roles::of(table))?;
    if unexplained > AT_REST {
        let fault = SignalFault::SpeedZero { unexplained };
        return Some(Finding::refusal(Kind::Frozen, Fault::Signal(fault)));
    }
    let doubts = [MotorKey::BackEmf, MotorKey::Inertia, MotorKey::LoadTorque];
    let (duration_s, noise_rad_s) = (table.duration_s(), speed.noise);
    let fault = SignalFault::ShaftAtRest { duration_s, noise_rad_s };
    Some(Finding::caution(Kind::Standstill, &doubts, Fault::Signal(fault)))
}

/// Single values that no machine can have shown: one row far off between two that agree. A current may jump, but not to three
/// times its usual range and back; where rows are close enough the inertia forbids a speed half of its range for one row.
pub(super) fn outlier(table: &Table) -> Option<Finding> {
    let pairs = table.time_s.windows(2);
    let close = pairs.clone().filter(|pair| pair[1] - pair[0] <= CLOSE_S);
    let close = 2 * close.count() > pairs.count();
    let [current, speed] = Watched::both(table);
    wild(&speed, if close { 0.5 } else { 3.0 }).or_else(|| wild(&current, 3.0))
}

fn wild(watched: &Watched<'_>, ranges: f64) -> Option<Finding> {
    let values = watched.values;
    let mut sorted = finite(values);
    if sorted.len() < 100 {
        return None;
    }
    sorted.sort_by(f64::total_cmp);
    // The usual range excludes one per cent of the values at each end.
    let tail = whole((0.01 * sorted.len() as f64).ceil());
    let range = sorted[sorted.len() - 1 - tail] - sorted[tail];
    let stands_out = |row: &usize| {
        let (before, at, after) = (values[row - 1], values[*row], values[row + 1]);
        let nearest = (at - before).abs().min((at - after).abs());
        let agree = (before - after).abs() <= Settings::CHANGES * range;
        range > 0.0 && agree && nearest > ranges * range
    };
    let inner = 1..values.len().saturating_sub(1);
    let spikes: Vec<usize> = inner.filter(stands_out).collect();
    let first = *spikes.first()?;
    // Many of them are no outliers but belong to the signal.
    if spikes.len() > tail {
        return None;
    }
    let fault = SignalFault::Outlier {
        key: watched.key,
        at_s: watched.table.time_s[first],
        value: values[first],
        neighbours: [values[first - 1], values[first + 1]],
        count: spikes.len(),
        of: values.len(),
    };
    Some(Finding::refusal(Kind::Outlier, Fault::Signal(fault)))
}

/// Share of the largest value that counts as zero.
const ROUNDING: f64 = 1e-9;

/// One signal that contradicts itself: frozen for a while, cut off at a limit, or without its direction.
pub(super) fn contradicted(table: &Table) -> Vec<Finding> {
    let mut findings = Vec::new();
    let speed_moves = Activity::of(&table.speed_rad_s).moves;
    for watched in Watched::both(table).into_iter().filter(|watched| watched.activity.moves) {
        // A winding at rest, sampled slowly and without noise, does follow the voltage in jumps.
        if speed_moves && let Some(held) = watched.held() {
            findings.push(held);
            continue;
        }
        // A plateau at the limit is saturation, not a frozen signal.
        match watched.clipped() {
            Some(clipped) => findings.push(clipped),
            None => findings.extend(watched.frozen()),
        }
        findings.extend(unsigned(&watched));
    }
    if speed_moves {
        findings.extend(dead_at_zero(table));
    }
    findings.extend(unsigned_voltage(table));
    findings
}

/// The longest stretch of a speed of exactly zero with a back-EMF in the voltage balance: the shaft turns, and its sensor is
/// dead. At rest `u = R i + L di/dt`.
fn dead_at_zero(table: &Table) -> Option<Finding> {
    // A slope of equal angles is zero but for rounding.
    let zero_rad_s = ROUNDING * Activity::of(&table.speed_rad_s).largest();
    let is_zero = |row: usize| table.speed_rad_s[row].abs() <= zero_rad_s;
    let still = runs_of(table.speed_rad_s.len(), FROZEN_ROWS, is_zero);
    let longest = still.into_iter().max_by_key(Range::len)?;
    let inside = |window: &&Range<usize>| longest.start <= window.start && window.end < longest.end;
    let windows: Vec<Range<usize>> = table.windows.iter().filter(inside).cloned().collect();
    let clear_v = Settings::FAR * Activity::of(&table.voltage_v).largest();
    let driven = table.voltage_v[longest.clone()].iter().filter(|volts| volts.abs() > clear_v);
    // A bridge that is off leaves the voltage of the supply, and the winding takes none of it.
    if table.voltage_is_of_a_supply() || driven.count() < FROZEN_ROWS {
        return None;
    }
    let unexplained =
        voltage_at_rest(&Roles::of(table).over(&windows)).filter(|share| *share > AT_REST)?;
    let (from_s, to_s) = (table.time_s[longest.start], table.time_s[longest.end - 1]);
    let fault = SignalFault::SpeedDead { from_s, to_s, unexplained };
    Some(Finding::refusal(Kind::Frozen, Fault::Signal(fault)))
}

/// A signal that is never negative although the voltage clearly reverses and it is large there.
fn unsigned(watched: &Watched<'_>) -> Option<Finding> {
    let Watched { table, key, activity, .. } = watched;
    let voltage = Activity::of(&table.voltage_v);
    if !voltage.is_there() || activity.least < -Settings::CLEAR * activity.most {
        return None;
    }
    // Where the voltage is clearly of one direction.
    let clear_v = Settings::FAR * voltage.largest();
    let direction = |u: f64| i8::from(u > clear_v) - i8::from(u < -clear_v);
    let rows = table.voltage_v.iter().zip(watched.values).filter(|(_, x)| x.is_finite());
    let rows: Vec<(i8, f64)> = rows.map(|(u, x)| (direction(*u), *x)).collect();
    let under = |wanted: i8| -> Vec<f64> {
        rows.iter().filter(|row| row.0 == wanted).map(|row| row.1).collect()
    };
    let [ahead, astern] = [1, -1].map(under);
    // A heavy shaft need not follow a short reversal; one that did came through zero.
    let astern_least = astern.iter().fold(f64::INFINITY, |least, x| least.min(x.abs()));
    if astern_least > Settings::CHANGES * activity.largest()
        || ahead.len().min(astern.len()) < FROZEN_ROWS
    {
        return None;
    }
    // A shaft that slows down and then sticks has turned forward only: its speed has to rise again after its least.
    let is_speed = *key == Channel::Speed.key();
    let risen = rows.chunk_by(|a, b| a.0 == b.0).filter(|part| part[0].0 < 0).flat_map(|part| {
        let smaller = |a: &usize, b: &usize| part[*a].1.abs().total_cmp(&part[*b].1.abs());
        let least = (0..part.len()).min_by(smaller).filter(|_| is_speed).unwrap_or(0);
        part[least..].iter().map(|row| row.1)
    });
    let forward = ahead.iter().map(|x| x * x).sum::<f64>() / ahead.len() as f64;
    let backward = risen.map(|x| x * x).sum::<f64>() / astern.len() as f64;
    (backward > Settings::CLEAR * forward).then(|| {
        let (values, voltage) = (activity.extent(), table.voltage_key);
        let fault = SignalFault::SignLost { key, values, voltage, rows: astern.len() };
        Finding::refusal(Kind::Unsigned, Fault::Signal(fault))
    })
}

/// The speed reverses, the voltage never does: its sign is lost, or it is not the motor's.
fn unsigned_voltage(table: &Table) -> Option<Finding> {
    let voltage = Activity::of(&table.voltage_v);
    let speed = Activity::of(&table.speed_rad_s);
    if !(voltage.is_there() && speed.moves) || voltage.least < -Settings::CLEAR * voltage.most {
        return None;
    }
    let [clear_v, clear_rad_s] = [voltage.most, speed.largest()].map(|most| Settings::FAR * most);
    let rows = table.voltage_v.iter().zip(&table.speed_rad_s);
    let rows = rows.filter(|(u, w)| **u > clear_v && **w < -clear_rad_s).count();
    let share = rows as f64 / table.time_s.len().max(1) as f64;
    let both = speed.most > clear_rad_s && speed.least < -clear_rad_s;
    (both && share > Settings::CHANGES).then(|| {
        let (voltage, speeds_rad_s) = (table.voltage_key, speed.extent());
        let fault = SignalFault::VoltageSignLost { voltage, speeds_rad_s, rows };
        Finding::refusal(Kind::Unsigned, Fault::Signal(fault))
    })
}

/// A signal that jumps from one end of its range to the other where nothing drives it: a counter that overflows to the other
/// sign.
pub(super) fn overflow(table: &Table) -> Option<Finding> {
    let [current, speed] = Watched::both(table);
    overflow_of(&speed).or_else(|| overflow_of(&current))
}

fn overflow_of(watched: &Watched<'_>) -> Option<Finding> {
    let Watched { table, key, values, activity, sensor, .. } = watched;
    let ([least, most], range) = (activity.extent(), activity.range());
    let sizes: Vec<f64> = values.windows(2).map(|pair| (pair[1] - pair[0]).abs()).collect();
    let is_end = |value: f64| (value - least).min(most - value) < Settings::FAR * range;
    let ends = |row: &usize| is_end(values[row - 1]) && is_end(values[*row]);
    let jumps: Vec<usize> =
        (1..values.len()).filter(|row| sizes[row - 1] > 0.7 * range && ends(row)).collect();
    let is_coarse = sensor.quantum <= 0.0 || range < 20.0 * sensor.quantum;
    if jumps.len() < 3 || is_coarse || median(&sizes) > Settings::CLEAR * range {
        return None;
    }
    // A current that drives is no cause of its own jumps.
    let is_driven = *key == Channel::Speed.key();
    let input = if is_driven { &table.input } else { &table.voltage_v };
    let stands = |row: &&usize| {
        let beside = row.saturating_sub(2)..(**row + 2).min(input.len());
        let moved = span(&input[beside]);
        moved.is_infinite() || moved <= Settings::FAR * span(input)
    };
    // Most jumps occur at a constant input.
    let uncaused = jumps.iter().filter(stands).count();
    if (uncaused as f64) < 0.6 * jumps.len() as f64 {
        return None;
    }
    // The signal goes on beyond its end as it did before.
    let period = jumps.iter().map(|row| {
        let beside = [row.checked_sub(2), Some(*row)].into_iter().flatten();
        let (least, _) = extent(beside.filter_map(|step| sizes.get(step)));
        sizes[row - 1] + least.min(Settings::CLEAR * range)
    });
    let period = median(&period.collect::<Vec<f64>>());
    // The step is exact and the jump known to some per cent: a whole number of bits goes before the jump itself.
    let (step, _) = extent(sizes.iter().filter(|size| **size > ROUNDING * range));
    let bits = (period / step).log2();
    let is_whole = (bits - bits.round()).abs() < 0.05 && (8.0..=32.0).contains(&bits.round());
    let counts = is_whole.then(|| bits.round().exp2());
    let first = jumps[0];
    let fault = SignalFault::CounterOverflows {
        key,
        jump: counts.map_or(period, |counts| counts * step),
        counts,
        rows: jumps.len(),
        at_s: table.time_s[first],
        values: [values[first - 1], values[first]],
    };
    Some(Finding::refusal(Kind::Overflow, Fault::Signal(fault)))
}
