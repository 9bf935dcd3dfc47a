//! Whether signals and nameplates can be believed: fault detection by parity equations (Isermann, Fault-Diagnosis Systems,
//! 2006, ch. 10).
//!
//! ```text
//! voltage   u    = R i + L di/dt + Ke w        torque   Kt i = J dw/dt + Mc sign(w)        Kt = Ke
//!
//! live watch    last cycles, as ranges -------> Window: fits | misfits -> mirrored, plausible range      (balance.rs)
//!               all rows of a run ------------> Factor: the current is read so many times too large      (factor.rs)
//! first pulse   means at rest, in motion -----> Share of the nameplate: fits | refused | undetermined    (share.rs)
//!  and stage    farthest current and speed ---> Sight: reversed, open, dead, locked                      (sight.rs)
//! record        regressions over windows -----> Assignment: exchanged, reversed                          (assignment.rs)
//! nameplate     estimates over nameplate -----> mistakes of units                                        (units.rs)
//! readings equal to the bit ------------------> Repeats: frozen                                          (repeats.rs)
//! ```
//!
//! What is to be believed has one set of thresholds, [`SETTINGS`].

mod balance;
mod factor;
mod range;
mod repeats;
mod scale;
mod settings;

pub use balance::{Plate, Reading, Row, Scale, Window};
pub use factor::Factor;
pub use range::Range;
pub use repeats::Repeats;
pub use scale::{DEGREES, KEYS, Scaled, nearest, speed_units};
pub use settings::{SETTINGS, Settings};
