//! Nonparametric frequency response from a record: magnitude, phase and coherence with their intervals, and the resonances and
//! anti-resonances with their damping (Pintelon and Schoukens 2012, chapters 2, 7 and 9).
//!
//! ```text
//! Scenario -> stretches in which the shaft keeps turning -> spectrum (Fourier integrals) -+-> local_polynomial -> points
//!                                                                                         +-> rational -> modes
//! beside: the same of a model under the same voltage, and the bands in which they differ
//! ```
//!
//! The excitation needs many frequencies: a chirp, a pseudo-random sequence, a sum of sines. Coulomb friction at a reversal is
//! not linear, so that only stretches of one direction are used, as of an excitation about an offset.

mod beside;
mod local_polynomial;
mod rational;
mod spectrum;

use std::ops::Range;

use nalgebra::{Complex, Matrix2};
use rayon::prelude::*;
use serde::Serialize;
use thiserror::Error;

pub use self::beside::{Compared, Departure, compared, of_model};
use self::local_polynomial::{FREEDOM, LINES, Line, Local, SIDE, local};
use self::rational::{Lines, Pair};
use drivebench_model::numerics::count::whole;
use drivebench_model::numerics::statistics::{largest, mean, median_step};
use drivebench_model::plant::{Input, Scenario};
use drivebench_model::sample::TWO_SIDED_95;
use drivebench_model::signal::{Point, holding_since};
use drivebench_model::text::number::{shortest, with_std};

/// Least coherence of a point that the excitation determines.
pub const CARRIED: f64 = 0.8;
/// Fewest rows and seconds of a stretch.
const FEWEST_ROWS: usize = 200;
const SHORTEST_S: f64 = 1.0;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Pathway {
    VoltageToSpeed,
    VoltageToCurrent,
    /// The mechanics without the winding: the ratio of the other two.
    CurrentToSpeed,
}

impl Pathway {
    pub const ALL: [Self; 3] = [Self::VoltageToSpeed, Self::VoltageToCurrent, Self::CurrentToSpeed];

    /// Name, key as an argument names it, and unit.
    const fn labels(self) -> [&'static str; 3] {
        match self {
            Self::VoltageToSpeed => ["voltage to speed", "voltage-to-speed", "rad/s per V"],
            Self::VoltageToCurrent => ["voltage to current", "voltage-to-current", "A per V"],
            Self::CurrentToSpeed => ["current to speed", "current-to-speed", "rad/s per A"],
        }
    }

    pub const fn name(self) -> &'static str {
        self.labels()[0]
    }

    pub const fn key(self) -> &'static str {
        self.labels()[1]
    }

    pub const fn unit(self) -> &'static str {
        self.labels()[2]
    }
}

/// A pathway at one frequency; limits are of 95 % intervals.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ResponsePoint {
    pub frequency_hz: f64,
    /// In the unit of the pathway.
    pub magnitude: f64,
    pub magnitude_low: f64,
    pub magnitude_high: f64,
    /// Continued over the half turns from the lowest frequency on.
    pub phase_deg: f64,
    pub phase_half_width_deg: f64,
    /// Share of the output's power that the input explains.
    pub coherence: f64,
    /// Whether the excitation determines this point.
    pub is_carried: bool,
}

impl ResponsePoint {
    /// Half of the interval, in the logarithm of the magnitude.
    fn half_width(&self) -> f64 {
        (self.magnitude_high / self.magnitude).ln()
    }
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PathwayResponse {
    pub pathway: Pathway,
    pub unit: &'static str,
    pub points: Vec<ResponsePoint>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ModeKind {
    Resonance,
    AntiResonance,
}

impl ModeKind {
    pub const fn name(self) -> &'static str {
        match self {
            Self::Resonance => "resonance",
            Self::AntiResonance => "anti-resonance",
        }
    }
}

/// A complex pair of poles or zeros.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Mode {
    pub kind: ModeKind,
    pub pathway: Pathway,
    pub frequency_hz: f64,
    pub frequency_std_hz: f64,
    pub damping_ratio: f64,
    pub damping_std: f64,
}

