//! Location of an equation's error along each variable: the share that follows it, and the narrowest range that holds most.

use std::f64::consts::{PI, TAU};

use super::regression::{Fit, Regression, Variable};
use super::windows::{Window, Windows, own_keys};
use super::{ErrorForm, ErrorOf, FailureLocation};
use drivebench_model::plant::effect::Axis;
use drivebench_model::plant::{Balance, Model, MotorKey};

/// Thresholds of the location.
struct Settings {
    /// Largest order per turn.
    orders: usize,
    /// Fewest windows, by weight, with a contribution of a wave.
    fewest_windows_of_wave: f64,
    /// Share of the error that must follow a variable to be reported.
    worth_mentioning_share: f64,
    /// The same in multiples of what chance explains.
    beyond_chance: f64,
    /// Every periodic excitation has spectral lines: one comes first only where no physical variable comes near.
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
    /// Share of the error that follows a variable which a region must hold.
    region_share: f64,
    /// Bins of equal population in which a region begins and ends.
    bins: usize,
    /// Share of the time of a range of magnitudes below which a one-sided range is preferred: most faults are even in the sign.
    narrower_share: f64,
}

const SETTINGS: Settings = Settings {
    orders: 36,
    fewest_windows_of_wave: 30.0,
    worth_mentioning_share: 0.1,
    beyond_chance: 4.0,
    weight_of_line: 0.9,
    parsimony: 1.03,
    one_sided_share: 0.75,
    one_sided_share_of_time: 0.6,
    one_sided_windows: 20,
    nearly_all_share: 0.75,
    region_share: 0.8,
    bins: 24,
    narrower_share: 0.7,
};

/// Time is no physical cause: it comes first only where no physical variable explains nearly as much.
pub(super) const WEIGHT_OF_TIME: f64 = 0.85;

/// A variable on which the error depends, and its rank.
struct Ranked {
    location: FailureLocation,
    weight: f64,
}

