//! Load that follows the speed behind a first-order lag.

use super::{Card, Enters, Instant, Limit, ParameterSpec, Place, Terms};

pub(super) const EFFECT: Card = Card {
    id: "lagged_load",
    name: "load behind the speed",
    enters: Enters::Torque,
    equation: "T = k y, dy/dt = (w|w| - y)/tau: the load of a fan or pump that follows the speed late",
    causes: "air or water that must be set in motion first: a fan with a long duct, a pump with a \
        long pipe, a stirrer in a vessel. Throttle it or take it off: what changes is its load. A \
        load at once and an inertia that is in the model too large look alike at small changes of \
        speed; after a stop from full speed this load goes on for the time tau",
    looks_like: "torque error after every change of speed that dies out over the time tau, smaller \
        on the way up than on the way down",
    excite: "steps between high and low speeds both ways, held for several times the lag",
    remedy: "expected where a fan or pump moves a long column; feed forward k times the lagged w|w|",
    takes_power: true,
    // To first order in tau.
    alternatives: &["quadratic_load"],
    // Behind a lag of a few periods the load is there at once.
    limit: Some(Limit { simpler: "quadratic_load", parameter: 1, least: 0.02 }),
    parameters: &[
        ParameterSpec::coefficient("lagged_n_m_s2_per_rad2", "N.m.s2/rad2", 1.5e-6),
        ParameterSpec::shape("time_constant_s", "s", (0.01, 60.0), &[0.1, 0.3, 1.0, 3.0]),
    ],
    formula: &[
        (Place::Torque, "lagged_n_m_s2_per_rad2*x"),
        (Place::StateRate, "(w*abs(w) - x)/time_constant_s"),
    ],
    terms: |values| Box::new(Lag { lagged: values[0], time_constant_s: values[1] }),
    ..Card::PLAIN
};

/// The square of the speed behind the lag is a state of its own.
struct Lag {
    lagged: f64,
    time_constant_s: f64,
}

impl Terms for Lag {
    fn torque_n_m(&self, _at: &Instant, own: &[f64]) -> f64 {
        self.lagged * own[0]
    }

    fn states(&self) -> usize {
        1
    }

    fn derivative(&self, at: &Instant, own: &[f64], out: &mut [f64]) {
        out[0] = (at.speed_rad_s * at.speed_rad_s.abs() - own[0]) / self.time_constant_s;
    }

    fn advance(&self, at: &Instant, own: &mut [f64], interval_s: f64) {
        let settled = at.speed_rad_s * at.speed_rad_s.abs();
        own[0] = settled + (own[0] - settled) * (-interval_s / self.time_constant_s).exp();
    }
}
