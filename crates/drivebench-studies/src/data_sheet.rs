//! Paper B's data sheet, held against itself, and what its average model leaves out: the switches' drop of eq. (1) and the
//! torque ripple that the factor 0.827 averages away.

use serde::Serialize;

use super::machine::{COMPLETE, driven, made_of, stamps};
use drivebench::plant::{Input, Model, Plant, State};
use drivebench::sample::Channel;
use drivebench::units::rad_s_from_rpm;

pub(super) const RESISTANCE_OHM: f64 = 3.25;
const INDUCTANCE_H: f64 = 11.1e-3;
const MUTUAL_H: f64 = 4.56e-3;
pub(super) const ELECTRICAL_S: f64 = 0.0034;
pub(super) const MECHANICAL_S: f64 = 0.076;
pub(super) const BACK_EMF_V_PER_RPM: f64 = 0.097;
const POWER_W: f64 = 1570.0;
pub(super) const RATED_N_M: f64 = 10.0;
pub(super) const RATED_A: f64 = 4.5;
const RATED_RPM: f64 = 1500.0;
const INERTIA_KG_M2: f64 = 16e-4;
pub(super) const POLE_PAIRS: f64 = 2.0;
const LINE_V: f64 = 380.0;
/// `T_a = 0.827 T_M`.
const MEAN_FACTOR: f64 = 0.827;
/// Chosen, for the paper gives none: what two switches in the current's way drop.
const SWITCHES_V: f64 = 2.0;
/// Steps of the commutation per electrical turn.
const STEPS: f64 = 6.0;

/// A value of the sheet beside what its other values say.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Check {
    pub what: &'static str,
    pub unit: &'static str,
    pub printed: f64,
    pub computed: f64,
}

/// The motor turning steadily under one voltage, by eq. (4) with more and more of what it leaves out.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Switched {
    pub model: &'static str,
    pub voltage_v: f64,
    /// Mean, and the ripple from its lowest to its highest.
    pub speed_rad_s: f64,
    pub ripple_rad_s: f64,
    pub current_a: f64,
}

#[derive(Clone, Debug, Serialize)]
pub struct DataSheet {
    pub checks: Vec<Check>,
    /// Mean of the rectified three-phase supply, and what the motor asks for at its rated speed and current, V: with ke and
    /// R as printed, and with two phases in series.
    pub rectified_v: f64,
    pub rated_v: [f64; 2],
    /// Share of the mean torque by which it swings with the angle, from lowest to highest, and its first harmonic.
    pub ripple_peak_to_peak: f64,
    pub ripple_ratio: f64,
    pub switches_v: f64,
    /// Friction that acts like the drop on the paper's plant, N.m.
    pub drop_as_friction_n_m: f64,
    pub switched: Vec<Switched>,
}

/// Mean of the rectified supply, V.
pub(super) fn rectified_v() -> f64 {
    LINE_V * std::f64::consts::SQRT_2 * 3.0 / std::f64::consts::PI
}

