//! Peak of an effect on a run, for comparison with the motor's rating.
//!
//! The terms of the fitted effect are evaluated along the free run of the fitted model. An effect outside them, as a delay
//! or a second inertia, is reported by the largest change that it makes to the signals.

use serde::Serialize;

use super::score::Fitted;
use drivebench_model::numerics::statistics::largest;
use drivebench_model::plant::{
    ActiveEffect, Effect, Input, Instant, Model, MotorKey, Path, Plant, Scenario, ShaftAngle,
    State, Trajectory,
};
use drivebench_model::sample::TWO_SIDED_95;

/// Share of the largest of its kind below which a size is a rounding error: a filter of the current does not
/// move the shaft.
const ROUNDING_SHARE: f64 = 1e-6;

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

/// Peaks of an effect on the training run: a torque, a voltage, both, or only its change of the signals.
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
    /// The peaks that are not null.
    pub fn peaks(&self) -> impl Iterator<Item = Peak> {
        [self.torque_n_m, self.voltage_v, self.speed_rad_s, self.current_a].into_iter().flatten()
    }
}

/// Torque N.m, voltage V, speed rad/s, current A; zero where the effect has none.
type Sizes = [f64; 4];
const UNITS: [&str; 4] = ["N.m", "V", "rad/s", "A"];

