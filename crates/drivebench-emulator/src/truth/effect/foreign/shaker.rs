//! A torque that swings in time, whatever the machine does: a neighbour's machine on the same frame.

use super::{Acts, HiddenKind, NotNegative, Positive, load, named};

pub(in super::super) const KIND: HiddenKind = HiddenKind {
    id: "shaker",
    names: &[],
    parameters: &[
        NotNegative.of("amplitude_n_m", "N.m", 0.1, 0.1..0.2),
        Positive.of("frequency_hz", "Hz", 4.6, 4.4..5.6),
    ],
    mystery: Some(|dice| vec![dice.torque_n_m, dice.between(2.0, 8.0)]),
    acts: Acts::Inside(|values, _| {
        let [amplitude_n_m, frequency_hz] = named(values);
        let frequency_rad_s = std::f64::consts::TAU * frequency_hz;
        load(move |at| amplitude_n_m * (frequency_rad_s * at.time_s).sin())
    }),
};
