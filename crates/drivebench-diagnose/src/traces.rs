//! Traces of a comparison: every signal, measured and simulated, with the noise, over the time of its run.
//!
//! ```text
//! model, Evidence -> Traces: one RunTraces for the hold-out, the fit run (of a split run both are one) and the confirming run
//!                      '-> SignalTrace: time from the run's begin, measured, model (a free run), noise; a gap is NaN
//! ```
//!
//! A run that no voltage drives has the torque of the motor and that of the inverse model.

use std::borrow::Cow;
use std::sync::Arc;

use super::evidence::{Evidence, HoldoutFrom};
use super::mechanical::{self, Balance, Sides};
use drivebench_identify::balance::TorqueRows;
use drivebench_identify::noise::{FloorSource, NoiseFloor};
use drivebench_identify::online::{Online, OnlineConfig};
use drivebench_identify::output_error::{self, FitError};
use drivebench_model::plant::{Input, Model, MotorKey, Scenario};
use drivebench_model::sample::{Channel, ParameterEstimate, Run};

/// Quantity of a trace.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    Channel(Channel),
    /// On-line estimate of a parameter of the motor.
    Estimate(MotorKey),
}

impl Quantity {
    pub const fn name(self) -> &'static str {
        match self {
            Self::Channel(channel) => channel.name(),
            Self::Estimate(key) => key.name(),
        }
    }

    pub const fn unit(self) -> &'static str {
        match self {
            Self::Channel(channel) => channel.unit(),
            Self::Estimate(key) => key.unit(),
        }
    }
}

/// One signal over time.
#[derive(Clone, Debug, PartialEq)]
pub struct SignalTrace {
    pub quantity: Quantity,
    /// Since the run's begin, its first command; rising.
    pub time_s: Arc<[f64]>,
    /// NaN where nothing was measured.
    pub measured: Vec<f64>,
    /// The same simulated; empty where the model does not have this signal.
    pub model: Vec<f64>,
    /// Standard deviation of the sensor's noise, where it is known.
    pub noise: Option<f64>,
    /// Standard deviation of each value, of an estimate.
    pub std: Vec<f64>,
    /// Held from each instant to the next, as a command.
    pub is_held: bool,
}

impl SignalTrace {
    /// Of a measurement alone.
    fn new(quantity: Quantity, time_s: impl Into<Arc<[f64]>>, measured: Vec<f64>) -> Self {
        Self {
            quantity,
            time_s: time_s.into(),
            measured,
            model: Vec::new(),
            noise: None,
            std: Vec::new(),
            is_held: false,
        }
    }

    /// Whether it has a value anywhere.
    fn is_known(&self) -> bool {
        self.measured.iter().any(|value| value.is_finite())
    }

    /// Measured less model: positive where the model is too low. NaN in gaps.
    pub fn residual(&self) -> impl Iterator<Item = f64> + '_ {
        self.measured.iter().zip(&self.model).map(|(measured, model)| measured - model)
    }

    pub const fn has_model(&self) -> bool {
        !self.model.is_empty()
    }

    /// The stretches with the largest root mean square of the residual, the worst first: begin, end and the instant of the
    /// largest residual in it. The run is cut into `parts`.
    pub fn worst_places(&self, parts: usize) -> Vec<WorstPlace> {
        let (Some(first), Some(last)) = (self.time_s.first(), self.time_s.last()) else {
            return Vec::new();
        };
        let part_s = (last - first) / parts.max(1) as f64;
        if !self.has_model() || part_s <= 0.0 {
            return Vec::new();
        }
        let mut places: Vec<WorstPlace> = Vec::new();
        let (mut count, mut largest) = (0.0, 0.0);
        for (time_s, residual) in self.time_s.iter().zip(self.residual()) {
            if !residual.is_finite() {
                continue;
            }
            let part = ((time_s - first) / part_s).floor().min(parts as f64 - 1.0);
            let from_s = first + part * part_s;
            if places.last().is_none_or(|place| place.from_s < from_s) {
                (count, largest) = (0.0, 0.0);
                places.push(WorstPlace { from_s, to_s: from_s + part_s, at_s: *time_s, rms: 0.0 });
            }
            if let Some(place) = places.last_mut() {
                count += 1.0;
                // Running mean of the squares.
                place.rms += (residual * residual - place.rms) / count;
                if residual.abs() > largest {
                    (largest, place.at_s) = (residual.abs(), *time_s);
                }
            }
        }
        for place in &mut places {
            place.rms = place.rms.sqrt();
        }
        places.sort_by(|a, b| b.rms.total_cmp(&a.rms));
        places
    }
}

