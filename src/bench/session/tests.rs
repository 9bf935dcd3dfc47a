use proptest::prelude::*;

use super::*;
use crate::bench::guard::TripKind;
use crate::bench::limits::{Limits, Nameplate};
use crate::bench::testing::{Fault, ScriptedDrive, Wave};
use crate::drive::{DriveLink, LinkError};

const PERIOD_S: f64 = 0.01;

fn session() -> Session {
    let motor = Nameplate::zk_22fc();
    let guard = Guard::new(Limits::for_motor(&motor, 100.0), &motor, None);
    let program = Wave {
        duration_s: 1.0,
        demand: |time_s: f64| Demand::Voltage(if time_s < 0.2 { 0.0 } else { 20.0 }),
    };
    Session::new(Box::new(program), guard)
}

struct Bench {
    session: Session,
    drive: ScriptedDrive,
    now_s: f64,
    log: Vec<Action>,
}

impl Bench {
    fn new(drive: ScriptedDrive) -> Self {
        Self {
            session: session(),
            drive,
            now_s: 0.0,
            log: Vec::new(),
        }
    }

    fn feed(&mut self, input: Input) {
        let mut actions = Vec::new();
        self.session.step(self.now_s, input, &mut actions);
        for action in actions {
            self.log.push(action.clone());
            if let Action::Send(command) = action {
                let reply = match self.drive.exchange(command) {
                    Ok(sample) => Input::Sample(Box::new(sample)),
                    Err(error) => Input::Lost(Lost::from(&error)),
                };
                self.feed(reply);
            }
        }
    }

    fn cycles(&mut self, cycles: u32) {
        for _ in 0..cycles {
            self.now_s += PERIOD_S;
            self.feed(Input::Cycle);
        }
    }

    fn start(mut self) -> Self {
        self.cycles(3);
        self.feed(Input::Intent(Intent::Start));
        self
    }

    fn outcome(&self) -> Option<&Outcome> {
        self.log.iter().find_map(|action| match action {
            Action::Finished(outcome) => Some(outcome),
            _ => None,
        })
    }

    fn events(&self, kind: &str) -> usize {
        self.log
            .iter()
            .filter(|action| matches!(action, Action::Event(event) if event["event"] == kind))
            .count()
    }
}

fn run_with(from: u64, to: u64, fault: Fault) -> Bench {
    let mut bench = Bench::new(ScriptedDrive::new(PERIOD_S).with(from, to, fault)).start();
    bench.cycles(600);
    bench
}

#[test]
fn a_healthy_run_goes_through_every_phase_and_ends_done_with_the_output_off() {
    let bench = run_with(0, 0, Fault::Timeout);
    assert_eq!(bench.outcome(), Some(&Outcome::Done));
    let phases: Vec<&str> = bench
        .log
        .iter()
        .filter_map(|action| match action {
            Action::Event(event) if event["event"] == "phase" => event["to"].as_str(),
            _ => None,
        })
        .collect();
    assert_eq!(
        phases,
        ["safe", "armed", "running", "ramp_down", "stopping", "done"]
    );
    assert_eq!(bench.events("segment"), 2);
    assert!(
        bench.events("shaped") >= 2,
        "the two steps are slew-limited"
    );
    let peak = bench
        .drive
        .demands
        .iter()
        .filter_map(|demand| match demand {
            Demand::Voltage(volts) => Some(*volts),
            _ => None,
        });
    assert!((peak.fold(0.0, f64::max) - 20.0).abs() < 1e-9);
    assert_eq!(bench.drive.demands.last(), Some(&Demand::Disable));
}

