//! Ordinary least squares of a balance's windowed error on linear B-splines (hat functions) over a variable, or on harmonics of
//! an angle, after the equation's own parameters are partialled out (Frisch and Waugh 1933, Lovell 1963).
//!
//! ```text
//! error of each window --.                      .--> share, certainty, curve at knots with its block-clustered deviation
//! own parameters -------- partialled out --> OLS --> what is fitted in each window
//! columns of a variable -'
//! ```
//!
//! A variable's columns are averaged over each window with its test function, so that a variable which passes through many turns
//! or amperes within one window has its true average. What the own parameters explain as well as the columns counts for neither;
//! directions that are then lost (a curve over the current that is a resistance) stay at zero.

use std::f64::consts::TAU;

use nalgebra::{Complex, DMatrix, DVector};

use super::windows::{Window, Windows, own_keys};
use drivebench_model::numerics::count::whole;
use drivebench_model::numerics::least_squares;
use drivebench_model::numerics::statistics::finite;
use drivebench_model::plant::effect::{Axis, table_weights};
use drivebench_model::plant::{Balance, Input};

/// Choices of the regression.
struct Settings {
    /// Two knots are apart by this share of what the run reached, or by the second share of their own size where that is
    /// less, for friction and a voltage drop bend near zero; at least by the third of the largest size.
    apart_share: f64,
    apart_share_of_size: f64,
    closest_share: f64,
    /// Windows between two knots.
    windows_each_knot: usize,
    /// Blocks of time for each column, without which a clustered covariance is not determined.
    blocks_each_column: f64,
    /// Rows that each column needs.
    rows_each_column: usize,
    /// Harmonics of an angle, and the knots at which the curve over a period is given.
    harmonics: usize,
    knots_of_a_turn: usize,
    /// Mean square over the windows that a harmonic has at least; one where the shaft stands.
    least_gain: f64,
    /// Periods that a line has within the run at least: what is slower is a drift.
    fewest_periods: f64,
    /// Half width of a line's foot, in periods per run.
    line_width: f64,
    /// Share of its power that the next line may have for it to stand alone.
    alone_share: f64,
    /// Windows below which no spectrum is taken.
    windows_of_spectrum: usize,
    /// Frequencies to either side of the spectrum's peak, within its resolution.
    refinement: i32,
}

const SETTINGS: Settings = Settings {
    apart_share: 1.0 / 40.0,
    apart_share_of_size: 0.5,
    closest_share: 0.004,
    windows_each_knot: 5,
    blocks_each_column: 1.5,
    rows_each_column: 3,
    harmonics: 4,
    knots_of_a_turn: 16,
    least_gain: 0.1,
    fewest_periods: 4.0,
    line_width: 2.0,
    alone_share: 0.5,
    windows_of_spectrum: 64,
    refinement: 12,
};

/// What an error may depend on as a curve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Variable {
    Axis(Axis),
    CurrentRate,
    Acceleration,
    VoltageRate,
}

impl Variable {
    /// Those on which an error, or what an effect does, may depend. The variable that a balance is solved for is none where only the
    /// error is known: every missing effect correlates with it.
    pub(super) fn of(equation: Balance, input: Input, has_effect: bool) -> Vec<Self> {
        let mut found =
            vec![Self::Axis(Axis::Speed), Self::Axis(Axis::Time), Self::Axis(Axis::Angle)];
        if input == Input::Voltage {
            if equation == Balance::Voltage || has_effect {
                found.extend([Self::Axis(Axis::Current), Self::CurrentRate]);
            }
            if equation == Balance::Torque || has_effect {
                found.push(Self::Axis(Axis::Voltage));
            }
            if equation == Balance::Voltage {
                found.push(Self::VoltageRate);
            }
        }
        if has_effect {
            found.push(Self::Acceleration);
        }
        found
    }

    pub(super) const fn key(self) -> &'static str {
        match self {
            Self::Axis(axis) => axis.key(),
            Self::CurrentRate => "current_rate_a_s",
            Self::Acceleration => "acceleration_rad_s2",
            Self::VoltageRate => "voltage_rate_v_s",
        }
    }

    pub(super) const fn unit(self) -> &'static str {
        match self {
            Self::Axis(axis) => axis.unit(),
            Self::CurrentRate => "A/s",
            Self::Acceleration => "rad/s2",
            Self::VoltageRate => "V/s",
        }
    }
}