/// A stretch of time with a large residual.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WorstPlace {
    pub from_s: f64,
    pub to_s: f64,
    /// Where the residual is largest.
    pub at_s: f64,
    pub rms: f64,
}

/// Role of a run in the comparison.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    HoldOut,
    /// The whole run, whose last part is held out.
    Split,
    FitRun,
    Confirm,
}

impl Part {
    pub const fn name(self) -> &'static str {
        match self {
            Self::HoldOut => "hold-out",
            Self::Split => "run, its end held out",
            Self::FitRun => "fit run",
            Self::Confirm => "confirming run",
        }
    }
}

/// The signals of one run, the simulated ones first.
#[derive(Clone, Debug, PartialEq)]
pub struct RunTraces {
    pub run: String,
    pub part: Part,
    /// From when on it is held out, where a run was split.
    pub held_out_from_s: Option<f64>,
    pub signals: Vec<SignalTrace>,
}

impl RunTraces {
    /// Speed and current of a complete model over a run that a voltage drives, and that voltage.
    pub fn free_run(model: &Model, run: &Scenario, noise: &NoiseFloor) -> Result<Self, FitError> {
        let mut signals = free_run(model, run, noise)?;
        signals.push(command(run));
        Ok(Self { run: run.name.clone(), part: Part::HoldOut, held_out_from_s: None, signals })
    }

    /// First and last instant of all signals; zero and one where there is none.
    pub fn span_s(&self) -> (f64, f64) {
        let ends = |signal: &SignalTrace| Some((*signal.time_s.first()?, *signal.time_s.last()?));
        let ends = self.signals.iter().filter_map(ends);
        ends.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1))).unwrap_or((0.0, 1.0))
    }
}

/// The comparison of a model with its runs, as signals over time.
#[derive(Clone, Debug, PartialEq)]
pub struct Traces {
    /// The hold-out first.
    pub runs: Vec<RunTraces>,
    /// Effects of the model.
    pub effects: Vec<&'static str>,
}

/// Every recorded channel outside of the comparison, by the name of its run.
#[derive(Clone, Debug, Default)]
pub struct RecordedChannels {
    runs: Vec<(String, Vec<SignalTrace>)>,
}

impl RecordedChannels {
    /// Adds a run of the comparison with its on-line estimates.
    pub fn add(&mut self, run: &Run, scenario: &Scenario) {
        let begin_s = scenario.begin_s();
        let signal = |channel: Channel| {
            // Rows of commands are between those of samples: an empty cell there is no gap.
            let points = run.points(channel).map(|(time_s, value)| (time_s - begin_s, value));
            let (time_s, measured): (Vec<f64>, Vec<f64>) = points.unzip();
            let trace = SignalTrace::new(Quantity::Channel(channel), time_s, measured);
            trace.is_known().then_some(SignalTrace { is_held: channel.is_commanded(), ..trace })
        };
        let mut signals: Vec<SignalTrace> = Channel::ALL.into_iter().filter_map(signal).collect();
        signals.extend(estimates(run, scenario));
        self.runs.push((run.name.clone(), signals));
    }

    /// The channels that a run has besides `known`.
    fn other_channels(&self, run: &Scenario, known: &[SignalTrace]) -> Vec<SignalTrace> {
        let recorded = run.part_of.first().unwrap_or(&run.name);
        let own = self.runs.iter().find(|(name, _)| name == recorded);
        let signals = own.into_iter().flat_map(|(_, signals)| signals);
        let is_new =
            |signal: &&SignalTrace| known.iter().all(|own| own.quantity != signal.quantity);
        signals.filter(is_new).cloned().collect()
    }
}

