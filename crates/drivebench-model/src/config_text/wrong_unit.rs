//! Keys, units and types that somebody gives as other programs call them: what to write instead, with the conversion.
//!
//! The nearest name alone would be accepted with a number that is wrong by a factor.

/// Endings of keys in another unit: given, ours, and what one of it is in ours.
const ENDINGS: [(&str, &str, &str); 31] = [
    ("_rpm", "_rad_s", "1 r/min is 0.10472 rad/s"),
    ("_r_min", "_rad_s", "1 r/min is 0.10472 rad/s"),
    ("_rps", "_rad_s", "1 r/s is 6.28319 rad/s"),
    ("_hz", "_rad_s", "1 r/s is 6.28319 rad/s"),
    ("_deg", "_rad", "1 degree is 0.0174533 rad"),
    ("_ma", "_a", "1 mA is 0.001 A"),
    ("_ka", "_a", "1 kA is 1000 A"),
    ("_mv", "_v", "1 mV is 0.001 V"),
    ("_kv", "_v", "1 kV is 1000 V"),
    ("_kw", "_w", "1 kW is 1000 W"),
    ("_mohm", "_ohm", "1 mohm is 0.001 ohm"),
    ("_kohm", "_ohm", "1 kohm is 1000 ohm"),
    ("_mh", "_h", "1 mH is 0.001 H"),
    ("_uh", "_h", "1 uH is 0.000001 H"),
    (
        "_v_per_krpm",
        "_v_s_per_rad",
        "1 V per 1000 r/min is 0.0095493 V.s/rad",
    ),
    (
        "_v_per_rpm",
        "_v_s_per_rad",
        "1 V per r/min is 9.5493 V.s/rad",
    ),
    ("_kg_cm2", "_kg_m2", "1 kg.cm2 is 0.0001 kg.m2"),
    ("_g_cm2", "_kg_m2", "1 g.cm2 is 0.0000001 kg.m2"),
    ("_kgcm2", "_kg_m2", "1 kg.cm2 is 0.0001 kg.m2"),
    ("_gcm2", "_kg_m2", "1 g.cm2 is 0.0000001 kg.m2"),
    ("_mnm", "_n_m", "1 mN.m is 0.001 N.m"),
    ("_ncm", "_n_m", "1 N.cm is 0.01 N.m"),
    ("_nm", "_n_m", "the unit is the same"),
    ("_khz", "_hz", "1 kHz is 1000 Hz"),
    ("_ms", "_s", "1 ms is 0.001 s"),
    ("_us", "_s", "1 us is 0.000001 s"),
    ("_us", "_ms", "1 us is 0.001 ms"),
    ("_s", "_ms", "1 s is 1000 ms"),
    ("_ms", "_us", "1 ms is 1000 us"),
    ("_v_per_ms", "_v_per_s", "1 V/ms is 1000 V/s"),
    ("_kbaud", "baud", "1 kbaud is 1000 bit/s"),
];

/// Values of `unit` that a scale has to go with: given, ours, factor.
const UNITS: [(&str, &str, &str); 7] = [
    ("mA", "A", "0.001"),
    ("kA", "A", "1000"),
    ("mV", "V", "0.001"),
    ("kV", "V", "1000"),
    ("W", "kW", "0.001"),
    ("mNm", "N.m", "0.001"),
    ("kHz", "Hz", "1000"),
];

/// Other names of the same type or unit.
const NAMES: [(&str, &str); 20] = [
    ("s16", "i16"),
    ("int16", "i16"),
    ("sint16", "i16"),
    ("s32", "i32"),
    ("int32", "i32"),
    ("sint32", "i32"),
    ("dint", "i32"),
    ("uint16", "u16"),
    ("word", "u16"),
    ("uint32", "u32"),
    ("dword", "u32"),
    ("float", "f32"),
    ("float32", "f32"),
    ("real", "f32"),
    ("r/min", "rpm"),
    ("1/min", "rpm"),
    ("nm", "N.m"),
    ("degc", "C"),
    ("volt", "V"),
    ("ampere", "A"),
];

/// What to write for a name in another unit, or of another convention; `None`: it is neither.
pub(super) fn help<'a>(
    given: &str,
    allowed: &(impl IntoIterator<Item = &'a str> + Clone),
) -> Option<String> {
    let known = |name: &str| allowed.clone().into_iter().any(|other| other == name);
    for (other, ours, text) in ENDINGS {
        let Some(stem) = given.strip_suffix(other) else {
            continue;
        };
        let name = format!("{stem}{ours}");
        if known(&name) {
            return Some(format!("give {name}: {text}"));
        }
    }
    let unit = UNITS
        .iter()
        .find(|(other, ours, _)| *other == given && known(ours));
    if let Some((other, ours, factor)) = unit {
        return Some(format!(
            "give unit {ours:?} with scale {factor}: 1 {other} is {factor} {ours}"
        ));
    }
    let plain = given.to_ascii_lowercase();
    let name = NAMES
        .iter()
        .find(|(other, ours)| *other == plain && known(ours));
    name.map(|(_, ours)| format!("give `{ours}`"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn another_unit_is_converted_and_not_only_renamed() {
        let keys = [
            "rated_current_a",
            "rated_speed_rad_s",
            "inductance_h",
            "reply_ms",
        ];
        let speed = "give rated_speed_rad_s: 1 r/min is 0.10472 rad/s";
        for (given, said) in [
            ("rated_speed_rpm", speed),
            ("rated_current_ma", "give rated_current_a: 1 mA is 0.001 A"),
            ("inductance_mh", "give inductance_h: 1 mH is 0.001 H"),
            ("reply_s", "give reply_ms: 1 s is 1000 ms"),
        ] {
            assert_eq!(help(given, &keys).as_deref(), Some(said));
        }
        assert_eq!(help("rated_speed", &keys), None);
        assert_eq!(help("power_kw", &keys), None);
    }

    #[test]
    fn units_with_a_prefix_and_types_of_other_manuals() {
        let units = ["", "A", "V", "rpm"];
        let said = "give unit \"A\" with scale 0.001: 1 mA is 0.001 A";
        assert_eq!(help("mA", &units).as_deref(), Some(said));
        assert_eq!(help("MA", &units), None);
        let types = ["u16", "i16", "u32", "i32", "f32"];
        assert_eq!(help("s32", &types).as_deref(), Some("give `i32`"));
        assert_eq!(help("UINT16", &types).as_deref(), Some("give `u16`"));
        assert_eq!(help("i24", &types), None);
        assert_eq!(help("Nm", &["N.m"]).as_deref(), Some("give `N.m`"));
    }
}
