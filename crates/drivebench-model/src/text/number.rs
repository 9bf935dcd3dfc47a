//! Numbers for people: as many digits as the uncertainty justifies, SI units, speeds also in r/min.

use crate::units::rpm_from_rad_s;

pub const MISSING: &str = "n/a";

/// `value` to `digits` significant digits; digits before the decimal point are never dropped.
pub fn significant(value: f64, digits: usize) -> String {
    if !value.is_finite() {
        return MISSING.to_owned();
    }
    let digits = digits.max(1);
    let exponent = exponent_of(value, digits);
    if value == 0.0 {
        "0".to_owned()
    } else if is_plain(exponent) {
        let wanted = i32::try_from(digits).unwrap_or(i32::MAX);
        format!("{value:.*}", places(wanted - 1 - exponent))
    } else {
        format!("{value:.*e}", digits - 1)
    }
}

/// Whether a number of this power of ten is written without an exponent.
fn is_plain(exponent: i32) -> bool {
    (-3..6).contains(&exponent)
}

/// `value ± std`, the standard deviation with two significant digits and the value to the same decimal.
pub fn with_std(value: f64, std: impl Into<Option<f64>>) -> String {
    if !value.is_finite() {
        return MISSING.to_owned();
    }
    let std = std.into().unwrap_or(f64::NAN);
    if !std.is_finite() || std < 0.0 {
        return format!("{} ± unknown", significant(value, 3));
    }
    let leading = exponent_of(if value.abs() > std { value } else { std }, 3);
    // At most ten digits, more than any measurement has; a smaller uncertainty is rounded to zero.
    let last = (exponent_of(std, 2) - 1).max(leading - 9);
    if std == 0.0 {
        return format!("{} ± 0", significant(value, 5));
    }
    if is_plain(leading) {
        let decimals = places(-last);
        let (value, std) = (rounded(value, last), rounded(std, last));
        format!("{value:.decimals$} ± {std:.decimals$}")
    } else {
        let unit = 10f64.powi(leading);
        let decimals = places(leading - last);
        let (value, std) = (value / unit + 0.0, std / unit);
        format!("({value:.decimals$} ± {std:.decimals$})e{leading}")
    }
}

/// A fixed number of decimals; what rounds to zero has no sign.
pub fn fixed(value: f64, decimals: usize) -> String {
    if !value.is_finite() {
        return MISSING.to_owned();
    }
    let text = format!("{value:.decimals$}");
    let is_zero = text.chars().all(|c| matches!(c, '-' | '0' | '.'));
    text[usize::from(is_zero && text.starts_with('-'))..].to_owned()
}

/// At most `digits` significant digits, without zeros behind the point.
pub fn shortest(value: f64, digits: usize) -> String {
    let text = significant(value, digits);
    let (number, power) = text.split_at(text.find('e').unwrap_or(text.len()));
    if number.contains('.') {
        let number = number.trim_end_matches('0').trim_end_matches('.');
        format!("{number}{power}")
    } else {
        text
    }
}

/// The nearest number with so many significant digits.
pub fn with_digits(value: f64, digits: usize) -> f64 {
    significant(value, digits).parse().unwrap_or(value)
}

/// The value of a register: at most six digits, as many as 16 bits and a scale have.
pub fn reading(value: f64) -> String {
    shortest(value, 6)
}

/// A number and its unit; a ratio, whose unit is `-`, has none to show.
pub fn with_unit(number: &str, unit: &str) -> String {
    if number == MISSING || matches!(unit, "" | "-") {
        number.to_owned()
    } else {
        format!("{number} {unit}")
    }
}

/// A speed in the unit of nameplates, to stand beside the one in rad/s.
pub fn r_min(speed_rad_s: f64) -> String {
    format!("{} r/min", significant(rpm_from_rad_s(speed_rad_s), 3))
}

pub fn percent(value: f64) -> String {
    with_unit(&fixed(value, 1), "%")
}

/// The fit of a model, `100 (1 - |y - y'| / |y - mean|)` per cent (Ljung 1999); below -100 % a sentence instead.
pub fn fit(fit_percent: f64) -> String {
    if fit_percent < -100.0 { "worse than the mean".to_owned() } else { percent(fit_percent) }
}

