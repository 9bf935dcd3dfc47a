//! The rows of training, hold-out and confirming run, and the scale of the errors.

use super::regression::{self, BalanceFit};
use crate::diagnosis::evidence::{Evidence, HoldoutFrom};
use crate::diagnosis::fitted::Fitted;
use crate::diagnosis::score::Score;
use crate::identification::noise::{FloorSource, NoiseFloor};
use crate::identification::output_error::FitError;
use crate::identification::torque_rows::{Method, TorqueRows};
use crate::identification::{inverse_dynamics, weak_form};
use crate::plant::{Input, Model, ModelError, MotorKey, Scenario, State};

/// Rows below which a balance is not fitted.
const FEWEST_ROWS: usize = 30;

/// One processing of all runs.
pub(in crate::diagnosis) struct Sides {
    pub(in crate::diagnosis) training: TorqueRows,
    pub(in crate::diagnosis) holdout: TorqueRows,
    pub(in crate::diagnosis) confirm: Option<TorqueRows>,
    /// The whole run where it was split: what figures in the literature are of.
    pub(super) whole: Option<TorqueRows>,
}

impl Sides {
    /// The weak form, which decides.
    pub(super) fn weak_form(model: &Model, evidence: &Evidence) -> Result<Self, FitError> {
        let by_current = evidence.training.input != Input::Torque;
        if by_current && model.motor.torque_constant().is_none() {
            let key = MotorKey::TorqueConstant.key().to_owned();
            return Err(ModelError::Unset { key }.into());
        }
        Self::new(Method::WeakForm, model, evidence)
    }

    pub(super) fn new(
        method: Method,
        model: &Model,
        evidence: &Evidence,
    ) -> Result<Self, FitError> {
        let rows = |scenario: &Scenario| {
            let rows = match method {
                Method::WeakForm => weak_form::torque_rows(model, scenario),
                Method::InverseDynamics => inverse_dynamics::torque_rows(model, scenario),
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
        })
    }

    pub(in crate::diagnosis) fn fit(&self, model: &Model) -> Option<BalanceFit> {
        regression::fit(model, &self.training)
    }
}

/// The balance of torques of all runs, and in what its errors are counted.
pub(in crate::diagnosis) struct Balance {
    pub(in crate::diagnosis) sides: Sides,
    pub(in crate::diagnosis) scale: Scale,
}

impl Balance {
    /// With the refitted baseline.
    pub(in crate::diagnosis) fn with_baseline(
        model: &Model,
        evidence: &Evidence,
    ) -> Result<(Self, BalanceFit), FitError> {
        let sides = Sides::weak_form(model, evidence)?;
        let baseline = sides.fit(model).ok_or_else(|| FitError::CannotSimulate {
            run: evidence.training.name.clone(),
        })?;
        let scale = Scale::of(model, &evidence.training, &sides.training, &baseline);
        Ok((Self { sides, scale }, baseline))
    }

    /// A complete model on these rows; only times of events are found anew.
    pub(in crate::diagnosis) fn score(&self, model: &Model, rows: &TorqueRows) -> Score {
        let model = regression::with_events_of(model, rows);
        let predicted = regression::predicted(&model, rows);
        Score::of_balance(rows, &predicted, self.scale.unit_n_m)
    }

    pub(in crate::diagnosis) fn fitted(&self, fit: &BalanceFit, evidence: &Evidence) -> Fitted {
        let speeds = &evidence.training.speed_rad_s;
        let first = speeds.iter().copied().find(|speed| speed.is_finite());
        Fitted {
            model: fit.model.clone(),
            parameters: fit.parameters.clone(),
            nrms: fit.rms() / self.scale.unit_n_m,
            noise: NoiseFloor {
                source: self.scale.source,
                ..evidence.noise
            },
            interval_factor: 1.0,
            start: State::at(0.0, first.unwrap_or(0.0)),
        }
    }
}

/// In what the errors are counted.
#[derive(Clone, Copy, Debug)]
pub(in crate::diagnosis) struct Scale {
    /// N.m that count as one.
    pub(in crate::diagnosis) unit_n_m: f64,
    pub(in crate::diagnosis) source: FloorSource,
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
