//! Verdict on each fitted parameter.

use drivebench_model::plant::{MotorKey, Slot};
use drivebench_model::sample::{ParameterEstimate, Verdict};

/// Relative standard deviation above which a positive parameter is not carried by the data.
pub(super) const NOT_OBSERVABLE: f64 = 0.5;
/// Relative standard deviation of an effect's parameter below which it is settled: its size is what is asked, roughly.
pub(super) const SETTLED_EFFECT: f64 = 0.1;
/// Relative standard deviation above which a coefficient may as well be zero (1 % in two directions).
const TOLD_FROM_ZERO: f64 = 1.0 / 2.58;
/// Relative standard deviation below which it is settled.
pub(super) const SETTLED: f64 = 0.02;

/// Standard deviations that hold 95 % of the values.
const TWO_SIDED_95: f64 = 1.96;

/// A motor's parameter that the data do not carry.
pub(super) fn unknown(key: MotorKey, reason: impl Into<String>) -> ParameterEstimate {
    ParameterEstimate::not_observable(key.key(), key.unit(), reason)
}

/// Judges one fitted value by its standard deviation; `None`, or either not finite: the data leave it undetermined.
pub fn judge(slot: &Slot, value: f64, std: Option<f64>, period_s: f64) -> ParameterEstimate {
    let (key, unit) = (slot.key(), slot.unit());
    let Some(std) = std.filter(|std| std.is_finite() && value.is_finite()) else {
        let reason = match slot {
            Slot::Motor(MotorKey::Inductance) => at_period("no unique value", period_s),
            _ => "the run does not excite it: no unique value".to_owned(),
        };
        return ParameterEstimate::not_observable(&key, unit, reason);
    };
    let relative = std / value.abs().max(f64::MIN_POSITIVE);
    let positive = matches!(slot, Slot::Motor(_));
    if value == 0.0 && std == 0.0 {
        let reason = "the signals that would show it do not change";
        return ParameterEstimate::not_observable(&key, unit, reason);
    }
    if positive && value < -TWO_SIDED_95 * std {
        let reason = "negative, which no motor has: check signs, units and columns of the signals";
        let found = ParameterEstimate::found(key, unit, value, std, Some(reason.to_owned()));
        return ParameterEstimate {
            verdict: Verdict::Invalid,
            ..found
        };
    }
    if positive && relative > NOT_OBSERVABLE {
        let reason = match slot {
            Slot::Motor(MotorKey::Inductance) => at_period(&uncertainty(relative), period_s),
            _ => format!("{}: the run does not excite it", uncertainty(relative)),
        };
        return ParameterEstimate::not_observable(&key, unit, reason);
    }
    // An effect's coefficient may be zero within its uncertainty: that is a finding, and its value stays in sight.
    let settled = relative <= if positive { SETTLED } else { SETTLED_EFFECT };
    let reason = if !positive && relative > TOLD_FROM_ZERO {
        "not told from zero".to_owned()
    } else {
        uncertainty(relative)
    };
    ParameterEstimate::found(key, unit, value, std, (!settled).then_some(reason))
}

/// A relative standard deviation in words that can be read whatever its size.
fn uncertainty(relative: f64) -> String {
    if relative > 10.0 {
        "the uncertainty is more than ten times the value".to_owned()
    } else if relative > 2.0 {
        format!("the uncertainty is {relative:.1} times the value")
    } else if relative > NOT_OBSERVABLE {
        format!("relative uncertainty {:.0} %", 100.0 * relative)
    } else {
        format!("relative uncertainty {:.1} %", 100.0 * relative)
    }
}

fn at_period(what: &str, period_s: f64) -> String {
    let period_ms = 1e3 * period_s;
    format!("{what} at a period of {period_ms:.1} ms: sample faster, or use burst capture")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_not_finite_is_never_settled() {
        let slot = Slot::Motor(MotorKey::Inertia);
        for (value, std) in [(f64::NAN, 0.0), (f64::INFINITY, 0.0), (1.0, f64::NAN)] {
            let judged = judge(&slot, value, Some(std), 0.01);
            assert_eq!(
                (judged.verdict, judged.value),
                (Verdict::NotObservable, None)
            );
        }
    }

    #[test]
    fn an_uncertainty_reads_sensibly_at_any_size() {
        for (relative, text) in [
            (0.031, "relative uncertainty 3.1 %"),
            (0.87, "relative uncertainty 87 %"),
            (3.12, "the uncertainty is 3.1 times the value"),
            (
                12345.678,
                "the uncertainty is more than ten times the value",
            ),
        ] {
            assert_eq!(uncertainty(relative), text);
        }
        let slot = Slot::Motor(MotorKey::Inertia);
        let judged = judge(&slot, 1e-9, Some(1.0), 0.01);
        assert_eq!(judged.verdict, Verdict::NotObservable);
        let reason = judged.reason.unwrap();
        assert!(
            !reason.contains(|letter: char| letter.is_ascii_digit()),
            "{reason}"
        );
    }
}
