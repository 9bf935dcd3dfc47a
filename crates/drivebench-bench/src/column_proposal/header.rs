//! A header taken apart: its unit, its words.
//!
//! ```text
//! "Motor speed [rpm]"   -> motor, speed    | r/min      in brackets
//! "Strom / mA"          -> strom           | mA         behind a stroke
//! "i_filtered_A"        -> i, filtered     | A          the last part
//! "leftVelRadPerSec"    -> left, vel       | rad/s      the last words
//! ```

use super::known::{Quantity, Unit, plain};

pub(super) struct Parts {
    /// Without capitals and accents.
    pub words: Vec<String>,
    pub unit: Option<Unit>,
}

/// Words after which a single letter numbers a thing and is no unit.
const NUMBERED: [&str; 14] = [
    "channel", "ch", "chan", "phase", "axis", "motor", "m", "encoder", "enc", "sensor", "joint",
    "group", "port", "leg",
];

impl Parts {
    pub(super) fn of(header: &str) -> Self {
        let Some((rest, inside)) = in_brackets(header) else {
            return Self::without_brackets(header);
        };
        if let Some(unit) = Unit::of(inside) {
            return Self { words: words(&rest), unit: Some(unit) };
        }
        // The brackets hold words: `Voltage (motor)`.
        let own = Self::without_brackets(&rest);
        Self { words: [own.words, words(inside)].concat(), unit: own.unit }
    }

    fn without_brackets(header: &str) -> Self {
        let path = header.starts_with('/');
        let marks = [" in ", ", ", " - ", "/"];
        let found = marks.iter().filter(|mark| !path || mark.len() > 1).find_map(|mark| {
            let (rest, unit_text) = header.split_once(mark)?;
            Some((rest, Unit::of(unit_text)?)).filter(|(rest, _)| !rest.trim().is_empty())
        });
        if let Some((rest, unit)) = found {
            return Self { words: words(rest), unit: Some(unit) };
        }
        let parts: Vec<&str> = header.split(is_separator).filter(|part| !part.is_empty()).collect();
        for count in (1..=parts.len().min(3)).rev() {
            let (before, last) = parts.split_at(parts.len() - count);
            let spelled = [last.join("/"), last.join("."), last.concat()];
            let numbers = last[0].chars().count() == 1
                && before.last().is_some_and(|part| NUMBERED.contains(&&*plain(part)));
            // A single letter alone is a symbol.
            let is_letter = before.is_empty() && header.trim().chars().count() == 1;
            if numbers || is_letter {
                continue;
            }
            if let Some(unit) = spelled.iter().find_map(|text| Unit::of(text)) {
                let rest = if before.is_empty() { &parts[..] } else { before };
                let words = rest.iter().flat_map(|part| words(part)).collect();
                return Self { words, unit: Some(unit) };
            }
        }
        let all = words(header);
        for count in (1..=all.len().min(3)).rev() {
            let (before, last) = all.split_at(all.len() - count);
            let spelled = last.join(" ").replace(" per ", "/").replace(' ', "");
            let is_unit = spelled.len() > 2 && !before.is_empty();
            if let Some(unit) = Unit::of(&spelled).filter(|_| is_unit) {
                return Self { words: before.to_vec(), unit: Some(unit) };
            }
        }
        // `rpm_left`: the name of the quantity is a unit.
        let is_name = |unit: &Unit| {
            matches!(unit.quantity, Quantity::Speed | Quantity::Voltage | Quantity::Current)
        };
        let mut named = all.iter().filter(|word| word.len() > 2).filter_map(|word| Unit::of(word));
        let unit = named.find(is_name);
        Self { words: all, unit }
    }
}

/// The text without its last brackets, and what stands in them.
fn in_brackets(header: &str) -> Option<(String, &str)> {
    let close = header.rfind([')', ']', '}'])?;
    let open = header[..close].rfind(['(', '[', '{'])?;
    let rest = format!("{} {}", &header[..open], &header[close + 1..]);
    Some((rest, &header[open + 1..close]))
}

fn is_separator(letter: char) -> bool {
    letter.is_whitespace() || "_-./:,;|\"'#()[]{}".contains(letter)
}

/// The words of a text, split at separators, between digits and letters, and at capitals inside: `leftSpeed2`.
fn words(text: &str) -> Vec<String> {
    let letters: Vec<char> = text.chars().collect();
    let mut parted = String::new();
    for (at, letter) in letters.iter().copied().enumerate() {
        let before = at.checked_sub(1).map(|at| letters[at]);
        let after = letters.get(at + 1);
        let is_break = before.is_some_and(|before| {
            before.is_ascii_digit() != letter.is_ascii_digit()
                || before.is_lowercase() && letter.is_uppercase()
                || before.is_uppercase()
                    && letter.is_uppercase()
                    && after.is_some_and(|after| after.is_lowercase())
        });
        parted.extend(is_break.then_some(' '));
        parted.push(letter);
    }
    parted.split(is_separator).filter(|word| !word.is_empty()).map(plain).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_are_found_where_people_write_them() {
        for (header, expected, name) in [
            ("Motor speed [rpm]", "motor speed", "r/min"),
            ("Torque (N\u{b7}m)", "torque", "N.m"),
            ("Strom / mA", "strom", "mA"),
            ("n in 1/min", "n", "r/min"),
            ("Speed, rpm", "speed", "r/min"),
            ("Cur - A", "cur", "A"),
            ("U/V", "u", "V"),
            ("i_filtered_A", "i filtered", "A"),
            ("y_rad_s", "y", "rad/s"),
            ("i mA", "i", "mA"),
            ("rpm", "rpm", "r/min"),
            ("rpm_left", "rpm left", "r/min"),
            ("t_ms", "t", "ms"),
            ("load_torque_n_m", "load torque", "N.m"),
            ("leftVelRadPerSec", "left vel", "rad/s"),
            ("velRadiansPerSecond", "vel", "rad/s"),
            ("DriveAppliedVolts", "drive applied", "V"),
            ("Speed (steps/s)", "speed", "counts/s"),
            ("ESC signal (\u{b5}s)", "esc signal", "us"),
            ("Thrust (N)", "thrust", "N"),
            ("Winkel [\u{b0}]", "winkel", "degrees"),
            ("Channel A", "channel a", ""),
            ("phase_a", "phase a", ""),
            ("i", "i", ""),
            ("v", "v", ""),
            ("Voltage (motor)", "voltage motor", ""),
            ("/joint_states/velocity", "joint states velocity", ""),
            ("axis0.encoder.vel_estimate", "axis 0 encoder vel estimate", ""),
            ("m1setvel", "m 1 setvel", ""),
            ("ERPM", "erpm", ""),
            ("", "", ""),
        ] {
            let parts = Parts::of(header);
            assert_eq!(parts.words.join(" "), expected, "{header}");
            assert_eq!(parts.unit.map_or("", |unit| unit.name), name, "{header}");
        }
    }
}
