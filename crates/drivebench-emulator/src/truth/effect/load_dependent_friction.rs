//! Gear loss: friction that grows with the torque that goes through the teeth.

use super::{Acts, HiddenKind, Loss, friction};

/// Friction of `ratio` times the motor's torque.
pub(super) const KIND: HiddenKind = HiddenKind {
    id: "load_dependent_friction",
    names: &["load_dependent_friction"],
    parameters: &[Loss.of("ratio", "-", 0.08, 0.05..0.12)],
    mystery: Some(|dice| vec![dice.size(0.04, 0.15)]),
    acts: Acts::Inside(|values, _| {
        // Efficiency law of a gear: what arrives is (1 - ratio) T while the motor drives, and the motor gets (1 - ratio)
        // of what comes from the load while it is driven, which is a friction of ratio/(1 - ratio) T: 5.3 % instead of
        // 5 %. The host's catalogue has the same ratio both ways.
        let driving = values[0];
        let driven = driving / (1.0 - driving);
        friction(move |at| {
            let is_driven = at.torque_n_m * at.speed_rad_s < 0.0;
            let ratio = if is_driven { driven } else { driving };
            ratio * at.torque_n_m.abs()
        })
    }),
};