/// After the fault no command energises, the outcome is the expected one, and the reaction is within two cycles.
#[test]
fn every_fault_ends_at_zero_output_with_its_own_reason() {
    let ever = u64::MAX;
    for (fault, kind, reaction) in [
        (Fault::Set(Channel::Current, 23.0), TripKind::OverCurrent, 1),
        (Fault::Set(Channel::Speed, -400.0), TripKind::OverSpeed, 1),
        (
            Fault::Set(Channel::Voltage, 130.0),
            TripKind::OverVoltage,
            1,
        ),
        (Fault::TripWith(7), TripKind::DriveFault, 1),
        (Fault::Missing(Channel::Current), TripKind::SignalMissing, 3),
        (Fault::ClockStops, TripKind::ClockStuck, 3),
        (Fault::LeavesRunning, TripKind::NotRunning, 7),
    ] {
        let bench = run_with(60, ever, fault.clone());
        match bench.outcome() {
            Some(Outcome::Tripped(trip)) => assert_eq!(trip.kind, kind, "{fault:?}"),
            other => panic!("{fault:?}: {other:?}"),
        }
        let after = bench.drive.demands[60 + reaction..].iter();
        assert!(
            after.clone().all(|demand| !demand.energises()),
            "{fault:?}: a command energises after the trip"
        );
        assert!(
            bench.drive.demands[60..=60 + reaction].contains(&Demand::Stop),
            "{fault:?}"
        );
    }
}

#[test]
fn one_lost_reply_costs_nothing_and_a_silent_link_ends_the_run() {
    let one = run_with(60, 61, Fault::Timeout);
    assert_eq!(one.outcome(), Some(&Outcome::Done));
    assert_eq!(one.events("reply_lost"), 1);
    let silent = run_with(60, u64::MAX, Fault::Timeout);
    assert!(matches!(silent.outcome(), Some(Outcome::LinkLost { .. })));
    let last_on = silent.drive.demands.iter().rposition(|d| d.energises());
    // Link silence is 100 ms: ten cycles, and one to find out.
    assert!(last_on.unwrap() <= 71, "{last_on:?}");
    // The script stays aborted although the link comes back.
    let back = run_with(60, 80, Fault::Timeout);
    assert!(matches!(back.outcome(), Some(Outcome::LinkLost { .. })));
    assert!(back.drive.demands[75..].iter().all(|d| !d.energises()));
}

#[test]
fn a_link_that_is_gone_ends_the_session_at_once() {
    let bench = run_with(60, u64::MAX, Fault::Gone);
    assert!(
        matches!(bench.outcome(), Some(Outcome::LinkLost { reason }) if reason.contains("unplugged"))
    );
    assert!(bench.drive.demands[61..].iter().all(|d| !d.energises()));
    assert_eq!(bench.session.phase(), Phase::LinkLost);
}

#[test]
fn a_process_that_was_stopped_sends_stop_before_anything_else() {
    let mut bench = Bench::new(ScriptedDrive::new(PERIOD_S)).start();
    bench.cycles(50);
    let before = bench.drive.demands.len();
    bench.now_s += 5.0;
    bench.feed(Input::Cycle);
    assert_eq!(bench.drive.demands[before], Demand::Stop);
    assert!(
        matches!(bench.outcome(), Some(Outcome::LinkLost { reason }) if reason.contains("host"))
    );
}

#[test]
fn the_first_stop_ramps_down_and_the_second_is_immediate() {
    let mut bench = Bench::new(ScriptedDrive::new(PERIOD_S)).start();
    bench.cycles(60);
    bench.feed(Input::Intent(Intent::Stop));
    bench.cycles(1);
    let volts = bench.drive.demands.last().unwrap().voltage_v().unwrap();
    assert!(volts > 0.0 && volts < 20.0, "{volts}");
    bench.feed(Input::Intent(Intent::Quit));
    bench.cycles(1);
    assert_eq!(bench.drive.demands.last(), Some(&Demand::Stop));
    assert_eq!(bench.outcome(), Some(&Outcome::Interrupted));
}

#[test]
fn a_stop_that_the_drive_does_not_confirm_is_repeated_and_said() {
    let mut bench =
        Bench::new(ScriptedDrive::new(PERIOD_S).with(60, u64::MAX, Fault::IgnoresStop)).start();
    bench.cycles(400);
    let stops = bench
        .drive
        .demands
        .iter()
        .filter(|d| **d == Demand::Stop)
        .count();
    assert!(stops >= 99, "{stops}");
    let silent = LinkError::Gone("script:".to_owned(), "unplugged".to_owned());
    let said = bench.session.last_word(Some(&silent)).unwrap();
    assert_eq!(said.level, Level::Error);
    assert!(said.text.contains("NOT confirmed"), "{}", said.text);
    // The program was over, but nobody knows that the output is off: no success.
    assert!(
        matches!(bench.outcome(), Some(Outcome::LinkLost { .. })),
        "{:?}",
        bench.outcome()
    );
}

