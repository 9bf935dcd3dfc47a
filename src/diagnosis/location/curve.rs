//! The axis map: what the error of each equation follows, as a curve, before it has a name.
//!
//! The errors of the windows over hat functions along speed, current, voltage and time, over harmonics of the angle, and
//! over one line in the spectrum. The current is no axis of the torque balance and the voltage none of the voltage
//! balance: they are what the balance is solved for. A part of a curve that a parameter of the motor explains as well is
//! left to that parameter.

use std::f64::consts::TAU;

use nalgebra::{DMatrix, DVector};
use serde::Serialize;

use super::axis::{HATS_OF_TIME, Search, hat};
use super::windows::{WINDOW_OF_A_CURVE_S, Windows, own_keys};
use super::{name, unit};
use crate::identification::noise::NoiseFloor;
use crate::identification::output_error::{BLOCK_S, FitError};
use crate::numerics::count::whole;
use crate::numerics::least_squares;
use crate::plant::effect::Axis;
use crate::plant::{Balance, Input, Model, Scenario};
use crate::text::number::significant;

/// Harmonics of the angle, and the knots at which the curve over a turn is given.
const HARMONICS: usize = 4;
const KNOTS_OF_A_TURN: usize = 16;
/// Share of the range that two knots of a refined curve are apart at least, and the knots that a curve has.
const CLOSEST_SHARE: f64 = 0.01;
const FEWEST_KNOTS: usize = 3;
const FIRST_KNOTS: usize = 14;
const MOST_KNOTS: usize = 32;
/// Rounds of refining, and what each must add to the share that is explained.
const ROUNDS: usize = 5;
const WORTH_REFINING_SHARE: f64 = 0.004;
/// Share of an average knot's data below which a knot is left out: the run was never there, or did not move.
const LEAST_DATA_SHARE: f64 = 0.02;
/// Standard deviations from which on a value counts as found.
const FOUND_SIGMAS: f64 = 3.0;
/// Adjusted R2 from which on an error is said to follow an axis.
const FOLLOWS_SHARE: f64 = 0.1;
/// Power of a line that the next one may have for it to be a line of its own: an error that goes with the excitation has
/// many lines, and none is its cause.
const ALONE_SHARE: f64 = 0.5;

/// How far the error of one equation follows one axis, and the curve.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct AxisMap {
    /// `torque` or `voltage`.
    pub equation: &'static str,
    /// `speed_rad_s`, `current_a`, `voltage_v`, `angle_rad`, `time_s` (since the run's first command), or
    /// `frequency_hz`: a line in the spectrum of the torque error.
    pub axis: &'static str,
    /// Adjusted share of the error's variance that follows the axis.
    pub r2: f64,
    /// Places on the axis; of a line its frequency.
    pub knots: Vec<f64>,
    /// What the equation lacks there, V or N.m, a loss counted positive; of a line its amplitude.
    pub values: Vec<f64>,
    /// Standard deviation of each value, clustered in blocks of time.
    pub std: Vec<f64>,
    /// `weak_form` of the difference between measurement and model.
    pub method: &'static str,
    /// The equation's residual over what measurement noise alone would leave; `None` where the noise is not known.
    pub error_over_noise: Option<f64>,
    pub sentence: String,
}

impl AxisMap {
    /// Whether so much of the error follows the axis that it is worth a word.
    pub fn is_followed(&self) -> bool {
        self.r2 >= FOLLOWS_SHARE
    }
}

/// The maps of both balances, those that explain most first.
///
/// # Errors
/// As the free run of `model`, which must be complete.
pub fn axis_map(
    model: &Model,
    scenario: &Scenario,
    noise: &NoiseFloor,
) -> Result<Vec<AxisMap>, FitError> {
    let windows = Windows::new(model, scenario, noise, WINDOW_OF_A_CURVE_S)?.without_reversals();
    let mut maps = Vec::new();
    for equation in [Balance::Voltage, Balance::Torque] {
        let search = Search {
            windows: &windows,
            equation,
            own: 0,
        };
        let Some(error) = Error::of(&search) else {
            continue;
        };
        let axes = axes(equation, scenario.input).iter();
        maps.extend(axes.filter_map(|axis| error.map(*axis)));
        if equation == Balance::Torque {
            maps.extend(error.line());
        }
    }
    maps.sort_by(|a, b| b.r2.total_cmp(&a.r2));
    Ok(maps)
}

