//! Friction that is higher about one speed, in either direction: a resonance that takes up power there.

use super::{Acts, HiddenKind, NotNegative, Positive, friction, named};

pub(in super::super) const KIND: HiddenKind = HiddenKind {
    id: "torque_bump",
    names: &[],
    parameters: &[
        NotNegative.of("bump_n_m", "N.m", 0.12, 0.12..0.2),
        Positive.of("speed_rad_s", "rad/s", 95.0, 70.0..130.0),
        Positive.of("width_rad_s", "rad/s", 20.0, 12.0..22.0),
    ],
    mystery: Some(|dice| {
        vec![
            dice.size(0.08, 0.2) * dice.rated_torque_n_m,
            dice.between(60.0, 180.0),
            dice.between(10.0, 30.0),
        ]
    }),
    acts: Acts::Inside(|values, _| {
        let [bump_n_m, speed_rad_s, width_rad_s] = named(values);
        // T exp(-((|w| - w0)/width)^2) against the motion.
        friction(move |at| {
            let off = (at.speed_rad_s.abs() - speed_rad_s) / width_rad_s;
            bump_n_m * (-off * off).exp()
        })
    }),
};
