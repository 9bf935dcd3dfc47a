use proptest::prelude::*;

use super::*;
use crate::limits::{Limits, Nameplate};
use crate::mechanics::Brake;
use crate::testing::{
    Fault, ScriptedDrive, SessionRig, Wave, gone, has, no_fault, refusal, within,
};
use drivebench_emulator::VirtualClock;
use drivebench_model::numerics::count::whole;

type Bench = SessionRig<ScriptedDrive, fn(usize, Sample) -> Option<Sample>>;

const EVER: u64 = u64::MAX;

fn session_of(duration_s: f64, demand: fn(f64) -> Demand) -> Session {
    let motor = Nameplate::zk_22fc();
    let guard = Guard::new(Limits::for_motor(&motor, 100.0), &motor, None);
    Session::new(Box::new(Wave { duration_s, demand }), guard)
}

fn session() -> Session {
    session_of(1.0, |time_s| Demand::Voltage(if time_s < 0.2 { 0.0 } else { 20.0 }))
}

fn bench(session: Session, drive: ScriptedDrive) -> Bench {
    SessionRig::new(session, (drive, VirtualClock::new()), no_fault)
}

fn idle() -> Bench {
    bench(session(), ScriptedDrive::new(0.01))
}

/// So many cycles after the start, on a drive with a fault from one exchange to another.
fn run_for(cycles: u32, from: u64, to: u64, fault: Fault) -> Bench {
    bench(session(), ScriptedDrive::new(0.01).with(from, to, fault)).started(cycles)
}

fn run_with(from: u64, to: u64, fault: Fault) -> Bench {
    run_for(600, from, to, fault)
}

/// Cause of the trip that ended the run.
#[track_caller]
fn lost(bench: &Bench) -> &str {
    match bench.outcome() {
        Some(Outcome::LinkLost { reason }) => reason,
        other => panic!("{other:?}"),
    }
}

fn stops(bench: &Bench) -> usize {
    bench.link.demands.iter().filter(|demand| **demand == Demand::Stop).count()
}

fn is_stop(action: &Action) -> bool {
    matches!(action, Action::Send(command) if command.demand == Demand::Stop)
}

fn events<'a>(bench: &'a Bench, kind: &str) -> Vec<&'a Event> {
    let event = |action: &'a Action| match action {
        Action::Event(event) if event.event == kind => Some(event),
        _ => None,
    };
    bench.log.iter().filter_map(event).collect()
}

#[test]
fn a_healthy_run_passes_every_phase_and_ends_done() {
    let bench = run_with(0, 0, Fault::Timeout);
    assert_eq!(bench.outcome(), Some(&Outcome::Done));
    let phases = events(&bench, "phase");
    let phases: Vec<&Value> = phases.iter().map(|e| &e.details["to"]).collect();
    assert_eq!(phases, ["safe", "armed", "running", "ramp_down", "stopping", "done"]);
    assert_eq!(events(&bench, "segment").len(), 2);
    assert!(events(&bench, "shaped").len() >= 2, "the two steps are slew-limited");
    assert!((bench.volts().into_iter().fold(0.0, f64::max) - 20.0).abs() < 1e-9);
    assert_eq!(bench.link.demands.last(), Some(&Demand::Disable));
}

/// After the fault no command energises, the outcome is the expected one, and the reaction is within two cycles.
#[test]
fn every_fault_ends_at_zero_output_with_its_own_reason() {
    let beyond = Fault::Set(Channel::Voltage, 130.0);
    for (fault, kind, reaction) in [
        (Fault::Set(Channel::Current, 23.0), TripKind::OverCurrent, 1),
        (Fault::Set(Channel::Speed, -400.0), TripKind::OverSpeed, 1),
        (beyond, TripKind::OverVoltage, 1),
        (Fault::TripWith(7), TripKind::DriveFault, 1),
        (Fault::Missing(Channel::Current), TripKind::SignalMissing, 3),
        (Fault::ClockStops, TripKind::ClockStuck, 3),
        (Fault::LeavesRunning, TripKind::NotRunning, 7),
    ] {
        let bench = run_with(60, EVER, fault.clone());
        assert_eq!(bench.trip().0, kind, "{fault:?}");
        let on = bench.energised_from(60 + reaction);
        assert_eq!(on, 0, "{fault:?}: a command energises after the trip");
        let reaction = &bench.link.demands[60..=60 + reaction];
        assert!(reaction.contains(&Demand::Stop), "{fault:?}");
    }
}

