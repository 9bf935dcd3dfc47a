//! The runs of the menu, as parts of a bench file's sequence: every excitation of `run` but the coast-down, for which
//! the model has no open circuit. Each is scaled down until all rivals keep it within the limits, with the commands as a
//! run would give them.

use serde::Serialize;

use super::ExperimentLimits;
use drivebench_identify::noise::NoiseFloor;
use drivebench_model::excitation::{
    Dither, Output, Prbs, Program, Ramp, Segment, Sine, Standstill, Steps, rich,
};
use drivebench_model::numerics::count::whole;
use drivebench_model::numerics::statistics::largest;
use drivebench_model::plant::{Input, Model, MotorKey, Plant, Scenario, State};
use drivebench_model::sample::Channel;

/// A sequence with the slew limit that it is meant for.
#[derive(Clone, Debug, PartialEq)]
pub struct Recipe {
    pub id: &'static str,
    pub segments: Vec<Segment>,
    pub slew_v_per_s: f64,
}

/// Voltages and times that suit the motor and its limits.
#[derive(Clone, Copy, Debug)]
struct Levels {
    /// Reaches the largest speed, V.
    full_v: f64,
    /// Largest step at rest, V.
    quick_v: f64,
    /// Lowest voltage of motion, V.
    creep_v: f64,
    /// Slew rate at which most of the allowed current flows, V/s.
    slew_v_per_s: f64,
    /// Slew rate that reverses `quick_v` within a command period, or the fastest of the bench, V/s.
    quick_slew_v_per_s: f64,
    /// Time between two commands, s.
    period_s: f64,
}

/// How fast a recipe's voltage may change.
#[derive(Clone, Copy)]
enum Change {
    /// At the slew rate that keeps the current within its limit.
    Slewed,
    /// From one level to another within a command period where the bench allows it: small voltages only.
    Quick,
}

/// Number of recipes.
pub(super) const COUNT: usize = 12;

/// A value rounded to three significant digits, towards zero, so that it stays within its limit.
fn figures(value: f64) -> f64 {
    if value == 0.0 || !value.is_finite() {
        return value;
    }
    // A division by a power of ten is the nearest double of the decimal; a product with 0.01 is not.
    let places = 2.0 - value.abs().log10().floor();
    let unit = 10_f64.powf(places.abs());
    // Above its rounding: 9.5 must not become 9.49.
    let above = value * (1.0 + 1e-12);
    if places >= 0.0 { (above * unit).trunc() / unit } else { (above / unit).trunc() * unit }
}

/// Whole milliseconds, upwards; a clock to the tenth of one.
fn milliseconds(seconds: f64) -> f64 {
    (seconds * 1e3 - 1e-6).ceil() / 1e3
}

fn clock(seconds: f64) -> f64 {
    (seconds * 1e4).round() / 1e4
}

/// The segment with all its values rounded.
fn rounded(segment: Segment) -> Segment {
    let dithered = |dither: Option<Dither>| {
        dither.map(|dither| Dither {
            amplitude_v: figures(dither.amplitude_v),
            clock_s: clock(dither.clock_s),
            ..dither
        })
    };
    match segment {
        Segment::Steps(steps) => Segment::Steps(Steps {
            levels_v: steps.levels_v.into_iter().map(figures).collect(),
            hold_s: milliseconds(steps.hold_s),
            dither: dithered(steps.dither),
        }),
        Segment::Ramp(ramp) => Segment::Ramp(Ramp {
            from_v: figures(ramp.from_v),
            to_v: figures(ramp.to_v),
            seconds: milliseconds(ramp.seconds),
            dither: dithered(ramp.dither),
        }),
        Segment::Prbs(prbs) => Segment::Prbs(Prbs {
            amplitude_v: figures(prbs.amplitude_v),
            clock_s: clock(prbs.clock_s),
            seconds: milliseconds(prbs.seconds),
            ..prbs
        }),
        Segment::Sine(sine) => {
            Segment::Sine(Sine { amplitude_v: figures(sine.amplitude_v), ..sine })
        }
        other => other,
    }
}

fn standstill(seconds: f64) -> Segment {
    Segment::Standstill(Standstill { seconds })
}

fn ramp(from_v: f64, to_v: f64, seconds: f64, dither: Option<Dither>) -> Segment {
    Segment::Ramp(Ramp { from_v, to_v, seconds, dither })
}

