//! Scenario: the part of a run that a simulation needs, which is the input as applied, the instants of the measurements and
//! the angle.

use std::borrow::Cow;
use std::ops::Range;

use thiserror::Error;

use super::commanded_current;
use super::late_rows;
use super::limited::{LimitReached, applied};
use super::restored_speed;
use super::run_scales::RunScales;
use super::sampled_edges;
use super::sampled_torque;
use super::shaft_angle::continuous;
use super::unconfirmed;
use super::unknown_input::{self, Rows, UnknownInput};
use crate::numerics::count::whole;
use crate::numerics::statistics::{mean, mean_step, median_step, variance};
use crate::sample::{Channel, Origin, Run, Sensors};
use crate::signal::{self, Point};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Input {
    /// Voltage, held from each event to the next.
    Voltage,
    /// Current, as commanded or as measured: only the torque balance is simulated.
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
    Gap { run: String, gap_s: f64, time_s: f64, median_s: f64, allowed_s: f64 },
    #[error("run {run:?} has {rows} usable rows, at least {needed} are needed")]
    TooShort { run: String, rows: usize, needed: usize },
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
    /// Names of the runs that it is a part of, the recorded one first; empty for a whole run.
    pub part_of: Vec<String>,
    pub input: Input,
    pub input_channel: Channel,
    /// `(time, value)`, held until the next; strictly increasing.
    pub events: Vec<(f64, f64)>,
    pub sample_time_s: Vec<f64>,
    /// Measured current at the sample times, NaN where missing; of a commanded one its mean over half a period on either side.
    pub current_a: Vec<f64>,
    /// Measured voltage at the sample times of a run that a commanded current drives, NaN where missing; else empty.
    pub voltage_v: Vec<f64>,
    /// Instants at which a commanded current steps, in the input, and the ends of gaps in its speed; else empty.
    pub current_steps_s: Vec<f64>,
    /// By which the speed shows a change of the commanded current after its stamp, s: already in the inputs and in `voltage_v`.
    pub command_lag_s: f64,
    /// Measured speed at the sample times, NaN where missing.
    pub speed_rad_s: Vec<f64>,
    /// Measured angle `(time, angle)`, unwrapped; an exogenous input of effects of position. Empty: the speed is integrated.
    pub angle: Vec<(f64, f64)>,
    /// Half-widths of the stamps of the samples, s, zero for a stamp of the drive. Empty: all are stamps of the drive.
    pub time_half_width_s: Vec<f64>,
    pub sensors: Sensors,
    /// Standard deviation by the resolution of the sensor of a speed that was restored from behind a filter, rad/s; else zero.
    pub speed_rounding_rad_s: f64,
    /// Intervals in which rows with the voltage were lost, a sampled voltage changed or a command was not confirmed, in order; `events` have its
    /// estimate there. Empty in a whole record whose changes are at their stamps.
    pub unknown_input: Vec<UnknownInput>,
    /// Intervals in which the drive reached its current limit, in order.
    pub limits: Vec<LimitReached>,
    /// The samples of which residuals are computed: all, or the last part where a run was split for validation.
    pub scored: Range<usize>,
    /// Those of the reference where nothing was measured; a part of a run has those of the whole.
    pub scales: RunScales,
}

/// Supply to which a sag is referred, V: in the model file and in the configuration of the emulator.
pub const REFERENCE_SUPPLY_V: f64 = 110.0;