#[test]
fn a_silence_is_answered_before_the_next_cycle() {
    let mut session = run_for(60, EVER, EVER, Fault::Timeout).session;
    let begun_s = session.now_s;
    let left_s = session.guard().silence_left_s(begun_s);
    for (after_s, is_over) in [(left_s - 0.001, false), (left_s, true)] {
        let mut actions = Vec::new();
        let lost = Lost::Transient("no reply".to_owned());
        session.step(begun_s + after_s, Input::Lost(lost), &mut actions);
        assert_eq!(actions.iter().any(is_stop), is_over, "{after_s} s");
    }
    assert_eq!(session.phase(), Phase::Stopping);
}

#[test]
fn one_lost_reply_has_no_effect_and_a_silent_link_ends_the_run() {
    let one = run_with(60, 61, Fault::Timeout);
    assert_eq!(one.outcome(), Some(&Outcome::Done));
    assert_eq!(events(&one, "reply_lost").len(), 1);
    let silent = run_with(60, EVER, Fault::Timeout);
    lost(&silent);
    // Link silence is 100 ms: ten cycles, and one for its detection.
    assert_eq!(silent.energised_from(72), 0);
    // The run stays aborted although the link comes back.
    let back = run_with(60, 80, Fault::Timeout);
    lost(&back);
    assert_eq!(back.energised_from(75), 0);
}

#[test]
fn a_link_that_is_gone_ends_the_session_at_once() {
    let bench = run_with(60, EVER, Fault::Gone);
    has(lost(&bench), "unplugged");
    assert_eq!(bench.energised_from(61), 0);
    assert_eq!(bench.session.phase(), Phase::LinkLost);
}

#[test]
fn the_first_stop_ramps_down_and_the_second_is_immediate() {
    let mut bench = idle().started(60);
    bench.ask(Intent::Stop);
    bench.cycles(1);
    let volts = bench.link.demands.last().unwrap().voltage_v().unwrap();
    assert!(volts > 0.0 && volts < 20.0, "{volts}");
    bench.ask(Intent::Quit);
    bench.cycles(1);
    assert_eq!(bench.link.demands.last(), Some(&Demand::Stop));
    assert_eq!(bench.outcome(), Some(&Outcome::Interrupted));
}

#[test]
fn a_stop_while_the_motor_coasts_keeps_the_output_off() {
    let coasts = |time_s| if time_s < 1.0 { Demand::Voltage(20.0) } else { Demand::Disable };
    let mut bench = bench(session_of(5.0, coasts), ScriptedDrive::new(0.01)).started(105);
    let before = bench.link.demands.len();
    assert_eq!(bench.link.demands.last(), Some(&Demand::Disable));
    within(bench.recorded(Channel::Speed).last().unwrap().1, 10.0..);
    bench.ask(Intent::Stop);
    bench.cycles(5);
    assert_eq!(bench.energised_from(before), 0);
    assert_eq!(bench.outcome(), Some(&Outcome::Stopped));
}

#[test]
fn a_stop_ramps_any_output_to_zero_before_it_goes_off() {
    let demands: [fn(f64) -> Demand; 3] =
        [|_| Demand::Voltage(20.0), |_| Demand::Current(3.0), |_| Demand::Speed(50.0)];
    for demand in demands {
        // The shaft turns from shortly before the stop on.
        let spins: fn(usize, Sample) -> Option<Sample> =
            |sent, sample| Some(if sent < 61 { sample } else { sample.with(Channel::Speed, 20.0) });
        let link = (ScriptedDrive::new(0.01), VirtualClock::new());
        let mut bench = SessionRig::new(session_of(5.0, demand), link, spins).started(60);
        let demand = bench.link.demands.last().copied().unwrap();
        assert_eq!(bench.session.phase(), Phase::Running, "{demand:?}");
        bench.ask(Intent::Stop);
        bench.cycles(1);
        assert_eq!(bench.session.phase(), Phase::RampDown, "{demand:?}");
        let next = bench.link.demands.last().unwrap();
        assert!(next.energises(), "{demand:?}: {next:?}");
    }
}

#[test]
fn a_state_before_the_request_confirms_no_stop() {
    // Armed, and not running yet.
    let drive = ScriptedDrive::new(0.01).with(0, EVER, Fault::NeverRuns);
    let mut bench = bench(session(), drive).started(2);
    bench.ask(Intent::Stop);
    bench.cycles(300);
    assert_eq!(bench.outcome(), Some(&Outcome::Stopped));
    let is_end = |action: &Action| matches!(action, Action::Finished(_));
    let requested = bench.log.iter().position(is_stop);
    let ended = bench.log.iter().position(is_end);
    assert!(requested.is_some() && requested < ended, "{requested:?} {ended:?}");
}

#[test]
fn a_link_lost_after_a_stop_ends_as_requested() {
    for fault in [Fault::Gone, Fault::Timeout] {
        let mut bench = run_for(60, 66, EVER, fault.clone());
        bench.ask(Intent::Quit);
        bench.cycles(400);
        assert_eq!(bench.outcome(), Some(&Outcome::Interrupted), "{fault:?}");
        let notice = bench.session.stop_notice(None).unwrap();
        assert_eq!(notice.level, Level::Warning, "{fault:?}: {}", notice.text);
    }
}

