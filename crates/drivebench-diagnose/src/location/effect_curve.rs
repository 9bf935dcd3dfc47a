//! The curve of an effect: an equation's error without it along its axis, with the effect drawn through the points.
//!
//! ```text
//! model with the effect ----> windows: error of the equation with it  ------------------> points that lie on zero
//! the same values without --> windows: its error without it  ---------------------------> points
//!                                the difference of both: contribution of the effect -----> line
//! ```
//!
//! The points are measured, the line is computed, and both pass through the same windows: where the form is wrong the line
//! misses the points. A change of the equation's own parameters besides the effect is taken out of both.

use std::f64::consts::TAU;

use super::axis::Search;
use super::curve::AxisMap;
use super::windows::{FEWEST_HALF, Window, Windows, own_keys};
use drivebench_identify::noise::NoiseFloor;
use drivebench_identify::output_error::FitError;
use drivebench_model::numerics::count::whole;
use drivebench_model::numerics::statistics::extent;
use drivebench_model::plant::effect::{self, Axis, ParameterRole};
use drivebench_model::plant::{ActiveEffect, Balance, Effect, Input, Model, Scenario};

/// Bins of the points, and of the line.
const BINS: usize = 24;
const BINS_OF_A_LINE: usize = 72;
/// Windows in a bin from which on its mean has an uncertainty of its own; fewer are no point.
const FEWEST_IN_A_BIN: usize = 3;
/// Windows below which nothing is drawn.
const FEWEST_WINDOWS: usize = 12;
/// Neighbouring windows share half of their samples.
const WINDOWS_EACH: f64 = 2.0;
/// Share of a period of the angle that a window may turn through; and share of the range that its speed, current or voltage
/// may vary (a standard deviation), so that a mean is that of one position.
const STILLEST_SHARE: f64 = 0.35;
const STEADY_SHARE: f64 = 0.015;
/// Number of such windows from which on only they are used.
const STILL_WINDOWS: usize = 60;
/// Time is no physical cause: an axis only where no physical variable explains nearly as much.
const WEIGHT_OF_TIME: f64 = 0.85;

/// What lies in one bin of the axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CurvePoint {
    /// Mean position on the axis.
    pub at: f64,
    /// Mean error of the equation there, V or N.m, a loss counted positive.
    pub mean: f64,
    /// Standard deviation of the mean.
    pub std: f64,
    /// Windows in the bin.
    pub count: usize,
}

/// Why a curve is drawn along its axis, where the effect has none of its own.
#[derive(Clone, Debug, PartialEq)]
pub enum AxisReason {
    /// This share of what the effect does, or of the error, follows it.
    Share(f64),
    /// It is an error that no effect explains, as its map has it.
    Map(Box<AxisMap>),
}

/// An equation's error along an axis and the effect that is to explain it.
#[derive(Clone, Debug, PartialEq)]
pub struct EffectCurve {
    /// The effect that is drawn; none where there is only the error.
    pub effect: Option<&'static str>,
    /// `torque` or `voltage`, and the unit of the values.
    pub equation: &'static str,
    pub unit: &'static str,
    /// `speed_rad_s`, `current_a`, `voltage_v`, `angle_rad`, `time_s` (since the run's first command),
    /// `acceleration_rad_s2`, `current_rate_a_s` or `voltage_rate_v_s`.
    pub axis: &'static str,
    pub axis_unit: &'static str,
    /// Of an angle: the equal parts of a turn that are drawn as one.
    pub periods_per_turn: f64,
    pub why_axis: Option<AxisReason>,
    /// Error of the equation without the effect.
    pub points: Vec<CurvePoint>,
    /// Contribution of the effect along the axis, at its size; empty where there is only the error.
    pub line: Vec<(f64, f64)>,
    /// Error of the equation with the effect in the model: zero where the model is complete; empty where there is only the
    /// error.
    pub with_it: Vec<CurvePoint>,
    /// Root mean square of the points that noise alone would leave in a window; null where no noise is known.
    pub noise: Option<f64>,
    /// The same of the equation's error without and with the effect.
    pub rms_without: f64,
    pub rms_with: Option<f64>,
}

impl EffectCurve {
    /// Whether it is an error that no effect explains, over knots and not over windows of a run.
    pub const fn is_unexplained(&self) -> bool {
        !self.rms_without.is_finite()
    }
}

