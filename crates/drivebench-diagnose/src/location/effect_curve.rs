//! The curve of an effect: an equation's error without it along its axis, with the effect drawn through the points.
//!
//! ```text
//! model with the effect ----> windows: error of the equation with it  ------------------> points that lie on zero
//! the same values without --> windows: its error without it  ---------------------------> points
//!                                the difference of both: contribution of the effect -----> line
//! ```
//!
//! The points are measured, the line is computed, and both pass through the same windows and the same regression: where the
//! form is wrong the line misses the points. A change of the equation's own parameters besides the effect is taken out of
//! both.

use super::curve::AxisMap;
use super::failures::WEIGHT_OF_TIME;
use super::regression::{Basis, Fit, Regression, Variable};
use super::windows::{FEWEST_HALF, Windows};
use drivebench_identify::noise::NoiseFloor;
use drivebench_identify::output_error::FitError;
use drivebench_model::plant::effect::{self, Axis, ParameterRole};
use drivebench_model::plant::{ActiveEffect, Balance, Effect, Model, Scenario};

/// One knot of the axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CurvePoint {
    /// Position on the axis.
    pub at: f64,
    /// Error of the equation there, V or N.m, a loss counted positive.
    pub mean: f64,
    /// Its standard deviation.
    pub std: f64,
    /// Windows nearest to it.
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
        let knots = map.knots.iter().zip(&map.values).zip(&map.std);
        let points = knots.map(|((&at, &mean), &std)| CurvePoint { at, mean, std, count: 0 });
        Self {
            effect: None,
            equation: map.equation,
            unit: if map.equation == "voltage" { "V" } else { "N.m" },
            axis: map.axis,
            axis_unit: Axis::from_key(map.axis).map_or("", Axis::unit),
            periods_per_turn: 1.0,
            why_axis: Some(AxisReason::Map(Box::new(map.clone()))),
            points: points.collect(),
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
        if let Some(changes) = with_it.fit_own(*equation) {
            without_it.take_out(*equation, &changes);
        }
    }
    Ok(Pairs { without_it: &without_it, with_it: Some(&with_it) }.curve(Some(active)))
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
        windows.fit_own(*equation);
    }
    Ok(Pairs { without_it: &windows, with_it: None }.curve(None))
}

/// The windows of a run under the model without an effect and with it.
struct Pairs<'a> {
    without_it: &'a Windows<'a>,
    with_it: Option<&'a Windows<'a>>,
}