/// The axes of a balance. The input of a run that is driven by current or torque is what its balance is solved for.
fn axes(equation: Balance, input: Input) -> &'static [Axis] {
    match (equation, input) {
        (Balance::Voltage, Input::Voltage) => {
            &[Axis::Speed, Axis::Current, Axis::Angle, Axis::Time]
        }
        (Balance::Voltage, _) => &[],
        (Balance::Torque, Input::Voltage) => &[Axis::Speed, Axis::Voltage, Axis::Angle, Axis::Time],
        (Balance::Torque, _) => &[Axis::Speed, Axis::Angle, Axis::Time],
    }
}

/// The errors of all windows of an equation, with what the motor's own parameters would explain of them.
struct Error<'a> {
    search: &'a Search<'a>,
    own: DMatrix<f64>,
    own_inverse: DMatrix<f64>,
    /// What they leave.
    residual: DVector<f64>,
    blocks: Vec<usize>,
    over_noise: Option<f64>,
}

/// A curve with what it explains.
struct Curve {
    r2: f64,
    knots: Vec<f64>,
    values: Vec<f64>,
    std: Vec<f64>,
}

fn matrix(rows: &[Vec<f64>]) -> DMatrix<f64> {
    DMatrix::from_fn(rows.len(), rows[0].len(), |row, column| rows[row][column])
}

impl<'a> Error<'a> {
    fn of(search: &'a Search<'a>) -> Option<Self> {
        let equation = search.equation;
        let k = own_keys(equation).len();
        let rows = search.rows(k, |window, row| {
            row.copy_from_slice(&window.own(equation)[..k]);
        });
        let begin_s = search.of().next()?.time_s;
        if rows.len() <= k {
            return None;
        }
        let own = matrix(&rows);
        let (own_inverse, _) = least_squares::inverse_where_determined(&own);
        let each = search.of().map(|window| window.error(equation));
        let right = DVector::from_iterator(rows.len(), each);
        let residual = &right - &own * (&own_inverse * own.tr_mul(&right));
        let variance = residual.norm_squared() / (rows.len() - k) as f64;
        let floor: f64 = search
            .of()
            .map(|window| window.floor(equation).powi(2))
            .sum();
        let floor = (floor / rows.len() as f64).sqrt();
        Some(Self {
            search,
            own,
            own_inverse,
            residual,
            blocks: (search.of())
                .map(|window| whole((window.time_s - begin_s) / BLOCK_S))
                .collect(),
            over_noise: (floor > 0.0).then(|| variance.sqrt() / floor),
        })
    }

    /// Fits `rows` to the error. They count only with what the motor's parameters cannot explain as well; directions that
    /// are then lost (a curve over the current that is a resistance) stay at zero. The values are those of `shape`, knot by
    /// knot, times the coefficients.
    fn explained(&self, rows: &[Vec<f64>], knots: Vec<f64>, shape: &DMatrix<f64>) -> Option<Curve> {
        let columns = matrix(rows);
        let added = columns.ncols();
        if rows.len() <= self.own.ncols() + added {
            return None;
        }
        let beside = &columns - &self.own * (&self.own_inverse * self.own.tr_mul(&columns));
        let (inverse, _) = least_squares::inverse_where_determined(&beside);
        let coefficients = &inverse * beside.tr_mul(&self.residual);
        let left = &self.residual - &beside * &coefficients;
        let spare = (rows.len() - self.own.ncols()) as f64;
        let variance = self.residual.norm_squared() / spare;
        let r2 = 1.0 - left.norm_squared() / (spare - added as f64) / variance;
        let known = vec![true; added];
        let covariance = least_squares::clustered(&beside, &left, &self.blocks, inverse, &known);
        let covariance = shape * covariance * shape.transpose();
        let std = covariance
            .diagonal()
            .map(|variance| variance.max(0.0).sqrt());
        r2.is_finite().then(|| Curve {
            r2,
            knots,
            values: (shape * coefficients).as_slice().to_vec(),
            std: std.as_slice().to_vec(),
        })
    }