/// Holds at these shares of a voltage.
fn steps(of_v: f64, shares: &[f64], hold_s: f64) -> Segment {
    Segment::Steps(Steps {
        levels_v: shares.iter().map(|share| share * of_v).collect(),
        hold_s,
        dither: None,
    })
}

fn random(amplitude_v: f64, clock_s: f64, seconds: f64, seed: u64, levels: u16) -> Segment {
    Segment::Prbs(Prbs { amplitude_v, clock_s, seconds, seed, offset_v: 0.0, levels })
}

impl Levels {
    /// Time to a share of the full voltage and a little on it.
    fn arrival_s(&self, share: f64) -> f64 {
        share * self.full_v / self.slew_v_per_s
    }

    /// Time in which a voltage changes its sign under the slew of quick changes, with a little on it, s.
    fn reversal_s(&self, amplitude_v: f64) -> f64 {
        2.2 * amplitude_v / self.quick_slew_v_per_s
    }

    /// 4 ms, or as fast as commands come and the voltage may follow.
    fn fast_clock_s(&self, amplitude_v: f64) -> f64 {
        let wanted_s = self.reversal_s(amplitude_v).max(0.004);
        let periods = (wanted_s / self.period_s).round().max(1.0);
        periods * self.period_s
    }

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

    /// Every run begins at rest, for its own noise floor, which more samples make more accurate.
    fn after_rest(&self, parts: &[Segment]) -> Vec<Segment> {
        let rest = standstill((100.0 * self.period_s).clamp(0.5, 1.0));
        [&[rest], parts].concat()
    }

    fn slow_ramp(&self) -> Vec<Segment> {
        // No faster than half of what the current allows.
        let quarter_s = (2.0 * self.arrival_s(1.0)).max(2.5);
        let full_v = self.full_v;
        self.after_rest(&[
            ramp(0.0, -full_v, quarter_s, None),
            ramp(-full_v, full_v, 2.0 * quarter_s, None),
            ramp(full_v, 0.0, quarter_s, None),
        ])
    }

    fn heat_and_repeat(&self) -> Vec<Segment> {
        let part_s = self.arrival_s(1.0).max(0.2) + 0.15;
        let part = || steps(self.full_v, &[0.5, -0.5, 0.0], part_s);
        let heat = [1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 0.0];
        let heat = steps(self.full_v, &heat, self.arrival_s(2.0).max(0.2) + 0.05);
        self.after_rest(&[part(), heat, part()])
    }

    fn current_reversals(&self) -> Vec<Segment> {
        let levels = [1.0, -1.0, 0.5, -0.5, 0.0, 0.7, -0.7, 0.3, -0.3, 0.0, 1.0, 0.0, -1.0, 0.0];
        let hold_s = self.reversal_s(self.quick_v).max(0.12);
        let part = |times| steps(self.quick_v, &levels, times * hold_s);
        self.after_rest(&[part(1.0), part(2.0)])
    }

    fn dither_at_speed(&self) -> Vec<Segment> {
        // The dither's changes are quick, so the levels are reached by ramps; half of the current is left for each.
        let (level_v, dither_v) = (0.5 * self.full_v, 0.4 * self.quick_v);
        let change_s = (2.0 * self.arrival_s(0.5)).max(0.5);
        let part = |from_v, to_v, seconds, seed| {
            let dither =
                Dither { amplitude_v: dither_v, clock_s: self.fast_clock_s(dither_v), seed };
            ramp(from_v, to_v, seconds, Some(dither))
        };
        self.after_rest(&[
            part(0.0, 0.0, 1.0, 1),
            part(0.0, level_v, change_s, 2),
            part(level_v, level_v, 1.0, 3),
            part(level_v, -level_v, 2.0 * change_s, 4),
            part(-level_v, -level_v, 1.0, 5),
            part(-level_v, 0.0, change_s, 6),
        ])
    }

