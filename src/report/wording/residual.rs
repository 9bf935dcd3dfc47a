//! The tests of the residual.

use drivebench_diagnose::{ResidualLights, SignalLights};
use drivebench_model::text::number::share;

/// The signals with which a residual is correlated, in the order of its tests.
const AGAINST: [&str; 4] =
    ["its own past", "the input", "the input squared", "the input squared, itself squared"];

/// What the two tests show: whiteness, and independence of the input.
pub fn residual(lights: &ResidualLights) -> String {
    if !lights.enough_samples {
        return "too few samples to test whether only noise is left".to_owned();
    }
    let outside = share(lights.autocorrelation_outside_99_percent);
    let band = "of the autocorrelation lags lie outside their 99 % band";
    let undefined =
        "the input never changes, so that its correlation with the residual is undefined";
    match (lights.white, lights.independent_of_input) {
        (true, Some(true)) => format!(
            "only noise is left: it is white, and independent of the input ({outside} {band}; 1 % is chance)"
        ),
        (true, Some(false)) => format!(
            "more than noise is left: the residual is correlated with the input at {} of the lags, where 1 % is expected by \
             chance; it is white ({outside} {band})",
            share(outside_with_input(lights))
        ),
        (true, None) => {
            format!("white, as noise is; {undefined} ({outside} {band}; 1 % is chance)")
        }
        (false, of_input) => {
            let input = match of_input {
                Some(true) => "independent of the input",
                Some(false) => "correlated with the input",
                None => undefined,
            };
            format!("more than noise is left: not white ({outside} of lags outside), {input}")
        }
    }
}

/// Share of the lags at which a residual is correlated with the input, the worst of the tests that fail.
fn outside_with_input(lights: &ResidualLights) -> f64 {
    let of_signal = |(_, own): (_, SignalLights)| [own.rho_ue, own.rho_u2e, own.rho_u2e2];
    let red = lights.named().flat_map(of_signal).filter(|light| !light.passes);
    red.map(|light| light.outside_99_percent).fold(0.0, f64::max)
}

/// What each signal's residual is correlated with; nothing where only noise is left.
pub fn details(lights: &ResidualLights) -> Vec<String> {
    let each = lights.named().filter(|_| lights.enough_samples);
    let sentences = each.filter_map(|(name, lights)| {
        let with = correlated_with(&lights)?;
        Some(format!(
            "{name} error is correlated with {with}; in brackets: multiples of the 99 % band"
        ))
    });
    sentences.collect()
}

/// Each in multiples of its 99 % band; none where all are within it. The test of the product of error and input is not used
/// alone.
fn correlated_with(lights: &SignalLights) -> Option<String> {
    let each = lights.each();
    let red = AGAINST.iter().zip(&each).filter(|(_, light)| !light.passes);
    let words = red.map(|(name, light)| format!("{name} ({:.1})", light.largest_over_band));
    let mut words: Vec<String> = words.collect();
    if lights.rho_ee.passes && !lights.is_white() {
        let times = lights.ljung_box / lights.ljung_box_limit;
        words.push(format!("its own past, all lags together ({times:.1})"));
    }
    (!words.is_empty()).then(|| words.join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;
    use drivebench_diagnose::Light;

    #[test]
    fn a_residual_has_the_result_of_both_tests() {
        let red = Light { largest_over_band: 2.2, outside_99_percent: 0.12, passes: false };
        let green = Light { largest_over_band: 0.9, outside_99_percent: 0.0, passes: true };
        let speed = SignalLights {
            rho_ee: green,
            rho_ue: red,
            rho_u2e: green,
            rho_u2e2: green,
            ljung_box_limit: 50.0,
            ..SignalLights::default()
        };
        let lights = |white, independent_of_input| ResidualLights {
            white,
            enough_samples: true,
            autocorrelation_outside_99_percent: 0.04,
            independent_of_input,
            speed_rad_s: Some(speed),
            ..ResidualLights::default()
        };
        for (found, begin, end) in [
            (lights(true, Some(true)), "only noise is left: it is white", "1 % is chance)"),
            (
                lights(true, Some(false)),
                "more than noise is left: the residual is correlated with the input at 12 % of the lags",
                "it is white (4 % of the autocorrelation lags lie outside their 99 % band)",
            ),
            (lights(true, None), "white, as noise is; the input never changes", "1 % is chance)"),
            (lights(false, Some(false)), "more than noise is left: not white (4 %", "the input"),
            (ResidualLights::default(), "too few samples", "noise is left"),
        ] {
            let text = residual(&found);
            assert!(text.starts_with(begin) && text.ends_with(end), "{text}");
        }
        assert_eq!(
            details(&lights(true, Some(false))),
            [
                "speed error is correlated with the input (2.2); in brackets: multiples of the 99 % band"
            ]
        );
    }
}
