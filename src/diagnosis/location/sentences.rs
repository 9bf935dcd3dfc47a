//! Sentences: each location and each balance in words for a person.

use super::axis::{Axis, Shape};
use super::{EquationBalance, name, unit};
use crate::plant::{Balance, MotorKey};
use crate::text::number::{share, shortest};

/// Share of the time above which a region is the whole range.
const NEARLY_ALL_SHARE: f64 = 0.75;
/// Fall of the error, in multiples of the noise, from which on it is worth a word that the motor's values may move.
const WORTH_SAYING_NRES: f64 = 0.1;

/// Three digits are what such a place or size carries.
fn figure(value: f64) -> String {
    shortest(value, 3)
}

fn name_and_unit(variable: &str) -> (&'static str, &'static str) {
    match variable {
        "speed_rad_s" => ("speed", "rad/s"),
        "current_a" => ("current", "A"),
        "time_s" => ("time", "s"),
        "acceleration_rad_s2" => ("acceleration", "rad/s2"),
        "current_rate_a_s" => ("rate of the current", "A/s"),
        "direction" => ("direction of motion", ""),
        "angle_rad" => ("angle", "rad"),
        "voltage_edge_s" => ("timing of the voltage", "s"),
        "frequency_hz" => ("phase of a line in frequency", ""),
        _ => ("variable", ""),
    }
}

pub(super) fn name_of_variable(variable: &str) -> &'static str {
    name_and_unit(variable).0
}

/// The sentence of one variable.
pub(super) fn sentence(axis: &Axis) -> String {
    let (equation, unit) = (name(axis.equation), unit(axis.equation));
    let follows = share(axis.follows);
    let variable = name_of_variable(axis.variable);
    match &axis.shape {
        Shape::Curve => range(axis).unwrap_or_else(|| {
            format!(
                "{follows} of the {equation} error follows the {variable}, over its whole range"
            )
        }),
        Shape::Own {
            key,
            by,
            share: part,
        } => format!(
            "{follows} of the {equation} error follows the {variable}, as {} {} too {} in the model would make it ({} {})",
            name_of(*key),
            share(part.abs()),
            if *by > 0.0 { "low" } else { "high" },
            figure(by.abs()),
            key.unit()
        ),
        Shape::Turns { order, amplitude } => format!(
            "{follows} of the {equation} error follows the angle: it repeats {}, with {} {unit}",
            match order {
                1 => "once per turn".to_owned(),
                2 => "twice per turn".to_owned(),
                order => format!("{order} times per turn"),
            },
            figure(*amplitude)
        ),
        Shape::Drift {
            resistance: Some([from, to]),
        } => format!(
            "{follows} of the {equation} error follows the time, as a resistance that moves by {:+.3} ohm from begin to \
             end would",
            to - from
        ),
        Shape::Drift { resistance: None } => range(axis).unwrap_or_else(|| {
            format!("{follows} of the {equation} error follows the time, over the whole run")
        }),
        Shape::Line { amplitude } => format!(
            "{follows} of the {equation} error is a line at {} Hz, with {} {unit}",
            figure(0.5 * (axis.region.from + axis.region.to)),
            figure(*amplitude)
        ),
        Shape::Late { delay_s, resolved } => format!(
            "{follows} of the {equation} error follows the steps of the voltage, as if it came{} {} (timing)",
            if *resolved {
                format!(" {} ms", figure(1e3 * delay_s.abs()))
            } else {
                String::new()
            },
            if *delay_s > 0.0 { "late" } else { "early" }
        ),
        Shape::Offset { by } => format!(
            "{follows} of the {equation} error is the same everywhere: {} {unit} are missing in the model",
            figure(*by)
        ),
        Shape::OneWay { forward } => format!(
            "{} of the {equation} error falls in {} motion ({} of the time in motion)",
            share(axis.region.share_of_error),
            if *forward { "forward" } else { "reverse" },
            share(axis.region.share_of_time)
        ),
    }
}

/// "85 % of the torque error lies below 12 rad/s (11 % of the time)"; `None` where the range is nearly everything.
fn range(axis: &Axis) -> Option<String> {
    let region = &axis.region;
    if region.share_of_time > NEARLY_ALL_SHARE {
        return None;
    }
    let (_, unit) = name_and_unit(axis.variable);
    let (from, to) = (figure(region.from), figure(region.to));
    let place = match (region.from_lowest, region.to_highest, region.of_size) {
        (true, _, true) => format!("below {to} {unit} in either direction"),
        (_, true, true) => format!("above {from} {unit} in either direction"),
        (_, _, true) => format!("between {from} and {to} {unit} in either direction"),
        (true, _, false) => format!("below {to} {unit}"),
        (_, true, false) => format!("above {from} {unit}"),
        _ => format!("between {from} and {to} {unit}"),
    };
    Some(format!(
        "{} of the {} error lies {place} ({} of the time)",
        share(region.share_of_error),
        name(axis.equation),
        share(region.share_of_time)
    ))
}

/// Writes the sentence of a whole balance.
pub(super) fn describe(balance: &mut EquationBalance, first: Option<&Axis>) {
    let name = balance.equation;
    let size = match balance.nres {
        Some(nres) => format!("{nres:.2} times its noise"),
        None => format!(
            "{} % of the {} (no noise is known to compare it with)",
            figure(100.0 * balance.relative),
            if name == super::name(Balance::Torque) {
                "driving torque"
            } else {
                "voltage"
            }
        ),
    };
    let moved = match (balance.refitted, balance.nres, balance.nres_refitted) {
        (true, Some(before), Some(after)) if before - after > WORTH_SAYING_NRES => format!(
            ", {after:.2} times where {} may move",
            largest_change(balance)
        ),
        _ => String::new(),
    };
    balance.sentence = if !balance.fails && balance.nres.is_none() {
        format!("the {name} equation: its error is {size} and follows nothing, as noise does")
    } else if !balance.fails {
        format!("the {name} equation holds: its error is {size}{moved}")
    } else if let Some(axis) = first {
        format!(
            "the {name} equation fails: its error is {size}{moved}; {}",
            sentence(axis)
        )
    } else {
        format!(
            "the {name} equation fails: its error is {size}{moved} and follows no variable that was asked"
        )
    };
}

/// The parameter that is farthest off, with its move.
fn largest_change(balance: &EquationBalance) -> String {
    let largest = balance
        .own_changes
        .iter()
        .max_by(|a, b| a.share.abs().total_cmp(&b.share.abs()));
    largest.map_or_else(String::new, |change| {
        let name = MotorKey::from_key(change.key).map_or("a value", name_of);
        format!("its values (the {name} by {:+.1} %)", 100.0 * change.share)
    })
}

const fn name_of(key: MotorKey) -> &'static str {
    match key {
        MotorKey::Resistance => "resistance",
        MotorKey::Inductance => "inductance",
        MotorKey::BackEmf => "back-EMF constant",
        MotorKey::Inertia => "inertia",
        MotorKey::LoadTorque => "load torque",
        MotorKey::TorqueConstant => "torque constant",
    }
}