/// Values of a variable.
enum Values {
    OfSamples(Vec<f64>),
    /// Of a rate, which only a window has.
    OfWindows(fn(&Window) -> f64),
}

/// Columns of a variable, a row for each window of the regression.
pub(super) struct Basis {
    /// Mean of the variable in each window; of an angle that of its middle.
    pub places: Vec<f64>,
    pub rows: Vec<Vec<f64>>,
    pub knots: Vec<f64>,
    /// Values of the columns at the knots.
    shape: DMatrix<f64>,
}

/// The regression of one error on columns.
pub(super) struct Fit {
    /// Coefficient of each column.
    pub coefficients: DVector<f64>,
    /// Adjusted share of the variance that the own parameters leave (adjusted R2).
    pub r2: f64,
    /// Share of the squared error beyond the noise.
    pub follows: f64,
    /// Explained power over its expectation by chance with as many columns (an F statistic).
    pub strength: f64,
    /// What own parameters and columns explain in each window; NaN where a column is not known.
    pub fitted: Vec<f64>,
    /// Root mean square of what the own parameters leave, and of the noise.
    rms: f64,
    pub noise: f64,
    /// Windows beyond the own parameters.
    spare: f64,
    partial: Partial,
    blocks: Vec<usize>,
}

impl Fit {
    /// The curve at the knots of its columns, and its deviation, clustered in blocks of time.
    pub(super) fn curve(&self, basis: &Basis) -> (Vec<f64>, Vec<f64>) {
        let covariance = &basis.shape * self.covariance() * basis.shape.transpose();
        let deviation = |variance: &f64| variance.max(0.0).sqrt();
        let values = &basis.shape * &self.coefficients;
        (values.as_slice().to_vec(), covariance.diagonal().iter().map(deviation).collect())
    }

    /// Amplitude of a wave that was fitted by its cosine and its sine, and its deviation.
    pub(super) fn amplitude(&self) -> (f64, f64) {
        let size = self.coefficients.norm();
        let along = &self.coefficients / size.max(f64::MIN_POSITIVE);
        let variance = along.dot(&(self.covariance() * &along));
        (size, variance.max(0.0).sqrt())
    }

    /// Error after the fit of the own parameters, in units of the noise.
    pub(super) fn over_noise(&self) -> Option<f64> {
        (self.noise > 0.0).then(|| self.rms / self.noise)
    }

    fn covariance(&self) -> DMatrix<f64> {
        let Partial { columns, remainder, bread, .. } = &self.partial;
        let known = vec![true; columns.ncols()];
        least_squares::clustered(columns, remainder, &self.blocks, bread.clone(), &known)
    }
}

/// Errors of an equation in windows of a run.
pub(super) struct Regression<'a> {
    pub windows: &'a Windows<'a>,
    pub equation: Balance,
    /// How many of the equation's own parameters are partialled out.
    own: usize,
    /// The windows of which the error is known, with it.
    pub each: Vec<(&'a Window, f64)>,
}

impl<'a> Regression<'a> {
    /// `refitted`: whether the error is what the equation's own parameters leave.
    pub(super) fn new(windows: &'a Windows<'a>, equation: Balance, refitted: bool) -> Self {
        let own = if refitted { own_keys(equation).len() } else { 0 };
        Self { own, ..Self::of(windows, equation, |_, window| window.error(equation)) }
    }

    /// Of another value of the windows than their error, with nothing partialled out.
    pub(super) fn of(
        windows: &'a Windows<'a>,
        equation: Balance,
        error: impl Fn(usize, &Window) -> f64,
    ) -> Self {
        let each = windows.each.iter().enumerate();
        let each = each.map(|(index, window)| (window, error(index, window)));
        let each = each.filter(|(_, error)| error.is_finite()).collect();
        Self { windows, equation, own: 0, each }
    }

    pub(super) fn rms(&self) -> f64 {
        let power: f64 = self.each.iter().map(|(_, error)| error * error).sum();
        (power / self.each.len().max(1) as f64).sqrt()
    }

