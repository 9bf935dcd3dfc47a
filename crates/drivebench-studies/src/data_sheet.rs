//! Paper B's data sheet, checked for consistency, and what its average model leaves out: the switches' drop of eq. (1) and the
//! torque ripple that the factor 0.827 averages away.

use serde::Serialize;

use super::machine::{COMPLETE, made_of, stamps};
use drivebench::numerics::statistics::{extent, mean};
use drivebench::plant::{Input, Model, Motor, Plant, Scenario, State};
use drivebench::sample::Channel;
use drivebench::units::rad_s_from_rpm;

/// What the paper prints of its motor.
pub(super) struct Sheet {
    pub resistance_ohm: f64,
    inductance_h: f64,
    mutual_h: f64,
    /// T1 and Tm.
    pub time_constants_s: [f64; 2],
    pub back_emf_v_per_rpm: f64,
    power_w: f64,
    pub rated_n_m: f64,
    pub rated_a: f64,
    rated_rpm: f64,
    inertia_kg_m2: f64,
    pub pole_pairs: f64,
    line_v: f64,
}

pub(super) const SHEET: Sheet = Sheet {
    resistance_ohm: 3.25,
    inductance_h: 11.1e-3,
    mutual_h: 4.56e-3,
    time_constants_s: [0.0034, 0.076],
    back_emf_v_per_rpm: 0.097,
    power_w: 1570.0,
    rated_n_m: 10.0,
    rated_a: 4.5,
    rated_rpm: 1500.0,
    inertia_kg_m2: 16e-4,
    pole_pairs: 2.0,
    line_v: 380.0,
};

impl Sheet {
    /// ke in V.s/rad.
    fn back_emf(&self) -> f64 {
        self.back_emf_v_per_rpm / rad_s_from_rpm(1.0)
    }

    /// With T1, Tm and ke as printed; the torque constant is that of ke.
    pub(super) fn motor(&self, load_torque_n_m: f64) -> Motor {
        let (name, ke) = ("brushless motor of paper B", self.back_emf());
        made_of(name, self.resistance_ohm, ke, self.time_constants_s, load_torque_n_m)
    }

    /// Mean of the rectified three-phase supply, V.
    pub(super) fn rectified_v(&self) -> f64 {
        self.line_v * std::f64::consts::SQRT_2 * 3.0 / std::f64::consts::PI
    }
}

/// Chosen, for the paper gives none: what two switches in the current's way drop.
const SWITCHES_V: f64 = 2.0;
/// Steps of the commutation per electrical turn.
pub(super) const STEPS: f64 = 6.0;

/// A value of the sheet, and the same computed from its other values.
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
    /// Mean of the rectified three-phase supply, and what the motor needs at its rated speed and current, V: with ke and
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

pub(super) fn data_sheet() -> DataSheet {
    let Sheet { resistance_ohm: r, inductance_h, power_w, rated_n_m, rated_a, .. } = SHEET;
    let [electrical_ms, mechanical_ms] = SHEET.time_constants_s.map(|time_s| 1e3 * time_s);
    let (rated_rad_s, ke) = (rad_s_from_rpm(SHEET.rated_rpm), SHEET.back_emf());
    let kt = rated_n_m / rated_a;
    let from_inertia_ms = |kt: f64| 1e3 * (r * SHEET.inertia_kg_m2 / (ke * kt));
    let check = |what, unit, printed, computed| Check { what, unit, printed, computed };
    let rated_v = SHEET.back_emf_v_per_rpm * SHEET.rated_rpm + r * rated_a;
    // Two of three phases conduct for a sixth of an electrical turn about their common crest.
    let half_step = std::f64::consts::PI / STEPS;
    let crest = 3.0_f64.sqrt();
    let mean = crest * half_step.sin() / half_step;
    DataSheet {
        checks: vec![
            check("T1 = L/R", "ms", electrical_ms, 1e3 * inductance_h / r),
            check("T1 = (L - M)/R", "ms", electrical_ms, 1e3 * (inductance_h - SHEET.mutual_h) / r),
            check("P = T n", "W", power_w, rated_n_m * rated_rad_s),
            check("P = ke n I", "W", power_w, ke * rated_rad_s * rated_a),
            check("P = 2 ke n I", "W", power_w, 2.0 * ke * rated_rad_s * rated_a),
            check("ke (SI) = T/I", "V.s/rad", ke, kt),
            check("Tm = R J/ke^2", "ms", mechanical_ms, from_inertia_ms(ke)),
            check("Tm = R J I/(ke T)", "ms", mechanical_ms, from_inertia_ms(kt)),
            // The paper's T_a = 0.827 T_M.
            check("0.827 = 3 sqrt(3)/(2 pi)", "-", 0.827, 0.5 * mean),
        ],
        rectified_v: SHEET.rectified_v(),
        rated_v: [rated_v, 2.0 * rated_v],
        ripple_peak_to_peak: (crest - crest * half_step.cos()) / mean,
        ripple_ratio: ripple_ratio(),
        switches_v: SWITCHES_V,
        drop_as_friction_n_m: ke * SWITCHES_V / r,
        switched: [rated_rad_s, 10.0].into_iter().flat_map(switched).collect(),
    }
}

/// First harmonic of a cosine's crest, repeated six times a turn, over its mean: `2/(6^2 - 1)`.
fn ripple_ratio() -> f64 {
    2.0 / (STEPS * STEPS - 1.0)
}

/// At the voltage that holds a speed under the rated current by the average model.
fn switched(speed_rad_s: f64) -> [Switched; 3] {
    let (ke, rated_a) = (SHEET.back_emf(), SHEET.rated_a);
    let motor = SHEET.motor(ke * rated_a);
    let voltage_v = ke * speed_rad_s + SHEET.resistance_ohm * rated_a;
    let of = |name: &'static str, effects: &[(&str, &[f64])]| {
        let mut model = Model::baseline(motor.clone());
        for (id, values) in effects {
            model = model.with_effect(id).expect("the catalogue has it");
            let added = model.effects.last_mut().expect("it was added");
            added.values = values.iter().copied().map(Some).collect();
        }
        let times = stamps(2e-4, 10_000);
        let scenario =
            Scenario::planned("", Input::Voltage, Channel::Voltage, vec![(0.0, voltage_v)], times);
        let mut plant = Plant::new(&model, Input::Voltage).expect(COMPLETE);
        let found = plant.simulate(&scenario, State::at(rated_a, speed_rad_s));
        // Steady motion from one second on.
        let [speed, current] = [&found.speed_rad_s, &found.current_a].map(|all| &all[5_000..]);
        let (low, high) = extent(speed);
        Switched {
            model: name,
            voltage_v,
            speed_rad_s: mean(speed),
            ripple_rad_s: high - low,
            current_a: mean(current),
        }
    };
    let order = STEPS * SHEET.pole_pairs;
    let drop: (&str, &[f64]) = ("voltage_drop", &[SWITCHES_V]);
    let ripple = [0.0, ripple_ratio(), order];
    [
        of("eq. (4), du left out", &[]),
        of("with the switches' drop", &[drop]),
        of("with drop and ripple", &[drop, ("torque_ripple", &ripple)]),
    ]
}
