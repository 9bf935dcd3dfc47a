//! Paper B, computed again: Kalman filter, optimal state feedback, adaptive compensation of a brushless motor's speed.
//!
//! ```text
//! bench (T1, Tm, ke of the paper; with and without back-EMF) -> Figures 4 and 5: compensation on and off
//!     design: convergence of the gains, Q/R, K3 and mu -> noise: variance of the speed
//!     hall: speed from edges     back_emf: what the paper leaves out     comparison: every regulator on the same cases
//! ```
//!
//! T, Q, R, V, W and mu are not in the paper: the page lists what was chosen.

use serde::Serialize;

use super::adaptive::FORGETTING;
use super::data_sheet::{DataSheet, SHEET, STEPS, data_sheet};
use super::hall_sensor::HallSensor;
use super::loops::{
    Bench, Comparison, Held, LoadChange, Named, Sizes, WithBackEmf, comparison, cycles, effort_v,
    error, lasting_rad_s, load_change, mean_and_std, rms, steps, within,
};
use super::machine::{random, white};
use drivebench::control::{
    self, LoadObservingSettings, LoopTiming, PaperBError, PaperBSettings, Trial, TrialPoint,
};
use drivebench::plant::{Model, MotorKey};

/// Chosen: period, s; friction of what the motor drives, N.m; load of Figure 5, N.m; speed at which loads are tried, rad/s.
const PERIOD_S: f64 = 0.001;
const FRICTION_N_M: f64 = 2.0;
const LOAD_N_M: f64 = 5.0;
const SPEED_RAD_S: f64 = 100.0;

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
const SIZES: Sizes =
    Sizes { levels_rad_s: [90.0, 110.0], half_s: 1.0, start_rad_s: 150.0, load_n_m: LOAD_N_M };

#[derive(Clone, Debug, Serialize)]
pub struct PaperB {
    pub paper: &'static str,
    pub title: &'static str,
    /// What the paper leaves open and what was chosen.
    pub chosen: Vec<String>,
    pub data_sheet: DataSheet,
    pub figure_4: Figure4,
    pub figure_5: Figure5,
    pub design: Design,
    pub noise: Noise,
    pub hall: Hall,
    pub back_emf: BackEmf,
    pub comparison: Comparison,
}