    /// A row of columns for each window.
    pub(super) fn rows(
        &self,
        columns: usize,
        mut fill: impl FnMut(&Window, &mut [f64]),
    ) -> Vec<Vec<f64>> {
        let row = |(window, _): &(&Window, f64)| {
            let mut row = vec![0.0; columns];
            fill(window, &mut row);
            row
        };
        self.each.iter().map(row).collect()
    }

    /// The same from a value that every sample has, each `put` into the columns with its weight in the window.
    pub(super) fn averaged(
        &self,
        values: &[f64],
        columns: usize,
        put: impl Fn(f64, f64, &mut [f64]),
    ) -> Vec<Vec<f64>> {
        self.rows(columns, |window, row| {
            let weights = self.windows.weights_of(window).mean;
            for (weight, value) in weights.iter().zip(&values[self.windows.samples_of(window)]) {
                put(*value, *weight, row);
            }
        })
    }

    /// Least squares over rows of columns; `None` where there are too few, or nothing is left to explain.
    pub(super) fn fit(&self, rows: &[Vec<f64>]) -> Option<Fit> {
        let (own, added) = (self.own, rows.first()?.len());
        let is_known = |row: &usize| rows[*row].iter().all(|value| value.is_finite());
        let used: Vec<usize> = (0..rows.len()).filter(is_known).collect();
        let n = used.len();
        if added == 0 || n < SETTINGS.rows_each_column * (own + added) {
            return None;
        }
        let window = |row: usize| self.each[used[row]].0;
        let base = DMatrix::from_fn(n, own, |row, at| window(row).own(self.equation)[at]);
        let errors = DVector::from_fn(n, |row, _| self.each[used[row]].1);
        let columns = DMatrix::from_fn(n, added, |row, at| rows[used[row]][at]);
        let fit = partial_regression(&base, &columns, &errors);
        let (power, unexplained) = (fit.residual.norm_squared(), fit.remainder.norm_squared());
        if power <= 0.0 {
            return None;
        }
        let noise: f64 = (0..n).map(|row| window(row).floor(self.equation).powi(2)).sum();
        let (spare, k) = ((n - own) as f64, added as f64);
        let by_chance = if noise > 0.0 { noise / n as f64 } else { unexplained / (spare - k) };
        let by_chance = by_chance.max(ROUNDING * power / spare);
        let explained = power - unexplained;
        let beyond = (power - noise).max(LEAST_BEYOND_SHARE * power);
        let mut fitted = vec![f64::NAN; rows.len()];
        for (at, row) in used.iter().enumerate() {
            fitted[*row] = errors[at] - fit.remainder[at];
        }
        let begin_s = window(0).time_s;
        let shortest = (window(n - 1).time_s - begin_s) / (SETTINGS.blocks_each_column * (k + 2.0));
        let block_s = self.windows.scenario.scales.block_s().min(shortest);
        let block = |row: usize| whole((window(row).time_s - begin_s) / block_s);
        Some(Fit {
            r2: 1.0 - unexplained / (spare - k) / (power / spare),
            follows: ((explained - k * by_chance) / beyond).clamp(0.0, 1.0),
            strength: explained / (k * by_chance),
            rms: (power / spare).sqrt(),
            noise: (noise / n as f64).sqrt(),
            blocks: (0..n).map(block).collect(),
            coefficients: fit.coefficients.clone(),
            fitted,
            spare,
            partial: fit,
        })
    }

    fn values(&self, variable: Variable) -> Option<Values> {
        let scenario = self.windows.scenario;
        let at_samples = |value: &dyn Fn(f64) -> f64| {
            scenario.sample_time_s.iter().map(|time_s| value(*time_s)).collect()
        };
        let of_windows = |value| Some(Values::OfWindows(value));
        Some(Values::OfSamples(match variable {
            Variable::Axis(Axis::Speed) => scenario.speed_rad_s.clone(),
            Variable::Axis(Axis::Current) => scenario.current_a.clone(),
            Variable::Axis(Axis::Angle) => self.windows.angle_at_samples()?,
            Variable::Axis(Axis::Time) => at_samples(&|time_s| time_s - scenario.begin_s()),
            Variable::Axis(Axis::Voltage) => at_samples(&|time_s| scenario.input_at(time_s)),
            Variable::CurrentRate => return of_windows(|window| window.own(Balance::Voltage)[1]),
            Variable::Acceleration => return of_windows(|window| window.own(Balance::Torque)[0]),
            Variable::VoltageRate => return of_windows(|window| window.input_rate),
        }))
    }

