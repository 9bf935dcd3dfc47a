//! Around drive and motor: a supply that may take nothing back, and a brake that the drive works.

use crate::config::{BrakeConfig, EmulatorConfig};

/// A supply behind a rectifier: it gives, and what comes back charges its capacitor.
#[derive(Clone, Copy, Debug)]
struct Capacitor {
    farads: f64,
    supplied_v: f64,
    volts: f64,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct SupplyAndBrake {
    capacitor: Option<Capacitor>,
    brake: Option<BrakeConfig>,
    /// Since the drive has started, or stopped, s.
    since_s: f64,
    was_running: bool,
}

impl SupplyAndBrake {
    pub(super) fn new(config: &EmulatorConfig) -> Self {
        let supplied_v = config.limits.bus_v;
        Self {
            capacitor: config.limits.bus_capacitance_f.map(|farads| Capacitor {
                farads,
                supplied_v,
                volts: supplied_v,
            }),
            brake: config.brake,
            // Long shut.
            since_s: f64::INFINITY,
            was_running: false,
        }
    }

    /// A step with so much power out of the supply, W.
    pub(super) fn step(&mut self, step_s: f64, is_running: bool, power_w: f64) {
        if is_running == self.was_running {
            self.since_s += step_s;
        } else {
            (self.was_running, self.since_s) = (is_running, 0.0);
        }
        if let Some(capacitor) = &mut self.capacitor {
            let energy =
                capacitor.volts * capacitor.volts - 2.0 * power_w * step_s / capacitor.farads;
            // Below the rectifier's voltage the supply gives what is missing.
            capacitor.volts = energy.max(0.0).sqrt().max(capacitor.supplied_v);
        }
    }

    /// Rise of the intermediate circuit over its supply, V.
    pub(super) fn rise_v(&self) -> f64 {
        self.capacitor.map_or(0.0, |capacitor| capacitor.volts - capacitor.supplied_v)
    }

    pub(super) fn holds(&self) -> bool {
        self.brake.is_some_and(|brake| {
            if self.was_running {
                self.since_s < brake.release_s
            } else {
                self.since_s >= brake.apply_s
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_comes_back_stays_in_the_capacitor_until_it_is_used() {
        let mut config = EmulatorConfig::embedded("zk-22fc-plain").unwrap();
        config.limits.bus_capacitance_f = Some(1e-3);
        let mut around = SupplyAndBrake::new(&config);
        around.step(0.01, true, -100.0);
        // 1 J into 1 mF at 120 V.
        let expected = (120.0_f64.powi(2) + 2.0 * 1.0 / 1e-3).sqrt() - 120.0;
        assert!((around.rise_v() - expected).abs() < 1e-9);
        around.step(1.0, true, 100.0);
        assert!(around.rise_v().abs() < 1e-12);
        config.limits.bus_capacitance_f = None;
        let mut stiff = SupplyAndBrake::new(&config);
        stiff.step(1.0, true, -1e3);
        assert!(stiff.rise_v().abs() < 1e-12);
    }
}
