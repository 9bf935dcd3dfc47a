//! All controllers on the same machine: what each has to achieve, and the differences that are expected.

use super::testing::{self, assert_close, inertia, limiter, machine};
use super::tuning::{Request, Rule, tune};
use super::*;
use drivebench_model::numerics::count::whole;
use drivebench_model::plant::Model;

const PERIOD_S: f64 = 0.01;

fn model() -> Model {
    testing::model(inertia(0.2))
}

fn plant() -> LinearPlant {
    testing::plant(inertia(0.2))
}

fn timing() -> LoopTiming {
    testing::timing(2.0)
}

fn holding() -> Holding {
    Holding::of(&model(), Actuator::Voltage, 0.0)
}

fn square(half_s: f64, low: f64, high: f64) -> impl Fn(f64) -> f64 {
    move |t| {
        if (t / half_s).floor() % 2.0 == 0.0 { high } else { low }
    }
}

fn pi(gains: PiGains, timing: &LoopTiming) -> Pi {
    Pi::new(gains, AntiWindup::Hold, holding()).leaving_after(timing.leaving_s())
}

fn fixed() -> Pi {
    pi(tune(&plant(), &timing(), &Request::default()).unwrap().gains, &timing())
}

fn adaptive() -> Addc {
    Addc::new(&model(), &plant(), &timing(), &AddcSettings::new(holding(), 0.15)).unwrap()
}

fn load_observer(timing: &LoopTiming) -> LoadObserving {
    LoadObserving::new(&model(), &plant(), timing, &LoadObservingSettings::default()).unwrap()
}

fn paper_b(period_s: f64) -> PaperB {
    PaperB::new(PaperBPlant::new(period_s, 0.009, 0.2, 0.3538), PaperBSettings::default()).unwrap()
}

fn steps(trace: &[TrialPoint], half_s: f64) -> Vec<Response> {
    let rows = whole((half_s / PERIOD_S).round());
    let of = |chunk: &[TrialPoint]| {
        let points: Vec<_> = chunk.iter().map(|p| (p.time_s, p.speed_rad_s)).collect();
        response(&points, points[0].1, chunk[0].reference_rad_s)
    };
    trace.chunks(rows).skip(1).map(of).collect()
}

#[test]
fn a_load_leaves_no_steady_state_error() {
    let mut observer = load_observer(&timing());
    for controller in [&mut fixed() as &mut dyn SpeedController, &mut adaptive(), &mut observer] {
        let trial = Trial::new(machine(0.0), limiter(&timing()), inertia(0.2), |_| 80.0)
            .with_load(|t| if t > 3.0 { 1.0 } else { 0.0 });
        let trace = trial.run(controller, 8.0);
        assert_close(trace[299].speed_rad_s, 80.0, 0.01);
        assert_close(trace[799].speed_rad_s, 80.0, 0.01);
        let dip = trace[300..].iter().map(|p| 80.0 - p.speed_rad_s).fold(0.0, f64::max);
        assert!(dip > 0.5 && dip < 10.0, "{dip}: {:?}", controller.explain());
    }
    assert_close(observer.load_n_m(), 1.0 + 0.455, 0.05);
}

#[test]
fn a_limit_within_the_drive_is_taken_for_no_load() {
    let integrator = TrialMachine {
        back_emf_v_s_per_rad: 0.0,
        friction_n_m: 0.0,
        period_s: 0.001,
        delay_periods: 0,
        ..machine(0.0)
    };
    let (mut observer, mut paper_b) = (load_observer(&timing()), paper_b(0.001));
    let both: [(_, &mut dyn SpeedController); 2] =
        [(machine(0.0), &mut observer), (integrator, &mut paper_b)];
    for (machine, controller) in both {
        let limiter = Limiter { output: 110.0, current: None };
        let trial = Trial::new(machine, limiter, inertia(0.2), |_| 200.0);
        let trace = trial.run(controller, 20.0);
        assert_close(trace[trace.len() - 1].speed_rad_s, 200.0, 1e-6);
        // Without a report of the limit they overshoot by 14 and 5 rad/s.
        let most = trace.iter().map(|point| point.speed_rad_s).fold(0.0, f64::max);
        assert!(most < 204.0, "{most}: {:?}", controller.explain());
    }
}

/// Prints the table of docs/physics.md: integral of the absolute error over a step, and the largest overshoot, of the steps of
/// 20 rad/s after 24 s, by when an adaptive controller has adapted.
#[test]
fn over_an_eightfold_inertia_addc_is_no_worse_than_pi_by_hand() {
    let timing = testing::timing(1.0);
    eprintln!("| inertia | PI by hand | addc | pi | mrac | paper-b | load-observer |");
    for ratio in [0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0] {
        let by_hand = Request { rule: Rule::SymmetricalOptimum, ..Request::default() };
        let by_hand = tune(&testing::plant(ratio * inertia(0.2)), &timing, &by_hand).unwrap();
        let addc = Addc::new(&model(), &plant(), &timing, &AddcSettings::new(holding(), 0.15));
        let addc = addc.unwrap().adapting_to_the_winding(&model(), 0.0, &timing);
        let gains = tune(&plant(), &timing, &Request::default()).unwrap().gains;
        let scales = MracScales { speed_rad_s: 110.0, current_a: 10.0 };
        let mut all: [Box<dyn SpeedController>; 6] = [
            Box::new(pi(by_hand.gains, &timing)),
            Box::new(addc.unwrap()),
            Box::new(pi(gains, &timing)),
            Box::new(Mrac::new(&plant(), &timing, scales, true).unwrap()),
            Box::new(paper_b(PERIOD_S)),
            Box::new(load_observer(&timing)),
        ];
        let found = all.each_mut().map(|controller| {
            let machine = TrialMachine { delay_periods: 1, ..machine(1.0) };
            let reference = square(2.0, 90.0, 110.0);
            let inertia = ratio * inertia(0.2);
            let trial = Trial::new(machine, limiter(&testing::timing(2.0)), inertia, reference);
            let trace = trial.run(controller.as_mut(), 48.0);
            let steps = steps(&trace, 2.0).split_off(11);
            let errors = steps.iter().map(|step| step.absolute_error_rad);
            let overshoots = steps.iter().map(|step| step.overshoot_percent);
            (errors.sum::<f64>() / steps.len() as f64, overshoots.fold(0.0, f64::max))
        });
        let cells = found.map(|(error, most)| format!("{error:.2} rad, {most:.1} %"));
        eprintln!("| {ratio} | {} |", cells.join(" | "));
        let [hand, addc, ..] = found;
        assert!(addc.0 <= 1.02 * hand.0, "{ratio}: {addc:?} {hand:?}");
        // The noise of the sensor makes 0.3 % of a step of 20 rad/s.
        assert!(addc.1 <= hand.1 + 0.3, "{ratio}: {addc:?} {hand:?}");
    }
}
