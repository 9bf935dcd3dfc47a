use proptest::prelude::*;

use super::super::motor::zk_22fc;
use super::*;
use drivebench_model::numerics::count::whole;

const H: f64 = 50e-6;

fn hidden(id: &str, values: &[(&str, f64)]) -> HiddenEffect {
    HiddenEffect::new(id, values).unwrap()
}

fn stribeck() -> HiddenEffect {
    hidden("stribeck_friction", &[("stribeck_n_m", 0.16), ("stribeck_speed_rad_s", 10.0)])
}

fn run(plant: &mut Plant, terminals: Terminals, time_s: f64, step_s: f64) {
    for _ in 0..whole((time_s / step_s).round()) {
        plant.advance(terminals, step_s);
    }
}

/// The motor of paper A with these effects, after this voltage.
fn after(hidden: &[HiddenEffect], volts: f64, time_s: f64) -> Plant {
    let mut plant = Plant::new(zk_22fc(), hidden);
    run(&mut plant, Terminals::Voltage(volts), time_s, H);
    plant
}

#[test]
fn a_locked_current_rises_exponentially_to_u_over_r() {
    let mut motor = zk_22fc();
    motor.load_torque_n_m = 10.0;
    let mut plant = Plant::new(motor, &[]);
    run(&mut plant, Terminals::Voltage(1.1), 0.009, H);
    // Ta = L/R = 9 ms: one time constant.
    assert!((plant.current_a() - (1.0 - (-1.0_f64).exp())).abs() < 1e-9);
    assert_eq!(plant.motion(), Motion::Stuck);
    assert!(plant.angle_rad() == 0.0);
}

#[test]
fn static_friction_holds_below_its_breakaway_voltage() {
    // Mc/Kt = 1.286 A, so 1.4146 V break away; (Mc + Ms) R/Kt = 1.912 V.
    for (hidden, volts, moves) in [
        (&[][..], 1.41, false),
        (&[], -1.41, false),
        (&[], 1.42, true),
        (&[], -1.42, true),
        (&[stribeck()], 1.90, false),
        (&[stribeck()], 1.93, true),
    ] {
        let plant = after(hidden, volts, 1.0);
        assert_eq!(plant.angle_rad().abs() > 0.0, moves, "{volts} V");
        assert!(plant.speed_rad_s() * volts >= 0.0);
    }
}

#[test]
fn the_shaft_breaks_away_with_its_friction_fully_built_up() {
    let mut plant = Plant::new(zk_22fc(), &[stribeck()]);
    // The current passes the breakaway level after 35 ms; 5 ms later the surplus is a few mN.m. Without the bristle's
    // torque it would be 160 mN.m, and the speed 0.1 rad/s.
    run(&mut plant, Terminals::Voltage(1.95), 0.040, H);
    let speed = plant.speed_rad_s();
    assert!(speed > 0.0 && speed < 0.02, "{speed}");
}

#[test]
fn a_shaft_that_passes_zero_keeps_its_bristle() {
    let stribeck = [stribeck()];
    // After each leg: the torque of the bristle a quarter of a millisecond into the reversed motion, far less than its stretch.
    let after = |rest_s: f64| {
        let mut plant = after(&stribeck, 20.0, 0.5);
        if rest_s > 0.0 {
            run(&mut plant, Terminals::Voltage(0.0), rest_s, H);
            assert_eq!(plant.motion(), Motion::Stuck);
        }
        while plant.motion() != Motion::Backward {
            plant.advance(Terminals::Voltage(-20.0), H);
        }
        run(&mut plant, Terminals::Voltage(-20.0), 2.5e-4, H);
        assert!(plant.speed_rad_s() < 0.0 && plant.speed_rad_s() > -3.0);
        plant.effects[0].drag_torque_n_m(plant.speed_rad_s())
    };
    let (passing, rested) = (after(0.0), after(1.0));
    assert!(passing > 0.1, "{passing}");
    assert!(rested < -0.1, "{rested}");
}

#[test]
fn an_open_circuit_coasts_down_on_a_straight_line() {
    let mut plant = after(&[], 60.0, 2.0);
    let open = Terminals::Open { bus_v: 120.0 };
    run(&mut plant, open, 0.01, H);
    assert!(plant.current_a() == 0.0);
    let start = plant.speed_rad_s();
    run(&mut plant, open, 1.0, H);
    // dw/dt = -Mc/J = -101.1 rad/s2
    let expected = start - 0.455 / 0.0045;
    assert!((plant.speed_rad_s() - expected).abs() < 1e-9);
    let off_v = plant.terminal_v() - 0.3538 * expected;
    assert!(off_v.abs() < 1e-9, "back-EMF at the terminals");
    run(&mut plant, open, 1.0, H);
    assert_eq!(plant.motion(), Motion::Stuck);
    assert!(plant.speed_rad_s() == 0.0);
}

