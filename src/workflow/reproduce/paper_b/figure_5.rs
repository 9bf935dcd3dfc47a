//! Figure 5: a load is applied and removed at constant speed.

use serde::Serialize;

use super::{LOAD_N_M, SETTINGS, SPEED_RAD_S, input_noise, on_paper, paper_machine, without};
use crate::control::TrialPoint;
use crate::workflow::reproduce::loops::{Bench, LoadChange, effort_v, load_change};

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
    let noise = input_noise(bench, super::SEED, END_S);
    let load = |t: f64| {
        let load = if (ON_S..OFF_S).contains(&t) {
            LOAD_N_M
        } else {
            0.0
        };
        load + noise(t)
    };
    let course = |settings| {
        let machine = paper_machine(bench);
        let trace = on_paper(bench, &machine, settings, &|_| SPEED_RAD_S, &load, END_S);
        let from = |at_s: f64| trace.iter().filter(move |point| point.time_s >= at_s);
        let loaded: Vec<TrialPoint> = from(ON_S).copied().collect();
        Loaded {
            compensated: settings.compensation > 0.0,
            applied: load_change(&trace, ON_S, OFF_S),
            removed: load_change(&trace, OFF_S, END_S),
            effort_v: effort_v(&loaded),
            trace,
        }
    };
    Figure5 {
        speed_rad_s: SPEED_RAD_S,
        load_n_m: LOAD_N_M,
        courses: [course(without(SETTINGS)), course(SETTINGS)],
    }
}