impl Traces {
    /// The traces of a complete model; only initial state and times of events are fitted.
    pub fn of(
        model: &Model,
        evidence: &Evidence,
        recorded: &RecordedChannels,
    ) -> Result<Self, FitError> {
        let is_split = evidence.holdout_from == HoldoutFrom::Split;
        let first = if is_split { Part::Split } else { Part::HoldOut };
        let mut parts = vec![(first, &evidence.holdout)];
        if !is_split {
            parts.push((Part::FitRun, &evidence.training));
        }
        parts.extend(evidence.confirm.iter().map(|run| (Part::Confirm, run)));
        let by_voltage = evidence.training.input == Input::Voltage;
        let balance = (!by_voltage).then(|| Balance::new(model, evidence)).transpose()?;
        let traced = |(part, run): (Part, &Scenario)| {
            let mut signals = match &balance {
                None => free_run(model, run, &evidence.noise)?,
                Some((balance, _)) => {
                    let rows = rows_of(&balance.sides, part);
                    let known = balance.source != FloorSource::None;
                    let unit_n_m = known.then_some(balance.unit_n_m);
                    rows.map(|rows| torque(model, rows, run, unit_n_m)).into_iter().collect()
                }
            };
            if run.input == Input::Voltage {
                signals.push(command(run));
            }
            signals.extend(recorded.other_channels(run, &signals));
            let begin_s = run.sample_time_s.get(run.scored.start).map(|t| t - run.begin_s());
            // A split run is shown whole.
            let whole = run.part_of.last().filter(|_| part == Part::Split);
            Ok(RunTraces {
                run: whole.unwrap_or(&run.name).clone(),
                part,
                held_out_from_s: begin_s.filter(|_| part == Part::Split),
                signals,
            })
        };
        let runs = parts.into_iter().map(traced);
        Ok(Self { runs: runs.collect::<Result<_, FitError>>()?, effects: model.effect_ids() })
    }
}

/// The command, since the run's begin.
fn command(run: &Scenario) -> SignalTrace {
    let events = run.events.iter().map(|(time_s, value)| (time_s - run.begin_s(), *value));
    let (time_s, values): (Vec<f64>, Vec<f64>) = events.unzip();
    let trace = SignalTrace::new(Quantity::Channel(run.input_channel), time_s, values);
    SignalTrace { is_held: true, ..trace }
}

/// Speed and current of the free run with their measurement, without a signal that was never measured.
fn free_run(
    model: &Model,
    run: &Scenario,
    noise: &NoiseFloor,
) -> Result<Vec<SignalTrace>, FitError> {
    let trajectory = output_error::predict(model, run, noise)?.trajectory;
    let begin_s = run.begin_s();
    let time_s: Arc<[f64]> = run.sample_time_s.iter().map(|t| t - begin_s).collect();
    let is_known = noise.source != FloorSource::None;
    let signal = |channel, measured: &Vec<f64>, model, level: f64| {
        let noise = (is_known && level.is_finite()).then_some(level);
        let time_s = Arc::clone(&time_s);
        let trace = SignalTrace::new(Quantity::Channel(channel), time_s, measured.clone());
        trace.is_known().then_some(SignalTrace { model, noise, ..trace })
    };
    let (speed, current) = (trajectory.speed_rad_s, trajectory.current_a);
    let signals = [
        signal(Channel::Speed, &run.speed_rad_s, speed, noise.speed_rad_s),
        signal(Channel::Current, &run.current_a, current, noise.current_a),
    ];
    Ok(signals.into_iter().flatten().collect())
}

/// Instants at which estimates are kept.
const ESTIMATES: usize = 400;

