//! Location of an equation's error along each variable: the share that follows it, and the narrowest range that holds most.
//!
//! Every variable has its columns, averaged over each window with the test function, so that a variable that passes through
//! many turns or amperes within one window has its true average. Their adjusted R2 is compared.

use std::f64::consts::{PI, TAU};

use nalgebra::{DMatrix, DVector};

use super::windows::{Window, Windows, own_keys};
use super::{ErrorForm, ErrorOf, FailureLocation};
use drivebench_model::numerics::count::whole;
use drivebench_model::plant::effect::{Axis, table_weights};
use drivebench_model::plant::{Balance, Model, MotorKey};

/// Hat functions along speed and current, and along time.
const HATS: usize = 16;
const HATS_OF_TIME: usize = 24;
/// Largest order per turn.
const ORDERS: usize = 36;
/// Thresholds of the search along each variable.
struct Settings {
    /// Fewest windows, by weight, with a contribution of a wave.
    fewest_windows_of_wave: f64,
    /// Share of the error that must follow a variable to be reported.
    worth_mentioning_share: f64,
    /// The same in multiples of what chance explains.
    beyond_chance: f64,
    /// Time is no physical cause, and every periodic excitation has spectral lines: they come first only where no physical
    /// variable comes near.
    weight_of_time: f64,
    /// The same of a line in frequency.
    weight_of_line: f64,
    /// Weight of a single wrong value of the motor against a curve of many columns.
    parsimony: f64,
    /// A direction of motion holds the error if it has this share of it.
    one_sided_share: f64,
    /// The share of the time that the direction may have at most.
    one_sided_share_of_time: f64,
    /// Windows in which the shaft has to turn that way.
    one_sided_windows: usize,
    /// Share of the time above which a region is the whole range.
    nearly_all_share: f64,
    /// Share of the largest diagonal that keeps columns without data from being singular.
    ridge: f64,
    /// Share of the error that follows a variable which a region must hold.
    region_share: f64,
    /// Share of the time of a range of magnitudes below which a one-sided range is preferred: most faults are even in the sign.
    narrower_share: f64,
    /// Periods that a line has within the run at least: what is slower is a drift.
    fewest_periods: f64,
    /// Half width of a line's foot, in periods per run.
    line_width: f64,
    /// Share of its power that the next line may have for it to stand alone.
    alone_share: f64,
}

const SETTINGS: Settings = Settings {
    fewest_windows_of_wave: 30.0,
    worth_mentioning_share: 0.1,
    beyond_chance: 4.0,
    weight_of_time: 0.85,
    weight_of_line: 0.9,
    parsimony: 1.03,
    one_sided_share: 0.75,
    one_sided_share_of_time: 0.6,
    one_sided_windows: 20,
    nearly_all_share: 0.75,
    ridge: 1e-9,
    region_share: 0.8,
    narrower_share: 0.7,
    fewest_periods: 4.0,
    line_width: 2.0,
    alone_share: 0.5,
};

/// A variable on which the error depends, and its rank.
struct Ranked {
    location: FailureLocation,
    weight: f64,
}

/// The variables on which the error depends, the largest share first. `refitted`: whether the error is what the
/// equation's own parameters leave, so that their columns stand besides every variable's.
pub(super) fn ranked(
    windows: &Windows<'_>,
    equation: Balance,
    refitted: bool,
    model: &Model,
    error_of: ErrorOf,
) -> Vec<FailureLocation> {
    let search =
        Search { windows, equation, own: if refitted { own_keys(equation).len() } else { 0 } };
    let mut found = Vec::new();
    if !refitted {
        found.extend(search.own_values(model, error_of));
    }
    found.extend(search.curve("speed_rad_s"));
    match equation {
        Balance::Voltage => {
            found.extend(search.curve("current_a"));
            found.extend(search.late(model));
        }
        // Not the current: this balance is solved for it, so that every missing effect correlates with it.
        Balance::Torque => {
            found.extend(search.turns());
            found.extend(search.line());
        }
    }
    found.extend(search.offset());
    found.extend(search.drift());
    found.extend(search.one_way());
    found.sort_by(|a: &Ranked, b| b.weight.total_cmp(&a.weight));
    // The better form of each variable.
    let mut kept: Vec<FailureLocation> = Vec::new();
    for Ranked { location, .. } in found {
        if kept.iter().all(|own| own.variable != location.variable) {
            kept.push(location);
        }
    }
    kept
}

