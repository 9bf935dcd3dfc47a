//! Mechanical balance over one block: `w_b - w_a = (Kt/J) int i - (Mc/J) s h`.

use super::Direction;
use crate::verdict;
use drivebench_model::numerics::change_watch::ChangeWatch;
use drivebench_model::numerics::recursive_least_squares::{RecursiveLeastSquares, RowNoise};
use drivebench_model::plant::{MotorKey, Slot};
use drivebench_model::sample::{ParameterEstimate, Reason, Verdict};

/// Rows below which there is no estimate.
const FEWEST_ROWS: u64 = 4;

/// Estimators with a common forgetting factor.
#[derive(Clone, Debug)]
struct Fits {
    estimator: RecursiveLeastSquares<2>,
    /// The same with the integral of the current off by its uncertainty.
    doubtful: RecursiveLeastSquares<2>,
    /// The same with a viscous friction over J as a third parameter: tests whether the load is constant.
    sloping: RecursiveLeastSquares<3>,
}

impl Fits {
    fn new(forgetting: f64) -> Self {
        // Sizes of a machine of some 100 W, and a prior wide enough for any other.
        let estimator =
            RecursiveLeastSquares::new([0.0; 2], [100.0; 2], 1e8, forgetting).clustered();
        let scale = [100.0, 100.0, 1.0];
        Self {
            doubtful: estimator.clone(),
            estimator,
            sloping: RecursiveLeastSquares::new([0.0; 3], scale, 1e8, forgetting).clustered(),
        }
    }
}

#[derive(Clone, Debug)]
pub(super) struct MechanicalBalance {
    fits: Fits,
    /// End of the last row taken: the next one shares its sample.
    last_end_s: f64,
    innovation_rad_s: Option<f64>,
    blocked_rows: u64,
    watch: ChangeWatch,
    /// Restarts after a change of the inertia.
    changes: u32,
    forgetting: f64,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct MechanicalRow {
    pub(super) begin_s: f64,
    pub(super) end_s: f64,
    pub(super) speed_step_rad_s: f64,
    pub(super) current_integral_a_s: f64,
    /// The same with the inputs off by one standard deviation.
    pub(super) doubtful_integral_a_s: f64,
    /// Sign of the speed over the whole block; zero where it has none: the row is dropped.
    pub(super) direction: i8,
    /// Mean of the speeds at its ends, rad/s.
    pub(super) speed_rad_s: f64,
    /// Share of the noise of the begin in that of the row, see [`carry`].
    pub(super) carry: f64,
}

/// The noise of a row as `e_end - carry e_begin` with white `e`: `charge_noise` is that of `(Kt/J) h` times a current
/// sample over that of a speed sample, `n` the intervals between samples of a row.
///
/// Alone, the noise of the speed gives 1. Each end's current counts half in both rows that share it, with equal signs.
pub(super) fn carry(charge_noise: f64, n: f64) -> f64 {
    let one = (charge_noise / n).powi(2);
    let power = 2.0 + one * (n - 0.5);
    let shared = 1.0 - 0.25 * one;
    let k = shared / power;
    2.0 * k / (1.0 + (1.0 - 4.0 * k * k).max(0.0).sqrt())
}

impl MechanicalBalance {
    pub(super) fn new(forgetting: f64) -> Self {
        Self {
            fits: Fits::new(forgetting),
            last_end_s: f64::NAN,
            innovation_rad_s: None,
            blocked_rows: 0,
            // Misses of 15 % of the moves of the last rows: more than what a missing effect makes of them.
            watch: ChangeWatch::new(0.15, 0.0),
            changes: 0,
            forgetting,
        }
    }

    pub(super) fn take(&mut self, row: &MechanicalRow) {
        self.innovation_rad_s = None;
        if row.direction == 0 {
            self.blocked_rows += 1;
            self.watch.interrupt();
            return;
        }
        let held = -f64::from(row.direction) * (row.end_s - row.begin_s);
        let noise = RowNoise {
            carry: row.carry,
            continues: row.begin_s.total_cmp(&self.last_end_s).is_eq(),
        };
        let step = row.speed_step_rad_s;
        let regressor = [row.current_integral_a_s, held];
        self.watch_inertia(&regressor, step, noise.continues);
        let along = [regressor[0], held, held * row.speed_rad_s.abs()];
        self.fits.sloping.update_row(&along, step, noise);
        self.innovation_rad_s = self.fits.estimator.update_row(&regressor, step, noise);
        self.fits.doubtful.update_row(&[row.doubtful_integral_a_s, held], step, noise);
        self.last_end_s = row.end_s;
    }

