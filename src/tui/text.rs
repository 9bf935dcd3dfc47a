//! Numbers and names as text.

/// A value with as many digits as its standard deviation allows: two digits of the deviation.
pub(super) fn with_std(value: f64, std: Option<f64>) -> String {
    let Some(std) = std.filter(|std| std.is_finite() && *std > 0.0) else {
        return number(value);
    };
    if !value.is_finite() {
        return number(value);
    }
    let (largest, smallest) = (value.abs().max(std), std);
    let exponent = smallest.log10().floor();
    if largest >= 1e6 || exponent < -6.0 {
        // One power of ten for both, so that they can be compared at a glance.
        let power = largest.log10().floor();
        let scale = 10_f64.powf(power);
        let decimals = (power - exponent + 1.0).clamp(1.0, 6.0) as usize;
        return format!(
            "({:.decimals$} ± {:.decimals$})e{power:.0}",
            value / scale,
            std / scale
        );
    }
    let decimals = (1.0 - exponent).clamp(0.0, 7.0) as usize;
    format!("{value:.decimals$} ± {std:.decimals$}")
}

/// Four significant digits; `-` for a value that is missing.
pub(super) fn number(value: f64) -> String {
    if !value.is_finite() {
        return "-".to_owned();
    }
    let size = value.abs();
    if size < f64::MIN_POSITIVE {
        return "0".to_owned();
    }
    if !(1e-3..1e6).contains(&size) {
        return format!("{value:.2e}");
    }
    let decimals = (3.0 - size.log10().floor()).clamp(0.0, 6.0) as usize;
    format!("{value:.decimals$}")
}

/// A round number of an axis, without trailing zeros.
pub(super) fn tick(value: f64) -> String {
    let size = value.abs();
    if size < 1e-12 {
        return "0".to_owned();
    }
    if !(1e-3..1e5).contains(&size) {
        return format!("{value:.0e}");
    }
    let decimals = (2.0 - size.log10().floor()).clamp(0.0, 4.0) as usize;
    let text = format!("{value:.decimals$}");
    if text.contains('.') {
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    } else {
        text
    }
}

/// Seconds as milliseconds.
pub(super) fn milliseconds(seconds: f64) -> String {
    format!("{} ms", tick(seconds * 1e3))
}

/// A relative deviation as a percentage.
pub(super) fn percent(share: f64) -> String {
    let percent = share * 100.0;
    if percent >= 1000.0 {
        ">999 %".to_owned()
    } else if percent >= 10.0 {
        format!("{percent:.0} %")
    } else if percent >= 0.1 {
        format!("{percent:.1} %")
    } else {
        "<0.1 %".to_owned()
    }
}

/// Symbol and name of a parameter by its key; an effect's parameter goes by its own key without the unit.
pub(super) fn parameter(key: &str) -> (String, String) {
    let known = match key {
        "resistance_ohm" => ("R", "resistance"),
        "inductance_h" => ("L", "inductance"),
        "back_emf_v_s_per_rad" => ("Ke", "back-EMF"),
        "torque_n_m_per_a" => ("Kt", "torque constant"),
        "inertia_kg_m2" => ("J", "inertia"),
        "load_torque_n_m" => ("Tl", "load torque"),
        _ => ("", ""),
    };
    if !known.0.is_empty() {
        return (known.0.to_owned(), known.1.to_owned());
    }
    let own = key.rsplit('.').next().unwrap_or(key);
    let mut words = own.split('_');
    let first = words.next().unwrap_or(own);
    (first.to_owned(), own.replace('_', " "))
}

