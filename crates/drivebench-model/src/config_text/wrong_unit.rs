//! Keys, units and types in the convention of other programs, and what to write instead: the nearest name alone would be
//! accepted with a number that is wrong by a factor.

/// Endings of keys in another unit: given, expected, and the conversion.
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
    ("_v_per_krpm", "_v_s_per_rad", "1 V per 1000 r/min is 0.0095493 V.s/rad"),
    ("_v_per_rpm", "_v_s_per_rad", "1 V per r/min is 9.5493 V.s/rad"),
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

/// Values of `unit` that need a scale: given, expected, factor.
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
    let is_allowed = |name: &str| allowed.clone().into_iter().any(|other| other == name);
    let converted = |(ending, expected, text): &(&str, &str, &str)| {
        let name = format!("{}{expected}", given.strip_suffix(ending)?);
        is_allowed(&name).then(|| format!("give {name}: {text}"))
    };
    if let Some(help) = ENDINGS.iter().find_map(converted) {
        return Some(help);
    }
    if let Some((_, unit, factor)) = UNITS.iter().find(|row| row.0 == given && is_allowed(row.1)) {
        return Some(format!(
            "give unit {unit:?} with scale {factor}: 1 {given} is {factor} {unit}"
        ));
    }
    let lower = given.to_ascii_lowercase();
    Some(format!("give `{}`", NAMES.iter().find(|name| name.0 == lower && is_allowed(name.1))?.1))
}

#[cfg(test)]
mod tests {
    use super::*;
    #[test]
    fn names_of_other_conventions_are_converted() {
        let keys = ["rated_current_a", "rated_speed_rad_s", "reply_ms"];
        let (units, types) = (["", "A", "V", "rpm", "N.m"], ["u16", "i16", "i32"]);
        for (given, allowed, expected) in [
            ("rated_speed_rpm", &keys[..], "give rated_speed_rad_s: 1 r/min is 0.10472 rad/s"),
            ("rated_current_ma", &keys, "give rated_current_a: 1 mA is 0.001 A"),
            ("reply_s", &keys, "give reply_ms: 1 s is 1000 ms"),
            ("rated_speed", &keys, ""),
            ("power_kw", &keys, ""),
            ("mA", &units, "give unit \"A\" with scale 0.001: 1 mA is 0.001 A"),
            ("MA", &units, ""),
            ("Nm", &units, "give `N.m`"),
            ("s32", &types, "give `i32`"),
            ("UINT16", &types, "give `u16`"),
            ("i24", &types, ""),
        ] {
            let found = help(given, &allowed.iter().copied()).unwrap_or_default();
            assert_eq!(found, expected, "{given}");
        }
    }
}