impl Mode {
    /// Kind, frequency and damping, each with its 95 % interval.
    pub fn text(&self) -> String {
        let hertz = with_std(self.frequency_hz, TWO_SIDED_95 * self.frequency_std_hz);
        let damping = with_std(self.damping_ratio, TWO_SIDED_95 * self.damping_std);
        format!("{} at {hertz} Hz, damping {damping}", self.kind.name())
    }
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FrequencyResponse {
    pub pathways: Vec<PathwayResponse>,
    pub modes: Vec<Mode>,
    /// From the length of the stretches, and from the rate of their samples, Hz.
    pub lowest_hz: f64,
    pub highest_hz: f64,
    pub sampling_hz: f64,
    /// Seconds of record that were used, in how many stretches.
    pub used_s: f64,
    pub stretches: usize,
    pub cautions: Vec<String>,
}

impl FrequencyResponse {
    pub fn of(&self, pathway: Pathway) -> Option<&PathwayResponse> {
        self.pathways.iter().find(|own| own.pathway == pathway)
    }

    /// The modes of a pathway, the lowest first.
    pub fn modes_of(&self, pathway: Pathway) -> Vec<Mode> {
        let mut own: Vec<Mode> =
            self.modes.iter().filter(|mode| mode.pathway == pathway).copied().collect();
        own.sort_by(|a, b| a.frequency_hz.total_cmp(&b.frequency_hz));
        own
    }

    /// The pathway to show first: the mechanics alone where they resonate, else the first that is carried.
    pub fn telling(&self) -> Option<Pathway> {
        let mechanics = Pathway::CurrentToSpeed;
        if !self.modes_of(mechanics).is_empty() {
            return Some(mechanics);
        }
        let carried = self.pathways.iter().find(|own| !own.bands_hz().is_empty());
        carried.or(self.pathways.first()).map(|own| own.pathway)
    }

    /// Limits by the sampling rate.
    pub fn rate_sentence(&self) -> String {
        let [sampling, highest, half] =
            [self.sampling_hz, self.highest_hz, 0.5 * self.sampling_hz].map(|hz| shortest(hz, 4));
        format!(
            "sampled at {sampling} Hz: shown up to {highest} Hz; what swings above {half} Hz would appear below it"
        )
    }
}

impl PathwayResponse {
    /// Bands in which the excitation determines the response; up to three points without it do not end a band.
    pub fn bands_hz(&self) -> Vec<(f64, f64)> {
        let carried = self.points.iter().enumerate();
        let carried: Vec<(usize, f64)> = carried
            .filter(|(_, point)| point.is_carried)
            .map(|(at, point)| (at, point.frequency_hz))
            .collect();
        let bands = carried.chunk_by(|a, b| b.0 - a.0 <= 4);
        let bands = bands.filter(|band| band.len() >= 3);
        bands.map(|band| (band[0].1, band[band.len() - 1].1)).collect()
    }
}

#[derive(Clone, Debug, Error, PartialEq)]
pub enum FrequencyResponseError {
    #[error("run {run:?} has no voltage: its input is a {input} (expected a voltage)")]
    NoVoltage { run: String, input: &'static str },
    #[error("run {run:?} has a constant voltage (expected one that changes at many frequencies)")]
    Steady { run: String },
    #[error(
        "run {run:?}: {rows} samples in {seconds:.2} s (expected at least {} samples and {} s)",
        FEWEST_ROWS,
        SHORTEST_S
    )]
    Short { run: String, rows: usize, seconds: f64 },
}

impl FrequencyResponseError {
    pub const fn help(&self) -> &'static str {
        match self {
            Self::NoVoltage { .. } => "map a column with --map voltage_v=HEADER",
            Self::Steady { .. } | Self::Short { .. } => {
                "record a chirp or a prbs about an offset: chirp = { amplitude_v, offset_v, from_hz, to_hz, seconds }"
            }
        }
    }
}

