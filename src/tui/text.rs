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
    fn a_parameter_has_a_symbol_and_a_name() {
        assert_eq!(parameter("inertia_kg_m2").0, "J");
        assert_eq!(
            parameter("stribeck_friction.stribeck_n_m"),
            ("stribeck".to_owned(), "stribeck n m".to_owned())
        );
    }
}
