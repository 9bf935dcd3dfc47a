//! System identification of a motor: recursive on line, batch over a record, with standard deviations and verdicts.
//!
//! ```text
//! samples, one by one --> online (recursive: schemes 2 and 3) ------------------+
//! Run (angle -> speed_from_angle) -> Scenario -+-> start -> output_error -------+-> ParameterEstimate
//!                                              +-> weak_form (both balances) ---+   (value, deviation, verdict)
//!                                              +-> inverse_dynamics (both) -----+
//!                                              +-> step_response (one step) ----+
//!                                              +-> noise: noise floor of the signals
//!
//! escalation: an unknown motor from small steps; nameplate: comparison of estimates with the nameplate
//! misfit: residual of the model over the noise, and the wider intervals that follow from it
//! scheme: all of these by name, as `identify --scheme` calls them
//! plateaus: estimates from steady states where the transients are too fast; cause: why a parameter has no value
//! physical: limits of a parameter from the record; first_order: the lag from voltage to speed
//! frequency_response: magnitude, phase and coherence; resonances with their damping
//! repeat, added_inertia: estimates from several runs; drift: the change between two dates
//! lost_rows: missing rows of a record; speed_lag: how much later than the angle a measured speed is
//! belief: whether signals and nameplates can be believed, for the live watch, the first pulse and all of the below
//! sanity: plausibility of the data, checked first; claims: limits of the verdicts by the origin of the signals, applied last
//! ```

pub mod added_inertia;
pub mod balance;
pub mod belief;
mod between_samples;
mod cause;
pub mod claims;
pub mod drift;
pub mod effect_start;
pub mod escalation;
pub mod first_order;
pub mod frequency_response;
pub mod inverse_dynamics;
pub mod kalman;
pub mod lost_rows;
pub mod misfit;
pub mod missing_cells;
pub mod nameplate;
pub mod noise;
pub mod online;
pub mod output_error;
pub mod physical;
mod plateaus;
pub mod recursive;
pub mod repeat;
pub mod sanity;
pub mod scheme;
pub mod scheme_1;
pub mod speed_from_angle;
pub mod speed_lag;
pub mod stamps;
pub mod start;
pub mod step_response;
pub mod temperature;
#[cfg(test)]
mod testing;
pub mod verdict;
pub mod voltage_departure;
pub mod weak_form;
pub mod winding_balance;
mod window_sums;
mod wrapped_angle;
