//! Scenario, what a simulation needs of a run: the input as applied, the instants at which something was measured, the angle.

use std::borrow::Cow;
use std::ops::Range;

use thiserror::Error;

use super::limited::{LimitReached, applied};
use super::shaft_angle::continuous;
use super::unknown_input::{self, Told, UnknownInput};
use crate::numerics::count::whole;
use crate::numerics::statistics::median;
use crate::sample::{Channel, Origin, Run};
use crate::signal;

/// What drives the model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Input {
    /// Voltage, held from each event to the next.
    Voltage,
    /// Current as measured: only the torque balance is simulated.
    Current,
    /// Torque as given: only the torque balance is simulated, with a torque constant of one.
    Torque,
}

#[derive(Clone, Debug, Error, PartialEq)]
pub enum ScenarioError {
    #[error("run {run:?} has no voltage, and neither current nor torque in its place")]
    NoInput { run: String },
    #[error("run {run:?} has neither current nor speed beside its {input}")]
    NoOutput { run: String, input: &'static str },
    #[error(
        "run {run:?}: {gap_s} s pass between two samples near {time_s} s (the median is {median_s} s, at most {allowed_s} s are allowed)"
    )]
    Gap {
        run: String,
        gap_s: f64,
        time_s: f64,
        median_s: f64,
        allowed_s: f64,
    },
    #[error("run {run:?} has {rows} usable rows, at least {needed} are needed")]
    TooShort {
        run: String,
        rows: usize,
        needed: usize,
    },
}

impl ScenarioError {
    pub const fn help(&self) -> &'static str {
        match self {
            Self::NoInput { .. } => {
                "map a column with --map voltage_v=HEADER (or torque_n_m=HEADER)"
            }
            Self::NoOutput { .. } => {
                "map a column with --map speed_rad_s=HEADER or current_a=HEADER (or angle_rad=HEADER)"
            }
            Self::Gap { .. } => {
                "is the time column in seconds? --map time_s=HEADER*0.001 converts milliseconds; cut a pause out of the file"
            }
            Self::TooShort { .. } => "record a longer run, or check the time column",
        }
    }
}

/// A run prepared for simulation and comparison. Times are those of the run's stamps.
#[derive(Clone, Debug)]
pub struct Scenario {
    pub name: String,
    pub input: Input,
    /// Which column served as input.
    pub input_channel: Channel,
    /// `(time, value)`, held until the next; strictly increasing.
    pub events: Vec<(f64, f64)>,
    pub sample_time_s: Vec<f64>,
    /// Measured current at the sample times, NaN where missing.
    pub current_a: Vec<f64>,
    /// Measured speed at the sample times, NaN where missing.
    pub speed_rad_s: Vec<f64>,
    /// Measured angle `(time, angle)`, continuous over turns; an exogenous input of effects of position. Empty: the speed is integrated.
    pub angle: Vec<(f64, f64)>,
    /// Half-widths of the stamps of the samples, s, zero where the drive stamped them itself. Empty: it stamped all.
    pub time_half_width_s: Vec<f64>,
    /// Where rows were lost that told the voltage, in order; `events` hold its estimate there. Empty in a whole record.
    pub unknown_input: Vec<UnknownInput>,
    /// Where the drive came to its current limit from afar, in order.
    pub limits: Vec<LimitReached>,
    /// The samples that count in residuals: all, or the tail where a run was split for validation.
    pub scored: Range<usize>,
}

/// Supply to which a sag is referred, V: in the model file and in the configuration of the emulator.
pub const REFERENCE_SUPPLY_V: f64 = 110.0;

/// Half-widths of a stamp within which a command of the same host was applied: its own exchange and the reading one.
const EXCHANGE: f64 = 2.0;
/// Share of a period that a write takes at least where the samples are stamped more sharply than the commands.
const WRITING: f64 = 0.1;
/// Longest time without a sample, s: a motor's transients are over long before.
const LONGEST_GAP_S: f64 = 60.0;
/// Time between runs that are put behind each other, s. What a run does is over by then, but for what a simulation begins
/// again with.
const AT_REST_S: f64 = 3.0;
/// Standard deviations of the mean of the first samples within which a run begins at rest.
const REST_SIGMAS: f64 = 4.0;
/// Rows below which nothing can be said about a motor.
const FEWEST_ROWS: usize = 20;

