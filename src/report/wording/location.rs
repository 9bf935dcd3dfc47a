//! Where a model fails: equations, ranges of a variable, curves.

use std::fmt::{Display, Write as _};

use super::limits::trivial;
use drivebench_diagnose::{
    AxisFinding, AxisMap, AxisReason, Comparison, EffectCurve, EquationBalance, EquationState,
    ErrorForm, FailureLocation, Undecided, Where,
};
use drivebench_model::plant::MotorKey;
use drivebench_model::plant::effect::Axis;
use drivebench_model::text::number::{share, shortest, significant};

/// A place or size has three significant digits.
fn figure(value: f64) -> String {
    shortest(value, 3)
}

/// Name and unit of a variable that an error may follow; empty where it follows none.
const fn name_and_unit(variable: &str) -> (&'static str, &'static str) {
    match variable.as_bytes() {
        b"speed_rad_s" => ("speed", "rad/s"),
        b"current_a" => ("current", "A"),
        b"voltage_v" => ("voltage", "V"),
        b"time_s" => ("time", "s"),
        b"acceleration_rad_s2" => ("acceleration", "rad/s2"),
        b"current_rate_a_s" => ("rate of the current", "A/s"),
        b"voltage_rate_v_s" => ("rate of the voltage", "V/s"),
        b"direction" => ("direction of motion", ""),
        b"angle_rad" => ("angle", "rad"),
        b"voltage_edge_s" => ("timing of the voltage", "s"),
        b"frequency_hz" => ("phase of a line in frequency", ""),
        _ => ("", ""),
    }
}

/// Unit of an equation's error.
fn unit_of(equation: &str) -> &'static str {
    if equation == "voltage" { "V" } else { "N.m" }
}

pub fn location(found: &FailureLocation) -> String {
    let sentence = |of_error: f64, what: &dyn Display| {
        format!("{} of the {} error {what}", share(of_error), found.equation)
    };
    let follows = |what: String| sentence(found.follows, &what);
    let (name, _) = name_and_unit(found.variable);
    let unit = unit_of(found.equation);
    let lies = |place: String, either_way: bool| {
        let either = if either_way { " in either direction" } else { "" };
        let time = share(found.share_of_time);
        sentence(found.share_of_error, &format!("lies {place}{either} ({time} of the time)"))
    };
    let [from, to] = match found.form {
        ErrorForm::Below { begin_s, .. }
        | ErrorForm::Above { begin_s, .. }
        | ErrorForm::Between { begin_s, .. } => [found.from - begin_s, found.to - begin_s],
        _ => [found.from, found.to],
    }
    .map(figure);
    let along = match found.variable {
        "time_s" => "s of the run",
        variable => name_and_unit(variable).1,
    };
    match found.form {
        ErrorForm::Below { either_way, .. } => lies(format!("below {to} {along}"), either_way),
        ErrorForm::Above { either_way, .. } => lies(format!("above {from} {along}"), either_way),
        ErrorForm::Between { either_way, .. } => {
            lies(format!("between {from} and {to} {along}"), either_way)
        }
        ErrorForm::Throughout => {
            let range =
                if found.variable == "time_s" { "the whole run" } else { "its whole range" };
            follows(format!("follows the {name}, over {range}"))
        }
        ErrorForm::ModelValue { key, by, own } => follows(format!(
            "follows the {name}, as with a {} that is {} too {} in the model ({} {})",
            key.name(),
            share((by / own).abs()),
            if by > 0.0 { "low" } else { "high" },
            figure(by.abs()),
            key.unit(),
        )),
        ErrorForm::WindowValue { key, by, own } => follows(format!(
            "follows the {name}: short windows give {} {} {}, the fit to the whole run has {}",
            key.name(),
            figure(own + by),
            key.unit(),
            figure(own)
        )),
        ErrorForm::ValueBeside { key, by } => follows(format!(
            "follows the {name}, as with a further {} of {} {}",
            key.name(),
            figure(by),
            key.unit()
        )),
        ErrorForm::VoltageTiming { delay_s, is_resolved } => {
            let by = || format!(" {} ms", figure(1e3 * delay_s.abs()));
            let by = is_resolved.then(by).unwrap_or_default();
            let word = if delay_s > 0.0 { "late" } else { "early" };
            follows(format!("follows the steps of the voltage, as if it came{by} {word} (timing)"))
        }
        ErrorForm::PerTurn { order, amplitude } => {
            let times = match order {
                1 => "once".to_owned(),
                2 => "twice".to_owned(),
                order => format!("{order} times"),
            };
            let amplitude = figure(amplitude);
            follows(format!(
                "follows the angle: it repeats {times} per turn, with {amplitude} {unit}"
            ))
        }
        ErrorForm::Line { amplitude } => {
            let middle = figure(0.5 * (found.from + found.to));
            follows(format!("is a line at {middle} Hz, with {} {unit}", figure(amplitude)))
        }
        ErrorForm::ResistanceDrift { by_ohm } => follows(format!(
            "follows the time, as with a resistance that changes by {by_ohm:+.3} ohm from begin to end"
        )),
        ErrorForm::Offset { by } => follows(format!(
            "is the same everywhere: {} {unit} are missing in the model",
            figure(by)
        )),
        ErrorForm::OneWay { forward } => {
            let word = if forward { "forward" } else { "reverse" };
            let time = share(found.share_of_time);
            follows(format!("falls in {word} motion ({time} of the time in motion)"))
        }
    }
}