#[test]
fn a_waived_watchdog_is_not_named_as_the_stop() {
    for (watchdog_s, waived, words) in [
        (None, None, "no watchdog is known"),
        (Some(0.5), None, "stops the motor 0.5 s after the last command"),
        (Some(0.5), Some("watchdog"), "may still"),
    ] {
        let waived = waived.map(str::to_owned).into_iter().collect();
        let drive = ScriptedDrive::new(0.01).with(60, EVER, Fault::Gone);
        let session = session().with_watchdog(watchdog_s).with_waivers(waived);
        let bench = bench(session, drive).started(100);
        has(bench.session.stop_notice(Some(&gone("x".to_owned()))).unwrap().text, words);
    }
}

#[test]
fn a_shaft_that_moves_again_rests_anew_before_its_brake() {
    let applies = |bench: &Bench| -> Vec<f64> {
        (events(bench, "brake").into_iter())
            .filter(|event| event.details["brake"] == "applies")
            .map(|event| event.time_s)
            .collect()
    };
    let run = |moves_at| {
        let brake = Brake { hold_current_a: 0.0, release_s: 0.05, apply_s: 0.2 };
        let session = session().with_waivers(vec![PLAUSIBILITY.to_owned()]);
        let moves = Fault::Set(Channel::Speed, 10.0);
        let drive = ScriptedDrive::new(0.01).with(moves_at, moves_at + 3, moves);
        bench(session.with_brake(Some(brake)), drive).started(600)
    };
    let calm = run(EVER - 3);
    let [rests_s] = *applies(&calm) else {
        panic!("{:?}", applies(&calm));
    };
    let moved = run(whole(rests_s / 0.01) as u64 + 10);
    let [_, rests_s] = *applies(&moved) else {
        panic!("{:?}", applies(&moved));
    };
    let phases = events(&moved, "phase");
    let ends = phases.iter().find(|event| event.details["to"] == "stopping");
    within(ends.unwrap().time_s - rests_s, 0.199..0.22);
}

#[test]
fn an_unconfirmed_stop_is_repeated_and_reported() {
    let bench = run_for(400, 60, EVER, Fault::IgnoresStop);
    assert!(stops(&bench) >= 99, "{}", stops(&bench));
    let notice = bench.session.stop_notice(Some(&gone("script:".to_owned()))).unwrap();
    assert_eq!(notice.level, Level::Error);
    has(notice.text, "NOT confirmed");
    // The program was over, but the output is not known to be off: no success.
    lost(&bench);
}

/// A session that gives its drive 10 s to stop, after 600 cycles.
fn slow_to_stop(from: u64, to: u64, fault: Fault) -> Bench {
    let times = CommandTimes { stop_s: 10.0, ..CommandTimes::default() };
    let drive = ScriptedDrive::new(0.01).with(from, to, fault);
    bench(session().with_command_times(times), drive).started(600)
}

#[test]
fn a_slow_ramp_is_waited_for_and_a_silent_drive_is_not() {
    let slow = slow_to_stop(60, 500, Fault::IgnoresStop);
    assert_eq!(slow.outcome(), Some(&Outcome::Done));
    assert_eq!(slow.session.stop_notice(None), None);
    let silent = slow_to_stop(60, EVER, Fault::Timeout);
    lost(&silent);
    within(stops(&silent) as f64, 99.0..110.0);
}

#[test]
fn a_busy_drive_gets_its_stop_often_and_then_seldom() {
    let refused = |code| {
        let times = CommandTimes { stop_s: 2.0, ..CommandTimes::default() };
        let watched = session().with_command_times(times).with_watchdog(Some(0.2));
        bench(watched, ScriptedDrive::new(0.01).with(60, EVER, Fault::Refuses(code))).started(600)
    };
    let busy = refused(6);
    has(lost(&busy), "requests refused: no valid reply for 0.1");
    has(lost(&busy), "the command: exception 0x06 device busy");
    assert_eq!(events(&busy, "refused_for_now").len(), busy.link.demands.len() - 60);
    // Every cycle for 0.2 s, then every 0.3 s for 1.8 s.
    within(stops(&busy) as f64, 20.0..28.0);
    let notice = busy.session.stop_notice(Some(&refusal("script:".to_owned(), 6))).unwrap();
    has(&notice.text, "it answers: script: the drive refused");
    has(&notice.text, "its watchdog stops the motor 0.2 s after");
    // As many after an illegal request, although the allowed silence is over by then.
    let illegal = refused(2);
    has(lost(&illegal), "illegal data address");
    within(stops(&illegal) as f64, 20.0..28.0);
    // An exception that was followed by a reply is not the cause of a later silence.
    let drive = ScriptedDrive::new(0.01).with(50, 55, Fault::Refuses(6));
    let silent = drive.with(60, EVER, Fault::Timeout);
    has(lost(&bench(session(), silent).started(600)), "link silent");
}