impl Scenario {
    /// An input and the instants to simulate at; nothing is measured.
    pub fn planned(
        name: impl Into<String>,
        input: Input,
        input_channel: Channel,
        events: Vec<(f64, f64)>,
        sample_time_s: Vec<f64>,
    ) -> Self {
        Self {
            name: name.into(),
            input,
            input_channel,
            events,
            scored: 0..sample_time_s.len(),
            sample_time_s,
            current_a: Vec::new(),
            speed_rad_s: Vec::new(),
            angle: Vec::new(),
            time_half_width_s: Vec::new(),
            unknown_input: Vec::new(),
            limits: Vec::new(),
        }
    }

    /// Prepares the voltage-driven simulation of `run`, or the mechanical one where there is no voltage.
    pub fn from_run(run: &Run) -> Result<Self, ScenarioError> {
        let (input, channel) = input_of(run).ok_or_else(|| ScenarioError::NoInput {
            run: run.name.clone(),
        })?;
        let mut events: Vec<(f64, f64)> = run.points(channel).collect();
        let mut limits = Vec::new();
        if channel == Channel::VoltageCmd {
            (events, limits) = applied(run, &events);
        }
        let start_s = events.first().map_or(f64::INFINITY, |first| first.0);
        let column = |channel| run.column(channel).unwrap_or_default();
        let is_measured = |row: usize| {
            let outputs = [Channel::Current, Channel::Speed].map(column);
            let mut cells = outputs.iter().filter_map(|output| output.get(row));
            cells.any(|cell| cell.is_finite())
        };
        if !(0..run.rows()).any(is_measured) {
            return Err(ScenarioError::NoOutput {
                run: run.name.clone(),
                input: channel.name(),
            });
        }
        let rows = run.time_s().iter().enumerate();
        let rows = rows.filter(|(row, time_s)| **time_s >= start_s && is_measured(*row));
        let rows: Vec<usize> = rows.map(|(row, _)| row).collect();
        if rows.len() < FEWEST_ROWS {
            return Err(ScenarioError::TooShort {
                run: run.name.clone(),
                rows: rows.len(),
                needed: FEWEST_ROWS,
            });
        }
        let cells = |of: &[f64], none: f64| -> Vec<f64> {
            let cell = |row: &usize| of.get(*row).copied().unwrap_or(none);
            rows.iter().map(cell).collect()
        };
        let times = cells(run.time_s(), f64::NAN);
        let speed: Vec<(f64, f64)> = run.points(Channel::Speed).collect();
        let half_width_s = |cell: f64| if cell.is_finite() { cell.abs() } else { 0.0 };
        let half_widths = run.column(Channel::TimeHalfWidth);
        let mut scenario = Self {
            current_a: cells(column(Channel::Current), f64::NAN),
            speed_rad_s: cells(column(Channel::Speed), f64::NAN),
            angle: continuous(run.points(Channel::Angle).collect(), &speed),
            time_half_width_s: half_widths.map_or_else(Vec::new, |widths| {
                let cells = cells(widths, 0.0).into_iter();
                cells.map(half_width_s).collect()
            }),
            limits,
            ..Self::planned(run.name.clone(), input, channel, events, times)
        };
        scenario.refuse_gaps()?;
        if input == Input::Voltage {
            scenario.bridge_lost_rows();
        }
        Ok(scenario)
    }

    /// Finds where the voltage is not known and puts its estimate there. What was measured in a long hole, and what a
    /// simulation begins again with behind it, is no longer there to be met.
    fn bridge_lost_rows(&mut self) {
        let times = &self.sample_time_s;
        let steps: Vec<f64> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
        let mut sample = 0;
        let measured: Vec<[f64; 2]> = (self.events.iter())
            .map(|(time_s, _)| {
                while sample < times.len() && times[sample] < *time_s {
                    sample += 1;
                }
                // Rows are the same where their stamps are, to the bit.
                let own = times.get(sample).is_some_and(|time| time <= time_s);
                if own {
                    [self.current_a[sample], self.speed_rad_s[sample]]
                } else {
                    [f64::NAN; 2]
                }
            })
            .collect();
        let holes = unknown_input::find(&Told {
            input: &self.events,
            measured: &measured,
            sample_period_s: median(&steps),
        });
        if holes.is_empty() {
            return;
        }
        self.events
            .extend(holes.iter().flat_map(UnknownInput::steps));
        self.events.sort_by(|a, b| a.0.total_cmp(&b.0));
        for hole in holes.iter().filter(|hole| hole.restart.is_some()) {
            let times = &self.sample_time_s;
            let begin = times.partition_point(|time| *time < hole.from_s);
            let end = times.partition_point(|time| *time <= hole.to_s);
            self.current_a[begin..end].fill(f64::NAN);
            self.speed_rad_s[begin..end].fill(f64::NAN);
        }
        self.unknown_input = holes;
    }