/// The variables on which the error depends, the largest share first. `refitted`: whether the error is what the
/// equation's own parameters leave, so that they stand besides every variable.
pub(super) fn ranked(
    windows: &Windows<'_>,
    equation: Balance,
    refitted: bool,
    model: &Model,
    error_of: ErrorOf,
) -> Vec<FailureLocation> {
    let errors = Regression::new(windows, equation, refitted);
    let mut found = Vec::new();
    if !refitted {
        found.extend(errors.own_values(model, error_of));
    }
    found.extend(errors.along(Axis::Speed));
    match equation {
        Balance::Voltage => {
            found.extend(errors.along(Axis::Current));
            found.extend(errors.late(model));
        }
        // Not the current: this balance is solved for it, so that every missing effect correlates with it.
        Balance::Torque => {
            found.extend(errors.turns());
            found.extend(errors.line());
        }
    }
    found.extend(errors.offset());
    found.extend(errors.drift());
    found.extend(errors.one_way());
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

impl Regression<'_> {
    /// A fit that explains enough to be reported.
    pub(super) fn reported(&self, rows: &[Vec<f64>]) -> Option<Fit> {
        self.fit(rows).filter(Fit::is_reported)
    }

    /// A variable of one column, with its coefficient.
    fn single(&self, column: impl Fn(&Window) -> f64) -> Option<(f64, Fit)> {
        let fit = self.reported(&self.rows(1, |window, row| row[0] = column(window)))?;
        Some((fit.coefficients[0], fit))
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
        Ranked { location, weight: weight * fit.r2 }
    }

    /// Where along `places` most of what a fit explains lies.
    fn region(&self, places: &[f64], fit: &Fit) -> Option<Region> {
        let point = |((at, fitted), (window, _)): ((&f64, &f64), &(&Window, f64))| Point {
            at: *at,
            fitted: *fitted,
            beyond: window.beyond(self.equation),
        };
        let points = places.iter().zip(&fit.fitted).zip(&self.each).map(point);
        let known = points.filter(|point| point.at.is_finite() && point.fitted.is_finite());
        narrowest(&known.collect::<Vec<_>>())
    }

    /// The range in which most of the error lies along a variable, where it is not nearly everything.
    fn range(region: &Region, begin_s: f64) -> ErrorForm {
        let either_way = region.of_size;
        match (region.from_lowest, region.to_highest) {
            _ if region.share_of_time > SETTINGS.nearly_all_share => ErrorForm::Throughout,
            (true, _) => ErrorForm::Below { either_way, begin_s },
            (_, true) => ErrorForm::Above { either_way, begin_s },
            _ => ErrorForm::Between { either_way, begin_s },
        }
    }

    /// A curve over speed or current.
    fn along(&self, axis: Axis) -> Option<Ranked> {
        let basis = self.basis(Variable::Axis(axis), 1.0)?;
        let fit = self.reported(&basis.rows)?;
        let region = self.region(&basis.places, &fit)?;
        Some(self.ranked(axis.key(), region, &fit, 1.0, Self::range(&region, 0.0)))
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
            let (by, fit) = self.single(value)?;
            let region = if key == MotorKey::LoadTorque {
                everywhere(-1.0, 1.0)
            } else {
                let places = self.each.iter().map(|(window, _)| value(window));
                self.region(&places.collect::<Vec<_>>(), &fit)?
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
        // The loss is u(t) - u(t - delay).
        let (delay_s, fit) = self.single(|window| window.input_rate)?;
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
        let all = self.waves(&self.windows.angle_at_samples()?, 1.0, SETTINGS.orders);
        let of_order = |order: usize| {
            // Above half the sampling rate a wave is aliased: it is left out.
            let is_aliased = |window: &Window| {
                order as f64 * window.speed_rad_s.abs() * self.windows.period_s > PI
            };
            let wave = |(row, (window, _)): (&Vec<f64>, &(&Window, f64))| {
                let wave = &row[2 * order - 2..2 * order];
                if is_aliased(window) { vec![0.0; 2] } else { wave.to_vec() }
            };
            let rows: Vec<Vec<f64>> = all.iter().zip(&self.each).map(wave).collect();
            // A wave with a contribution in few windows only, as of a high order, would overfit them.
            let size = || rows.iter().map(|wave| wave[0] * wave[0] + wave[1] * wave[1]);
            let (sum, squares): (f64, f64) = (size().sum(), size().map(|size| size * size).sum());
            let is_supported = sum * sum / squares > SETTINGS.fewest_windows_of_wave;
            Some((order, is_supported.then(|| self.fit(&rows))??))
        };
        let orders = (1..=SETTINGS.orders).filter_map(of_order);
        let (order, fit) = orders.max_by(|a, b| a.1.r2.total_cmp(&b.1.r2))?;
        let form = ErrorForm::PerTurn { order, amplitude: fit.coefficients.norm() };
        let ranked = self.ranked("angle_rad", everywhere(0.0, TAU), &fit, 1.0, form);
        fit.is_reported().then_some(ranked)
    }

    fn line(&self) -> Option<Ranked> {
        let line = self.strongest_line().filter(|line| line.is_alone && line.fit.is_reported())?;
        let (size, _) = line.fit.amplitude();
        let form = ErrorForm::Line { amplitude: size / line.window_gain };
        // The resolution by the length of the run.
        let times = &self.windows.scenario.sample_time_s;
        let half_hz = 0.5 / (times[times.len() - 1] - times[0]);
        let region = Region {
            share_of_error: line.fit.follows,
            ..everywhere(line.frequency_hz - half_hz, line.frequency_hz + half_hz)
        };
        Some(self.ranked("frequency_hz", region, &line.fit, SETTINGS.weight_of_line, form))
    }

    /// A curve over time: of the equation itself, or of what multiplies its current (voltage) or its direction (torque:
    /// friction acts against the motion, and a load that changes does so too); the better.
    fn drift(&self) -> Option<Ranked> {
        let basis = self.basis(Variable::Axis(Axis::Time), 1.0)?;
        let modulation: fn(&Window) -> f64 = match self.equation {
            Balance::Voltage => |window| window.current_a,
            Balance::Torque => |window| window.direction,
        };
        let mut modulated = basis.rows.clone();
        for (row, (window, _)) in modulated.iter_mut().zip(&self.each) {
            for value in row {
                *value *= modulation(window);
            }
        }
        let fits = [&basis.rows, &modulated].map(|rows| self.reported(rows));
        let [plain, modulated] = &fits;
        let r2 = |fit: &Option<Fit>| fit.as_ref().map(|fit| fit.r2);
        let is_modulated = r2(modulated) > r2(plain);
        let fit = if is_modulated { modulated } else { plain }.as_ref()?;
        let times: Vec<f64> = self.each.iter().map(|(window, _)| window.time_s).collect();
        let region = self.region(&times, fit)?;
        let form = if is_modulated && self.equation == Balance::Voltage {
            let last = fit.coefficients.len() - 1;
            ErrorForm::ResistanceDrift { by_ohm: fit.coefficients[last] - fit.coefficients[0] }
        } else {
            // The time stamps of a drive count from its power-on, those of a run from its begin.
            Self::range(&region, self.windows.scenario.begin_s())
        };
        Some(self.ranked("time_s", region, fit, WEIGHT_OF_TIME, form))
    }

    /// A constant error.
    fn offset(&self) -> Option<Ranked> {
        let (by, fit) = self.single(|_| 1.0)?;
        let variable = match self.equation {
            Balance::Torque => "offset_n_m",
            Balance::Voltage => "offset_v",
        };
        let region = everywhere(by.min(0.0), by.max(0.0));
        Some(self.ranked(variable, region, &fit, SETTINGS.parsimony, ErrorForm::Offset { by }))
    }

    /// Whether nearly all of the error falls in one direction of motion: always after the other variables.
    fn one_way(&self) -> Option<Ranked> {
        let sides = self.windows.by_direction(self.equation);
        let (whole, count) = (sides[0].0 + sides[1].0, sides[0].1 + sides[1].1);
        let forward = sides[1].0 > sides[0].0;
        let (beyond, windows) = sides[usize::from(forward)];
        let (held, time) = (beyond / whole, windows as f64 / count.max(1) as f64);
        if !(held >= SETTINGS.one_sided_share
            && time <= SETTINGS.one_sided_share_of_time
            && windows >= SETTINGS.one_sided_windows)
        {
            return None;
        }
        let (from, to) = if forward { (0.0, 1.0) } else { (-1.0, 0.0) };
        let location = FailureLocation {
            equation: self.equation.key(),
            variable: "direction",
            from,
            to,
            share_of_error: held,
            share_of_time: time,
            follows: held,
            strength: windows as f64,
            form: ErrorForm::OneWay { forward },
        };
        Some(Ranked { location, weight: 0.0 })
    }
}

impl Fit {
    fn is_reported(&self) -> bool {
        self.follows >= SETTINGS.worth_mentioning_share && self.strength >= SETTINGS.beyond_chance
    }
}

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
    if last < 3 * SETTINGS.bins || sorted[0].0 >= sorted[last].0 {
        return None;
    }
    // Equal populations resolve where the run spent much time.
    let first_of = |bin: usize| bin * sorted.len() / SETTINGS.bins;
    let edge = |bin: usize| sorted[first_of(bin).min(last)].0;
    let sums = |value: fn(&Point) -> f64| -> Vec<f64> {
        let inside = |bin: usize| sorted[first_of(bin)..first_of(bin + 1)].iter();
        let sum = |bin: usize| inside(bin).map(|(_, point)| value(point)).sum();
        (0..SETTINGS.bins).map(sum).collect()
    };
    let follows = sums(|point| point.fitted * point.fitted);
    let beyond: Vec<f64> = sums(|point| point.beyond).into_iter().map(|sum| sum.max(0.0)).collect();
    let total: f64 = follows.iter().sum();
    let held = |(first, end): (usize, usize)| follows[first..=end].iter().sum::<f64>();
    let ranges =
        (0..SETTINGS.bins).flat_map(|first| (first..SETTINGS.bins).map(move |end| (first, end)));
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
        to_highest: end + 1 == SETTINGS.bins,
    })
}
