//! A run linearised along the Kalman filter of one model: its innovations, and how deviations from its trajectory go on.

use super::kalman::{Dynamics, Followed, Follower, Noise, follow, lead};
use super::process_noise::constants;
use super::tangent::{Step, Tangent, carry};
use crate::work::Work;
use drivebench_model::plant::{ActiveEffect, Input, Instant, Model, Scenario, ShaftAngle, State};

pub(super) struct LinearisedRun<'a> {
    pub(super) model: Model,
    /// What of the model happens in this run alone.
    events: Vec<ActiveEffect>,
    pub(super) scenario: &'a Scenario,
    pub(super) start: State,
    pub(super) noise: Noise,
    pub(super) follower: Follower,
    pub(super) followed: Followed,
    pub(super) dynamics: Dynamics,
    /// The middle of the interval before each sample.
    pub(super) instants: Vec<Instant>,
    /// Transition of deviations over that interval.
    pub(super) steps: Vec<Step>,
    /// Where simulations of it are counted.
    work: Option<&'a Work>,
}

impl<'a> LinearisedRun<'a> {
    pub(super) fn new(
        model: &Model,
        scenario: &'a Scenario,
        start: State,
        noise: Noise,
    ) -> Option<Self> {
        Self::with(model, vec![], scenario, start, noise, None)
    }

    /// With events that other runs do not have; its simulations are counted in `work`.
    pub(super) fn with(
        model: &Model,
        events: Vec<ActiveEffect>,
        scenario: &'a Scenario,
        start: State,
        noise: Noise,
        work: Option<&'a Work>,
    ) -> Option<Self> {
        let model = with_events(model, &events);
        let (follower, followed) = lead(&model, scenario, start, &noise)?;
        let mut white = followed.white.iter().flatten();
        if !white.all(|white| white.is_finite()) {
            return None;
        }
        let dynamics = Dynamics::of(&model, scenario.input)?;
        let passages = follower.passages.iter().zip(&follower.forgets);
        let steps = passages.map(|(passage, forget)| {
            if passage.interval_s > 0.0 {
                Step::of(passage, *forget, &dynamics)
            } else {
                Step::still()
            }
        });
        Some(Self {
            steps: steps.collect(),
            instants: instants(&model, scenario, &followed),
            model,
            events,
            scenario,
            start,
            noise,
            follower,
            followed,
            dynamics,
            work,
        })
    }

    /// The same run, or a part of it, around another model.
    pub(super) fn around<'b>(
        &self,
        model: &Model,
        events: Vec<ActiveEffect>,
        scenario: &'b Scenario,
    ) -> Option<LinearisedRun<'b>>
    where
        'a: 'b,
    {
        LinearisedRun::with(model, events, scenario, self.start, self.noise, self.work)
    }

    /// Counts sub-steps that were simulated of it.
    pub(super) fn count(&self, steps: u64) {
        if let Some(work) = self.work {
            work.add(steps);
        }
    }

    /// Change of the whitened innovations by another model, beside the run's own events, over `step`, in the whole run or
    /// the beginning of it that `scenario` is; zero where it cannot be simulated.
    pub(super) fn difference(&self, model: &Model, scenario: &Scenario, step: f64) -> Vec<f32> {
        let model = with_events(model, &self.events);
        let mut out = Vec::with_capacity(scenario.samples());
        let follower = &self.follower;
        let steps = follow(follower, &model, scenario, self.start, &self.noise, &mut out);
        let Some(steps) = steps else {
            return vec![0.0; 2 * scenario.samples()];
        };
        self.count(steps);
        let over = 1.0 / step;
        let pairs = out.iter().zip(&self.followed.white);
        let change = |(a, b): (&[f64; 2], &[f64; 2])| [0, 1].map(|k| single((b[k] - a[k]) * over));
        bounded(pairs.flat_map(change).collect())
    }

    /// Columns of as many tangents as there are lanes, or fewer.
    pub(super) fn along(&self, tangents: &[&Tangent]) -> Vec<Vec<f32>> {
        let mut columns = vec![Vec::with_capacity(self.rows()); tangents.len()];
        carry(self, tangents, |first, white| {
            for (lane, column) in columns.iter_mut().enumerate() {
                column.resize(2 * first, 0.0);
                column.extend(white.iter().map(|row| single(row[lane])));
            }
        });
        columns.into_iter().map(bounded).collect()
    }

    /// Two for each sample, whether measured or not.
    pub(super) fn rows(&self) -> usize {
        2 * self.scenario.samples()
    }
}

/// Zero in the place of a column that grows without bound along the run, as the oscillation of a stiff shaft in a form far from
/// the run: the motor's own parameters reach 1e6 standard deviations, and one larger number spoils every solution.
fn bounded(column: Vec<f32>) -> Vec<f32> {
    if column.iter().all(|cell| cell.abs() < 1e12) { column } else { vec![0.0; column.len()] }
}

/// Sum of the squares of the innovations.
pub(super) fn squares(runs: &[LinearisedRun<'_>]) -> f64 {
    let white = runs.iter().flat_map(|run| run.followed.white.iter());
    white.flatten().map(|value| value * value).sum()
}

pub(super) fn with_events(model: &Model, events: &[ActiveEffect]) -> Model {
    let mut model = model.clone();
    model.effects.extend_from_slice(events);
    model
}

#[expect(clippy::cast_possible_truncation, reason = "stored like this")]
const fn single(value: f64) -> f32 {
    value as f32
}

fn instants(model: &Model, scenario: &Scenario, followed: &Followed) -> Vec<Instant> {
    let angles = scenario.shaft_angle();
    let motor = constants(model, scenario);
    let instant = |sample: usize| {
        let from = sample.saturating_sub(1);
        let mid_s = 0.5 * (scenario.sample_time_s[from] + scenario.sample_time_s[sample]);
        let next = angles.partition_point(|point| point.0 <= mid_s);
        let angle_rad = match (next.checked_sub(1).map(|k| angles[k]), angles.get(next)) {
            (Some(before), Some(after)) => {
                before.1 + (mid_s - before.0) / (after.0 - before.0) * (after.1 - before.1)
            }
            (Some(point), None) => point.1,
            (None, after) => after.map_or(0.0, |after| after.1),
        };
        let mean = |k: usize| 0.5 * (followed.after[from][k] + followed.before[sample][k]);
        let input = scenario.input_at(mid_s);
        let by_voltage = scenario.input == Input::Voltage;
        Instant {
            time_s: mid_s - scenario.begin_s(),
            voltage_v: input,
            current_a: if by_voltage { mean(0) } else { input },
            speed_rad_s: mean(1),
            angle: ShaftAngle::at(angle_rad),
            ..motor
        }
    };
    (0..scenario.samples()).map(instant).collect()
}
