//! What an effect contributes to the torque balance at each sample.

use crate::identification::torque_rows::TorqueRows;
use crate::plant::{Effect, Instant, ParameterRole};

/// Samples at which the direction of a term's power is looked at.
const LOOKS: usize = 500;

/// Torque of the effect with these parameter values at every sample, N.m.
pub(super) fn torque(effect: &dyn Effect, values: &[f64], at: &[Instant]) -> Vec<f64> {
    let terms = effect.terms(values);
    let own = vec![0.0; terms.states()];
    at.iter()
        .map(|at| terms.torque_n_m(at, &own) + at.speed_rad_s.signum() * terms.friction_n_m(at))
        .collect()
}

/// Column of one coefficient, per unit, evaluated at the size `probe` because some effects are only nearly proportional.
pub(super) fn column(
    effect: &dyn Effect,
    values: &[f64],
    coefficient: usize,
    probe: f64,
    rows: &TorqueRows,
) -> Vec<f64> {
    let mut column = rows.column(&torque(
        effect,
        &alone(effect, values, coefficient, probe),
        &rows.at,
    ));
    for cell in &mut column {
        *cell /= probe;
    }
    column
}

/// The values with one coefficient at `size` and every other coefficient at zero.
pub(super) fn alone(
    effect: &dyn Effect,
    values: &[f64],
    coefficient: usize,
    size: f64,
) -> Vec<f64> {
    let specs = effect.parameters();
    let of =
        |(index, value): (usize, &f64)| match (specs[index].is_coefficient(), index == coefficient)
        {
            (true, true) => size,
            (true, false) => 0.0,
            (false, _) => *value,
        };
    values.iter().enumerate().map(of).collect()
}

/// Whether a term that takes power wherever the shaft moves: physics allows it no negative coefficient.
pub(super) fn only_takes_power(
    effect: &dyn Effect,
    values: &[f64],
    coefficient: usize,
    at: &[Instant],
) -> bool {
    let specs = effect.parameters();
    if specs
        .iter()
        .any(|spec| spec.role == ParameterRole::EventTime)
    {
        return false;
    }
    let unit = alone(effect, values, coefficient, specs[coefficient].scale.abs());
    let some: Vec<Instant> = at
        .iter()
        .step_by(at.len().div_ceil(LOOKS).max(1))
        .copied()
        .collect();
    let torque = torque(effect, &unit, &some);
    let mut moves = false;
    for (torque, at) in torque.iter().zip(&some) {
        let power = torque * at.speed_rad_s;
        if power < 0.0 {
            return false;
        }
        moves |= power > 0.0;
    }
    moves
}

/// Shares of the rows' span as times since the run's first command.
pub(super) fn event_times(shares: &[f64], rows: &TorqueRows) -> Vec<f64> {
    let (Some(first), Some(last)) = (rows.time_s.first(), rows.time_s.last()) else {
        return Vec::new();
    };
    shares
        .iter()
        .map(|share| first - rows.begin_s + share * (last - first))
        .collect()
}
