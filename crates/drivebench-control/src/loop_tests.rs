//! Controllers of the family on the same machine: what each of them must do, and what sets them apart.

use super::testing::{self, assert_close, inertia};
use super::tuning::{Request, tune};
use super::*;
use drivebench_model::numerics::count::whole;
use drivebench_model::plant::Model;

const PERIOD_S: f64 = 0.01;
const CURRENT_LIMIT_A: f64 = 10.0;

fn model() -> Model {
    testing::model(inertia(0.2))
}

fn plant() -> LinearPlant {
    testing::plant(inertia(0.2))
}

fn timing() -> LoopTiming {
    testing::timing(2.0)
}

fn machine(noise: f64) -> TrialMachine {
    TrialMachine {
        resistance_ohm: 1.1,
        inductance_h: 0.0099,
        back_emf_v_s_per_rad: 0.3538,
        torque_n_m_per_a: 0.3538,
        friction_n_m: 0.455,
        viscous_n_m_s_per_rad: 0.0,
        coupling: None,
        drive_current_limit_a: 11.4,
        period_s: PERIOD_S,
        delay_periods: 2,
        speed_noise_rad_s: 0.15 * noise,
        current_noise_a: 0.03 * noise,
    }
}

fn limiter() -> Limiter {
    Limiter {
        output: 110.0,
        current: Some(CurrentLimit {
            current_a: CURRENT_LIMIT_A,
            resistance_ohm: 1.1,
            back_emf_v_s_per_rad: 0.3538,
            ahead_s: timing().dead_time_s(),
        }),
    }
}

fn square(half_s: f64, low: f64, high: f64) -> impl Fn(f64) -> f64 {
    move |t| {
        if (t / half_s).floor() % 2.0 == 0.0 { high } else { low }
    }
}

/// Mechanical time constants of Figure 6 of paper A, s, each for `each_s`.
fn figure_6(each_s: f64) -> impl Fn(f64) -> f64 {
    move |t| inertia([0.2, 0.05, 1.0][whole(t / each_s).min(2)])
}

fn fixed() -> Pi {
    let tuning = tune(&plant(), &timing(), &Request::default()).unwrap();
    let holding = Holding::of(&model(), Actuator::Voltage, 0.0);
    Pi::new(tuning.gains, AntiWindup::Hold, holding).leaving_after(timing().leaving_s())
}

fn adaptive() -> Addc {
    let holding = Holding::of(&model(), Actuator::Voltage, 0.0);
    let settings = AddcSettings::new(holding, 0.15);
    Addc::new(&model(), &plant(), &timing(), &settings).unwrap()
}

/// Responses to each step of a square wave.
fn steps(trace: &[TrialPoint], half_s: f64) -> Vec<Response> {
    let rows = whole((half_s / PERIOD_S).round());
    let of = |chunk: &[TrialPoint]| {
        let points: Vec<_> = chunk.iter().map(|p| (p.time_s, p.speed_rad_s)).collect();
        response(&points, points[0].1, chunk[0].reference_rad_s)
    };
    trace.chunks(rows).skip(1).map(of).collect()
}

/// A reference of 80 rad/s, and from 3 s on a load of 1 N.m: the speed is there before and after.
fn held_under_load(controller: &mut dyn SpeedController) -> Vec<TrialPoint> {
    let course = Course {
        reference_rad_s: &|_| 80.0,
        inertia_kg_m2: &|_| inertia(0.2),
        load_n_m: &|t| if t > 3.0 { 1.0 } else { 0.0 },
    };
    let trace = trial(&machine(0.0), &course, controller, &limiter(), 800, 1);
    assert_close(trace[299].speed_rad_s, 80.0, 0.01);
    assert_close(trace[799].speed_rad_s, 80.0, 0.01);
    trace
}

fn run(controller: &mut dyn SpeedController, noise: f64) -> Vec<TrialPoint> {
    let course = Course {
        reference_rad_s: &square(4.0, 90.0, 110.0),
        inertia_kg_m2: &figure_6(24.0),
        load_n_m: &|_| 0.0,
    };
    trial(&machine(noise), &course, controller, &limiter(), 7200, 1)
}