/// The error of an equation, and the first of the places where it fails.
pub fn balance(balance: &EquationBalance, locations: &[FailureLocation]) -> String {
    let name = balance.equation;
    let size = match balance.nres {
        Some(nres) => format!("{nres:.2} times its noise"),
        None => format!(
            "{} % of the {} (no noise is known to compare it with)",
            figure(100.0 * balance.relative),
            if name == "torque" { "driving torque" } else { "voltage" }
        ),
    };
    let moved = match (balance.refitted, balance.nres, balance.nres_refitted) {
        (true, Some(before), Some(after)) if before - after > 0.1 => {
            format!(", {after:.2} times with its values free{}", largest_change(balance))
        }
        _ => String::new(),
    };
    let first = || locations.iter().find(|own| own.equation == name).map(location);
    match balance.state {
        EquationState::Unknown => format!(
            "the {name} equation: its error is {size} and follows none of the variables examined"
        ),
        EquationState::Holds => format!("the {name} equation holds: its error is {size}{moved}"),
        EquationState::Follows => format!(
            "the {name} equation fails: its error is {size}{moved}; {}",
            first().unwrap_or_default()
        ),
        EquationState::FollowsNothing => format!(
            "the {name} equation fails: its error is {size}{moved} and follows none of the variables examined"
        ),
    }
}

fn largest_change(balance: &EquationBalance) -> String {
    let largest = balance.own_changes.iter().max_by(|a, b| a.share.abs().total_cmp(&b.share.abs()));
    largest.map_or_else(String::new, |change| {
        let name = MotorKey::from_key(change.key).map_or("a value", MotorKey::name);
        format!(" (the {name} by {:+.1} %)", 100.0 * change.share)
    })
}

pub fn undecided(found: &Undecided) -> String {
    match found {
        Undecided::Equations { equations: [worse, other] } => format!(
            "the {worse} and the {other} equation fail equally: these runs do not decide which of them is incomplete"
        ),
        Undecided::Variables { equation, variables, follows } => {
            let [first, second] = variables.map(|variable| match name_and_unit(variable).0 {
                "" => "is the same everywhere".to_owned(),
                name => format!("follows the {name}"),
            });
            let [of_first, of_second] = follows.map(|follows| 100.0 * follows);
            format!(
                "the {equation} error {first} and {second} equally ({of_first:.0} and {of_second:.0} %): these runs do not decide \
                between them"
            )
        }
    }
}