/// Peaks of an effect of a fitted model on `run`; not known where a torque drives, whose free run drifts.
pub(super) fn of_fit(fit: &Fitted, effect: &'static dyn Effect, run: &Scenario) -> Option<Reached> {
    if run.input != Input::Voltage {
        return None;
    }
    let id = effect.card().id;
    let active = fit.model.effects.iter().find(|active| active.id() == id)?;
    let values: Vec<f64> = active.values.iter().copied().collect::<Option<_>>()?;
    let along = FreeRun::new(fit, effect, &values, run)?;
    let sizes = along.sizes(&values)?;
    let mut variances = [0.0; 4];
    let mut known = true;
    for (index, spec) in effect.parameters().iter().enumerate() {
        let key = format!("{id}.{}", spec.key);
        let found = fit.parameters.iter().find(|found| found.key == key);
        let std = found.and_then(|found| found.std);
        known &= std.is_some();
        let Some(std) = std.filter(|std| *std > 0.0) else {
            continue;
        };
        let mut moved = values.clone();
        // At the upper bound the step is downwards.
        let upwards = values[index] + std;
        let range = spec.in_run(&run.scales);
        let stepped = if upwards <= range.max { upwards } else { values[index] - std };
        moved[index] = stepped.max(range.min);
        let at_step = along.sizes(&moved).unwrap_or(sizes);
        for k in 0..4 {
            variances[k] += (at_step[k] - sizes[k]).powi(2);
        }
    }
    let largest = along.largest();
    let peak = |index: usize| {
        let (value, largest) = (sizes[index], largest[index]);
        let std = known.then(|| variances[index].sqrt());
        let interval = |std: f64| {
            let half = TWO_SIDED_95 * std;
            [(value - half).max(0.0), value + half]
        };
        let is_there = value > ROUNDING_SHARE * largest && value.is_finite();
        is_there.then(|| Peak {
            value,
            std,
            interval_95: std.map(interval),
            unit: UNITS[index],
            percent_of_largest: (largest > 0.0).then(|| 100.0 * value / largest),
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
struct FreeRun<'a> {
    effect: &'static dyn Effect,
    model: &'a Model,
    run: &'a Scenario,
    start: State,
    with: Trajectory,
    /// The free run without the effect, where only a comparison shows it.
    without: Option<Trajectory>,
}

impl<'a> FreeRun<'a> {
    fn new(
        fit: &'a Fitted,
        effect: &'static dyn Effect,
        values: &[f64],
        run: &'a Scenario,
    ) -> Option<Self> {
        let terms = effect.terms(values);
        let acts_on_signals = terms.path() != Path::default() || terms.coupling().is_some();
        let start = State::at(fit.start.current_a, fit.start.speed_rad_s);
        let without = if acts_on_signals {
            let bare = fit.model.without_effect(effect.card().id).ok()?;
            Some(Plant::new(&bare, run.input).ok()?.simulate(run, start))
        } else {
            None
        };
        let mut plant = Plant::new(&fit.model, run.input).ok()?;
        Some(Self {
            effect,
            model: &fit.model,
            run,
            start,
            with: plant.simulate(run, fit.start),
            without,
        })
    }

    fn sizes(&self, values: &[f64]) -> Option<Sizes> {
        let mut sizes = self.along(values);
        if let Some(without) = &self.without {
            let mut model = self.model.clone();
            let id = self.effect.card().id;
            let own = model.effects.iter_mut().filter(|active| active.id() == id);
            own.for_each(|own| *own = ActiveEffect::with(self.effect, values));
            let with = Plant::new(&model, self.run.input).ok()?.simulate(self.run, self.start);
            sizes[2] = largest_difference(&with.speed_rad_s, &without.speed_rad_s);
            sizes[3] = largest_difference(&with.current_a, &without.current_a);
        }
        Some(sizes)
    }

    /// The largest torque and voltage of the terms.
    fn along(&self, values: &[f64]) -> Sizes {
        let terms = self.effect.terms(values);
        let motor = Instant::of(&self.model.motor).in_run(self.run);
        let inertia = self.model.motor.get(MotorKey::Inertia).unwrap_or(0.0);
        let angles = self.run.shaft_angle();
        let mut angles = angles.iter().peekable();
        let mut angle_rad = 0.0;
        let mut events = self.run.events.iter().peekable();
        let mut voltage_v = 0.0;
        let mut own = vec![0.0; terms.states()];
        let (mut last_s, mut last_rad_s) = (self.run.begin_s(), self.start.speed_rad_s);
        let (mut torque, mut voltage) = (0.0_f64, 0.0_f64);
        for (sample, &time_s) in self.run.sample_time_s.iter().enumerate() {
            while let Some(point) = angles.next_if(|point| point.0 <= time_s) {
                angle_rad = point.1;
            }
            while let Some(event) = events.next_if(|event| event.0 <= time_s) {
                voltage_v = event.1;
            }
            let at = Instant {
                time_s: time_s - self.run.begin_s(),
                voltage_v,
                current_a: self.with.current_a[sample],
                speed_rad_s: self.with.speed_rad_s[sample],
                angle: ShaftAngle::at(angle_rad),
                ..motor
            };
            let interval_s = time_s - last_s;
            if !own.is_empty() && interval_s > 0.0 {
                terms.advance(&at, &mut own, interval_s);
            }
            let acceleration = (at.speed_rad_s - last_rad_s) / interval_s;
            let acceleration = if interval_s > 0.0 { acceleration } else { 0.0 };
            (last_s, last_rad_s) = (time_s, at.speed_rad_s);
            let sums = terms.sums(&at, &own);
            let accelerating = (sums.inertia_gain * inertia * acceleration).abs();
            torque = torque.max(sums.torque_n_m.abs() + sums.friction_n_m.abs() + accelerating);
            // Voltage across the inductance that the effect replaces.
            let driving_v = voltage_v
                - motor.resistance_ohm * at.current_a
                - motor.back_emf_v_s_per_rad * at.speed_rad_s;
            let inductive_v = (sums.current_rate_gain * driving_v).abs();
            voltage = voltage.max(sums.voltage_v.abs() + inductive_v);
        }
        [torque, voltage, 0.0, 0.0]
    }

    /// The largest torque, voltage, speed and current of the run.
    fn largest(&self) -> Sizes {
        let current_a = largest(self.with.current_a.iter().copied());
        let per_ampere = self.model.motor.torque_constant().unwrap_or(0.0).abs();
        [
            per_ampere * current_a,
            largest(self.run.events.iter().map(|event| event.1)),
            largest(self.with.speed_rad_s.iter().copied()),
            current_a,
        ]
    }
}

fn largest_difference(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kit::{held, truth};
    use drivebench_identify::noise::NoiseFloor;
    use drivebench_identify::output_error;
    use drivebench_model::plant::{effect, testing};

    /// What an effect reached on a run of the true motor with it, fitted.
    fn reached(id: &str, values: &[f64]) -> (Reached, Scenario) {
        let model = truth(id, values);
        let run = testing::record(&model, held(&[60.0, -50.0, 30.0, 0.0], 0.7), 0.001, 3.0, 3);
        let noise = NoiseFloor::from_standstill(&run).unwrap();
        let fit = output_error::fit(&[model], &run, &noise).unwrap();
        let found = of_fit(&fit.into(), effect::find(id).unwrap(), &run);
        (found.unwrap(), run)
    }

    #[test]
    fn a_drag_reaches_its_coefficient_times_the_largest_speed() {
        let (found, run) = reached("viscous_friction", &[8e-4]);
        let fastest = largest(run.speed_rad_s.iter().copied());
        let torque = found.torque_n_m.unwrap();
        assert!((torque.value / (8e-4 * fastest) - 1.0).abs() < 0.05, "{torque:?}");
        let [from, to] = torque.interval_95.unwrap();
        assert!(from < torque.value && torque.value < to && torque.unit == "N.m");
        assert!(torque.percent_of_largest.unwrap() < 100.0);
        assert!(found.voltage_v.is_none() && found.speed_rad_s.is_none());
    }

    #[test]
    fn a_drop_is_in_volts_and_a_delay_in_the_change_of_the_speed() {
        let (drop, _) = reached("voltage_drop", &[1.5]);
        let voltage = drop.voltage_v.unwrap();
        assert!((voltage.value - 1.5).abs() < 0.05 && voltage.unit == "V", "{voltage:?}");
        assert!(drop.torque_n_m.is_none());
        let (late, run) = reached("speed_delay", &[0.004]);
        let steps = run.speed_rad_s.windows(40);
        let steepest = steps.map(|part| (part[39] - part[0]).abs() / 0.039).fold(0.0, f64::max);
        let change = late.speed_rad_s.unwrap();
        assert!((change.value / (0.004 * steepest) - 1.0).abs() < 0.2, "{change:?}");
        assert!(late.torque_n_m.is_none() && late.voltage_v.is_none());
    }

    #[test]
    fn at_its_upper_bound_a_parameter_keeps_its_deviation() {
        let model = truth("speed_delay", &[0.004]);
        let run = testing::record(&model, held(&[60.0, -50.0], 0.7), 0.001, 2.0, 3);
        let noise = NoiseFloor::from_standstill(&run).unwrap();
        let mut fit = Fitted::from(output_error::fit(&[model], &run, &noise).unwrap());
        let most = fit.model.effects[0].effect.parameters()[0].max;
        fit.model.effects[0].values[0] = Some(most);
        let delay = effect::find("speed_delay").unwrap();
        let late = of_fit(&fit, delay, &run).unwrap().speed_rad_s.unwrap();
        assert!(late.std.unwrap() > 0.0, "{late:?}");
    }

    #[test]
    fn an_effect_of_one_sensor_changes_no_other() {
        for (id, value, unit) in [
            ("current_filter", 2e-3, "A"),
            ("current_offset", 0.3, "A"),
            ("speed_filter", 4e-3, "rad/s"),
            ("speed_offset", 2.0, "rad/s"),
        ] {
            let (found, _) = reached(id, &[value]);
            let units: Vec<&str> = found.peaks().map(|peak| peak.unit).collect();
            assert_eq!(units, [unit], "{id}: {found:?}");
        }
    }
}