/// The rows of a text that is broken between words; a word longer than a row is broken where the row ends.
pub(super) fn wrapped(text: &str, width: usize) -> Vec<String> {
    let width = width.max(1);
    let mut rows = Vec::new();
    let (mut row, mut length) = (String::new(), 0);
    for word in text.split_whitespace() {
        let mut word: Vec<char> = word.chars().collect();
        if length > 0 && length + 1 + word.len() > width {
            rows.push(std::mem::take(&mut row));
            length = 0;
        }
        if length > 0 {
            row.push(' ');
            length += 1;
        }
        while word.len() > width {
            let rest = word.split_off(width);
            rows.push(word.into_iter().collect());
            word = rest;
        }
        length += word.len();
        row.extend(word);
    }
    if length > 0 || rows.is_empty() {
        rows.push(row);
    }
    rows
}

/// The keys that fit into a row: `always` is kept, of the others as many as there is room for, the first first.
pub(super) fn keys_that_fit(keys: &[&str], always: &str, width: usize) -> String {
    let length = |text: &str| text.chars().count();
    let mut room = width.saturating_sub(1 + length(always));
    let mut shown = String::from(" ");
    for key in keys {
        let needed = length(key) + 2;
        if needed > room {
            break;
        }
        room -= needed;
        shown.push_str(key);
        shown.push_str("  ");
    }
    shown + always
}

/// A text cut to `width`, with a mark where something is left out.
pub(super) fn cut(text: &str, width: usize) -> String {
    if text.chars().count() <= width {
        return text.to_owned();
    }
    let mut short: String = text.chars().take(width.saturating_sub(1)).collect();
    short.push('…');
    short
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_deviation_decides_on_the_digits() {
        for (value, std, expected) in [
            (1.103_28, 0.021, "1.103 ± 0.021"),
            (0.009_9, 0.000_05, "0.009900 ± 0.000050"),
            (293.2, 12.0, "293 ± 12"),
            (4.5e-9, 2.0e-10, "(4.50 ± 0.20)e-9"),
            (3.2e7, 1.0e6, "(3.20 ± 0.10)e7"),
            (-0.5, 3.0, "-0.5 ± 3.0"),
        ] {
            assert_eq!(with_std(value, Some(std)), expected);
        }
        assert_eq!(with_std(1.5, None), "1.500");
        assert_eq!(with_std(f64::NAN, Some(1.0)), "-");
    }

    #[test]
    fn ticks_are_short() {
        for (value, expected) in [
            (0.0, "0"),
            (-110.0, "-110"),
            (2.5, "2.5"),
            (0.05, "0.05"),
            (1e6, "1e6"),
            (-5e-4, "-5e-4"),
            (12_500.0, "12500"),
        ] {
            assert_eq!(tick(value), expected);
        }
    }

    #[test]
    fn no_word_is_lost_between_rows_and_no_row_is_too_long() {
        let text = "held-out error 2.82 -> 2.74 times the noise aaaaaaaaaaaaaaaaaaaaaaaaa";
        for width in 1..80 {
            let rows = wrapped(text, width);
            assert!(
                rows.iter().all(|row| row.chars().count() <= width),
                "{rows:?}"
            );
            let joined: String = rows.concat().split_whitespace().collect();
            assert_eq!(joined, text.split_whitespace().collect::<String>());
        }
        assert_eq!(wrapped("", 10), [""]);
    }

    #[test]
    fn the_keys_that_matter_are_never_cut_off() {
        let keys = ["a add", "r remove", "m map"];
        for width in 16..60 {
            let shown = keys_that_fit(&keys, "? help  q leave", width);
            assert!(
                shown.chars().count() <= width && shown.ends_with("q leave"),
                "{shown}"
            );
        }
        assert!(keys_that_fit(&keys, "q", 60).starts_with(" a add  r remove  m map  q"));
        assert_eq!(cut("diagnosis", 4), "dia…");
    }

    #[test]
    fn a_parameter_has_a_symbol_and_a_name() {
        assert_eq!(parameter("inertia_kg_m2").0, "J");
        assert_eq!(
            parameter("stribeck_friction.stribeck_n_m"),
            ("stribeck".to_owned(), "stribeck n m".to_owned())
        );
    }
}