/// Time between concatenated runs, s. Any length serves: the simulation restarts after it.
const BETWEEN_RUNS_S: f64 = 3.0;
/// Fewest rows of a run, and the number of first samples by which a run is at rest at its beginning.
const FEWEST_ROWS: usize = 20;
/// Share of the largest measured torque, current or speed that counts as zero: sensor noise.
const NEARLY_ZERO_MEASURED: f64 = 0.05;

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
            part_of: Vec::new(),
            input,
            input_channel,
            events,
            scored: 0..sample_time_s.len(),
            sample_time_s,
            current_a: Vec::new(),
            voltage_v: Vec::new(),
            current_steps_s: Vec::new(),
            command_lag_s: 0.0,
            speed_rad_s: Vec::new(),
            angle: Vec::new(),
            time_half_width_s: Vec::new(),
            sensors: Sensors::default(),
            speed_rounding_rad_s: 0.0,
            unknown_input: Vec::new(),
            limits: Vec::new(),
            scales: RunScales::REFERENCE,
        }
    }

    /// Prepares the voltage-driven simulation of `run`, or the mechanical one where there is no voltage.
    pub fn from_run(run: &Run) -> Result<Self, ScenarioError> {
        let (input, channel) =
            input_of(run).ok_or_else(|| ScenarioError::NoInput { run: run.name.clone() })?;
        let by_voltage = input == Input::Voltage;
        let timely = if by_voltage { None } else { late_rows::left_out(run) };
        let run = timely.as_ref().unwrap_or(run);
        let restored = if by_voltage { None } else { restored_speed::restored(run) };
        let (run, speed_rounding_rad_s) =
            restored.as_ref().map_or((run, 0.0), |own| (&own.run, own.rounding_rad_s));
        let mut events: Vec<Point> = run.points(channel).collect();
        let (mut limits, mut steps_s, mut lag_s) = (Vec::new(), Vec::new(), 0.0);
        let mut unconfirmed = Vec::new();
        match channel {
            Channel::VoltageCmd => {
                (events, limits) = applied(run, &events);
                let found = unconfirmed::find(run, channel);
                for own in &found {
                    own.put_into(&mut events);
                }
                unconfirmed = found.into_iter().map(|own| own.interval).collect();
                events = ramped(&events, run.sensors().ramp_v_per_s);
            }
            Channel::CurrentCmd => {
                let steps = commanded_current::steps(&events);
                lag_s = commanded_current::lag_s(run, &steps);
                events = commanded_current::applied(run, &steps);
                events.iter_mut().skip(1).for_each(|event| event.0 += lag_s);
                steps_s = steps.iter().skip(1).map(|step| step.0 + lag_s).collect();
                steps_s.extend(restored.iter().flat_map(|own| &own.gaps_s));
                steps_s.sort_by(f64::total_cmp);
            }
            Channel::Torque => events = sampled_torque::applied(run, events),
            _ => {}
        }
        let start_s = events.first().map_or(f64::INFINITY, |first| first.0);
        let column = |channel| run.column(channel).unwrap_or_default();
        let is_measured = |row: usize| {
            let outputs = [Channel::Current, Channel::Speed].map(column);
            let mut cells = outputs.iter().filter_map(|output| output.get(row));
            cells.any(|cell| cell.is_finite())
        };
        if !(0..run.rows()).any(is_measured) {
            return Err(ScenarioError::NoOutput { run: run.name.clone(), input: channel.name() });
        }
        let is_usable = |row: &usize| run.time_s()[*row] >= start_s && is_measured(*row);
        let rows: Vec<usize> = (0..run.rows()).filter(is_usable).collect();
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
        let speed: Vec<Point> = run.points(Channel::Speed).collect();
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
            sensors: run.sensors(),
            speed_rounding_rad_s,
            ..Self::planned(run.name.clone(), input, channel, events, times)
        };
        if channel == Channel::CurrentCmd {
            scenario.current_a = scenario.held_means();
            (scenario.command_lag_s, scenario.current_steps_s) = (lag_s, steps_s);
            let volts: Vec<Point> = run.points(Channel::Voltage).collect();
            if !volts.is_empty() {
                // Up to one period of the lag may be that of the command; of that the speed shows half.
                let doubtful_s = scenario.doubtful_lag_s();
                let at = |time_s: &f64| signal::line(&volts, time_s - (lag_s - 0.5 * doubtful_s));
                scenario.voltage_v = scenario.sample_time_s.iter().map(at).collect();
            }
        }
        if run.sensors().averages_current && channel == Channel::VoltageCmd {
            scenario.leave_out_currents_over_reversals();
        }
        scenario.refuse_gaps()?;
        if input == Input::Voltage {
            let is_own = run.origin(channel) == Origin::Commanded || half_widths.is_some();
            scenario.bridge_unknown(unconfirmed, !is_own);
        }
        scenario.find_scales();
        Ok(scenario)
    }

    pub fn find_scales(&mut self) {
        self.scales = RunScales::of(self);
    }

    /// The part of the lag between commanded current and speed that may be that of the command, s: a current loop is quicker than a
    /// period.
    pub fn doubtful_lag_s(&self) -> f64 {
        let period_s = self.mean_period_s();
        self.command_lag_s.clamp(-period_s, period_s)
    }

    /// A mean without a sign has that of the voltage when it is read, which was another in a part of its interval.
    fn leave_out_currents_over_reversals(&mut self) {
        let mut from_s = self.begin_s();
        for (current, to_s) in self.current_a.iter_mut().zip(&self.sample_time_s) {
            let first = self.events.partition_point(|event| event.0 <= from_s).saturating_sub(1);
            let last = self.events.partition_point(|event| event.0 <= *to_s);
            let signs = self.events[first..last].iter().map(|event| event.1.signum());
            let is_one_way =
                signs.clone().all(|sign| sign > 0.0) || signs.clone().all(|sign| sign < 0.0);
            if !is_one_way && self.events[first..last].iter().any(|event| event.1 != 0.0) {
                *current = f64::NAN;
            }
            from_s = *to_s;
        }
    }

    /// Adds estimates of the voltage where it is unknown, and removes the measurements from which a simulation restarts after a long
    /// hole or an unconfirmed command; of a voltage that may be `sampled`, also of the instants of its changes.
    fn bridge_unknown(&mut self, unconfirmed: Vec<UnknownInput>, may_be_sampled: bool) {
        let times = &self.sample_time_s;
        let mut sample = 0;
        let measured: Vec<[f64; 2]> = (self.events.iter())
            .map(|(time_s, _)| {
                while sample < times.len() && times[sample] < *time_s {
                    sample += 1;
                }
                // Rows of voltage and sample are the same where their stamps are equal to the bit.
                let is_same = times.get(sample).is_some_and(|time| time <= time_s);
                if is_same {
                    [self.current_a[sample], self.speed_rad_s[sample]]
                } else {
                    [f64::NAN; 2]
                }
            })
            .collect();
        let rows =
            Rows { input: &self.events, measured: &measured, sample_period_s: median_step(times) };
        let mut holes = unknown_input::find(&rows);
        let edges = if may_be_sampled { sampled_edges::find(&rows) } else { Vec::new() };
        for edge in edges {
            self.events[edge.event].0 = edge.at_s;
            holes.push(edge.interval);
        }
        holes.extend(unconfirmed);
        holes.sort_by(|a, b| a.from_s.total_cmp(&b.from_s));
        if holes.is_empty() {
            return;
        }
        let lost = holes.iter().filter(|hole| hole.lost_rows > 0);
        self.events.extend(lost.flat_map(UnknownInput::steps));
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

    /// Refuses a stamp far from its neighbours, or a time column in another unit: the time between would be simulated step by
    /// step for hours.
    fn refuse_gaps(&self) -> Result<(), ScenarioError> {
        let allowed_s = 60.0;
        let times = self.sample_time_s.windows(2);
        let mut gaps: Vec<f64> = times.map(|pair| pair[1] - pair[0]).collect();
        let Some(at) = gaps.iter().position(|gap| *gap > allowed_s) else {
            return Ok(());
        };
        let gap_s = gaps[at];
        gaps.sort_by(f64::total_cmp);
        Err(ScenarioError::Gap {
            run: self.name.clone(),
            gap_s,
            time_s: self.sample_time_s[at],
            median_s: gaps[gaps.len() / 2],
            allowed_s,
        })
    }

    /// Half of the interval in which a sample may have been taken, s; zero for a stamp of the drive.
    pub fn half_width_s(&self, sample: usize) -> f64 {
        self.time_half_width_s.get(sample).copied().unwrap_or(0.0)
    }

    pub fn is_stamped_by_host(&self) -> bool {
        self.time_half_width_s.iter().any(|half_width_s| *half_width_s > 0.0)
    }

    /// Median half-width of the stamps that are not of the drive, s; `None` where all are.
    pub fn typical_half_width_s(&self) -> Option<f64> {
        let mut present = self.time_half_width_s.clone();
        present.retain(|half_width_s| *half_width_s > 0.0);
        present.sort_by(f64::total_cmp);
        present.get(present.len() / 2).copied()
    }

    /// Mean and standard deviation of the delay of the input against its stamps, s; `None` where the drive stamped it. A command
    /// of the host was applied at an unknown instant of its exchange; a sampled voltage changed at an unknown instant between two
    /// samples.
    pub fn input_delay_s(&self) -> Option<(f64, f64)> {
        let half_width_s = self.typical_half_width_s()?;
        let period_s = self.mean_period_s();
        match (self.input, self.input_channel) {
            (Input::Voltage, Channel::VoltageCmd) | (Input::Current, Channel::CurrentCmd) => {
                // Within two exchanges, that of the write and that of the read; a write takes a tenth of a period at least.
                Some((0.0, (2.0 * half_width_s).max(0.1 * period_s)))
            }
            (Input::Voltage, _) => Some((-0.5 * period_s, 0.5 * period_s)),
            _ => None,
        }
    }

    /// Whether the input is known at the samples only, so that its changes came at unknown instants.
    pub fn has_sampled_input(&self) -> bool {
        self.unknown_input.iter().any(UnknownInput::is_of_edge)
    }

    /// Instant of the first input, at which the simulation starts.
    pub fn begin_s(&self) -> f64 {
        self.events[0].0
    }

    /// Mean of the input over half a period on either side of each sample: with the values at the samples the trapezoidal rule would
    /// delay a step by half a sample.
    pub fn held_means(&self) -> Vec<f64> {
        (0..self.samples()).map(|sample| self.held_mean(sample)).collect()
    }

    /// The same at one sample.
    pub fn held_mean(&self, sample: usize) -> f64 {
        let times = &self.sample_time_s;
        let from_s = 0.5 * (times[sample] + times[sample.saturating_sub(1)]);
        let to_s = 0.5 * (times[sample] + times[(sample + 1).min(times.len() - 1)]);
        signal::mean(&self.events, from_s, to_s)
    }

    pub fn input_at(&self, time_s: f64) -> f64 {
        signal::held(&self.events, time_s).unwrap_or(self.events[0].1)
    }

    /// Full voltage of the supply to which effects of the duty refer; zero where the input is not a voltage. It is not in a run,
    /// and the largest voltage of the run would give the same machine another parameter in the next run.
    pub fn supply_v(&self) -> f64 {
        match self.input {
            Input::Voltage => REFERENCE_SUPPLY_V,
            Input::Current | Input::Torque => 0.0,
        }
    }

    /// Angle of the shaft `(time, angle)`: the measured one, else the integral of the measured speed, which has an arbitrary start
    /// and drifts. Not the simulated one, whose phase is lost within seconds.
    pub fn shaft_angle(&self) -> Cow<'_, [(f64, f64)]> {
        if !self.angle.is_empty() {
            return Cow::Borrowed(&self.angle);
        }
        let speeds = self.sample_time_s.iter().zip(&self.speed_rad_s);
        let (mut angle_rad, mut last) = (0.0, None);
        let integrated =
            speeds.filter(|point| point.1.is_finite()).map(|(&time_s, &speed_rad_s)| {
                if let Some((before_s, before_rad_s)) = last {
                    angle_rad += 0.5 * (speed_rad_s + before_rad_s) * (time_s - before_s);
                }
                last = Some((time_s, speed_rad_s));
                (time_s, angle_rad)
            });
        Cow::Owned(integrated.collect())
    }

    pub fn samples(&self) -> usize {
        self.sample_time_s.len()
    }

    pub fn mean_period_s(&self) -> f64 {
        mean_step(&self.sample_time_s)
    }

    /// The names of its runs and its own, for a part of it.
    fn within(&self) -> Vec<String> {
        [&*self.part_of, std::slice::from_ref(&self.name)].concat()
    }

    /// Split of one run into training and hold-out: the first part, and the whole with only its last part scored. The hold-out is
    /// simulated from the start, so that it needs no initial state.
    pub fn split(&self, training_share: f64) -> (Self, Self) {
        let cut = whole((self.samples() as f64 * training_share).round());
        let whole = Self { part_of: self.within(), ..self.clone() };
        let (mut training, mut holdout) = (whole.clone(), whole);
        let share = 100.0 * training_share;
        training.name = format!("{} (first {share:.0} %)", self.name);
        for column in [
            &mut training.sample_time_s,
            &mut training.current_a,
            &mut training.voltage_v,
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

    /// A part of the run as a scenario, with the machine at rest at its first sample.
    #[must_use]
    pub fn stretch(&self, samples: Range<usize>) -> Self {
        let times = &self.sample_time_s[samples.clone()];
        let (begin_s, end_s) = (times[0], times[times.len() - 1]);
        // From the first sample on, the commands before it are kept.
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
            voltage_v: part(&self.voltage_v),
            command_lag_s: self.command_lag_s,
            current_steps_s: self.current_steps_s.clone(),
            speed_rad_s: part(&self.speed_rad_s),
            time_half_width_s: part(&self.time_half_width_s),
            sensors: self.sensors,
            speed_rounding_rad_s: self.speed_rounding_rad_s,
            unknown_input,
            limits,
            part_of: self.within(),
            scales: self.scales,
            ..Self::planned(name, input, channel, events, times)
        }
    }

    /// Instant at which the shaft begins to turn, s: a small torque may keep it turning.
    fn turns_from_s(&self) -> f64 {
        let mut sizes = self.speed_rad_s.iter().map(|speed| speed.abs());
        let fastest = sizes.clone().fold(0.0, f64::max);
        let first = sizes.position(|size| size > NEARLY_ZERO_MEASURED * fastest);
        first.map_or(f64::INFINITY, |sample| self.sample_time_s[sample])
    }

    /// The run with its input later by this time; its begin stays.
    #[must_use]
    pub fn with_input_later(&self, later_s: f64) -> Self {
        let mut moved = self.clone();
        let begin_s = self.begin_s();
        moved.events.iter_mut().skip(1).for_each(|event| event.0 += later_s);
        let before = moved.events.iter().skip(1).take_while(|event| event.0 <= begin_s).count();
        moved.events.drain(..before);
        moved.events[0].0 = begin_s;
        moved
    }

    /// Concatenation of this run and a later one of the same machine. Between them the input is zero, and the simulation
    /// restarts with the initial state of the later run. Inputs after this run's last sample (the hold-out) are left out.
    #[must_use]
    pub fn followed_by(&self, later: &Self) -> Self {
        let shift_s = self.whole_s() + self.begin_s() - later.begin_s();
        let shifted = |time_s: f64| time_s + shift_s;
        let begins_s = shifted(later.begin_s());
        let ended_s = begins_s - BETWEEN_RUNS_S;
        let before_end = |points: &[Point]| -> Vec<Point> {
            points.iter().copied().filter(|point| point.0 < ended_s).collect()
        };
        let shifted_points = |points: &[Point]| -> Vec<Point> {
            points.iter().map(|point| (shifted(point.0), point.1)).collect()
        };
        let joined = |a: &[f64], b: &[f64]| [a, b].concat();
        let zero = vec![(ended_s, 0.0)];
        let events = [before_end(&self.events), zero, shifted_points(&later.events)].concat();
        // Without the angle of one of them the position of the shaft is unknown.
        let mut angle = Vec::new();
        if !self.angle.is_empty() && !later.angle.is_empty() {
            angle = [before_end(&self.angle), shifted_points(&later.angle)].concat();
        }
        let widths = |run: &Self| -> Vec<f64> {
            (0..run.samples()).map(|sample| run.half_width_s(sample)).collect()
        };
        let mut time_half_width_s = Vec::new();
        if !self.time_half_width_s.is_empty() || !later.time_half_width_s.is_empty() {
            time_half_width_s = joined(&widths(self), &widths(later));
        }
        // Of a hole that reaches beyond the end only the part before it.
        let holes = self.unknown_input.iter().filter(|hole| hole.from_s < ended_s).map(|hole| {
            let restart = hole.restart.filter(|_| hole.to_s < ended_s);
            UnknownInput { to_s: hole.to_s.min(ended_s), restart, ..*hole }
        });
        let between = UnknownInput::between_runs(ended_s, begins_s, later.begins_with());
        let later_holes = later.unknown_input.iter().map(|hole| UnknownInput {
            from_s: shifted(hole.from_s),
            to_s: shifted(hole.to_s),
            ..*hole
        });
        let limits = self.limits.iter().copied();
        let later_limits = later.limits.iter().map(|limit| LimitReached {
            from_s: shifted(limit.from_s),
            to_s: shifted(limit.to_s),
            ..*limit
        });
        let later_times = later.sample_time_s.iter().copied().map(shifted);
        let times = self.sample_time_s.iter().copied().chain(later_times).collect();
        let name = format!("{} and {}", self.name, later.name);
        Self {
            angle,
            limits: limits.filter(|limit| limit.to_s < ended_s).chain(later_limits).collect(),
            current_a: joined(&self.current_a, &later.current_a),
            voltage_v: joined(&self.voltage_v, &later.voltage_v),
            command_lag_s: self.command_lag_s,
            current_steps_s: {
                let later = later.current_steps_s.iter().map(|time_s| shifted(*time_s));
                self.current_steps_s.iter().copied().chain(later).collect()
            },
            speed_rad_s: joined(&self.speed_rad_s, &later.speed_rad_s),
            time_half_width_s,
            sensors: self.sensors,
            speed_rounding_rad_s: self.speed_rounding_rad_s,
            unknown_input: holes.chain([between]).chain(later_holes).collect(),
            scales: RunScales {
                length_s: self.scales.length_s + later.scales.length_s,
                ..self.scales
            },
            ..Self::planned(name, self.input, self.input_channel, events, times)
        }
    }

    /// Initial current and speed: zero where the mean of the first samples is within four standard deviations of zero, else the
    /// first measured values; NaN where missing.
    pub fn begins_with(&self) -> [f64; 2] {
        let at_rest = self.leading_standstill();
        let begin = |values: &[f64]| {
            let first = values.iter().copied().find(|value| value.is_finite());
            let rest = values.get(at_rest.clone()).unwrap_or_default().iter().copied();
            let rest: Vec<f64> = rest.filter(|value| value.is_finite()).take(FEWEST_ROWS).collect();
            let deviation_of_mean = (variance(&rest) / rest.len() as f64).sqrt();
            let is_zero = rest.len() == FEWEST_ROWS && mean(&rest).abs() <= 4.0 * deviation_of_mean;
            if is_zero { 0.0 } else { first.unwrap_or(f64::NAN) }
        };
        [begin(&self.current_a), begin(&self.speed_rad_s)]
    }

    /// From the run's first input to that of a run that is appended to it, s.
    pub fn whole_s(&self) -> f64 {
        let last_s = self.sample_time_s[self.samples() - 1];
        last_s + self.mean_period_s() - self.begin_s() + BETWEEN_RUNS_S
    }

    /// Samples of the leading standstill: the input is zero, or nearly so. The first instants of a bumpless start, in which the
    /// command follows the measured voltage, do not belong to it.
    pub fn leading_standstill(&self) -> Range<usize> {
        let sizes = self.events.iter().map(|event| event.1.abs());
        let largest = sizes.fold(0.0, f64::max);
        // A bumpless start ends at a small voltage.
        let nearly_zero = match self.input {
            Input::Voltage => 0.002,
            Input::Current | Input::Torque => NEARLY_ZERO_MEASURED,
        };
        let moves = |event: &&Point| event.1.abs() > nearly_zero * largest;
        // A bumpless start comes to zero within two small commands.
        let leading = self.events.iter().take_while(moves).count();
        let is_small = |event: &Point| event.1.abs() <= 0.05 * largest;
        let bumpless = leading <= 2 && self.events[..leading].iter().all(is_small);
        let (begin, begin_s) = match self.events.get(leading) {
            Some(event) if bumpless => (leading, event.0),
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

/// Events behind the drive's own ramp, of so many units a second, as a staircase; the same where it has none.
fn ramped(events: &[Point], per_s: f64) -> Vec<Point> {
    let Some(first) = events.first().filter(|_| per_s > 0.0) else { return events.to_vec() };
    let (mut out, mut value) = (vec![*first], first.1);
    let ends = events.iter().skip(2).map(|event| event.0).chain([f64::INFINITY]);
    for ((from_s, target), end_s) in events.iter().skip(1).zip(ends) {
        let lasts_s = ((target - value).abs() / per_s).min(end_s - from_s);
        let reaches = value + (target - value).signum() * per_s * lasts_s;
        // Steps of 0.5 ms, at most 50 of a command, as under a limit.
        let steps = whole((lasts_s / 0.5e-3).ceil()).min(50);
        let at = |step: f64| step / steps as f64;
        out.extend((0..steps).map(|step| {
            let step = step as f64;
            (from_s + at(step) * lasts_s, value + at(step + 0.5) * (reaches - value))
        }));
        value = if end_s - from_s > lasts_s { *target } else { reaches };
        if from_s + lasts_s < end_s {
            out.push((from_s + lasts_s, *target));
        }
    }
    out
}

/// The input column. A commanded voltage has the instants of its changes; a measured one is known at the samples only and is the
/// input where there is no command.
fn input_of(run: &Run) -> Option<(Input, Channel)> {
    let has = |channel| run.points(channel).next().is_some();
    let stamped = run.origin(Channel::VoltageCmd) == Origin::Commanded && has(Channel::VoltageCmd);
    let is_sampled = stamped && run.origin(Channel::Voltage) == Origin::Measured;
    let mut inputs = [
        // The voltage of a drive that controls the current changes between the samples, and follows from the motion.
        (Input::Current, Channel::CurrentCmd, has(Channel::Speed) || has(Channel::Angle)),
        (Input::Voltage, Channel::Voltage, !is_sampled),
        (Input::Voltage, Channel::VoltageCmd, true),
        (Input::Torque, Channel::Torque, true),
        (Input::Current, Channel::Current, true),
    ]
    .into_iter();
    let (input, channel, _) = inputs.find(|(_, channel, usable)| *usable && has(*channel))?;
    Some((input, channel))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plant::testing::{self, record, run_of};
    use crate::plant::{Model, Plant, State};

    fn run(origin: Origin) -> Run {
        let times = (0..40).map(|row| f64::from(row) * 0.01).collect();
        let columns = [
            (Channel::VoltageCmd, vec![2.0; 40], origin),
            (Channel::Voltage, vec![1.9; 40], Origin::Measured),
            (Channel::Speed, vec![0.0; 40], Origin::Measured),
        ];
        run_of("r", times, columns)
    }

    fn with_column(mut run: Run, channel: Channel, cells: Vec<f64>, origin: Origin) -> Scenario {
        run.set_column(channel, cells, origin).unwrap();
        Scenario::from_run(&run).unwrap()
    }

    #[test]
    fn a_run_becomes_a_scenario_of_its_input_and_its_usable_rows() {
        for (origin, channel) in
            [(Origin::Commanded, Channel::VoltageCmd), (Origin::Unknown, Channel::Voltage)]
        {
            let scenario = Scenario::from_run(&run(origin)).unwrap();
            assert_eq!(scenario.input_channel, channel);
        }
        // Rows before the first voltage are not used.
        let mut cells = vec![f64::NAN; 40];
        cells[15] = 3.0;
        let late = run(Origin::Commanded);
        let late = with_column(late, Channel::VoltageCmd, cells, Origin::Commanded);
        assert_eq!((late.samples(), late.events), (25, vec![(0.15, 3.0)]));
        // A split scores the tail but starts at the beginning.
        let whole = Scenario::from_run(&run(Origin::Commanded)).unwrap();
        let (training, holdout) = whole.split(0.6);
        assert_eq!((training.samples(), training.scored), (24, 0..24));
        assert_eq!((holdout.samples(), holdout.scored), (40, 24..40));
        // An angle within one turn is made continuous.
        let turns = |k: u16| 0.2 * f64::from(k);
        let cells = (0..40).map(|k| turns(k).fract() * std::f64::consts::TAU);
        let wrapped = run(Origin::Commanded);
        let wrapped = with_column(wrapped, Channel::Angle, cells.collect(), Origin::Measured);
        let end_rad = wrapped.shaft_angle()[39].1;
        assert!((end_rad - turns(39) * std::f64::consts::TAU).abs() < 1e-9);
    }

    #[test]
    fn records_that_cannot_be_simulated_are_refused() {
        let of = |times: Vec<f64>, channels: [Channel; 2]| {
            let columns = channels.map(|name| (name, vec![1.0; times.len()], Origin::Unknown));
            Scenario::from_run(&run_of("r", times, columns)).unwrap_err()
        };
        let (volts, amperes, speed) = (Channel::Voltage, Channel::Current, Channel::Speed);
        let seconds: Vec<f64> = (0..39).map(f64::from).collect();
        let milliseconds: Vec<f64> = (0..40).map(|k| f64::from(k) * 1000.0).collect();
        for (times, channels, message) in [
            (milliseconds, [volts, speed], "1000 s pass between two samples"),
            ([&seconds[..], &[1e12]].concat(), [volts, speed], "s pass between"),
            (seconds[..5].to_vec(), [volts, amperes], "has 5 usable rows"),
            (seconds.clone(), [volts, Channel::Bus], "has neither current nor speed"),
            (seconds.clone(), [speed, Channel::Bus], "has no voltage"),
        ] {
            let error = of(times, channels);
            assert!(error.to_string().contains(message), "{error}");
            assert!(!error.help().is_empty());
        }
    }

    #[test]
    fn the_input_of_a_host_has_an_unknown_delay() {
        let drive = run(Origin::Commanded);
        assert_eq!(Scenario::from_run(&drive).unwrap().input_delay_s(), None);
        let widths = || (Channel::TimeHalfWidth, vec![0.002; 40], Origin::Derived);
        let (channel, cells, origin) = widths();
        let commanded = with_column(drive.clone(), channel, cells, origin);
        assert_eq!(commanded.time_half_width_s.len(), commanded.samples());
        assert_eq!(commanded.input_delay_s(), Some((0.0, 0.004)));
        let (channel, cells, origin) = widths();
        let sampled = with_column(drive.without(Channel::VoltageCmd), channel, cells, origin);
        let (mean_s, std_s) = sampled.input_delay_s().unwrap();
        assert!((mean_s + 0.005).abs() < 1e-9 && (std_s - 0.005).abs() < 1e-9);
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
        let holes = with_holes();
        let [one, long] = holes.unknown_input[..] else {
            panic!("{:?}", holes.unknown_input);
        };
        assert!((one.from_s - 0.5).abs() < 1e-9 && (one.to_s - 0.501).abs() < 1e-9);
        assert!((long.from_s - 1.2).abs() < 1e-9 && long.variance > 0.0);
        assert!((holes.input_at(1.3) - long.mean).abs() < 1e-12);
        // The simulation restarts from the measurement after it, which is not compared.
        let restart = long.restart.unwrap();
        assert!(restart[0].is_nan() && (restart[1] - 1400.0).abs() < 1e-9);
        let missing = holes.speed_rad_s.iter().filter(|speed| speed.is_nan());
        assert_eq!(missing.count(), 1);
        let whole = Scenario::from_run(&run(Origin::Unknown)).unwrap();
        assert!(whole.unknown_input.is_empty() && whole.events.len() == 40);
    }

    #[test]
    fn means_of_a_current_over_a_reversal_are_left_out_and_a_ramp_is_a_staircase() {
        let mut run = run(Origin::Commanded);
        let volts = (0..40).map(|row| if row < 20 { 10.0 } else { -10.0 }).collect();
        run.set_column(Channel::VoltageCmd, volts, Origin::Commanded).unwrap();
        let current = vec![1.0; 40];
        run.set_column(Channel::Current, current, Origin::Measured).unwrap();
        run.set_sensors(Sensors {
            averages_current: true,
            ramp_v_per_s: 4000.0,
            ..Sensors::default()
        });
        let scenario = Scenario::from_run(&run).unwrap();
        let lost: Vec<usize> =
            (0..40).filter(|sample| scenario.current_a[*sample].is_nan()).collect();
        assert_eq!(lost, [21], "from 0.2 s on the voltage passes zero, in 5 ms");
        for (time_s, volts) in [(0.1999, 10.0), (0.2025, 0.0), (0.2051, -10.0)] {
            assert!((scenario.input_at(time_s) - volts).abs() < 1.1, "{time_s}");
        }
    }

    fn speeds(model: &Model, run: &Scenario) -> Vec<f64> {
        let mut plant = Plant::new(model, Input::Voltage).unwrap();
        plant.simulate(run, State::default()).speed_rad_s
    }

    #[test]
    fn an_appended_run_is_simulated_as_it_is_alone() {
        // The heavy machine still turns long after the end of its run.
        for (inertia_kg_m2, seconds, within) in [(0.0045, 2.0, 1e-6), (0.3, 3.0, 0.5)] {
            let values = [1.1, 0.0099, 0.3538, inertia_kg_m2, 0.455];
            let model = Model::baseline(testing::motor("m", &values));
            let run = |volts: f64, seed| {
                let events = vec![(0.0, 0.0), (0.3, volts), (0.9, 0.7 * volts)];
                record(&model, events, 0.01, seconds, seed)
            };
            let (first, whole) = (run(40.0, 1), run(60.0, 2));
            assert_eq!(first.begins_with().map(f64::to_bits), [0, 0]);
            let alone = speeds(&model, &whole);
            let moving = whole.stretch(120..whole.samples());
            assert!(moving.begins_with()[1] > 1.0);
            for (later, from) in [(&whole, 0), (&moving, 120)] {
                let both = first.followed_by(later);
                assert_eq!(both.samples(), first.samples() + later.samples());
                let begins_s = both.sample_time_s[first.samples()] - first.begin_s();
                let own_s = later.sample_time_s[0] - later.begin_s();
                assert!((begins_s - first.whole_s() - own_s).abs() < 1e-9);
                let within = if from == 0 { within } else { 0.5 };
                let simulated = speeds(&model, &both);
                for (a, b) in simulated[first.samples()..].iter().zip(&alone[from..]) {
                    assert!((a - b).abs() < within, "{inertia_kg_m2} {from}: {a} {b}");
                }
            }
        }
    }

    #[test]
    fn inputs_of_a_hold_out_are_not_appended_to() {
        let mut first = with_holes();
        let times = first.sample_time_s.iter();
        first.angle = times.map(|time_s| (*time_s, 3.0 * time_s)).collect();
        let (training, _) = first.split(0.5);
        let end_s = training.sample_time_s[training.samples() - 1];
        assert!(first.unknown_input[1].restart.is_some() && first.unknown_input[1].to_s > end_s);
        let both = training.followed_by(&first);
        for times in [
            both.events.iter().map(|event| event.0).collect::<Vec<f64>>(),
            both.angle.iter().map(|point| point.0).collect(),
            both.sample_time_s.clone(),
            both.unknown_input.iter().map(|hole| hole.from_s).collect(),
        ] {
            assert!(times.windows(2).all(|pair| pair[1] > pair[0]), "{times:?}");
        }
        // The hole before the end, the time between the runs, and the holes of the appended run.
        assert_eq!(both.unknown_input.len(), 4);
        let between = &both.unknown_input[1];
        assert!(between.variance.abs() < 1e-12 && between.restart.is_some());
        let begins_s = both.sample_time_s[training.samples()];
        assert!((between.to_s - begins_s).abs() < 1e-9 && between.from_s >= end_s);
        let inside = |time_s: f64| (between.from_s..begins_s).contains(&time_s);
        assert!(!both.angle.iter().any(|point| inside(point.0)));
    }
}
