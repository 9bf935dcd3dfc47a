//! What no run tells apart, because it is one equation (DISCOVERY.md 2.10). Stated, never computed.

/// What cannot be known of an effect of this id from voltage, current, speed and angle.
pub fn equivalences(effect: &str) -> &'static [&'static str] {
    match effect {
        "viscous_friction" => &[
            "viscous friction and the drag of eddy currents are one equation: no run tells them apart; drive the machine \
             with the rotor's magnets out (or the field off), or run it cold and warm",
        ],
        "constant_load" => &[
            "a constant load torque and Coulomb friction that depends on the direction are one equation while the load \
             is below the friction: no run tells them apart; turn the machine round on its bench, or take the load off",
        ],
        "field_change" => &[
            "a change of flux and a gain error of the speed sensor are one equation: no run tells them apart; check the \
             sensor against a counter",
        ],
        _ => &[],
    }
}
