//! What scheme 3 may say of each parameter.

use super::{KEYS, START_ROWS, START_UNCERTAINTY, Scheme3, TRIAL_ROWS, Trial};
use crate::identification::verdict;
use crate::plant::{MotorKey, Slot};
use crate::sample::{ParameterEstimate, Verdict};

/// Share of the prior variance above which a parameter counts as not excited.
const IGNORANT: f64 = 0.3;
/// Root mean square of the normalised innovation over the last rows above which nothing is settled.
const LARGEST_MISFIT: f64 = 3.0;
/// Relative standard deviation of the resistance from which on that estimate is trusted.
const CERTAIN_RATIO: f64 = 0.01;

impl Scheme3 {
    /// How far the data carry R, L, Ke, Kt/J, Mc/J: 0 nothing learnt, 1 learnt.
    pub fn excitation(&self) -> [f64; 5] {
        let electrical = self.electrical().map_or([1.0; 3], |estimator| {
            [0, 1, 2].map(|j| estimator.ignorance(j))
        });
        let [a, b] = self.balance.ignorance();
        let [r, l, ke] = electrical;
        [r, l, ke, a, b].map(|ignorance| (1.0 - ignorance).clamp(0.0, 1.0))
    }

    /// Standard deviation of the speed at standstill, rad/s, where there was one.
    pub fn speed_noise_rad_s(&self) -> Option<f64> {
        self.speed_at_rest.deviation()
    }

    /// Torque constant and its standard deviation: the given one, else the back-EMF constant.
    pub fn torque_constant(&self) -> Option<(f64, f64)> {
        if let Some(given) = self.torque_n_m_per_a {
            return Some((given, 0.0));
        }
        let estimator = self.electrical()?;
        let (value, std) = (
            estimator.parameters()[2],
            estimator.standard_deviations()?[2],
        );
        (estimator.ignorance(2) < IGNORANT && value > 0.0).then_some((value, std))
    }

    /// R, L, Ke, J, Mc with verdicts.
    pub fn estimates(&self) -> Vec<ParameterEstimate> {
        let mut out = self.electrical_estimates();
        if let Some(reason) = self.on_trial() {
            let keys = [MotorKey::Inertia, MotorKey::LoadTorque];
            out.extend(keys.map(|key| {
                ParameterEstimate::not_observable(key.key(), key.unit(), reason.clone())
            }));
            return out;
        }
        out.extend(self.balance.estimates(
            self.torque_constant(),
            (
                self.direction.largest_rad_s(),
                self.direction.dead_zone_rad_s(),
            ),
            self.period_s,
            [0.0; 2],
        ));
        let doubt = if self.limited {
            Some("stands still: a limit of the drive holds its output, so that the motor has another voltage than was commanded".to_owned())
        } else {
            self.misfit().map(|times| {
                format!(
                    "the measured current misses the prediction by {times:.1} times its noise: \
                     an effect is missing, a signal is wrong, or the estimate went astray"
                )
            })
        };
        // One voltage is shared by R and Ke, and the current between two samples is theirs: without R nothing is sure.
        let resistance = out.iter().find(|p| p.key == MotorKey::Resistance.key());
        let open = resistance.is_none_or(|resistance| resistance.verdict != Verdict::Settled);
        let doubt = doubt.or_else(|| {
            open.then(|| {
                "rests on the resistance, which the run does not settle: it takes a current that changes at every speed"
                    .to_owned()
            })
        });
        if let Some(reason) = doubt {
            for parameter in out.iter_mut().filter(|p| p.verdict == Verdict::Settled) {
                parameter.verdict = Verdict::Searching;
                parameter.reason = Some(reason.clone());
            }
        }
        out
    }

    /// How many times its noise the current misses the prediction by, where that is no chance.
    fn misfit(&self) -> Option<f64> {
        self.current_noise_a()?;
        let times = self.best()?.misfit().sqrt();
        (times > LARGEST_MISFIT).then_some(times)
    }