impl From<&AxisMap> for EffectCurve {
    fn from(map: &AxisMap) -> Self {
        let points = map.knots.iter().zip(&map.values).enumerate();
        let point = |(knot, (at, mean)): (usize, (&f64, &f64))| CurvePoint {
            at: *at,
            mean: *mean,
            std: map.std.get(knot).copied().unwrap_or(f64::NAN),
            count: 0,
        };
        Self {
            effect: None,
            equation: map.equation,
            unit: if map.equation == "voltage" { "V" } else { "N.m" },
            axis: map.axis,
            axis_unit: Axis::from_key(map.axis).map_or("", Axis::unit),
            periods_per_turn: 1.0,
            why_axis: Some(AxisReason::Map(Box::new(map.clone()))),
            points: points.map(point).collect(),
            line: Vec::new(),
            with_it: Vec::new(),
            noise: None,
            rms_without: f64::NAN,
            rms_with: None,
        }
    }
}

/// The effect `id` of a complete `model` and the error without it on `run`. `None` where it is not in the model, or where
/// the run does not determine it.
pub fn effect_curve(
    model: &Model,
    id: &str,
    run: &Scenario,
    noise: &NoiseFloor,
) -> Result<Option<EffectCurve>, FitError> {
    let Some(active) = model.effects.iter().find(|active| active.id() == id) else {
        return Ok(None);
    };
    let mut without = model.clone();
    without.effects.retain(|active| active.id() != id);
    let mut with_it = Windows::new(model, run, noise, FEWEST_HALF)?;
    let mut without_it = Windows::new(&without, run, noise, FEWEST_HALF)?;
    if with_it.missing_signal().is_some() {
        return Ok(None);
    }
    for equation in super::equations(run.input) {
        if let Some(changes) = with_it.own_changes(*equation) {
            with_it.take_out(*equation, &changes);
            without_it.take_out(*equation, &changes);
        }
    }
    let pairs = Pairs { without_it: &without_it, with_it: Some(&with_it) };
    Ok(pairs.curve(Some(active)))
}

/// Error of a complete `model` on `run`, along the axis with the largest share. `None` where the run does not determine it.
pub fn error_curve(
    model: &Model,
    run: &Scenario,
    noise: &NoiseFloor,
) -> Result<Option<EffectCurve>, FitError> {
    let mut windows = Windows::new(model, run, noise, FEWEST_HALF)?;
    if windows.missing_signal().is_some() {
        return Ok(None);
    }
    for equation in super::equations(run.input) {
        if let Some(changes) = windows.own_changes(*equation) {
            windows.take_out(*equation, &changes);
        }
    }
    let pairs = Pairs { without_it: &windows, with_it: None };
    Ok(pairs.curve(None))
}

/// The windows of a run under the model without an effect and with it.
struct Pairs<'a> {
    without_it: &'a Windows<'a>,
    with_it: Option<&'a Windows<'a>>,
}

/// A variable that an error can be drawn along.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Along {
    Axis(Axis),
    /// Own columns of a balance: rate of the current, acceleration.
    CurrentRate,
    Acceleration,
    VoltageRate,
}

impl Along {
    const fn key(self) -> &'static str {
        match self {
            Self::Axis(axis) => axis.key(),
            Self::CurrentRate => "current_rate_a_s",
            Self::Acceleration => "acceleration_rad_s2",
            Self::VoltageRate => "voltage_rate_v_s",
        }
    }

    const fn unit(self) -> &'static str {
        match self {
            Self::Axis(axis) => axis.unit(),
            Self::CurrentRate => "A/s",
            Self::Acceleration => "rad/s2",
            Self::VoltageRate => "V/s",
        }
    }
}

/// One window along the axis.
#[derive(Clone, Copy)]
struct At {
    place: f64,
    without: f64,
    with: f64,
    floor: f64,
}

