//! A recorded data set, in columns.

use crate::tabulated;
use thiserror::Error;

use super::{Channel, Sample};

tabulated! {
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
    #[serde(rename_all = "snake_case")]
    pub enum Origin {
        /// Sampled by an instrument at the row's instant.
        Measured = "measured",
        /// Computed by the drive from other quantities.
        Estimated = "estimated",
        /// The requested value, stamped with the instant from which it was applied.
        Commanded = "commanded",
        /// Computed by this program, as speed from angle.
        Derived = "derived",
        #[default]
        Unknown = "unknown",
    }
    /// As in files and on the command line.
    pub const fn name(self) -> &'static str;
}

tabulated! {
    #[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
    #[serde(rename_all = "snake_case")]
    pub enum Side {
        /// At the motor's terminals.
        Terminal = "terminal",
        /// Between supply and drive: the duty cycle relates it to the motor.
        Supply = "supply",
    }
    pub const fn name(self) -> &'static str;
}

/// What is known of the sensors and the power stage of a run: a part of every model of it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sensors {
    pub speed: SpeedLag,
    /// Nobody has stated the filter of the speed, and none is known.
    pub has_unknown_filter: bool,
    /// A measured current is the mean since the sample before.
    pub averages_current: bool,
    /// The drive's own ramp of the voltage, V/s; zero where it has none.
    pub ramp_v_per_s: f64,
}

/// How much later than the shaft's a measured speed is: the delay and the time constant of the first-order filter of its sensor, s.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SpeedLag {
    pub delay_s: f64,
    pub filter_s: f64,
}

impl SpeedLag {
    /// Of a slow change.
    pub fn total_s(self) -> f64 {
        self.delay_s + self.filter_s
    }
}

/// Largest magnitude of a time or a value of any bench: a larger one is a damaged file or a wrong unit.
pub const LARGEST: f64 = 1e12;

#[derive(Clone, Debug, Error, PartialEq)]
pub enum RunError {
    #[error(
        "run {run:?}: row {row}: {column} {value:e} is not allowed (expected a size up to {LARGEST:e})"
    )]
    Absurd { run: String, column: &'static str, row: usize, value: f64 },
    #[error(
        "run {run:?}: row {row}: time {time_s} s is not after {before_s} s (time must be strictly increasing)"
    )]
    TimeNotIncreasing { run: String, row: usize, time_s: f64, before_s: f64 },
    #[error("run {run:?}: column {column} has {rows} rows, time has {expected}")]
    ColumnLength { run: String, column: &'static str, rows: usize, expected: usize },
}

/// Columns over one strictly increasing time axis, which need not be equidistant. NaN marks a missing cell.
///
/// Measured cells hold at their row's instant; command and reference cells hold from their row until the next row that
/// has one, so a command and a sample may stand on rows of their own.
#[derive(Clone, Debug, Default)]
pub struct Run {
    pub name: String,
    time_s: Vec<f64>,
    columns: [Option<Vec<f64>>; Channel::COUNT],
    origins: [Origin; Channel::COUNT],
    sides: [Option<Side>; Channel::COUNT],
    /// Rows, in order, at which the drive reported an active limit of its output.
    limited_rows: Vec<usize>,
    /// Rows, in order, with a command that the drive did not confirm.
    unconfirmed_rows: Vec<usize>,
    sensors: Sensors,
    /// Rows that were torn or unreadable and left out.
    pub rows_dropped: usize,
    /// Sentences for the reader: runs of fit and hold-out, derived columns.
    pub notes: Vec<String>,
}

impl Run {
    /// A run with a time axis and no columns yet.
    pub fn new(name: impl Into<String>, time_s: Vec<f64>) -> Result<Self, RunError> {
        let name = name.into();
        refuse_absurd(&name, "time_s", &time_s)?;
        // False for NaN as well.
        let increases = |pair: &[f64]| pair[1] > pair[0];
        if let Some(row) = time_s.windows(2).position(|pair| !increases(pair)) {
            return Err(RunError::TimeNotIncreasing {
                run: name,
                row: row + 1,
                time_s: time_s[row + 1],
                before_s: time_s[row],
            });
        }
        Ok(Self { name, time_s, ..Self::default() })
    }

    pub fn set_column(
        &mut self,
        channel: Channel,
        values: Vec<f64>,
        origin: Origin,
    ) -> Result<(), RunError> {
        if values.len() != self.time_s.len() {
            return Err(RunError::ColumnLength {
                run: self.name.clone(),
                column: channel.key(),
                rows: values.len(),
                expected: self.time_s.len(),
            });
        }
        refuse_absurd(&self.name, channel.key(), &values)?;
        self.columns[channel.index()] = Some(values);
        self.origins[channel.index()] = origin;
        Ok(())
    }

    pub fn set_origin(&mut self, channel: Channel, origin: Origin) {
        self.origins[channel.index()] = origin;
    }

    pub fn set_side(&mut self, channel: Channel, side: Side) {
        self.sides[channel.index()] = Some(side);
    }

    pub fn set_limited_rows(&mut self, rows: Vec<usize>) {
        self.limited_rows = rows;
    }

    /// Rows at which a limit of the drive was active, so that the voltage was not the commanded one.
    pub fn limited_rows(&self) -> &[usize] {
        &self.limited_rows
    }

