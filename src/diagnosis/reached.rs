//! How large an effect became on a run: what a person can hold against the motor's rating.
//!
//! The terms of the fitted effect are evaluated along the free run of the fitted model. What enters no balance, as a delay
//! or a second inertia, is the largest change that it makes to the signals.

use serde::Serialize;

use super::ladder::Fitted;
use crate::plant::{
    ActiveEffect, Effect, Input, Instant, Model, MotorKey, Plant, Scenario, ShaftAngle, State,
    Trajectory,
};
use crate::sample::TWO_SIDED_95;
use crate::text::number::{significant, with_std};

/// Share of the largest of its kind below which a size is the simulation's rounding: a filter of the current does not
/// move the shaft.
const ROUNDING: f64 = 1e-6;

/// The largest size of one quantity on the run.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Peak {
    pub value: f64,
    /// From the standard deviations of the effect's own parameters, as if they were independent.
    pub std: Option<f64>,
    pub interval_95: Option<[f64; 2]>,
    pub unit: &'static str,
    /// Share of the largest torque, voltage, speed or current of the run.
    pub percent_of_largest: Option<f64>,
}

impl Peak {
    /// As a sentence, with so many standard deviations on either side.
    pub fn text(&self, deviations: f64) -> String {
        let size = with_std(self.value, self.std.map(|std| deviations * std));
        let share = self.percent_of_largest.map_or_else(String::new, |percent| {
            format!(", {} % of the largest", significant(percent, 2))
        });
        format!("up to {size} {} in this run{share}", self.unit)
    }
}

/// What an effect reached on the training run: a torque, a voltage, both, or only what it changes in the signals.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Reached {
    #[serde(skip_serializing_if = "Option::is_none")]
    pub torque_n_m: Option<Peak>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub voltage_v: Option<Peak>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub speed_rad_s: Option<Peak>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub current_a: Option<Peak>,
}

impl Reached {
    /// Those that there are.
    pub fn peaks(&self) -> impl Iterator<Item = Peak> {
        [
            self.torque_n_m,
            self.voltage_v,
            self.speed_rad_s,
            self.current_a,
        ]
        .into_iter()
        .flatten()
    }
}

/// Torque N.m, voltage V, speed rad/s, current A; zero where the effect has none.
type Sizes = [f64; 4];
const UNITS: [&str; 4] = ["N.m", "V", "rad/s", "A"];

/// What an effect of a fitted model reached on `run`; not known where a torque drives, whose free run drifts.
pub(super) fn of_fit(fit: &Fitted, effect: &'static dyn Effect, run: &Scenario) -> Option<Reached> {
    if run.input != Input::Voltage {
        return None;
    }
    let id = effect.card().id;
    let active = fit.model.effects.iter().find(|active| active.id() == id)?;
    let values: Vec<f64> = active.values.iter().copied().collect::<Option<_>>()?;
    let measure = Measure::new(fit, effect, run)?;
    let sizes = measure.sizes(&values)?;
    let mut variances = [0.0; 4];
    let mut known = true;
    for (index, spec) in effect.parameters().iter().enumerate() {
        let key = format!("{id}.{}", spec.key);
        let found = fit.parameters.iter().find(|found| found.key == key);
        match found.and_then(|found| found.std) {
            Some(std) if std > 0.0 => {
                let mut moved = values.clone();
                moved[index] = (values[index] + std).clamp(spec.min, spec.max);
                if let Some(there) = measure.sizes(&moved) {
                    for ((variance, here), there) in variances.iter_mut().zip(sizes).zip(there) {
                        *variance += (there - here).powi(2);
                    }
                }
            }
            Some(_) => {}
            None => known = false,
        }
    }
    let largest = measure.largest();
    let peak = |index: usize| {
        let value = sizes[index];
        let std = known.then(|| variances[index].sqrt());
        let is_there = value > ROUNDING * largest[index] && value.is_finite();
        is_there.then(|| Peak {
            value,
            std,
            interval_95: std.map(|std| {
                [
                    (value - TWO_SIDED_95 * std).max(0.0),
                    value + TWO_SIDED_95 * std,
                ]
            }),
            unit: UNITS[index],
            percent_of_largest: (largest[index] > 0.0).then(|| 100.0 * value / largest[index]),
        })
    };
    Some(Reached {
        torque_n_m: peak(0),
        voltage_v: peak(1),
        speed_rad_s: peak(2),
        current_a: peak(3),
    })
}

