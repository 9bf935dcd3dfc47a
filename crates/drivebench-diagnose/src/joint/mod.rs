//! Spike-and-slab variable selection (George and McCulloch, Variable selection via Gibbs sampling, J. Am. Stat. Assoc. 88, 1993)
//! over a model that is linearised along a Kalman filter and refined by Gauss-Newton: the posterior over all sets of effects.
//!
//! ```text
//! model, run --(kalman: filter; run: linearised run)--> innovations, gains
//! (torque_balance: the same of a run that a torque or a current drives, along its measured motion)
//!                 |-> columns   regressors: change of the whitened innovations by each effect at its slab size
//!                 |             (nuisances: parameters that are always included; tangent: forward sensitivities, eight at a
//!                 |             time; screening: which forms get a column; whitened: storage and products of columns)
//!                 |-> noise     disturbance and sensor noise by maximum marginal likelihood, all effects included at slab width
//!                 '-> select    posterior over the sets of effects and forms
//! eligible:      which effects a run can judge, and which of its rows are used
//! process_noise: terms of the effects at an instant, and the process noise by errors of their forms
//! events:        effects that begin at an unknown time in one run
//! solution:      model at the posterior mean of a set;  prediction_error: Gauss-Newton refit of it
//! refits:        tests of the linear solution by refits;  stepwise: forward selection far from the data
//! search:        rounds of linearisation, selection and refit until set and noise are stable
//! residuals:     residual of the final set: excess over white noise, share of unknown curves
//! free_run:      part of a free-run error that no model predicts, excess of innovations, likelihood ratio test
//! expected_information: information about each effect if one more run were recorded
//! detectability: posterior deviation and smallest detectable size of an effect
//! rivals:        confounded effects
//! marginal:      probability, bound and detectable size of one effect;  answer: of all effects and unknown curves
//! ```

pub(super) mod answer;
mod columns;
mod detectability;
pub(super) mod eligible;
pub(super) mod events;
pub(super) mod expected_information;
pub(super) mod free_run;
mod grid;
mod kalman;
pub(super) mod marginal;
mod memory;
mod noise;
mod nuisances;
mod prediction_error;
mod process_noise;
mod refits;
mod regression;
mod residuals;
mod rivals;
mod run;
mod screening;
mod search;
mod select;
mod solution;
mod stepwise;
mod tangent;
mod torque_balance;
mod whitened;

pub(super) use kalman::Noise;
pub(super) use prediction_error::motor_constants;
