//! Mechanical balance over one block: `w_b - w_a = (Kt/J) int i - (Mc/J) s h`.

use crate::identification::verdict;
use crate::numerics::recursive_least_squares::{RecursiveLeastSquares, RowNoise};
use crate::plant::{MotorKey, Slot};
use crate::sample::ParameterEstimate;

/// Sizes of Kt/J, rad/(A.s^2), and Mc/J, rad/s^2, of a machine of some 100 W, and a prior wide enough for any other.
const SCALE: [f64; 2] = [100.0, 100.0];
const PRIOR: f64 = 1e8;
/// Rows below which nothing is said.
const FEWEST_ROWS: u64 = 4;

/// A torque constant with its standard deviation, N.m/A.
pub(super) type TorqueConstant = (f64, f64);

#[derive(Clone, Debug)]
pub(super) struct MechanicalBalance {
    estimator: RecursiveLeastSquares<2>,
    /// End of the last row taken: the next one shares its sample.
    last_end_s: f64,
    innovation_rad_s: Option<f64>,
    blocked_rows: u64,
}

/// One block between two samples.
#[derive(Clone, Copy, Debug)]
pub(super) struct MechanicalRow {
    pub(super) begin_s: f64,
    pub(super) end_s: f64,
    pub(super) speed_step_rad_s: f64,
    pub(super) current_integral_a_s: f64,
    /// Sign of the speed over the whole block; zero where it has none: the row is dropped.
    pub(super) direction: i8,
}

impl MechanicalBalance {
    pub(super) fn new(forgetting: f64) -> Self {
        Self {
            estimator: RecursiveLeastSquares::new([0.0; 2], SCALE, PRIOR, forgetting),
            last_end_s: f64::NAN,
            innovation_rad_s: None,
            blocked_rows: 0,
        }
    }

    pub(super) fn take(&mut self, row: &MechanicalRow) {
        self.innovation_rad_s = None;
        if row.direction == 0 {
            self.blocked_rows += 1;
            return;
        }
        let regressor = [
            row.current_integral_a_s,
            -f64::from(row.direction) * (row.end_s - row.begin_s),
        ];
        let noise = RowNoise {
            carry: 1.0,
            continues: row.begin_s.total_cmp(&self.last_end_s).is_eq(),
        };
        self.innovation_rad_s = self
            .estimator
            .update_row(&regressor, row.speed_step_rad_s, noise);
        self.last_end_s = row.end_s;
    }

    pub(super) fn innovation_rad_s(&self) -> Option<f64> {
        self.innovation_rad_s
    }

    /// Kt/J where the data carry it to this relative standard deviation, for the speed between samples.
    pub(super) fn acceleration_per_ampere(&self, uncertainty: f64) -> Option<f64> {
        let std = self.estimator.standard_deviations()?[0];
        let value = self.estimator.parameters()[0];
        (self.estimator.rows() > FEWEST_ROWS && value > 0.0 && std < uncertainty * value)
            .then_some(value)
    }

    /// Variance of one speed sample's error, (rad/s)^2.
    pub(super) fn noise_variance(&self) -> Option<f64> {
        self.estimator.noise_variance()
    }

    pub(super) fn ignorance(&self) -> [f64; 2] {
        [self.estimator.ignorance(0), self.estimator.ignorance(1)]
    }

    /// Inertia and load torque; `moved` is the largest speed so far and the dead zone, rad/s.
    pub(super) fn estimates(
        &self,
        torque: Option<TorqueConstant>,
        moved: (f64, f64),
        period_s: f64,
    ) -> Vec<ParameterEstimate> {
        let unknown = |reason: &str| -> Vec<ParameterEstimate> {
            [MotorKey::Inertia, MotorKey::LoadTorque]
                .iter()
                .map(|key| ParameterEstimate::not_observable(key.key(), key.unit(), reason))
                .collect()
        };
        if self.estimator.rows() < FEWEST_ROWS {
            return unknown(&format!(
                "{} usable rows, at least {FEWEST_ROWS} are needed: largest speed so far {:.2} rad/s, dead zone {:.2} rad/s, {} rows dropped inside it",
                self.estimator.rows(),
                moved.0,
                moved.1,
                self.blocked_rows
            ));
        }
        let Some((kt, kt_std)) = torque else {
            return unknown("the torque constant is not known yet");
        };
        let [a, b] = self.estimator.parameters();
        if a <= 0.0 {
            return unknown("the speed does not follow the current: no positive inertia fits");
        }
        let covariance = |row, column| self.estimator.covariance(row, column);
        let (inertia, load) = (kt / a, kt * b / a);
        let stds = (|| {
            let (aa, ab, bb) = (covariance(0, 0)?, covariance(0, 1)?, covariance(1, 1)?);
            let kt_share = (kt_std / kt).powi(2);
            let ratio = b / a;
            let inertia_std = inertia * (aa / (a * a) + kt_share).max(0.0).sqrt();
            let ratio_variance = (bb - 2.0 * ratio * ab + ratio * ratio * aa) / (a * a);
            let load_std = (kt * kt * ratio_variance + load * load * kt_share)
                .max(0.0)
                .sqrt();
            Some((inertia_std, load_std))
        })();
        vec![
            verdict::judge(
                &Slot::Motor(MotorKey::Inertia),
                inertia,
                stds.map(|s| s.0),
                period_s,
            ),
            verdict::judge(
                &Slot::Motor(MotorKey::LoadTorque),
                load,
                stds.map(|s| s.1),
                period_s,
            ),
        ]
    }
}