#[test]
fn figure_6_the_fixed_gains_swing_and_the_adaptive_ones_do_not() {
    for noise in [0.0, 1.0] {
        let fixed = steps(&run(&mut fixed(), noise), 4.0);
        let adaptive = steps(&run(&mut adaptive(), noise), 4.0);
        for (n, (a, b)) in fixed.iter().zip(&adaptive).enumerate() {
            println!(
                "{noise} step {n}: {:5.1} % {:?} | {:5.1} % {:?}",
                a.overshoot_percent, a.settling_s, b.overshoot_percent, b.settling_s
            );
        }
        // Steps 0..4 at 0.2 s, then (from 24 s) 5..10 at 0.05 s, then 11.. at 1 s; one is let to notice.
        let calm = |step: &Response| step.overshoot_percent < 10.0 && step.settling_s.is_some();
        let (light, heavy) = (&adaptive[6..11], &adaptive[12..]);
        assert!(light.iter().all(calm) && heavy.iter().all(calm));
        let swings = |step: &Response| (25.0..60.0).contains(&step.overshoot_percent);
        assert!(fixed[6..11].iter().all(swings));
    }
}

#[test]
fn a_load_that_comes_on_is_held_without_an_error_that_stays() {
    for controller in [&mut fixed() as &mut dyn SpeedController, &mut adaptive()] {
        let dip = held_under_load(controller)[300..]
            .iter()
            .map(|p| 80.0 - p.speed_rad_s)
            .fold(0.0, f64::max);
        assert!(dip > 0.5 && dip < 10.0, "{dip}");
    }
}

fn rival(disconnects: bool) -> Mrac {
    let scales = MracScales { speed_rad_s: 120.0, current_a: CURRENT_LIMIT_A };
    Mrac::new(&plant(), &timing(), scales, disconnects).unwrap()
}

/// Start and brake cycles from standstill to full speed and back, far into the current limit.
fn start_and_brake(controller: &mut dyn SpeedController) -> Vec<f64> {
    let course = Course {
        reference_rad_s: &square(5.0, 0.0, 250.0),
        inertia_kg_m2: &|_| inertia(0.2),
        load_n_m: &|_| 0.0,
    };
    let trace = trial(&machine(0.0), &course, controller, &limiter(), 6000, 1);
    // Mean square error over the last two seconds of each step.
    let square = |p: &TrialPoint| (p.reference_rad_s - p.speed_rad_s).powi(2);
    let mean = |end: &[TrialPoint]| end.iter().map(square).sum::<f64>() / end.len() as f64;
    trace.chunks(500).map(|chunk| mean(&chunk[300..]).sqrt()).collect()
}

#[test]
fn the_rival_fails_in_saturation_unless_it_is_disconnected_there() {
    let connected = start_and_brake(&mut rival(false));
    let disconnected = start_and_brake(&mut rival(true));
    let adaptive = start_and_brake(&mut adaptive());
    println!("{connected:.2?}\n{disconnected:.2?}\n{adaptive:.2?}");
    let last = |errors: &[f64]| errors[8..].iter().copied().fold(0.0, f64::max);
    assert!(last(&connected) > 20.0);
    assert!(last(&disconnected) < 5.0);
    assert!(last(&adaptive) < 1.0);
}

#[test]
fn the_load_observer_knows_its_load_and_keeps_its_speed() {
    let settings = LoadObservingSettings::default();
    let mut controller = LoadObserving::new(&model(), &plant(), &timing(), &settings).unwrap();
    held_under_load(&mut controller);
    assert_close(controller.load_n_m(), 1.0 + 0.455, 0.05);
}

#[test]
fn a_limit_that_only_the_drive_sees_is_taken_for_no_load() {
    let settings = LoadObservingSettings::default();
    let mut observer = LoadObserving::new(&model(), &plant(), &timing(), &settings).unwrap();
    let lag = PaperBPlant::new(0.001, 0.009, 0.2, 0.3538);
    let mut paper_b = PaperB::new(lag, PaperBSettings::default()).unwrap();
    let integrator = TrialMachine {
        back_emf_v_s_per_rad: 0.0,
        friction_n_m: 0.0,
        period_s: 0.001,
        delay_periods: 0,
        ..machine(0.0)
    };
    let rivals: [(_, &mut dyn SpeedController); 2] =
        [(machine(0.0), &mut observer), (integrator, &mut paper_b)];
    let course = Course {
        reference_rad_s: &|_| 200.0,
        inertia_kg_m2: &|_| inertia(0.2),
        load_n_m: &|_| 0.0,
    };
    let limiter = Limiter { output: 110.0, current: None };
    for (machine, rival) in rivals {
        let cycles = whole(20.0 / machine.period_s);
        let trace = trial(&machine, &course, rival, &limiter, cycles, 1);
        assert_close(trace[cycles - 1].speed_rad_s, 200.0, 1e-6);
        let speeds = trace.iter().map(|point| point.speed_rad_s);
        // Told nothing of the limit they go 14 and 5 rad/s too far.
        let most = speeds.fold(0.0, f64::max);
        assert!(most < 204.0, "{}: {most}", rival.id());
    }
}

