//! Dynamics with their covariance as parameters with deviation and verdict.

use super::Dynamics;
use crate::verdict::{SETTLED, judge};
use drivebench_model::plant::{MotorKey, Slot};
use drivebench_model::sample::{ParameterEstimate, Verdict};

/// Relative error that a doubt has to show before a value is not called settled, and before it is called invalid.
const VISIBLE: f64 = 0.02;
const SPOILT: f64 = 0.2;
/// Standard deviations of the better value that the difference must exceed.
const SIGNIFICANT: f64 = 2.0;

/// What is claimed and what is known against it.
#[derive(Clone, Debug)]
pub struct Claim {
    pub dynamics: Dynamics,
    /// Covariance of (Ta, TM, Ke, load voltage); `None` where it is not known.
    pub covariance: Option<[[f64; 4]; 4]>,
    pub period_s: f64,
    pub resistance_ohm: Option<f64>,
    /// Torque constant, N.m/A, where it is not the back-EMF constant.
    pub torque_n_m_per_a: Option<f64>,
    pub doubts: Vec<Doubt>,
}

/// A better founded value of the same quantities.
#[derive(Clone, Debug)]
pub struct Doubt {
    pub better: Dynamics,
    pub covariance: Option<[[f64; 4]; 4]>,
    /// Why the claim is off, as the begin of the reason.
    pub cause: String,
    /// A known error of the method: what it makes of `better`, and the cause to name where that is most of the difference.
    pub systematic: Option<(Dynamics, String)>,
    /// Whose value it is.
    pub source: &'static str,
}

/// One reported quantity: key, unit, the slot by whose rules it is judged.
struct Quantity {
    key: &'static str,
    unit: &'static str,
    slot: MotorKey,
    of: fn(&Dynamics, f64, Option<f64>) -> f64,
}

const WITHOUT_RESISTANCE: [Quantity; 3] = [
    Quantity {
        key: "electrical_time_constant_s",
        unit: "s",
        slot: MotorKey::Inductance,
        of: |d, _, _| d.ta_s,
    },
    Quantity {
        key: "mechanical_time_constant_s",
        unit: "s",
        slot: MotorKey::Inertia,
        of: |d, _, _| d.tm_s,
    },
    Quantity {
        key: MotorKey::BackEmf.key(),
        unit: MotorKey::BackEmf.unit(),
        slot: MotorKey::BackEmf,
        of: |d, _, _| d.ke,
    },
];

const WITH_RESISTANCE: [Quantity; 3] = [
    Quantity {
        key: MotorKey::Inductance.key(),
        unit: MotorKey::Inductance.unit(),
        slot: MotorKey::Inductance,
        of: |d, r, _| d.ta_s * r,
    },
    Quantity {
        key: MotorKey::Inertia.key(),
        unit: MotorKey::Inertia.unit(),
        slot: MotorKey::Inertia,
        of: |d, r, kt| d.tm_s * d.ke * kt.unwrap_or(d.ke) / r,
    },
    Quantity {
        key: MotorKey::LoadTorque.key(),
        unit: MotorKey::LoadTorque.unit(),
        slot: MotorKey::LoadTorque,
        of: |d, r, kt| d.load_v * kt.unwrap_or(d.ke) / r,
    },
];

/// Ta, TM, Ke and, with a resistance, L, J, Mc: each judged by its standard deviation and by the doubts.
pub fn estimates(claim: &Claim) -> Vec<ParameterEstimate> {
    let mut out: Vec<ParameterEstimate> = WITHOUT_RESISTANCE
        .iter()
        .map(|quantity| one(claim, quantity, 1.0))
        .collect();
    match claim.resistance_ohm.filter(|r| *r > 0.0) {
        Some(r) => out.extend(WITH_RESISTANCE.iter().map(|quantity| one(claim, quantity, r))),
        None => out.extend(WITH_RESISTANCE.iter().map(|quantity| {
            ParameterEstimate::not_observable(
                quantity.key,
                quantity.unit,
                "voltage and speed fix it only with a known resistance: give resistance_ohm in the model file",
            )
        })),
    }
    out
}

/// Every quantity as not observable for one reason.
pub(crate) fn all_unknown(reason: &str) -> Vec<ParameterEstimate> {
    WITHOUT_RESISTANCE
        .iter()
        .chain(&WITH_RESISTANCE)
        .map(|quantity| ParameterEstimate::not_observable(quantity.key, quantity.unit, reason))
        .collect()
}