    /// Columns of a variable: hat functions, of the angle harmonics, where an effect has so many periods per turn.
    pub(super) fn basis(&self, variable: Variable, periods_per_turn: f64) -> Option<Basis> {
        let values = self.values(variable)?;
        match &values {
            Values::OfSamples(angle) if variable == Variable::Axis(Axis::Angle) => {
                Some(self.period(angle, periods_per_turn))
            }
            _ => self.hats(&values, variable == Variable::Axis(Axis::Time)),
        }
    }

    fn period(&self, angle: &[f64], periods_per_turn: f64) -> Basis {
        let mut rows = self.waves(angle, periods_per_turn, SETTINGS.harmonics);
        // A window that turns through much of a wave averages it away: without harmonics of which little is left.
        let power = |column: usize| rows.iter().map(|row| row[column].powi(2)).sum::<f64>();
        let is_resolved = |order: &usize| {
            power(2 * order) + power(2 * order + 1) >= SETTINGS.least_gain * rows.len() as f64
        };
        let columns = 2 * (1 + (1..SETTINGS.harmonics).take_while(is_resolved).count());
        for row in &mut rows {
            row.truncate(columns);
        }
        let period_rad = TAU / periods_per_turn;
        let at = |knot: usize| knot as f64 / SETTINGS.knots_of_a_turn as f64;
        let mut shape = DMatrix::zeros(SETTINGS.knots_of_a_turn, columns);
        for knot in 0..SETTINGS.knots_of_a_turn {
            let mut row = vec![0.0; columns];
            waves(TAU * at(knot), 1.0, &mut row);
            shape.row_mut(knot).copy_from_slice(&row);
        }
        let middle = |(window, _): &(&Window, f64)| {
            let samples = self.windows.samples_of(window);
            angle[(samples.start() + samples.end()) / 2].rem_euclid(period_rad)
        };
        Basis {
            places: self.each.iter().map(middle).collect(),
            rows,
            knots: (0..SETTINGS.knots_of_a_turn).map(|knot| period_rad * at(knot)).collect(),
            shape,
        }
    }

    /// Cosine and sine of each harmonic in each window.
    pub(super) fn waves(
        &self,
        angle: &[f64],
        periods_per_turn: f64,
        orders: usize,
    ) -> Vec<Vec<f64>> {
        let put =
            |angle: f64, weight, row: &mut [f64]| waves(periods_per_turn * angle, weight, row);
        self.averaged(angle, 2 * orders, put)
    }

    fn hats(&self, values: &Values, is_time: bool) -> Option<Basis> {
        let rows = |count: usize, put: &dyn Fn(f64, f64, &mut [f64])| match values {
            Values::OfSamples(values) => self.averaged(values, count, put),
            Values::OfWindows(of) => self.rows(count, |window, row| put(of(window), 1.0, row)),
        };
        let mean = rows(1, &|value, weight, row| row[0] += weight * value);
        let places: Vec<f64> = mean.iter().map(|row| row[0]).collect();
        let knots = knots(&places, !is_time)?;
        let put = |value, weight, row: &mut [f64]| {
            for (knot, share) in table_weights(Axis::Speed, &knots, value) {
                row[knot] += weight * share;
            }
        };
        let (rows, shape) = (rows(knots.len(), &put), DMatrix::identity(knots.len(), knots.len()));
        Some(Basis { places, rows, knots, shape })
    }
}

/// Partial regression: least squares on columns of which the others explain a part.
pub(super) struct Partial {
    pub coefficients: DVector<f64>,
    /// Columns and errors without what the others explain, and the residual of both.
    columns: DMatrix<f64>,
    residual: DVector<f64>,
    remainder: DVector<f64>,
    /// `(X'X)^-1`, without the canonical variates that the others explain nearly as well: those stay at zero.
    bread: DMatrix<f64>,
}

