//! Records and checks for the tests of this room.

use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution as _, Normal, Uniform};

use super::noise::{FloorSource, NoiseFloor};
use super::scheme::{self, Data, Identified, IdentifyError};
use drivebench_model::plant::{Input, Model, Motor, Plant, Scenario, State};
use drivebench_model::sample::{Channel, Origin, ParameterEstimate, Run, Sample, Verdict};

pub(super) use drivebench_model::plant::testing::{
    CURRENT_NOISE_A, SPEED_NOISE_RAD_S, held, record, with,
};

/// The floor of a record with the noise of a bench.
pub(super) const NOISE: NoiseFloor = NoiseFloor {
    current_a: CURRENT_NOISE_A,
    speed_rad_s: SPEED_NOISE_RAD_S,
    source: FloorSource::Standstill,
    samples: 1000,
    memory: [0.0; 2],
};

/// R, L, Ke, J, Mc.
pub(super) type Truth = [f64; 5];

/// The five, in that order.
pub(super) use super::belief::KEYS;

/// `Motor::zk_22fc`.
pub(super) const PAPER: Truth = [1.1, 0.0099, 0.3538, 0.0045, 0.455];
/// L/R 1 ms, R J/Ke^2 8 ms.
pub(super) const SMALL: Truth = [2.0, 0.002, 0.05, 1e-5, 0.01];
/// L/R 0.5 ms, R J/Ke^2 19 ms.
pub(super) const BRUSHED: Truth = [1.2, 6e-4, 0.05, 4e-5, 0.012];
/// L/R 20 ms, R J/Ke^2 167 ms.
pub(super) const LARGE: Truth = [0.3, 0.006, 1.2, 0.8, 4.0];

pub(super) fn motor(truth: &Truth) -> Motor {
    drivebench_model::plant::testing::motor("truth", truth)
}

/// The motor of paper A, nothing missing.
pub(super) fn paper() -> Model {
    Model::baseline(Motor::zk_22fc())
}

/// A motor of which nothing is known.
pub(super) fn unknown() -> Model {
    Model::baseline(Motor::new("?"))
}

pub(super) fn brushed() -> Model {
    Model::baseline(motor(&BRUSHED))
}

/// The motor of paper A with an effect of these values.
pub(super) fn paper_with(id: &str, values: &[f64]) -> Model {
    with(&paper(), id, values)
}

/// Voltage steps at odd instants in both directions after a rest; the full scale is 70.
pub(super) fn steps(begin_s: f64, seconds: f64, scale: f64, hold_s: f64) -> Vec<(f64, f64)> {
    let levels = [20.0, 35.0, 15.0, 60.0, 30.0, 45.0, 25.0, -30.0, -50.0, -20.0, 10.0, 70.0];
    let mut events = vec![(0.0, 0.0)];
    let mut at_s = begin_s;
    for step in 0_u8.. {
        if at_s > seconds {
            break;
        }
        events.push((at_s, scale * levels[usize::from(step) % levels.len()]));
        at_s += hold_s * (1.0 + 0.38 * f64::from(step % 3));
    }
    events
}

pub(super) fn every(period_s: f64, seconds: f64) -> Vec<f64> {
    (0..u32::MAX)
        .map(|k| f64::from(k) * period_s)
        .take_while(|time_s| *time_s < seconds - 0.5 * period_s)
        .collect()
}

/// Stamps up to three tenths of a period late.
pub(super) fn jittered(period_s: f64, seconds: f64, seed: u64) -> Vec<f64> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let late = Uniform::new(0.0, 0.3 * period_s).unwrap();
    every(period_s, seconds).into_iter().map(|time_s| time_s + late.sample(&mut random)).collect()
}

/// `model` under an input at the given instants, without noise.
pub(super) fn simulated(
    model: &Model,
    input: Input,
    events: Vec<(f64, f64)>,
    times: Vec<f64>,
) -> Scenario {
    let channel = match input {
        Input::Torque => Channel::Torque,
        _ => Channel::Voltage,
    };
    let mut scenario = Scenario::planned("r", input, channel, events, times);
    let out = Plant::new(model, input).unwrap().simulate(&scenario, State::default());
    (scenario.current_a, scenario.speed_rad_s) = (out.current_a, out.speed_rad_s);
    scenario
}

pub(super) fn noisy(values: &[f64], sigma: f64, random: &mut ChaCha8Rng) -> Vec<f64> {
    let noise = Normal::new(0.0, sigma).unwrap();
    values.iter().map(|value| value + noise.sample(random)).collect()
}

pub(super) fn run_of<const N: usize>(times: Vec<f64>, columns: [(Channel, Vec<f64>); N]) -> Run {
    let mut run = Run::new("r", times).unwrap();
    for (channel, cells) in columns {
        put(&mut run, channel, cells);
    }
    run
}