fn one(claim: &Claim, quantity: &Quantity, resistance_ohm: f64) -> ParameterEstimate {
    let of = |dynamics: &Dynamics| (quantity.of)(dynamics, resistance_ohm, claim.torque_n_m_per_a);
    let deviation = |dynamics: &Dynamics, covariance: &Option<[[f64; 4]; 4]>| {
        covariance.map(|covariance| spread(dynamics, &covariance, &of))
    };
    let value = of(&claim.dynamics);
    let std = deviation(&claim.dynamics, &claim.covariance);
    let mut judged = judge(&Slot::Motor(quantity.slot), value, std, claim.period_s);
    quantity.key.clone_into(&mut judged.key);
    judged.unit = quantity.unit;
    if judged.verdict == Verdict::NotObservable {
        return judged;
    }
    for doubt in &claim.doubts {
        let better = of(&doubt.better);
        let error = value - better;
        let noise = deviation(&doubt.better, &doubt.covariance).unwrap_or(0.0);
        let relative = error.abs() / better.abs().max(f64::MIN_POSITIVE);
        // A comparison with what is not finite shows nothing.
        let visible = relative > VISIBLE && error.abs() > SIGNIFICANT * noise;
        if judged.verdict == Verdict::Invalid {
            continue;
        }
        if !visible {
            not_better_than(noise, doubt, &mut judged);
            continue;
        }
        judged.verdict = if relative > SPOILT {
            Verdict::Invalid
        } else {
            Verdict::Searching
        };
        let cause = match &doubt.systematic {
            Some((made_of_it, cause)) if (of(made_of_it) - better) / error > 0.5 => cause,
            _ => &doubt.cause,
        };
        judged.reason = Some(format!(
            "{cause}: {:+.0} % against {better:.4e} {} {}",
            100.0 * error / better,
            quantity.unit,
            doubt.source
        ));
    }
    judged
}

/// A bias is known no better than the value that shows it: what that leaves open is part of the uncertainty.
fn not_better_than(noise: f64, doubt: &Doubt, judged: &mut ParameterEstimate) {
    let (Some(value), Some(std)) = (judged.value, judged.std) else {
        return;
    };
    // Not finite: the better value says nothing, as if there were none.
    let open = Some(noise)
        .filter(|noise| noise.is_finite())
        .unwrap_or(value.abs());
    judged.std = Some(std.hypot(open));
    if std.hypot(open) > SETTLED * value.abs() {
        let percent = 100.0 * open / value.abs();
        let known = if percent > 100.0 {
            "is not known, also not".to_owned()
        } else {
            format!("is known to {percent:.0} % only")
        };
        judged.unsettle(format!(
            "{}, and how far {known} {}",
            doubt.cause, doubt.source
        ));
    }
}

/// Standard deviation of a function of the dynamics, by its gradient (central differences).
fn spread(dynamics: &Dynamics, covariance: &[[f64; 4]; 4], of: &dyn Fn(&Dynamics) -> f64) -> f64 {
    let at = dynamics.to_array();
    let gradient: [f64; 4] = std::array::from_fn(|j| {
        let step = 1e-5 * at[j].abs().max(1e-9);
        let (mut up, mut down) = (at, at);
        up[j] += step;
        down[j] -= step;
        (of(&Dynamics::from_array(up)) - of(&Dynamics::from_array(down))) / (2.0 * step)
    });
    quadratic(&gradient, covariance).max(0.0).sqrt()
}

fn quadratic<const N: usize>(gradient: &[f64; N], covariance: &[[f64; N]; N]) -> f64 {
    (0..N)
        .map(|i| {
            (0..N)
                .map(|j| gradient[i] * covariance[i][j] * gradient[j])
                .sum::<f64>()
        })
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A claim of the same dynamics as a better value of this relative deviation.
    fn electrical(relative: f64) -> ParameterEstimate {
        let dynamics = Dynamics {
            ta_s: 0.009,
            tm_s: 0.04,
            ke: 0.35,
            load_v: 1.4,
        };
        let diagonal = |share: f64| {
            let at = dynamics.to_array();
            std::array::from_fn(|i| {
                std::array::from_fn(|j| if i == j { (share * at[i]).powi(2) } else { 0.0 })
            })
        };
        let doubt = Doubt {
            better: Dynamics {
                ta_s: 0.0091,
                ..dynamics
            },
            covariance: Some(diagonal(relative)),
            cause: "noise of the speed biases least squares".to_owned(),
            systematic: None,
            source: "by 1-iv on the same run",
        };
        let claim = Claim {
            dynamics,
            covariance: Some(diagonal(0.005)),
            period_s: 0.001,
            resistance_ohm: None,
            torque_n_m_per_a: None,
            doubts: vec![doubt],
        };
        estimates(&claim).swap_remove(0)
    }

    #[test]
    fn a_bias_that_nothing_bounds_settles_nothing() {
        let bounded = electrical(0.01);
        assert_eq!(bounded.verdict, Verdict::Settled, "{bounded:?}");
        // Within the deviation of the better value, which is as good as none.
        let open = electrical(0.6);
        assert_eq!(open.verdict, Verdict::Searching, "{open:?}");
        assert!(open.std.unwrap() > 0.5 * open.value.unwrap());
        assert!(open.reason.unwrap().contains("known to 60 % only by 1-iv"));
    }
}
