//! Dynamics with their covariance as parameters with deviation and verdict.

use super::Dynamics;
use crate::verdict::{SETTLED, judge};
use drivebench_model::plant::{MotorKey, Slot};
use drivebench_model::sample::{ParameterEstimate, Reason, Verdict};

#[derive(Clone, Debug)]
pub(crate) struct Claim {
    pub(crate) dynamics: Dynamics,
    /// Covariance of (Ta, TM, Ke, load voltage); `None` where it is not known.
    pub(crate) covariance: Option<[[f64; 4]; 4]>,
    pub(crate) period_s: f64,
    pub(crate) resistance_ohm: Option<f64>,
    /// Torque constant, N.m/A, where it is not the back-EMF constant.
    pub(crate) torque_n_m_per_a: Option<f64>,
    pub(crate) doubt: Option<Doubt>,
}

/// A less biased estimate of the same quantities.
#[derive(Clone, Debug)]
pub(crate) struct Doubt {
    pub(crate) better: Dynamics,
    pub(crate) covariance: Option<[[f64; 4]; 4]>,
    /// Cause of the error of the claim, as the beginning of the reason.
    pub(crate) cause: String,
    /// A known error of the method: what it makes of `better`, and the cause to name where that is most of the difference.
    pub(crate) systematic: Option<(Dynamics, String)>,
    /// Method that gave it, as the end of the reason.
    pub(crate) source: &'static str,
}

