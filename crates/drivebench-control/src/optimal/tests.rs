use super::*;
use crate::testing::assert_close;
use crate::{Measured, SpeedController};
use nalgebra::Vector2;

/// Data of paper B: T1 = 3.4 ms, Tm = 76 ms, ke = 0.097 V/(r/min).
const KE: f64 = 0.097 * 60.0 / std::f64::consts::TAU;

fn plant(period_s: f64) -> PaperBPlant {
    PaperBPlant::new(period_s, 0.0034, 0.076, KE)
}

#[test]
fn the_discrete_plant_is_that_of_small_steps() {
    let (g, h) = plant(0.001).state_space();
    let mut x = Vector2::zeros();
    for _ in 0..50 {
        x = g * x + h * 10.0;
    }
    // ke Tm dn/dt = y, T1 dy/dt = u - y.
    let (mut y, mut n) = (0.0, 0.0);
    for _ in 0..500_000 {
        let h = 1e-7;
        let middle = y + 0.5 * h * (10.0 - y) / 0.0034;
        n += h * middle / (KE * 0.076);
        y += h * (10.0 - middle) / 0.0034;
    }
    assert_close(x[0], n, 1e-6);
    // No cancellation at a short period.
    let tiny = plant(1e-9);
    let expected = 0.5 * 1e-18 / (0.0034 * 0.076 * KE);
    assert!((tiny.a / expected - 1.0).abs() < 1e-3, "{}", tiny.a);
}

/// Speeds of the paper's plant under a load, N.m over J as rad/s per period.
fn follow(controller: &mut PaperB, cycles: usize, push: impl Fn(usize) -> f64) -> Vec<f64> {
    let (g, h) = plant(0.001).state_space();
    let mut x = Vector2::zeros();
    (0..cycles)
        .map(|k| {
            let output = controller.step(100.0, &Measured::at(x[0]), 0.001);
            controller.applied(output);
            x = g * x + h * output;
            x[0] -= push(k);
            x[1] -= push(k);
            x[0]
        })
        .collect()
}

#[test]
fn the_compensation_takes_a_constant_load() {
    let error = |compensation| {
        let settings = PaperBSettings { compensation, ..PaperBSettings::default() };
        let mut controller = PaperB::new(plant(0.001), settings).unwrap();
        let trace = follow(&mut controller, 4000, |k| if k > 2000 { 0.02 } else { 0.0 });
        assert_close(trace[1999], 100.0, 1e-3);
        (trace[3999] - 100.0).abs()
    };
    let (without, with) = (error(0.0), error(0.3));
    assert!(without > 0.3, "{without}");
    assert!(with < 0.01 * without, "{with} {without}");
}

#[test]
fn gains_converge_or_are_refused() {
    let settings = PaperBSettings::default();
    let made = PaperB::new(plant(0.001), settings).unwrap();
    let (filter, feedback) = made.convergence();
    assert!(filter.len() > 3 && feedback.len() > 3);
    assert!(filter.last().unwrap() < &1e-6 && feedback.last().unwrap() < &1e-6);
    let refused = |settings| PaperB::new(plant(0.0005), settings).err().unwrap();
    let slow = PaperBSettings { process_noise: 1e-4, measurement_noise: 1e5, ..settings };
    assert_eq!(refused(slow), PaperBError::Iteration("filter's gain"));
    let none = PaperBSettings { measurement_noise: 0.0, ..settings };
    assert!(matches!(refused(none), PaperBError::Setting { .. }));
}