    /// Another inertia shows where the motor's torque is large against the friction. A miss of a shaft that runs out, or
    /// that creeps, is one of the friction, which may be of another form than this one's: it changes with the speed and
    /// comes back, and what is known is not dropped for it.
    fn watch_inertia(&mut self, regressor: &[f64; 2], step_rad_s: f64, continues: bool) {
        let [a, b] = self.fits.estimator.parameters();
        let (driven, braked) = (a * regressor[0], b * regressor[1]);
        let tells = driven.abs() > 3.0 * braked.abs();
        if !continues || !tells {
            self.watch.interrupt();
        }
        let is_founded = self.fits.estimator.rows() >= 40;
        if tells && self.watch.take(driven + braked, step_rad_s, is_founded) {
            self.fits = Fits::new(self.forgetting);
            self.watch.interrupt();
            self.changes += 1;
        }
    }

    /// Why no value may be settled now although the rows agree.
    fn reopened(&self) -> Option<(Reason, String)> {
        let rows = self.fits.estimator.rows();
        let needed = 60;
        (self.changes > 0 && rows < needed).then(|| {
            let so_far = format!("begun again, {rows} of {needed} rows so far");
            (Reason::InertiaChanged, format!("the inertia has changed: {so_far}"))
        })
    }

    /// Why inertia or load may not be settled although the rows agree: with a friction that grows with the speed it would be
    /// another, and the rows do not rule such a friction out. `value` is the one of the two, its place in the rows `at`.
    fn not_constant(&self, value: f64, at: usize) -> Option<(Reason, String)> {
        let [a, b, _] = self.fits.sloping.parameters();
        let (sloping, of) = [(a, value), (b / a, value * a)][at];
        let std = self.fits.sloping.standard_deviations()?[at];
        let doubt = (sloping / value - 1.0).abs() + 2.0 * std / of.abs();
        // A comparison that is false for NaN as well.
        let sure = doubt <= 0.06;
        (!sure).then(|| {
            let reason = format!(
                "a friction that grows with the speed, which these speeds do not rule out, would change it by up to {:.0} %",
                (100.0 * doubt).min(100.0)
            );
            (Reason::ModelMisses, reason)
        })
    }

    /// By how much Kt/J, relative, and Mc/Kt, A, are off because a friction that grows with the speed is there; zero where
    /// the rows do not separate it from none. `ratio` is Mc/Kt.
    fn slope_bias(&self, ratio: f64) -> [f64; 2] {
        let [a, b, slope] = self.fits.sloping.parameters();
        // Where there is none, what is widened by it stays as narrow as it was.
        let significant = (self.fits.sloping.standard_deviations())
            .is_some_and(|stds| slope.abs() > 4.0 * stds[2]);
        if !significant {
            return [0.0; 2];
        }
        let known = self.fits.estimator.parameters()[0];
        [(a / known - 1.0).abs(), (b / a - ratio).abs()]
    }

    pub(super) fn innovation_rad_s(&self) -> Option<f64> {
        self.innovation_rad_s
    }

    /// Present Kt/J and its standard deviation, rad/(A.s^2).
    pub(super) fn acceleration_with_std(&self) -> Option<(f64, f64)> {
        let std = self.fits.estimator.standard_deviations()?[0];
        let value = self.fits.estimator.parameters()[0];
        (self.fits.estimator.rows() > FEWEST_ROWS).then_some((value, std))
    }

    pub(super) fn noise_variance(&self) -> Option<f64> {
        self.fits.estimator.noise_variance()
    }

    /// Kt/J and Mc/J once there are enough rows.
    pub(super) fn values(&self) -> Option<[f64; 2]> {
        let [a, b] = self.fits.estimator.parameters();
        (self.fits.estimator.rows() >= FEWEST_ROWS && a > 0.0).then_some([a, b])
    }

    pub(super) fn set_forgetting(&mut self, forgetting: f64) {
        self.fits.estimator.set_forgetting(forgetting);
        self.fits.doubtful.set_forgetting(forgetting);
        self.fits.sloping.set_forgetting(forgetting);
        self.forgetting = forgetting;
    }

