//! Verdict on each fitted parameter by its relative standard deviation.

use drivebench_model::plant::{MotorKey, Slot};
use drivebench_model::sample::{ParameterEstimate, Reason, Verdict};

/// Relative standard deviation above which a positive parameter is not observable.
pub(super) const NOT_OBSERVABLE: f64 = 0.5;
/// Relative standard deviation below which a parameter of the motor is settled.
pub(super) const SETTLED: f64 = 0.02;
/// The same of a parameter of an effect, which is needed less accurately.
pub(super) const SETTLED_EFFECT: f64 = 0.1;

/// Error of a model in units of the noise from which none of its values is settled: missing effects bias them, and deviations
/// from noise, or from the errors of neighbouring samples, do not bound that bias. A servo whose current is filtered, which was
/// not named, left 2.0 and gave R 11 % and ten of its deviations from the truth; one with a drop of another form left 1.4, and R 9 %.
pub const SETTLED_BELOW_RATIO: f64 = 1.25;

/// Relative standard deviation below which the parameter of this key is settled.
pub fn settled_below(key: &str) -> f64 {
    if MotorKey::from_key(key).is_some() { SETTLED } else { SETTLED_EFFECT }
}

/// Makes a parameter not observable.
pub(super) fn refuse(parameter: &mut ParameterEstimate, code: Reason, reason: impl Into<String>) {
    *parameter = ParameterEstimate::not_observable(&parameter.key, parameter.unit, code, reason);
}

/// A parameter of the motor that is not observable.
pub(super) fn unknown(key: MotorKey, code: Reason, reason: impl Into<String>) -> ParameterEstimate {
    ParameterEstimate::not_observable(key.key(), key.unit(), code, reason)
}

/// Verdict on one fitted value by its standard deviation; `None`, or either not finite: it is not determined.
pub fn judge(slot: &Slot, value: f64, std: Option<f64>, period_s: f64) -> ParameterEstimate {
    let (key, unit) = (slot.key(), slot.unit());
    let is_inductance = matches!(slot, Slot::Motor(MotorKey::Inductance));
    let unseen = if is_inductance { Reason::SampledTooSlowly } else { Reason::NotExcited };
    let open = |reason: String| ParameterEstimate::not_observable(&key, unit, unseen, reason);
    let at_period = |what: &str| {
        let period_ms = 1e3 * period_s;
        format!("{what} at a period of {period_ms:.1} ms: sample faster, or use burst capture")
    };
    let Some(std) = std.filter(|std| std.is_finite() && value.is_finite()) else {
        return open(if is_inductance {
            at_period("no unique value")
        } else {
            "the run does not excite it: no unique value".to_owned()
        });
    };
    let relative = std / value.abs().max(f64::MIN_POSITIVE);
    let positive = matches!(slot, Slot::Motor(_));
    if value == 0.0 && std == 0.0 {
        return open("the signals that depend on it do not change".to_owned());
    }
    if positive && value < -1.96 * std {
        let reason = "negative, which is impossible: check signs, units and columns of the signals";
        let doubt = Some((Reason::Impossible, reason.to_owned()));
        let found = ParameterEstimate::found(key, unit, value, std, doubt);
        return ParameterEstimate { verdict: Verdict::Invalid, ..found };
    }
    if positive && relative > NOT_OBSERVABLE {
        let uncertain = uncertainty(relative);
        return open(if is_inductance {
            at_period(&uncertain)
        } else {
            format!("{uncertain}: the run does not excite it")
        });
    }
    // A coefficient of an effect may be zero within its uncertainty (2.58 standard deviations, 1 % two-sided); its value stays.
    let settled = relative <= if positive { SETTLED } else { SETTLED_EFFECT };
    let reason = if !positive && relative > 1.0 / 2.58 {
        (Reason::MayBeZero, "not significantly different from zero".to_owned())
    } else {
        (Reason::Uncertain, uncertainty(relative))
    };
    ParameterEstimate::found(key, unit, value, std, (!settled).then_some(reason))
}

/// A relative standard deviation as text of any size.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_that_is_not_determined_is_not_observable() {
        let slot = Slot::Motor(MotorKey::Inertia);
        for (value, std, reason) in [
            (f64::NAN, 0.0, "no unique value"),
            (f64::INFINITY, 0.0, "no unique value"),
            (1.0, f64::NAN, "no unique value"),
            (1.0, 0.87, "relative uncertainty 87 %:"),
            (1.0, 3.12, "the uncertainty is 3.1 times the value:"),
            (1e-9, 1.0, "more than ten times the value:"),
        ] {
            let judged = judge(&slot, value, Some(std), 0.01);
            assert_eq!(judged.verdict, Verdict::NotObservable, "{judged:?}");
            assert!(judged.value.is_none() && judged.reason.unwrap().contains(reason));
        }
        assert_eq!(uncertainty(0.031), "relative uncertainty 3.1 %");
    }
}