/// On-line estimates along a run that a voltage drives; gaps before the first.
fn estimates(run: &Run, scenario: &Scenario) -> Vec<SignalTrace> {
    if scenario.input != Input::Voltage {
        return Vec::new();
    }
    let command = Channel::VoltageCmd;
    let is_measured = scenario.input_channel == Channel::Voltage && run.column(command).is_some();
    let used = if is_measured { Cow::Owned(run.without(command)) } else { Cow::Borrowed(run) };
    let stride = used.rows().div_ceil(ESTIMATES).max(1);
    let mut online = Online::new(OnlineConfig::default());
    let mut times = Vec::new();
    let mut found: Vec<Vec<ParameterEstimate>> = Vec::new();
    for (row, sample) in used.samples().enumerate() {
        online.push(&sample);
        if row % stride == 0 {
            times.push(sample.time_s - scenario.begin_s());
            found.push(online.estimates());
        }
    }
    let time_s: Arc<[f64]> = times.into();
    let of = |key: MotorKey| {
        let all = |figure: fn(&ParameterEstimate) -> Option<f64>| -> Vec<f64> {
            let own = found.iter().map(|all| ParameterEstimate::find(all, key.key()));
            own.map(|own| own.and_then(figure).unwrap_or(f64::NAN)).collect()
        };
        let (values, std) = (all(|own| own.value), all(|own| own.std));
        let trace = SignalTrace::new(Quantity::Estimate(key), Arc::clone(&time_s), values);
        trace.is_known().then_some(SignalTrace { std, ..trace })
    };
    MotorKey::ALL.into_iter().filter_map(of).collect()
}

const fn rows_of(sides: &Sides, part: Part) -> Option<&TorqueRows> {
    match part {
        Part::HoldOut => Some(&sides.holdout),
        Part::FitRun => Some(&sides.training),
        Part::Split => sides.whole.as_ref(),
        Part::Confirm => sides.confirm.as_ref(),
    }
}