/// A session that gives its drive 10 s to stop.
fn patient(drive: ScriptedDrive) -> Bench {
    let mut bench = Bench::new(drive);
    let times = CommandTimes {
        stop_s: 10.0,
        ..CommandTimes::default()
    };
    bench.session = session().with_command_times(times);
    bench.start()
}

#[test]
fn a_drive_that_comes_down_by_a_slow_ramp_of_its_own_is_waited_for() {
    let mut bench = patient(ScriptedDrive::new(PERIOD_S).with(60, 500, Fault::IgnoresStop));
    bench.cycles(600);
    assert_eq!(bench.outcome(), Some(&Outcome::Done));
    assert_eq!(bench.session.last_word(None), None);
}

#[test]
fn a_drive_that_says_nothing_is_not_waited_for_as_for_a_slow_ramp() {
    let mut bench = patient(ScriptedDrive::new(PERIOD_S).with(60, u64::MAX, Fault::Timeout));
    bench.cycles(600);
    assert!(matches!(bench.outcome(), Some(Outcome::LinkLost { .. })));
    let demands = bench.drive.demands.iter();
    let stops = demands.filter(|demand| **demand == Demand::Stop).count();
    assert!((99..110).contains(&stops), "{stops}");
}

#[test]
fn a_stop_asked_for_while_the_output_goes_off_is_not_forgotten() {
    let drive = ScriptedDrive::new(PERIOD_S).with(60, u64::MAX, Fault::IgnoresStop);
    let mut bench = Bench::new(drive).start();
    while bench.session.phase() != Phase::Stopping {
        assert!(bench.outcome().is_none(), "it ended before it stopped");
        bench.cycles(1);
    }
    bench.feed(Input::Intent(Intent::Quit));
    bench.cycles(400);
    assert_eq!(bench.outcome(), Some(&Outcome::Interrupted));
}

#[test]
fn a_drive_that_never_runs_is_named_after_the_enable_time() {
    let bench = run_with(0, u64::MAX, Fault::NeverRuns);
    assert!(matches!(
        bench.outcome(),
        Some(Outcome::Tripped(trip)) if trip.kind == TripKind::NotRunning
    ));
    assert!(
        bench
            .drive
            .demands
            .iter()
            .all(|d| d.voltage_v() == Some(0.0))
    );
}

#[test]
fn nothing_starts_by_itself_and_a_trip_is_re_armed_only_by_hand() {
    let mut idle = Bench::new(ScriptedDrive::new(PERIOD_S));
    idle.cycles(300);
    assert!(idle.drive.demands.iter().all(|d| *d == Demand::Disable));
    assert_eq!(idle.session.phase(), Phase::Safe);

    let mut bench = run_with(60, 65, Fault::Set(Channel::Current, 99.0));
    assert_eq!(bench.session.phase(), Phase::Tripped);
    bench.feed(Input::Intent(Intent::Start));
    bench.cycles(20);
    assert!(bench.drive.demands[62..].iter().all(|d| !d.energises()));
    assert_eq!(bench.events("refused"), 1);
    bench.feed(Input::Intent(Intent::Rearm));
    bench.cycles(20);
    assert_eq!(bench.session.phase(), Phase::Safe);
    assert!(bench.drive.demands[62..].iter().all(|d| !d.energises()));
    bench.feed(Input::Intent(Intent::Start));
    bench.cycles(30);
    assert_eq!(bench.session.phase(), Phase::Running);
}

