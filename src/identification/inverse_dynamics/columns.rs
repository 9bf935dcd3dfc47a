//! The balance of one part, term by term: what each unknown contributes per unit at each sample.

use super::grid::{Motion, Part};
use super::processing::{Processing, filter, rate, spanned};
use crate::identification::regressor::PROPORTIONAL;
use crate::plant::{Balance, Input, Instant, Model, MotorKey, Scenario, ShaftAngle, Slot};

/// Rows of one part before decimation.
pub(super) struct Rows {
    pub(super) time_s: Vec<f64>,
    pub(super) left: Vec<f64>,
    /// One column per unknown.
    pub(super) columns: Vec<Vec<f64>>,
    /// Whether the balance holds there: away from the ends and, for torques, from rest.
    pub(super) valid: Vec<bool>,
}

/// `None` where the part is sampled too slowly for the cut-off.
pub(super) fn rows(
    model: &Model,
    scenario: &Scenario,
    equation: Balance,
    unknowns: &[Slot],
    part: &Part,
    processing: &Processing,
) -> Option<Rows> {
    let filter = filter(processing.cut_off_hz, part.period_s)?;
    let low_pass = |values: &[f64]| filter.zero_phase(values);
    let angular = processing.motion == Motion::Angle;
    // Beside a speed that is a central difference everything else is averaged over its span.
    let beside = |values: Vec<f64>| if angular { spanned(&values) } else { values };
    let filtered = low_pass(&part.motion);
    let speed = if angular {
        rate(&filtered, part.period_s)
    } else {
        filtered
    };
    let current = beside(low_pass(&part.current_a));
    let left = match (equation, scenario.input) {
        (Balance::Voltage, _) => beside(low_pass(&held_means(scenario, part))),
        (Balance::Torque, Input::Torque) => spanned(&beside(low_pass(&part.torque_n_m))),
        (Balance::Torque, Input::Voltage | Input::Current) => {
            // Without a torque constant in units of it: the caller says so.
            let kt = model.motor.torque_constant().unwrap_or(1.0);
            spanned(&current).iter().map(|i| kt * i).collect()
        }
    };
    let signals = Signals {
        model,
        supply_v: scenario.supply_v(),
        begin_s: scenario.begin_s(),
        part,
        equation,
        left: &left,
        current: &current,
        speed: &speed,
    };
    let columns = unknowns
        .iter()
        .map(|slot| low_pass(&signals.column(slot)))
        .collect();
    let reach = processing.reach(part.period_s);
    let mut valid = match equation {
        Balance::Voltage => vec![true; speed.len()],
        Balance::Torque => moving(&speed, processing.dead_zone_rad_s, reach),
    };
    let ends = reach.min(valid.len());
    valid[..ends].fill(false);
    let tail = valid.len() - ends;
    valid[tail..].fill(false);
    Some(Rows {
        time_s: (0..part.samples()).map(|k| part.time_s(k)).collect(),
        left: low_pass(&left),
        columns,
        valid,
    })
}

/// False at rest and within the filter's reach of it: a shaft that sticks is held by less than the Coulomb torque. A
/// reversal passes through zero speed faster than the filter sees, and stays.
pub(super) fn moving(speed: &[f64], dead_zone_rad_s: f64, reach: usize) -> Vec<bool> {
    let mut moving = vec![true; speed.len()];
    let shortest = (reach / 2).max(3);
    let mut begin = 0;
    for k in 0..=speed.len() {
        if speed.get(k).is_some_and(|w| w.abs() <= dead_zone_rad_s) {
            continue;
        }
        if k - begin >= shortest {
            let end = (k + reach).min(speed.len());
            moving[begin.saturating_sub(reach)..end].fill(false);
        }
        begin = k + 1;
    }
    moving
}

/// Signals of one part as the terms see them.
struct Signals<'a> {
    model: &'a Model,
    supply_v: f64,
    /// When the run's first command came.
    begin_s: f64,
    part: &'a Part,
    equation: Balance,
    left: &'a [f64],
    current: &'a [f64],
    speed: &'a [f64],
}