/// The torque of the motor and that of the inverse model.
fn torque(model: &Model, rows: &TorqueRows, run: &Scenario, noise: Option<f64>) -> SignalTrace {
    let time_s: Vec<f64> = rows.time_s.iter().map(|t| t - run.begin_s()).collect();
    let model = mechanical::predicted(&mechanical::with_events_of(model, rows), rows);
    let means = |torques: &[f64]| -> Vec<f64> {
        torques.iter().enumerate().map(|(row, torque)| torque / rows.share(row)).collect()
    };
    let trace = SignalTrace::new(Quantity::Channel(Channel::Torque), time_s, means(&rows.left));
    SignalTrace { model: means(&model), noise, ..trace }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kit::{nameplate, truth};
    use drivebench_model::plant::testing::{self, SPEED_NOISE_RAD_S, with_a_fan};
    use drivebench_model::sample::Origin;

    fn evidence() -> Evidence {
        let mut fitted = with_a_fan(0);
        fitted.name = "a".to_owned();
        fitted.speed_rad_s[100..110].fill(f64::NAN);
        Evidence::new(fitted, Some(with_a_fan(1)), None)
    }

    fn with_its_fan() -> Model {
        truth("quadratic_load", &[4e-6])
    }

    fn rms(trace: &SignalTrace) -> f64 {
        let known = trace.residual().filter(|residual| residual.is_finite());
        let (sum, count) = known.fold((0.0, 0.0), |(sum, n), r| (sum + r * r, n + 1.0));
        f64::sqrt(sum / count)
    }

    #[test]
    fn a_right_model_has_the_residual_of_the_noise_and_a_gap_stays_a_gap() {
        let none = RecordedChannels::default();
        let right = Traces::of(&with_its_fan(), &evidence(), &none).unwrap();
        let wrong = Traces::of(&nameplate(), &evidence(), &none).unwrap();
        assert_eq!(right.effects, ["quadratic_load"]);
        assert_eq!(wrong.effects, [""; 0]);
        let parts: Vec<Part> = right.runs.iter().map(|run| run.part).collect();
        assert_eq!(parts, [Part::HoldOut, Part::FitRun]);
        for (of_right, of_wrong) in right.runs.iter().zip(&wrong.runs) {
            let (speed, missed) = (&of_right.signals[0], &of_wrong.signals[0]);
            assert_eq!(speed.quantity, Quantity::Channel(Channel::Speed));
            assert!((rms(speed) / SPEED_NOISE_RAD_S - 1.0).abs() < 0.15, "{}", rms(speed));
            assert!(rms(missed) > 5.0 * rms(speed));
            assert!((speed.noise.unwrap() / SPEED_NOISE_RAD_S - 1.0).abs() < 0.3);
            assert!(speed.time_s[0].abs() < 1e-9 && speed.time_s.len() == speed.model.len());
        }
        let gap = &right.runs[1].signals[0];
        let missing = |k: usize| gap.residual().nth(k).unwrap().is_nan();
        assert!((100..110).all(missing) && !missing(99) && !missing(110));
    }

    #[test]
    fn the_worst_place_has_the_largest_residual() {
        let time_s: Vec<f64> = (0..1000).map(|k| 0.01 * f64::from(k)).collect();
        let bump = |at: f64, size: f64, t: f64| size * (-((t - at) / 0.05).powi(2)).exp();
        let model = time_s.iter().map(|t| bump(7.35, 3.0, *t) + bump(2.05, -5.0, *t)).collect();
        let trace = SignalTrace::new(Quantity::Channel(Channel::Speed), time_s, vec![0.0; 1000]);
        let worst = SignalTrace { model, ..trace }.worst_places(100);
        assert!((worst[0].at_s - 2.05).abs() < 0.02, "{:?}", worst[0]);
        let next = worst.iter().find(|place| (place.at_s - 2.05).abs() > 0.5).unwrap();
        assert!((next.at_s - 7.35).abs() < 0.06, "{next:?}");
        assert_eq!(worst.len(), 100);
    }

    #[test]
    fn a_split_run_is_one_run_with_the_begin_of_its_held_out_part() {
        let evidence = Evidence::new(with_a_fan(0), None, None);
        let traces = Traces::of(&with_its_fan(), &evidence, &RecordedChannels::default()).unwrap();
        let [run] = traces.runs.as_slice() else { panic!("{}", traces.runs.len()) };
        assert!(!run.run.contains("last"), "{}", run.run);
        let from_s = run.held_out_from_s.unwrap();
        assert!((from_s / run.span_s().1 - 0.6).abs() < 0.01, "{from_s}");
    }

    #[test]
    fn further_channels_have_the_time_of_their_run() {
        let fitted = with_a_fan(0);
        let times = fitted.sample_time_s.clone();
        let volts = times.iter().map(|time_s| fitted.input_at(*time_s)).collect();
        let bus = (0..times.len()).map(|k| if k == 1 { f64::NAN } else { 48.0 }).collect();
        let columns = [
            (Channel::VoltageCmd, volts, Origin::Unknown),
            (Channel::Current, fitted.current_a.clone(), Origin::Measured),
            (Channel::Speed, fitted.speed_rad_s.clone(), Origin::Measured),
            (Channel::Bus, bus, Origin::Measured),
        ];
        let run = testing::run_of("a", times, columns);
        let mut recorded = RecordedChannels::default();
        recorded.add(&run, &fitted);
        let traces = Traces::of(&with_its_fan(), &evidence(), &recorded).unwrap();
        let quantities = traces.runs[0].signals.iter().map(|signal| signal.quantity);
        let own = [Channel::Speed, Channel::Current, Channel::VoltageCmd].map(Quantity::Channel);
        assert_eq!(quantities.collect::<Vec<_>>(), own);
        let beside = &traces.runs[1].signals[3..];
        let bus = &beside[0];
        assert_eq!(bus.quantity, Quantity::Channel(Channel::Bus));
        // An empty cell of a row of commands is no gap.
        assert_eq!(bus.time_s.len(), fitted.samples() - 1);
        let quantity = Quantity::Estimate(MotorKey::Resistance);
        let resistance = beside.iter().find(|own| own.quantity == quantity).unwrap();
        let [value, std] = [&resistance.measured, &resistance.std].map(|own| *own.last().unwrap());
        assert!((value - 1.1).abs() < 5.0 * std && std < 0.1, "{value} {std}");
        assert!(resistance.measured[0].is_nan(), "nothing is known at the start");
    }
}
