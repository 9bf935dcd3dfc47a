//! Speed from Hall edges: 12 per turn at two pole pairs. What the time between edges does to the loop.

use serde::Serialize;

use super::figures::{length_s, polyline};
use super::{POLE_PAIRS, SETTINGS, on_paper};
use crate::control::{HallSensor, PaperBSettings, TrialPoint};
use crate::workflow::reproduce::loops::{Bench, Named, effort_v, error, mean_and_std, rms};

/// Edges per electrical turn.
const STATES: f64 = 6.0;
const SPEEDS_RAD_S: [f64; 5] = [10.0, 30.0, 60.0, 100.0, 157.0];
const LENGTH_S: f64 = 3.0;
const SETTLED_S: f64 = 1.5;
/// A slower design beside the chosen one: its voltage costs this much more.
const SLOWER: f64 = 100.0;

/// A constant speed, regulated on what is seen.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct AtSpeed {
    pub speed_rad_s: f64,
    /// Periods from one edge to the next.
    pub interval_periods: f64,
    /// With the true speed, with Hall edges, with Hall edges and the slower design.
    pub std_rad_s: [f64; 3],
    pub mean_error_rad_s: [f64; 3],
    pub effort_v: [f64; 3],
}

#[derive(Clone, Debug, Serialize)]
pub struct Hall {
    pub edges_per_turn: f64,
    pub slower_voltage_cost: f64,
    pub speeds: Vec<AtSpeed>,
    /// Root mean square error over the polyline of Figure 4: true speed, Hall edges, slower design.
    pub polyline_error_rad_s: [f64; 3],
    pub shown: Vec<Named>,
}

pub(super) fn hall(bench: &Bench) -> Hall {
    let edges_per_turn = STATES * POLE_PAIRS;
    let slower = PaperBSettings {
        voltage_cost: SLOWER * SETTINGS.voltage_cost,
        ..SETTINGS
    };
    // On the paper's plant, with friction and without other noise: what is seen is then the edges' doing alone.
    let run = |sees_edges: bool, settings, reference: &dyn Fn(f64) -> f64, seconds| {
        let mut trial = on_paper(bench, reference);
        trial.machine.speed_noise_rad_s = 0.0;
        if sees_edges {
            trial.sensor = Box::new(HallSensor::new(edges_per_turn));
        }
        trial.run(&mut bench.paper_b(settings), seconds)
    };
    let ways = [(false, SETTINGS), (true, SETTINGS), (true, slower)];
    let at = |speed_rad_s: f64| {
        let found = ways.map(|(edges, settings)| {
            let trace = run(edges, settings, &|_| speed_rad_s, LENGTH_S).into_iter();
            let settled = trace.filter(|point| point.time_s > SETTLED_S);
            let settled: Vec<TrialPoint> = settled.collect();
            let (mean, std) = mean_and_std(&settled);
            (std, speed_rad_s - mean, effort_v(&settled))
        });
        let per_period = edges_per_turn * speed_rad_s * bench.timing.period_s;
        AtSpeed {
            speed_rad_s,
            interval_periods: std::f64::consts::TAU / per_period,
            std_rad_s: found.map(|found| found.0),
            mean_error_rad_s: found.map(|found| found.1),
            effort_v: found.map(|found| found.2),
        }
    };
    let traces = ways.map(|(edges, settings)| run(edges, settings, &polyline, length_s()));
    let names = ["true speed", "Hall edges", "Hall edges, slower design"];
    Hall {
        edges_per_turn,
        slower_voltage_cost: slower.voltage_cost,
        speeds: SPEEDS_RAD_S.map(at).into(),
        polyline_error_rad_s: traces.each_ref().map(|trace| rms(trace.iter().map(error))),
        shown: Named::all(names, traces),
    }
}
