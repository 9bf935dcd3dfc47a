//! Cogging: magnets against slots, as a harmonic series.

use super::{Acts, HiddenKind, Mechanism, Parameter, Wave, load, named};

/// Second harmonic as a share of the first: 1 % of the torque's power, so that one sine explains 99 % of it.
pub(super) const SECOND_HARMONIC: f64 = 0.1;

/// Torque `sin_n_m sin(N th) + cos_n_m cos(N th)`, with or without current.
pub(super) const KIND: HiddenKind = HiddenKind {
    id: "cogging",
    names: &["cogging"],
    parameters: &[
        // N, periods per turn.
        Parameter::order(&[4.0, 6.0, 8.0, 9.0, 12.0, 14.0]),
        Wave.of("sin_n_m", "N.m", 0.1, 0.07..0.15),
        Wave.of("cos_n_m", "N.m", 0.0, 0.07..0.15),
    ],
    mystery: Some(|dice| {
        let order = dice.order();
        let [sin, cos] = dice.wave(dice.torque_n_m);
        vec![order, sin, cos]
    }),
    acts: Acts::Inside(|values, _| slots(named(values), SECOND_HARMONIC)),
};

/// `A sin(x + p) + share A sin(2 (x + p))` with `x = N th`: the shape of a magnet edge that passes a slot, steeper on one
/// side. A first-order sine is what the host's catalogue has.
#[derive(Clone, Copy, Debug)]
pub(super) struct Harmonics {
    order: f64,
    amplitude: f64,
    phase_rad: f64,
    second: f64,
}

impl Harmonics {
    /// The series whose first harmonic is `sin sin(N th) + cos cos(N th)`.
    pub(super) fn new([order, sin, cos]: [f64; 3], second: f64) -> Self {
        Self { order, amplitude: sin.hypot(cos), phase_rad: cos.atan2(sin), second }
    }

    pub(super) fn at(&self, angle_rad: f64) -> f64 {
        let (sin, cos) = (self.order * angle_rad + self.phase_rad).sin_cos();
        // sin 2x = 2 sin x cos x
        self.amplitude * sin * (1.0 + 2.0 * self.second * cos)
    }
}

/// The torque of such a series, with or without current.
pub(super) fn slots(first_harmonic: [f64; 3], second: f64) -> Box<dyn Mechanism> {
    let series = Harmonics::new(first_harmonic, second);
    load(move |at| series.at(at.angle_rad))
}