/// A reported quantity: the slot by whose rules it is judged, its key where that is another (then in seconds), and its
/// value from dynamics, resistance and torque constant.
type Quantity = (MotorKey, Option<&'static str>, fn(&Dynamics, f64, f64) -> f64);

const WITHOUT_RESISTANCE: [Quantity; 3] = [
    (MotorKey::Inductance, Some("electrical_time_constant_s"), |d, _, _| d.ta_s),
    (MotorKey::Inertia, Some("mechanical_time_constant_s"), |d, _, _| d.tm_s),
    (MotorKey::BackEmf, None, |d, _, _| d.ke),
];

const WITH_RESISTANCE: [Quantity; 3] = [
    (MotorKey::Inductance, None, |d, r, _| d.ta_s * r),
    (MotorKey::Inertia, None, |d, r, kt| d.tm_s * d.ke * kt / r),
    (MotorKey::LoadTorque, None, |d, r, kt| d.load_v * kt / r),
];

fn unknown((slot, key, _): &Quantity, code: Reason, reason: &str) -> ParameterEstimate {
    let unit = key.map_or(slot.unit(), |_| "s");
    ParameterEstimate::not_observable(key.unwrap_or(slot.key()), unit, code, reason)
}

/// Ta, TM, Ke and, with a resistance, L, J, Mc: each judged by its standard deviation and by the doubt.
pub(crate) fn estimates(claim: &Claim) -> Vec<ParameterEstimate> {
    let resistance_ohm = claim.resistance_ohm.filter(|r| *r > 0.0);
    let with_resistance = WITH_RESISTANCE.iter().map(|quantity| match resistance_ohm {
        Some(r) => one(claim, quantity, r),
        None => unknown(
            quantity,
            Reason::DependsOnAnother,
            "voltage and speed fix it only with a known resistance: give resistance_ohm in the model file",
        ),
    });
    let without = WITHOUT_RESISTANCE.iter().map(|quantity| one(claim, quantity, 1.0));
    without.chain(with_resistance).collect()
}

/// Every quantity as not observable for one reason.
pub(crate) fn all_unknown(reason: &str) -> Vec<ParameterEstimate> {
    let all = WITHOUT_RESISTANCE.iter().chain(&WITH_RESISTANCE);
    all.map(|quantity| unknown(quantity, Reason::Impossible, reason)).collect()
}

fn one(claim: &Claim, quantity: &Quantity, resistance_ohm: f64) -> ParameterEstimate {
    let (slot, key, value_of) = quantity;
    let of = |d: &Dynamics| value_of(d, resistance_ohm, claim.torque_n_m_per_a.unwrap_or(d.ke));
    let value = of(&claim.dynamics);
    let std = claim.covariance.map(|it| spread(&claim.dynamics, &it, &of));
    let mut judged = judge(&Slot::Motor(*slot), value, std, claim.period_s);
    if let Some(key) = key {
        (judged.key, judged.unit) = ((*key).to_owned(), "s");
    }
    let open = matches!(judged.verdict, Verdict::NotObservable | Verdict::Invalid);
    let Some(doubt) = claim.doubt.as_ref().filter(|_| !open) else { return judged };
    let better = of(&doubt.better);
    let error = value - better;
    let noise = doubt.covariance.map_or(0.0, |it| spread(&doubt.better, &it, &of));
    let relative = error.abs() / better.abs().max(f64::MIN_POSITIVE);
    // A comparison with what is not finite shows nothing.
    let visible = relative > 0.02 && error.abs() > 2.0 * noise;
    if !visible {
        not_better_than(noise, doubt, &mut judged);
        return judged;
    }
    let spoilt = relative > 0.2;
    let verdict = if spoilt { Verdict::Invalid } else { Verdict::Searching };
    let cause = match &doubt.systematic {
        Some((made_of_it, cause)) if (of(made_of_it) - better) / error > 0.5 => cause,
        _ => &doubt.cause,
    };
    let (percent, unit, source) = (100.0 * error / better, judged.unit, &doubt.source);
    let reason = format!("{cause}: {percent:+.0} % against {better:.4e} {unit} {source}");
    judged.set(verdict, Reason::MethodBiased, reason);
    judged
}

/// The bias is known only within the deviation of the compared value, which is added to the uncertainty.
fn not_better_than(noise: f64, doubt: &Doubt, judged: &mut ParameterEstimate) {
    let (Some(value), Some(std)) = (judged.value, judged.std) else { return };
    // Not finite: as if there were no better value.
    let open = if noise.is_finite() { noise } else { value.abs() };
    judged.std = Some(std.hypot(open));
    if std.hypot(open) > SETTLED * value.abs() {
        let percent = 100.0 * open / value.abs();
        let known = if percent > 100.0 {
            "is not known, also not".to_owned()
        } else {
            format!("is known to {percent:.0} % only")
        };
        let reason = format!("{}, and how far {known} {}", doubt.cause, doubt.source);
        judged.unsettle(Reason::MethodBiased, reason);
    }
}

/// Standard deviation of a function of the dynamics, by its gradient (central differences).
fn spread(dynamics: &Dynamics, covariance: &[[f64; 4]; 4], of: &dyn Fn(&Dynamics) -> f64) -> f64 {
    let at = dynamics.to_array();
    let gradient: [f64; 4] = std::array::from_fn(|j| {
        let step = 1e-5 * at[j].abs().max(1e-9);
        let moved = |by: f64| {
            let mut there = at;
            there[j] += by;
            of(&Dynamics::from_array(there))
        };
        (moved(step) - moved(-step)) / (2.0 * step)
    });
    let along =
        |i: usize| -> f64 { (0..4).map(|j| gradient[i] * covariance[i][j] * gradient[j]).sum() };
    (0..4).map(along).sum::<f64>().max(0.0).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bias_that_nothing_bounds_settles_nothing() {
        let dynamics = Dynamics { ta_s: 0.009, tm_s: 0.04, ke: 0.35, load_v: 1.4 };
        let diagonal = |share: f64| {
            let square = |i: usize| (share * dynamics.to_array()[i]).powi(2);
            std::array::from_fn(|i| std::array::from_fn(|j| if i == j { square(i) } else { 0.0 }))
        };
        // Ta against a better value of this relative deviation.
        let electrical = |relative: f64| {
            let doubt = Doubt {
                better: Dynamics { ta_s: 0.0091, ..dynamics },
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
                doubt: Some(doubt),
            };
            estimates(&claim).swap_remove(0)
        };
        let bounded = electrical(0.01);
        assert_eq!(bounded.verdict, Verdict::Settled, "{bounded:?}");
        // Within the deviation of the better value, which is as good as none.
        let open = electrical(0.6);
        assert_eq!(open.verdict, Verdict::Searching, "{open:?}");
        assert!(open.std.unwrap() > 0.5 * open.value.unwrap());
        assert!(open.reason.unwrap().contains("known to 60 % only by 1-iv"));
    }
}
