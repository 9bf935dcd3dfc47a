//! A recipe made smaller until both rivals keep it within the limits, with the commands as a run would give them.

use serde::Serialize;

use super::limits::ExperimentLimits;
use super::menu::{Reach, Recipe, recipe};
use crate::excitation::{Output, Program};
use crate::identification::noise::NoiseFloor;
use crate::numerics::count::whole;
use crate::plant::{Input, Model, MotorKey, Plant, Scenario, State};
use crate::sample::Channel;

/// Shares of the limits that a plan may use: the motor on the bench is not quite the model.
const VOLTAGE_SHARE: f64 = 0.95;
const CURRENT_SHARE: f64 = 0.85;
const SPEED_SHARE: f64 = 0.92;
/// Rows of a plan are not closer than this, and its simulations take no shorter steps, s: a menu of runs takes its time, and
/// what two models differ by in a run needs no such accuracy as a measurement.
pub(super) const SHORTEST_PERIOD_S: f64 = 2e-3;
const LONGEST_PERIOD_S: f64 = 0.05;
/// Times a recipe is made smaller before it is given up.
const MOST_TRIALS: usize = 5;

/// What a run reaches, magnitudes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Peaks {
    pub voltage_v: f64,
    pub current_a: f64,
    pub speed_rad_s: f64,
    pub rms_current_a: f64,
    pub travel_rad: f64,
    pub duration_s: f64,
}

/// A run that could be made.
pub(super) struct Planned {
    pub(super) recipe: Recipe,
    pub(super) peaks: Peaks,
    /// Commands, sample times and the angle; no measurement yet.
    blank: Scenario,
    /// How many rows of the bench one of the plan stands for.
    stands_for: f64,
}

impl Planned {
    /// Rows that the bench would record.
    pub(super) fn rows(&self) -> f64 {
        self.stands_for * self.blank.samples() as f64
    }

    /// The noise that rows of the plan have where they say as much as those of the bench do.
    pub(super) fn noise(&self, noise: NoiseFloor) -> NoiseFloor {
        NoiseFloor {
            current_a: noise.current_a / self.stands_for.sqrt(),
            speed_rad_s: noise.speed_rad_s / self.stands_for.sqrt(),
            ..noise
        }
    }

    /// The run as it would be measured, without noise, if `truth` were true.
    pub(super) fn measured(&self, truth: &Model) -> Option<Scenario> {
        let mut run = self.blank.clone();
        fill(&mut run, truth)?;
        Some(run)
    }
}

/// Recipe `index` within the limits for every model of `models`; `None` where it cannot be.
pub(super) fn planned(
    index: usize,
    models: &[&Model],
    limits: &ExperimentLimits,
) -> Option<Planned> {
    let period_s = limits.period_s.clamp(SHORTEST_PERIOD_S, LONGEST_PERIOD_S);
    let whole_reach = reach(models.first()?, limits, period_s)?;
    let mut share = 1.0;
    for _ in 0..MOST_TRIALS {
        let recipe = recipe(index, &whole_reach.smaller(share));
        let mut blank = blank(&recipe, period_s)?;
        let mut peaks = Peaks::default();
        for model in models {
            let mut run = blank.clone();
            fill(&mut run, model)?;
            peaks = peaks.and(&Peaks::of(&run));
            if blank.angle.is_empty() {
                // The angle comes from outside, as it does in a run; every model then gets the same.
                blank.angle = run.shaft_angle().into_owned();
            }
        }
        let excess = peaks.excess(limits);
        if excess <= 1.0 {
            return (peaks.duration_s <= limits.duration_s).then_some(Planned {
                recipe,
                peaks,
                blank,
                stands_for: (period_s / limits.period_s).max(1.0),
            });
        }
        share *= 0.97 / excess;
    }
    None
}

fn fill(run: &mut Scenario, model: &Model) -> Option<()> {
    let plant = Plant::new(model, Input::Voltage).ok()?;
    let mut plant = plant.coarse(SHORTEST_PERIOD_S);
    let out = plant.simulate(run, State::default());
    let finite = |values: &[f64]| values.iter().all(|value| value.is_finite());
    (finite(&out.current_a) && finite(&out.speed_rad_s)).then(|| {
        run.current_a = out.current_a;
        run.speed_rad_s = out.speed_rad_s;
    })
}

