//! Limiter of the output, cycle by cycle: voltage limit, and the current that the voltage will drive.

use serde::Serialize;

/// Limits of a controller's output. The guard's limits stand behind them and are wider.
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
    /// From the sample to the middle of the time for which the voltage holds, s: the speed goes on meanwhile.
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

/// Share of an output's size below which a difference is rounding and no limit.
const ROUNDING: f64 = 1e-9;

/// Sign of the limit between what was wanted and what was given: +1 where more was wanted; zero where nothing was cut.
pub(super) fn limited(wanted: f64, given: f64) -> f64 {
    let short = wanted - given;
    if short.abs() > ROUNDING * wanted.abs().max(1.0) { short.signum() } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_winding_never_sees_more_than_its_current_and_the_terminals_no_more_than_their_voltage() {
        let limiter = Limiter {
            output: 110.0,
            current: Some(CurrentLimit {
                current_a: 10.0,
                resistance_ohm: 1.0,
                back_emf_v_s_per_rad: 0.35,
                ahead_s: 0.02,
            }),
        };
        let within = |wanted, speed, acceleration| limiter.limit(wanted, speed, acceleration);
        assert!((within(1e9, 100.0, 0.0) - 45.0).abs() < 1e-9);
        assert!((within(-1e9, 100.0, 0.0) - 25.0).abs() < 1e-9);
        assert!((within(1e9, 100.0, 500.0) - 48.5).abs() < 1e-9);
        assert!((within(1e9, 310.0, 0.0) - 110.0).abs() < 1e-9);
        assert!((within(f64::NAN, 0.0, 0.0)).abs() < 1e-9);
    }
}
