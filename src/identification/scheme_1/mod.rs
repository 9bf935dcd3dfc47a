//! Scheme 1 of paper A: voltage and speed give L/R, TM, Ke, and with a known resistance J and Mc.
//!
//! ```text
//! (voltage of an interval, speed at its end, direction) -> rows -> recursive least squares -> Coefficients
//!                                                            |                                     | Form::Printed, eq. (17)
//!                                                            |                                     v Form::Exact, eq. (13)
//!                                                            +--> instrumental variables ------> Dynamics --(R, Kt)--> Scheme1Values
//!                                                                  (auxiliary model, batch)            estimates: deviation, verdict
//! ```
//!
//! What each is good for: the printed form needs T << L/R and T << TM; the exact form needs neither. Both are least
//! squares on a measured speed, so noise of the sensor biases them, the more the faster the sampling. The instrumental
//! variables are free of that bias over a whole run; over a short memory (some tens of samples) they scatter too much.

mod compensated;
mod estimates;
mod instrumental;
mod inverse;
mod recursive;
mod rows;

pub use compensated::{Noise, noise_free};
pub(in crate::identification) use estimates::all_unknown;
pub use estimates::{Claim, Doubt, estimates};
pub use instrumental::{Instrumental, InstrumentalError, Series, instrumental_variables};
pub use inverse::{Coefficients, Dynamics, Form, Scheme1Rejection, Scheme1Values};
pub use recursive::Scheme1;

#[cfg(test)]
mod tests;
