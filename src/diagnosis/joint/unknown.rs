//! Curves of torque and voltage that no effect of the catalogue gives: what is left goes there by what it follows.

use nalgebra::DVector;

use super::acting::constants;
use super::columns::{Around, Form, NO_PARAMETER, Part, Source};
use super::tangent::{Axis, Tangent, Wave};
use crate::plant::Input;

/// Log of the odds of an unknown curve beforehand.
const LOG_ODDS_UNKNOWN: f64 = -4.605_170_185_988_091;

/// Torque as a function of the speed that friction, drag and load of the catalogue are no part of, each of this size: what
/// a run that a torque drives is made of is theirs first.
fn beyond_the_catalogue(most: f64, size: f64) -> Vec<Tangent> {
    const KNOTS: usize = 13;
    let at = |knot: usize| 2.0 * knot as f64 / (KNOTS - 1) as f64 - 1.0;
    let shapes: [fn(f64) -> f64; 5] = [
        |_| 1.0,
        |x| x,
        f64::abs,
        |x| x * x.abs(),
        |x| {
            if x == 0.0 { 0.0 } else { x.signum() }
        },
    ];
    let mut basis: Vec<DVector<f64>> = Vec::new();
    let hats =
        (0..KNOTS).map(|knot| DVector::from_fn(KNOTS, |k, _| f64::from(u8::from(k == knot))));
    let shapes = shapes.map(|shape| DVector::from_fn(KNOTS, |k, _| shape(at(k))));
    for vector in shapes.into_iter().chain(hats) {
        let mut left = vector.clone();
        for known in &basis {
            left -= known * known.dot(&left);
        }
        if basis.len() < KNOTS && left.norm() > 0.1 * vector.norm() {
            basis.push(left.normalize());
        }
    }
    let beyond = basis.into_iter().skip(5);
    beyond
        .map(|curve| Tangent::Curve {
            most,
            values: (curve * size).iter().copied().collect(),
        })
        .collect()
}

/// Torque and voltage as functions that no effect of the catalogue gives.
pub(super) fn unknown_curves(runs: &[Around<'_>]) -> Vec<Part> {
    let run = &runs[0];
    let by_voltage = run.scenario.input == Input::Voltage;
    let most = |k: usize| {
        run.followed
            .after
            .iter()
            .fold(0.0_f64, |most, state| most.max(state[k].abs()))
    };
    let (current, speed) = (most(0), most(1));
    let share = if by_voltage { 0.06 } else { 0.03 };
    let torque = share * constants(&run.model, run.scenario).torque_n_m_per_a * current;
    let volts = 0.06
        * run
            .scenario
            .events
            .iter()
            .fold(0.0_f64, |most, event| most.max(event.1.abs()));
    let part = |id: &'static str, curves: Vec<Tangent>| {
        let mut part = Part::named(id, None, LOG_ODDS_UNKNOWN);
        let mut form = Form::new(vec![], 0.0);
        for curve in curves {
            form.column(Source::Tangent(curve), NO_PARAMETER, 1.0, 0.0);
        }
        form.variant.parameters.clear();
        part.push(form);
        part
    };
    let hats = |axis: Axis, count: i32, most: f64, size: f64| -> Vec<Tangent> {
        let width = 2.0 * most / f64::from(count - 1);
        (0..count)
            .map(|k| Tangent::Hat {
                axis,
                centre: width * f64::from(k) - most,
                width,
                size,
            })
            .collect()
    };
    let wave = |order: i32, sine: bool| {
        Tangent::Wave(Wave {
            order: f64::from(order),
            sine,
            size: torque,
            of_current: false,
        })
    };
    let over_speed = if by_voltage {
        hats(Axis::Speed, 11, speed, torque)
    } else {
        beyond_the_catalogue(speed, torque)
    };
    let mut parts = vec![
        part("torque over speed", over_speed),
        part(
            "torque over angle",
            (1..=6)
                .flat_map(|order| [true, false].map(|sine| wave(order, sine)))
                .collect(),
        ),
    ];
    if by_voltage {
        let volts = hats(Axis::Current, 7, current, volts);
        parts.push(part("voltage over current", volts));
    }
    parts
}
