//! Figures 4 and 5, with and without adaptive compensation: response and error to a polyline reference, and a load that is
//! applied and removed at constant speed.

use serde::Serialize;

use super::{LOAD_N_M, PERIOD_S, SEED, SETTINGS, SPEED_RAD_S, input_noise, on_paper, without};
use crate::control::{PaperBSettings, TrialPoint};
use crate::workflow::reproduce::loops::{
    Bench, LoadChange, effort_v, error, load_change, rms, within,
};

/// Reference: time s, speed rad/s.
const POLYLINE: [(f64, f64); 7] = [
    (0.0, 0.0),
    (0.3, 100.0),
    (0.8, 100.0),
    (1.0, 150.0),
    (1.5, 150.0),
    (1.9, 50.0),
    (2.5, 50.0),
];
/// After a corner the flat parts are given this time, s.
const SETTLED_S: f64 = 0.2;

/// One of the two regulators.
#[derive(Clone, Debug, Serialize)]
pub struct Followed {
    pub compensated: bool,
    pub absolute_error_rad: f64,
    pub largest_error_rad_s: f64,
    /// Root mean square on the slopes, and on the flat parts 0.2 s after their corner.
    pub slope_error_rad_s: f64,
    pub flat_error_rad_s: f64,
    /// Mean on those flat parts.
    pub flat_mean_rad_s: f64,
    /// Beyond the corners' speeds, rad/s.
    pub overshoot_rad_s: f64,
    pub effort_v: f64,
    #[serde(skip)]
    pub trace: Vec<TrialPoint>,
}

#[derive(Clone, Debug, Serialize)]
pub struct Figure4 {
    pub polyline: [(f64, f64); 7],
    /// Without compensation, then with it.
    pub courses: [Followed; 2],
}

/// The reference at a time, s.
pub(super) fn polyline(time_s: f64) -> f64 {
    let next = POLYLINE.partition_point(|corner| corner.0 <= time_s);
    if next == POLYLINE.len() {
        return POLYLINE[next - 1].1;
    }
    let ((from_s, from), (to_s, to)) = (POLYLINE[next - 1], POLYLINE[next]);
    from + (to - from) * (time_s - from_s) / (to_s - from_s)
}

pub(super) fn length_s() -> f64 {
    POLYLINE[POLYLINE.len() - 1].0
}

pub(super) fn figure_4(bench: &Bench) -> Figure4 {
    let noise = input_noise(bench, SEED, length_s());
    let course = |settings: PaperBSettings| {
        let trial = on_paper(bench, polyline).with_load(&noise);
        let trace = trial.run(&mut bench.paper_b(settings), length_s());
        measured(settings.compensation > 0.0, trace)
    };
    Figure4 {
        polyline: POLYLINE,
        courses: [course(without(SETTINGS)), course(SETTINGS)],
    }
}

fn measured(compensated: bool, trace: Vec<TrialPoint>) -> Followed {
    let slope = |point: &&TrialPoint| {
        (polyline(point.time_s + PERIOD_S) - polyline(point.time_s)).abs() > 1e-9
    };
    let flat = |point: &&TrialPoint| {
        let since = polyline(point.time_s - SETTLED_S.min(point.time_s));
        !slope(point) && (since - point.reference_rad_s).abs() < 1e-9
    };
    let flat_errors: Vec<f64> = trace.iter().filter(flat).map(error).collect();
    let beyond = |point: &TrialPoint| {
        // Only at the end of a slope: the reference has stopped, the shaft has not.
        let since = polyline((point.time_s - SETTLED_S).max(0.0));
        let way = (point.reference_rad_s - since).signum();
        if (point.reference_rad_s - since).abs() > 1e-9 && !slope(&point) {
            -way * error(point)
        } else {
            0.0
        }
    };
    Followed {
        compensated,
        absolute_error_rad: PERIOD_S * trace.iter().map(|point| error(point).abs()).sum::<f64>(),
        largest_error_rad_s: trace.iter().map(|p| error(p).abs()).fold(0.0, f64::max),
        slope_error_rad_s: rms(trace.iter().filter(slope).map(error)),
        flat_error_rad_s: rms(flat_errors.iter().copied()),
        flat_mean_rad_s: flat_errors.iter().sum::<f64>() / flat_errors.len().max(1) as f64,
        overshoot_rad_s: trace.iter().map(beyond).fold(0.0, f64::max),
        effort_v: effort_v(&trace),
        trace,
    }
}

const ON_S: f64 = 0.8;
const OFF_S: f64 = 1.4;
const END_S: f64 = 2.0;

#[derive(Clone, Debug, Serialize)]
pub struct Loaded {
    pub compensated: bool,
    pub applied: LoadChange,
    pub removed: LoadChange,
    pub effort_v: f64,
    #[serde(skip)]
    pub trace: Vec<TrialPoint>,
}

#[derive(Clone, Debug, Serialize)]
pub struct Figure5 {
    pub speed_rad_s: f64,
    pub load_n_m: f64,
    /// Without compensation, then with it.
    pub courses: [Loaded; 2],
}

pub(super) fn figure_5(bench: &Bench) -> Figure5 {
    let noise = input_noise(bench, SEED, END_S);
    let load = |t: f64| {
        let is_on = (ON_S..OFF_S).contains(&t);
        noise(t) + if is_on { LOAD_N_M } else { 0.0 }
    };
    let course = |settings: PaperBSettings| {
        let trial = on_paper(bench, |_| SPEED_RAD_S).with_load(load);
        let trace = trial.run(&mut bench.paper_b(settings), END_S);
        Loaded {
            compensated: settings.compensation > 0.0,
            applied: load_change(&trace, ON_S, OFF_S),
            removed: load_change(&trace, OFF_S, END_S),
            effort_v: effort_v(&within(&trace, ON_S, f64::INFINITY)),
            trace,
        }
    };
    Figure5 {
        speed_rad_s: SPEED_RAD_S,
        load_n_m: LOAD_N_M,
        courses: [course(without(SETTINGS)), course(SETTINGS)],
    }
}
