//! Two models on one run, and two runs of one motor.

use super::times;
use drivebench_diagnose::{Kinship, MotorMatch, Versus, VersusFinding};

/// With `A` and `B` for the models.
pub fn versus(found: &Versus) -> String {
    let [first, second] = found.holdout_rmse;
    let errors = format!("A {first:.2}, B {second:.2} {}", times(found.noise_floor_from));
    let ratio = || {
        let ratio =
            found.difference.unwrap_or(f64::NAN).abs() / found.difference_std.unwrap_or(0.0);
        format!("{ratio:.1} standard errors over {} parts of the run", found.blocks)
    };
    let better = |name: &str, better: f64, other: f64| {
        format!(
            "{name} is better: {errors}, {:.0} % less, {} ({:.1} are needed)",
            100.0 * (1.0 - better / other),
            ratio(),
            found.limit
        )
    };
    match found.finding {
        VersusFinding::TooShort => {
            format!("the hold-out is too short to distinguish them: {errors}")
        }
        VersusFinding::Same => format!("both models give the same: {errors}"),
        VersusFinding::NotToldApart => format!(
            "this run does not distinguish them: {errors}; the difference is {}, and {:.1} are needed",
            ratio(),
            found.limit
        ),
        VersusFinding::FirstBetter => better("A", first, second),
        VersusFinding::SecondBetter => better("B", second, first),
    }
}

pub fn motor_match(found: &MotorMatch) -> String {
    let (first, second) = (found.first, found.second);
    let figures = format!(
        "back-EMF constant {:.4} and {:.4} V.s/rad ({:+.1} %), resistance {:.3} and {:.3} ohm ({:+.0} %)",
        first.back_emf_v_s_per_rad.value,
        second.back_emf_v_s_per_rad.value,
        100.0 * found.back_emf_difference,
        first.resistance_ohm.value,
        second.resistance_ohm.value,
        100.0 * found.resistance_difference
    );
    match found.kinship {
        Kinship::Same => format!("no sign that the two runs are of different motors: {figures}"),
        Kinship::Doubtful => format!(
            "the two runs may be of different motors: {figures}; a magnet that is some 20 K warmer has the same effect"
        ),
        Kinship::Other => format!(
            "the two runs are not of the same motor, or not wired equally: {figures}; a change of temperature does not explain this"
        ),
    }
}
