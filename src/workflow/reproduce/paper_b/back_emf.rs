//! What paper B leaves out: its open-loop transfer function has no back-EMF. The difference as a missing physical effect.

use serde::Serialize;

use super::{SETTINGS, SPEED_RAD_S, paper_machine, run, without};
use crate::control::{Direct, Measured, SpeedController, TrialMachine, TrialPoint};
use crate::plant::MotorKey;
use crate::workflow::reproduce::loops::{Bench, Named, WithBackEmf, steps};

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
    let quiet = |machine: TrialMachine| TrialMachine {
        friction_n_m: 0.0,
        speed_noise_rad_s: 0.0,
        ..machine
    };
    let plants = [quiet(paper_machine(bench)), quiet(bench.machine())];
    let open = plants.map(|machine| {
        let (sensor, held) = (&mut Direct, &mut Held(OPEN_V));
        run(bench, sensor, &machine, held, &|_| 0.0, &|_| 0.0, OPEN_S)
    });
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
    let closed = cases.map(|(full_motor, compensated, fed_forward)| {
        let settings = if compensated {
            SETTINGS
        } else {
            without(SETTINGS)
        };
        let machine = &plants[usize::from(full_motor)];
        let ke = if fed_forward {
            bench.value(MotorKey::BackEmf)
        } else {
            0.0
        };
        let mut controller = WithBackEmf::new(bench.paper_b(settings), ke);
        let (sensor, made) = (&mut Direct, &mut controller);
        let trace = run(
            bench,
            sensor,
            machine,
            made,
            &|_| SPEED_RAD_S,
            &|_| 0.0,
            CLOSED_S,
        );
        let response = steps(&trace)[0].response;
        let tail = &trace[trace.len() - trace.len() / 5..];
        let errors = tail
            .iter()
            .map(|point| point.reference_rad_s - point.speed_rad_s);
        Closed {
            full_motor,
            compensated,
            fed_forward,
            overshoot_percent: response.overshoot_percent,
            settling_s: response.settling_s,
            lasting_rad_s: errors.sum::<f64>() / tail.len().max(1) as f64,
            trace,
        }
    });
    BackEmf {
        open_voltage_v: OPEN_V,
        apart_after_s: apart.map(|(paper, _)| paper.time_s),
        open_end_rad_s: [end(&open[0]), end(&open[1])],
        open: ["paper B's plant", "motor with back-EMF"]
            .into_iter()
            .zip(open)
            .map(|(name, trace)| Named::new(name, trace))
            .collect(),
        closed: closed.into(),
    }
}
