//! Which parameters a plan will make visible, from the predicted run and the time constants of the nameplate.

use serde::Serialize;

use super::trace::Trace;
use crate::bench::limits::Nameplate;
use crate::plant::MotorKey;

/// How well a parameter will be seen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Prospect {
    Good,
    /// Only by methods that integrate the circuit exactly between samples.
    Weak,
    NotObservable,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Observability {
    pub key: &'static str,
    pub prospect: Prospect,
    pub reason: String,
}

/// Samples per electrical time constant below which the difference quotient of the current is biased (paper A: the
/// period is to be half of L/R or less).
const GOOD_SAMPLES: f64 = 2.0;
/// Periods per electrical time constant beyond which nothing of the transient is left between two samples: exp(-3).
const MOST_PERIODS: f64 = 3.0;
/// Share of the rated value that an excitation has to reach to count.
const ENOUGH: f64 = 0.2;

pub(super) fn parameters(trace: &Trace, motor: &Nameplate, rate_hz: f64) -> Vec<Observability> {
    let points = &trace.points;
    let largest = |of: &dyn Fn(usize) -> f64| {
        (0..points.len())
            .map(of)
            .fold(0.0_f64, |peak, value| peak.max(value.abs()))
    };
    let current_share = largest(&|at| points[at].current_a) / motor.rated_current_a;
    let speed_share = largest(&|at| points[at].speed_rad_s) / motor.rated_speed_rad_s;
    let acceleration = largest(&|at| match at.checked_sub(1) {
        Some(before) if !points[at].coasts => {
            (points[at].speed_rad_s - points[before].speed_rad_s) / trace.step_s
        }
        _ => 0.0,
    });
    let inertial_share =
        acceleration * motor.inertia_kg_m2 / (motor.back_emf_v_s_per_rad * motor.rated_current_a);
    let forward = points
        .iter()
        .any(|p| p.speed_rad_s > 0.05 * motor.rated_speed_rad_s);
    let backward = points
        .iter()
        .any(|p| p.speed_rad_s < -0.05 * motor.rated_speed_rad_s);

    let by_share = |key: MotorKey, share: f64, what: &str| Observability {
        key: key.key(),
        prospect: if share >= ENOUGH {
            Prospect::Good
        } else {
            Prospect::NotObservable
        },
        reason: format!("{what} reaches {:.0} % of rated", 100.0 * share),
    };
    let electrical_s = motor.inductance_h / motor.resistance_ohm;
    let periods = 1.0 / (rate_hz * electrical_s);
    let (prospect, verdict) = if periods <= 1.0 / GOOD_SAMPLES {
        (Prospect::Good, "the transient is sampled")
    } else if periods <= MOST_PERIODS {
        (
            Prospect::Weak,
            "only exact discretisation or output error sees it",
        )
    } else {
        (
            Prospect::NotObservable,
            "the transient is over between two samples: use burst capture",
        )
    };
    let load = match (forward, backward) {
        (true, true) => (Prospect::Good, "both directions part it from an offset"),
        (false, false) => (Prospect::NotObservable, "the shaft does not move"),
        _ => (
            Prospect::Weak,
            "one direction only: it cannot be parted from a constant load",
        ),
    };
    vec![
        by_share(MotorKey::Resistance, current_share, "the current"),
        Observability {
            key: MotorKey::Inductance.key(),
            prospect: if current_share >= ENOUGH {
                prospect
            } else {
                Prospect::NotObservable
            },
            reason: format!(
                "L/R {:.2} ms, period {:.2} ms: {verdict}",
                1e3 * electrical_s,
                1e3 / rate_hz
            ),
        },
        by_share(MotorKey::BackEmf, speed_share, "the speed"),
        by_share(MotorKey::Inertia, inertial_share, "the accelerating torque"),
        Observability {
            key: MotorKey::LoadTorque.key(),
            prospect: load.0,
            reason: load.1.to_owned(),
        },
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::bench_file::BenchFile;
    use crate::bench::plan::plan;
    use crate::bench::testing::Wave;
    use crate::sample::Demand;

    fn prospects(rate_hz: f64) -> Vec<Prospect> {
        let bench = BenchFile::embedded_default();
        let program = bench.program(1).unwrap();
        plan(
            &program,
            &bench.nameplate().unwrap(),
            &bench.limits(),
            rate_hz,
            None,
        )
        .unwrap()
        .parameters
        .iter()
        .map(|parameter| parameter.prospect)
        .collect()
    }

    #[test]
    fn the_inductance_depends_on_the_rate_and_the_rest_on_the_excitation() {
        use Prospect::{Good, NotObservable, Weak};
        assert_eq!(prospects(1000.0), [Good, Good, Good, Good, Good]);
        assert_eq!(prospects(100.0), [Good, Weak, Good, Good, Good]);
        assert_eq!(prospects(20.0)[1], NotObservable);
    }

    #[test]
    fn a_voltage_below_breakaway_shows_no_mechanics() {
        let bench = BenchFile::embedded_default();
        let program = Wave {
            duration_s: 1.0,
            demand: |_| Demand::Voltage(1.0),
        };
        let plan = plan(
            &program,
            &bench.nameplate().unwrap(),
            &bench.limits(),
            100.0,
            None,
        )
        .unwrap();
        for parameter in &plan.parameters[2..] {
            assert_eq!(parameter.prospect, Prospect::NotObservable, "{parameter:?}");
        }
    }
}