/// The free run along which an effect is measured.
struct Measure<'a> {
    effect: &'static dyn Effect,
    model: &'a Model,
    run: &'a Scenario,
    start: State,
    with: Trajectory,
    /// The free run without the effect, where only a comparison shows it.
    without: Option<Trajectory>,
}

impl<'a> Measure<'a> {
    fn new(fit: &'a Fitted, effect: &'static dyn Effect, run: &'a Scenario) -> Option<Self> {
        let model = &fit.model;
        let active = model
            .effects
            .iter()
            .find(|active| active.id() == effect.card().id)?;
        let values: Vec<f64> = active.values.iter().copied().collect::<Option<_>>()?;
        let terms = effect.terms(&values);
        let beside = terms.path() != crate::plant::Path::default() || terms.coupling().is_some();
        let mut bare = model.clone();
        bare.effects
            .retain(|active| active.id() != effect.card().id);
        let start = State::at(fit.start.current_a, fit.start.speed_rad_s);
        let without = if beside {
            Some(Plant::new(&bare, run.input).ok()?.simulate(run, start))
        } else {
            None
        };
        Some(Self {
            effect,
            model,
            run,
            start,
            with: Plant::new(model, run.input).ok()?.simulate(run, fit.start),
            without,
        })
    }

    fn sizes(&self, values: &[f64]) -> Option<Sizes> {
        let mut sizes = self.along(values);
        let Some(without) = &self.without else {
            return Some(sizes);
        };
        let mut model = self.model.clone();
        for active in &mut model.effects {
            if active.id() == self.effect.card().id {
                *active = ActiveEffect {
                    effect: self.effect,
                    values: values.iter().copied().map(Some).collect(),
                };
            }
        }
        let with = Plant::new(&model, self.run.input)
            .ok()?
            .simulate(self.run, self.start);
        sizes[2] = largest_difference(&with.speed_rad_s, &without.speed_rad_s);
        sizes[3] = largest_difference(&with.current_a, &without.current_a);
        Some(sizes)
    }

    /// The largest torque and voltage of the terms.
    fn along(&self, values: &[f64]) -> Sizes {
        let terms = self.effect.terms(values);
        let motor = &self.model.motor;
        let value = |key| motor.get(key).unwrap_or(0.0);
        let (resistance_ohm, back_emf) = (value(MotorKey::Resistance), value(MotorKey::BackEmf));
        let angles = self.run.shaft_angle();
        let mut angle = angles.iter().peekable();
        let mut angle_rad = 0.0;
        let mut events = self.run.events.iter().peekable();
        let mut voltage_v = 0.0;
        let supply_v = self.run.supply_v();
        let mut own = vec![0.0; terms.states()];
        let mut rate = own.clone();
        let mut last_s = self.run.begin_s();
        let mut last_rad_s = self.start.speed_rad_s;
        let inertia = value(MotorKey::Inertia);
        let (mut torque, mut voltage) = (0.0_f64, 0.0_f64);
        for (sample, &time_s) in self.run.sample_time_s.iter().enumerate() {
            while let Some(point) = angle.next_if(|point| point.0 <= time_s) {
                angle_rad = point.1;
            }
            while let Some(event) = events.next_if(|event| event.0 <= time_s) {
                voltage_v = event.1;
            }
            let at = Instant {
                time_s: time_s - self.run.begin_s(),
                voltage_v,
                supply_v,
                current_a: self.with.current_a[sample],
                speed_rad_s: self.with.speed_rad_s[sample],
                angle: ShaftAngle::at(angle_rad),
                ..Instant::of(motor)
            };
            if !own.is_empty() && time_s > last_s {
                terms.derivative(&at, &own, &mut rate);
                for (state, rate) in own.iter_mut().zip(&rate) {
                    *state += rate * (time_s - last_s);
                }
            }
            let interval_s = time_s - last_s;
            let acceleration = if interval_s > 0.0 {
                (at.speed_rad_s - last_rad_s) / interval_s
            } else {
                0.0
            };
            (last_s, last_rad_s) = (time_s, at.speed_rad_s);
            let sums = terms.sums(&at, &own);
            let accelerating = (sums.inertia_gain * inertia * acceleration).abs();
            torque = torque.max(sums.torque_n_m.abs() + sums.friction_n_m.abs() + accelerating);
            // What a faster current saves of the voltage that drives it.
            let driving_v = voltage_v - resistance_ohm * at.current_a - back_emf * at.speed_rad_s;
            voltage =
                voltage.max(sums.voltage_v.abs() + (sums.current_rate_gain * driving_v).abs());
        }
        [torque, voltage, 0.0, 0.0]
    }