pub fn share(share: f64) -> String {
    with_unit(&fixed(100.0 * share, 0), "%")
}

/// A probability in per cent; no figure above 99 % or below 1 %.
pub fn probability(probability: f64) -> String {
    match 100.0 * probability {
        p if p > 99.0 => "more than 99 %".to_owned(),
        p if p < 1.0 => "less than 1 %".to_owned(),
        _ => share(probability),
    }
}

/// Number of decimals; zero where the last digit is left of the point.
pub fn places(decimals: i32) -> usize {
    usize::try_from(decimals).unwrap_or(0)
}

/// Power of ten of the first digit after rounding to `digits`; 0 for zero.
pub fn exponent_of(value: f64, digits: usize) -> i32 {
    let text = format!("{value:.*e}", digits - 1);
    text.rsplit_once('e').map(|(_, exponent)| exponent.parse()).and_then(Result::ok).unwrap_or(0)
}

/// `value` rounded to a multiple of `10^place` where `place` is positive; unchanged otherwise.
fn rounded(value: f64, place: i32) -> f64 {
    if place > 0 {
        let unit = 10f64.powi(place);
        (value / unit).round() * unit + 0.0
    } else {
        value + 0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn digits_follow_the_uncertainty() {
        for (value, std, text) in [
            (0.119_432_1, 0.000_123, "0.11943 ± 0.00012"),
            (0.004_500_02, 2.1e-6, "0.0045000 ± 0.0000021"),
            (2.012e-6, 3.1e-8, "(2.012 ± 0.031)e-6"),
            (12_345.0, 678.0, "12350 ± 680"),
            (0.01, 0.12, "0.01 ± 0.12"),
            (-0.01, 0.0996, "-0.01 ± 0.10"),
            (1.1, 0.0, "1.1000 ± 0"),
            (1.1, f64::NAN, "1.10 ± unknown"),
            (f64::NAN, 0.1, "n/a"),
            (5e7, 1e6, "(5.00 ± 0.10)e7"),
        ] {
            assert_eq!(with_std(value, std), text);
        }
    }

    #[test]
    fn significant_digits_are_kept_and_nothing_more() {
        for (found, text) in [
            (significant(0.0, 3), "0"),
            (significant(-0.0, 3), "0"),
            (significant(0.999_6, 3), "1.00"),
            (significant(12_345.6, 3), "12346"),
            (significant(1.234e-5, 3), "1.23e-5"),
            (significant(f64::INFINITY, 3), "n/a"),
            (reading(-13_107.300_000_000_001), "-13107.3"),
            (reading(-1.200_000_000_000_000_2), "-1.2"),
            (reading(-0.0), "0"),
            (reading(65_536.0), "65536"),
            (reading(2.5e6), "2.5e6"),
            (reading(-5e-4), "-5e-4"),
            (fixed(-0.04, 1), "0.0"),
            (fixed(-0.06, 1), "-0.1"),
            (with_unit(&significant(0.2, 2), "-"), "0.20"),
            (r_min(-12.0), "-115 r/min"),
            (share(0.126), "13 %"),
            (share(f64::NAN), "n/a"),
            (percent(12.34), "12.3 %"),
            (percent(f64::NAN), "n/a"),
        ] {
            assert_eq!(found, text);
        }
    }

    proptest! {
        #[test]
        fn the_text_is_the_value_within_the_uncertainty(
            mantissa in -1.0..1.0f64, power in -12..12i32, relative in 1e-6..10.0f64,
        ) {
            let value = mantissa * 10f64.powi(power);
            let std = (value.abs() * relative).max(1e-300);
            let text = with_std(value, std);
            let (numbers, power) = match text.strip_prefix('(') {
                Some(rest) => rest.split_once(")e").unwrap(),
                None => (text.as_str(), "0"),
            };
            let scale = 10f64.powi(power.parse().unwrap());
            let (shown, shown_std) = numbers.split_once(" ± ").unwrap();
            let shown = shown.parse::<f64>().unwrap() * scale;
            let shown_std = shown_std.parse::<f64>().unwrap() * scale;
            prop_assert!((shown - value).abs() <= 0.06 * std, "{text} of {value} {std}");
            prop_assert!((shown_std / std - 1.0).abs() < 0.06, "{text} of {value} {std}");
        }
    }
}