pub(super) fn put(run: &mut Run, channel: Channel, cells: Vec<f64>) {
    run.set_column(channel, cells, Origin::Measured).unwrap();
}

/// The run with each cell of a column changed by its row and value.
pub(super) fn changed(run: &Run, channel: Channel, cell: impl Fn(usize, f64) -> f64) -> Run {
    let cells = run.column(channel).unwrap().iter().enumerate();
    let cells = cells.map(|(row, value)| cell(row, *value)).collect();
    let mut other = run.clone();
    put(&mut other, channel, cells);
    other
}

/// The run of a drive of which a limit let 60 % of the commands of that time through; reported until the next one.
pub(super) fn limited(run: &Run, within_s: std::ops::Range<f64>) -> Run {
    let times = run.time_s();
    let commanded = |row: usize, volts: f64| {
        let share = if within_s.contains(&times[row]) { 0.6 } else { 1.0 };
        volts / share
    };
    let mut out = changed(run, Channel::VoltageCmd, commanded);
    let until_s = within_s.end + 0.15;
    let rows = 0..run.rows();
    let rows = rows.filter(|row| (within_s.start..until_s).contains(&times[*row]));
    out.set_limited_rows(rows.collect());
    out
}

/// The run that a scenario was recorded as: voltage as applied, current and speed as measured.
pub(super) fn recorded(scenario: &Scenario) -> Run {
    let times = scenario.sample_time_s.clone();
    let volts = times.iter().map(|time_s| scenario.input_at(*time_s + 1e-9));
    let volts = volts.collect();
    run_of(
        times,
        [
            (Channel::Voltage, volts),
            (Channel::Current, scenario.current_a.clone()),
            (Channel::Speed, scenario.speed_rad_s.clone()),
        ],
    )
}

/// The run with these of its columns.
pub(super) fn only<const N: usize>(run: &Run, channels: [Channel; N]) -> Run {
    let column = |channel| (channel, run.column(channel).unwrap().to_vec());
    run_of(run.time_s().to_vec(), channels.map(column))
}

/// Takes every command and sample of a record in the order of time, commands as rows of their own.
pub(super) fn in_order(
    events: &[(f64, f64)],
    times: &[f64],
    [current, speed]: [&[f64]; 2],
    mut take: impl FnMut(Sample),
) {
    let mut events = events.iter().peekable();
    for (k, &time_s) in times.iter().enumerate() {
        while let Some(&(at_s, volts)) = events.next_if(|event| event.0 <= time_s) {
            take(Sample::at(at_s).with(Channel::VoltageCmd, volts));
        }
        take(Sample::at(time_s).with(Channel::Current, current[k]).with(Channel::Speed, speed[k]));
    }
}

/// What the motor does, without noise.
#[derive(Clone)]
pub(super) struct Record {
    pub(super) events: Vec<(f64, f64)>,
    pub(super) times: Vec<f64>,
    pub(super) current: Vec<f64>,
    pub(super) speed: Vec<f64>,
}

impl Record {
    pub(super) fn of(model: &Model, events: Vec<(f64, f64)>, times: Vec<f64>) -> Self {
        let out = simulated(model, Input::Voltage, events, times);
        Self {
            events: out.events,
            times: out.sample_time_s,
            current: out.current_a,
            speed: out.speed_rad_s,
        }
    }

    /// Current and speed with the noise of a seed, then the registers' 1 mA and 0.01 rad/s.
    pub(super) fn noisy(&self, seed: u64) -> [Vec<f64>; 2] {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut read = |values: &[f64], sigma: f64, quantum: f64| -> Vec<f64> {
            let values = noisy(values, sigma, &mut random);
            values.iter().map(|x| (x / quantum).round() * quantum).collect()
        };
        [read(&self.current, CURRENT_NOISE_A, 1e-3), read(&self.speed, SPEED_NOISE_RAD_S, 0.01)]
    }

    /// The run of a seed, without one as simulated; commands on rows of their own.
    pub(super) fn run(&self, seed: Option<u64>) -> Run {
        let [current, speed] = seed
            .map_or_else(|| [self.current.clone(), self.speed.clone()], |seed| self.noisy(seed));
        let mut rows: Vec<(f64, [f64; 3])> = Vec::new();
        in_order(&self.events, &self.times, [&current, &speed], |sample| {
            let cell = |channel| sample.get(channel).unwrap_or(f64::NAN);
            let cells = [Channel::VoltageCmd, Channel::Current, Channel::Speed].map(cell);
            let same_row = |last: &&mut (f64, _)| last.0.total_cmp(&sample.time_s).is_eq();
            match rows.last_mut().filter(same_row) {
                Some(last) => (last.1[1], last.1[2]) = (cells[1], cells[2]),
                None => rows.push((sample.time_s, cells)),
            }
        });
        let column = |k: usize| rows.iter().map(|row| row.1[k]).collect();
        let times = rows.iter().map(|row| row.0).collect();
        let mut run = run_of(times, [(Channel::Current, column(1)), (Channel::Speed, column(2))]);
        run.set_column(Channel::VoltageCmd, column(0), Origin::Commanded).unwrap();
        run
    }
}

