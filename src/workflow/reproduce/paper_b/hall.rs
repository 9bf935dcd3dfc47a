//! Speed from Hall edges: 12 per turn at two pole pairs. What the time between edges does to the loop.

use serde::Serialize;

use super::figures::{length_s, polyline};
use super::{POLE_PAIRS, SETTINGS, paper_machine};
use crate::control::{Direct, HallSensor, PaperBSettings, SpeedSensor, TrialMachine, TrialPoint};
use crate::workflow::reproduce::loops::{Bench, Named, effort_v, rms, std};

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

#[derive(Clone, Copy)]
enum Seen {
    True,
    Edges,
}

pub(super) fn hall(bench: &Bench) -> Hall {
    let slower = PaperBSettings {
        voltage_cost: SLOWER * SETTINGS.voltage_cost,
        ..SETTINGS
    };
    let ways = [
        (Seen::True, SETTINGS),
        (Seen::Edges, SETTINGS),
        (Seen::Edges, slower),
    ];
    let at = |speed_rad_s: f64| {
        let found = ways.map(|(seen, settings)| {
            let trace = run(bench, seen, settings, &|_| speed_rad_s, LENGTH_S);
            let settled: Vec<TrialPoint> = trace
                .into_iter()
                .filter(|point| point.time_s > SETTLED_S)
                .collect();
            let speeds: Vec<f64> = settled.iter().map(|point| point.speed_rad_s).collect();
            let mean = speeds.iter().sum::<f64>() / speeds.len().max(1) as f64;
            (std(&speeds), speed_rad_s - mean, effort_v(&settled))
        });
        AtSpeed {
            speed_rad_s,
            interval_periods: std::f64::consts::TAU
                / (edges() * speed_rad_s * bench.timing.period_s),
            std_rad_s: found.map(|found| found.0),
            mean_error_rad_s: found.map(|found| found.1),
            effort_v: found.map(|found| found.2),
        }
    };
    let traces = ways.map(|(seen, settings)| run(bench, seen, settings, &polyline, length_s()));
    let error = |trace: &[TrialPoint]| {
        rms(trace
            .iter()
            .map(|point| point.reference_rad_s - point.speed_rad_s))
    };
    let polyline_error_rad_s = [0, 1, 2].map(|way: usize| error(&traces[way]));
    let names = ["true speed", "Hall edges", "Hall edges, slower design"];
    Hall {
        edges_per_turn: edges(),
        slower_voltage_cost: slower.voltage_cost,
        speeds: SPEEDS_RAD_S.map(at).into(),
        polyline_error_rad_s,
        shown: names
            .into_iter()
            .zip(traces)
            .map(|(name, trace)| Named::new(name, trace))
            .collect(),
    }
}

fn edges() -> f64 {
    STATES * POLE_PAIRS
}

/// On the paper's plant, with friction and without other noise: what is seen is then the edges' doing alone.
fn run(
    bench: &Bench,
    seen: Seen,
    settings: PaperBSettings,
    reference_rad_s: &dyn Fn(f64) -> f64,
    seconds: f64,
) -> Vec<TrialPoint> {
    let machine = TrialMachine {
        speed_noise_rad_s: 0.0,
        ..paper_machine(bench)
    };
    let mut sensor: Box<dyn SpeedSensor> = match seen {
        Seen::True => Box::new(Direct),
        Seen::Edges => Box::new(HallSensor::new(edges())),
    };
    let mut made = bench.paper_b(settings);
    super::run(
        bench,
        &mut *sensor,
        &machine,
        &mut made,
        reference_rad_s,
        &|_| 0.0,
        seconds,
    )
}