    fn map(&self, axis: Axis) -> Option<AxisMap> {
        let scenario = self.search.windows.scenario;
        let times = scenario.sample_time_s.iter();
        let values = match axis {
            Axis::Speed => scenario.speed_rad_s.clone(),
            Axis::Current => scenario.current_a.clone(),
            Axis::Angle => self.search.angle_at_samples()?,
            Axis::Time => times.map(|time_s| time_s - scenario.begin_s()).collect(),
            Axis::Voltage => times.map(|time_s| scenario.input_at(*time_s)).collect(),
        };
        let curve = match axis {
            Axis::Angle => self.turn(&values)?,
            _ => self.hats(axis, &values)?,
        };
        let sentence = sentence(self.search.equation, axis, scenario, &curve);
        Some(self.named(axis.key(), curve, sentence))
    }

    fn named(&self, axis: &'static str, curve: Curve, sentence: String) -> AxisMap {
        AxisMap {
            equation: name(self.search.equation),
            axis,
            r2: curve.r2,
            knots: curve.knots,
            values: curve.values,
            std: curve.std,
            method: "weak_form",
            error_over_noise: self.over_noise,
            sentence,
        }
    }

    /// Harmonics over a turn.
    fn turn(&self, angles: &[f64]) -> Option<Curve> {
        let rows = self
            .search
            .averaged(angles, 2 * HARMONICS, |angle, weight, row| {
                for (cell, wave) in row.iter_mut().zip(harmonics(angle)) {
                    *cell += weight * wave;
                }
            });
        let step = TAU / KNOTS_OF_A_TURN as f64;
        let knots: Vec<f64> = (0..KNOTS_OF_A_TURN)
            .map(|knot| knot as f64 * step)
            .collect();
        let shape = DMatrix::from_fn(knots.len(), 2 * HARMONICS, |knot, column| {
            harmonics(knots[knot])[column]
        });
        self.explained(&rows, knots, &shape)
    }

    /// Hat functions along an axis, finer where the curve bends. Where nothing is followed a finer curve would follow noise.
    fn hats(&self, axis: Axis, values: &[f64]) -> Option<Curve> {
        let search = self.search;
        let rows = |knots: &[f64]| {
            let put = |value, weight, row: &mut [f64]| hat(knots, value, weight, row);
            search.averaged(values, knots.len(), put)
        };
        let fit = |knots: Vec<f64>| {
            let knots = with_data(&rows(&knots), knots);
            let shape = DMatrix::identity(knots.len(), knots.len());
            let is_curve = knots.len() >= FEWEST_KNOTS;
            is_curve.then(|| self.explained(&rows(&knots), knots, &shape))?
        };
        let is_time = axis == Axis::Time;
        let mut best = fit(first_knots(values, is_time)?)?;
        let refines = !is_time && best.r2 >= FOLLOWS_SHARE;
        for _ in 0..if refines { ROUNDS } else { 0 } {
            match refined(&best).and_then(&fit) {
                Some(finer) if finer.r2 >= best.r2 + WORTH_REFINING_SHARE => best = finer,
                _ => break,
            }
        }
        Some(best)
    }

    fn line(&self) -> Option<AxisMap> {
        let line = self.search.strongest_line()?;
        let rows = self.search.rows(2, |window, row| {
            row.copy_from_slice(&line.wave(window.time_s));
        });
        let shape = DMatrix::identity(2, 2);
        let wave = self.explained(&rows, vec![line.frequency_hz], &shape)?;
        let amplitude = wave.values[0].hypot(wave.values[1]);
        let std = (0..2)
            .map(|k| (wave.values[k] * wave.std[k]).powi(2))
            .sum::<f64>()
            .sqrt();
        // The best of many frequencies explains something of any noise: as many columns more as that is worth.
        let spare = (rows.len() - self.own.ncols()) as f64;
        let chance = 2.0 * (line.tried as f64).ln().max(0.0);
        let r2 = 1.0 - (1.0 - wave.r2) * spare / (spare - chance);
        let found = Curve {
            r2,
            knots: wave.knots,
            values: vec![amplitude / line.seen],
            std: vec![std / amplitude / line.seen],
        };
        let sentence = if r2 < FOLLOWS_SHARE || line.next_share > ALONE_SHARE {
            "no single line stands out in the spectrum of the torque error".to_owned()
        } else {
            format!(
                "{:.0} % of the torque error is a line at {} Hz with an amplitude of {} N.m",
                100.0 * r2,
                significant(line.frequency_hz, 3),
                significant(found.values[0], 3)
            )
        };
        Some(self.named("frequency_hz", found, sentence))
    }
}

