//! Run linearised along the Kalman filter of one model: innovations, and the transition of deviations from its trajectory.

use super::grid::Grid;
use super::kalman::{Dynamics, FilterGains, FilteredRun, Noise, filter_run, innovations_with};
use super::tangent::{Step, Tangent, propagate};
use crate::work::Work;
use drivebench_model::plant::{ActiveEffect, Model, Scenario, State};

pub(super) struct LinearisedRun<'a> {
    pub(super) model: Model,
    /// Events of this run alone.
    events: Vec<ActiveEffect>,
    pub(super) scenario: &'a Scenario,
    pub(super) start: State,
    pub(super) noise: Noise,
    pub(super) gains: FilterGains,
    pub(super) filtered: FilteredRun,
    pub(super) dynamics: Dynamics,
    /// Transitions of deviations between samples.
    pub(super) steps: Vec<Step>,
    /// The intervals over which tangents are propagated.
    pub(super) grid: Grid,
    /// Counter of the simulated sub-steps.
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

    /// With events of this run alone; simulated sub-steps are counted in `work`.
    pub(super) fn with(
        model: &Model,
        events: Vec<ActiveEffect>,
        scenario: &'a Scenario,
        start: State,
        noise: Noise,
        work: Option<&'a Work>,
    ) -> Option<Self> {
        let model = with_events(model, &events);
        let (gains, mut filtered) = filter_run(&model, scenario, start, &noise)?;
        let mut white = filtered.white.iter().flatten();
        if !white.all(|white| white.is_finite()) {
            return None;
        }
        let dynamics = Dynamics::of(&model, scenario)?;
        let transitions = gains.transitions.iter().zip(&gains.decays);
        let steps = transitions.map(|(transition, decay)| {
            if transition.interval_s > 0.0 {
                Step::of(transition, *decay, &dynamics)
            } else {
                Step::identity()
            }
        });
        let grid = Grid::of(&model, scenario, &dynamics, &noise, (&gains, &filtered));
        filtered.trace = None;
        Some(Self {
            steps: steps.collect(),
            grid,
            model,
            events,
            scenario,
            start,
            noise,
            gains,
            filtered,
            dynamics,
            work,
        })
    }

    /// The same run, or a part of it, linearised along another model.
    pub(super) fn relinearised<'b>(
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

    pub(super) fn count(&self, steps: u64) {
        if let Some(work) = self.work {
            work.add(steps);
        }
    }

    /// Change of the whitened innovations by another model, besides the run's own events, over `step`, in the whole run or
    /// the beginning of it that `scenario` is; zero where it cannot be simulated.
    pub(super) fn difference(&self, model: &Model, scenario: &Scenario, step: f64) -> Vec<f32> {
        let model = with_events(model, &self.events);
        let mut out = Vec::with_capacity(scenario.samples());
        let gains = &self.gains;
        let steps = innovations_with(gains, &model, scenario, self.start, &self.noise, &mut out);
        let Some(steps) = steps else {
            return vec![0.0; 2 * scenario.samples()];
        };
        self.count(steps);
        let over = 1.0 / step;
        let pairs = out.iter().zip(&self.filtered.white);
        let change = |(a, b): (&[f64; 2], &[f64; 2])| [0, 1].map(|k| single((b[k] - a[k]) * over));
        bounded(pairs.flat_map(change).collect())
    }

    /// Columns of at most [`LANES`](super::tangent::LANES) tangents.
    pub(super) fn tangent_columns(&self, tangents: &[&Tangent]) -> Vec<Vec<f32>> {
        let mut columns = vec![Vec::with_capacity(self.rows()); tangents.len()];
        propagate(self, tangents, |first, white| {
            for (lane, column) in columns.iter_mut().enumerate() {
                column.resize(2 * first, 0.0);
                column.extend(white.iter().map(|row| single(row[lane])));
            }
        });
        columns.into_iter().map(bounded).collect()
    }

    /// Rows of its columns: two for each sample, measured or not.
    pub(super) fn rows(&self) -> usize {
        2 * self.scenario.samples()
    }
}

/// Replaces a column that diverges (a stiff shaft in a form far from the run) by zeros. Columns of the motor's parameters reach
/// 1e6 standard deviations; beyond 1e12 the normal equations are singular in double precision.
fn bounded(column: Vec<f32>) -> Vec<f32> {
    if column.iter().all(|cell| cell.abs() < 1e12) { column } else { vec![0.0; column.len()] }
}

/// Sum of the squares of the innovations.
pub(super) fn squares(runs: &[LinearisedRun<'_>]) -> f64 {
    let white = runs.iter().flat_map(|run| run.filtered.white.iter());
    white.flatten().map(|value| value * value).sum()
}

pub(super) fn with_events(model: &Model, events: &[ActiveEffect]) -> Model {
    let mut model = model.clone();
    model.effects.extend_from_slice(events);
    model
}

#[expect(clippy::cast_possible_truncation, reason = "columns are stored in single precision")]
const fn single(value: f64) -> f32 {
    value as f32
}