    pub(super) fn variance_ratio(&self) -> [f64; 2] {
        [0, 1].map(|j| self.fits.estimator.variance_ratio(j))
    }

    /// Inertia and load torque from the torque constant, N.m/A, with its standard deviation. `moved` has the largest speed
    /// so far and the dead zone; `sampling` is the relative error of J and the error of Mc/Kt, A, that coarse sampling leaves.
    pub(super) fn estimates(
        &self,
        torque: Option<(f64, f64)>,
        moved: &Direction,
        period_s: f64,
        sampling: [f64; 2],
    ) -> Vec<ParameterEstimate> {
        let unknown = |code: Reason, reason: &str| -> Vec<ParameterEstimate> {
            let keys = [MotorKey::Inertia, MotorKey::LoadTorque];
            keys.map(|key| verdict::unknown(key, code, reason)).to_vec()
        };
        if self.fits.estimator.rows() < FEWEST_ROWS {
            return unknown(
                Reason::TooFewRows,
                &format!(
                    "{} usable rows, at least {FEWEST_ROWS} are needed: largest speed so far {:.2} rad/s, dead zone {:.2} rad/s, {} rows dropped inside it",
                    self.fits.estimator.rows(),
                    moved.largest_rad_s,
                    moved.dead_zone_rad_s(),
                    self.blocked_rows
                ),
            );
        }
        let Some((kt, kt_std)) = torque else {
            let reason = "the torque constant is not known yet";
            return unknown(Reason::DependsOnAnother, reason);
        };
        let [a, b] = self.fits.estimator.parameters();
        if a <= 0.0 {
            let reason = "the speed does not follow the current: no positive inertia fits";
            return unknown(Reason::Impossible, reason);
        }
        let covariance = |row, column| self.fits.estimator.covariance(row, column);
        let (inertia, load) = (kt / a, kt * b / a);
        let stds = (|| {
            let (aa, ab, bb) = (covariance(0, 0)?, covariance(0, 1)?, covariance(1, 1)?);
            let kt_share = (kt_std / kt).powi(2);
            let ratio = b / a;
            let [other_a, other_b] = self.fits.doubtful.parameters();
            let [inertia_bias, load_bias] = self.slope_bias(ratio);
            let inertia_doubt = (inertia * (other_a / a - 1.0))
                .hypot(inertia * sampling[0])
                .hypot(inertia * inertia_bias);
            let load_doubt = (kt * (other_b / other_a - ratio)).hypot(kt * sampling[1]);
            let inertia_std =
                (inertia * (aa / (a * a) + kt_share).max(0.0).sqrt()).hypot(inertia_doubt);
            let ratio_variance = (bb - 2.0 * ratio * ab + ratio * ratio * aa) / (a * a);
            let load_std = (kt * kt * ratio_variance + load * load * kt_share).max(0.0).sqrt();
            let load_std = load_std.hypot(load_doubt).hypot(kt * load_bias);
            Some((inertia_std, load_std))
        })();
        let load_doubt = kt * sampling[1] / load.abs().max(f64::MIN_POSITIVE);
        let found = [
            (MotorKey::Inertia, inertia, stds.map(|s| s.0), sampling[0]),
            (MotorKey::LoadTorque, load, stds.map(|s| s.1), load_doubt),
        ];
        found
            .into_iter()
            .map(|(key, value, std, doubt)| {
                let mut judged = verdict::judge(&Slot::Motor(key), value, std, period_s);
                let most = std.is_some_and(|std| doubt * value.abs() > std / 2f64.sqrt());
                if most && judged.value.is_some() {
                    // A bound on a systematic error does not settle the value.
                    judged.set(Verdict::Searching, Reason::SampledTooSlowly, format!(
                        "the current between samples ({:.1} ms apart) is not known: an error of about {:.1} %, by what \
                         every second sample gives; sample faster, or use scheme 3",
                        1e3 * period_s,
                        100.0 * doubt
                    ));
                }
                let (fitted, at) = if key == MotorKey::Inertia { (a, 0) } else { (b / a, 1) };
                let why_open = self.reopened().or_else(|| self.not_constant(fitted, at));
                if let Some((code, reason)) = why_open {
                    judged.unsettle(code, reason);
                }
                judged
            })
            .collect()
    }
}