/// Part of a record between two of its samples.
struct Stretch {
    /// Held input from the first sample on.
    input: Vec<Point>,
    end_s: f64,
    time_s: Vec<f64>,
    /// Median step.
    period_s: f64,
    /// Current, speed; NaN where missing.
    outputs: [Vec<f64>; 2],
}

impl Stretch {
    fn of(scenario: &Scenario, rows: &Range<usize>) -> Self {
        let time_s = scenario.sample_time_s[rows.clone()].to_vec();
        let (begin_s, end_s) = (time_s[0], time_s[time_s.len() - 1]);
        let held =
            holding_since(&scenario.events, begin_s).iter().take_while(|event| event.0 < end_s);
        let input = held.map(|&(at_s, value)| (at_s.max(begin_s), value));
        let column = |values: &[f64]| {
            let own = values.get(rows.clone()).map(<[f64]>::to_vec);
            own.unwrap_or_else(|| vec![f64::NAN; rows.len()])
        };
        Self {
            input: input.collect(),
            end_s,
            outputs: [column(&scenario.current_a), column(&scenario.speed_rad_s)],
            period_s: median_step(&time_s),
            time_s,
        }
    }

    fn length_s(&self) -> f64 {
        self.end_s - self.time_s[0]
    }

    fn is_steady(&self) -> bool {
        self.input.windows(2).all(|pair| pair[0].1.to_bits() == pair[1].1.to_bits())
    }

    fn line(&self, frequency_hz: f64) -> Line {
        let output = |values: &Vec<f64>| spectrum::of_samples(&self.time_s, values, frequency_hz);
        let [current, speed] = spectrum::between_samples(frequency_hz * self.period_s);
        Line {
            input: spectrum::of_held(&self.input, self.end_s, frequency_hz),
            outputs: [output(&self.outputs[0]) * current, output(&self.outputs[1]) * speed],
        }
    }

    /// From the lines of whole periods nearest to the frequency, which the mean (large about an offset) does not leak into. `None`
    /// where there are too few lines below it.
    fn local(&self, frequency_hz: f64) -> Option<Local> {
        let length_s = self.length_s();
        let periods = frequency_hz * length_s;
        let middle = periods.round();
        if middle < (SIDE + 1) as f64 {
            return None;
        }
        let near_hz: [f64; LINES] =
            std::array::from_fn(|line| (middle + line as f64 - SIDE as f64) / length_s);
        local(&near_hz.map(|hertz| self.line(hertz)), periods - middle)
    }
}

/// Stretches of rows in which the shaft turns in one direction, or the whole scenario where none is long enough; and whether one
/// is. Long stretches are divided.
fn stretches(scenario: &Scenario) -> (Vec<Range<usize>>, bool) {
    let (speed, time_s) = (&scenario.speed_rad_s, &scenario.sample_time_s);
    // Below it a shaft counts as reversing.
    let slow_rad_s = 0.02 * largest(speed);
    let mut found: Vec<Range<usize>> = Vec::new();
    let mut open: Option<(usize, f64)> = None;
    for row in 0..=time_s.len() {
        let now = speed.get(row).copied().unwrap_or(0.0);
        let is_missing = row < time_s.len() && !now.is_finite();
        let turns = now.abs() > slow_rad_s;
        if is_missing || open.is_some_and(|(_, sign)| turns && now * sign > 0.0) {
            continue;
        }
        found.extend(open.take().map(|(from, _)| from..row));
        open = turns.then(|| (row, now.signum()));
    }
    let seconds = |rows: &Range<usize>| time_s[rows.end - 1] - time_s[rows.start];
    found.retain(|rows| rows.len() >= FEWEST_ROWS && seconds(rows) >= SHORTEST_S);
    let longest = found.iter().map(seconds).fold(0.0, f64::max);
    // Much shorter stretches have a coarser resolution and begin at a higher frequency.
    found.retain(|rows| seconds(rows) >= 0.5 * longest);
    let keeps_turning = !found.is_empty();
    if !keeps_turning {
        found.push(0..time_s.len());
    }
    let cut = found.into_iter().flat_map(|rows| {
        let parts = rows.len().div_ceil(16_384);
        let size = rows.len().div_ceil(parts.max(1));
        (0..parts).map(move |part| {
            let from = rows.start + part * size;
            from..(from + size).min(rows.end)
        })
    });
    // Twelve are enough for the average.
    (cut.take(12).collect(), keeps_turning)
}