pub fn failure(comparison: &Comparison) -> String {
    let words = match comparison.where_it_fails().0 {
        Where::First => return comparison.locations.first().map_or_else(String::new, location),
        Where::Undecided(found) => return undecided(&found),
        Where::NotFitted => {
            "not known: the model follows the run no better than a trivial prediction"
        }
        Where::NoBalance => "not known: these runs do not show where it fails",
        Where::AlongNothing => {
            "an equation fails, and its error follows no speed, current, angle or time"
        }
        Where::NoNoiseFloor => {
            "not known: the errors follow none of the variables examined, and no noise is known"
        }
        Where::OverTheWholeRun => {
            "no equation fails beyond its noise in short windows, but more than noise is left over the whole run: too small or too \
            slow to be located"
        }
        Where::Nowhere => "nowhere: no equation fails beyond its noise",
    };
    words.to_owned()
}

pub fn axis_map(map: &AxisMap) -> String {
    let what = map.equation;
    let axis_text = |integrated: bool| {
        if integrated { "angle, integrated from the speed" } else { name_and_unit(map.axis).0 }
    };
    match map.finding {
        AxisFinding::NotFollowed { integrated } => {
            format!("the {what} error does not follow the {}", axis_text(integrated))
        }
        AxisFinding::Followed { integrated } => {
            let mut text = format!(
                "{} of the {what} error follows the {}",
                share(map.r2),
                axis_text(integrated)
            );
            if let Some((place, height)) = map.largest() {
                // The knots of a time count from the begin of the run already.
                let across = match map.axis {
                    "time_s" => "s of the run",
                    axis => Axis::from_key(axis).map_or("", Axis::unit),
                };
                let [from, to, height] =
                    [*place.start(), *place.end(), height].map(|v| significant(v, 3));
                let place = if from == to {
                    format!("near {from}")
                } else {
                    format!("between {from} and {to}")
                };
                let _ =
                    write!(text, "; it is largest {place} {across}: {height} {}", unit_of(what));
            }
            text
        }
        AxisFinding::NoLine => {
            format!("no single line stands out in the spectrum of the {what} error")
        }
        AxisFinding::Line => format!(
            "{} of the {what} error is a line at {} Hz with an amplitude of {} {}",
            share(map.r2),
            significant(map.knots[0], 3),
            significant(map.values[0], 3),
            unit_of(what)
        ),
    }
}

/// What the values of a curve are, with their unit.
pub fn curve_title(curve: &EffectCurve) -> String {
    format!("error of the {} equation, {}", curve.equation, curve.unit)
}

pub fn axis_name(curve: &EffectCurve) -> String {
    let periods = curve.periods_per_turn;
    if periods > 1.0 {
        return format!("angle in one of {periods} periods of a turn");
    }
    name_and_unit(curve.axis).0.to_owned()
}

pub fn axis_label(curve: &EffectCurve) -> String {
    format!("{}, {}", axis_name(curve), curve.axis_unit)
}

pub fn curve(curve: &EffectCurve) -> String {
    let unit = curve.unit;
    let rms = |value: f64| significant(value, 2);
    let noise = curve.noise.map_or_else(String::new, |noise| {
        format!("; noise alone leaves {} {unit} (root mean squares of a window)", rms(noise))
    });
    let without = rms(curve.rms_without);
    match (curve.effect, curve.rms_with) {
        (Some(effect), Some(with)) => format!(
            "the {} error is {without} {unit} without {effect} and {} {unit} with it{noise}",
            curve.equation,
            rms(with),
        ),
        _ => format!("the {} error is {without} {unit}{noise}", curve.equation),
    }
}

/// Why a curve is drawn over its axis, where the effect has none of its own.
pub fn why_axis(curve: &EffectCurve) -> Option<String> {
    let (axis, _) = name_and_unit(curve.axis);
    Some(match (curve.why_axis.as_ref()?, curve.effect) {
        (AxisReason::Map(map), _) => axis_map(map),
        (AxisReason::Share(followed), Some(effect)) => format!(
            "{effect} is no function of one variable: drawn over the {axis}, which explains {} of it",
            share(*followed)
        ),
        (AxisReason::Share(followed), None) => format!(
            "no effect is drawn: the error over the {axis}, which explains {} of it",
            share(*followed)
        ),
    })
}

/// Why nothing is concluded from a comparison.
pub fn not_fitted(comparison: &Comparison) -> Option<String> {
    comparison.not_fitted.as_ref().map(trivial)
}