impl Pairs<'_> {
    /// Windows whose error is known in both, with their position.
    fn along(
        &self,
        equation: Balance,
        place: impl Fn(usize, &Window) -> f64,
    ) -> impl Iterator<Item = At> {
        let without = self.without_it.each.iter().enumerate();
        without.filter_map(move |(index, window)| {
            let with = self
                .with_it
                .map_or(Some(0.0), |with| Some(with.each.get(index)?.error(equation)))?;
            let at = At {
                place: place(index, window),
                without: window.error(equation),
                with,
                floor: window.floor(equation),
            };
            let is_known = at.place.is_finite() && at.without.is_finite() && at.with.is_finite();
            is_known.then_some(at)
        })
    }

    /// What is drawn: the contribution of an effect, else the error.
    fn followed(&self, at: &At) -> f64 {
        at.without - if self.with_it.is_some() { at.with } else { 0.0 }
    }

    fn curve(&self, active: Option<&ActiveEffect>) -> Option<EffectCurve> {
        let scenario = self.without_it.scenario;
        let equations = super::equations(scenario.input);
        let own = active.and_then(|active| own_curve(active.effect));
        let own = own.filter(|(equation, _)| equations.contains(equation));
        let own = own.and_then(|(equation, axis)| {
            let places = self.places(equation, Along::Axis(axis), active)?;
            Some((equation, Along::Axis(axis), places, None))
        });
        let (equation, along, places, share_followed) = own.or_else(|| {
            let equation = self.equation(equations)?;
            let tried = candidates(equation, scenario.input, active).into_iter();
            let tried = tried.filter_map(|along| {
                let places = self.places(equation, along, active)?;
                let r2 = self.follows(equation, &places)?;
                let weight = if along == Along::Axis(Axis::Time) { WEIGHT_OF_TIME } else { 1.0 };
                Some((weight * r2, along, places, r2))
            });
            let best = tried.max_by(|a, b| a.0.total_cmp(&b.0))?;
            Some((equation, best.1, best.2, Some(best.3)))
        })?;
        let all: Vec<At> = self.along(equation, |index, _| places[index]).collect();
        let (least, most) = extent(all.iter().map(|at| at.place));
        if all.len() < FEWEST_WINDOWS || most <= least {
            return None;
        }
        let bins = edges(&all, BINS);
        let fine = edges(&all, BINS_OF_A_LINE);
        let points = |of: fn(&At) -> f64| points(&all, &bins, of);
        let rms = |of: fn(&At) -> f64| {
            let squares: f64 = all.iter().map(|at| of(at).powi(2)).sum();
            (squares / all.len() as f64).sqrt()
        };
        let noise = rms(|at| at.floor);
        let is_angle = along == Along::Axis(Axis::Angle);
        let is_drawn = self.with_it.is_some();
        Some(EffectCurve {
            effect: active.map(ActiveEffect::id),
            equation: equation.key(),
            unit: equation.unit(),
            axis: along.key(),
            axis_unit: along.unit(),
            periods_per_turn: if is_angle { periods_per_turn(active) } else { 1.0 },
            why_axis: share_followed.map(AxisReason::Share),
            points: points(|at| at.without),
            line: if is_drawn { line(&all, &fine) } else { Vec::new() },
            with_it: if is_drawn { points(|at| at.with) } else { Vec::new() },
            noise: (noise > 0.0).then_some(noise),
            rms_without: rms(|at| at.without),
            rms_with: is_drawn.then(|| rms(|at| at.with)),
        })
    }

    /// The equation with the larger error, in units of its noise.
    fn equation(&self, equations: &[Balance]) -> Option<Balance> {
        let size = |equation: &Balance| {
            let (mut power, mut unit) = (0.0, 0.0);
            for at in self.along(*equation, |_, _| 0.0) {
                power += self.followed(&at).powi(2);
                unit += if at.floor > 0.0 { at.floor.powi(2) } else { at.without.powi(2) };
            }
            power / f64::max(unit, f64::MIN_POSITIVE)
        };
        let sizes = equations.iter().map(|equation| (size(equation), *equation));
        Some(sizes.max_by(|a, b| a.0.total_cmp(&b.0))?.1)
    }

    /// Position of every window on an axis, in the order of the windows; `None` where the run does not have it.
    fn places(
        &self,
        equation: Balance,
        along: Along,
        active: Option<&ActiveEffect>,
    ) -> Option<Vec<f64>> {
        let windows = self.without_it;
        let each = windows.each.iter();
        Some(match along {
            Along::Axis(Axis::Speed) => {
                let places = each.map(|window| window.speed_rad_s).collect();
                self.steady(places, &windows.scenario.speed_rad_s)
            }
            Along::Axis(Axis::Current) => {
                let places = each.map(|window| window.current_a).collect();
                self.steady(places, &windows.scenario.current_a)
            }
            Along::Axis(Axis::Voltage) => each.map(Window::input).collect(),
            Along::Axis(Axis::Time) => {
                let begin_s = windows.scenario.begin_s();
                each.map(|window| window.time_s - begin_s).collect()
            }
            Along::CurrentRate => each.map(|window| window.own(Balance::Voltage)[1]).collect(),
            Along::Acceleration => each.map(|window| window.own(Balance::Torque)[0]).collect(),
            Along::VoltageRate => each.map(|window| window.input_rate).collect(),
            Along::Axis(Axis::Angle) => {
                let search = Search { windows, equation, own: own_keys(equation).len() };
                let angle = search.angle_at_samples()?;
                let period_rad = TAU / periods_per_turn(active);
                let middle_and_travel = |window: &Window| {
                    let angle = &angle[windows.samples_of(window)];
                    let travel = angle[angle.len() - 1] - angle[0];
                    (angle[angle.len() / 2], travel.abs() / period_rad)
                };
                let turned: Vec<(f64, f64)> = each.map(middle_and_travel).collect();
                // A window that turns through much of a period averages it away, in points and line.
                let place = |turn: &(f64, f64)| turn.0.rem_euclid(period_rad);
                let is_still = turned.iter().map(|turn| turn.1 < STILLEST_SHARE).collect();
                where_enough(turned.iter().map(place).collect(), is_still)
            }
        })
    }

    /// Without the windows in which the axis varies, where enough are left: the mean of a curve over a transient
    /// is not its value at the mean.
    fn steady(&self, places: Vec<f64>, samples: &[f64]) -> Vec<f64> {
        let windows = self.without_it;
        let known = places.iter().filter(|place| place.is_finite());
        let (least, most) = extent(known);
        let is_steady = |(window, place): (&Window, &f64)| {
            let weights = windows.weights_of(window).mean;
            let own = &samples[windows.samples_of(window)];
            let squares = weights.iter().zip(own);
            let variance: f64 = squares.map(|(w, value)| w * (value - place).powi(2)).sum();
            variance.sqrt() < STEADY_SHARE * (most - least)
        };
        let is_steady = windows.each.iter().zip(&places).map(is_steady).collect();
        where_enough(places, is_steady)
    }

    /// Adjusted R2 of the means over bins of an axis.
    fn follows(&self, equation: Balance, places: &[f64]) -> Option<f64> {
        let all: Vec<At> = self.along(equation, |index, _| places[index]).collect();
        let n = all.len() as f64;
        if all.len() < FEWEST_WINDOWS.max(2 * BINS) {
            return None;
        }
        let bins = edges(&all, BINS);
        let mean = all.iter().map(|at| self.followed(at)).sum::<f64>() / n;
        let (mut left, mut total) = (0.0, 0.0);
        for inside in in_bins(&all, &bins) {
            let of_bin: f64 = inside.iter().map(|at| self.followed(at)).sum();
            let of_bin = of_bin / inside.len() as f64;
            for at in inside {
                left += (self.followed(at) - of_bin).powi(2);
                total += (self.followed(at) - mean).powi(2);
            }
        }
        let k = bins.len() as f64;
        (total > 0.0).then(|| (1.0 - (left / (n - k)) / (total / n)).clamp(0.0, 1.0))
    }
}