/// Regression of errors on columns after `others` are partialled out.
pub(super) fn partial_regression(
    others: &DMatrix<f64>,
    columns: &DMatrix<f64>,
    errors: &DVector<f64>,
) -> Partial {
    let (inverse, _) = least_squares::inverse_where_determined(others);
    let residual = errors - others * (&inverse * others.tr_mul(errors));
    let spectral = |matrix: DMatrix<f64>, of: &dyn Fn(f64) -> f64| {
        let eigen = matrix.symmetric_eigen();
        let values = DMatrix::from_diagonal(&eigen.eigenvalues.map(of));
        &eigen.eigenvectors * values * eigen.eigenvectors.transpose()
    };
    let root = least_squares::inverse_where_determined(columns).0;
    let root = spectral(root, &|value| value.max(0.0).sqrt());
    let columns = columns - others * (inverse * others.tr_mul(columns));
    let tolerances = &root * columns.tr_mul(&columns) * &root;
    let kept = |tolerance| if tolerance > LEAST_TOLERANCE { 1.0 / tolerance } else { 0.0 };
    let bread = &root * spectral(tolerances, &kept) * &root;
    let coefficients = &bread * columns.tr_mul(&residual);
    let remainder = &residual - &columns * &coefficients;
    Partial { coefficients, columns, residual, remainder, bread }
}

/// Least share of a combination of columns that the own parameters must leave.
const LEAST_TOLERANCE: f64 = 0.02;
/// Share of an error's power below which it is rounding.
const ROUNDING: f64 = 1e-12;
/// Least share of an error's power that counts as beyond the noise.
const LEAST_BEYOND_SHARE: f64 = 0.02;
/// Knots of a curve, with which it can bend.
const FEWEST_KNOTS: usize = 3;

/// Knots of a curve, from zero outwards where a variable has both signs: as close as the windows determine.
fn knots(places: &[f64], near_zero: bool) -> Option<Vec<f64>> {
    let mut sorted = finite(places);
    sorted.sort_by(f64::total_cmp);
    let (first, last) = (*sorted.first()?, *sorted.last()?);
    let has_both = near_zero && first < 0.0 && last > 0.0;
    let begin = if has_both { 0.0 } else { first };
    let (widest, closest) =
        (SETTINGS.apart_share * (last - first), SETTINGS.closest_share * last.max(-first));
    let outwards = |side: &mut dyn Iterator<Item = f64>| {
        let (mut knots, mut end, mut group) = (vec![begin], begin, Vec::new());
        for place in side {
            group.push(place);
            let near = (SETTINGS.apart_share_of_size * end.abs()).max(closest);
            let apart = if has_both { near.min(widest) } else { widest };
            if group.len() >= SETTINGS.windows_each_knot && (place - end).abs() >= apart {
                knots.push(group[group.len() / 2]);
                end = place;
                group.clear();
            }
        }
        // The last knot at the end of what was reached, with windows enough.
        if let Some(extreme) = group.last() {
            if group.len() < SETTINGS.windows_each_knot && knots.len() > 1 {
                knots.pop();
            }
            knots.push(*extreme);
        }
        knots
    };
    let from = sorted.partition_point(|place| *place < begin);
    let mut knots = outwards(&mut sorted[..from].iter().rev().copied());
    knots.reverse();
    knots.extend(outwards(&mut sorted[from..].iter().copied()).into_iter().skip(1));
    (knots.len() >= FEWEST_KNOTS).then_some(knots)
}

/// Cosine and sine of the harmonics of an angle, times a weight, added to a row.
fn waves(angle_rad: f64, weight: f64, row: &mut [f64]) {
    let (sin, cos) = angle_rad.sin_cos();
    let (mut re, mut im) = (cos, sin);
    for wave in row.chunks_mut(2) {
        wave[0] += weight * re;
        wave[1] += weight * im;
        (re, im) = (re * cos - im * sin, re * sin + im * cos);
    }
}

/// The strongest line in the spectrum of an equation's error: a shaker, a belt, an independently driven gear.
pub(super) struct Line {
    pub frequency_hz: f64,
    /// Gain of the windows' average at its frequency.
    pub window_gain: f64,
    /// Whether no other line has a comparable power. An error that depends on a periodic excitation has many.
    pub is_alone: bool,
    pub fit: Fit,
}

