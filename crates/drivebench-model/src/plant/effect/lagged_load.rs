//! Load of a fan or pump that follows the speed behind a first-order lag.

use super::{Card, Enters, Instant, Limit, Measure, ParameterSpec, Place, Terms};

/// Time constant of the lag. One of more than a sixth of the run does not die out in it, and is as well a drift or what begins.
pub(super) const LAG: ParameterSpec = ParameterSpec {
    of: Measure::Response,
    most_of_length: 1.0 / 6.0,
    ..ParameterSpec::shape("time_constant_s", "s", (0.01, 60.0), &[0.1, 0.3, 1.0, 3.0])
};
/// Behind a shorter lag the load is there at once: a step of the speed takes as long.
pub(super) const LEAST_LAG_S: f64 = 0.02;

pub(super) const EFFECT: Card = Card {
    id: "lagged_load",
    name: "load that follows the speed late",
    enters: Enters::Torque,
    equation: "T = k y, dy/dt = (w|w| - y)/tau",
    causes: "air or water that must first be set in motion: a fan with a duct, a pump with a pipe, \
        a stirrer in a vessel. Take it off or throttle it: what changes is its load. Of a negative \
        size beside a quadratic load: an inflow that develops late, as behind a propeller, which is \
        loaded most just after it has become faster",
    looks_like: "torque error after every change of speed that dies out over the time tau",
    excite: "steps between high and low speeds both ways, held for several times the lag",
    remedy: "expected where a fan or pump moves a long column; feed forward k times w|w| behind the \
        same lag",
    // Of opposite signs they are any hysteresis.
    excludes: &["lagged_drag"],
    limit: Some(Limit { simpler: "quadratic_load", parameter: 1, least: LEAST_LAG_S }),
    parameters: &[ParameterSpec::coefficient("lagged_n_m_s2_per_rad2", "N.m.s2/rad2", 1.5e-6), LAG],
    formula: &[
        (Place::Torque, "lagged_n_m_s2_per_rad2*x"),
        (Place::StateRate, "(w*abs(w) - x)/time_constant_s"),
    ],
    terms: |values| lagged(values, |speed_rad_s| speed_rad_s * speed_rad_s.abs()),
    ..Card::PLAIN
};

/// Terms of a torque in proportion to a law of the speed behind a lag, for size and time constant.
pub(super) fn lagged(values: &[f64], law: fn(f64) -> f64) -> Box<dyn Terms> {
    Box::new(Lagged { size: values[0], time_constant_s: values[1], law })
}

/// What the torque is in proportion to is a state of its own.
struct Lagged {
    size: f64,
    time_constant_s: f64,
    law: fn(f64) -> f64,
}

impl Terms for Lagged {
    fn torque_n_m(&self, _at: &Instant, own: &[f64]) -> f64 {
        self.size * own[0]
    }

    fn states(&self) -> usize {
        1
    }

    fn derivative(&self, at: &Instant, own: &[f64], out: &mut [f64]) {
        out[0] = ((self.law)(at.speed_rad_s) - own[0]) / self.time_constant_s;
    }

    fn advance(&self, at: &Instant, own: &mut [f64], interval_s: f64) {
        let settled = (self.law)(at.speed_rad_s);
        own[0] = settled + (own[0] - settled) * (-interval_s / self.time_constant_s).exp();
    }
}