pub(super) struct Search<'a> {
    pub windows: &'a Windows<'a>,
    pub equation: Balance,
    /// How many of the equation's own columns stand before every variable's.
    pub own: usize,
}

/// Regression of an error on columns.
#[derive(Default)]
struct Fit {
    /// Coefficient of each column, the equation's own first.
    coefficients: Vec<f64>,
    /// `1 - (RSS / (n - k)) / (TSS / n)`.
    adjusted: f64,
    /// Share of the squared error beyond the noise.
    follows: f64,
    /// Explained power over its expectation by chance with as many columns (an F statistic).
    strength: f64,
}

impl Search<'_> {
    pub(super) fn of(&self) -> impl Iterator<Item = &Window> {
        self.windows.of(self.equation)
    }

    /// A row of columns for each window, the equation's own first.
    pub(super) fn rows(
        &self,
        columns: usize,
        mut fill: impl FnMut(&Window, &mut [f64]),
    ) -> Vec<Vec<f64>> {
        let row = |window: &Window| {
            let mut row = vec![0.0; self.own + columns];
            row[..self.own].copy_from_slice(&window.own(self.equation)[..self.own]);
            fill(window, &mut row[self.own..]);
            row
        };
        self.of().map(row).collect()
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
            let own = &values[self.windows.samples_of(window)];
            for (weight, value) in weights.iter().zip(own) {
                put(*value, *weight, row);
            }
        })
    }

    /// Least squares of the error over these rows; `None` where they explain too little to be reported.
    fn fit(&self, rows: &[Vec<f64>]) -> Option<Fit> {
        let columns = rows.first()?.len();
        let mut normal: DMatrix<f64> = DMatrix::zeros(columns, columns);
        let mut right: DVector<f64> = DVector::zeros(columns);
        let (mut power, mut noise, mut n) = (0.0, 0.0, 0.0);
        for (window, row) in self.of().zip(rows) {
            if row.iter().any(|value| !value.is_finite()) {
                continue;
            }
            let error = window.error(self.equation);
            n += 1.0;
            power += error * error;
            noise += window.floor(self.equation).powi(2);
            for (at, value) in row.iter().enumerate().filter(|(_, value)| **value != 0.0) {
                right[at] += value * error;
                for (other, second) in row.iter().enumerate().skip(at) {
                    normal[(at, other)] += value * second;
                }
            }
        }
        let k = columns as f64;
        if n < 3.0 * k + 10.0 || power <= 0.0 {
            return None;
        }
        normal.fill_lower_triangle_with_upper_triangle();
        // Columns in one unit, so that the ridge means the same for each.
        let scale: Vec<f64> = (0..columns).map(|at| normal[(at, at)].sqrt()).collect();
        let largest = scale.iter().fold(0.0, |most: f64, s| most.max(*s));
        if largest <= 0.0 {
            return None;
        }
        let is_known = |s: &f64| *s > 1e-9 * largest;
        let inverse = scale.iter().map(|s| if is_known(s) { 1.0 / s } else { 0.0 });
        let inverse: Vec<f64> = inverse.collect();
        for at in 0..columns {
            right[at] *= inverse[at];
            for other in 0..columns {
                normal[(at, other)] *= inverse[at] * inverse[other];
            }
            normal[(at, at)] += SETTINGS.ridge + if inverse[at] == 0.0 { 1.0 } else { 0.0 };
        }
        let solved = normal.cholesky()?.solve(&right);
        let explained = solved.dot(&right).clamp(0.0, power);
        let left = power - explained;
        let by_chance = if noise > 0.0 { noise / n } else { left / (n - k) };
        let by_chance = by_chance.max(1e-12 * power / n);
        let beyond = (power - noise).max(0.02 * power);
        let fit = Fit {
            coefficients: solved.iter().zip(&inverse).map(|(x, unit)| x * unit).collect(),
            adjusted: 1.0 - (left / (n - k)) / (power / n),
            follows: ((explained - k * by_chance) / beyond).clamp(0.0, 1.0),
            strength: explained / (k * by_chance),
        };
        (fit.follows >= SETTINGS.worth_mentioning_share && fit.strength >= SETTINGS.beyond_chance)
            .then_some(fit)
    }

    /// How much of the error follows these rows; `None` where that is too little to be reported.
    pub(super) fn followed_share(&self, rows: &[Vec<f64>]) -> Option<f64> {
        self.fit(rows).map(|fit| fit.follows)
    }

    /// Where along `at` most of what a fit explains lies.
    fn region(&self, rows: &[Vec<f64>], fit: &Fit, at: impl Fn(&Window) -> f64) -> Option<Region> {
        let along = self.of().zip(rows).map(|(window, row)| Point {
            at: at(window),
            fitted: row.iter().zip(&fit.coefficients).map(|(c, x)| c * x).sum(),
            beyond: window.beyond(self.equation),
        });
        narrowest(&along.filter(|point| point.at.is_finite()).collect::<Vec<_>>())
    }

    fn ranked(
        &self,
        variable: &'static str,
        region: Region,
        fit: &Fit,
        weight: f64,
        form: ErrorForm,
    ) -> Ranked {
        let Region { from, to, .. } = region;
        let is_around_zero = region.of_size && region.from_lowest;
        let location = FailureLocation {
            equation: self.equation.key(),
            variable,
            from: if is_around_zero { -to } else { from },
            to,
            share_of_error: region.share_of_error,
            share_of_time: region.share_of_time,
            follows: fit.follows,
            strength: fit.strength,
            form,
        };
        let weight = weight * fit.adjusted;
        Ranked { location, weight }
    }

    /// The range in which most of the error lies along a variable, where it is not nearly everything.
    fn range(&self, variable: &str, region: &Region) -> ErrorForm {
        if region.share_of_time > SETTINGS.nearly_all_share {
            return ErrorForm::Throughout;
        }
        let either_way = region.of_size;
        // The time stamps of a drive count from its power-on, those of a run from its begin.
        let begin_s = if variable == "time_s" { self.windows.scenario.begin_s() } else { 0.0 };
        match (region.from_lowest, region.to_highest) {
            (true, _) => ErrorForm::Below { either_way, begin_s },
            (_, true) => ErrorForm::Above { either_way, begin_s },
            _ => ErrorForm::Between { either_way, begin_s },
        }
    }

    /// Knots at quantiles of a variable over the windows.
    fn knots(&self, at: impl Fn(&Window) -> f64, most: usize) -> Option<Vec<f64>> {
        let mut values: Vec<f64> = self.of().map(at).filter(|v| v.is_finite()).collect();
        values.sort_by(f64::total_cmp);
        let last = values.len().checked_sub(1)?;
        let span = values[last] - values[0];
        let mut knots: Vec<f64> = (0..most).map(|k| values[k * last / (most - 1)]).collect();
        if most == HATS {
            let largest = values[0].abs().max(values[last].abs());
            let near_zero = [0.02, 0.04, 0.08, 0.16, 0.32].map(|share| share * largest);
            let edges = near_zero.iter().flat_map(|edge| [-edge, *edge]).chain([0.0]);
            knots.extend(edges.filter(|edge| *edge > values[0] && *edge < values[last]));
            knots.sort_by(f64::total_cmp);
        }
        knots.dedup_by(|later, earlier| *later - *earlier <= 0.002 * span);
        (knots.len() >= 3 && span > 0.0).then_some(knots)
    }

    /// A curve of hats over speed or current.
    fn curve(&self, variable: &'static str) -> Option<Ranked> {
        let scenario = self.windows.scenario;
        let (at, values): (fn(&Window) -> f64, &[f64]) = match variable {
            "speed_rad_s" => (|window| window.speed_rad_s, &scenario.speed_rad_s),
            _ => (|window| window.current_a, &scenario.current_a),
        };
        let knots = self.knots(at, HATS)?;
        let put = |value, weight, row: &mut [f64]| hat(&knots, value, weight, row);
        let rows = self.averaged(values, knots.len(), put);
        let fit = self.fit(&rows)?;
        let region = self.region(&rows, &fit, at)?;
        let form = self.range(variable, &region);
        Some(self.ranked(variable, region, &fit, 1.0, form))
    }

    /// Each of the equation's own parameters alone. Where short windows contradict a value that was fitted to the whole run
    /// both values are given, without a decision which is wrong.
    fn own_values(&self, model: &Model, error_of: ErrorOf) -> Vec<Ranked> {
        let variables: &[&'static str] = match self.equation {
            Balance::Voltage => &["current_a", "current_rate_a_s", "speed_rad_s"],
            Balance::Torque => &["acceleration_rad_s2", "direction"],
        };
        let keys = own_keys(self.equation).iter().zip(variables).enumerate();
        let one = |(column, (&key, &variable)): (usize, (&MotorKey, &&'static str))| {
            let value = |window: &Window| window.own(self.equation)[column];
            let rows = self.rows(1, |window, row| row[0] = value(window));
            let fit = self.fit(&rows)?;
            let by = fit.coefficients[0];
            let region = if key == MotorKey::LoadTorque {
                everywhere(-1.0, 1.0)
            } else {
                self.region(&rows, &fit, value)?
            };
            let own = model.motor.get(key).filter(|own| own.is_finite());
            let form = match (error_of, own) {
                (ErrorOf::Model, Some(own)) => ErrorForm::ModelValue { key, by, own },
                (ErrorOf::Structure, Some(own)) => ErrorForm::WindowValue { key, by, own },
                (_, None) => ErrorForm::ValueBeside { key, by },
            };
            Some(self.ranked(variable, region, &fit, SETTINGS.parsimony, form))
        };
        keys.filter_map(one).collect()
    }

    /// Delay of the voltage: `v = -delay <du/dt>`.
    fn late(&self, model: &Model) -> Option<Ranked> {
        let fit = self.fit(&self.rows(1, |window, row| row[0] = window.input_rate))?;
        // The loss is u(t) - u(t - delay).
        let delay_s = fit.coefficients[self.own];
        let value = |key| model.motor.get(key).unwrap_or(f64::NAN);
        let time_constant_s = value(MotorKey::Inductance) / value(MotorKey::Resistance);
        // Samples that do not resolve the armature's transient show a delay, but not its length.
        let is_resolved = self.windows.period_s < 0.5 * time_constant_s;
        let form = ErrorForm::VoltageTiming { delay_s, is_resolved };
        let region = everywhere(delay_s.min(0.0), delay_s.max(0.0));
        Some(self.ranked("voltage_edge_s", region, &fit, 1.0, form))
    }

    /// The order per turn that explains most.
    fn turns(&self) -> Option<Ranked> {
        let angle = self.angle_at_samples()?;
        // Averages of the waves of all orders at once: [cos, sin] of each.
        let average = |window: &Window| {
            let mut waves = vec![[0.0; 2]; ORDERS + 1];
            let weights = self.windows.weights_of(window).mean;
            // Above half the sampling rate a wave is aliased: it is left out.
            let step_rad = window.speed_rad_s.abs() * self.windows.period_s;
            let highest_order = (PI / step_rad.max(1e-9)).min(1e6);
            for (weight, angle) in weights.iter().zip(&angle[self.windows.samples_of(window)]) {
                let (sin, cos) = angle.sin_cos();
                let (mut re, mut im) = (cos, sin);
                let orders = waves.iter_mut().enumerate().skip(1);
                for (_, wave) in orders.take_while(|(order, _)| *order as f64 <= highest_order) {
                    wave[0] += weight * re;
                    wave[1] += weight * im;
                    (re, im) = (re * cos - im * sin, re * sin + im * cos);
                }
            }
            waves
        };
        let waves: Vec<Vec<[f64; 2]>> = self.of().map(average).collect();
        let explained = |order: usize| {
            // Normal equations of two columns, and the fourth powers for the effective number of windows.
            let (mut cc, mut cs, mut ss, mut ce, mut se) = (0.0, 0.0, 0.0, 0.0, 0.0);
            let mut fourth = 0.0;
            for (window, waves) in self.of().zip(&waves) {
                let ([c, s], error) = (waves[order], window.error(self.equation));
                let size = c * c + s * s;
                (cc, cs, ss) = (cc + c * c, cs + c * s, ss + s * s);
                (ce, se, fourth) = (ce + c * error, se + s * error, fourth + size * size);
            }
            let determinant = cc * ss - cs * cs;
            // A wave with a contribution in few windows only, as of a high order, would overfit them.
            let is_supported = (cc + ss).powi(2) / fourth > SETTINGS.fewest_windows_of_wave;
            if determinant > 1e-6 * cc * ss && is_supported {
                (ce * ce * ss - 2.0 * ce * se * cs + se * se * cc) / determinant
            } else {
                0.0
            }
        };
        let orders = (1..=ORDERS).map(|order| (order, explained(order)));
        let (order, _) = orders.max_by(|a, b| a.1.total_cmp(&b.1))?;
        let mut each = waves.iter();
        let fit = self.fit(&self.rows(2, |_, row| {
            row.copy_from_slice(each.next().map_or(&[f64::NAN; 2], |waves| &waves[order]));
        }))?;
        let form = ErrorForm::PerTurn { order, amplitude: self.amplitude(&fit) };
        Some(self.ranked("angle_rad", everywhere(0.0, TAU), &fit, 1.0, form))
    }

    /// Amplitude of a wave that was fitted by its cosine and its sine.
    fn amplitude(&self, fit: &Fit) -> f64 {
        fit.coefficients[self.own].hypot(fit.coefficients[self.own + 1])
    }

    /// Angle of the shaft at every sample, extrapolated beyond the ends of the record.
    pub(super) fn angle_at_samples(&self) -> Option<Vec<f64>> {
        let points = self.windows.scenario.shaft_angle();
        if points.len() < 2 {
            return None;
        }
        let mut next = 1;
        let at = |time_s: &f64| {
            while next + 1 < points.len() && points[next].0 < *time_s {
                next += 1;
            }
            let (before, after) = (points[next - 1], points[next]);
            before.1 + (after.1 - before.1) * (time_s - before.0) / (after.0 - before.0)
        };
        Some(self.windows.scenario.sample_time_s.iter().map(at).collect())
    }

    fn line(&self) -> Option<Ranked> {
        let line = self.strongest_line().filter(|line| line.is_alone)?;
        let fit = self.fit(&self.rows(2, |window, row| {
            row.copy_from_slice(&line.wave(window.time_s));
        }))?;
        let form = ErrorForm::Line { amplitude: self.amplitude(&fit) / line.window_gain };
        // The resolution by the length of the run.
        let times = &self.windows.scenario.sample_time_s;
        let half_hz = 0.5 / (times[times.len() - 1] - times[0]);
        let region = Region {
            share_of_error: fit.follows,
            ..everywhere(line.frequency_hz - half_hz, line.frequency_hz + half_hz)
        };
        Some(self.ranked("frequency_hz", region, &fit, SETTINGS.weight_of_line, form))
    }

    /// A curve over time: of the equation itself, or of what multiplies its current (voltage) or its direction (torque:
    /// friction acts against the motion, and a load that changes does so too); the better.
    fn drift(&self) -> Option<Ranked> {
        let at = |window: &Window| window.time_s;
        let knots = self.knots(at, HATS_OF_TIME)?;
        let modulation: fn(&Window) -> f64 = match self.equation {
            Balance::Voltage => |window| window.current_a,
            Balance::Torque => |window| window.direction,
        };
        let over_time = |by: fn(&Window) -> f64| {
            let put =
                |window: &Window, row: &mut [f64]| hat(&knots, window.time_s, by(window), row);
            let rows = self.rows(knots.len(), put);
            self.fit(&rows).map(|fit| (rows, fit))
        };
        let (plain, modulated) = (over_time(|_| 1.0), over_time(modulation));
        let is_modulated = modulated.as_ref().is_some_and(|(_, modulated)| {
            let plain = plain.as_ref();
            plain.is_none_or(|(_, plain)| modulated.adjusted > plain.adjusted)
        });
        let (rows, fit) = if is_modulated { modulated? } else { plain? };
        let region = self.region(&rows, &fit, at)?;
        let form = if is_modulated && self.equation == Balance::Voltage {
            let ends = [self.own, self.own + knots.len() - 1].map(|end| fit.coefficients[end]);
            ErrorForm::ResistanceDrift { by_ohm: ends[1] - ends[0] }
        } else {
            self.range("time_s", &region)
        };
        Some(self.ranked("time_s", region, &fit, SETTINGS.weight_of_time, form))
    }

    /// A constant error.
    fn offset(&self) -> Option<Ranked> {
        let fit = self.fit(&self.rows(1, |_, row| row[0] = 1.0))?;
        let by = fit.coefficients[self.own];
        let variable = match self.equation {
            Balance::Torque => "offset_n_m",
            Balance::Voltage => "offset_v",
        };
        let region = everywhere(by.min(0.0), by.max(0.0));
        Some(self.ranked(variable, region, &fit, SETTINGS.parsimony, ErrorForm::Offset { by }))
    }

    /// Whether nearly all of the error falls in one direction of motion.
    fn one_way(&self) -> Option<Ranked> {
        let mut sums = [(0.0, 0_usize); 2];
        for window in self.of() {
            if window.speed_rad_s.abs() > self.windows.dead_zone_rad_s {
                let side = &mut sums[usize::from(window.speed_rad_s > 0.0)];
                side.0 += window.beyond(self.equation);
                side.1 += 1;
            }
        }
        let power: f64 = sums.iter().map(|side| side.0.max(0.0)).sum();
        let count: usize = sums.iter().map(|side| side.1).sum();
        let forward = sums[1].0 > sums[0].0;
        let (beyond, windows) = sums[usize::from(forward)];
        let (held, time) = (beyond / power, windows as f64 / count.max(1) as f64);
        if !(held >= SETTINGS.one_sided_share
            && time <= SETTINGS.one_sided_share_of_time
            && windows >= SETTINGS.one_sided_windows)
        {
            return None;
        }
        let (from, to) = if forward { (0.0, 1.0) } else { (-1.0, 0.0) };
        let region = Region { share_of_error: held, share_of_time: time, ..everywhere(from, to) };
        let fit = Fit { follows: held, strength: windows as f64, ..Fit::default() };
        // Always after the other variables.
        Some(self.ranked("direction", region, &fit, 0.0, ErrorForm::OneWay { forward }))
    }
}

