//! Cells that are no measurement, made missing before anything is judged by them: codes that stand for no value, repeats of a
//! signal that is sampled more slowly than it is logged, and rows in which the whole telemetry stood still.
//!
//! ```text
//! Run --> codes (-9999, all ones, zero between two values) --> telemetry that froze --> repeats --> Run, a sentence for each
//! ```

use std::ops::Range;

use super::sensor::{Sensor, is_same, stops_suddenly, stretches};
use super::stretches::FROZEN_ROWS;
use drivebench_model::numerics::statistics::{extent, finite, largest, median_step};
use drivebench_model::sample::{Channel, Run};

/// Makes missing what is no measurement, and says what and why.
pub fn mask(run: &mut Run) -> Vec<String> {
    let mut sentences = Vec::new();
    for channel in CHANNELS {
        // Two codes beside each other are rare, three have not been met.
        for _ in 0..3 {
            let Some((rows, sentence)) = code(run, channel) else {
                break;
            };
            empty(run, channel, rows);
            sentences.push(sentence);
        }
    }
    sentences.extend(frozen_telemetry(run));
    for channel in [Channel::Current, Channel::Speed, Channel::Angle] {
        sentences.extend(repeats(run, channel));
    }
    sentences
}

const CHANNELS: [Channel; 6] = [
    Channel::Voltage,
    Channel::VoltageCmd,
    Channel::Current,
    Channel::Speed,
    Channel::Angle,
    Channel::Torque,
];
/// What drives the motor, whichever of them is there.
const INPUTS: [Channel; 3] = [Channel::Voltage, Channel::VoltageCmd, Channel::Torque];

fn empty(run: &mut Run, channel: Channel, rows: impl IntoIterator<Item = usize>) {
    let Some(cells) = run.column(channel) else {
        return;
    };
    let mut cells = cells.to_vec();
    for row in rows {
        cells[row] = f64::NAN;
    }
    let origin = run.origin(channel);
    // The column stood there before, with as many rows and no larger values.
    let _ = run.set_column(channel, cells, origin);
}

/// Distance of a code from the other values, in their range: from which on it is one wherever it stands, by its figures or by
/// coming again, and from which on where it stands alone between two values that agree.
const FAR_FIGURE: f64 = 1.0;
const FAR: f64 = 3.0;
const APART: f64 = 0.5;
/// Blocks of the very same value from which it is a code although its figures are none.
const BLOCKS: usize = 3;
/// Share of the blocks that stand between two values that agree, and the share of the range within which two do.
const MOSTLY: f64 = 0.8;
const AGREE: f64 = 0.2;
/// Rows of a block that stands alone.
const ALONE_ROWS: usize = 3;
/// Distinct values below which a signal has no range of its own to compare with.
const FEWEST_VALUES: usize = 8;
/// Size of the two neighbours, as a share of the range and in quanta, between which a zero is a value that was not there.
const CLEAR: f64 = 0.5;
const CLEAR_QUANTA: f64 = 5.0;
/// Rows close enough that no shaft stops and runs again from one to the next, s.
const CLOSE_S: f64 = 0.02;

/// Figures of values that stand for none: nines, and the ends of what 8 to 32 bits can count.
const FIGURES: &[f64] = &[
    999.0,
    9999.0,
    99999.0,
    999_999.0,
    127.0,
    128.0,
    255.0,
    1023.0,
    2047.0,
    2048.0,
    4095.0,
    32767.0,
    32768.0,
    65535.0,
    8_388_607.0,
    8_388_608.0,
    16_777_215.0,
    2_147_483_647.0,
    2_147_483_648.0,
    4_294_967_295.0,
];

/// Whether a value is one of those figures, with the decimal point anywhere.
fn is_figure(value: f64) -> bool {
    (-6..=6).any(|place| {
        let scaled = value.abs() * 10_f64.powi(place);
        FIGURES
            .iter()
            .any(|figure| (scaled - figure).abs() < 1e-7 * figure)
    })
}