    /// A stamp far from its neighbours, or a time column in another unit, would be simulated step by step for ever.
    fn refuse_gaps(&self) -> Result<(), ScenarioError> {
        let times = self.sample_time_s.windows(2);
        let mut gaps: Vec<f64> = times.map(|pair| pair[1] - pair[0]).collect();
        let Some(at) = gaps.iter().position(|gap| *gap > LONGEST_GAP_S) else {
            return Ok(());
        };
        let gap_s = gaps[at];
        gaps.sort_by(f64::total_cmp);
        Err(ScenarioError::Gap {
            run: self.name.clone(),
            gap_s,
            time_s: self.sample_time_s[at],
            median_s: gaps[gaps.len() / 2],
            allowed_s: LONGEST_GAP_S,
        })
    }

    /// Half of the interval in which a sample may have been taken, s; zero where the drive stamped it itself.
    pub fn half_width_s(&self, sample: usize) -> f64 {
        self.time_half_width_s.get(sample).copied().unwrap_or(0.0)
    }

    /// Half-width that half of the stamps have at least, s; `None` where the drive stamped its samples itself.
    pub fn typical_half_width_s(&self) -> Option<f64> {
        let mut present = self.time_half_width_s.clone();
        present.retain(|half_width_s| *half_width_s > 0.0);
        present.sort_by(f64::total_cmp);
        present.get(present.len() / 2).copied()
    }

    /// Mean and standard deviation of the time, s, by which the input reached the motor later than its stamps say; `None`
    /// where the drive itself stamped it. A command of the host was applied some time within its exchange; a voltage
    /// that was sampled changed some time between two samples.
    pub fn input_delay_s(&self) -> Option<(f64, f64)> {
        let half_width_s = self.typical_half_width_s()?;
        let length_s = self.sample_time_s.last()? - self.sample_time_s.first()?;
        let period_s = length_s / (self.samples() - 1) as f64;
        match (self.input, self.input_channel) {
            (Input::Voltage, Channel::VoltageCmd) => {
                let own_s = EXCHANGE * half_width_s;
                Some((0.0, own_s.max(WRITING * period_s)))
            }
            (Input::Voltage, _) => Some((-0.5 * period_s, 0.5 * period_s)),
            _ => None,
        }
    }

    /// The same with every change of the input later by `delay_s`; what held first holds from the same instant.
    #[must_use]
    pub fn with_input_delayed(&self, delay_s: f64) -> Self {
        let mut delayed = self.clone();
        let mut last_s = self.begin_s();
        for event in delayed.events.iter_mut().skip(1) {
            event.0 = (event.0 + delay_s).max(last_s.next_up());
            last_s = event.0;
        }
        delayed
    }

    /// When the first input came: the simulation starts there.
    pub fn begin_s(&self) -> f64 {
        self.events[0].0
    }

    /// Input that holds at `time_s`.
    pub fn input_at(&self, time_s: f64) -> f64 {
        signal::held(&self.events, time_s).unwrap_or(self.events[0].1)
    }

    /// Full voltage of the supply that effects of the duty refer to. A run does not tell it, and what one run happened
    /// to reach would give the same machine another number in the next: a fixed reference.
    /// Zero where the run is not driven by a voltage.
    pub fn supply_v(&self) -> f64 {
        if self.input == Input::Voltage {
            REFERENCE_SUPPLY_V
        } else {
            0.0
        }
    }