/// Knots over what the run reached: half way between even spacing and as many samples between each two, so that a curve is
/// asked for where the run was seldom, too; over time evenly.
fn first_knots(values: &[f64], is_time: bool) -> Option<Vec<f64>> {
    let mut sorted: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
    sorted.sort_by(f64::total_cmp);
    let (first, last) = (*sorted.first()?, *sorted.last()?);
    let steps = if is_time { HATS_OF_TIME } else { FIRST_KNOTS } - 1;
    let knot = |k: usize| {
        let even = first + (last - first) * k as f64 / steps as f64;
        let quantile = sorted[k * (sorted.len() - 1) / steps];
        if is_time {
            even
        } else {
            0.5 * (quantile + even)
        }
    };
    let mut knots: Vec<f64> = (0..=steps).map(knot).collect();
    knots.dedup_by(|later, earlier| *later - *earlier <= CLOSEST_SHARE * (last - first));
    Some(knots)
}

/// The knots that the windows say something about.
fn with_data(rows: &[Vec<f64>], knots: Vec<f64>) -> Vec<f64> {
    let data = |knot: usize| rows.iter().map(|row| row[knot] * row[knot]).sum::<f64>();
    let data: Vec<f64> = (0..knots.len()).map(data).collect();
    let least = LEAST_DATA_SHARE * data.iter().sum::<f64>() / data.len() as f64;
    let kept = knots
        .into_iter()
        .zip(&data)
        .filter(|(_, data)| **data >= least);
    kept.map(|(knot, _)| knot).collect()
}

/// Knots halfway beside the two sharpest bends of a curve.
fn refined(curve: &Curve) -> Option<Vec<f64>> {
    let (knots, values) = (&curve.knots, &curve.values);
    let last = knots.len() - 1;
    let closest = CLOSEST_SHARE * (knots[last] - knots[0]);
    let slope = |at: usize| (values[at + 1] - values[at]) / (knots[at + 1] - knots[at]);
    let bend = |at: usize| (slope(at) - slope(at - 1)).abs();
    let mut bends: Vec<usize> = (1..last).collect();
    bends.sort_by(|a, b| bend(*b).total_cmp(&bend(*a)));
    let mut finer = knots.clone();
    for at in bends.into_iter().take(2) {
        for (low, high) in [(at - 1, at), (at, at + 1)] {
            let middle = 0.5 * (knots[low] + knots[high]);
            if knots[high] - knots[low] > 2.0 * closest && !finer.contains(&middle) {
                finer.push(middle);
            }
        }
    }
    finer.sort_by(f64::total_cmp);
    (finer.len() > knots.len() && finer.len() <= MOST_KNOTS).then_some(finer)
}

/// Sines and cosines of the harmonics of an angle.
fn harmonics(angle_rad: f64) -> [f64; 2 * HARMONICS] {
    std::array::from_fn(|index| {
        let (sin, cos) = ((index / 2 + 1) as f64 * angle_rad).sin_cos();
        if index % 2 == 0 { sin } else { cos }
    })
}

/// What is said of a curve: how much follows it, and the knot with the largest value that stands out from its uncertainty.
fn sentence(equation: Balance, axis: Axis, scenario: &Scenario, curve: &Curve) -> String {
    let what = name(equation);
    let along = match axis {
        Axis::Speed => "speed",
        Axis::Current => "current",
        Axis::Voltage => "voltage",
        Axis::Angle if scenario.angle.is_empty() => "angle, integrated from the speed",
        Axis::Angle => "angle",
        Axis::Time => "time",
    };
    if curve.r2 < FOLLOWS_SHARE {
        return format!("the {what} error does not follow the {along}");
    }
    let percent = 100.0 * curve.r2;
    let share = format!("{percent:.0} % of the {what} error follows the {along}");
    let (values, std) = (&curve.values, &curve.std);
    let sure = (0..values.len()).filter(|knot| values[*knot].abs() > FOUND_SIGMAS * std[*knot]);
    match sure.max_by(|a, b| values[*a].abs().total_cmp(&values[*b].abs())) {
        Some(peak) => format!(
            "{share}; it is largest near {} {}: {} {}",
            significant(curve.knots[peak], 3),
            axis.unit(),
            significant(values[peak], 3),
            unit(equation)
        ),
        None => share,
    }
}