/// The rows of a code in a column, and what is to be said of it.
fn code(run: &Run, channel: Channel) -> Option<(Vec<usize>, String)> {
    let cells = run.column(channel)?;
    let (least, most) = extent(finite(cells));
    let found = [least, most]
        .into_iter()
        .filter(|value| value.is_finite())
        .find_map(|value| Some((value, extreme_code(run, channel, cells, value)?)));
    let found = found.or_else(|| Some((0.0, zeros(run, channel, cells)?)));
    let (value, rows) = found?;
    let first_s = run.time_s()[rows[0]];
    let others = (0..cells.len()).filter(|row| !is_same(cells[*row], value));
    let (least, most) = extent(finite(&others.map(|row| cells[row]).collect::<Vec<_>>()));
    let count = rows.len();
    let why = if value.abs() > 0.0 {
        format!(", far from all others ({least:.4} to {most:.4})")
    } else {
        " between values that agree and are far from it: no machine moves like that".to_owned()
    };
    let sentence = format!(
        "{} reads exactly {value} in {count} {} of {} (first at {first_s:.4} s){why}: it stands for a missing value, and the \
         cells are taken as missing",
        channel.key(),
        if count == 1 { "row" } else { "rows" },
        cells.len()
    );
    Some((rows, sentence))
}

/// Blocks of rows of one value.
fn blocks(cells: &[f64], value: f64) -> Vec<Range<usize>> {
    let is = |row: usize| is_same(cells[row], value);
    let mut found = stretches(cells.len(), 1, |row| is(row) && is(row - 1));
    found.retain(|rows| is(rows.start));
    found
}

/// The rows of the least or the largest value where it is a code.
fn extreme_code(run: &Run, channel: Channel, cells: &[f64], value: f64) -> Option<Vec<usize>> {
    let mut others = finite(cells);
    others.retain(|other| !is_same(*other, value));
    let (least, most) = extent(&others);
    let range = most - least;
    others.sort_by(f64::total_cmp);
    others.dedup();
    if others.len() < FEWEST_VALUES || range <= 0.0 {
        return None;
    }
    let distance = (value - most).max(least - value);
    let blocks = blocks(cells, value);
    let is_figure = is_figure(value);
    let alone = blocks.iter().filter(|rows| {
        rows.len() <= ALONE_ROWS
            && stands_between(cells, rows, AGREE * range)
            && input_stands(run, channel, rows)
    });
    let mostly_alone =
        blocks.len() >= BLOCKS && alone.count() as f64 >= MOSTLY * blocks.len() as f64;
    let far = if is_figure { FAR_FIGURE } else { FAR };
    let is_far = distance > far * range.max(least.abs()).max(most.abs());
    let is_code =
        is_far && (is_figure || blocks.len() >= BLOCKS) || mostly_alone && distance > APART * range;
    // An excitation may well consist of pulses of one height.
    let may_pulse = INPUTS.contains(&channel);
    let found = is_code && (is_figure || !may_pulse);
    found.then(|| blocks.into_iter().flatten().collect())
}

/// Single zeros between two clear values that agree.
fn zeros(run: &Run, channel: Channel, cells: &[f64]) -> Option<Vec<usize>> {
    if !matches!(channel, Channel::Speed | Channel::Current) {
        return None;
    }
    let clear = (CLEAR * largest(cells)).max(CLEAR_QUANTA * Sensor::of(cells).quantum);
    let is_zero = |row: usize| cells[row].abs() <= 0.0;
    let mut found = stretches(cells.len(), 1, |row| is_zero(row) && is_zero(row - 1));
    let neighbours = |rows: &Range<usize>| {
        let before = rows.start.checked_sub(1).map(|row| cells[row]);
        before.zip(cells.get(rows.end).copied())
    };
    found.retain(|rows| {
        is_zero(rows.start)
            && rows.len() == 1
            && neighbours(rows).is_some_and(|(before, after)| before.abs().min(after.abs()) > clear)
            && stands_between(cells, rows, AGREE * clear)
            && input_stands(run, channel, rows)
    });
    let fewest = if channel == Channel::Speed && median_step(run.time_s()) <= CLOSE_S {
        1
    } else {
        BLOCKS
    };
    (found.len() >= fewest).then(|| found.into_iter().flatten().collect())
}