    /// Id, how fast the voltage may change, and the parts of each run of the menu.
    fn menu(&self) -> [(&'static str, Change, Vec<Segment>); COUNT] {
        let full_v = self.full_v;
        let hard = [1.0, -1.0, 1.0, 0.0, -1.0, 0.0, 0.5, -0.5, 0.0];
        let hard_s = self.arrival_s(2.0).max(0.2) + 0.15;
        let stairs = [0.25, 0.5, 0.75, 1.0, 0.6, 0.0, -0.25, -0.5, -0.75, -1.0, -0.6, 0.0];
        let stairs_s = self.arrival_s(0.6).max(0.2) + 0.5;
        // Large and small: play in a coupling does not grow with the torque.
        let dither = [(1.0, 1), (0.4, 2)].map(|(share, seed)| {
            let clock_s = self.fast_clock_s(share * self.quick_v);
            let seconds = (30.0 * clock_s).clamp(2.0, 4.0);
            random(share * self.quick_v, clock_s, seconds, seed, 2)
        });
        let slow_sine =
            Segment::Sine(Sine { amplitude_v: self.creep_v, frequency_hz: 0.4, seconds: 7.5 });
        let levels_s = self.arrival_s(0.4).max(10.0 * self.period_s);
        [
            ("rich", Change::Slewed, rich(full_v, self.slew_v_per_s, 1)),
            ("slow_ramp", Change::Slewed, self.slow_ramp()),
            ("fast_dither", Change::Quick, self.after_rest(&dither)),
            ("hard_cycling", Change::Slewed, self.after_rest(&[steps(full_v, &hard, hard_s)])),
            ("staircase", Change::Slewed, self.after_rest(&[steps(full_v, &stairs, stairs_s)])),
            ("slow_sine", Change::Slewed, self.after_rest(&[slow_sine])),
            ("standstill", Change::Slewed, vec![standstill(4.0)]),
            ("heat_and_repeat", Change::Slewed, self.heat_and_repeat()),
            (
                "random_levels",
                Change::Slewed,
                self.after_rest(&[random(0.6 * full_v, levels_s, 6.0, 3, 7)]),
            ),
            ("steady_hold", Change::Slewed, self.after_rest(&[steps(full_v, &[0.5], 4.0)])),
            ("current_reversals", Change::Quick, self.current_reversals()),
            ("dither_at_speed", Change::Quick, self.dither_at_speed()),
        ]
    }

    /// Recipe `index` of the menu.
    fn recipe(&self, index: usize) -> Recipe {
        let (id, change, segments) = self.menu()[index].clone();
        Recipe {
            id,
            segments: segments.into_iter().map(rounded).collect(),
            slew_v_per_s: figures(match change {
                Change::Slewed => self.slew_v_per_s,
                Change::Quick => self.quick_slew_v_per_s.max(self.slew_v_per_s),
            }),
        }
    }
}

/// Shares of the limits that a plan may use: a margin for the error of the model.
const VOLTAGE_SHARE: f64 = 0.95;
const CURRENT_SHARE: f64 = 0.85;
const SPEED_SHARE: f64 = 0.92;
/// Shortest period of a plan's rows and of its simulation steps, s: a menu of runs is expensive, and
/// the difference of two models needs less accuracy than a measurement.
pub(super) const SHORTEST_PERIOD_S: f64 = 2e-3;
/// Relative difference of duration and of squared voltage of two runs of one recipe, and instants that are compared.
const ALIKE: f64 = 0.1;
const INSTANTS: usize = 400;
const LONGEST_PERIOD_S: f64 = 0.05;
/// Most attempts to scale a recipe down.
const MOST_TRIALS: usize = 5;

/// Peak magnitudes of a run.
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
    /// Whether a run in hand is nearly the same: a repetition adds little information.
    pub(super) fn is_repeated_by(&self, run: &Scenario) -> bool {
        let seconds = |run: &Scenario| run.mean_period_s() * run.samples() as f64;
        let long_s = self.peaks.duration_s;
        if (seconds(run) / long_s - 1.0).abs() > ALIKE {
            return false;
        }
        let (mut apart, mut own) = (0.0, 0.0);
        for sample in 0..INSTANTS {
            let at_s = long_s * (sample as f64 + 0.5) / INSTANTS as f64;
            let [there, here] = [run, &self.blank].map(|run| run.input_at(run.begin_s() + at_s));
            apart += (there - here).powi(2);
            own += here * here;
        }
        apart <= ALIKE * own
    }

    /// Rows of the bench that one of the plan stands for.
    pub(super) const fn stands_for(&self) -> f64 {
        self.stands_for
    }

    /// Rows that the bench would record.
    pub(super) fn rows(&self) -> f64 {
        self.stands_for * self.blank.samples() as f64
    }

