//! Parameters from data: recursive on line, batch afterwards, with honest uncertainty.
//!
//! ```text
//! samples, one by one --> online (recursive: schemes 2 and 3) ------------------+
//! Run (angle -> speed_from_angle) -> Scenario -+-> start -> output_error -------+-> ParameterEstimate
//!                                              +-> weak_form (both balances) ---+   (value, deviation, verdict)
//!                                              +-> noise: the floor below which nothing can be seen
//!
//! escalation: an unknown motor from small steps; nameplate: whether what was found fits what is printed on it
//! scheme: all of these by name, as `identify --scheme` calls them
//! repeat, added_inertia: what several runs say together
//! ```

pub mod added_inertia;
pub mod escalation;
pub mod nameplate;
pub mod noise;
pub mod online;
pub mod output_error;
pub mod recursive;
pub mod repeat;
pub mod scheme;
pub mod speed_from_angle;
pub mod start;
mod verdict;
pub mod weak_form;