/// Whether the values on both sides of a block agree.
fn stands_between(cells: &[f64], rows: &Range<usize>, within: f64) -> bool {
    let before = rows.start.checked_sub(1).map(|row| cells[row]);
    let both = before.zip(cells.get(rows.end).copied());
    both.is_some_and(|(before, after)| (after - before).abs() <= within)
}

/// Whether the input is the same on both sides of a block, within a tenth of its range: a current that is cut off at a limit
/// stands alone there too, where the voltage steps.
fn input_stands(run: &Run, channel: Channel, rows: &Range<usize>) -> bool {
    INPUTS
        .iter()
        .filter(|input| **input != channel)
        .all(|input| {
            let Some(cells) = run.column(*input) else {
                return true;
            };
            let beside = rows.start.saturating_sub(2)..(rows.end + 1).min(cells.len());
            let (least, most) = extent(finite(&cells[beside]));
            let (lowest, highest) = extent(finite(cells));
            let changes = most - least > 0.1 * (highest - lowest);
            !changes
        })
}

/// Rows in which every signal stands still to the bit, one of them from the midst of its noise.
fn frozen_telemetry(run: &mut Run) -> Option<String> {
    let there: Vec<Channel> = CHANNELS
        .into_iter()
        .filter(|channel| run.column(*channel).is_some())
        .collect();
    let columns: Vec<&[f64]> = there
        .iter()
        .filter_map(|channel| run.column(*channel))
        .collect();
    let stands = |row: usize| {
        columns
            .iter()
            .all(|cells| is_same(cells[row - 1], cells[row]) || cells[row].is_nan())
    };
    let measured: Vec<(&[f64], Sensor)> = (there.iter().zip(&columns))
        .filter(|(channel, _)| {
            matches!(channel, Channel::Current | Channel::Speed | Channel::Angle)
        })
        .map(|(_, cells)| (*cells, Sensor::of(cells)))
        .collect();
    let mut still = stretches(run.rows(), FROZEN_ROWS, stands);
    still.retain(|rows| {
        let stops = |(cells, sensor): &(&[f64], Sensor)| {
            cells[rows.start].is_finite() && stops_suddenly(cells, sensor, rows)
        };
        // A motor at rest stands still with all its signals; that it runs shows in its speed, or in its current.
        let runs = |channel: Channel| {
            let cells = run.column(channel)?;
            Some(cells[rows.start].abs() > 0.0)
        };
        let runs = runs(Channel::Speed).or_else(|| runs(Channel::Current));
        runs.unwrap_or(false) && measured.iter().any(stops)
    });
    let first = still.first()?;
    let times = run.time_s();
    let lengths: Vec<f64> = still
        .iter()
        .map(|rows| times[rows.end - 1] - times[rows.start])
        .collect();
    let count: usize = still.iter().map(|rows| rows.len() - 1).sum();
    let keys: Vec<&str> = there.iter().map(|channel| channel.key()).collect();
    let sentence = format!(
        "{} stand exactly still in {} {} of up to {:.3} s (first from {:.3} s on) while the motor runs: the telemetry froze, and {count} rows that repeat the last one are taken as missing",
        keys.join(", "),
        still.len(),
        if still.len() == 1 {
            "stretch"
        } else {
            "stretches"
        },
        largest(&lengths),
        times[first.start],
    );
    for channel in there {
        let rows = still.iter().flat_map(|rows| rows.clone().skip(1));
        empty(run, channel, rows);
    }
    Some(sentence)
}

/// Repeats of a signal that takes a new value once in some rows only.
fn repeats(run: &mut Run, channel: Channel) -> Option<String> {
    let cells = run.column(channel)?;
    let rows = Sensor::of(cells).held_rows;
    if rows < 2 {
        return None;
    }
    let there: Vec<usize> = (0..cells.len())
        .filter(|row| cells[*row].is_finite())
        .collect();
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
    let (period_s, count) = (median_step(&times), repeats.len());
    let sentence = format!(
        "{} takes a new value every {:.4} s and the rows are {period_s:.4} s apart: it is sampled and held, and {count} cells that \
         only repeat it are taken as missing",
        channel.key(),
        rows as f64 * period_s
    );
    empty(run, channel, repeats);
    Some(sentence)
}