impl<'a> Pairs<'a> {
    /// Windows whose error is known in both, with a value of the errors without the effect and with it.
    fn of(&self, equation: Balance, value: impl Fn(f64, f64) -> f64) -> Regression<'a> {
        Regression::of(self.without_it, equation, |index, window| {
            let with = self.with_it.map(|with| with.each.get(index));
            let with = with.map_or(0.0, |with| with.map_or(f64::NAN, |with| with.error(equation)));
            let is_known = window.error(equation).is_finite() && with.is_finite();
            if is_known { value(window.error(equation), with) } else { f64::NAN }
        })
    }

    /// What is drawn: the contribution of an effect, else the error.
    fn drawn(&self, equation: Balance) -> Regression<'a> {
        self.of(equation, |without, with| without - with)
    }

    fn curve(&self, active: Option<&ActiveEffect>) -> Option<EffectCurve> {
        let input = self.without_it.scenario.input;
        let equations = super::equations(input);
        let periods_per_turn = periods_per_turn(active);
        let along = |errors: &Regression<'_>, variable| {
            let basis = errors.basis(variable, periods_per_turn)?;
            let fit = errors.fit(&basis.rows)?;
            Some((variable, basis, fit))
        };
        let own = active.and_then(|active| {
            let (equation, axis) = own_curve(active.effect)?;
            let drawn = equations.contains(&equation).then(|| self.drawn(equation))?;
            Some((equation, along(&drawn, Variable::Axis(axis))?))
        });
        let is_own = own.is_some();
        let (equation, (variable, basis, fit)) = own.or_else(|| {
            let equation = self.equation(equations)?;
            let drawn = self.drawn(equation);
            let weight = |(variable, _, fit): &(Variable, Basis, Fit)| {
                let is_time = *variable == Variable::Axis(Axis::Time);
                fit.r2 * if is_time { WEIGHT_OF_TIME } else { 1.0 }
            };
            let variables = Variable::of(equation, input, active.is_some()).into_iter();
            let tried = variables.filter_map(|variable| along(&drawn, variable));
            Some((equation, tried.max_by(|a, b| weight(a).total_cmp(&weight(b)))?))
        })?;
        let points = |errors: &Regression<'_>| Some(points(&basis, &errors.fit(&basis.rows)?));
        let (without, with) = (self.of(equation, |it, _| it), self.of(equation, |_, it| it));
        let effect = active.filter(|_| self.with_it.is_some());
        let is_angle = variable == Variable::Axis(Axis::Angle);
        Some(EffectCurve {
            effect: active.map(ActiveEffect::id),
            equation: equation.key(),
            unit: equation.unit(),
            axis: variable.key(),
            axis_unit: variable.unit(),
            periods_per_turn: if is_angle { periods_per_turn } else { 1.0 },
            why_axis: (!is_own).then(|| AxisReason::Share(fit.r2.max(0.0))),
            points: points(&without)?,
            line: effect.map_or_else(Vec::new, |_| {
                basis.knots.iter().copied().zip(fit.curve(&basis).0).collect()
            }),
            with_it: effect.and_then(|_| points(&with)).unwrap_or_default(),
            noise: (fit.noise > 0.0).then_some(fit.noise),
            rms_without: without.rms(),
            rms_with: effect.map(|_| with.rms()),
        })
    }

    /// The equation with the larger error, in units of its noise.
    fn equation(&self, equations: &[Balance]) -> Option<Balance> {
        let size = |equation: &Balance| {
            let noise = Regression::of(self.without_it, *equation, |_, own| own.floor(*equation));
            let without = self.of(*equation, |without, _| without);
            let unit = if noise.rms() > 0.0 { noise.rms() } else { without.rms() };
            self.drawn(*equation).rms() / unit.max(f64::MIN_POSITIVE)
        };
        let sizes = equations.iter().map(|equation| (size(equation), *equation));
        Some(sizes.max_by(|a, b| a.0.total_cmp(&b.0))?.1)
    }
}

/// A curve at its knots.
fn points(basis: &Basis, fit: &Fit) -> Vec<CurvePoint> {
    let (values, std) = fit.curve(basis);
    let mut counts = vec![0; basis.knots.len()];
    for place in basis.places.iter().filter(|place| place.is_finite()) {
        let apart = |knot: &usize| (basis.knots[*knot] - place).abs();
        if let Some(knot) = (0..counts.len()).min_by(|a, b| apart(a).total_cmp(&apart(b))) {
            counts[knot] += 1;
        }
    }
    let knots = basis.knots.iter().zip(values).zip(std).zip(counts);
    knots.map(|(((at, mean), std), count)| CurvePoint { at: *at, mean, std, count }).collect()
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
    use std::f64::consts::TAU;

    use super::*;
    use crate::kit::{held, nameplate, truth as with};
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
        assert!(curve.points.len() > 12 && curve.line.len() == curve.points.len());
        for (speed, torque) in &curve.line {
            assert!((torque - law(*speed)).abs() < 0.03 * largest, "{torque} at {speed}");
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
        let is_off = |point: &&CurvePoint| point.mean.abs() > 5.0 * point.std;
        let missed = curve.with_it.iter().filter(is_off).count();
        assert!(missed >= 3, "{missed}: {:?}", curve.with_it);
    }

    #[test]
    fn a_late_command_is_a_line_over_the_rate_of_the_voltage() {
        let truth = with("command_delay", &[0.004]);
        let events = held(&[40.0, 55.0, 20.0, 60.0, 35.0].repeat(8), 0.11);
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
        assert!(curve.points.iter().all(|point| point.at < TAU / 6.0));
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