#[test]
fn energy_in_is_heat_and_friction_and_what_is_stored() {
    let mut plant = Plant::new(zk_22fc(), &[]);
    let h = 1e-6;
    let (mut supplied, mut heat, mut friction) = (0.0, 0.0, 0.0);
    for volts in [60.0, -30.0] {
        for _ in 0..150_000 {
            let (i0, w0) = (plant.current_a(), plant.speed_rad_s());
            plant.advance(Terminals::Voltage(volts), h);
            let (i1, w1) = (plant.current_a(), plant.speed_rad_s());
            supplied += volts * 0.5 * (i0 + i1) * h;
            heat += 1.1 * 0.5 * (i0 * i0 + i1 * i1) * h;
            friction += 0.455 * 0.5 * (w0.abs() + w1.abs()) * h;
        }
    }
    let (i, w) = (plant.current_a(), plant.speed_rad_s());
    let stored = 0.5 * 0.0099 * i.powi(2) + 0.5 * 0.0045 * w.powi(2);
    let balance = supplied - heat - friction - stored;
    assert!(balance.abs() < 1e-7 * heat, "{balance} J of {supplied} J");
}

/// Speed after a start, a reversal through stick and a stop, for one step length.
fn reversal(hidden: &[HiddenEffect], step_s: f64) -> f64 {
    let mut plant = Plant::new(zk_22fc(), hidden);
    for volts in [20.0, -4.0, 0.5, -12.0] {
        run(&mut plant, Terminals::Voltage(volts), 0.08, step_s);
    }
    plant.speed_rad_s()
}

#[test]
fn halving_the_step_shows_the_order_through_stick_and_reversal() {
    let error = |hidden: &[HiddenEffect], exact: f64, step| (reversal(hidden, step) - exact).abs();
    let exact = reversal(&[], 20e-6);
    // Over three halvings: where an event lies within its step moves a single ratio.
    let order = (error(&[], exact, 2e-3) / error(&[], exact, 0.25e-3)).log2() / 3.0;
    assert!((3.5..4.8).contains(&order), "order {order}");
    assert!(error(&[], exact, H) < 1e-9);
    let bristle = [stribeck()];
    let exact = reversal(&bristle, 1e-6);
    let at_h = error(&bristle, exact, H);
    assert!(at_h < 2e-3 * exact.abs(), "{at_h} of {exact}");
    assert!(error(&bristle, exact, H / 4.0) < 0.5 * at_h);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    /// Whatever the voltage, the speed never chatters: once stuck below the breakaway voltage it stays stuck.
    #[test]
    fn rest_is_rest(start in -100.0..100.0_f64, hold in -1.4..1.4_f64) {
        let mut plant = after(&[], start, 0.2);
        run(&mut plant, Terminals::Voltage(hold), 3.0, H);
        prop_assert_eq!(plant.motion(), Motion::Stuck);
        let angle = plant.angle_rad();
        run(&mut plant, Terminals::Voltage(hold), 0.5, H);
        prop_assert!(plant.angle_rad().to_bits() == angle.to_bits());
    }
}

#[test]
fn a_changed_inertia_keeps_speed_and_divides_acceleration() {
    let change = |time_s, inertia_ratio| Change { time_s, inertia_ratio, load_n_m: 0.0 };
    let changes = vec![change(0.2, 2.0), change(1.0, 4.0)];
    let mut plant = Plant::new(zk_22fc(), &[]).with_changes(changes);
    // Nothing but friction brakes: Mc/J without a change, a half and a quarter of it with them.
    run(&mut plant, Terminals::Voltage(60.0), 0.5, H);
    let open = Terminals::Open { bus_v: 1000.0 };
    run(&mut plant, open, 0.3, H);
    let slope = |plant: &mut Plant| {
        let before = plant.speed_rad_s();
        run(plant, open, 0.1, H);
        (plant.speed_rad_s() - before) / 0.1
    };
    let expected = -0.455 / 0.0045;
    assert!((slope(&mut plant) / expected - 0.5).abs() < 1e-6);
    run(&mut plant, open, 0.1 - H, H);
    let before = plant.speed_rad_s();
    run(&mut plant, open, 2.0 * H, H);
    assert!((plant.speed_rad_s() - before).abs() < 0.02, "it jumped");
    assert!((slope(&mut plant) / expected - 0.25).abs() < 1e-6);
    plant.start();
    assert!((slope(&mut plant) / expected - 1.0).abs() < 1e-6);
}

#[test]
fn a_load_that_comes_on_pulls_backwards_also_at_rest() {
    let pull = |load_n_m| {
        let changes = vec![Change { time_s: 0.1, inertia_ratio: 1.0, load_n_m }];
        let mut plant = Plant::new(zk_22fc(), &[]).with_changes(changes);
        let open = Terminals::Open { bus_v: 1000.0 };
        run(&mut plant, open, 0.1, H);
        assert_eq!(plant.motion(), Motion::Stuck);
        run(&mut plant, open, 0.1, H);
        plant.speed_rad_s()
    };
    // Below the friction nothing turns; beyond it what is left accelerates.
    assert!(pull(0.4).abs() < 1e-12);
    assert!((pull(0.955) / (-0.5 / 0.0045 * 0.1) - 1.0).abs() < 1e-3);
    assert!(pull(-0.955) > 11.0);
}