#[test]
fn a_request_while_the_output_goes_off_is_not_lost() {
    let mut bench = run_for(0, 60, EVER, Fault::IgnoresStop);
    while bench.session.phase() != Phase::Stopping {
        assert!(bench.outcome().is_none(), "it ended before it stopped");
        bench.cycles(1);
    }
    bench.ask(Intent::Quit);
    bench.cycles(400);
    assert_eq!(bench.outcome(), Some(&Outcome::Interrupted));
}

#[test]
fn a_drive_that_never_runs_is_named_after_the_enable_time() {
    let bench = run_with(0, EVER, Fault::NeverRuns);
    assert_eq!(bench.trip().0, TripKind::NotRunning);
    assert!(bench.link.demands.iter().all(|demand| demand.voltage_v() == Some(0.0)));
}

#[test]
fn nothing_starts_by_itself_or_after_a_trip() {
    let mut idle = idle();
    idle.cycles(300);
    assert!(idle.link.demands.iter().all(|d| *d == Demand::Disable));
    assert_eq!(idle.session.phase(), Phase::Safe);

    let mut bench = run_with(60, 65, Fault::Set(Channel::Current, 99.0));
    assert_eq!(bench.session.phase(), Phase::Tripped);
    bench.ask(Intent::Start);
    bench.cycles(20);
    assert_eq!(bench.energised_from(62), 0);
    assert_eq!(events(&bench, "refused").len(), 1);
}

#[test]
fn a_limit_that_cannot_be_watched_refuses_to_arm() {
    let bench = run_with(0, EVER, Fault::Missing(Channel::Speed));
    assert_eq!(bench.session.phase(), Phase::Safe);
    let names = |action: &Action| matches!(action, Action::Notice(n) if n.text.contains("speed"));
    assert!(bench.log.iter().any(names));
}

#[test]
fn a_drive_that_is_found_running_is_stopped_first() {
    let mut bench = idle();
    let mut found = Sample::at(0.0).with(Channel::Speed, 50.0);
    found.state = Some(DriveState::Running);
    bench.feed(Input::Sample(Box::new(found)));
    bench.cycles(1);
    assert_eq!(bench.link.demands, [Demand::Stop]);
}

#[test]
fn every_intent_is_an_event_with_its_number() {
    let mut bench = idle().started(10);
    bench.ask(Intent::Mark("here".to_owned()));
    let mark = events(&bench, "intent").pop().unwrap();
    assert_eq!(mark.details["intent"], "mark");
    assert_eq!(mark.details["text"], "here");
    assert_eq!(mark.seq, Some(13));
    assert!(mark.details["input"].as_u64().unwrap() > 13);
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
        let mut sample =
            Sample::at(0.0).with(Channel::Current, current).with(Channel::Speed, speed);
        sample.state = state;
        Input::Sample(Box::new(sample))
    });
    let intent = prop_oneof![
        4 => Just(Intent::Start),
        1 => Just(Intent::Stop),
        1 => Just(Intent::ResetFault),
        1 => Just(Intent::Mark("m".to_owned())),
    ];
    prop_oneof![
        8 => Just(Input::Cycle),
        8 => sample,
        1 => Just(Input::Lost(Lost::Transient("late".to_owned()))),
        1 => Just(Input::Lost(Lost::Busy("busy".to_owned()))),
        1 => Just(Input::Silence),
        1 => Just(Input::Missed(2)),
        2 => intent.prop_map(Input::Intent),
    ]
}

proptest! {
    /// In any order of any inputs: no set-point leaves before a start was requested, and none after an end or a trip, because
    /// nothing re-arms.
    #[test]
    fn no_set_point_before_a_start_and_none_after_an_end(
        inputs in prop::collection::vec((any_input(), 0.0..0.02f64), 1..400),
    ) {
        let mut session = session();
        let (mut now_s, mut time_s) = (0.0, 0.0);
        let (mut requested, mut over) = (false, false);
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
            requested |= matches!(&input, Input::Intent(Intent::Start));
            let mut actions = Vec::new();
            session.step(now_s, input, &mut actions);
            for action in actions {
                match action {
                    Action::Send(command) if command.demand.energises() => {
                        prop_assert!(requested && !over, "{command:?}");
                    }
                    Action::Finished(_) => over = true,
                    Action::Event(event) if event.event == "trip" => over = true,
                    _ => {}
                }
            }
        }
    }
}