/// Adds `weight` times the hat functions over `knots` at `value`; outside, the last ones.
pub(super) fn hat(knots: &[f64], value: f64, weight: f64, row: &mut [f64]) {
    for (knot, share) in table_weights(Axis::Speed, knots, value) {
        row[knot] += weight * share;
    }
}

/// Bins of equal population, and the share of the error that follows the variable which a region must hold.
const BINS: usize = 24;

/// A range with what lies in it.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Region {
    from: f64,
    to: f64,
    /// Share of the squared error beyond the noise.
    share_of_error: f64,
    share_of_time: f64,
    /// The range is one of sizes: it stands for both signs.
    of_size: bool,
    /// It begins at the lowest value, ends at the highest.
    from_lowest: bool,
    to_highest: bool,
}

const fn everywhere(from: f64, to: f64) -> Region {
    Region {
        from,
        to,
        share_of_error: 1.0,
        share_of_time: 1.0,
        of_size: false,
        from_lowest: true,
        to_highest: true,
    }
}

/// One window along a variable: its explained error, and the square of its error beyond the noise.
struct Point {
    at: f64,
    fitted: f64,
    beyond: f64,
}

/// The narrower (in time) of the regions along the variable and along its size.
fn narrowest(points: &[Point]) -> Option<Region> {
    let plain = along(points, false);
    if !(points.iter().any(|p| p.at > 0.0) && points.iter().any(|p| p.at < 0.0)) {
        return plain;
    }
    match (plain, along(points, true)) {
        (Some(plain), Some(size))
            if plain.share_of_time >= SETTINGS.narrower_share * size.share_of_time =>
        {
            Some(size)
        }
        (plain, size) => plain.or(size),
    }
}

