//! A supply whose voltage sags under load: source resistance and the capacitor of the DC link.

use super::{Acts, HiddenKind, Mechanism, Moment, NotNegative};
use drivebench_model::plant::REFERENCE_SUPPLY_V;

/// Time constant of source resistance and capacitor, s: a lag that hardly shows in samples at 1 kHz.
const BUS_TIME_CONSTANT_S: f64 = 2e-3;

/// Resistance of the drive's supply; referred to the motor it is multiplied by the squared duty cycle. As in the model file it is
/// that of a supply of 110 V: on the drive's own bus the same loss of voltage takes `(bus/110 V)^2` of it.
pub(super) const KIND: HiddenKind = HiddenKind {
    id: "supply_sag",
    names: &["supply_sag"],
    parameters: &[NotNegative.of("sag_ohm", "ohm", 0.4, 0.25..0.6)],
    mystery: Some(|dice| vec![dice.size(0.02, 0.06) * dice.voltage_v / dice.current_a]),
    acts: Acts::Inside(|values, site| {
        let referred = site.bus_v / REFERENCE_SUPPLY_V;
        Box::new(Supply {
            source_ohm: values[0] * referred * referred,
            open_circuit_v: site.bus_v,
            bus_v: site.bus_v,
        })
    }),
};

/// C dv/dt = (V0 - v)/Rs - D i with the duty cycle D = u/V0, and the motor gets D v. Settled: u - Rs D^2 i, which is the
/// host's form; the capacitor makes the sag lag. The battery takes back what braking returns.
struct Supply {
    source_ohm: f64,
    open_circuit_v: f64,
    bus_v: f64,
}

impl Mechanism for Supply {
    fn supply_factor(&self) -> f64 {
        self.bus_v / self.open_circuit_v
    }

    fn advance(&mut self, step_s: f64, at: &Moment, put_out_v: f64) {
        let duty = put_out_v / self.open_circuit_v;
        let settled = self.open_circuit_v - self.source_ohm * duty * at.current_a;
        self.bus_v += (settled - self.bus_v) * -(-step_s / BUS_TIME_CONSTANT_S).exp_m1();
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::motor::zk_22fc;
    use super::super::Site;
    use super::*;

    #[test]
    fn settles_on_the_duty_cycle_law_and_lags() {
        let at = Moment { current_a: 6.0, ..Moment::default() };
        for bus_v in [110.0, 120.0, 300.0] {
            let site = Site { bus_v, ..Site::of(&zk_22fc()) };
            let mut bus = KIND.mechanism_on(&site, &[0.4]);
            // Half of the 110 V to which the size refers, whatever the bus: the motor loses a quarter of Rs i.
            let full_v = 0.4 * 0.25 * 6.0;
            bus.advance(BUS_TIME_CONSTANT_S, &at, 55.0);
            let lost_v = 55.0 * (1.0 - bus.supply_factor());
            assert!((lost_v / full_v - 0.632).abs() < 1e-3, "{bus_v}: {lost_v}");
            for _ in 0..1000 {
                bus.advance(50e-6, &at, 55.0);
            }
            let lost_v = 55.0 * (1.0 - bus.supply_factor());
            assert!((lost_v - full_v).abs() < 1e-9, "{bus_v}: {lost_v}");
        }
    }
}
