//! A recorded data set, in columns.

use thiserror::Error;

use super::{Channel, Sample};

/// Where a signal comes from; it limits what may be claimed from it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Origin {
    /// Sampled by an instrument at the row's instant.
    Measured,
    /// Computed by the drive from other quantities.
    Estimated,
    /// What was asked, stamped with the instant from which it was applied.
    Commanded,
    /// Computed by this program, as speed from angle.
    Derived,
    #[default]
    Unknown,
}

#[derive(Clone, Debug, Error, PartialEq)]
pub enum RunError {
    #[error(
        "run {run:?}: row {row}: time {time_s} s is not after {before_s} s (time must be strictly increasing)"
    )]
    TimeNotIncreasing {
        run: String,
        row: usize,
        time_s: f64,
        before_s: f64,
    },
    #[error("run {run:?}: column {column} has {rows} rows, time has {expected}")]
    ColumnLength {
        run: String,
        column: &'static str,
        rows: usize,
        expected: usize,
    },
    #[error("run {run:?}: no {needed} in the data")]
    Missing { run: String, needed: &'static str },
    #[error("run {run:?}: {rows} usable rows, at least {needed} are needed")]
    TooShort {
        run: String,
        rows: usize,
        needed: usize,
    },
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
    /// Rows that were torn or unreadable and left out.
    pub rows_dropped: usize,
    /// Where fit and hold-out come from, what was derived and how: sentences for the reader.
    pub notes: Vec<String>,
}

impl Run {
    /// A run with a time axis and no columns yet.
    pub fn new(name: impl Into<String>, time_s: Vec<f64>) -> Result<Self, RunError> {
        let name = name.into();
        for (row, pair) in time_s.windows(2).enumerate() {
            // A comparison that is false for NaN as well.
            if !matches!(
                pair[1].partial_cmp(&pair[0]),
                Some(std::cmp::Ordering::Greater)
            ) {
                return Err(RunError::TimeNotIncreasing {
                    run: name,
                    row: row + 1,
                    time_s: pair[1],
                    before_s: pair[0],
                });
            }
        }
        Ok(Self {
            name,
            time_s,
            ..Self::default()
        })
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
        self.columns[channel.index()] = Some(values);
        self.origins[channel.index()] = origin;
        Ok(())
    }

    pub fn time_s(&self) -> &[f64] {
        &self.time_s
    }

    pub fn rows(&self) -> usize {
        self.time_s.len()
    }

    /// The column, NaN where a cell is missing; `None` when it holds nothing at all.
    pub fn column(&self, channel: Channel) -> Option<&[f64]> {
        self.columns[channel.index()].as_deref()
    }

    pub fn origin(&self, channel: Channel) -> Origin {
        self.origins[channel.index()]
    }

    /// `(time, value)` of the cells that are there.
    pub fn points(&self, channel: Channel) -> impl Iterator<Item = (f64, f64)> + '_ {
        let values = self.column(channel).unwrap_or_default();
        self.time_s
            .iter()
            .copied()
            .zip(values.iter().copied())
            .filter(|(_, value)| value.is_finite())
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
            sample
        })
    }

    /// Rows `from..to` as a run of their own; the last command before `from` is carried onto the first row, because it
    /// still holds there.
    #[must_use]
    pub fn slice(&self, from: usize, to: usize, name: impl Into<String>) -> Self {
        let mut part = Self {
            name: name.into(),
            time_s: self.time_s[from..to].to_vec(),
            origins: self.origins,
            notes: self.notes.clone(),
            ..Self::default()
        };
        for channel in Channel::ALL {
            let Some(values) = self.column(channel) else {
                continue;
            };
            let mut cells = values[from..to].to_vec();
            let held = channel.is_commanded() && cells.first().is_some_and(|first| first.is_nan());
            if held && let Some(last) = values[..from].iter().rev().find(|value| value.is_finite())
            {
                cells[0] = *last;
            }
            part.columns[channel.index()] = Some(cells);
        }
        part
    }

    /// Median distance between rows that carry a measurement of `channel`, s.
    pub fn period_s(&self, channel: Channel) -> Option<f64> {
        let times: Vec<f64> = self.points(channel).map(|(time, _)| time).collect();
        let mut gaps: Vec<f64> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
        if gaps.is_empty() {
            return None;
        }
        gaps.sort_by(f64::total_cmp);
        Some(gaps[gaps.len() / 2])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run() -> Run {
        let mut run = Run::new("r", vec![0.0, 0.1, 0.25, 0.3]).unwrap();
        run.set_column(
            Channel::VoltageCmd,
            vec![1.0, f64::NAN, f64::NAN, 2.0],
            Origin::Commanded,
        )
        .unwrap();
        run.set_column(
            Channel::Current,
            vec![f64::NAN, 0.5, 0.6, 0.7],
            Origin::Measured,
        )
        .unwrap();
        run
    }

    #[test]
    fn time_must_increase_and_nan_is_not_a_time() {
        assert!(matches!(
            Run::new("r", vec![0.0, 0.0]),
            Err(RunError::TimeNotIncreasing { row: 1, .. })
        ));
        assert!(Run::new("r", vec![0.0, f64::NAN]).is_err());
        assert!(Run::new("r", vec![]).is_ok());
    }

    #[test]
    fn a_slice_carries_the_command_that_still_holds() {
        let part = run().slice(2, 4, "tail");
        assert_eq!(part.column(Channel::VoltageCmd).unwrap(), &[1.0, 2.0]);
        assert_eq!(part.column(Channel::Current).unwrap(), &[0.6, 0.7]);
    }

    #[test]
    fn samples_carry_the_cells_that_are_there() {
        let samples: Vec<Sample> = run().samples().collect();
        assert_eq!(samples.len(), 4);
        assert_eq!(samples[0].get(Channel::VoltageCmd), Some(1.0));
        assert_eq!(samples[0].get(Channel::Current), None);
        assert_eq!(samples[1].get(Channel::VoltageCmd), None);
        assert_eq!(
            samples[3],
            Sample::at(0.3)
                .with(Channel::VoltageCmd, 2.0)
                .with(Channel::Current, 0.7)
        );
    }

    #[test]
    fn points_leave_missing_cells_out() {
        assert_eq!(run().points(Channel::Current).count(), 3);
        assert!((run().period_s(Channel::Current).unwrap() - 0.15).abs() < 1e-12);
    }
}