    /// Angle of the shaft `(time, angle)`: the measured one, else the integral of the measured speed, which starts
    /// anywhere and drifts. Never the simulated one, whose phase is lost within seconds.
    pub fn shaft_angle(&self) -> Cow<'_, [(f64, f64)]> {
        if !self.angle.is_empty() {
            return Cow::Borrowed(&self.angle);
        }
        let mut points: Vec<(f64, f64)> = Vec::with_capacity(self.samples());
        let (mut angle_rad, mut last) = (0.0, None);
        for (&time_s, &speed_rad_s) in self.sample_time_s.iter().zip(&self.speed_rad_s) {
            if !speed_rad_s.is_finite() {
                continue;
            }
            if let Some((before_s, before_rad_s)) = last {
                angle_rad += 0.5 * (speed_rad_s + before_rad_s) * (time_s - before_s);
            }
            points.push((time_s, angle_rad));
            last = Some((time_s, speed_rad_s));
        }
        Cow::Owned(points)
    }

    pub fn samples(&self) -> usize {
        self.sample_time_s.len()
    }

    /// Mean time between two samples.
    pub fn mean_period_s(&self) -> f64 {
        let (times, last) = (&self.sample_time_s, self.samples() - 1);
        (times[last] - times[0]) / last as f64
    }

    /// The first part and the whole with only its last part scored: a split of one run into training and hold-out.
    /// The hold-out is simulated from the start, so that no state has to be guessed in the middle.
    pub fn split(&self, training_share: f64) -> (Self, Self) {
        let cut = whole((self.samples() as f64 * training_share).round());
        let (mut training, mut holdout) = (self.clone(), self.clone());
        let share = 100.0 * training_share;
        training.name = format!("{} (first {share:.0} %)", self.name);
        for column in [
            &mut training.sample_time_s,
            &mut training.current_a,
            &mut training.speed_rad_s,
            &mut training.time_half_width_s,
        ] {
            column.truncate(cut);
        }
        training.scored = 0..cut;
        let share = 100.0 * (1.0 - training_share);
        holdout.name = format!("{} (last {share:.0} %)", self.name);
        holdout.scored = cut..self.samples();
        (training, holdout)
    }

    /// Samples of a run that has not begun to move at the first of them, which are all of it; its name tells which part it is.
    #[must_use]
    pub fn stretch(&self, samples: Range<usize>) -> Self {
        let times = &self.sample_time_s[samples.clone()];
        let (begin_s, end_s) = (times[0], times[times.len() - 1]);
        // A whole beginning keeps what was commanded before its first sample.
        let begin = if samples.start == 0 {
            0
        } else {
            let before = self.events.partition_point(|event| event.0 <= begin_s);
            before.saturating_sub(1)
        };
        let end = self.events.partition_point(|event| event.0 <= end_s);
        let mut events = self.events[begin..end.max(begin + 1)].to_vec();
        if samples.start > 0 {
            events[0].0 = events[0].0.max(begin_s);
        }
        let from = self.angle.partition_point(|point| point.0 < events[0].0);
        let to = self.angle.partition_point(|point| point.0 <= end_s);
        let mut unknown_input = self.unknown_input.clone();
        unknown_input.retain(|hole| hole.from_s >= events[0].0 && hole.to_s <= end_s);
        let mut limits = self.limits.clone();
        limits.retain(|limit| limit.from_s >= events[0].0 && limit.to_s <= end_s);
        let part = |values: &Vec<f64>| values.get(samples.clone()).unwrap_or_default().to_vec();
        let [from_s, to_s] = [begin_s, end_s].map(|time_s| time_s - self.sample_time_s[0]);
        let name = format!("{} ({from_s:.0} to {to_s:.0} s)", self.name);
        let (input, channel, times) = (self.input, self.input_channel, part(&self.sample_time_s));
        Self {
            angle: self.angle[from..to.max(from)].to_vec(),
            current_a: part(&self.current_a),
            speed_rad_s: part(&self.speed_rad_s),
            time_half_width_s: part(&self.time_half_width_s),
            unknown_input,
            limits,
            ..Self::planned(name, input, channel, events, times)
        }
    }

    /// When the shaft turns first, s: a little torque may keep it turning.
    fn turns_from_s(&self) -> f64 {
        let sizes = self.speed_rad_s.iter().map(|speed| speed.abs());
        let fastest = sizes.clone().fold(0.0, f64::max);
        let first = sizes
            .into_iter()
            .position(|size| size > NEARLY_ZERO_MEASURED * fastest);
        first.map_or(f64::INFINITY, |sample| self.sample_time_s[sample])
    }

    /// This run and behind it a later one of the same machine as one record. Between them the input is zero; a simulation
    /// does not go through that time but begins again with what the later run begins with. What comes behind this run's last
    /// sample, which is held out, is no part of it.
    #[must_use]
    pub fn followed_by(&self, later: &Self) -> Self {
        let shift_s = self.whole_s() + self.begin_s() - later.begin_s();
        let there = |time_s: f64| time_s + shift_s;
        let points = |points: &[(f64, f64)]| -> Vec<(f64, f64)> {
            let points = points.iter();
            points
                .map(|(time_s, value)| (there(*time_s), *value))
                .collect()
        };
        let joined = |a: &[f64], b: &[f64]| [a, b].concat();
        let begins_s = there(later.begin_s());
        let ended_s = begins_s - AT_REST_S;
        let own = |points: &[(f64, f64)]| -> Vec<(f64, f64)> {
            let own = points.iter().filter(|point| point.0 < ended_s);
            own.copied().collect()
        };
        let mut events = own(&self.events);
        events.push((ended_s, 0.0));
        events.extend(points(&later.events));
        // Without the angle of one of them nobody knows where the shaft was.
        let angle = if self.angle.is_empty() || later.angle.is_empty() {
            Vec::new()
        } else {
            [own(&self.angle), points(&later.angle)].concat()
        };
        let is_sharp = self.time_half_width_s.is_empty() && later.time_half_width_s.is_empty();
        let widths = |run: &Self| -> Vec<f64> {
            let samples = 0..run.samples();
            samples.map(|sample| run.half_width_s(sample)).collect()
        };
        // Of a hole that reaches beyond the end only what lies before it.
        let holes = self.unknown_input.iter();
        let holes = holes.filter(|hole| hole.from_s < ended_s);
        let mut unknown_input: Vec<UnknownInput> = holes
            .map(|hole| UnknownInput {
                to_s: hole.to_s.min(ended_s),
                restart: hole.restart.filter(|_| hole.to_s < ended_s),
                ..*hole
            })
            .collect();
        let begins_with = later.begins_with();
        unknown_input.push(UnknownInput::between_runs(ended_s, begins_s, begins_with));
        unknown_input.extend(later.unknown_input.iter().map(|hole| UnknownInput {
            from_s: there(hole.from_s),
            to_s: there(hole.to_s),
            ..*hole
        }));
        let limits = self.limits.iter().copied();
        let mut limits: Vec<LimitReached> = limits.filter(|limit| limit.to_s < ended_s).collect();
        limits.extend(later.limits.iter().map(|limit| LimitReached {
            from_s: there(limit.from_s),
            to_s: there(limit.to_s),
            ..*limit
        }));
        let times: Vec<f64> = later.sample_time_s.iter().copied().map(there).collect();
        Self {
            angle,
            limits,
            current_a: joined(&self.current_a, &later.current_a),
            speed_rad_s: joined(&self.speed_rad_s, &later.speed_rad_s),
            time_half_width_s: if is_sharp {
                Vec::new()
            } else {
                joined(&widths(self), &widths(later))
            },
            unknown_input,
            ..Self::planned(
                format!("{} and {}", self.name, later.name),
                self.input,
                self.input_channel,
                events,
                joined(&self.sample_time_s, &times),
            )
        }
    }

    /// Current and speed that a run begins with: zero where its first samples do not differ from it by more than their
    /// noise, else the first ones measured; not a number where missing.
    pub fn begins_with(&self) -> [f64; 2] {
        let at_rest = self.leading_standstill();
        let begin = |values: &[f64]| {
            let first = values.iter().copied().find(|value| value.is_finite());
            let rest = values.get(at_rest.clone()).unwrap_or_default().iter();
            let rest = rest.copied().filter(|value| value.is_finite());
            let rest: Vec<f64> = rest.take(FEWEST_ROWS).collect();
            let count = rest.len() as f64;
            let mean = rest.iter().sum::<f64>() / count;
            let squares: f64 = rest.iter().map(|value| (value - mean).powi(2)).sum();
            let rests = rest.len() == FEWEST_ROWS
                && mean.abs() <= REST_SIGMAS * (squares / (count - 1.0) / count).sqrt();
            if rests {
                0.0
            } else {
                first.unwrap_or(f64::NAN)
            }
        };
        [begin(&self.current_a), begin(&self.speed_rad_s)]
    }

    /// From the run's first input to that of a run that is put behind it, s.
    pub fn whole_s(&self) -> f64 {
        let last_s = self.sample_time_s[self.samples() - 1];
        last_s + self.mean_period_s() - self.begin_s() + AT_REST_S
    }

    /// Samples of the leading standstill: the input is still zero, but for a hair beside what comes later. The first
    /// instants of a bumpless start, which takes over what the sensor of the voltage showed, do not belong to it.
    pub fn leading_standstill(&self) -> Range<usize> {
        let sizes = self.events.iter().map(|event| event.1.abs());
        let largest = sizes.fold(0.0, f64::max);
        let nearly_zero = if self.input == Input::Voltage {
            NEARLY_ZERO
        } else {
            NEARLY_ZERO_MEASURED
        };
        let moves = |event: &&(f64, f64)| event.1.abs() > nearly_zero * largest;
        let taken_over = self.events.iter().take_while(moves).count();
        let is_small = |event: &(f64, f64)| event.1.abs() <= BUMPLESS_SHARE * largest;
        let bumpless =
            taken_over <= BUMPLESS_EVENTS && self.events[..taken_over].iter().all(is_small);
        let (begin, begin_s) = match self.events.get(taken_over) {
            Some(event) if bumpless => (taken_over, event.0),
            _ => (0, f64::NEG_INFINITY),
        };
        let moved = self.events[begin..].iter().find(moves);
        let mut moved_s = moved.map_or(f64::INFINITY, |event| event.0);
        if self.input != Input::Voltage {
            moved_s = moved_s.min(self.turns_from_s());
        }
        let sample = |limit_s: f64| self.sample_time_s.partition_point(|time| *time < limit_s);
        sample(begin_s)..sample(moved_s)
    }
}