/// The response of what was measured in `scenarios`, all of one plant.
pub fn frequency_response(
    scenarios: &[Scenario],
) -> Result<FrequencyResponse, FrequencyResponseError> {
    response_over(scenarios, scenarios)
}

/// That of `scenarios` over the stretches in which the shaft of `turning` keeps turning: of the same records, in which
/// something else stands in the place of what was measured.
fn response_over(
    scenarios: &[Scenario],
    turning: &[Scenario],
) -> Result<FrequencyResponse, FrequencyResponseError> {
    let mut all = Vec::new();
    let mut cautions = Vec::new();
    for (scenario, turning) in scenarios.iter().zip(turning) {
        let run = || scenario.name.clone();
        if scenario.input != Input::Voltage {
            let input = scenario.input_channel.name();
            return Err(FrequencyResponseError::NoVoltage { run: run(), input });
        }
        let time_s = &scenario.sample_time_s;
        let seconds = time_s.first().zip(time_s.last()).map_or(0.0, |(first, last)| last - first);
        if time_s.len() < FEWEST_ROWS || seconds < SHORTEST_S {
            let rows = time_s.len();
            return Err(FrequencyResponseError::Short { run: run(), rows, seconds });
        }
        let (rows, keeps_turning) = stretches(turning);
        if !keeps_turning {
            cautions.push(format!(
                "{}: the shaft never turns in one direction for {} s; its Coulomb friction, which changes sign with the speed, is in the response (an excitation about an offset avoids it)",
                scenario.name, SHORTEST_S
            ));
        }
        let before = all.len();
        let made = rows.iter().map(|rows| Stretch::of(scenario, rows));
        all.extend(made.filter(|stretch| !stretch.is_steady()));
        if all.len() == before {
            return Err(FrequencyResponseError::Steady { run: run() });
        }
    }
    Ok(Estimator::over(all).response(cautions))
}

/// Pooled estimate of both outputs at a frequency.
struct Pooled {
    response: [Complex<f64>; 2],
    covariance: Matrix2<Complex<f64>>,
    coherence: [f64; 2],
}

struct Estimator {
    stretches: Vec<Stretch>,
    frequencies_hz: Vec<f64>,
    has: [bool; 2],
    period_s: f64,
    lowest_hz: f64,
    highest_hz: f64,
}

impl Estimator {
    fn over(stretches: Vec<Stretch>) -> Self {
        let has = [0, 1].map(|output| {
            stretches.iter().flat_map(|own| &own.outputs[output]).any(|value| value.is_finite())
        });
        let period_s = stretches.iter().map(|stretch| stretch.period_s).fold(0.0, f64::max);
        let longest_s = stretches.iter().map(Stretch::length_s).fold(0.0, f64::max);
        let apart_hz = 1.0 / longest_s;
        let lowest_hz = (SIDE + 1) as f64 * apart_hz;
        // Above it too little separates a response from its image.
        let highest_hz = 0.3 / period_s;
        // 100 points a decade.
        let factor = 10.0_f64.powf(1.0 / 100.0);
        let next = |hertz: &f64| {
            let lines = (hertz * factor / apart_hz).round();
            Some((lines * apart_hz).max(hertz + apart_hz))
        };
        let frequencies_hz = std::iter::successors(Some(lowest_hz), next)
            .take_while(|hertz| *hertz <= highest_hz)
            .collect();
        Self { stretches, frequencies_hz, has, period_s, lowest_hz, highest_hz }
    }

