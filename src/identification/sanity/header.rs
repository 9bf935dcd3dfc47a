//! What the header of a mapped column says about its unit.

use super::{Finding, Kind};

/// `(target, words in the header, its unit, factor to the target's unit)`.
const UNITS: &[(&str, &[&str], &str, &str)] = &[
    ("speed_rad_s", &["krpm"], "1000 r/min", "104.719755"),
    (
        "speed_rad_s",
        &[
            "rpm", "r/min", "u/min", "rev/min", "1/min", "min-1", "min^-1",
        ],
        "r/min (a factor 9.5493)",
        "0.104719755",
    ),
    (
        "speed_rad_s",
        &["deg/s", "dps", "\u{b0}/s"],
        "deg/s",
        "0.01745329252",
    ),
    (
        "speed_rad_s",
        &["rps", "rev/s", "turns/s", "hz"],
        "turns per second",
        "6.283185307",
    ),
    ("current_a", &["ma", "milliamp", "milliamps"], "mA", "0.001"),
    ("current_a", &["ka"], "kA", "1000"),
    (
        "voltage_v",
        &["mv", "millivolt", "millivolts"],
        "mV",
        "0.001",
    ),
    ("voltage_v", &["kv"], "kV", "1000"),
    ("voltage_cmd_v", &["mv"], "mV", "0.001"),
    ("voltage_cmd_v", &["kv"], "kV", "1000"),
    ("bus_v", &["mv"], "mV", "0.001"),
    (
        "time_s",
        &["ms", "msec", "millis", "milliseconds"],
        "ms",
        "0.001",
    ),
    (
        "time_s",
        &["us", "usec", "micros", "\u{b5}s", "\u{3bc}s"],
        "us",
        "0.000001",
    ),
    ("time_s", &["ns", "nanos"], "ns", "0.000000001"),
    (
        "angle_rad",
        &["deg", "degrees", "\u{b0}"],
        "degrees",
        "0.01745329252",
    ),
    (
        "angle_rad",
        &["rev", "turns", "revs"],
        "turns",
        "6.283185307",
    ),
    (
        "torque_n_m",
        &["mnm", "nmm", "mn.m", "n.mm"],
        "mN.m",
        "0.001",
    ),
    ("torque_n_m", &["ncm", "n.cm"], "N.cm", "0.01"),
];

/// The unit that a header names where it is not the target's. `scaled`: the map gives a factor, so somebody thought of it.
pub fn of_header(target: &str, header: &str, scaled: bool) -> Option<Finding> {
    if scaled {
        return None;
    }
    let header_lower = header.to_lowercase();
    let words: Vec<&str> = header_lower
        .split(|letter: char| letter.is_whitespace() || "_,;:()[]{}|\"".contains(letter))
        .collect();
    let (_, _, unit, factor) = UNITS
        .iter()
        .find(|(of, names, ..)| *of == target && names.iter().any(|name| words.contains(name)))?;
    Some(Finding::refusal(
        Kind::Unit,
        format!("--map {target}={header}: the header names {unit}, and no factor is given"),
        format!(
            "write {target}={header}*{factor}; if the column is in the unit of {target} all the same, write {target}={header}*1"
        ),
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_unit_in_the_header_is_seen_unless_a_factor_was_given() {
        for (target, header, part) in [
            ("speed_rad_s", "rpm", "9.5493"),
            ("speed_rad_s", "Motor speed [RPM]", "*0.104719755"),
            ("speed_rad_s", "n (1/min)", "r/min"),
            ("current_a", "i mA", "*0.001"),
            ("time_s", "t_ms", "*0.001"),
            ("angle_rad", "pos (deg)", "degrees"),
        ] {
            let found = of_header(target, header, false).expect(header);
            let text = format!("{} {}", found.sentence, found.help);
            assert!(text.contains(part) && found.refuses, "{text}");
            assert_eq!(of_header(target, header, true), None);
        }
        for (target, header) in [
            ("speed_rad_s", "speed_rad_s"),
            ("speed_rad_s", "omega"),
            ("current_a", "ima"),
            ("current_a", "rpm"),
            ("time_s", "time (s)"),
        ] {
            assert_eq!(of_header(target, header, false), None, "{header}");
        }
    }
}