/// Commands, and their largest share of the largest input, that a bumpless start takes to come to zero.
const BUMPLESS_EVENTS: usize = 2;
const BUMPLESS_SHARE: f64 = 0.05;

/// Share of the largest input that moves nothing: what a bumpless start leaves behind.
const NEARLY_ZERO: f64 = 0.002;
/// The same of a torque or a current, which is measured with noise.
const NEARLY_ZERO_MEASURED: f64 = 0.05;

/// The column that drives the model. A commanded voltage with the instants at which it was applied tells when the
/// voltage changed; a measured one only what it was at the sample, so it serves where there is no command.
fn input_of(run: &Run) -> Option<(Input, Channel)> {
    let has = |channel| run.points(channel).next().is_some();
    let stamped = run.origin(Channel::VoltageCmd) == Origin::Commanded && has(Channel::VoltageCmd);
    let is_sampled = stamped && run.origin(Channel::Voltage) == Origin::Measured;
    let mut inputs = [
        (Input::Voltage, Channel::Voltage, !is_sampled),
        (Input::Voltage, Channel::VoltageCmd, true),
        (Input::Torque, Channel::Torque, true),
        (Input::Current, Channel::Current, true),
    ]
    .into_iter();
    let (input, channel, _) = inputs.find(|(_, channel, serves)| *serves && has(*channel))?;
    Some((input, channel))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plant::testing::run_of;

    fn run(origin: Origin) -> Run {
        let times = (0..40).map(|row| f64::from(row) * 0.01).collect();
        let columns = [
            (Channel::VoltageCmd, vec![2.0; 40], origin),
            (Channel::Voltage, vec![1.9; 40], Origin::Measured),
            (Channel::Speed, vec![0.0; 40], Origin::Measured),
        ];
        run_of("r", times, columns)
    }

    #[test]
    fn a_stamped_command_beats_an_instantaneous_measurement() {
        for (origin, channel) in [
            (Origin::Commanded, Channel::VoltageCmd),
            (Origin::Unknown, Channel::Voltage),
        ] {
            let scenario = Scenario::from_run(&run(origin)).unwrap();
            assert_eq!(scenario.input_channel, channel);
        }
    }

    #[test]
    fn rows_before_the_first_voltage_are_not_used() {
        let mut late = run(Origin::Commanded);
        let mut cells = vec![f64::NAN; 40];
        cells[15] = 3.0;
        late.set_column(Channel::VoltageCmd, cells, Origin::Commanded)
            .unwrap();
        let scenario = Scenario::from_run(&late).unwrap();
        assert_eq!(scenario.samples(), 25);
        assert_eq!(scenario.events, vec![(0.15, 3.0)]);
    }

    #[test]
    fn a_split_scores_the_tail_but_starts_at_the_beginning() {
        let whole = Scenario::from_run(&run(Origin::Commanded)).unwrap();
        let (training, holdout) = whole.split(0.6);
        assert_eq!((training.samples(), training.scored), (24, 0..24));
        assert_eq!((holdout.samples(), holdout.scored), (40, 24..40));
    }

    #[test]
    fn milliseconds_taken_for_seconds_and_a_stamp_far_away_are_named() {
        let seconds: Vec<f64> = (0..39).map(f64::from).collect();
        let milliseconds = (0..40).map(|k| f64::from(k) * 1000.0).collect();
        for times in [milliseconds, [&seconds[..], &[1e12]].concat()] {
            let channels = [Channel::Voltage, Channel::Speed];
            let columns = channels.map(|channel| (channel, vec![1.0; 40], Origin::Unknown));
            let refused = Scenario::from_run(&run_of("r", times, columns));
            assert!(matches!(refused, Err(ScenarioError::Gap { .. })));
        }
    }

    #[test]
    fn what_a_host_stamped_has_a_delay_that_is_not_known_and_what_a_drive_stamped_has_none() {
        let drive = run(Origin::Commanded);
        assert_eq!(Scenario::from_run(&drive).unwrap().input_delay_s(), None);
        let mut host = drive;
        host.set_column(Channel::TimeHalfWidth, vec![0.002; 40], Origin::Derived)
            .unwrap();
        let commanded = Scenario::from_run(&host).unwrap();
        assert_eq!(commanded.time_half_width_s.len(), commanded.samples());
        assert_eq!(commanded.input_delay_s(), Some((0.0, 0.004)));
        let sampled = Scenario::from_run(&host.without(Channel::VoltageCmd)).unwrap();
        let (mean_s, std_s) = sampled.input_delay_s().unwrap();
        assert!((mean_s + 0.005).abs() < 1e-9 && (std_s - 0.005).abs() < 1e-9);
        let later = commanded.with_input_delayed(0.0005);
        let (before, after) = (&commanded.events, &later.events);
        assert_eq!(after[0], before[0], "what held first holds on");
        assert!((after[1].0 - before[1].0 - 0.0005).abs() < 1e-12);
    }

    #[test]
    fn an_angle_within_one_turn_is_made_continuous() {
        let mut wrapped = run(Origin::Commanded);
        let turns = |k: u16| 0.2 * f64::from(k);
        let cells = (0..40)
            .map(|k| turns(k).fract() * std::f64::consts::TAU)
            .collect();
        wrapped
            .set_column(Channel::Angle, cells, Origin::Measured)
            .unwrap();
        let angle = Scenario::from_run(&wrapped).unwrap();
        let angle = angle.shaft_angle();
        assert!((angle[39].1 - turns(39) * std::f64::consts::TAU).abs() < 1e-9);
    }

    #[test]
    fn too_few_rows_and_no_input_are_named() {
        let error = |run: &Run| Scenario::from_run(run).unwrap_err();
        let columns = [Channel::Voltage, Channel::Current]
            .map(|channel| (channel, vec![1.0; 5], Origin::Unknown));
        let short = error(&run_of("short", (0..5).map(f64::from).collect(), columns));
        assert!(matches!(short, ScenarioError::TooShort { rows: 5, .. }));
        let empty = error(&Run::new("empty", vec![]).unwrap());
        assert!(matches!(empty, ScenarioError::NoInput { .. }));
    }

    /// A switched voltage at 1 kHz of which a row and 0.2 s are lost.
    fn with_holes() -> Scenario {
        let is_lost = |row: &usize| *row == 500 || (1200..1400).contains(row);
        let rows: Vec<usize> = (0..2000).filter(|row| !is_lost(row)).collect();
        let cells = |value: fn(usize) -> f64| rows.iter().map(|row| value(*row)).collect();
        let volts = |row: usize| {
            let is_up = (row / 7 * row / 7).is_multiple_of(3);
            if is_up { 5.0 } else { -5.0 }
        };
        let columns = [
            (Channel::Voltage, cells(volts), Origin::Unknown),
            (Channel::Speed, cells(|row| row as f64), Origin::Measured),
        ];
        let times = cells(|row| 1e-3 * row as f64);
        Scenario::from_run(&run_of("r", times, columns)).unwrap()
    }

    #[test]
    fn lost_rows_have_a_variance_and_a_whole_record_none() {
        let is_unknown = |record: &Scenario, from_s: f64, to_s: f64| {
            let mut holes = record.unknown_input.iter();
            holes.any(|hole| hole.to_s > from_s && hole.from_s < to_s && hole.variance > 0.0)
        };
        let holes = with_holes();
        assert_eq!(holes.unknown_input.len(), 2);
        let long = holes.unknown_input[1];
        assert!((1.1999..1.25).contains(&long.from_s) && long.variance > 0.0);
        assert!(is_unknown(&holes, 1.15, 1.25) && !is_unknown(&holes, 0.6, 1.1999));
        assert!((holes.input_at(1.3) - long.mean).abs() < 1e-12);
        let whole = Scenario::from_run(&run(Origin::Unknown)).unwrap();
        assert!(whole.unknown_input.is_empty() && !is_unknown(&whole, 0.0, 1.0));
        assert_eq!(whole.events.len(), 40);
    }

    #[test]
    fn a_run_behind_another_is_simulated_as_it_is_by_itself() {
        let values = [1.1, 0.0099, 0.3538, 0.0045, 0.455];
        let model = crate::plant::Model::baseline(crate::plant::testing::motor("m", &values));
        let run = |volts: f64, seed| {
            let events = vec![(0.0, 0.0), (0.3, volts), (0.9, -0.5 * volts)];
            crate::plant::testing::record(&model, events, 0.01, 2.0, seed)
        };
        let (first, second) = (run(40.0, 1), run(60.0, 2));
        let both = first.followed_by(&second);
        assert_eq!(both.samples(), first.samples() + second.samples());
        let simulated = |run: &Scenario| {
            let mut plant = crate::plant::Plant::new(&model, Input::Voltage).unwrap();
            plant
                .simulate(run, crate::plant::State::default())
                .speed_rad_s
        };
        let (whole, alone) = (simulated(&both), simulated(&second));
        for (a, b) in whole[first.samples()..].iter().zip(&alone) {
            assert!((a - b).abs() < 1e-6, "{a} {b}");
        }
        let from_s = both.sample_time_s[first.samples()] - first.begin_s();
        assert!((from_s - first.whole_s() - second.sample_time_s[0]).abs() < 1e-9);
    }

    #[test]
    fn what_is_held_out_of_a_run_is_no_part_of_it_where_another_comes_behind() {
        let mut first = with_holes();
        let times = first.sample_time_s.iter();
        first.angle = times.map(|time_s| (*time_s, 3.0 * time_s)).collect();
        let (training, _) = first.split(0.5);
        let end_s = training.sample_time_s[training.samples() - 1];
        assert!(first.unknown_input[1].restart.is_some() && first.unknown_input[1].to_s > end_s);
        let both = training.followed_by(&first);
        for times in [
            both.events.iter().map(|own| own.0).collect::<Vec<f64>>(),
            both.angle.iter().map(|own| own.0).collect(),
            both.sample_time_s.clone(),
            both.unknown_input.iter().map(|own| own.from_s).collect(),
        ] {
            assert!(times.windows(2).all(|pair| pair[1] > pair[0]), "{times:?}");
        }
        // The hole before the end, the time between the runs, and the holes of the run behind it.
        assert_eq!(both.unknown_input.len(), 4);
        let between = &both.unknown_input[1];
        assert!(between.variance.abs() < 1e-12 && between.restart.is_some());
        let begins_s = both.sample_time_s[training.samples()];
        assert!((between.to_s - begins_s).abs() < 1e-9 && between.from_s >= end_s);
        let inside = |time_s: f64| (between.from_s..begins_s).contains(&time_s);
        assert!(!both.angle.iter().any(|point| inside(point.0)));
    }

    #[test]
    fn a_run_that_begins_in_motion_is_simulated_from_what_it_begins_with() {
        let values = [1.1, 0.0099, 0.3538, 0.3, 0.455];
        let model = crate::plant::Model::baseline(crate::plant::testing::motor("m", &values));
        let run = |seed| {
            let events = vec![(0.0, 0.0), (0.3, 60.0), (0.9, 40.0)];
            crate::plant::testing::record(&model, events, 0.01, 3.0, seed)
        };
        // So heavy that it turns on for long after its end; the other is the end of a run.
        let (first, whole) = (run(1), run(2));
        let second = whole.stretch(120..whole.samples());
        assert_eq!(first.begins_with().map(f64::to_bits), [0, 0]);
        assert!(second.begins_with()[1] > 1.0);
        for (later, from) in [(&second, 120), (&whole, 0)] {
            let both = first.followed_by(later);
            let mut plant = crate::plant::Plant::new(&model, Input::Voltage).unwrap();
            let start = crate::plant::State::default();
            let simulated = plant.simulate(&both, start).speed_rad_s;
            let alone = plant.simulate(&whole, start).speed_rad_s;
            let pairs = simulated[first.samples()..].iter().zip(&alone[from..]);
            for (a, b) in pairs {
                assert!((a - b).abs() < 0.5, "{a} {b}");
            }
        }
    }

    #[test]
    fn what_a_simulation_begins_again_with_is_not_met_by_it() {
        let holes = with_holes();
        let restart = holes.unknown_input[1].restart.unwrap();
        assert!(restart[0].is_nan() && (restart[1] - 1400.0).abs() < 1e-9);
        let missing = holes.speed_rad_s.iter().filter(|speed| speed.is_nan());
        assert_eq!(missing.count(), 1);
    }
}
