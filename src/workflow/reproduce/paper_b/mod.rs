//! Paper B, computed again: Kalman filter, optimal state feedback, adaptive compensation of a brushless motor's speed.
//!
//! ```text
//! bench (T1, Tm, ke of the paper; with and without back-EMF) -> figures: compensation on and off
//!     design: convergence of K and gamma, Q/R, K3 and mu -> noise: speed variance
//!     hall: speed from edges     back_emf: what the paper leaves out     comparison: every regulator on the same cases
//! ```
//!
//! T, Q, R, V, W and mu are not in the paper: what was chosen is said on the page.

mod back_emf;
mod design;
mod figures;
mod hall;
mod noise;
#[cfg(test)]
mod tests;

use serde::Serialize;

pub use back_emf::{BackEmf, Closed};
pub use design::{Design, Radii, Stop, WithRatio};
pub use figures::{Figure4, Figure5, Followed, Loaded};
pub use hall::{AtSpeed, Hall};
pub use noise::{Disturbance, Noise, Variance};

use super::adaptive::FORGETTING;
use super::loops::{Bench, Comparison, Sizes, Trial, comparison, cycles};
use super::machine::made_of;
use super::signal::{random, white};
use crate::control::{LoadObservingSettings, LoopTiming, PaperBSettings};
use crate::plant::{Model, MotorKey};
use crate::units::rad_s_from_rpm;

/// Data of the paper: resistance, T1, Tm and ke; rated torque and current, pole pairs.
const RESISTANCE_OHM: f64 = 3.25;
const ELECTRICAL_S: f64 = 0.0034;
const MECHANICAL_S: f64 = 0.076;
const BACK_EMF_V_PER_RPM: f64 = 0.097;
const RATED_N_M: f64 = 10.0;
const RATED_A: f64 = 4.5;
const POLE_PAIRS: f64 = 2.0;
/// Chosen: period, friction of what the motor drives, load of Figure 5, speed at which loads are tried.
const PERIOD_S: f64 = 0.001;
const FRICTION_N_M: f64 = 2.0;
const LOAD_N_M: f64 = 5.0;
const SPEED_RAD_S: f64 = 100.0;
const SEED: u64 = 1;
/// Streams of a seed's random numbers.
const INPUT_PURPOSE: u64 = 31;
const LOAD_PURPOSE: u64 = 32;

/// Settings of the regulator, chosen by us; `compensation` as share of the paper's K3.
const SETTINGS: PaperBSettings = PaperBSettings {
    process_noise: 5.0,
    measurement_noise: 0.02,
    error_cost: 1.0,
    voltage_cost: 0.02,
    filter_share: 0.2,
    compensation: 0.05,
    tolerance: 1e-6,
};

/// Of the cases that every regulator is put through.
const SIZES: Sizes = Sizes {
    levels_rad_s: [90.0, 110.0],
    half_s: 1.0,
    start_rad_s: 150.0,
    load_n_m: LOAD_N_M,
};

/// Paper B, computed again.
#[derive(Clone, Debug, Serialize)]
pub struct PaperB {
    pub paper: &'static str,
    pub title: &'static str,
    /// What the paper leaves open and what was chosen.
    pub chosen: Vec<String>,
    pub figure_4: Figure4,
    pub figure_5: Figure5,
    pub design: Design,
    pub noise: Noise,
    pub hall: Hall,
    pub back_emf: BackEmf,
    pub comparison: Comparison,
}

/// Computes everything; `begins` hears the name of each part before it begins.
pub fn paper_b(mut begins: impl FnMut(&str)) -> PaperB {
    let bench = bench();
    begins("Figures 4 and 5");
    let (figure_4, figure_5) = (figures::figure_4(&bench), figures::figure_5(&bench));
    begins("convergence and weights");
    let design = design::design(&bench);
    begins("speed variance");
    let noise = noise::noise(&bench);
    begins("speed from Hall edges");
    let hall = hall::hall(&bench);
    begins("back-EMF");
    let back_emf = back_emf::back_emf(&bench);
    begins("every regulator on the same cases");
    PaperB {
        paper: "paper-b",
        title: "Wang Lei, Cai Jiling, Jiang Jingping, Wang Yang: optimal state feedback control of a brushless direct-current motor drive system (2006)",
        chosen: chosen(),
        figure_4,
        figure_5,
        design,
        noise,
        hall,
        back_emf,
        comparison: comparison(&bench, &SIZES),
    }
}

