//! Parameters from data: recursive on line, batch afterwards, with honest uncertainty.
//!
//! ```text
//! samples, one by one --> online (recursive: schemes 2 and 3) ------------------+
//! Run (angle -> speed_from_angle) -> Scenario -+-> start -> output_error -------+-> ParameterEstimate
//!                                              +-> weak_form (both balances) ---+   (value, deviation, verdict)
//!                                              +-> inverse_dynamics (both) -----+
//!                                              +-> step_response (one step) ----+
//!                                              +-> noise: the floor below which no error shows
//!
//! escalation: an unknown motor from small steps; nameplate: whether what was found fits what is printed on it
//! misfit: what the model leaves beside the noise, and how much wider that makes its intervals
//! scheme: all of these by name, as `identify --scheme` calls them
//! plateaus: estimates from held levels where the transients are too fast; cause: why a parameter has no value
//! physical: what a record allows a value to be; first_order: the lag that voltage and speed alone show
//! frequency_response: magnitude, phase and coherence; resonances with their damping
//! repeat, added_inertia: estimates from several runs; drift: the change between two dates
//! lost_rows: sentence on the missing rows of a record
//! sanity: faults of the data, checked first; claims: limits of the verdicts by the origin of the signals, applied last
//! ```

pub mod added_inertia;
pub mod balance;
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
pub mod stamps;
pub mod start;
pub mod step_response;
pub mod temperature;
#[cfg(test)]
mod testing;
pub mod verdict;
pub mod voltage_departure;
pub mod weak_form;
mod window_sums;
mod wrapped_angle;
