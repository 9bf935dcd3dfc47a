//! The rows of training, hold-out and confirming run, and the scale of the errors.

use super::Settings;
use super::regression::{self, BalanceFit, OnTrial};
use super::score::Score;
use super::terms::Extra;
use crate::diagnosis::evidence::{Evidence, HoldoutFrom};
use crate::identification::noise::{FloorSource, NoiseFloor};
use crate::identification::output_error::FitError;
use crate::identification::torque_rows::{Method, TorqueRows};
use crate::identification::{inverse_dynamics, weak_form};
use crate::plant::{Input, Model, ModelError, MotorKey, Scenario};

/// Rows below which a balance is not fitted.
const FEWEST_ROWS: usize = 30;

/// One processing of all runs.
pub(super) struct Sides {
    pub(super) training: TorqueRows,
    pub(super) holdout: TorqueRows,
    pub(super) confirm: Option<TorqueRows>,
    /// The whole run where it was split: what figures in the literature are of.
    pub(super) whole: Option<TorqueRows>,
    pub(super) settings: Settings,
}

impl Sides {
    /// The weak form, which decides.
    pub(super) fn weak_form(
        model: &Model,
        evidence: &Evidence,
        settings: Settings,
    ) -> Result<Self, FitError> {
        let by_current = evidence.training.input != Input::Torque;
        if by_current && model.motor.torque_constant().is_none() {
            let key = MotorKey::TorqueConstant.key().to_owned();
            return Err(ModelError::Unset { key }.into());
        }
        Self::new(Method::WeakForm, model, evidence, settings)
    }

    pub(super) fn new(
        method: Method,
        model: &Model,
        evidence: &Evidence,
        settings: Settings,
    ) -> Result<Self, FitError> {
        let rows = |scenario: &Scenario| {
            let rows = match method {
                Method::WeakForm => weak_form::torque_rows(model, scenario, settings.filter),
                Method::InverseDynamics => {
                    inverse_dynamics::torque_rows(model, scenario, settings.filter)
                }
            };
            let found = rows.as_ref().map_or(0, TorqueRows::rows);
            rows.filter(|rows| rows.rows() >= FEWEST_ROWS)
                .ok_or_else(|| FitError::NoTorqueBalance {
                    run: scenario.name.clone(),
                    rows: found,
                    needed: FEWEST_ROWS,
                })
        };
        let whole = (evidence.holdout_from == HoldoutFrom::Split).then(|| Scenario {
            scored: 0..evidence.holdout.samples(),
            ..evidence.holdout.clone()
        });
        Ok(Self {
            whole: whole.as_ref().map(rows).transpose()?,
            training: rows(&evidence.training)?,
            holdout: rows(&evidence.holdout)?,
            confirm: evidence.confirm.as_ref().map(rows).transpose()?,
            settings,
        })
    }

    pub(super) fn fit(&self, model: &Model) -> Option<BalanceFit> {
        regression::fit(model, OnTrial::default(), &self.training)
    }

    /// The fitted balance on the hold-out; only times of events are found anew.
    pub(super) fn held_out(&self, fit: &BalanceFit, extra: Option<&Extra>) -> Score {
        Self::score(fit, extra, &self.holdout)
    }

    pub(super) fn score(fit: &BalanceFit, extra: Option<&Extra>, rows: &TorqueRows) -> Score {
        let model = super::trial::with_events_of(&fit.model, rows);
        let extra = extra.zip(fit.extra.map(|(size, _)| size));
        Score::of(&regression::predicted(&model, extra, rows), rows)
    }
}

/// In what the errors are counted.
#[derive(Clone, Copy, Debug)]
pub(super) struct Scale {
    /// N.m that count as one.
    pub(super) unit_n_m: f64,
    pub(super) source: FloorSource,
}

impl Scale {
    /// What the noise of the leading standstill would leave in a row (DISCOVERY.md 2.9), else the error of the refitted
    /// baseline.
    pub(super) fn of(
        model: &Model,
        scenario: &Scenario,
        rows: &TorqueRows,
        baseline: &BalanceFit,
    ) -> Self {
        standstill_floor(model, scenario, rows, baseline).map_or(
            Self {
                unit_n_m: baseline.rms().max(f64::MIN_POSITIVE),
                source: FloorSource::None,
            },
            |unit_n_m| Self {
                unit_n_m,
                source: FloorSource::Standstill,
            },
        )
    }

    /// The floor in units of the scale: nothing is known to be below it where it is not known.
    pub(super) fn floor(&self) -> f64 {
        if self.source == FloorSource::None {
            0.0
        } else {
            1.0
        }
    }

    pub(super) fn of_noise(&self, noise: &NoiseFloor) -> NoiseFloor {
        NoiseFloor {
            source: self.source,
            ..*noise
        }
    }
}

/// Noise of torque (or current) and of speed over the standstill, through the weights of a window.
fn standstill_floor(
    model: &Model,
    scenario: &Scenario,
    rows: &TorqueRows,
    baseline: &BalanceFit,
) -> Option<f64> {
    let still = NoiseFloor::from_standstill(scenario)?;
    let rest = scenario.leading_standstill();
    let driving: Vec<f64> = if scenario.input == Input::Torque {
        let end_s = *scenario.sample_time_s.get(rest.end.checked_sub(1)?)?;
        let within = scenario.events.iter().take_while(|event| event.0 <= end_s);
        within.map(|event| event.1).collect()
    } else {
        let kt = model.motor.torque_constant()?;
        let currents = &scenario.current_a[rest];
        currents.iter().map(|current| kt * current).collect()
    };
    let driving: Vec<f64> = driving.into_iter().filter(|v| v.is_finite()).collect();
    let torque = crate::numerics::statistics::variance(&driving)
        .max(0.0)
        .sqrt();
    let torque = if torque.is_finite() { torque } else { 0.0 };
    let inertia = baseline.model.motor.get(MotorKey::Inertia)?;
    let floor = (torque * rows.gain).hypot(inertia * still.speed_rad_s * rows.rate_gain);
    (floor.is_finite() && floor > 0.0).then_some(floor)
}