    pub const fn set_sensors(&mut self, sensors: Sensors) {
        self.sensors = sensors;
    }

    /// Without a lag where none is known.
    pub const fn sensors(&self) -> Sensors {
        self.sensors
    }

    pub fn set_unconfirmed_rows(&mut self, rows: Vec<usize>) {
        self.unconfirmed_rows = rows;
    }

    /// Rows with a command of which it is unknown whether and when, before the next one, it acted.
    pub fn unconfirmed_rows(&self) -> &[usize] {
        &self.unconfirmed_rows
    }

    #[must_use]
    pub fn without(&self, channel: Channel) -> Self {
        let mut run = self.clone();
        run.columns[channel.index()] = None;
        run
    }

    pub fn time_s(&self) -> &[f64] {
        &self.time_s
    }

    pub fn rows(&self) -> usize {
        self.time_s.len()
    }

    /// The column, NaN where a cell is missing; `None` without the column.
    pub fn column(&self, channel: Channel) -> Option<&[f64]> {
        self.columns[channel.index()].as_deref()
    }

    pub fn origin(&self, channel: Channel) -> Origin {
        self.origins[channel.index()]
    }

    /// `None`: not stated.
    pub fn side(&self, channel: Channel) -> Option<Side> {
        self.sides[channel.index()]
    }

    /// `(time, value)` of the finite cells.
    pub fn points(&self, channel: Channel) -> impl Iterator<Item = (f64, f64)> + '_ {
        let values = self.column(channel).unwrap_or_default().iter().copied();
        self.time_s.iter().copied().zip(values).filter(|(_, value)| value.is_finite())
    }

    /// Every row as a sample with the channels that it has; a missing cell is unset.
    pub fn samples(&self) -> impl Iterator<Item = Sample> + '_ {
        self.time_s.iter().enumerate().map(|(row, &time_s)| {
            let mut sample = Sample::at(time_s);
            for channel in Channel::ALL {
                if let Some(values) = self.column(channel) {
                    sample.set(channel, values[row]);
                }
            }
            sample.limited = self.limited_rows.binary_search(&row).is_ok();
            sample
        })
    }

    /// Median distance between rows that carry a measurement of `channel`, s.
    pub fn period_s(&self, channel: Channel) -> Option<f64> {
        let times: Vec<f64> = self.points(channel).map(|(time, _)| time).collect();
        let mut gaps: Vec<f64> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
        if gaps.is_empty() {
            return None;
        }
        let middle = gaps.len() / 2;
        Some(*gaps.select_nth_unstable_by(middle, f64::total_cmp).1)
    }
}

/// NaN is a missing cell; infinity and impossible magnitudes are damage.
fn refuse_absurd(run: &str, column: &'static str, values: &[f64]) -> Result<(), RunError> {
    values.iter().position(|value| value.abs() > LARGEST).map_or(Ok(()), |row| {
        Err(RunError::Absurd { run: run.to_owned(), column, row, value: values[row] })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    #[test]
    fn time_must_increase_and_sizes_be_possible() {
        for (times, message) in [
            (vec![], ""),
            (vec![0.0, 0.0], "row 1: time 0 s is not after 0 s"),
            (vec![0.0, f64::NAN], "is not after"),
            (vec![0.0, 1.0, f64::INFINITY], "row 2: time_s inf"),
            (vec![f64::NEG_INFINITY, 0.0], "row 0: time_s -inf"),
            (vec![0.0, 1e15], "row 1: time_s 1e15"),
        ] {
            let error = Run::new("r", times).err();
            let text = error.map_or_else(String::new, |error| error.to_string());
            assert!(text.contains(message) && text.is_empty() == message.is_empty(), "{text}");
        }
        let mut run = Run::new("r", vec![0.0, 0.1, 0.25, 0.3]).unwrap();
        let wild = vec![0.0, f64::NAN, 1e300, 0.0];
        let error = run.set_column(Channel::Speed, wild, Origin::Unknown);
        let text =
            "run \"r\": row 2: speed_rad_s 1e300 is not allowed (expected a size up to 1e12)";
        assert_eq!(error.unwrap_err().to_string(), text);
        assert!(run.set_column(Channel::Speed, vec![0.0], Origin::Unknown).is_err());
    }

    #[test]
    fn samples_and_points_hold_the_cells_that_are_there() {
        let mut run = Run::new("r", vec![0.0, 0.1, 0.25, 0.3]).unwrap();
        let none = f64::NAN;
        for (channel, cells) in [
            (Channel::VoltageCmd, [1.0, none, none, 2.0]),
            (Channel::Current, [none, 0.5, 0.6, 0.7]),
        ] {
            run.set_column(channel, cells.into(), Origin::Measured).unwrap();
        }
        run.set_limited_rows(vec![1]);
        let mut limited = Sample::at(0.1).with(Channel::Current, 0.5);
        limited.limited = true;
        let expected = [
            Sample::at(0.0).with(Channel::VoltageCmd, 1.0),
            limited,
            Sample::at(0.25).with(Channel::Current, 0.6),
            Sample::at(0.3).with(Channel::VoltageCmd, 2.0).with(Channel::Current, 0.7),
        ];
        assert!(run.samples().eq(expected));
        assert_eq!(run.points(Channel::Current).count(), 3);
        assert!((run.period_s(Channel::Current).unwrap() - 0.15).abs() < 1e-12);
    }
}