fn along(points: &[Point], of_size: bool) -> Option<Region> {
    let key = |point: &Point| if of_size { point.at.abs() } else { point.at };
    let mut sorted: Vec<(f64, &Point)> = points.iter().map(|point| (key(point), point)).collect();
    sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
    let last = sorted.len().checked_sub(1)?;
    if last < 3 * BINS || sorted[0].0 >= sorted[last].0 {
        return None;
    }
    // Equal populations resolve where the run spent much time.
    let first_of = |bin: usize| bin * sorted.len() / BINS;
    let edge = |bin: usize| sorted[first_of(bin).min(last)].0;
    let sums = |value: fn(&Point) -> f64| -> Vec<f64> {
        let inside = |bin: usize| sorted[first_of(bin)..first_of(bin + 1)].iter();
        let sum = |bin: usize| inside(bin).map(|(_, point)| value(point)).sum();
        (0..BINS).map(sum).collect()
    };
    let follows = sums(|point| point.fitted * point.fitted);
    let beyond: Vec<f64> = sums(|point| point.beyond).into_iter().map(|sum| sum.max(0.0)).collect();
    let total: f64 = follows.iter().sum();
    let held = |(first, end): (usize, usize)| follows[first..=end].iter().sum::<f64>();
    let ranges = (0..BINS).flat_map(|first| (first..BINS).map(move |end| (first, end)));
    let enough = ranges.filter(|range| held(*range) >= SETTINGS.region_share * total);
    // Fewest windows; among equals the one that holds more.
    let (first, end) =
        enough.min_by(|a, b| (a.1 - a.0).cmp(&(b.1 - b.0)).then(held(*b).total_cmp(&held(*a))))?;
    let whole: f64 = beyond.iter().sum();
    let share_of_error = beyond[first..=end].iter().sum::<f64>() / whole;
    Some(Region {
        from: edge(first),
        to: edge(end + 1),
        share_of_error: if whole > 0.0 { share_of_error } else { 0.0 },
        share_of_time: (first_of(end + 1) - first_of(first)) as f64 / sorted.len() as f64,
        of_size,
        from_lowest: first == 0,
        to_highest: end + 1 == BINS,
    })
}

