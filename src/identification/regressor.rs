//! Effects as terms of a balance that is linear in their coefficients.

use crate::plant::effect::Sums;
use crate::plant::{ActiveEffect, Balance, Instant, Motor, Path};

/// Size, in units of the typical one, at which every effect is proportional to its coefficient.
pub(super) const PROPORTIONAL: f64 = 1e-4;

/// Why an effect is no such term, or `None` where it is one. `electrical`: there is a voltage balance.
pub(super) fn why_no_regressor(
    active: &ActiveEffect,
    motor: &Motor,
    electrical: bool,
) -> Option<&'static str> {
    let of_size = |size: f64| {
        let mut values = active.values_or_guess();
        for (value, spec) in values.iter_mut().zip(active.effect.parameters()) {
            if spec.is_coefficient() {
                *value = size;
            }
        }
        active.effect.terms(&values)
    };
    let terms = of_size(1.0);
    if terms.path() != Path::default() {
        return Some("it lies on the way of command or measurement, not in a balance");
    }
    if terms.coupling().is_some() {
        return Some("it is a second inertia with a motion of its own");
    }
    if terms.states() > 0 {
        return Some("it has a state of its own, which no balance shows");
    }
    if !electrical && !active.effect.card().enters.includes(Balance::Torque) {
        return Some("it enters the voltage balance, and there is no voltage");
    }
    let somewhere = Instant {
        voltage_v: 1.0,
        supply_v: 1.0,
        current_a: 1.0,
        speed_rad_s: 1.0,
        ..Instant::of(motor)
    };
    let later = Instant {
        time_s: f64::MAX,
        ..somewhere
    };
    if terms.inertia_gain(&later) != 0.0 {
        return Some("it changes the inertia, which the balance takes as constant");
    }
    let sums = terms.sums(&somewhere, &[]);
    if sums.current_rate_gain != 0.0 {
        return Some("it changes the inductance, which the balance takes as constant");
    }
    let parts = |sums: &Sums| {
        let voltage_v = if electrical { sums.voltage_v } else { 0.0 };
        [voltage_v, sums.torque_n_m, sums.friction_n_m]
    };
    let (once, twice) = (parts(&sums), parts(&of_size(2.0).sums(&somewhere, &[])));
    if once.iter().any(|term| !term.is_finite()) {
        return Some("its terms need motor constants that the model does not give");
    }
    let proportional = |(one, two): (&f64, &f64)| (two - 2.0 * one).abs() <= 1e-9 * one.abs();
    (!once.iter().zip(&twice).all(proportional))
        .then_some("it is not proportional to its coefficient")
}
