//! Every regulator on the same cases.

use serde::Serialize;

use super::{Bench, Kind, Step, Trial, effort_v, error, load_change, square, steps, within};
use crate::control::{PaperBSettings, TrialPoint};

/// What a bench is put through.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Case {
    #[default]
    Nominal,
    Lighter,
    Heavier,
    Start,
    Load,
}

impl Case {
    pub const ALL: [Self; 5] = [
        Self::Nominal,
        Self::Lighter,
        Self::Heavier,
        Self::Start,
        Self::Load,
    ];

    pub const fn name(self) -> &'static str {
        match self {
            Self::Nominal => "step",
            Self::Lighter => "step, inertia / 4",
            Self::Heavier => "step, inertia x 5",
            Self::Start => "start and brake",
            Self::Load => "load on and off",
        }
    }

    /// Inertia over the model's before and after the jump.
    const fn ratio(self) -> f64 {
        match self {
            Self::Lighter => 0.25,
            Self::Heavier => 5.0,
            _ => 1.0,
        }
    }
}

/// One regulator in one case: the worst of the steps that count, or of the two changes of the load.
#[derive(Clone, Debug, Default, Serialize)]
pub struct CaseRow {
    pub controller: Kind,
    pub case: Case,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub overshoot_percent: Option<f64>,
    /// `None` (in JSON left out) where the case has no step, `Some(None)` (null) where a step never settled.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub settling_s: Option<Option<f64>>,
    /// Mean over the steps, rad; over both changes of the load there.
    pub absolute_error_rad: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub dip_rad_s: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub recovery_s: Option<Option<f64>>,
    /// Root mean square of the output's change from cycle to cycle, V.
    pub effort_v: f64,
}

#[derive(Clone, Debug, Serialize)]
pub struct Comparison {
    pub bench: String,
    pub period_s: f64,
    pub delay_cycles: f64,
    pub levels_rad_s: [f64; 2],
    pub half_period_s: f64,
    pub start_rad_s: f64,
    pub load_n_m: f64,
    /// What `paper-b` was given on this bench.
    pub paper_b: PaperBSettings,
    pub rows: Vec<CaseRow>,
}

impl Comparison {
    pub fn row(&self, controller: Kind, case: Case) -> Option<&CaseRow> {
        let matches = |row: &&CaseRow| row.controller == controller && row.case == case;
        self.rows.iter().find(matches)
    }
}

/// Sizes of the cases of a bench.
#[derive(Clone, Copy, Debug)]
pub(in crate::workflow::reproduce) struct Sizes {
    pub levels_rad_s: [f64; 2],
    pub half_s: f64,
    pub start_rad_s: f64,
    pub load_n_m: f64,
}

pub(in crate::workflow::reproduce) fn comparison(bench: &Bench, sizes: &Sizes) -> Comparison {
    let rows = Kind::ALL
        .into_iter()
        .flat_map(|kind| Case::ALL.map(|case| row(bench, sizes, kind, case)))
        .collect();
    Comparison {
        bench: bench.name.to_owned(),
        period_s: bench.timing.period_s,
        delay_cycles: bench.timing.delay_cycles(),
        levels_rad_s: sizes.levels_rad_s,
        half_period_s: sizes.half_s,
        start_rad_s: sizes.start_rad_s,
        load_n_m: sizes.load_n_m,
        paper_b: bench.paper_b,
        rows,
    }
}

/// Steps before the jump of the inertia, and in all; those from the second one after the jump on count.
const JUMP: usize = 2;
const STEPS: usize = 8;
const COUNTED_FROM: usize = JUMP + 1;

fn row(bench: &Bench, sizes: &Sizes, kind: Kind, case: Case) -> CaseRow {
    let half_s = sizes.half_s;
    let [low, high] = sizes.levels_rad_s;
    let reference: Box<dyn Fn(f64) -> f64> = match case {
        Case::Start => Box::new(square(half_s, sizes.start_rad_s, 0.0)),
        Case::Load => Box::new(move |_| 0.5 * (low + high)),
        _ => Box::new(square(half_s, high, low)),
    };
    let jump_s = half_s * JUMP as f64;
    let [on_s, off_s, end_s] = [2.0, 3.0, 4.0].map(|halves| halves * half_s);
    let loaded = move |t: f64| case == Case::Load && t >= on_s && t < off_s;
    let load = |t| if loaded(t) { sizes.load_n_m } else { 0.0 };
    let trace = Trial::of(bench, reference)
        .with_inertia_ratio(bench, |t| if t >= jump_s { case.ratio() } else { 1.0 })
        .with_load(load)
        .run(&mut *bench.controller(kind), half_s * STEPS as f64);
    let found = if case == Case::Load {
        of_load(&trace, [on_s, off_s, end_s])
    } else {
        of_steps(&steps(&trace)[COUNTED_FROM..])
    };
    CaseRow {
        controller: kind,
        case,
        ..found
    }
}

/// The longest of these times; none where one of them never comes.
fn longest(times_s: impl IntoIterator<Item = Option<f64>>) -> Option<f64> {
    let mut times_s = times_s.into_iter();
    times_s.try_fold(0.0, |worst: f64, time_s| Some(worst.max(time_s?)))
}

fn of_steps(counted: &[Step]) -> CaseRow {
    let mean =
        |of: fn(&Step) -> f64| counted.iter().map(of).sum::<f64>() / counted.len().max(1) as f64;
    let overshoot = counted.iter().map(|step| step.response.overshoot_percent);
    let settling = counted.iter().map(|step| step.response.settling_s);
    CaseRow {
        overshoot_percent: Some(overshoot.fold(0.0, f64::max)),
        settling_s: Some(longest(settling)),
        absolute_error_rad: mean(|step| step.response.absolute_error_rad),
        effort_v: mean(|step| step.effort_v),
        ..CaseRow::default()
    }
}

fn of_load(trace: &[TrialPoint], [on_s, off_s, end_s]: [f64; 3]) -> CaseRow {
    let changes = [
        load_change(trace, on_s, off_s),
        load_change(trace, off_s, end_s),
    ];
    let seen = within(trace, on_s, end_s);
    let period_s = trace[1].time_s - trace[0].time_s;
    let errors = seen.iter().map(|point| error(point).abs());
    CaseRow {
        absolute_error_rad: period_s * errors.sum::<f64>(),
        dip_rad_s: Some(changes[0].dip_rad_s.max(changes[1].dip_rad_s)),
        recovery_s: Some(longest(changes.map(|change| change.recovery_s))),
        effort_v: effort_v(&seen),
        ..CaseRow::default()
    }
}