    fn response(&self, mut cautions: Vec<String>) -> FrequencyResponse {
        let locals: Vec<Vec<Option<Local>>> = self
            .frequencies_hz
            .par_iter()
            .map(|hertz| self.stretches.iter().map(|own| own.local(*hertz)).collect())
            .collect();
        let pooled: Vec<Option<Pooled>> = locals.iter().map(|at| Self::pooled(at)).collect();
        let pathways = Pathway::ALL.into_iter().filter(|pathway| match pathway {
            Pathway::VoltageToSpeed => self.has[1],
            Pathway::VoltageToCurrent => self.has[0],
            Pathway::CurrentToSpeed => self.has[0] && self.has[1],
        });
        let pathways: Vec<PathwayResponse> = pathways
            .map(|pathway| PathwayResponse {
                pathway,
                unit: pathway.unit(),
                points: self.points(pathway, &pooled),
            })
            .collect();
        let modes = self.modes(&locals, &pathways);
        let sampling_hz = 1.0 / self.period_s;
        if !pathways.iter().flat_map(|pathway| &pathway.points).any(|point| point.is_carried) {
            cautions.push(format!(
                "no frequency has a coherence of {CARRIED}: the excitation is too weak, or current and speed do not follow it"
            ));
        }
        FrequencyResponse {
            pathways,
            modes,
            lowest_hz: self.lowest_hz,
            highest_hz: self.highest_hz,
            sampling_hz,
            used_s: self.stretches.iter().map(Stretch::length_s).sum(),
            stretches: self.stretches.len(),
            cautions,
        }
    }

    /// Relative uncertainty of a response by the motion between the samples: a quarter of the correction, since a command need not
    /// be constant from sample to sample.
    fn intersample_error(&self, frequency_hz: f64) -> f64 {
        let [current, _] = spectrum::between_samples(frequency_hz * self.period_s);
        0.25 * (1.0 - current)
    }

    /// The stretches together, each output weighed by its variance.
    fn pooled(at: &[Option<Local>]) -> Option<Pooled> {
        let known: Vec<&Local> = at.iter().flatten().collect();
        if known.is_empty() {
            return None;
        }
        let shares = [0, 1].map(|output| {
            let weight = |local: &&Local| {
                let variance = local.covariance[(output, output)].re;
                1.0 / variance.max(f64::MIN_POSITIVE)
            };
            let weights: Vec<f64> = known.iter().map(weight).collect();
            let sum: f64 = weights.iter().sum();
            weights.into_iter().map(|weight| weight / sum).collect::<Vec<f64>>()
        });
        let response = [0, 1].map(|output| {
            let parts = known.iter().zip(&shares[output]);
            parts.map(|(local, share)| local.response[output] * *share).sum()
        });
        let covariance = Matrix2::from_fn(|a, b| {
            let parts = known.iter().zip(shares[a].iter().zip(&shares[b]));
            parts.map(|(local, (one, other))| local.covariance[(a, b)] * (one * other)).sum()
        });
        let coherence = [0, 1].map(|output| {
            let explained: f64 = known.iter().map(|local| local.explained[output]).sum();
            let noise: f64 = known.iter().map(|local| local.noise[output]).sum();
            if explained > 0.0 { explained / (explained + noise) } else { 0.0 }
        });
        Some(Pooled { response, covariance, coherence })
    }