pub(super) fn data_sheet() -> DataSheet {
    let rated_rad_s = rad_s_from_rpm(RATED_RPM);
    let ke = BACK_EMF_V_PER_RPM / rad_s_from_rpm(1.0);
    let kt = RATED_N_M / RATED_A;
    let mechanical_s = |kt: f64| RESISTANCE_OHM * INERTIA_KG_M2 / (ke * kt);
    let check = |what, unit, printed, computed| Check { what, unit, printed, computed };
    let rated_v = BACK_EMF_V_PER_RPM * RATED_RPM + RESISTANCE_OHM * RATED_A;
    // Two of three phases conduct for a sixth of an electrical turn about their common crest.
    let half_step = std::f64::consts::PI / STEPS;
    let crest = 3.0_f64.sqrt();
    let mean = crest * half_step.sin() / half_step;
    DataSheet {
        checks: vec![
            check("T1 = L/R", "ms", 1e3 * ELECTRICAL_S, 1e3 * INDUCTANCE_H / RESISTANCE_OHM),
            check(
                "T1 = (L - M)/R",
                "ms",
                1e3 * ELECTRICAL_S,
                1e3 * (INDUCTANCE_H - MUTUAL_H) / RESISTANCE_OHM,
            ),
            check("P = T n", "W", POWER_W, RATED_N_M * rated_rad_s),
            check("P = ke n I", "W", POWER_W, ke * rated_rad_s * RATED_A),
            check("P = 2 ke n I", "W", POWER_W, 2.0 * ke * rated_rad_s * RATED_A),
            check("ke (SI) = T/I", "V.s/rad", ke, kt),
            check("Tm = R J/ke^2", "ms", 1e3 * MECHANICAL_S, 1e3 * mechanical_s(ke)),
            check("Tm = R J I/(ke T)", "ms", 1e3 * MECHANICAL_S, 1e3 * mechanical_s(kt)),
            check("0.827 = 3 sqrt(3)/(2 pi)", "-", MEAN_FACTOR, 0.5 * mean),
        ],
        rectified_v: rectified_v(),
        rated_v: [rated_v, 2.0 * rated_v],
        ripple_peak_to_peak: (crest - crest * half_step.cos()) / mean,
        ripple_ratio: ripple_ratio(),
        switches_v: SWITCHES_V,
        drop_as_friction_n_m: ke * SWITCHES_V / RESISTANCE_OHM,
        switched: [rated_rad_s, 10.0].into_iter().flat_map(switched).collect(),
    }
}

/// First harmonic of a cosine's crest, repeated six times a turn, over its mean: `2/(6^2 - 1)`.
fn ripple_ratio() -> f64 {
    2.0 / (STEPS * STEPS - 1.0)
}

/// At the voltage that holds a speed under the rated current by the average model.
fn switched(speed_rad_s: f64) -> [Switched; 3] {
    let ke = BACK_EMF_V_PER_RPM / rad_s_from_rpm(1.0);
    let motor = made_of(
        "brushless motor of paper B",
        RESISTANCE_OHM,
        ke,
        [ELECTRICAL_S, MECHANICAL_S],
        ke * RATED_A,
    );
    let voltage_v = ke * speed_rad_s + RESISTANCE_OHM * RATED_A;
    let of = |name: &'static str, effects: &[(&str, &[f64])]| {
        let mut model = Model::baseline(motor.clone());
        for (id, values) in effects {
            model = model.with_effect(id).expect("the catalogue has it");
            let added = model.effects.last_mut().expect("it was added");
            added.values = values.iter().copied().map(Some).collect();
        }
        let times = stamps(STAMP_S, SAMPLES);
        let scenario = driven(String::new(), Channel::Voltage, vec![(0.0, voltage_v)], times);
        let mut plant = Plant::new(&model, Input::Voltage).expect(COMPLETE);
        let found = plant.simulate(&scenario, State::at(RATED_A, speed_rad_s));
        let settled = &found.speed_rad_s[SETTLED..];
        let (low, high) = settled
            .iter()
            .fold((f64::MAX, f64::MIN), |(low, high), speed| (speed.min(low), speed.max(high)));
        let mean_of = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
        Switched {
            model: name,
            voltage_v,
            speed_rad_s: mean_of(settled),
            ripple_rad_s: high - low,
            current_a: mean_of(&found.current_a[SETTLED..]),
        }
    };
    let order = STEPS * POLE_PAIRS;
    let drop: (&str, &[f64]) = ("voltage_drop", &[SWITCHES_V]);
    let ripple = [0.0, ripple_ratio(), order];
    [
        of("eq. (4), du left out", &[]),
        of("with the switches' drop", &[drop]),
        of("with drop and ripple", &[drop, ("torque_ripple", &ripple)]),
    ]
}

/// Stamps of the steady motion, and the first that counts.
const STAMP_S: f64 = 2e-4;
const SAMPLES: usize = 10_000;
const SETTLED: usize = 5_000;