fn blank(recipe: &Recipe, period_s: f64) -> Option<Scenario> {
    let program = Program::new(&recipe.segments, recipe.slew_v_per_s).ok()?;
    let rows = whole((program.duration_s() / period_s).ceil());
    let times: Vec<f64> = (0..rows).map(|row| row as f64 * period_s).collect();
    let mut events: Vec<(f64, f64)> = Vec::new();
    for &time_s in &times {
        let voltage_v = match program.value_at(time_s) {
            Output::Voltage(volts) => volts,
            // The model knows no open circuit, so no recipe has one.
            Output::Coast => return None,
        };
        #[expect(
            clippy::float_cmp,
            reason = "the same command again changes nothing, another one does"
        )]
        let changes = events.last().is_none_or(|last| last.1 != voltage_v);
        if changes {
            events.push((time_s, voltage_v));
        }
    }
    Some(Scenario {
        name: recipe.id.to_owned(),
        input: Input::Voltage,
        input_channel: Channel::VoltageCmd,
        events,
        current_a: vec![0.0; rows],
        speed_rad_s: vec![0.0; rows],
        angle: Vec::new(),
        time_half_width_s: Vec::new(),
        unknown_input: vec![],
        scored: 0..rows,
        sample_time_s: times,
    })
}

/// Voltages for this motor; `None` for a model without an electrical half.
fn reach(model: &Model, limits: &ExperimentLimits, period_s: f64) -> Option<Reach> {
    let motor = |key| model.motor.get(key);
    let (resistance, back_emf, inertia) = (
        motor(MotorKey::Resistance)?,
        motor(MotorKey::BackEmf)?,
        motor(MotorKey::Inertia)?,
    );
    let load_a = motor(MotorKey::LoadTorque)? / model.motor.torque_constant()?;
    let idle_v = resistance * load_a;
    let voltage_v = VOLTAGE_SHARE * limits.voltage_v;
    let current_a = CURRENT_SHARE * limits.current_a;
    let full_v = voltage_v.min(idle_v + back_emf * SPEED_SHARE * limits.speed_rad_s);
    // While the voltage rises at s, the back-EMF lags by s R J/Ke^2: that over R is the current (PHYSICS.md).
    let accelerating_a = (0.9 * (current_a - load_a)).max(0.1 * current_a);
    let slew_v_per_s = accelerating_a * back_emf * back_emf / inertia;
    let quick_v = voltage_v.min(current_a * resistance);
    let reach = Reach {
        full_v,
        quick_v,
        creep_v: full_v.min(2.0 * idle_v + 0.08 * full_v),
        // Faster than in a twentieth of a second is no slew.
        slew_v_per_s: slew_v_per_s.min(full_v / 0.05).min(limits.slew_v_per_s),
        quick_slew_v_per_s: (2.0 * quick_v / period_s).min(limits.slew_v_per_s),
        period_s,
    };
    (reach.full_v > 0.0 && reach.slew_v_per_s > 0.0 && reach.full_v.is_finite()).then_some(reach)
}

impl Reach {
    fn smaller(&self, share: f64) -> Self {
        Self {
            full_v: share * self.full_v,
            quick_v: share * self.quick_v,
            creep_v: share * self.creep_v,
            slew_v_per_s: share * self.slew_v_per_s,
            quick_slew_v_per_s: share * self.quick_slew_v_per_s,
            period_s: self.period_s,
        }
    }
}

impl Peaks {
    fn of(run: &Scenario) -> Self {
        let largest = |values: &mut dyn Iterator<Item = f64>| {
            values.fold(0.0, |most, value| f64::max(most, value.abs()))
        };
        let squares: f64 = run.current_a.iter().map(|i| i * i).sum();
        let angle = run.shaft_angle();
        let start_rad = angle.first().map_or(0.0, |first| first.1);
        Self {
            voltage_v: largest(&mut run.events.iter().map(|event| event.1)),
            current_a: largest(&mut run.current_a.iter().copied()),
            speed_rad_s: largest(&mut run.speed_rad_s.iter().copied()),
            rms_current_a: (squares / run.samples().max(1) as f64).sqrt(),
            travel_rad: largest(&mut angle.iter().map(|point| point.1 - start_rad)),
            duration_s: run.sample_time_s.last().copied().unwrap_or(0.0),
        }
    }

    fn and(self, other: &Self) -> Self {
        Self {
            voltage_v: self.voltage_v.max(other.voltage_v),
            current_a: self.current_a.max(other.current_a),
            speed_rad_s: self.speed_rad_s.max(other.speed_rad_s),
            rms_current_a: self.rms_current_a.max(other.rms_current_a),
            travel_rad: self.travel_rad.max(other.travel_rad),
            duration_s: self.duration_s.max(other.duration_s),
        }
    }

    /// Largest of the peaks in units of what a plan may use; at most one where all is well.
    fn excess(&self, limits: &ExperimentLimits) -> f64 {
        let travel = limits
            .travel_rad
            .map_or(0.0, |limit| self.travel_rad / (SPEED_SHARE * limit));
        [
            self.voltage_v / limits.voltage_v,
            self.current_a / (CURRENT_SHARE * limits.current_a),
            self.speed_rad_s / (0.96 * limits.speed_rad_s),
            self.rms_current_a / limits.rms_current_a,
            travel,
        ]
        .into_iter()
        .fold(0.0, f64::max)
    }
}