    fn points(&self, pathway: Pathway, pooled: &[Option<Pooled>]) -> Vec<ResponsePoint> {
        let mut before: Option<f64> = None;
        let all = self.frequencies_hz.iter().zip(pooled);
        let points = all.filter_map(|(&frequency_hz, pooled)| {
            let pooled = pooled.as_ref()?;
            let [current, speed] = pooled.response;
            let relative = |output: usize| {
                pooled.covariance[(output, output)].re / pooled.response[output].norm_sqr()
            };
            let one = self.intersample_error(frequency_hz);
            let (value, variance, error, coherence) = match pathway {
                Pathway::VoltageToSpeed => (speed, relative(1), one, pooled.coherence[1]),
                Pathway::VoltageToCurrent => (current, relative(0), one, pooled.coherence[0]),
                Pathway::CurrentToSpeed => {
                    let together = pooled.covariance[(1, 0)] / (speed * current.conj());
                    let variance = (relative(0) + relative(1) - 2.0 * together.re).max(0.0);
                    let coherence = pooled.coherence[0].min(pooled.coherence[1]);
                    (speed / current, variance, 2.0 * one, coherence)
                }
            };
            if !(value.re.is_finite() && value.im.is_finite() && variance.is_finite()) {
                return None;
            }
            // A complex error has half of its variance along the phasor and half across it; Student's t, two-sided 95 %, is that of
            // the ten real degrees of freedom of one stretch.
            let half_width = 2.23 * (0.5 * variance).sqrt() + error;
            let phase_deg = continued(value.arg().to_degrees(), before);
            before = Some(phase_deg);
            let magnitude = value.norm();
            Some(ResponsePoint {
                frequency_hz,
                magnitude,
                magnitude_low: magnitude * (-half_width).exp(),
                magnitude_high: magnitude * half_width.exp(),
                phase_deg,
                phase_half_width_deg: half_width.to_degrees().min(180.0),
                coherence,
                is_carried: coherence >= CARRIED && half_width <= 0.5,
            })
        });
        points.collect()
    }

    fn modes(&self, locals: &[Vec<Option<Local>>], pathways: &[PathwayResponse]) -> Vec<Mode> {
        let lines: Vec<Lines> =
            (0..self.stretches.len().min(3)).map(|stretch| self.lines(stretch, locals)).collect();
        let Some(found) = rational::fit(&lines, self.period_s) else { return Vec::new() };
        let outputs: Vec<usize> = (0..2).filter(|output| self.has[*output]).collect();
        let zeros = |output: usize| {
            let at = outputs.iter().position(|own| *own == output);
            at.map_or(&[][..], |at| found.zeros[at].as_slice())
        };
        let mode = |kind, pathway, pair: &Pair| Mode {
            kind,
            pathway,
            frequency_hz: pair.frequency_hz,
            frequency_std_hz: (self.intersample_error(pair.frequency_hz) * pair.frequency_hz)
                .hypot(pair.frequency_std_hz),
            damping_ratio: pair.damping_ratio,
            damping_std: pair.damping_std,
        };
        let (resonance, anti) = (ModeKind::Resonance, ModeKind::AntiResonance);
        let (voltage, mechanics) = (Pathway::VoltageToSpeed, Pathway::CurrentToSpeed);
        let mut modes = Vec::new();
        if self.has[1] {
            modes.extend(zeros(1).iter().map(|pair| mode(anti, voltage, pair)));
            modes.extend(found.poles.iter().map(|pair| mode(resonance, voltage, pair)));
        }
        if self.has[0] && self.has[1] {
            // Speed over current: the numerator of the current is the denominator of the mechanics.
            modes.extend(zeros(1).iter().map(|pair| mode(anti, mechanics, pair)));
            modes.extend(zeros(0).iter().map(|pair| mode(resonance, mechanics, pair)));
        }
        let shows = |mode: &Mode| {
            let own = pathways.iter().find(|own| own.pathway == mode.pathway);
            own.is_some_and(|own| has_extremum(mode, &own.points))
        };
        // More damping makes no peak; a pair of larger deviations is not known well enough to be named.
        modes.retain(|mode| {
            (self.lowest_hz..=self.highest_hz).contains(&mode.frequency_hz)
                && mode.damping_ratio > 0.0
                && mode.damping_ratio < 0.4
                && mode.frequency_std_hz < 0.05 * mode.frequency_hz
                && mode.damping_std < 0.5 * mode.damping_ratio
                && shows(mode)
        });
        modes
    }