/// All have values within a relative distance of the truth.
#[track_caller]
pub(super) fn assert_all(name: &str, found: &[ParameterEstimate], truth: &Truth, within: f64) {
    for (own, truth) in found.iter().zip(truth) {
        let is_near = own.value.is_some_and(|value| (value / truth - 1.0).abs() < within);
        assert!(is_near, "{name}: {own:?}");
    }
}

#[track_caller]
pub(super) fn of<'a>(parameters: &'a [ParameterEstimate], key: &str) -> &'a ParameterEstimate {
    ParameterEstimate::find(parameters, key).unwrap_or_else(|| panic!("no {key}"))
}

#[track_caller]
pub(super) fn judged<'a>(
    parameters: &'a [ParameterEstimate],
    key: &str,
    verdict: Verdict,
) -> &'a ParameterEstimate {
    let found = of(parameters, key);
    assert_eq!(found.verdict, verdict, "{found:?}");
    found
}

#[track_caller]
pub(super) fn assert_says(found: &ParameterEstimate, words: &[&str]) {
    let reason = found.reason.as_deref().unwrap_or_default();
    let says = !reason.is_empty() && words.iter().all(|word| reason.contains(word));
    assert!(says, "{words:?} {found:?}");
}

pub(super) fn identify(id: &str, run: &Run, model: &Model) -> Result<Identified, IdentifyError> {
    let scenario = &Scenario::from_run(run).unwrap();
    let data = Data { run, scenario, model };
    scheme::find(id).unwrap().identify(&data)
}

#[track_caller]
pub(super) fn assert_near(found: f64, truth: f64, within: f64) {
    let off = found / truth - 1.0;
    assert!(off.abs() < within, "{found} is {off} off {truth}, allowed {within}");
}

/// Within a relative distance of the truth, and within four of its own deviations.
#[track_caller]
pub(super) fn assert_found(parameters: &[ParameterEstimate], key: &str, truth: f64, within: f64) {
    assert_covers(of(parameters, key), truth, within, 4.0);
}

/// Within a relative distance of the truth, and within so many of its own deviations.
#[track_caller]
pub(super) fn assert_covers(found: &ParameterEstimate, truth: f64, within: f64, deviations: f64) {
    let (value, std) = (found.value.unwrap(), found.std.unwrap());
    let near = (value / truth - 1.0).abs() < within && (value - truth).abs() < deviations * std;
    assert!(near, "{within} {found:?} {truth}");
}

/// Whether the interval of a parameter that has a value holds the truth.
pub(super) fn covers(parameter: &ParameterEstimate, truth: f64, sigmas: f64) -> bool {
    (parameter.value.unwrap() - truth).abs() <= sigmas * parameter.std.unwrap()
}

/// Bias, spread, reported deviation (all relative) and share of covered truths, over seeds.
#[derive(Debug)]
pub(super) struct Statistics<const N: usize> {
    pub(super) bias: [f64; N],
    pub(super) spread: [f64; N],
    pub(super) claimed: [f64; N],
    pub(super) covered: [f64; N],
    /// Seeds of which an estimate has no value.
    pub(super) missing: usize,
}

impl<const N: usize> Statistics<N> {
    pub(super) fn over<'a>(
        seeds: impl ExactSizeIterator<Item = &'a Vec<ParameterEstimate>>,
        truth: &[f64; N],
    ) -> Self {
        let all = seeds.len();
        let rows = seeds.filter_map(|estimates| {
            let mut row = [[0.0; 2]; N];
            for (k, truth) in truth.iter().enumerate() {
                row[k] = [estimates[k].value? / truth - 1.0, estimates[k].std? / truth];
            }
            Some(row)
        });
        let rows: Vec<[[f64; 2]; N]> = rows.collect();
        let count = rows.len() as f64;
        let over = |f: &dyn Fn(&[f64; 2]) -> f64| -> [f64; N] {
            std::array::from_fn(|k| rows.iter().map(|row| f(&row[k])).sum::<f64>() / count)
        };
        let bias = over(&|row| row[0]);
        let squares = over(&|row| row[0] * row[0]);
        Self {
            bias,
            spread: std::array::from_fn(|k| (squares[k] - bias[k] * bias[k]).sqrt()),
            claimed: over(&|row| row[1]),
            covered: over(&|row| f64::from(u8::from(row[0].abs() < 1.96 * row[1]))),
            missing: all - rows.len(),
        }
    }
}