/// Only the `eligible` positions, where they are enough; all of them else.
fn where_enough(places: Vec<f64>, eligible: Vec<bool>) -> Vec<f64> {
    if eligible.iter().filter(|is| **is).count() < STILL_WINDOWS {
        return places;
    }
    places.into_iter().zip(eligible).map(|(place, is)| if is { place } else { f64::NAN }).collect()
}

/// Equation and axis of an effect that is a curve: by its card, and the angle for an effect that needs it.
fn own_curve(effect: &dyn Effect) -> Option<(Balance, Axis)> {
    let card = effect.card();
    let of_a_turn = (card.needs_angle && card.enters.includes(Balance::Torque))
        .then_some((Balance::Torque, Axis::Angle));
    card.curve.or(of_a_turn)
}

/// How often an effect of the angle repeats within a turn.
fn periods_per_turn(active: Option<&ActiveEffect>) -> f64 {
    let order = active.and_then(|active| {
        let place = active.effect.parameters().iter().position(|spec| spec.key == "order")?;
        active.values_or_guess().get(place).copied()
    });
    order.filter(|order| *order >= 1.0).unwrap_or(1.0).round()
}

/// Axes that are tried. The variable that a balance is solved for is none where only the error is known: every missing effect
/// correlates with it.
fn candidates(equation: Balance, input: Input, active: Option<&ActiveEffect>) -> Vec<Along> {
    let mut tried = vec![Along::Axis(Axis::Speed), Along::Axis(Axis::Time)];
    let is_electrical = input == Input::Voltage;
    if is_electrical && (equation == Balance::Voltage || active.is_some()) {
        tried.extend([Along::Axis(Axis::Current), Along::CurrentRate]);
    }
    if is_electrical && (equation == Balance::Torque || active.is_some()) {
        tried.push(Along::Axis(Axis::Voltage));
    }
    if is_electrical && equation == Balance::Voltage {
        tried.push(Along::VoltageRate);
    }
    if equation == Balance::Torque {
        tried.push(Along::Axis(Axis::Angle));
    }
    if active.is_some() {
        tried.push(Along::Acceleration);
    }
    tried
}

