//! Added-inertia test: two runs, the second with a known inertia added, give the absolute scale of torque without a torque
//! sensor.
//!
//! The torque balance `Kt i = J dw/dt + Mc sgn(w)` is homogeneous: every run gives only `J/Kt` and `Mc/Kt`. With a disc
//! of known inertia D on the same shaft the second run gives `(J + D)/Kt`, and both together
//! `Kt = D / (J2/Kt - J1/Kt)`, `J = Kt (J1/Kt)`, `Mc = Kt (Mc1/Kt)`.

use super::verdict;
use drivebench_model::plant::{MotorKey, Slot};
use drivebench_model::sample::{ParameterEstimate, Reason};

/// One run with the torque constant that its scheme assumed.
#[derive(Clone, Copy, Debug)]
pub struct ScaledRun<'a> {
    pub parameters: &'a [ParameterEstimate],
    /// Torque constant that the scheme used, N.m/A.
    pub torque_n_m_per_a: f64,
}

impl ScaledRun<'_> {
    /// Value over the assumed torque constant, with its standard deviation.
    fn over_torque_constant(&self, key: MotorKey) -> Option<(f64, f64)> {
        let found = ParameterEstimate::find(self.parameters, key.key())?;
        let kt = self.torque_n_m_per_a;
        Some((found.value? / kt, found.std? / kt))
    }
}

/// Torque constant, inertia (without the added one) and load torque, absolute. `added_kg_m2` is on the motor shaft.
pub fn absolute(
    without: &ScaledRun<'_>,
    with: &ScaledRun<'_>,
    added_kg_m2: f64,
) -> Vec<ParameterEstimate> {
    let keys = [MotorKey::TorqueConstant, MotorKey::Inertia, MotorKey::LoadTorque];
    let none = |code: Reason, reason: &str| -> Vec<ParameterEstimate> {
        keys.map(|key| verdict::unknown(key, code, reason)).to_vec()
    };
    let inertias = [without, with].map(|run| run.over_torque_constant(MotorKey::Inertia));
    let [Some((a1, s1)), Some((a2, s2))] = inertias else {
        return none(Reason::NotInEveryRun, "the inertia is not observable in one of the two runs");
    };
    let difference = a2 - a1;
    let difference_std = s1.hypot(s2);
    if difference < 3.0 * difference_std {
        let reason = format!(
            "the added inertia changes J/Kt by {difference:.3e} kg.m2.A/(N.m), with a standard deviation of \
             {difference_std:.1e}: add more, or excite more"
        );
        return none(Reason::NotExcited, &reason);
    }
    let kt = added_kg_m2 / difference;
    // Propagation of errors: d(ln Kt) = -d(a2 - a1)/difference; J = D a1/(a2 - a1) depends on a1 twice.
    let kt_std = kt * difference_std / difference;
    let inertia_std = kt / difference * (a2 * s1).hypot(a1 * s2);
    let key = MotorKey::LoadTorque;
    let load = if let Some((load, std)) = without.over_torque_constant(key) {
        judged(key, kt * load, (kt * std).hypot(load * kt_std))
    } else {
        let reason = "not observable in the run without the added inertia";
        verdict::unknown(key, Reason::NotInEveryRun, reason)
    };
    vec![
        judged(MotorKey::TorqueConstant, kt, kt_std),
        judged(MotorKey::Inertia, kt * a1, inertia_std),
        load,
    ]
}

fn judged(key: MotorKey, value: f64, std: f64) -> ParameterEstimate {
    verdict::judge(&Slot::Motor(key), value, Some(std), f64::NAN)
}

#[cfg(test)]
mod tests {
    use super::*;
    use drivebench_model::sample::Verdict;

    fn run(inertia: f64, load: f64) -> Vec<ParameterEstimate> {
        vec![
            judged(MotorKey::Inertia, inertia, 1e-3 * inertia),
            judged(MotorKey::LoadTorque, load, 1e-3 * load),
        ]
    }

    fn scaled(parameters: &[ParameterEstimate], torque_n_m_per_a: f64) -> ScaledRun<'_> {
        ScaledRun { parameters, torque_n_m_per_a }
    }

    #[test]
    fn the_absolute_scale_comes_from_the_disc() {
        // Truth: Kt 0.30, J 0.004, Mc 0.4; the scheme took Kt = Ke = 0.36, so all that it gave is 1.2 times too large.
        let (without, with) = (run(0.0048, 0.48), run(0.0084, 0.48));
        let found = absolute(&scaled(&without, 0.36), &scaled(&with, 0.36), 0.003);
        for (parameter, truth) in found.iter().zip([0.30, 0.004, 0.4]) {
            let value = parameter.value.unwrap();
            assert!((value / truth - 1.0).abs() < 1e-9, "{parameter:?}");
            assert_eq!(parameter.verdict, Verdict::Settled);
            assert!(parameter.std.unwrap() > 1e-3 * value, "{parameter:?}");
        }
        // A disc too small for its noise fixes nothing.
        let (without, with) = (run(0.0048, 0.48), run(0.004_805, 0.48));
        for parameter in absolute(&scaled(&without, 0.36), &scaled(&with, 0.36), 5e-6) {
            assert_eq!(parameter.verdict, Verdict::NotObservable);
        }
    }

    #[test]
    fn the_stated_deviation_is_that_of_repeated_trials() {
        use rand::SeedableRng as _;
        use rand_distr::{Distribution as _, Normal};
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(5);
        let noise = Normal::new(0.0, 0.01).unwrap();
        let (mut squares, mut variances) = ([0.0; 2], [0.0; 2]);
        let trials = 2000;
        for _ in 0..trials {
            let mut scatter = |value: f64| value * (1.0 + noise.sample(&mut rng));
            let one = vec![judged(MotorKey::Inertia, scatter(0.004), 4e-5)];
            let two = vec![judged(MotorKey::Inertia, scatter(0.010), 1e-4)];
            let found = absolute(&scaled(&one, 1.0), &scaled(&two, 1.0), 0.006);
            for (j, truth) in [1.0, 0.004].into_iter().enumerate() {
                squares[j] += (found[j].value.unwrap() / truth - 1.0).powi(2);
                variances[j] += (found[j].std.unwrap() / truth).powi(2);
            }
        }
        for j in 0..2 {
            let ratio = (variances[j] / squares[j]).sqrt();
            assert!((0.9..1.1).contains(&ratio), "{j} {ratio}");
        }
    }
}
