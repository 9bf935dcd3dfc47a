//! Sets cells that are no measurement to missing: codes for a missing value, repeats of a signal that is sampled more slowly than
//! it is logged, and rows in which the whole telemetry was frozen.
//!
//! ```text
//! Run --> codes (-9999, all ones, zero between two values) --> telemetry that froze --> repeats --> Run, a finding for each
//! ```

use std::ops::Range;

use super::sensor::{Sensor, is_same, runs_of, stops_suddenly, stretches};
use super::stretches::FROZEN_ROWS;
use super::table::span;
use super::{CLOSE_S, Masked};
use crate::belief::Settings;
use drivebench_model::numerics::statistics::{extent, finite, largest, median_step};
use drivebench_model::sample::{Channel, Run};

/// Masks cells that are no measurement; returns the reason for each kind.
pub fn mask(run: &mut Run) -> Vec<Masked> {
    let mut found = Vec::new();
    for channel in CHANNELS {
        // Two different codes in one column are rare; three are not expected.
        for _ in 0..3 {
            let Some((rows, code)) = code(run, channel) else { break };
            empty(run, channel, rows);
            found.push(code);
        }
    }
    found.extend(frozen_telemetry(run));
    found.extend(MEASURED.into_iter().filter_map(|channel| repeats(run, channel)));
    found
}

const CHANNELS: [Channel; 7] = [
    Channel::Voltage,
    Channel::VoltageCmd,
    Channel::CurrentCmd,
    Channel::Current,
    Channel::Speed,
    Channel::Angle,
    Channel::Torque,
];
const MEASURED: [Channel; 3] = [Channel::Current, Channel::Speed, Channel::Angle];
/// The input: the first of these channels that the run has.
const INPUTS: [Channel; 3] = [Channel::Voltage, Channel::VoltageCmd, Channel::Torque];

fn empty(run: &mut Run, channel: Channel, rows: impl IntoIterator<Item = usize>) {
    let Some(cells) = run.column(channel) else { return };
    let mut cells = cells.to_vec();
    for row in rows {
        cells[row] = f64::NAN;
    }
    let origin = run.origin(channel);
    // The column stood there before, with as many rows and no larger values.
    let _ = run.set_column(channel, cells, origin);
}

/// Blocks of the very same value from which it is a code although its figures are none.
const BLOCKS: usize = 3;

/// Whether a value is nines, or an end of what 8 to 32 bits can count, with the decimal point anywhere.
fn is_figure(value: f64) -> bool {
    let ends = [8, 12, 16, 24, 32].into_iter().flat_map(|bits| {
        let counts = 2_f64.powi(bits);
        [counts - 1.0, 0.5 * counts - 1.0, 0.5 * counts]
    });
    let others = [999.0, 9999.0, 99_999.0, 999_999.0, 1023.0];
    ends.chain(others).any(|figure| {
        let mut scaled = (-6..=6).map(|place| value.abs() * 10_f64.powi(place));
        scaled.any(|scaled| (scaled - figure).abs() < 1e-7 * figure)
    })
}

/// The rows of a code in a column, and its finding.
fn code(run: &Run, channel: Channel) -> Option<(Vec<usize>, Masked)> {
    let cells = run.column(channel)?;
    let (least, most) = extent(finite(cells));
    let mut ends = [least, most].into_iter().filter(|value| value.is_finite());
    let extreme = ends.find_map(|value| Some((value, extreme_code(run, channel, cells, value)?)));
    let (value, rows) = extreme.or_else(|| Some((0.0, zeros(run, channel, cells)?)))?;
    let first_s = run.time_s()[rows[0]];
    let is_other = |cell: &&f64| cell.is_finite() && !is_same(**cell, value);
    let others = extent(cells.iter().filter(is_other));
    let (count, of) = (rows.len(), cells.len());
    Some((rows, Masked::Code { channel, value, rows: count, of, first_s, others }))
}

/// The rows of the least or the largest value where it is a code.
fn extreme_code(run: &Run, channel: Channel, cells: &[f64], value: f64) -> Option<Vec<usize>> {
    let mut others = finite(cells);
    others.retain(|other| !is_same(*other, value));
    let (least, most) = extent(&others);
    let range = most - least;
    others.sort_by(f64::total_cmp);
    others.dedup();
    // Fewer values are no range to compare with.
    if others.len() < 8 || range <= 0.0 {
        return None;
    }
    let distance = (value - most).max(least - value);
    let blocks = runs_of(cells.len(), 1, |row| is_same(cells[row], value));
    let is_figure = is_figure(value);
    let alone = blocks.iter().filter(|rows| {
        rows.len() <= 3
            && stands_between(cells, rows, Settings::FAR * range)
            && input_stands(run, channel, rows)
    });
    let mostly_alone = blocks.len() >= BLOCKS && alone.count() as f64 >= 0.8 * blocks.len() as f64;
    // Far off it is a code wherever it stands, by its figures or by coming again; nearer where it stands between two values
    // that agree.
    let far = if is_figure { 1.0 } else { 3.0 };
    let is_far = distance > far * range.max(least.abs()).max(most.abs());
    let is_code =
        is_far && (is_figure || blocks.len() >= BLOCKS) || mostly_alone && distance > 0.5 * range;
    // An excitation may well consist of pulses of one height.
    let may_pulse = INPUTS.contains(&channel);
    (is_code && (is_figure || !may_pulse)).then(|| blocks.into_iter().flatten().collect())
}

