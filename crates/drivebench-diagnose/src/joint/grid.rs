//! Intervals over which deviations from the trajectory of a linearised run are propagated: those between samples, or shorter ones
//! where the current settles within an interval or the sensors lag behind the motion.

use std::borrow::Cow;

use super::kalman::{Dynamics, FilterGains, FilteredRun, Noise, Transition};
use super::process_noise::constants;
use super::tangent::Step;
use drivebench_model::numerics::propagator::Propagator;
use drivebench_model::plant::{Instant, Model, Scenario, ShaftAngle, SubStep};

/// Motion over one interval.
#[derive(Clone, Copy, Debug)]
pub(super) struct Motion {
    pub(super) interval_s: f64,
    /// Direction; zero at rest.
    pub(super) direction: f64,
    /// Mean rates of current, A/s, and speed, rad/s2.
    pub(super) rates: [f64; 2],
}

/// The intervals of a run.
pub(super) struct Grid {
    /// Transitions of deviations; those of the run where they are the same.
    steps: Vec<Step>,
    /// The middle of each interval.
    pub(super) instants: Vec<Instant>,
    pub(super) motions: Vec<Motion>,
    /// Number of intervals up to each sample, that one included; empty where every interval ends at a sample.
    ends: Vec<usize>,
}

impl Grid {
    /// Of a run that was filtered with `model`.
    pub(super) fn of(
        model: &Model,
        scenario: &Scenario,
        dynamics: &Dynamics,
        noise: &Noise,
        (gains, filtered): (&FilterGains, &FilteredRun),
    ) -> Self {
        let middle = Middle::of(model, scenario);
        match &filtered.trace {
            Some(trace) => refined(trace, scenario, dynamics, noise, &middle),
            None => at_samples(scenario, gains, filtered, &middle),
        }
    }

    pub(super) fn is_refined(&self) -> bool {
        !self.ends.is_empty()
    }

    /// The transitions of the intervals, `at_samples` where they end at samples.
    pub(super) fn steps<'a>(&'a self, at_samples: &'a [Step]) -> &'a [Step] {
        if self.is_refined() { &self.steps } else { at_samples }
    }

    /// The number of the first sample that ends an interval of this number or a later one.
    pub(super) fn sample_from(&self, interval: usize) -> usize {
        if self.is_refined() { self.ends.partition_point(|end| *end <= interval) } else { interval }
    }

    /// Whether the interval ends at this sample.
    pub(super) fn ends_at(&self, interval: usize, sample: usize) -> bool {
        self.ends.get(sample).is_none_or(|end| *end == interval + 1)
    }

    /// The interval in which a command acts; a refined one begins with it.
    pub(super) fn interval_at(&self, scenario: &Scenario, acts_s: f64) -> usize {
        if self.is_refined() {
            let since_s = acts_s - scenario.begin_s();
            return self.instants.partition_point(|middle| middle.time_s <= since_s);
        }
        scenario.sample_time_s.partition_point(|sample_s| *sample_s <= acts_s)
    }
}

/// What the middles of the intervals have in common.
struct Middle<'a> {
    scenario: &'a Scenario,
    motor: Instant,
    angles: Cow<'a, [(f64, f64)]>,
}

impl<'a> Middle<'a> {
    fn of(model: &Model, scenario: &'a Scenario) -> Self {
        let (motor, angles) = (constants(model, scenario), scenario.shaft_angle());
        Self { scenario, motor, angles }
    }

    fn instant(&self, mid_s: f64, input: f64, [current_a, speed_rad_s]: [f64; 2]) -> Instant {
        let angles = &self.angles;
        let next = angles.partition_point(|point| point.0 <= mid_s);
        let angle_rad = match (next.checked_sub(1).map(|k| angles[k]), angles.get(next)) {
            (Some(before), Some(after)) => {
                before.1 + (mid_s - before.0) / (after.0 - before.0) * (after.1 - before.1)
            }
            (Some(point), None) => point.1,
            (None, after) => after.map_or(0.0, |after| after.1),
        };
        Instant {
            time_s: mid_s - self.scenario.begin_s(),
            voltage_v: input,
            current_a,
            speed_rad_s,
            angle: ShaftAngle::at(angle_rad),
            ..self.motor
        }
    }
}