#[test]
fn a_limit_that_cannot_be_watched_refuses_to_arm() {
    let bench = run_with(0, u64::MAX, Fault::Missing(Channel::Speed));
    assert_eq!(bench.session.phase(), Phase::Safe);
    assert!(bench.log.iter().any(|action| matches!(
        action,
        Action::Notice(notice) if notice.text.contains("speed")
    )));
}

#[test]
fn a_drive_that_is_found_running_is_stopped_first() {
    let mut bench = Bench::new(ScriptedDrive::new(PERIOD_S));
    let mut found = Sample::at(0.0).with(Channel::Speed, 50.0);
    found.state = Some(DriveState::Running);
    bench.feed(Input::Sample(Box::new(found)));
    bench.cycles(1);
    assert_eq!(bench.drive.demands, [Demand::Stop]);
}

#[test]
fn the_same_inputs_give_the_same_actions() {
    let (one, two) = (
        run_with(60, 62, Fault::Timeout),
        run_with(60, 62, Fault::Timeout),
    );
    assert!(one.log.len() > 300);
    assert_eq!(one.log, two.log);
}

#[test]
fn every_intent_is_an_event_with_its_number() {
    let mut bench = Bench::new(ScriptedDrive::new(PERIOD_S)).start();
    bench.cycles(10);
    bench.feed(Input::Intent(Intent::Mark("here".to_owned())));
    let mark = bench.log.iter().rev().find_map(|action| match action {
        Action::Event(event) if event["intent"] == "mark" => Some(event.clone()),
        _ => None,
    });
    let mark = mark.unwrap();
    assert_eq!(mark["text"], "here");
    assert_eq!(mark["seq"], 13);
    assert!(mark["input"].as_u64().unwrap() > 13);
}

fn any_input() -> impl Strategy<Value = Input> {
    let number =
        prop_oneof![40 => -0.3..0.3f64, 4 => -30.0..30.0f64, 1 => Just(f64::NAN), 1 => Just(1e9)];
    let state = prop_oneof![
        20 => Just(Some(DriveState::Running)),
        20 => Just(Some(DriveState::Disabled)),
        1 => Just(Some(DriveState::Fault)),
        1 => Just(None),
    ];
    let sample = (number.clone(), number, state).prop_map(|(current, speed, state)| {
        let mut sample = Sample::at(0.0)
            .with(Channel::Current, current)
            .with(Channel::Speed, speed);
        sample.state = state;
        Input::Sample(Box::new(sample))
    });
    let intent = prop_oneof![
        4 => Just(Intent::Start),
        2 => Just(Intent::Arm),
        1 => Just(Intent::Stop),
        1 => Just(Intent::ResetFault),
        1 => Just(Intent::Mark("m".to_owned())),
    ];
    prop_oneof![
        8 => Just(Input::Cycle),
        8 => sample,
        1 => Just(Input::Lost(Lost::Transient("late".to_owned()))),
        1 => Just(Input::Missed(2)),
        2 => intent.prop_map(Input::Intent),
    ]
}

proptest! {
    /// In any order of any inputs: no set-point leaves before a start was asked for, and none after an end or a trip,
    /// because nothing here re-arms.
    #[test]
    fn no_set_point_before_a_start_and_none_after_an_end(
        inputs in prop::collection::vec((any_input(), 0.0..0.02f64), 1..400),
    ) {
        let mut session = session();
        let (mut now_s, mut time_s) = (0.0, 0.0);
        let (mut asked, mut over) = (false, false);
        for (input, step_s) in inputs {
            now_s += step_s;
            let input = match input {
                Input::Sample(mut sample) => {
                    time_s += 0.01;
                    sample.time_s = time_s;
                    Input::Sample(sample)
                }
                other => other,
            };
            asked |= matches!(&input, Input::Intent(Intent::Start | Intent::Arm));
            let mut actions = Vec::new();
            session.step(now_s, input, &mut actions);
            for action in actions {
                match action {
                    Action::Send(command) if command.demand.energises() => {
                        prop_assert!(asked && !over, "{command:?}");
                    }
                    Action::Finished(_) => over = true,
                    Action::Event(event) if event["event"] == "trip" => over = true,
                    _ => {}
                }
            }
        }
    }
}