    /// The lines of a stretch, with the noise that their neighbourhood has.
    fn lines(&self, stretch: usize, locals: &[Vec<Option<Local>>]) -> Lines {
        let own = &self.stretches[stretch];
        let apart_hz = 1.0 / own.length_s();
        let (first, last) = (self.lowest_hz / apart_hz, self.highest_hz / apart_hz);
        // For a fit of poles and zeros 1,200 lines are enough.
        let stride = (((last - first) / 1_200.0).ceil()).max(1.0);
        let count = whole(((last - first) / stride).floor());
        let frequency_hz: Vec<f64> =
            (0..=count).map(|n| (first.ceil() + n as f64 * stride) * apart_hz).collect();
        let lines: Vec<Line> = frequency_hz.par_iter().map(|hertz| own.line(*hertz)).collect();
        // Of few degrees of freedom: averaged over the neighbours. The error between the samples counts as noise too.
        let noise = |output: usize, hertz: f64, measured: Complex<f64>| {
            let at = self.frequencies_hz.partition_point(|own| *own < hertz);
            let near = at.saturating_sub(FREEDOM)..(at + FREEDOM).min(locals.len());
            let known = locals[near].iter().filter_map(|all| all[stretch].as_ref());
            let variances: Vec<f64> = known.map(|local| local.noise[output]).collect();
            let error = self.intersample_error(hertz) * measured.norm();
            mean(&variances).sqrt().hypot(error)
        };
        let outputs = (0..2).filter(|output| self.has[*output]).map(|output| {
            let measured = lines.iter().map(|line| line.outputs[output]);
            let all = frequency_hz.iter().zip(measured.clone());
            let deviation = all.map(|(hertz, measured)| noise(output, *hertz, measured));
            (measured.collect(), deviation.collect())
        });
        Lines {
            input: lines.iter().map(|line| line.input).collect(),
            outputs: outputs.collect(),
            frequency_hz,
        }
    }
}

/// Whether the measured magnitude has the peak, or the dip, of a mode beyond its intervals: a pair of roots alone may be an
/// artefact of the fit.
fn has_extremum(mode: &Mode, points: &[ResponsePoint]) -> bool {
    let index_of = |hertz: f64| points.partition_point(|point| point.frequency_hz < hertz);
    let sign = match mode.kind {
        ModeKind::Resonance => 1.0,
        ModeKind::AntiResonance => -1.0,
    };
    let least_band = 0.025;
    let band = mode.damping_ratio.max(least_band);
    let [first, last] = [1.0 - band, 1.0 + band].map(|factor| index_of(mode.frequency_hz * factor));
    let height = |point: &ResponsePoint| sign * point.magnitude.ln();
    let near = points.get(first..=last).into_iter().flatten();
    let Some(top) = near.max_by(|a, b| height(a).total_cmp(&height(b))) else { return false };
    // The sides lie three dampings away.
    let distance = (3.0 * mode.damping_ratio).clamp(2.0 * least_band, 0.6);
    let sides =
        [1.0 - distance, 1.0 / (1.0 - distance)].map(|factor| index_of(mode.frequency_hz * factor));
    let [Some(below), Some(above)] = sides.map(|at| points.get(at)) else { return false };
    let contrast = height(top) - 0.5 * (height(below) + height(above));
    let of_sides = below.half_width().hypot(above.half_width());
    let uncertainty = top.half_width().hypot(0.5 * of_sides);
    // The output is small in a dip, and the upper side of a peak may be below the noise.
    let sides = [below, above].iter().filter(|side| side.is_carried).count();
    let is_carried = sides + usize::from(top.is_carried) >= 2;
    // At least 3 dB, as a logarithm.
    is_carried && contrast > 0.35 && contrast > uncertainty
}

/// A phase moved by whole turns to within half a turn of the one before.
fn continued(phase_deg: f64, before: Option<f64>) -> f64 {
    before.map_or(phase_deg, |before| phase_deg - 360.0 * ((phase_deg - before) / 360.0).round())
}

#[cfg(test)]
mod tests;