/// Computes everything; `begins` is called with the name of each part before it begins.
pub fn paper_b(mut begins: impl FnMut(&str)) -> PaperB {
    let bench = bench();
    begins("Figures 4 and 5");
    let (figure_4, figure_5) = (figure_4(&bench), figure_5(&bench));
    begins("convergence and weights");
    let design = design(&bench);
    begins("speed variance");
    let noise = noise(&bench);
    begins("speed from Hall edges");
    let hall = hall(&bench);
    begins("back-EMF");
    let back_emf = back_emf(&bench);
    begins("every regulator on the same cases");
    PaperB {
        paper: "paper-b",
        title: "Wang Lei, Cai Jiling, Jiang Jingping, Wang Yang: optimal state feedback control of a brushless direct-current motor drive system (2006)",
        chosen: chosen(),
        data_sheet: data_sheet(),
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
    Bench {
        name: "paper B's motor with its back-EMF, regulated inside the drive",
        model: Model::baseline(SHEET.motor(FRICTION_N_M)),
        timing: LoopTiming { period_s: PERIOD_S, delay_s: 0.0, filter_s: 0.0 },
        current_limit_a: 3.0 * SHEET.rated_a,
        voltage_limit_v: SHEET.rectified_v(),
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

/// A trial on the machine of the paper's own figures, eq. (6) to (9): the back-EMF does not feed back, so that the whole voltage is
/// at the winding. Friction is its only load but what the course brings.
fn on_paper<'a>(bench: &Bench, reference_rad_s: impl Fn(f64) -> f64 + 'a) -> Trial<'a> {
    let mut trial = bench.trial(reference_rad_s);
    trial.machine.back_emf_v_s_per_rad = 0.0;
    if let Some(limit) = &mut trial.limiter.current {
        limit.back_emf_v_s_per_rad = 0.0;
    }
    trial
}

/// White noise on the input with the variance Q, as the load torque that does the same; held over each period.
fn input_noise(bench: &Bench, seed: u64, length_s: f64) -> impl Fn(f64) -> f64 {
    let per_volt = bench.value(MotorKey::BackEmf) / SHEET.resistance_ohm;
    let size = per_volt * SETTINGS.process_noise.sqrt();
    held(seed, 31, length_s, move |draw| size * draw)
}

/// White noise through a filter, a value for each period; every `purpose` is an independent stream of the seed.
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

fn with_share(compensation: f64) -> PaperBSettings {
    PaperBSettings { compensation, ..SETTINGS }
}

/// Without compensation, with as much of K3 as is usable, and with the K3 that is printed.
fn courses<T>(course: impl Fn(PaperBSettings) -> T) -> [T; 3] {
    [0.0, SETTINGS.compensation, 1.0].map(|share| course(with_share(share)))
}

fn chosen() -> Vec<String> {
    let PaperBSettings { process_noise, measurement_noise, error_cost, voltage_cost, .. } =
        SETTINGS;
    let PaperBSettings { filter_share, compensation, tolerance, .. } = SETTINGS;
    let [electrical_ms, mechanical_ms] = SHEET.time_constants_s.map(|time_s| 1e3 * time_s);
    vec![
        format!(
            "Data of the paper: R = {} ohm, T1 = {electrical_ms:.1} ms, Tm = {mechanical_ms:.0} ms, ke = {} V/(r/min), {:.0} N.m, {} A, 1500 r/min, p = {:.0}. They are used as stated, although they do not fit each other: R J/(ke KT) with the stated J gives 2.5 to 6.1 ms, not 76 ms, which belongs to a 12-fold inertia (a coupled load). Torque constant here: that of ke in SI units.",
            SHEET.resistance_ohm,
            SHEET.back_emf_v_per_rpm,
            SHEET.rated_n_m,
            SHEET.rated_a,
            SHEET.pole_pairs
        ),
        format!(
            "Not in the paper, chosen by us: T = {:.0} ms; Q = {process_noise} V^2 (noise on the input), R = {measurement_noise} (rad/s)^2, V = {error_cost}, W = {voltage_cost}; mu = {filter_share}; the iterations stop at a relative change of {tolerance:.0e}; P(0) is the identity.",
            1e3 * PERIOD_S
        ),
        format!(
            "K3 = 1/(A+B) is the paper's. With it the compensation corrects the whole of a filtered error in every cycle and swings (see the table of K3 and mu); here it acts with {compensation} of it, and Figures 4 and 5 show both.",
        ),
        "Corrections to the scan: u* = -gamma G (x - [r, r]); n_p follows eq. (9) on measured speeds, and the predictor is fed u*, not u* + u0 (else u0 ramps for ever under a constant load).".to_owned(),
        format!(
            "Plant of Figures 4 and 5: the paper's own, in which the back-EMF does not feed back; {FRICTION_N_M} N.m of friction, noise on the speed with the variance R and on the input with the variance Q; current limit {:.1} A (three times rated). Polyline of Figure 4 and load of Figure 5 ({LOAD_N_M} N.m, half rated): chosen, the text gives no values.",
            3.0 * SHEET.rated_a
        ),
        "Seeds are fixed: the same program gives the same figures.".to_owned(),
    ]
}

/// Reference: time s, speed rad/s.
const POLYLINE: [(f64, f64); 7] =
    [(0.0, 0.0), (0.3, 100.0), (0.8, 100.0), (1.0, 150.0), (1.5, 150.0), (1.9, 50.0), (2.5, 50.0)];
const POLYLINE_S: f64 = POLYLINE[POLYLINE.len() - 1].0;

/// One of the regulators.
#[derive(Clone, Debug, Serialize)]
pub struct Followed {
    /// Share of K3 with which the compensation acts.
    pub share_of_k3: f64,
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
    /// Without compensation, with the usable share of K3, with the printed K3.
    pub courses: [Followed; 3],
}

fn polyline(time_s: f64) -> f64 {
    let next = POLYLINE.partition_point(|corner| corner.0 <= time_s);
    if next == POLYLINE.len() {
        return POLYLINE[next - 1].1;
    }
    let ((from_s, from), (to_s, to)) = (POLYLINE[next - 1], POLYLINE[next]);
    from + (to - from) * (time_s - from_s) / (to_s - from_s)
}

fn figure_4(bench: &Bench) -> Figure4 {
    let noise = input_noise(bench, 1, POLYLINE_S);
    let course = |settings: PaperBSettings| {
        let trial = on_paper(bench, polyline).with_load(&noise);
        let trace = trial.run(&mut bench.paper_b(settings), POLYLINE_S);
        measured(settings.compensation, trace)
    };
    Figure4 { polyline: POLYLINE, courses: courses(course) }
}

fn measured(share_of_k3: f64, trace: Vec<TrialPoint>) -> Followed {
    // The reference so long before: after a corner the flat parts are given this time.
    let reference_before = |point: &TrialPoint| polyline((point.time_s - 0.2).max(0.0));
    let slope = |point: &&TrialPoint| {
        (polyline(point.time_s + PERIOD_S) - polyline(point.time_s)).abs() > 1e-9
    };
    let flat = |point: &&TrialPoint| {
        !slope(point) && (reference_before(point) - point.reference_rad_s).abs() < 1e-9
    };
    let flat_errors: Vec<f64> = trace.iter().filter(flat).map(error).collect();
    let beyond = |point: &TrialPoint| {
        // Only at the end of a slope: the reference has stopped, the shaft has not.
        let way = point.reference_rad_s - reference_before(point);
        if way.abs() > 1e-9 && !slope(&point) { -way.signum() * error(point) } else { 0.0 }
    };
    Followed {
        share_of_k3,
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

#[derive(Clone, Debug, Serialize)]
pub struct Loaded {
    pub share_of_k3: f64,
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
    /// Without compensation, with the usable share of K3, with the printed K3.
    pub courses: [Loaded; 3],
}

fn figure_5(bench: &Bench) -> Figure5 {
    let [on_s, off_s, end_s] = [0.8, 1.4, 2.0];
    let noise = input_noise(bench, 1, end_s);
    let load = |t: f64| {
        let is_on = (on_s..off_s).contains(&t);
        noise(t) + if is_on { LOAD_N_M } else { 0.0 }
    };
    let course = |settings: PaperBSettings| {
        let trial = on_paper(bench, |_| SPEED_RAD_S).with_load(load);
        let trace = trial.run(&mut bench.paper_b(settings), end_s);
        Loaded {
            share_of_k3: settings.compensation,
            applied: load_change(&trace, on_s, off_s),
            removed: load_change(&trace, off_s, end_s),
            effort_v: effort_v(&within(&trace, on_s, f64::INFINITY)),
            trace,
        }
    };
    Figure5 { speed_rad_s: SPEED_RAD_S, load_n_m: LOAD_N_M, courses: courses(course) }
}

const TOLERANCES: [f64; 3] = [1e-3, 1e-6, 1e-9];
const RATIOS: [f64; 7] = [1e-4, 1e-3, 1e-2, 0.1, 1.0, 10.0, 100.0];
const SHARES: [f64; 5] = [1.0, 0.3, 0.1, 0.05, 0.02];
const FILTERS: [f64; 5] = [0.02, 0.05, 0.1, 0.2, 1.0];

/// Iterations until the relative change falls below a tolerance.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Stop {
    pub tolerance: f64,
    pub filter_iterations: usize,
    pub feedback_iterations: usize,
}

/// One ratio of the noises, without compensation.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct WithRatio {
    /// Q/R over the chosen one; Q is changed.
    pub factor: f64,
    pub process_noise: f64,
    pub filter_gain: [f64; 2],
    pub iterations: usize,
    pub overshoot_percent: f64,
    pub settling_s: Option<f64>,
    /// Standard deviation of the true speed at constant reference, and of the output, with both noises.
    pub speed_std_rad_s: f64,
    pub effort_v: f64,
    /// Mean error, rad/s: what friction leaves.
    pub lasting_rad_s: f64,
}

/// Stability by share of K3 (rows) and mu (columns).
#[derive(Clone, Debug, Serialize)]
pub struct Radii {
    pub shares: [f64; 5],
    pub filters: [f64; 5],
    /// Largest eigenvalue of the whole loop.
    pub radius: Vec<Vec<f64>>,
    /// Damping ratio of the compensation's own pair of eigenvalues; 1 where they are real.
    pub damping: Vec<Vec<f64>>,
}

#[derive(Clone, Debug, Serialize)]
pub struct Design {
    pub filter_gain: [f64; 2],
    pub feedback_gain: [f64; 2],
    pub radius: f64,
    /// Relative change of K and of gamma, iteration by iteration, down to the smallest tolerance.
    pub filter_changes: Vec<f64>,
    pub feedback_changes: Vec<f64>,
    pub stops: Vec<Stop>,
    pub ratios: Vec<WithRatio>,
    pub radii: Radii,
}

fn design(bench: &Bench) -> Design {
    let finest = PaperBSettings { tolerance: TOLERANCES[TOLERANCES.len() - 1], ..SETTINGS };
    let made = bench.paper_b(finest);
    let (filter, feedback) = made.convergence();
    let (filter_gain, feedback_gain) = made.gains();
    let below = |changes: &[f64], tolerance: f64| {
        let found = changes.iter().position(|change| *change < tolerance);
        found.map_or(changes.len(), |index| index + 1)
    };
    let stop = |tolerance: f64| Stop {
        tolerance,
        filter_iterations: below(filter, tolerance),
        feedback_iterations: below(feedback, tolerance),
    };
    Design {
        filter_gain: [filter_gain[0], filter_gain[1]],
        feedback_gain: [feedback_gain[0], feedback_gain[1]],
        radius: bench.paper_b(SETTINGS).radius(),
        stops: TOLERANCES.map(stop).into(),
        filter_changes: filter.to_vec(),
        feedback_changes: feedback.to_vec(),
        ratios: RATIOS.map(|factor| with_ratio(bench, factor)).into(),
        radii: radii(bench),
    }
}

fn with_ratio(bench: &Bench, factor: f64) -> WithRatio {
    let (length_s, step_at_s) = (3.0, 0.5);
    let settings =
        PaperBSettings { process_noise: factor * SETTINGS.process_noise, ..with_share(0.0) };
    let made = bench.paper_b(settings);
    let gain = made.gains().0;
    let noise = input_noise(bench, 1, length_s);
    let trace = on_paper(bench, |_| SPEED_RAD_S)
        .with_load(noise)
        .run(&mut bench.paper_b(settings), length_s);
    let mut quiet = on_paper(bench, |t| if t >= step_at_s - 0.5 * PERIOD_S { 51.0 } else { 50.0 });
    quiet.machine.speed_noise_rad_s = 0.0;
    quiet.machine.friction_n_m = 0.0;
    let step = steps(&quiet.run(&mut bench.paper_b(settings), 2.0 * step_at_s));
    let last = &step[step.len() - 1].response;
    // With a slow filter the speed takes its time to come to rest.
    let is_settled = |point: &TrialPoint| point.time_s > 2.0;
    let settled: Vec<TrialPoint> = trace.into_iter().filter(is_settled).collect();
    let (mean, std) = mean_and_std(&settled);
    WithRatio {
        factor,
        process_noise: settings.process_noise,
        filter_gain: [gain[0], gain[1]],
        iterations: made.convergence().0.len(),
        overshoot_percent: last.overshoot_percent,
        settling_s: last.settling_s,
        speed_std_rad_s: std,
        effort_v: effort_v(&settled),
        lasting_rad_s: SPEED_RAD_S - mean,
    }
}

fn radii(bench: &Bench) -> Radii {
    let radius = |compensation: f64, filter_share: f64| {
        let settings = PaperBSettings { filter_share, compensation, ..SETTINGS };
        match control::PaperB::new(bench.paper_b_plant(), settings) {
            Ok(made) => made.radius(),
            Err(PaperBError::Unstable { radius }) => radius,
            Err(_) => f64::NAN,
        }
    };
    let plant = bench.paper_b_plant();
    let split = plant.a / (plant.a + plant.b);
    let table = |of: &dyn Fn(f64, f64) -> f64| {
        let row = |share: &f64| FILTERS.iter().map(|filter| of(*share, *filter)).collect();
        SHARES.iter().map(row).collect()
    };
    Radii {
        shares: SHARES,
        filters: FILTERS,
        radius: table(&radius),
        damping: table(&|share, filter| damping(share, filter, split)),
    }
}

/// Damping ratio of `(z - 1)(z - 1 + mu) + c mu (a z + 1 - a) = 0`: the predictor works on measured speeds and is fed u*,
/// so that the compensation is a loop of its own. `a` is A/(A+B).
fn damping(share: f64, filter: f64, split: f64) -> f64 {
    let sum = 2.0 - filter - share * filter * split;
    let product = 1.0 - filter + share * filter * (1.0 - split);
    if sum * sum >= 4.0 * product {
        return 1.0;
    }
    let decay = -0.5 * product.ln();
    let angle = (0.5 * sum / product.sqrt()).acos();
    decay / decay.hypot(angle)
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Disturbance {
    /// White noise of the speed sensor, variance R.
    Sensor,
    /// White noise on the input, variance Q.
    Input,
    /// A load torque that wanders.
    Load,
    All,
}

impl Disturbance {
    const ALL: [Self; 4] = [Self::Sensor, Self::Input, Self::Load, Self::All];
}

/// Means over the seeds: without compensation, then with it.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Variance {
    pub disturbance: Disturbance,
    /// Variance of the true speed, (rad/s)^2.
    pub speed_variance: [f64; 2],
    pub effort_v: [f64; 2],
}

#[derive(Clone, Debug, Serialize)]
pub struct Noise {
    pub seeds: u64,
    pub variances: Vec<Variance>,
}

impl Noise {
    pub fn of(&self, disturbance: Disturbance) -> Option<&Variance> {
        let mut variances = self.variances.iter();
        variances.find(|found| found.disturbance == disturbance)
    }
}

fn noise(bench: &Bench) -> Noise {
    let seeds = 4;
    let of = |disturbance| {
        let (mut speed_variance, mut effort_v) = ([0.0; 2], [0.0; 2]);
        for seed in 1..=seeds {
            for (which, settings) in [with_share(0.0), SETTINGS].into_iter().enumerate() {
                let (variance, volts) = disturbed(bench, disturbance, settings, seed);
                speed_variance[which] += variance / seeds as f64;
                effort_v[which] += volts / seeds as f64;
            }
        }
        Variance { disturbance, speed_variance, effort_v }
    };
    Noise { seeds, variances: Disturbance::ALL.map(of).into() }
}

fn disturbed(
    bench: &Bench,
    disturbance: Disturbance,
    settings: PaperBSettings,
    seed: u64,
) -> (f64, f64) {
    let has = |one: Disturbance| disturbance == one || disturbance == Disturbance::All;
    let length_s = 4.0;
    let input = input_noise(bench, seed, length_s);
    let coloured = coloured_load(seed, length_s);
    let part = |of, value: f64| if has(of) { value } else { 0.0 };
    let load = |t| part(Disturbance::Input, input(t)) + part(Disturbance::Load, coloured(t));
    let mut trial = on_paper(bench, |_| SPEED_RAD_S).with_load(load);
    trial.seed = seed;
    trial.limiter.current = None;
    trial.machine.friction_n_m = 0.0;
    if !has(Disturbance::Sensor) {
        trial.machine.speed_noise_rad_s = 0.0;
    }
    let trace = trial.run(&mut bench.paper_b(settings), length_s);
    let settled = &trace[cycles(0.5, PERIOD_S)..];
    (mean_and_std(settled).1.powi(2), effort_v(settled))
}

/// A load torque of first order, N.m, held over each period: standard deviation and correlation time are chosen.
fn coloured_load(seed: u64, length_s: f64) -> impl Fn(f64) -> f64 {
    let (std_n_m, correlation_s) = (1.0, 0.2);
    let decay = (-PERIOD_S / correlation_s).exp();
    let push = std_n_m * (1.0 - decay * decay).sqrt();
    let mut now = 0.0;
    held(seed, 32, length_s, move |draw| {
        now = decay * now + push * draw;
        now
    })
}

/// A constant speed, regulated on the measured one.
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

fn hall(bench: &Bench) -> Hall {
    let edges_per_turn = STEPS * SHEET.pole_pairs;
    // A slower design beside the chosen one: its voltage costs more.
    let slower = PaperBSettings { voltage_cost: 100.0 * SETTINGS.voltage_cost, ..SETTINGS };
    // On the paper's plant, with friction and without other noise: the measurement then differs by the edges alone.
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
            let trace = run(edges, settings, &|_| speed_rad_s, 3.0).into_iter();
            let settled = trace.filter(|point| point.time_s > 1.5);
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
    let traces = ways.map(|(edges, settings)| run(edges, settings, &polyline, POLYLINE_S));
    let names = ["true speed", "Hall edges", "Hall edges, slower design"];
    Hall {
        edges_per_turn,
        slower_voltage_cost: slower.voltage_cost,
        speeds: [10.0, 30.0, 60.0, 100.0, 157.0].map(at).into(),
        polyline_error_rad_s: traces.each_ref().map(|trace| rms(trace.iter().map(error))),
        shown: Named::all(names, traces),
    }
}

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

fn back_emf(bench: &Bench) -> BackEmf {
    let open_voltage_v = 20.0;
    // The paper's plant or the full motor, without friction and noise.
    let trial = |full_motor: bool, reference_rad_s: f64| {
        let mut trial = if full_motor {
            bench.trial(move |_| reference_rad_s)
        } else {
            on_paper(bench, move |_| reference_rad_s)
        };
        trial.machine.friction_n_m = 0.0;
        trial.machine.speed_noise_rad_s = 0.0;
        trial
    };
    let open = [false, true].map(|full| trial(full, 0.0).run(&mut Held(open_voltage_v), 0.3));
    let apart = open[0].iter().zip(&open[1]).find(|(paper, full)| {
        full.speed_rad_s > 0.0 && paper.speed_rad_s - full.speed_rad_s > 0.05 * full.speed_rad_s
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
        let share = if compensated { SETTINGS.compensation } else { 0.0 };
        let made = bench.paper_b(with_share(share));
        let mut controller = WithBackEmf::new(made, if fed_forward { ke } else { 0.0 });
        let trace = trial(full_motor, SPEED_RAD_S).run(&mut controller, 1.5);
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
        open_voltage_v,
        apart_after_s: apart.map(|(paper, _)| paper.time_s),
        open_end_rad_s: [end(&open[0]), end(&open[1])],
        open: Named::all(names, open),
        closed: closed.into(),
    }
}