/// Integral of the absolute error over a step, and the largest overshoot: of the steps of 20 rad/s after 24 s, by when an
/// adaptive controller has adapted. Those of a controller that swings on are as large as they come.
fn over_steps(controller: &mut dyn SpeedController, ratio: f64) -> (f64, f64) {
    let course = Course {
        reference_rad_s: &square(2.0, 90.0, 110.0),
        inertia_kg_m2: &|_| ratio * inertia(0.2),
        load_n_m: &|_| 0.0,
    };
    let machine = TrialMachine { delay_periods: 1, ..machine(1.0) };
    let trace = trial(&machine, &course, controller, &limiter(), 4800, 1);
    let steps = steps(&trace, 2.0).split_off(11);
    let count = steps.len() as f64;
    let error = steps.iter().map(|step| step.absolute_error_rad).sum::<f64>() / count;
    let overshoots = steps.iter().map(|step| step.overshoot_percent);
    (error, overshoots.fold(0.0, f64::max))
}

/// Prints the table of docs/physics.md.
#[test]
fn over_an_eightfold_inertia_the_adaptive_controller_is_no_worse_than_a_hand_at_each() {
    let timing = testing::timing(1.0);
    let holding = Holding::of(&model(), Actuator::Voltage, 0.0);
    let by_hand = |ratio: f64| {
        let request = Request {
            rule: tuning::Rule::SymmetricalOptimum,
            bandwidth_rad_s: None,
            ..Request::default()
        };
        let plant = testing::plant(ratio * inertia(0.2));
        let gains = tune(&plant, &timing, &request).unwrap().gains;
        Pi::new(gains, AntiWindup::Hold, holding).leaving_after(timing.leaving_s())
    };
    let scales = MracScales { speed_rad_s: 110.0, current_a: CURRENT_LIMIT_A };
    let paper_b = PaperBPlant::new(PERIOD_S, 0.009, 0.2, 0.3538);
    let names = "PI by hand | addc | pi | mrac | paper-b | load-observer";
    eprintln!("| inertia | {names} |");
    for ratio in [0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0] {
        let addc = Addc::new(&model(), &plant(), &timing, &AddcSettings::new(holding, 0.15));
        let addc = addc.unwrap().adapting_to_the_winding(&model(), 0.0, &timing);
        let gains = tune(&plant(), &timing, &Request::default()).unwrap().gains;
        let observing = LoadObservingSettings::default();
        let mut all: [Box<dyn SpeedController>; 6] = [
            Box::new(by_hand(ratio)),
            Box::new(addc.unwrap()),
            Box::new(Pi::new(gains, AntiWindup::Hold, holding).leaving_after(timing.leaving_s())),
            Box::new(Mrac::new(&plant(), &timing, scales, true).unwrap()),
            Box::new(PaperB::new(paper_b, PaperBSettings::default()).unwrap()),
            Box::new(LoadObserving::new(&model(), &plant(), &timing, &observing).unwrap()),
        ];
        let found = all.each_mut().map(|one| over_steps(one.as_mut(), ratio));
        let cells = found.map(|(error, most)| format!("{error:.2} rad, {most:.1} %"));
        eprintln!("| {ratio} | {} |", cells.join(" | "));
        let [hand, addc, ..] = found;
        assert!(addc.0 <= 1.02 * hand.0, "{ratio}: {addc:?} {hand:?}");
        // Beside what the largest of some hundred samples of the sensor's noise makes of a step of 20 rad/s.
        assert!(addc.1 <= hand.1 + 0.3, "{ratio}: {addc:?} {hand:?}");
    }
}