/// The paper's motor with its stated T1, Tm and ke; the full motor of every comparison.
fn bench() -> Bench {
    let ke = BACK_EMF_V_PER_RPM / rad_s_from_rpm(1.0);
    Bench {
        name: "paper B's motor with its back-EMF, regulated inside the drive",
        model: Model::baseline(made_of(
            "brushless motor of paper B",
            RESISTANCE_OHM,
            ke,
            [ELECTRICAL_S, MECHANICAL_S],
            FRICTION_N_M,
        )),
        timing: LoopTiming {
            period_s: PERIOD_S,
            delay_s: 0.0,
            filter_s: 0.0,
        },
        current_limit_a: 3.0 * RATED_A,
        voltage_limit_v: 250.0,
        speed_noise_rad_s: SETTINGS.measurement_noise.sqrt(),
        current_noise_a: 0.05,
        scale_rad_s: 157.0,
        // The memory of paper A's 0.96 at 10 ms, 0.25 s: fewer samples would not carry the noise at 1 ms.
        forgetting: FORGETTING.powf(0.1),
        paper_b: SETTINGS,
        observer: LoadObservingSettings {
            error_rad_s: 1.0,
            voltage_v: 7.0,
            integral_s: 0.1,
            ..LoadObservingSettings::default()
        },
    }
}

/// A trial on the machine of the paper's own figures, eq. (6) to (9): the back-EMF does not feed back, so that the winding
/// sees the whole voltage. Friction is its only load but what the course brings.
fn on_paper<'a>(bench: &Bench, reference_rad_s: impl Fn(f64) -> f64 + 'a) -> Trial<'a> {
    let mut trial = Trial::of(bench, reference_rad_s);
    trial.machine.back_emf_v_s_per_rad = 0.0;
    if let Some(limit) = &mut trial.limiter.current {
        limit.back_emf_v_s_per_rad = 0.0;
    }
    trial
}

/// White noise on the input with the variance Q, as the load torque that does the same; held over each period.
fn input_noise(bench: &Bench, seed: u64, length_s: f64) -> impl Fn(f64) -> f64 {
    let per_volt = bench.value(MotorKey::BackEmf) / RESISTANCE_OHM;
    let size = per_volt * SETTINGS.process_noise.sqrt();
    held(seed, INPUT_PURPOSE, length_s, move |draw| size * draw)
}

/// White noise through a filter, a value for each period.
fn held(
    seed: u64,
    purpose: u64,
    length_s: f64,
    filter: impl FnMut(f64) -> f64,
) -> impl Fn(f64) -> f64 {
    let count = cycles(length_s, PERIOD_S) + 1;
    let draws = white(&mut random(seed, purpose), count);
    let values: Vec<f64> = draws.into_iter().map(filter).collect();
    move |t| values[cycles(t, PERIOD_S).min(values.len() - 1)]
}

/// The regulator without its compensation.
fn without(settings: PaperBSettings) -> PaperBSettings {
    PaperBSettings {
        compensation: 0.0,
        ..settings
    }
}

fn chosen() -> Vec<String> {
    let PaperBSettings {
        process_noise,
        measurement_noise,
        error_cost,
        voltage_cost,
        filter_share,
        compensation,
        tolerance,
    } = SETTINGS;
    vec![
        format!(
            "Data of the paper: R = {RESISTANCE_OHM} ohm, T1 = {:.1} ms, Tm = {:.0} ms, ke = {BACK_EMF_V_PER_RPM} V/(r/min), {RATED_N_M:.0} N.m, {RATED_A} A, 1500 r/min, p = {POLE_PAIRS:.0}. They are used as stated, although they do not fit each other: R J/(ke KT) with the stated J gives 2.5 to 6.1 ms, not 76 ms, which belongs to a 12-fold inertia (a coupled load). Torque constant here: that of ke in SI units.",
            1e3 * ELECTRICAL_S,
            1e3 * MECHANICAL_S
        ),
        format!(
            "Not in the paper, chosen by us: T = {:.0} ms; Q = {process_noise} V^2 (noise on the input), R = {measurement_noise} (rad/s)^2, V = {error_cost}, W = {voltage_cost}; mu = {filter_share}; the iterations stop at a relative change of {tolerance:.0e}; P(0) is the identity.",
            1e3 * PERIOD_S
        ),
        format!(
            "K3 = 1/(A+B) is the paper's. With it the compensation corrects the whole of a filtered error in every cycle and swings (see the table of K3 and mu); here it acts with {compensation} of it.",
        ),
        "Corrections to the scan: u* = -gamma G (x - [r, r]); n_p follows eq. (9) on measured speeds, and the predictor is fed u*, not u* + u0 (else u0 ramps for ever under a constant load).".to_owned(),
        format!(
            "Plant of Figures 4 and 5: the paper's own, in which the back-EMF does not feed back; {FRICTION_N_M} N.m of friction, noise on the speed with the variance R and on the input with the variance Q; current limit {:.1} A (three times rated). Polyline of Figure 4 and load of Figure 5 ({LOAD_N_M} N.m, half rated): chosen, the text gives no values.",
            3.0 * RATED_A
        ),
        "Seeds are fixed: the same program gives the same figures.".to_owned(),
    ]
}