/// Single zeros between two clear values that agree.
fn zeros(run: &Run, channel: Channel, cells: &[f64]) -> Option<Vec<usize>> {
    if !matches!(channel, Channel::Speed | Channel::Current) {
        return None;
    }
    let clear = (0.5 * largest(cells)).max(5.0 * Sensor::of(cells).quantum);
    let mut found = runs_of(cells.len(), 1, |row| cells[row].abs() <= 0.0);
    found.retain(|rows| {
        rows.len() == 1
            && neighbours(cells, rows)
                .is_some_and(|(before, after)| before.abs().min(after.abs()) > clear)
            && stands_between(cells, rows, Settings::FAR * clear)
            && input_stands(run, channel, rows)
    });
    let fewest =
        if channel == Channel::Speed && median_step(run.time_s()) <= CLOSE_S { 1 } else { BLOCKS };
    (found.len() >= fewest).then(|| found.into_iter().flatten().collect())
}

/// The values on both sides of a block.
fn neighbours(cells: &[f64], rows: &Range<usize>) -> Option<(f64, f64)> {
    rows.start.checked_sub(1).map(|row| cells[row]).zip(cells.get(rows.end).copied())
}

/// Whether the values on both sides of a block agree.
fn stands_between(cells: &[f64], rows: &Range<usize>, within: f64) -> bool {
    neighbours(cells, rows).is_some_and(|(before, after)| (after - before).abs() <= within)
}

/// Whether the input is the same on both sides of a block, within a tenth of its range: a current that is cut off at a limit
/// stands alone there too, where the voltage steps.
fn input_stands(run: &Run, channel: Channel, rows: &Range<usize>) -> bool {
    let others = INPUTS.into_iter().filter(|input| *input != channel);
    let mut columns = others.filter_map(|input| run.column(input));
    let changes = |cells: &[f64]| {
        let beside = rows.start.saturating_sub(2)..(rows.end + 1).min(cells.len());
        span(&cells[beside]) > Settings::CHANGES * span(cells)
    };
    !columns.any(changes)
}

/// Rows in which every signal stands still to the bit, one of them from the midst of its noise.
fn frozen_telemetry(run: &mut Run) -> Option<Masked> {
    let column = |channel| Some((channel, run.column(channel)?));
    let columns: Vec<(Channel, &[f64])> = CHANNELS.into_iter().filter_map(column).collect();
    let stands = |row: usize| {
        columns.iter().all(|(_, cells)| is_same(cells[row - 1], cells[row]) || cells[row].is_nan())
    };
    let measured = columns.iter().filter(|own| MEASURED.contains(&own.0));
    let measured: Vec<(&[f64], Sensor)> =
        measured.map(|(_, cells)| (*cells, Sensor::of(cells))).collect();
    let mut still = stretches(run.rows(), FROZEN_ROWS, stands);
    still.retain(|rows| {
        let stops = |(cells, sensor): &(&[f64], Sensor)| {
            cells[rows.start].is_finite() && stops_suddenly(cells, sensor, rows)
        };
        // A motor at rest stands still with all its signals; that it runs shows in its speed, or in its current.
        let runs = |channel| run.column(channel).map(|cells| cells[rows.start].abs() > 0.0);
        let runs = runs(Channel::Speed).or_else(|| runs(Channel::Current));
        runs.unwrap_or(false) && measured.iter().any(stops)
    });
    let first = still.first()?;
    let times = run.time_s();
    let lengths = still.iter().map(|rows| times[rows.end - 1] - times[rows.start]);
    let channels: Vec<Channel> = columns.iter().map(|own| own.0).collect();
    let (longest_s, from_s) = (largest(lengths), times[first.start]);
    for channel in &channels {
        empty(run, *channel, still.iter().flat_map(|rows| rows.clone().skip(1)));
    }
    let rows = still.iter().map(|rows| rows.len() - 1).sum();
    Some(Masked::TelemetryFroze { channels, stretches: still.len(), longest_s, from_s, rows })
}

/// Repeats of a signal that takes a new value once in some rows only.
fn repeats(run: &mut Run, channel: Channel) -> Option<Masked> {
    let cells = run.column(channel)?;
    let rows = Sensor::of(cells).held_rows;
    if rows < 2 {
        return None;
    }
    let there: Vec<usize> = (0..cells.len()).filter(|row| cells[*row].is_finite()).collect();
    let mut repeats = Vec::new();
    let mut since = 0;
    for pair in there.windows(2) {
        // A value that comes again when it is renewed is a measurement.
        since += 1;
        if is_same(cells[pair[0]], cells[pair[1]]) && since < rows {
            repeats.push(pair[1]);
        } else {
            since = 0;
        }
    }
    let times: Vec<f64> = there.iter().map(|row| run.time_s()[*row]).collect();
    let (period_s, cells) = (median_step(&times), repeats.len());
    empty(run, channel, repeats);
    let every_s = rows as f64 * period_s;
    Some(Masked::SampledAndHeld { channel, every_s, period_s, cells })
}