impl Signals<'_> {
    fn column(&self, slot: &Slot) -> Vec<f64> {
        let period_s = self.part.period_s;
        match *slot {
            Slot::Motor(MotorKey::Resistance) => spanned(self.current),
            Slot::Motor(MotorKey::Inductance) => rate(self.current, period_s),
            Slot::Motor(MotorKey::BackEmf) => spanned(self.speed),
            Slot::Motor(MotorKey::Inertia) => rate(self.speed, period_s),
            Slot::Motor(MotorKey::LoadTorque) => {
                spanned(&self.speed.iter().map(|w| w.signum()).collect::<Vec<_>>())
            }
            Slot::Motor(MotorKey::TorqueConstant) => vec![f64::NAN; self.speed.len()],
            Slot::Effect {
                index, parameter, ..
            } => spanned(&self.effect(index, parameter)),
        }
    }

    /// What the effect's coefficient adds per unit, of a size so small that the effect is proportional to it,; its shape parameters stay as they are given.
    fn effect(&self, index: usize, parameter: usize) -> Vec<f64> {
        let active = &self.model.effects[index];
        let mut values = active.values_or_guess();
        let size = PROPORTIONAL * active.effect.parameters()[parameter].scale;
        for (other, spec) in active.effect.parameters().iter().enumerate() {
            if spec.is_coefficient() {
                values[other] = if other == parameter { size } else { 0.0 };
            }
        }
        let terms = active.effect.terms(&values);
        let own = vec![0.0; terms.states()];
        (0..self.speed.len())
            .map(|k| {
                let at = Instant {
                    time_s: self.part.time_s(k) - self.begin_s,
                    voltage_v: if self.equation == Balance::Voltage {
                        self.left[k]
                    } else {
                        0.0
                    },
                    supply_v: self.supply_v,
                    current_a: self.current[k],
                    speed_rad_s: self.speed[k],
                    angle: ShaftAngle::at(self.part.angle_rad[k]),
                    ..Instant::of(&self.model.motor)
                };
                let added = match self.equation {
                    Balance::Voltage => terms.voltage_v(&at, &own),
                    Balance::Torque => {
                        terms.torque_n_m(&at, &own)
                            + self.speed[k].signum() * terms.friction_n_m(&at)
                    }
                };
                added / size
            })
            .collect()
    }
}

/// Exact mean of the held voltage over one period either side of each sample: the span of the central differences.
fn held_means(scenario: &Scenario, part: &Part) -> Vec<f64> {
    let events = &scenario.events;
    (0..part.samples())
        .map(|k| {
            let from_s = part.time_s(k) - part.period_s;
            let to_s = part.time_s(k) + part.period_s;
            let first = events.partition_point(|event| event.0 <= from_s).max(1) - 1;
            let mut sum = 0.0;
            for (index, event) in events.iter().enumerate().skip(first) {
                if event.0 >= to_s {
                    break;
                }
                let next_s = events.get(index + 1).map_or(to_s, |next| next.0.min(to_s));
                // Before the first event its value is all that is known; the ends of a part are not used.
                let begin_s = if index == 0 {
                    from_s
                } else {
                    event.0.max(from_s)
                };
                sum += event.1 * (next_s - begin_s);
            }
            sum / (to_s - from_s)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rest_is_left_out_with_the_filters_reach_and_a_reversal_stays() {
        let mut speed = vec![1.0; 60];
        speed[20..30].fill(0.0);
        // A reversal: one sample within the dead zone.
        speed[50] = 0.005;
        speed[51..].fill(-1.0);
        let moving = moving(&speed, 0.01, 6);
        assert!(moving[..14].iter().all(|m| *m) && moving[36..].iter().all(|m| *m));
        assert!(moving[14..36].iter().all(|m| !*m));
        // Rest that lasts to the end is rest as well.
        speed[51..].fill(0.0);
        assert!(!super::moving(&speed, 0.01, 6)[59]);
    }
}