    /// The largest torque, voltage, speed and current of the run.
    fn largest(&self) -> Sizes {
        let most = |values: &mut dyn Iterator<Item = f64>| {
            values.fold(0.0, |most: f64, value| most.max(value.abs()))
        };
        let current_a = most(&mut self.with.current_a.iter().copied());
        [
            self.model.motor.torque_constant().unwrap_or(0.0).abs() * current_a,
            most(&mut self.run.events.iter().map(|event| event.1)),
            most(&mut self.with.speed_rad_s.iter().copied()),
            current_a,
        ]
    }
}

fn largest_difference(a: &[f64], b: &[f64]) -> f64 {
    a.iter()
        .zip(b)
        .fold(0.0, |most: f64, (a, b)| most.max((a - b).abs()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identification::noise::NoiseFloor;
    use crate::identification::output_error;
    use crate::plant::{Motor, effect, testing};

    /// A run of the true motor with the effect, fitted.
    fn fitted(id: &str, values: &[f64]) -> (Fitted, Scenario) {
        let mut model = Model::baseline(Motor::zk_22fc());
        model.effects.push(ActiveEffect {
            effect: effect::find(id).unwrap(),
            values: values.iter().copied().map(Some).collect(),
        });
        let events = vec![
            (0.0, 0.0),
            (0.4, 60.0),
            (1.2, -50.0),
            (2.0, 30.0),
            (2.6, 0.0),
        ];
        let run = testing::record(&model, events, 0.001, 3.0, 3);
        let noise = NoiseFloor::from_standstill(&run).unwrap();
        let fit = output_error::fit(std::slice::from_ref(&model), &run, &noise).unwrap();
        (Fitted::from(fit), run)
    }

    fn reached(id: &str, values: &[f64]) -> (Reached, Scenario) {
        let (fit, run) = fitted(id, values);
        (of_fit(&fit, effect::find(id).unwrap(), &run).unwrap(), run)
    }

    #[test]
    fn a_drag_reaches_its_coefficient_times_the_largest_speed() {
        let (found, run) = reached("viscous_friction", &[8e-4]);
        let fastest = run
            .speed_rad_s
            .iter()
            .fold(0.0, |most: f64, w| most.max(w.abs()));
        let torque = found.torque_n_m.unwrap();
        assert!(
            (torque.value / (8e-4 * fastest) - 1.0).abs() < 0.05,
            "{torque:?}"
        );
        let [from, to] = torque.interval_95.unwrap();
        assert!(from < torque.value && torque.value < to && torque.unit == "N.m");
        assert!(torque.percent_of_largest.unwrap() < 100.0);
        assert!(found.voltage_v.is_none() && found.speed_rad_s.is_none());
    }

    #[test]
    fn a_drop_is_told_in_volts_and_a_delay_by_what_it_changes() {
        let (drop, _) = reached("voltage_drop", &[1.5]);
        let voltage = drop.voltage_v.unwrap();
        assert!(
            (voltage.value - 1.5).abs() < 0.05 && voltage.unit == "V",
            "{voltage:?}"
        );
        assert!(drop.torque_n_m.is_none());
        let (late, run) = reached("speed_delay", &[0.004]);
        let steepest = run
            .speed_rad_s
            .windows(40)
            .map(|pair| (pair[39] - pair[0]).abs() / 0.039)
            .fold(0.0, f64::max);
        let change = late.speed_rad_s.unwrap();
        assert!(
            (change.value / (0.004 * steepest) - 1.0).abs() < 0.2,
            "{change:?}"
        );
        assert!(late.torque_n_m.is_none() && late.voltage_v.is_none());
    }

    #[test]
    fn what_sits_in_one_sensor_reaches_nothing_in_the_others() {
        for (id, value) in [
            ("current_filter", 2e-3),
            ("current_offset", 0.3),
            ("speed_filter", 4e-3),
            ("speed_offset", 2.0),
        ] {
            let (found, _) = reached(id, &[value]);
            let units: Vec<&str> = found.peaks().map(|peak| peak.unit).collect();
            let own = if id.starts_with("current") {
                "A"
            } else {
                "rad/s"
            };
            assert_eq!(units, [own], "{id}: {found:?}");
        }
    }
}