/// Edges of bins: halfway between equal populations and even spacing, and one at zero where both signs occur, as many effects
/// depend on the direction. The last edge is the end.
fn edges(all: &[At], bins: usize) -> Vec<f64> {
    let mut sorted: Vec<f64> = all.iter().map(|at| at.place).collect();
    sorted.sort_by(f64::total_cmp);
    let (first, last) = (sorted[0], sorted[sorted.len() - 1]);
    let edge = |bin: usize| {
        let part = bin as f64 / bins as f64;
        let even = first + part * (last - first);
        let place = sorted[whole(part * (sorted.len() - 1) as f64)];
        0.5 * (even + place)
    };
    let mut edges: Vec<f64> = (1..=bins).map(edge).collect();
    if first < 0.0 && last > 0.0 {
        edges.push(0.0);
    }
    edges.sort_by(f64::total_cmp);
    edges.dedup_by(|later, earlier| *later <= *earlier);
    edges
}

/// What lies in each bin, those without anything left out.
fn in_bins<'a>(all: &'a [At], edges: &[f64]) -> Vec<Vec<&'a At>> {
    let mut bins: Vec<Vec<&At>> = vec![Vec::new(); edges.len()];
    for at in all {
        let bin = edges.partition_point(|edge| *edge < at.place);
        bins[bin.min(edges.len() - 1)].push(at);
    }
    bins.retain(|inside| !inside.is_empty());
    bins
}

fn points(all: &[At], edges: &[f64], of: fn(&At) -> f64) -> Vec<CurvePoint> {
    let bins = in_bins(all, edges).into_iter().filter(|inside| inside.len() >= FEWEST_IN_A_BIN);
    let point = |inside: Vec<&At>| {
        let n = inside.len() as f64;
        let mean = |value: &dyn Fn(&At) -> f64| inside.iter().map(|at| value(at)).sum::<f64>() / n;
        let value = mean(&of);
        let variance = mean(&|at| (of(at) - value).powi(2)) * n / (n - 1.0);
        let floor = mean(&|at| at.floor.powi(2));
        CurvePoint {
            at: mean(&|at| at.place),
            mean: value,
            std: (variance.max(floor) * WINDOWS_EACH / n).sqrt(),
            count: inside.len(),
        }
    };
    bins.map(point).collect()
}

/// What the effect does, as the mean of each bin.
fn line(all: &[At], edges: &[f64]) -> Vec<(f64, f64)> {
    let bins = in_bins(all, edges).into_iter();
    let middle = |inside: Vec<&At>| {
        let n = inside.len() as f64;
        let place: f64 = inside.iter().map(|at| at.place).sum();
        let value: f64 = inside.iter().map(|at| at.without - at.with).sum();
        (place / n, value / n)
    };
    bins.map(middle).collect()
}

