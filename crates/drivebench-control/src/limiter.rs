//! Limiter of the output, cycle by cycle: voltage limit, and the current that the voltage will drive.

use serde::Serialize;

/// Limits of a controller's output. The limits of the guard are wider.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Limiter {
    /// Largest output, actuator's unit.
    pub output: f64,
    /// With a voltage command: the current that may flow, A.
    pub current: Option<CurrentLimit>,
}

/// Keeps `abs(u - Ke w) <= R i` at the instant at which the voltage is applied.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct CurrentLimit {
    pub current_a: f64,
    pub resistance_ohm: f64,
    pub back_emf_v_s_per_rad: f64,
    /// From the sample to the middle of the time for which the voltage holds, s: the speed changes until then.
    pub ahead_s: f64,
}

impl Limiter {
    /// `wanted` within the limits. `acceleration_rad_s2` is that of the shaft now.
    pub fn limit(&self, wanted: f64, speed_rad_s: f64, acceleration_rad_s2: f64) -> f64 {
        let mut output = if wanted.is_finite() { wanted } else { 0.0 };
        if let Some(limit) = &self.current {
            let speed = speed_rad_s + limit.ahead_s * acceleration_rad_s2;
            let back_emf_v = limit.back_emf_v_s_per_rad * speed;
            let winding_v = limit.resistance_ohm * limit.current_a;
            output = output.clamp(back_emf_v - winding_v, back_emf_v + winding_v);
        }
        output.clamp(-self.output, self.output)
    }
}

/// Sign of the limit that clipped `wanted` to `given`: +1 where more was wanted; zero where they differ by rounding only.
pub(super) fn limited(wanted: f64, given: f64) -> f64 {
    let short = wanted - given;
    if short.abs() > 1e-9 * wanted.abs().max(1.0) { short.signum() } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use crate::testing::{assert_close, limiter, timing};

    #[test]
    fn current_and_voltage_stay_within_their_limits() {
        // Ke = 0.3538 V s/rad, 11 V across the winding, and 25 ms ahead.
        for (wanted, speed, acceleration, expected) in [
            (1e9, 100.0, 0.0, 46.38),
            (-1e9, 100.0, 0.0, 24.38),
            (1e9, 100.0, 500.0, 46.38 + 0.3538 * 12.5),
            (1e9, 310.0, 0.0, 110.0),
            (f64::NAN, 0.0, 0.0, 0.0),
        ] {
            assert_close(limiter(&timing(2.0)).limit(wanted, speed, acceleration), expected, 1e-12);
        }
    }
}