/// Steps of refinement to either side of the peak, each a fraction of the resolution.
const REFINEMENT: i32 = 12;
/// Windows below which no spectrum is taken.
const FEWEST_WINDOWS: usize = 64;

/// A line in the spectrum of an equation's error: a shaker, a belt, an independently driven gear.
pub(super) struct Line {
    pub frequency_hz: f64,
    /// Gain of the windows' average at its frequency.
    pub window_gain: f64,
    /// Number of frequencies of which it is the strongest.
    pub tried: usize,
    /// Whether no other line has a comparable power. An error that depends on a periodic excitation has many.
    pub is_alone: bool,
}

impl Line {
    /// Cosine and sine at a time.
    pub(super) fn wave(&self, time_s: f64) -> [f64; 2] {
        let (sin, cos) = (TAU * self.frequency_hz * time_s).sin_cos();
        [cos, sin]
    }
}

impl Search<'_> {
    /// The windows stand at nearly equal distances; where one was dropped there is a zero, which spreads a line but does
    /// not move it. The highest peak of the periodogram is then refined in true time.
    pub(super) fn strongest_line(&self) -> Option<Line> {
        let stride_s = 0.5 * self.windows.length_s();
        let first = self.of().next()?;
        let (begin_s, end_s) = (first.time_s, self.of().last()?.time_s);
        let length = whole(((end_s - begin_s) / stride_s).round()) + 1;
        if length < FEWEST_WINDOWS || stride_s <= 0.0 {
            return None;
        }
        let size = length.next_power_of_two() * 2;
        let (mut real, mut imaginary) = (vec![0.0; size], vec![0.0; size]);
        for window in self.of() {
            let place = whole(((window.time_s - begin_s) / stride_s).round());
            real[place.min(length - 1)] = window.error(self.equation);
        }
        transform(&mut real, &mut imaginary);
        let resolution_hz = 1.0 / (size as f64 * stride_s);
        let lowest = whole(SETTINGS.fewest_periods / (end_s - begin_s) / resolution_hz) + 1;
        let power = |k: usize| real[k].powi(2) + imaginary[k].powi(2);
        let peak = (lowest..size / 2).max_by(|a, b| power(*a).total_cmp(&power(*b)))?;
        let width = whole(SETTINGS.line_width / (end_s - begin_s) / resolution_hz);
        let apart = (lowest..size / 2).filter(|k| k.abs_diff(peak) > width);
        let next = apart.map(power).fold(0.0, f64::max);
        let mut line = Line {
            frequency_hz: 0.0,
            window_gain: 1.0,
            tried: size / 2 - lowest,
            is_alone: next <= SETTINGS.alone_share * power(peak),
        };
        let power_at = |frequency_hz: f64| {
            let (mut c, mut s) = (0.0, 0.0);
            for window in self.of() {
                let (sin, cos) = (TAU * frequency_hz * window.time_s).sin_cos();
                c += cos * window.error(self.equation);
                s += sin * window.error(self.equation);
            }
            c * c + s * s
        };
        line.frequency_hz = (-REFINEMENT..=REFINEMENT)
            .map(|step| (peak as f64 + f64::from(step) / f64::from(REFINEMENT)) * resolution_hz)
            .max_by(|a, b| power_at(*a).total_cmp(&power_at(*b)))?;
        let times = &self.windows.scenario.sample_time_s[self.windows.samples_of(first)];
        let weights = self.windows.weights_of(first).mean;
        let in_phase = |time_s: f64| line.wave(time_s - first.time_s)[0];
        let averaged = weights.iter().zip(times).map(|(weight, time_s)| weight * in_phase(*time_s));
        line.window_gain = averaged.sum::<f64>().abs().max(f64::MIN_POSITIVE);
        Some(line)
    }
}