    /// The noise at which the rows of the plan have the information of those of the bench.
    pub(super) fn noise(&self, noise: NoiseFloor) -> NoiseFloor {
        NoiseFloor {
            current_a: noise.current_a / self.stands_for.sqrt(),
            speed_rad_s: noise.speed_rad_s / self.stands_for.sqrt(),
            ..noise
        }
    }

    /// The run as it would be measured, without noise, under the model `truth`.
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
    let whole_reach = levels(models.first()?, limits, period_s)?;
    let mut share = 1.0;
    for _ in 0..MOST_TRIALS {
        let recipe = whole_reach.smaller(share).recipe(index);
        let mut blank = blank(&recipe, period_s)?;
        let mut peaks = Peaks::default();
        for model in models {
            let mut run = blank.clone();
            fill(&mut run, model)?;
            run.find_scales();
            blank.scales = run.scales;
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
    let mut plant = Plant::new(model, Input::Voltage).ok()?.coarse(SHORTEST_PERIOD_S);
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
            // The model has no open circuit, so no recipe has one.
            Output::Coast => return None,
        };
        #[expect(clippy::float_cmp, reason = "exactly the same command")]
        let changes = events.last().is_none_or(|last| last.1 != voltage_v);
        if changes {
            events.push((time_s, voltage_v));
        }
    }
    let (input, channel) = (Input::Voltage, Channel::VoltageCmd);
    Some(Scenario {
        current_a: vec![0.0; rows],
        speed_rad_s: vec![0.0; rows],
        ..Scenario::planned(recipe.id, input, channel, events, times)
    })
}

/// Voltages for this motor; `None` for a model without an armature circuit, and without a limit of the current.
fn levels(model: &Model, limits: &ExperimentLimits, period_s: f64) -> Option<Levels> {
    if !(limits.current_a.is_finite() && limits.rms_current_a.is_finite()) {
        return None;
    }
    let motor = |key| model.motor.get(key);
    let (resistance, back_emf, inertia) =
        (motor(MotorKey::Resistance)?, motor(MotorKey::BackEmf)?, motor(MotorKey::Inertia)?);
    let load_a = motor(MotorKey::LoadTorque)? / model.motor.torque_constant()?;
    let idle_v = resistance * load_a;
    let voltage_v = VOLTAGE_SHARE * limits.voltage_v;
    let current_a = CURRENT_SHARE * limits.current_a;
    let full_v = voltage_v.min(idle_v + back_emf * SPEED_SHARE * limits.speed_rad_s);
    // While the voltage rises at s, the back-EMF lags by s R J/Ke^2: that over R is the current.
    let accelerating_a = (0.9 * (current_a - load_a)).max(0.1 * current_a);
    let slew_v_per_s = accelerating_a * back_emf * back_emf / inertia;
    let quick_v = voltage_v.min(current_a * resistance);
    let levels = Levels {
        full_v,
        quick_v,
        creep_v: full_v.min(2.0 * idle_v + 0.08 * full_v),
        // Faster than in a twentieth of a second is no slew.
        slew_v_per_s: slew_v_per_s.min(full_v / 0.05).min(limits.slew_v_per_s),
        quick_slew_v_per_s: (2.0 * quick_v / period_s).min(limits.slew_v_per_s),
        period_s,
    };
    (levels.full_v > 0.0 && levels.slew_v_per_s > 0.0 && levels.full_v.is_finite())
        .then_some(levels)
}

impl Peaks {
    fn of(run: &Scenario) -> Self {
        let squares: f64 = run.current_a.iter().map(|i| i * i).sum();
        let angle = run.shaft_angle();
        let start_rad = angle.first().map_or(0.0, |first| first.1);
        Self {
            voltage_v: largest(run.events.iter().map(|event| event.1)),
            current_a: largest(run.current_a.iter().copied()),
            speed_rad_s: largest(run.speed_rad_s.iter().copied()),
            rms_current_a: (squares / run.samples().max(1) as f64).sqrt(),
            travel_rad: largest(angle.iter().map(|point| point.1 - start_rad)),
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

    /// Largest of the peaks in units of what a plan may use; at most one within the limits.
    fn excess(&self, limits: &ExperimentLimits) -> f64 {
        let travel = limits.travel_rad.map_or(0.0, |limit| self.travel_rad / (SPEED_SHARE * limit));
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