fn at_samples(
    scenario: &Scenario,
    gains: &FilterGains,
    filtered: &FilteredRun,
    middle: &Middle<'_>,
) -> Grid {
    let (mut instants, mut motions) = (Vec::new(), Vec::new());
    for (sample, transition) in gains.transitions.iter().enumerate() {
        let last = sample.saturating_sub(1);
        let [from, to] = [filtered.after[last], filtered.before[sample]];
        let mid_s = 0.5 * (scenario.sample_time_s[last] + scenario.sample_time_s[sample]);
        let mean = [0, 1].map(|k| 0.5 * (from[k] + to[k]));
        let interval_s = transition.interval_s;
        let has_passed = sample > 0 && interval_s > 0.0;
        let rates = [0, 1].map(|k| if has_passed { (to[k] - from[k]) / interval_s } else { 0.0 });
        instants.push(middle.instant(mid_s, scenario.input_at(mid_s), mean));
        motions.push(Motion { interval_s, direction: transition.direction, rates });
    }
    Grid { steps: Vec::new(), instants, motions, ends: Vec::new() }
}

fn refined(
    trace: &[SubStep],
    scenario: &Scenario,
    dynamics: &Dynamics,
    noise: &Noise,
    middle: &Middle<'_>,
) -> Grid {
    let mut grid = Grid {
        steps: vec![Step::identity()],
        instants: vec![middle.instant(scenario.begin_s(), scenario.events[0].1, [0.0; 2])],
        motions: vec![Motion { interval_s: 0.0, direction: 0.0, rates: [0.0; 2] }],
        ends: Vec::new(),
    };
    // Four intervals between two samples: the sensors take a deviation as linear over each.
    let longest_s = 0.25 * scenario.scales.period_s;
    let mut trace = trace.iter().peekable();
    let mut last_input = f64::NAN;
    let mut cached: (f64, [Propagator; 2]) = (-1.0, [Propagator::default(); 2]);
    for sample_s in &scenario.sample_time_s {
        // After a change of the input intervals grow in proportion to the time since then.
        let mut changed_s = f64::NEG_INFINITY;
        // Rounding: the last sub-step ends at the sample.
        let is_before = |next: &&SubStep| next.begin_s + 0.5 * next.length_s < *sample_s;
        while let Some(first) = trace.next_if(is_before) {
            if is_another(first.input, last_input) {
                (changed_s, last_input) = (first.begin_s, first.input);
            }
            let most_s = longest_s.min(first.begin_s - changed_s);
            let mut merged = Merged::of(first);
            let fits = |merged: &Merged, next: &SubStep| {
                merged.length_s + next.length_s <= most_s * (1.0 + 1e-6)
                    && !is_another(next.input, last_input)
                    && !is_another(next.directions[1], merged.direction)
            };
            while let Some(next) = trace.next_if(|next| is_before(next) && fits(&merged, next)) {
                merged.add(next);
            }
            let length_s = merged.length_s;
            if (length_s - cached.0).abs() > 1e-6 * length_s {
                cached = (length_s, [false, true].map(|rests| dynamics.over(length_s, rests)));
            }
            let transition = Transition {
                propagator: cached.1[usize::from(merged.direction == 0.0)],
                interval_s: length_s,
                direction: merged.direction,
                speed_factor: if merged.rests { 0.0 } else { 1.0 },
                input_keeps: dynamics.mean_input(length_s, 1.0).0,
                ..Transition::default()
            };
            let decay = (-length_s / noise.correlation_s).exp();
            grid.steps.push(Step::of(&transition, decay, dynamics));
            let mean = merged.integral.map(|sum| sum / length_s);
            let mid_s = first.begin_s + 0.5 * length_s;
            grid.instants.push(middle.instant(mid_s, first.input, mean));
            grid.motions.push(Motion {
                interval_s: length_s,
                direction: merged.direction,
                rates: [0, 1].map(|k| (merged.to[k] - first.from[k]) / length_s),
            });
        }
        grid.ends.push(grid.steps.len());
    }
    grid
}

/// Whether a command or a direction is not the same number.
const fn is_another(a: f64, b: f64) -> bool {
    a.to_bits() != b.to_bits()
}

/// Sub-steps of one input and one direction of motion as one interval.
struct Merged {
    length_s: f64,
    direction: f64,
    /// Whether the shaft rests at the begin or the end of any.
    rests: bool,
    /// Integrals of current and speed.
    integral: [f64; 2],
    to: [f64; 2],
}

impl Merged {
    fn of(first: &SubStep) -> Self {
        let mut merged = Self {
            length_s: 0.0,
            direction: first.directions[1],
            rests: false,
            integral: [0.0; 2],
            to: first.to,
        };
        merged.add(first);
        merged
    }

    fn add(&mut self, next: &SubStep) {
        self.length_s += next.length_s;
        self.rests |= next.directions.contains(&0.0);
        for (k, integral) in self.integral.iter_mut().enumerate() {
            *integral += 0.5 * next.length_s * (next.from[k] + next.to[k]);
        }
        self.to = next.to;
    }
}