/// `model` with the effect `id` at this size; the time of an event is estimated in every run anew.
/// `None` where a value is not known.
pub(crate) fn with_candidate(
    model: &Model,
    id: &str,
    value: impl Fn(&str) -> Option<f64>,
) -> Option<Model> {
    if model.has(id) {
        return Some(model.clone());
    }
    let effect = effect::find(id)?;
    let mut active = ActiveEffect::new(effect);
    for (own, spec) in active.values.iter_mut().zip(effect.parameters()) {
        *own = value(spec.key);
        if own.is_none() && spec.role != ParameterRole::EventTime {
            return None;
        }
    }
    let mut with = model.clone();
    with.effects.push(active);
    Some(with)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kit::{nameplate, truth as with};
    use drivebench_model::plant::testing::{self, with_a_fan};

    const FAN: f64 = 4e-6;

    fn drawn(model: &Model, id: &str, run: &Scenario) -> EffectCurve {
        let noise = NoiseFloor::from_standstill(run).unwrap();
        effect_curve(model, id, run, &noise).unwrap().unwrap()
    }

    #[test]
    fn the_curve_of_a_fan_is_its_parabola() {
        let run = with_a_fan(0);
        let curve = drawn(&with("quadratic_load", &[FAN]), "quadratic_load", &run);
        assert_eq!((curve.equation, curve.axis), ("torque", "speed_rad_s"));
        assert_eq!(curve.why_axis, None);
        let law = |speed: f64| FAN * speed * speed.abs();
        let largest = law(250.0);
        assert!(curve.line.len() > 30 && curve.points.len() > 12);
        for (speed, torque) in &curve.line {
            let apart = (torque - law(*speed)).abs();
            assert!(apart < 0.03 * largest, "{torque} at {speed}");
        }
        // Measured, through another way: within four of their own standard deviations and what the bins are wide.
        for point in &curve.points {
            let apart = (point.mean - law(point.at)).abs();
            assert!(apart < 4.0 * point.std + 0.03 * largest, "{point:?}");
        }
        for point in &curve.with_it {
            assert!(point.mean.abs() < 4.5 * point.std, "on zero with it: {point:?}");
        }
        let (without, with) = (curve.rms_without, curve.rms_with.unwrap());
        assert!(with < 1.2 * curve.noise.unwrap() && without > 3.0 * with, "{curve:?}");
    }

    #[test]
    fn a_line_of_the_wrong_form_misses_the_points() {
        let run = with_a_fan(0);
        // As much loss at 150 rad/s, linear.
        let curve = drawn(&with("viscous_friction", &[150.0 * FAN]), "viscous_friction", &run);
        let off = |point: &CurvePoint| point.mean.abs() > 5.0 * point.std;
        let missed = curve.with_it.iter().filter(|point| off(point)).count();
        assert!(missed >= 3, "{missed}: {:?}", curve.with_it);
    }

    #[test]
    fn a_late_command_is_a_line_over_the_rate_of_the_voltage() {
        let truth = with("command_delay", &[0.004]);
        let steps = (0..40).map(|k| {
            let level = [40.0, 55.0, 20.0, 60.0, 35.0][k % 5];
            (0.3 + 0.11 * k as f64, level)
        });
        let events = std::iter::once((0.0, 0.0)).chain(steps).collect();
        let run = testing::record(&truth, events, 0.001, 5.0, 3);
        let curve = drawn(&truth, "command_delay", &run);
        assert_eq!((curve.equation, curve.axis), ("voltage", "voltage_rate_v_s"));
        assert!(matches!(curve.why_axis, Some(AxisReason::Share(_))));
        let far = curve.line.iter().max_by(|a, b| a.0.total_cmp(&b.0)).unwrap();
        let slope_s = far.1 / far.0;
        assert!((slope_s / 0.004 - 1.0).abs() < 0.15, "{slope_s}");
    }

    #[test]
    fn an_effect_of_the_angle_is_folded_into_its_period() {
        let truth = with("cogging", &[0.05, 0.0, 6.0]);
        let events = testing::held([0.0, 0.4, 2.5, 4.5], [0.0, 9.0, -9.0, 12.0]);
        let run = testing::record(&truth, events, 0.002, 6.5, 5);
        let curve = drawn(&truth, "cogging", &run);
        assert_eq!(curve.axis, "angle_rad", "{curve:?}");
        assert!((curve.periods_per_turn - 6.0).abs() < 1e-12, "{curve:?}");
        assert!(curve.points.iter().map(|point| point.at).fold(0.0, f64::max) < TAU / 6.0);
        let highest = curve.line.iter().map(|at| at.1).fold(0.0, f64::max);
        assert!(highest > 0.02 && highest < 0.055, "{highest}");
    }

    #[test]
    fn without_a_candidate_there_is_the_error_along_the_axis_that_it_follows() {
        let run = with_a_fan(0);
        let noise = NoiseFloor::from_standstill(&run).unwrap();
        let curve = error_curve(&nameplate(), &run, &noise).unwrap().unwrap();
        assert_eq!((curve.equation, curve.axis), ("torque", "speed_rad_s"));
        assert!(curve.line.is_empty() && curve.with_it.is_empty() && curve.effect.is_none());
        assert!(curve.points.len() > 12 && curve.why_axis.is_some());
        assert_eq!(effect_curve(&nameplate(), "cogging", &run, &noise).unwrap(), None);
    }
}
