use super::*;
use crate::testing::{changed, put, record, run_of};
use drivebench_model::excitation::Program;
use drivebench_model::numerics::count::whole;
use drivebench_model::plant::{Model, Motor};
use drivebench_model::sample::Demand;

fn bounds() -> Bounds {
    Bounds {
        rated_voltage_v: 110.0,
        rated_current_a: 5.7,
        current_limit_a: 22.8,
        speed_limit_rad_s: 340.0,
        voltage_limit_v: 110.0,
        period_s: 0.01,
    }
}

/// The stage as the motor would answer it, with the noise of a bench; `distort` is what the sensors make of it.
fn answer(stage: &Stage, motor: &Motor, distort: impl Fn(&mut Run)) -> Run {
    let program = Program::new(&stage.segments, stage.slew_v_per_s).unwrap();
    let at = |k: usize| {
        let time_s = k as f64 * 0.01;
        (time_s, Demand::from(program.value_at(time_s)).voltage_v().unwrap())
    };
    let events: Vec<(f64, f64)> = (0..whole(program.duration_s() / 0.01)).map(at).collect();
    let volts = events.iter().map(|event| event.1).collect();
    let scenario = record(&Model::baseline(motor.clone()), events, 0.01, program.duration_s(), 7);
    let columns = [
        (Channel::VoltageCmd, volts),
        (Channel::Current, scenario.current_a),
        (Channel::Speed, scenario.speed_rad_s),
    ];
    let mut run = run_of(scenario.sample_time_s, columns);
    distort(&mut run);
    run
}

fn scaled(channel: Channel, factor: f64) -> impl Fn(&mut Run) {
    move |run: &mut Run| *run = changed(run, channel, |_, value| value * factor)
}

fn run_of_stages(
    motor: &Motor,
    bounds: Bounds,
    distort: impl Fn(&mut Run),
) -> (Vec<Stage>, Outcome) {
    let mut escalation = Escalation::new(bounds);
    let mut stages = Vec::new();
    while let Some(stage) = escalation.stage().cloned() {
        escalation.learn(&answer(&stage, motor, &distort)).unwrap();
        stages.push(stage);
    }
    (stages, escalation.outcome().unwrap().clone())
}

fn ending(distort: impl Fn(&mut Run)) -> Ending {
    match run_of_stages(&Motor::zk_22fc(), bounds(), distort).1 {
        Outcome::Named(ending) => ending,
        Outcome::Found(found) => panic!("found {found:?}"),
    }
}

#[test]
fn faults_of_sensors_and_drive_are_named() {
    let found = ending(scaled(Channel::Speed, -1.0));
    let slow = matches!(found, Ending::SpeedSign { speed_rad_s, .. } if speed_rad_s.abs() < 20.0);
    assert!(slow, "{found:?}");
    let found = ending(scaled(Channel::Current, -1.0));
    let low = matches!(found, Ending::CurrentSign { voltage_v, .. } if voltage_v < 3.0);
    assert!(low, "{found:?}");
    // The current distinguishes a dead speed signal from a locked rotor.
    let found = ending(scaled(Channel::Speed, 0.0));
    let Ending::SpeedSignalDead { ohm_at_rest, ohm_now, .. } = found else {
        panic!("{found:?}");
    };
    let rose = (ohm_at_rest - 1.1).abs() < 0.1 && ohm_now > 1.43;
    assert!(rose, "{ohm_at_rest} {ohm_now}");
    assert!(found.sentence().contains("dead"));
    // The measured voltage distinguishes a drive without an output from an open phase.
    let silence = |run: &mut Run| {
        scaled(Channel::Current, 0.0)(run);
        scaled(Channel::Speed, 0.0)(run);
    };
    let found = ending(silence);
    assert!(matches!(found, Ending::OpenPhase { .. }), "{found:?}");
    let found = ending(|run| {
        silence(run);
        put(run, Channel::Voltage, vec![0.01; run.rows()]);
    });
    let Ending::NoOutput { commanded_v, .. } = found else {
        panic!("{found:?}");
    };
    assert!((commanded_v - 27.5).abs() < 0.1, "{found:?}");
}

/// The stages of an escalation that finds the motor.
fn stages(motor: &Motor, bounds: Bounds) -> Vec<Stage> {
    let (stages, outcome) = run_of_stages(motor, bounds, |_| {});
    assert!(matches!(outcome, Outcome::Found(_)), "{outcome:?}");
    stages
}

#[test]
fn no_stage_goes_beyond_a_limit() {
    let tight = Bounds { voltage_limit_v: 9.0, current_limit_a: 9.0, ..bounds() };
    for stage in stages(&Motor::zk_22fc().with(MotorKey::LoadTorque, 2.0), tight) {
        let is_within = stage.peak_v <= 9.0 && stage.stop_current_a < 9.0;
        assert!(is_within, "{stage:?}");
    }
    // Nor is a step larger than the lowest resistance allows.
    let stages = stages(&Motor::zk_22fc(), bounds());
    for stage in stages.iter().filter(|stage| stage.kind == StageKind::Turn) {
        assert!(stage.peak_v / 1.1 < 0.8 * 22.8, "{stage:?}");
        assert!(stage.winding_v.unwrap() < 1.05 * 22.8 * 1.1, "{stage:?}");
    }
    assert_eq!(stages[0].kind, StageKind::Feel);
    assert!(stages[0].peak_v <= 0.33 + 1e-9);
    assert_eq!(stages.last().unwrap().kind, StageKind::Sweep);
}

#[test]
fn a_record_that_is_too_short_is_an_error_and_the_stage_stays() {
    let mut escalation = Escalation::new(bounds());
    let columns = [Channel::VoltageCmd, Channel::Current, Channel::Speed];
    let short = run_of(vec![0.0, 0.01, 0.02], columns.map(|channel| (channel, vec![1.0; 3])));
    assert!(escalation.learn(&short).is_err());
    assert!(escalation.stage().is_some() && escalation.history().is_empty());
}
