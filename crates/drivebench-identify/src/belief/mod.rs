//! Whether signals and nameplates can be believed: fault detection by parity equations (Isermann, Fault-Diagnosis Systems,
//! 2006, ch. 10).
//!
//! ```text
//! voltage   u    = R i + L di/dt + Ke w        torque   Kt i = J dw/dt + Mc sign(w)        Kt = Ke
//!
//! live watch    last cycles, as ranges -----> Window: fits, misfits, mirrored; plausible range       (balance.rs)
//!               rows of the whole run ------> Factor: the current is read so many times too large    (factor.rs)
//!               readings equal to the bit --> Repeats: frozen                                        (repeats.rs)
//! first pulse   steady states --------------> Plate: speed by voltage, current that turns a shaft    (balance.rs)
//! record,       found over nameplate -------> Scaled: one sensor's factor explains all ratios        (scale.rs)
//! nameplate
//! ```
//!
//! The caller supplies the samples and acts on the verdict; all thresholds are in [`Settings`].

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
pub use settings::Settings;