    /// Why the integral of the current between samples is not known yet, once the shaft has moved.
    fn on_trial(&self) -> Option<String> {
        let moved = self.direction.largest_rad_s() > self.direction.dead_zone_rad_s();
        let rows = match self.trial {
            Trial::Waiting => self.starting.as_ref()?.rows().to_string(),
            Trial::On(rows) => format!("{rows} of the {TRIAL_ROWS} or more of a trial"),
            Trial::Over => return None,
        };
        moved.then(|| {
            format!(
                "the current between two samples ({:.1} ms) is not known before R, L and Ke are: {rows} rows so far",
                1e3 * self.period_s
            )
        })
    }

    fn electrical_estimates(&self) -> Vec<ParameterEstimate> {
        let Some(estimator) = self.electrical() else {
            return Vec::new();
        };
        let starting = self.tracks.is_empty();
        let values = estimator.parameters();
        let stds = estimator
            .standard_deviations()
            .filter(|_| estimator.rows() >= START_ROWS);
        let certain = |j: usize| {
            estimator.ignorance(j) < IGNORANT
                && stds.is_some_and(|stds| stds[j] < START_UNCERTAINTY * values[j])
        };
        // In steady state the noise of the current passes for its excitation and R and Ke share one voltage: neither
        // may be told from the linear start without the other.
        let moved = self.direction.largest_rad_s() > self.direction.dead_zone_rad_s();
        let confounded = starting && moved && !(certain(0) && certain(2));
        (0..3)
            .map(|j| {
                let key = KEYS[j];
                let excited = estimator.ignorance(j) < IGNORANT && values[j] > 0.0 && !confounded;
                let Some(stds) = stds.filter(|_| excited) else {
                    let reason = self.why_not(key, estimator.rows());
                    return ParameterEstimate::not_observable(key.key(), key.unit(), reason);
                };
                let time_constant_s = values[1] / values[0];
                // Early on the ratio itself is not known well enough to say so.
                let known = !starting && stds[0] < CERTAIN_RATIO * values[0];
                let gone = self.is_gone(&values);
                if key == MotorKey::Inductance && known && gone {
                    // What is left of the transient between two samples is below the noise of everything else.
                    let reason = format!(
                        "L/R = {:.1} ms or less against a period of {:.1} ms; sample faster, or use burst capture",
                        1e3 * time_constant_s,
                        1e3 * self.period_s
                    );
                    return ParameterEstimate::not_observable(key.key(), key.unit(), reason);
                }
                let slot = Slot::Motor(key);
                let mut judged = verdict::judge(&slot, values[j], Some(stds[j]), self.period_s);
                if starting && judged.verdict == Verdict::Settled {
                    judged.verdict = Verdict::Searching;
                    judged.reason = Some("from the linear start: biased by coarse sampling".into());
                } else if let (Trial::On(rows), Verdict::Settled) = (self.trial, judged.verdict) {
                    judged.verdict = Verdict::Searching;
                    judged.reason = Some(format!(
                        "{rows} rows since the linear start, linearised again after {TRIAL_ROWS}"
                    ));
                }
                judged
            })
            .collect()
    }

    fn why_not(&self, key: MotorKey, rows: u64) -> String {
        let current = self.largest_current_a;
        let speed = self.direction.largest_rad_s();
        let zone = self.direction.dead_zone_rad_s();
        if self.voltage.is_empty() {
            return "no voltage command seen yet".into();
        }
        if rows < START_ROWS {
            return format!("{rows} rows so far, at least {START_ROWS} are needed");
        }
        if key == MotorKey::BackEmf && speed <= zone {
            return format!(
                "not moved yet: largest speed {speed:.2} rad/s, dead zone {zone:.2} rad/s"
            );
        }
        if key == MotorKey::Inductance {
            let period_ms = 1e3 * self.period_s;
            return self.winding().map_or_else(
                || format!("the current does not change enough at a period of {period_ms:.1} ms (largest {current:.2} A)"),
                |[r, l, _]| format!(
                    "the current does not change enough: period {period_ms:.1} ms, L/R about {:.1} ms",
                    1e3 * l / r
                ),
            );
        }
        format!("not excited: largest current {current:.2} A, largest speed {speed:.2} rad/s")
    }
}
