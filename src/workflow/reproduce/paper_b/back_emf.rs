//! What paper B leaves out: its open-loop transfer function has no back-EMF. The difference as a missing physical effect.

use serde::Serialize;

use super::{SETTINGS, SPEED_RAD_S, on_paper, without};
use crate::control::{Measured, SpeedController, TrialPoint};
use crate::plant::MotorKey;
use crate::workflow::reproduce::loops::{Bench, Named, Trial, WithBackEmf, lasting_rad_s, steps};

/// Voltage of the open loop, V.
const OPEN_V: f64 = 20.0;
const OPEN_S: f64 = 0.3;
const CLOSED_S: f64 = 1.5;
/// Difference of the speeds that is asked for, as share of the full motor's.
const APART_SHARE: f64 = 0.05;

/// A regulator on one of the plants, from standstill to 100 rad/s.
#[derive(Clone, Debug, Serialize)]
pub struct Closed {
    pub full_motor: bool,
    pub compensated: bool,
    pub fed_forward: bool,
    pub overshoot_percent: f64,
    pub settling_s: Option<f64>,
    /// Mean error of the last fifth, rad/s.
    pub lasting_rad_s: f64,
    #[serde(skip)]
    pub trace: Vec<TrialPoint>,
}

#[derive(Clone, Debug, Serialize)]
pub struct BackEmf {
    pub open_voltage_v: f64,
    /// After which the paper's plant is 5 % faster than the motor with its back-EMF, s.
    pub apart_after_s: Option<f64>,
    /// Speeds at the end, rad/s: the paper's plant, the full motor.
    pub open_end_rad_s: [f64; 2],
    pub open: Vec<Named>,
    pub closed: Vec<Closed>,
}

/// No regulator: a held voltage.
struct Held(f64);

impl SpeedController for Held {
    fn id(&self) -> &'static str {
        "held"
    }

    fn step(&mut self, _: f64, _: &Measured, _: f64) -> f64 {
        self.0
    }

    fn applied(&mut self, _: f64) {}

    fn reset(&mut self, _: &Measured, output: f64) {
        self.0 = output;
    }

    fn explain(&self) -> Vec<String> {
        vec![format!("{} V, held", self.0)]
    }
}

pub(super) fn back_emf(bench: &Bench) -> BackEmf {
    // The paper's plant or the full motor, without friction and noise.
    let trial = |full_motor: bool, reference_rad_s: f64| {
        let mut trial = if full_motor {
            Trial::of(bench, move |_| reference_rad_s)
        } else {
            on_paper(bench, move |_| reference_rad_s)
        };
        trial.machine.friction_n_m = 0.0;
        trial.machine.speed_noise_rad_s = 0.0;
        trial
    };
    let open = [false, true].map(|full| trial(full, 0.0).run(&mut Held(OPEN_V), OPEN_S));
    let apart = open[0].iter().zip(&open[1]).find(|(paper, full)| {
        full.speed_rad_s > 0.0
            && paper.speed_rad_s - full.speed_rad_s > APART_SHARE * full.speed_rad_s
    });
    let end = |trace: &[TrialPoint]| trace[trace.len() - 1].speed_rad_s;
    let cases = [
        (false, false, false),
        (false, true, false),
        (true, false, false),
        (true, true, false),
        (true, false, true),
        (true, true, true),
    ];
    let ke = bench.value(MotorKey::BackEmf);
    let closed = cases.map(|(full_motor, compensated, fed_forward)| {
        let bare = without(SETTINGS);
        let made = bench.paper_b(if compensated { SETTINGS } else { bare });
        let mut controller = WithBackEmf::new(made, if fed_forward { ke } else { 0.0 });
        let trace = trial(full_motor, SPEED_RAD_S).run(&mut controller, CLOSED_S);
        let response = steps(&trace)[0].response;
        Closed {
            full_motor,
            compensated,
            fed_forward,
            overshoot_percent: response.overshoot_percent,
            settling_s: response.settling_s,
            lasting_rad_s: lasting_rad_s(&trace),
            trace,
        }
    });
    let names = ["paper B's plant", "motor with back-EMF"];
    BackEmf {
        open_voltage_v: OPEN_V,
        apart_after_s: apart.map(|(paper, _)| paper.time_s),
        open_end_rad_s: [end(&open[0]), end(&open[1])],
        open: Named::all(names, open),
        closed: closed.into(),
    }
}
