//! Current of the winding over one sampling interval, exactly.
//!
//! `L di/dt = u - R i - Ke w`, `dw/dt = (Kt/J) i + c`: the voltage is held piece by piece, and the constant `c` (friction
//! and load) is the one that brings the speed from its measured begin to its measured end. Where the shaft is held, or
//! Kt/J is not known, Kt/J = 0 makes the speed a straight line. No assumption on T against L/R or on the speed's shape.

use drivebench_model::numerics::propagator::LinearPart;
use drivebench_model::signal::{Point, integral, pieces};

/// R, L, Ke.
pub(super) type Winding = [f64; 3];

#[derive(Clone, Copy, Debug)]
pub(super) struct Interval<'a> {
    pub(super) begin_s: f64,
    pub(super) length_s: f64,
    /// Measured speed at the begin and at the end, rad/s.
    pub(super) speed: [f64; 2],
    /// Kt/J, rad/(A.s^2); 0: the speed is a straight line.
    pub(super) acceleration_per_ampere: f64,
    /// `(absolute time, volts)`, in order, holding until the next; the first at or before `begin_s`.
    pub(super) voltage: &'a [Point],
}

/// Current at the end and its integral over the interval.
pub(super) fn propagate(
    [r, l, ke]: &Winding,
    current_a: f64,
    interval: &Interval<'_>,
) -> (f64, f64) {
    let per_ampere = interval.acceleration_per_ampere;
    // States i and w.
    let linear = LinearPart::new(&[[-r / l, -ke / l], [per_ampere, 0.0]]);
    let [w_begin, w_end] = interval.speed;
    let h = interval.length_s;
    let whole = linear.over(h);
    let mut x = [current_a, w_begin];
    for (length_s, volts) in pieces(interval.voltage, interval.begin_s, interval.begin_s + h) {
        let forcing = [volts / l, 0.0];
        x = if length_s < h {
            linear.over(length_s).apply(x, forcing)
        } else {
            whole.apply(x, forcing)
        };
    }
    // What one unit of the constant acceleration adds.
    let unit = whole.apply([0.0; 2], [0.0, 1.0]);
    let c = (w_end - x[1]) / unit[1];
    let end = x[0] + c * unit[0];
    let charge = if per_ampere > 0.0 {
        (w_end - w_begin - c * h) / per_ampere
    } else {
        (voltage_integral(interval) - l * (end - current_a) - ke * 0.5 * (w_begin + w_end) * h) / r
    };
    (end, charge)
}

pub(super) fn voltage_integral(interval: &Interval<'_>) -> f64 {
    let end_s = interval.begin_s + interval.length_s;
    integral(interval.voltage, interval.begin_s, end_s)
}