/// Fast Fourier transform in place; the length is a power of two (Cooley and Tukey 1965).
fn transform(real: &mut [f64], imaginary: &mut [f64]) {
    let n = real.len();
    let mut other = 0;
    for at in 1..n {
        let mut bit = n >> 1;
        while other & bit != 0 {
            other ^= bit;
            bit >>= 1;
        }
        other |= bit;
        if at < other {
            real.swap(at, other);
            imaginary.swap(at, other);
        }
    }
    let mut length = 2;
    while length <= n {
        let step = -TAU / length as f64;
        for start in (0..n).step_by(length) {
            for k in 0..length / 2 {
                let (sin, cos) = (step * k as f64).sin_cos();
                let (a, b) = (start + k, start + k + length / 2);
                let re = real[b] * cos - imaginary[b] * sin;
                let im = real[b] * sin + imaginary[b] * cos;
                (real[b], imaginary[b]) = (real[a] - re, imaginary[a] - im);
                real[a] += re;
                imaginary[a] += im;
            }
        }
        length *= 2;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_transform_of_a_wave_has_its_power_in_one_bin() {
        let n = 64;
        let wave = |k: usize| (TAU * 5.0 * k as f64 / n as f64).cos();
        let (mut real, mut imaginary): (Vec<f64>, _) = ((0..n).map(wave).collect(), vec![0.0; n]);
        transform(&mut real, &mut imaginary);
        for k in 0..n {
            let expected = if k == 5 || k == n - 5 { 32.0 } else { 0.0 };
            let apart = (real[k] - expected).hypot(imaginary[k]);
            assert!(apart < 1e-9, "{k}");
        }
    }
}
