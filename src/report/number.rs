//! Numbers as a person reads them: as many digits as their uncertainty carries, SI, r/min beside rad/s.

use crate::sample::{ParameterEstimate, Verdict};
use crate::units::rpm_from_rad_s;

/// Stands for a value that is not there.
pub const MISSING: &str = "n/a";

/// Powers of ten between which a number is written without an exponent.
const PLAIN: std::ops::Range<i32> = -3..6;

/// `value` to `digits` significant digits; digits before the decimal point are never dropped.
pub fn significant(value: f64, digits: usize) -> String {
    if !value.is_finite() {
        return MISSING.to_owned();
    }
    let digits = digits.max(1);
    let exponent = exponent_of(value, digits);
    if value == 0.0 || PLAIN.contains(&exponent) {
        let wanted = i32::try_from(digits).unwrap_or(i32::MAX);
        let decimals = places(wanted - 1 - exponent);
        format!(
            "{:.*}",
            if value == 0.0 { 0 } else { decimals },
            value + 0.0
        )
    } else {
        format!("{value:.*e}", digits - 1)
    }
}

/// `value ± std`, the standard deviation with two significant digits and the value to the same decimal.
pub fn with_std(value: f64, std: f64) -> String {
    if !value.is_finite() {
        return MISSING.to_owned();
    }
    if !std.is_finite() || std < 0.0 {
        return format!("{} ± unknown", significant(value, 3));
    }
    let leading = exponent_of(if value.abs() > std { value } else { std }, 3);
    // Ten digits are more than any measurement carries; the uncertainty is then below what is shown.
    let last = (exponent_of(std, 2) - 1).max(leading - 9);
    if std == 0.0 {
        return format!("{} ± 0", significant(value, 5));
    }
    if PLAIN.contains(&leading) {
        let decimals = places(-last);
        format!(
            "{:.decimals$} ± {:.decimals$}",
            rounded(value, last),
            rounded(std, last)
        )
    } else {
        let unit = 10f64.powi(leading);
        let decimals = places(leading - last);
        format!(
            "({:.decimals$} ± {:.decimals$})e{leading}",
            value / unit + 0.0,
            std / unit
        )
    }
}

/// A fixed number of decimals; what rounds to zero has no sign.
pub fn fixed(value: f64, decimals: usize) -> String {
    if !value.is_finite() {
        return MISSING.to_owned();
    }
    let text = format!("{value:.decimals$}");
    let nothing = text.chars().all(|c| matches!(c, '-' | '0' | '.'));
    text.strip_prefix('-')
        .filter(|_| nothing)
        .map_or_else(|| text.clone(), str::to_owned)
}

/// A speed in both units.
pub fn speed(speed_rad_s: f64) -> String {
    if speed_rad_s.is_finite() {
        format!(
            "{} rad/s ({} r/min)",
            significant(speed_rad_s, 3),
            fixed(rpm_from_rad_s(speed_rad_s), 0)
        )
    } else {
        MISSING.to_owned()
    }
}

/// A percentage with one decimal.
pub fn percent(value: f64) -> String {
    if value.is_finite() {
        format!("{} %", fixed(value, 1))
    } else {
        MISSING.to_owned()
    }
}

/// Value and uncertainty of an estimate without its unit; says so where the data do not carry it.
pub fn estimate(parameter: &ParameterEstimate) -> String {
    match (parameter.verdict, parameter.value, parameter.std) {
        (Verdict::NotObservable, ..) | (_, None, _) => MISSING.to_owned(),
        (Verdict::Fixed, Some(value), _) => significant(value, 5),
        (_, Some(value), std) => with_std(value, std.unwrap_or(f64::NAN)),
    }
}

/// Verdict with its reason.
pub fn verdict(parameter: &ParameterEstimate) -> String {
    match &parameter.reason {
        Some(reason) => format!("{}: {reason}", parameter.verdict.name()),
        None => parameter.verdict.name().to_owned(),
    }
}

/// Decimals to write; none where the last digit stands left of the point.
pub(super) fn places(decimals: i32) -> usize {
    usize::try_from(decimals).unwrap_or(0)
}

/// Power of ten of the first digit after rounding to `digits`; 0 for zero.
pub(super) fn exponent_of(value: f64, digits: usize) -> i32 {
    format!("{value:.*e}", digits - 1)
        .rsplit_once('e')
        .and_then(|(_, exponent)| exponent.parse().ok())
        .unwrap_or(0)
}

/// `value` rounded at the decimal place `10^place` where that stands left of the point; unchanged otherwise.
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
        for (value, digits, text) in [
            (0.0, 3, "0"),
            (-0.0, 3, "0"),
            (0.999_6, 3, "1.00"),
            (12_345.6, 3, "12346"),
            (1.234e-5, 3, "1.23e-5"),
            (f64::INFINITY, 3, "n/a"),
        ] {
            assert_eq!(significant(value, digits), text);
        }
        assert_eq!(
            (fixed(-0.04, 1).as_str(), fixed(-0.06, 1).as_str()),
            ("0.0", "-0.1")
        );
        assert_eq!(speed(-12.0), "-12.0 rad/s (-115 r/min)");
    }

    #[test]
    fn what_the_data_do_not_carry_has_no_number() {
        let mut parameter = ParameterEstimate::not_observable("inductance_h", "H", "sample faster");
        assert_eq!(estimate(&parameter), "n/a");
        assert_eq!(verdict(&parameter), "not observable: sample faster");
        parameter.value = Some(0.01);
        parameter.std = Some(0.001);
        parameter.verdict = Verdict::Searching;
        assert_eq!(estimate(&parameter), "0.0100 ± 0.0010");
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
