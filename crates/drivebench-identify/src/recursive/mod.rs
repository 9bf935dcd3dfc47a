//! Recursive identification: one sample in, parameters with their uncertainty out.
//!
//! ```text
//! samples, voltage as applied -> blocks of about 10 ms -> scheme 3: R, L, Ke (current predicted over the block)
//!                                                      -> mechanical balance: J, Mc (scheme 3 with its own Ke)
//! samples (i, w) ----------------------------------------> scheme 2: J, Mc (Kt known), as paper A
//! ```

mod mechanical;
mod scheme_2;
mod scheme_3;
mod track;
mod winding;

pub use scheme_2::{CurrentIntegral, Scheme2};
pub use scheme_3::{Memory, Scheme3, StartValues};

/// Share of the prior variance above which a parameter counts as not excited.
pub(crate) const IGNORANT: f64 = 0.3;
/// A longer gap between samples ends a row, s: the current between them is not known.
const LONGEST_GAP_S: f64 = 0.1;

/// Sign of the speed from a dead zone, never from noise around zero.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Direction {
    pub(crate) largest_rad_s: f64,
    /// Standard deviation of the speed at standstill, where known.
    pub(crate) noise_rad_s: f64,
}

impl Direction {
    pub(crate) fn with_noise(noise_rad_s: f64) -> Self {
        Self { noise_rad_s, ..Self::default() }
    }

    /// -1, 0 (inside the dead zone) or 1.
    pub(crate) fn of(&mut self, speed_rad_s: f64) -> i8 {
        self.largest_rad_s = self.largest_rad_s.max(speed_rad_s.abs());
        let zone = self.dead_zone_rad_s();
        i8::from(speed_rad_s > zone) - i8::from(speed_rad_s < -zone)
    }

    pub(crate) fn dead_zone_rad_s(&self) -> f64 {
        // Where the noise is not known, that of any sensor of a motor of some hundred rad/s.
        let noise_rad_s = if self.noise_rad_s > 0.0 { 4.0 * self.noise_rad_s } else { 0.5 };
        noise_rad_s.max(0.01 * self.largest_rad_s)
    }
}

/// Sampling period as it is usually, s: one gap in the stamps does not change it.
pub(crate) fn steady_period(known_s: f64, step_s: f64) -> f64 {
    if known_s.is_nan() || step_s < known_s / 2.5 {
        step_s
    } else if step_s > 2.5 * known_s {
        known_s
    } else {
        known_s + (step_s - known_s) / 16.0
    }
}