impl Regression<'_> {
    /// The windows stand at nearly equal distances; where one was dropped there is a zero, which spreads a line but does
    /// not move it. The highest peak of the periodogram is then refined in true time.
    pub(super) fn strongest_line(&self) -> Option<Line> {
        let stride_s = 0.5 * self.windows.length_s();
        let (first, end_s) = (self.each.first()?.0, self.each.last()?.0.time_s);
        let (begin_s, length_s) = (first.time_s, end_s - first.time_s);
        let length = whole((length_s / stride_s).round()) + 1;
        if length < SETTINGS.windows_of_spectrum || stride_s <= 0.0 {
            return None;
        }
        let size = length.next_power_of_two() * 2;
        let mut series = vec![Complex::default(); size];
        for (window, error) in &self.each {
            let place = whole(((window.time_s - begin_s) / stride_s).round());
            series[place.min(length - 1)] = Complex::from(*error);
        }
        let spectrum = transform(&series);
        let resolution_hz = 1.0 / (size as f64 * stride_s);
        let lowest = whole(SETTINGS.fewest_periods / length_s / resolution_hz) + 1;
        let power = |k: usize| spectrum[k].norm_sqr();
        let peak = (lowest..size / 2).max_by(|a, b| power(*a).total_cmp(&power(*b)))?;
        let width = whole(SETTINGS.line_width / length_s / resolution_hz);
        let apart = (lowest..size / 2).filter(|k| k.abs_diff(peak) > width);
        let next = apart.map(power).fold(0.0, f64::max);
        let power_at = |frequency_hz: f64| {
            let turned = |(window, error): &(&Window, f64)| {
                Complex::cis(TAU * frequency_hz * window.time_s) * *error
            };
            self.each.iter().map(turned).sum::<Complex<f64>>().norm_sqr()
        };
        let steps = -SETTINGS.refinement..=SETTINGS.refinement;
        let frequency_hz = steps
            .map(|step| f64::from(step) / f64::from(SETTINGS.refinement))
            .map(|step| (peak as f64 + step) * resolution_hz)
            .max_by(|a, b| power_at(*a).total_cmp(&power_at(*b)))?;
        let wave = |at: &Window, row: &mut [f64]| waves(TAU * frequency_hz * at.time_s, 1.0, row);
        let mut fit = self.fit(&self.rows(2, wave))?;
        // The best of many frequencies explains part of any noise: degrees of freedom for that choice.
        let chance = 2.0 * ((size / 2 - lowest) as f64).ln().max(0.0);
        fit.r2 = 1.0 - (1.0 - fit.r2) * fit.spare / (fit.spare - chance);
        let times = &self.windows.scenario.sample_time_s[self.windows.samples_of(first)];
        let weights = self.windows.weights_of(first).mean;
        let in_phase = |time_s: &f64| (TAU * frequency_hz * (time_s - begin_s)).cos();
        let averaged: f64 = weights.iter().zip(times).map(|(w, time_s)| w * in_phase(time_s)).sum();
        Some(Line {
            frequency_hz,
            window_gain: averaged.abs().max(f64::MIN_POSITIVE),
            is_alone: next <= SETTINGS.alone_share * power(peak),
            fit,
        })
    }
}

/// Fast Fourier transform; the length is a power of two (Cooley and Tukey 1965).
fn transform(values: &[Complex<f64>]) -> Vec<Complex<f64>> {
    let n = values.len();
    if n < 2 {
        return values.to_vec();
    }
    let half = |first| values.iter().skip(first).step_by(2).copied().collect::<Vec<_>>();
    let (even, mut odd) = (transform(&half(0)), transform(&half(1)));
    for (k, value) in odd.iter_mut().enumerate() {
        *value *= Complex::cis(-TAU * k as f64 / n as f64);
    }
    let pairs = || even.iter().zip(&odd);
    pairs().map(|(a, b)| a + b).chain(pairs().map(|(a, b)| a - b)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_transform_of_a_wave_has_its_power_in_one_bin() {
        let n = 64;
        let wave = |k: usize| Complex::from((TAU * 5.0 * k as f64 / n as f64).cos());
        let found = transform(&(0..n).map(wave).collect::<Vec<_>>());
        for (k, value) in found.iter().enumerate() {
            let expected = if k == 5 || k == n - 5 { 32.0 } else { 0.0 };
            assert!((value - expected).norm() < 1e-9, "{k}");
        }
    }
}
