//! The screen on fixed snapshots, keys in every state, and any data at any size.

use std::sync::Arc;

use proptest::prelude::*;
use ratatui::Terminal;
use ratatui::backend::TestBackend;
use ratatui::layout::Position;
use ratatui::style::{Color, Modifier};

mod any;
mod pages;

use super::model::{Event, Model, Page, ZOOM_S};
use super::view::view;
use super::{WorkerCell, WorkerState};
use crate::tui::application::{Effect, Exit};
use crate::tui::keys::{CHARACTERS, Press};
use crate::tui::testing::{self, number};
use crate::workflow::{Progress, ProvisionalRanking, Role, Step, StepState, StepView};
use drivebench_bench::{
    Excitation, InnovationPoint, Intent, Level, Notice, Phase, Snapshot, Stop, Target, Timing,
    TracePoint, Trip, TripKind,
};
use drivebench_diagnose::RankedEffect;
use drivebench_identify::online::Frozen;
use drivebench_link::LinkStatistics;
use drivebench_model::sample::{DriveState, ParameterEstimate, Reason, Verdict};
use pages::between_two_values;
pub(in crate::tui) use pages::pages;

fn found(key: &str, unit: &'static str, value: f64, std: f64) -> ParameterEstimate {
    ParameterEstimate::found(key, unit, value, std, None)
}

/// A voltage that steps every two seconds, a first-order speed, a model that is 10 % too fast, and a gap at 6 s.
fn trace(seconds: f64) -> Vec<TracePoint> {
    let mut speed = 0.0;
    let mut voltage = 0.0;
    (0..(seconds * 100.0) as u32)
        .map(|row| {
            let time_s = f64::from(row) * 0.01;
            voltage = [0.0, 60.0, -60.0, 97.0][(row / 200) as usize % 4];
            let settled = voltage / 0.4;
            speed += (settled - speed) * 0.03;
            let gap = (6.0..6.6).contains(&time_s);
            let measured = |value: f64| if gap { f64::NAN } else { value };
            TracePoint {
                time_s,
                voltage_v: measured(voltage),
                current_a: measured((settled - speed) * 0.02 + 1.3 * voltage.signum()),
                speed_rad_s: measured(speed),
                model_speed_rad_s: speed * 1.1,
                reference_rad_s: f64::NAN,
                command_v: voltage,
                applied_s: time_s,
            }
        })
        .collect()
}

/// Larger while the speed moves; none at standstill.
fn innovations(seconds: f64) -> Vec<InnovationPoint> {
    let points = trace(seconds).into_iter().step_by(5);
    let point = |point: TracePoint| InnovationPoint {
        time_s: point.time_s,
        current_a: 0.1 * point.current_a,
        speed_rad_s: if point.speed_rad_s == 0.0 {
            f64::NAN
        } else {
            0.3 * point.current_a * (40.0 * point.time_s).sin()
        },
    };
    points.map(point).collect()
}

fn notice(level: Level, text: &str) -> Notice {
    let text = text.to_owned();
    Notice { level, text }
}

fn running() -> Snapshot {
    let carried = "the shaft has not turned both ways";
    let searching = |found| ParameterEstimate { verdict: Verdict::Searching, ..found };
    let estimates = vec![
        found("resistance_ohm", "ohm", 1.103_28, 0.021),
        searching(found("inductance_h", "H", 0.009_87, 0.000_31)),
        found("back_emf_v_s_per_rad", "V.s/rad", 0.354_1, 0.000_4),
        searching(found("inertia_kg_m2", "kg.m2", 0.004_6, 0.001_9)),
        ParameterEstimate::not_observable("load_torque_n_m", "N.m", Reason::TooFewRows, carried),
    ];
    Snapshot {
        name: "zk-22fc-emulated".to_owned(),
        link: "modbus-rtu /dev/pts/7".to_owned(),
        target: Target::Sim,
        phase: Some(Phase::Running),
        drive_state: Some(DriveState::Running),
        elapsed_s: 8.4,
        total_s: 24.0,
        segment: Some("prbs".to_owned()),
        trace: Arc::new(trace(8.4)),
        innovations: Arc::new(innovations(8.4)),
        estimates: Arc::new(estimates),
        excitation: Arc::new(Excitation::from([
            ("resistance_ohm", 0.98),
            ("inductance_h", 0.81),
            ("back_emf_v_s_per_rad", 1.0),
            ("inertia_kg_m2", 0.42),
            ("load_torque_n_m", 0.05),
        ])),
        link_statistics: LinkStatistics {
            sent: 845,
            ok: 841,
            timeout: 3,
            crc: 1,
            ..LinkStatistics::default()
        },
        timing: Timing {
            rate_asked_hz: 100.0,
            rate_achieved_hz: 99.6,
            lateness_p50_s: 0.000_12,
            lateness_p99_s: 0.001_9,
            lateness_max_s: 0.004,
            cycles: 845,
            missed_cycles: 3,
        },
        rows: 840,
        notices: vec![
            notice(Level::Info, "watchdog proven: output off 98 ms after silence"),
            notice(Level::Warning, "voltage limited by the guard in 12 cycles"),
        ],
        ..Snapshot::default()
    }
}

fn hardware() -> Snapshot {
    Snapshot {
        target: Target::Hardware,
        phase: Some(Phase::Safe),
        drive_state: Some(DriveState::Ready),
        trace: Arc::default(),
        estimates: Arc::default(),
        excitation: Arc::default(),
        elapsed_s: 0.0,
        segment: None,
        link: "/dev/ttyUSB0".to_owned(),
        ..running()
    }
}

fn tripped() -> Snapshot {
    let reason = "over-current: current 11.8200 A, limit 11.4000 A";
    let mut notices = running().notices;
    notices.push(notice(Level::Error, reason));
    Snapshot {
        phase: Some(Phase::Tripped),
        drive_state: Some(DriveState::Disabled),
        trip: Some(Trip {
            kind: TripKind::OverCurrent,
            at_s: 8.4,
            value: 11.82,
            limit: 11.4,
            reason: reason.to_owned(),
        }),
        notices,
        recorder_error: Some("no space left on device".to_owned()),
        outcome: Some("tripped"),
        stop: Some(Stop {
            cause: "over-current".to_owned(),
            trip: Some(TripKind::OverCurrent),
            at_s: Some(8.4),
            ramp_ms: None,
            sent_after_ms: Some(0.1),
            confirmed_after_ms: Some(18.0),
            attempts: 1,
            watchdog_s: Some(0.5),
            last_refusal: None,
        }),
        ..running()
    }
}

fn done() -> Snapshot {
    Snapshot {
        phase: Some(Phase::Done),
        drive_state: Some(DriveState::Disabled),
        elapsed_s: 24.0,
        outcome: Some("done"),
        model_is_identified: true,
        ..running()
    }
}

/// Only the speed comes in, with nothing else known.
fn missing() -> Snapshot {
    let trace = trace(3.0).into_iter().map(|point| TracePoint {
        voltage_v: f64::NAN,
        current_a: f64::NAN,
        model_speed_rad_s: f64::NAN,
        ..point
    });
    Snapshot {
        phase: Some(Phase::Running),
        trace: Arc::new(trace.collect()),
        ..Snapshot::default()
    }
}

fn workflow(finished: bool) -> Progress {
    use StepState::{Active, Done, Failed, Waiting};
    let step = |(step, state, line): &(Step, StepState, &str)| StepView {
        state: *state,
        line: (*line).to_owned(),
        ..StepView::new(*step)
    };
    let checked = (Step::Safety, Done, "watchdog proven in 98 ms");
    let [fit, confirm] = [Role::Fit, Role::Confirm].map(Step::Record);
    let found = "quadratic_load, probability 0.99";
    let (steps, report) = if finished {
        let steps = [
            checked,
            (fit, Done, "2,400 rows"),
            (Step::Diagnose, Done, found),
            (confirm, Failed, "the third run was stopped"),
        ];
        (steps, Some(Arc::new(crate::report::testing::document())))
    } else {
        let steps = [
            checked,
            (fit, Active, "8.4 of 24 s"),
            (Step::Diagnose, Waiting, ""),
            (confirm, Waiting, ""),
        ];
        (steps, None)
    };
    Progress { steps: steps.iter().map(step).collect(), report, finished }
}

fn model(snapshot: Snapshot) -> Model {
    let mut model = Model::new(None);
    model.update(Event::Snapshot(Arc::new(snapshot)));
    model
}

fn terminal(model: &Model, width: u16, height: u16) -> Terminal<TestBackend> {
    testing::terminal((width, height), |frame| view(model, frame))
}

fn text(model: &Model, width: u16, height: u16) -> String {
    terminal(model, width, height).backend().to_string()
}

fn with(model: &Model, change: impl FnOnce(&mut Model)) -> Model {
    let mut changed = model.clone();
    change(&mut changed);
    changed
}

/// The same with a provisional ranking of effects.
fn ranked(snapshot: Snapshot) -> Model {
    let mut model = model(snapshot);
    let ranked = |effect, share| RankedEffect { effect, equation: "torque", share, windows: 212 };
    model.update(Event::Ranking(Arc::new(ProvisionalRanking {
        effects: vec![ranked("quadratic_load", 0.93), ranked("viscous_friction", 0.41)],
        seconds: 8.4,
    })));
    model
}

fn press(model: &mut Model, press: Press) -> Vec<Effect> {
    model.update(Event::Press(press))
}

/// The model after these keys, and the effects of the last one.
fn after(mut model: Model, keys: &str) -> (Model, Vec<Effect>) {
    let effects = keys.chars().map(|key| press(&mut model, testing::key(key))).last();
    (model, effects.unwrap_or_default())
}

fn pressed(model: Model, keys: &str) -> Model {
    after(model, keys).0
}

fn finish(model: &mut Model) -> Vec<Effect> {
    model.update(Event::Worker(WorkerState::Finished))
}

fn finished(mut model: Model) -> Model {
    finish(&mut model);
    model
}

fn report(model: &mut Model, is_there: bool) {
    model.update(Event::Workflow(Arc::new(workflow(is_there))));
}

/// A commissioning with its report, or without it.
fn commissioned(snapshot: Snapshot, is_there: bool) -> Model {
    with(&model(snapshot), |own| report(own, is_there))
}

fn unsure(phase: Phase, outcome: &'static str) -> Snapshot {
    let stop_error = Some("no reply within 200 ms".to_owned());
    Snapshot { phase: Some(phase), outcome: Some(outcome), stop_error, ..done() }
}

fn in_phase(phase: Option<Phase>, target: Target) -> Model {
    model(Snapshot { phase, target, drive_state: Some(DriveState::Ready), ..missing() })
}

fn with_drive(phase: Phase, target: Target, state: DriveState) -> Model {
    with(&in_phase(Some(phase), target), |own| {
        Arc::make_mut(&mut own.snapshot).drive_state = Some(state);
    })
}

/// The end of a commissioning in which this step can follow or cannot.
fn following(step: Step, state: StepState, again: bool) -> Model {
    let mut workflow = workflow(true);
    workflow.steps.push(StepView {
        state,
        // A step that is done can be repeated while it has a command: a next run, if there is one.
        command: again.then(|| "drivebench run next.toml".to_owned()),
        line: "none would distinguish more".to_owned(),
        ..StepView::new(step)
    });
    with(&model(done()), |own| drop(own.update(Event::Workflow(Arc::new(workflow)))))
}

const STOP: [Effect; 2] = [Effect::Send(Intent::Stop), Effect::RequestStop];
const STOP_AND_QUIT: [Effect; 2] = [Effect::Send(Intent::Quit), Effect::RequestStop];
const START: Effect = Effect::Send(Intent::Start);
const RESET: Effect = Effect::Send(Intent::ResetFault);

/// A state, keys, the effects of the last one, and a part of what the screen then shows.
type Row<'a> = (&'a dyn Fn() -> Model, &'a str, Vec<Effect>, &'a str);

#[test]
fn each_key_has_its_effect_and_message() {
    use DriveState::{Fault, Ready, Running};
    use Exit::{Diagnosis, Experiment, Finished, SpeedLoop, Traces};
    use Phase::{Connecting, Safe};
    use StepState::{Done, Failed, Offered, Waiting};
    use Target::{Hardware, Sim};
    let leave = |exit| vec![Effect::Leave(exit)];
    let over = |step, state, again| finished(following(step, state, again));
    let followed =
        |snapshot| with(&model(snapshot), |own| own.followed_by = Some("back to the steps"));
    let mark = Effect::Send(Intent::Mark("mark 1".to_owned()));
    let (hard, none) = (|| in_phase(Some(Safe), Hardware), Vec::new);
    let rows: &[Row<'_>] = &[
        (&|| model(running()), "q", none(), "stop first: Space"),
        (&|| with_drive(Connecting, Hardware, Running), "q", none(), "stop first: Space"),
        (&|| finished(model(running())), "q", leave(Finished), "output off"),
        (&|| finished(model(tripped())), "q", leave(Finished), "SAFETY TRIP"),
        (&|| finished(model(hardware())), "q", leave(Finished), "output off"),
        (&|| finished(model(done())), "q", leave(Finished), "output off"),
        (&|| followed(done()), "", none(), "q quit"),
        (&|| finished(followed(done())), "", none(), "q back to the steps"),
        (&|| finished(followed(done())), "", none(), "q = back to the steps."),
        (&|| finished(followed(unsure(Phase::Done, "done"))), "", none(), "q quit"),
        (&|| finished(followed(tripped())), "", none(), "q quit"),
        (&|| finished(followed(running())), "", none(), "q quit"),
        (&|| model(done()), "d", none(), "not yet"),
        (&|| finished(model(done())), "d", leave(Diagnosis), "d = diagnosis by hand, q = quit"),
        (&|| finished(model(done())), "v", leave(Traces), "output off"),
        (&|| finished(model(tripped())), "d", none(), "not yet"),
        (&|| commissioned(done(), true), "d", none(), "not yet"),
        (&|| finished(commissioned(done(), true)), "d", leave(Diagnosis), "EFFECT FOUND"),
        (&|| finished(commissioned(done(), false)), "d", none(), "not yet"),
        (&|| model(done()), "x", none(), "only a commissioning has further steps"),
        (&|| following(Step::Experiment, Offered, false), "x", none(), "not yet"),
        (&|| over(Step::Experiment, Waiting, false), "x", none(), "none would distinguish more"),
        (&|| over(Step::Experiment, Offered, false), "x", leave(Experiment), ""),
        (&|| over(Step::Experiment, Done, true), "x", leave(Experiment), ""),
        (&|| over(Step::Experiment, Done, false), "x", none(), "none would distinguish more"),
        // A run that could not be judged is made again.
        (&|| over(Step::Experiment, Failed, true), "x", leave(Experiment), ""),
        (&|| over(Step::Experiment, Failed, false), "x", none(), "none would distinguish more"),
        (&|| over(Step::SpeedLoop, Offered, false), "l", leave(SpeedLoop), ""),
        (&|| over(Step::SpeedLoop, Done, false), "l", none(), "none would distinguish more"),
        (&|| in_phase(Some(Safe), Sim), "s", vec![START], ""),
        (&hard, "s", none(), "Shaft clear? y = start"),
        (&hard, "sy", vec![START], ""),
        (&hard, "sn", none(), "not started"),
        (&hard, "sny", none(), "there is no question to answer"),
        (&hard, "y", none(), "there is no question to answer"),
        (&|| with_drive(Connecting, Sim, Fault), "k", vec![RESET], ""),
        (&|| with_drive(Phase::Running, Sim, Fault), "k", none(), "stop first"),
        (&|| with_drive(Safe, Sim, Ready), "k", none(), "the drive reports no fault"),
        (&|| model(running()), "m", vec![mark], "mark 1 set"),
        (&|| finished(model(running())), "m", none(), "nothing is recorded any more"),
        (&|| model(running()), "f", none(), "FROZEN, f = continue"),
        (&|| model(running()), "ff", none(), "0.0 s"),
        (&|| model(running()), "z", none(), "3.4 s"),
        (&|| model(running()), "?↓↓", none(), "help: Up Down scroll"),
        (&|| model(running()), "?q", none(), "Tab parameters"),
        (&|| model(running()), "⇥", none(), "Tab live"),
        (&|| model(running()), "⇥⇥", none(), "Tab parameters"),
        (&|| model(running()), "3", none(), "a plain run has two pages"),
        (&|| commissioned(running(), false), "⇤", none(), "Tab live"),
        (&|| commissioned(running(), false), "⇤⇥", none(), "Tab parameters"),
        (&|| commissioned(running(), false), "3", none(), "Tab live"),
        (&|| commissioned(running(), false), "3↓", none(), "Tab live"),
    ];
    for (row, (model, keys, effects, part)) in rows.iter().enumerate() {
        let (model, found) = after(model(), keys);
        assert_eq!(found, *effects, "row {row}, {keys:?}: {part}");
        let shown = text(&model, 80, 24);
        assert!(shown.contains(part), "row {row}, {keys:?}: {part}: {shown}");
    }
    let shown = text(&finished(ranked(done())), 80, 24);
    assert!(!shown.contains("provisional"), "{shown}");
}

#[test]
fn a_question_that_is_withdrawn_starts_nothing() {
    let question = pressed(in_phase(Some(Phase::Safe), Target::Hardware), "s");
    for other in [Press::Next, Press::Click(Position::ORIGIN), Press::Wheel(1)] {
        let mut refused = question.clone();
        assert_eq!(press(&mut refused, other), []);
        assert_eq!(press(&mut refused, Press::Yes), [], "{other:?}");
    }
    let mut late = question;
    late.update(Event::Snapshot(Arc::new(tripped())));
    assert!(!late.confirm_start);
    assert_eq!(press(&mut late, Press::Yes), []);
}

#[test]
fn estimates_under_a_limit_of_the_drive_are_shown_as_frozen() {
    let shown = |since_s| {
        let frozen = Frozen { rows: 120, seconds: 1.2, since_s };
        let model = model(Snapshot { frozen, ..running() });
        [(120, 40), (80, 24)].map(|(width, height)| text(&model, width, height))
    };
    let [wide, narrow] = shown(Some(7.2));
    assert!(wide.contains("frozen: the drive limits, 1.2 s, 120 rows"), "{wide}");
    assert!(narrow.contains("frozen: drive limits 1.2 s"), "{narrow}");
    assert!(shown(None).iter().all(|text| !text.contains("frozen")));
}

#[test]
fn a_value_that_is_gone_stays_with_its_age_until_the_run_ends() {
    let gone = Arc::clone(&between_two_values().snapshot.estimates);
    let mut forbidden = running().estimates.to_vec();
    forbidden[3].verdict = Verdict::Invalid;
    let held = (Some(0.004_6), "value of 3.2 s ago; the speed has not changed for a while");
    let nothing = (None, "the speed has not changed for a while");
    let at = |elapsed_s, estimates| Snapshot { elapsed_s, estimates, ..running() };
    for (name, snapshots, (value, reason)) in [
        ("held", vec![], held),
        ("over", vec![Snapshot { estimates: Arc::clone(&gone), ..done() }], nothing),
        ("forbidden by physics", vec![at(12.0, Arc::new(forbidden)), at(12.0, gone)], nothing),
    ] {
        let mut model = between_two_values();
        for snapshot in snapshots {
            model.update(Event::Snapshot(Arc::new(snapshot)));
        }
        let found = &model.parameters()[3];
        assert_eq!((found.value, found.reason.as_deref()), (value, Some(reason)), "{name}");
    }
    // A frozen page keeps the values of its moment.
    let mut model = pressed(between_two_values(), "f2");
    let parameters = model.parameters();
    assert!(text(&model, 120, 40).contains("value of 3.2 s ago"));
    for later in [Snapshot { elapsed_s: 14.0, ..running() }, done()] {
        model.update(Event::Snapshot(Arc::new(later)));
    }
    assert_eq!(model.parameters(), parameters);
}

#[test]
fn a_message_of_a_key_expires_after_a_while() {
    let mut model = model(running());
    assert!(!model.may_suspend());
    assert!(!model.message_expires() && model.message.is_some());
    let updates = (0..1000).position(|_| model.message_expires());
    assert!(updates.is_some_and(|updates| updates > 100), "{updates:?}");
    assert_eq!(model.message, None);
}

#[test]
fn a_lost_link_that_is_back_shows_its_result() {
    let mut lost = running();
    (lost.phase, lost.outcome) = (Some(Phase::Safe), Some("link_lost"));
    lost.reopening = Some("x: the same drive is back, stop confirmed".to_owned());
    let shown = text(&finished(model(lost)), 80, 24);
    assert!(shown.contains(" SAFE ") && shown.contains("stop confirmed. q = quit."), "{shown}");
}

#[test]
fn a_stop_that_was_not_confirmed_is_never_an_output_that_is_off() {
    for (phase, outcome) in [
        (Phase::Stopped, "stopped"),
        (Phase::Stopped, "interrupted"),
        (Phase::Tripped, "tripped"),
        (Phase::LinkLost, "link_lost"),
        (Phase::Stopped, "not_started"),
    ] {
        let shown = text(&finished(model(unsure(phase, outcome))), 80, 24);
        assert!(shown.contains("Stop NOT confirmed"), "{outcome}: {shown}");
        assert!(!shown.contains("Output off"), "{outcome}: {shown}");
    }
}

#[test]
fn the_report_is_shown_when_it_comes_and_only_then() {
    let mut model = finished(model(done()));
    for (is_there, page) in [(false, Page::Live), (true, Page::Steps)] {
        report(&mut model, is_there);
        assert_eq!(model.page, page);
    }
    let shown = text(&model, 80, 24);
    assert!(shown.contains("EFFECT FOUND: quadratic_load"), "{shown}");
    // A page chosen afterwards is kept.
    model.page = Page::Live;
    report(&mut model, true);
    assert_eq!(model.page, Page::Live);
}

#[test]
fn hardware_is_reversed_and_a_trip_is_white_on_red() {
    for (name, snapshot, at, symbol, fg, bg, is_reversed) in [
        ("hardware", hardware(), (2, 0), "A", Color::Red, Color::Reset, true),
        ("software", running(), (2, 0), "I", Color::Green, Color::Reset, false),
        ("trip", tripped(), (4, 3), "e", Color::White, Color::Red, false),
    ] {
        let shown = terminal(&model(snapshot), 80, 24);
        let cell = &shown.backend().buffer()[at];
        assert_eq!((cell.symbol(), cell.fg, cell.bg), (symbol, fg, bg), "{name}");
        assert_eq!(cell.modifier.contains(Modifier::REVERSED), is_reversed, "{name}");
    }
}

#[test]
fn a_frozen_view_keeps_its_data_while_trips_stay_live() {
    let mut model = pressed(model(running()), "f");
    let later = Snapshot { trace: Arc::default(), ..tripped() };
    model.update(Event::Snapshot(Arc::new(later)));
    let text = text(&model, 80, 24);
    assert!(text.contains("SAFETY TRIP") && text.contains("TRIPPED"), "{text}");
    assert!(text.contains("FROZEN") && text.contains('⣀') && text.contains('⠉'), "{text}");
}

fn phases() -> impl Iterator<Item = Option<Phase>> {
    use Phase::{Armed, Connecting, Done, LinkLost, RampDown, Running, Safe};
    use Phase::{Stopped, Stopping, Tripped};
    let all =
        [Connecting, Safe, Armed, Running, RampDown, Stopping, Done, Stopped, Tripped, LinkLost];
    std::iter::once(None).chain(all.map(Some))
}

/// Every state that changes what keys do.
fn every_state() -> Vec<Model> {
    let mut models = Vec::new();
    for phase in phases() {
        for target in [Target::Sim, Target::Hardware] {
            let model = in_phase(phase, target);
            models.extend([
                pressed(model.clone(), "?"),
                pressed(model.clone(), "f"),
                with(&model, |own| report(own, true)),
                with(&model, |own| own.confirm_start = true),
                finished(model.clone()),
                model,
            ]);
        }
    }
    models
}

#[test]
fn in_every_state_space_stops_and_ctrl_c_stops_then_quits() {
    let left = [Effect::Leave(Exit::Interrupted)];
    for mut model in every_state() {
        assert_eq!(press(&mut model.clone(), Press::Stop), STOP, "{model:?}");
        if model.is_finished() {
            assert_eq!(press(&mut model, Press::Interrupt), left);
            continue;
        }
        let mut hanging = model.clone();
        assert_eq!(press(&mut model, Press::Interrupt), STOP_AND_QUIT);
        assert_eq!(finish(&mut model), left);
        for _ in 0..2 {
            assert_eq!(press(&mut hanging, Press::Interrupt), STOP_AND_QUIT);
        }
        // The third leaves a worker that does not come back.
        assert!(press(&mut hanging, Press::Interrupt).contains(&Effect::Leave(Exit::Forced)));
    }
}

#[test]
fn only_the_confirmed_start_starts_and_no_key_leaves_while_on() {
    use Press::{Move, NextScreen, Open, Other, PreviousScreen};
    let more = [NextScreen, PreviousScreen, Move(-1), Move(1), Move(10), Open, Other];
    for model in every_state() {
        for key in CHARACTERS.into_iter().map(|(_, press)| press).chain(more) {
            let effects = press(&mut model.clone(), key);
            if effects.contains(&START) {
                let is_requested = key == Press::Start && !model.is_hardware();
                let is_confirmed = key == Press::Yes && model.confirm_start;
                let may_start = model.waits_for_start() && (is_requested || is_confirmed);
                assert!(may_start, "{key:?} {model:?}");
            }
            let leaves = effects.iter().any(|effect| matches!(effect, Effect::Leave(_)));
            assert!(!(leaves && model.is_energised()), "{key:?} {model:?}");
        }
    }
}

#[test]
fn in_every_state_an_idle_key_explains_and_ctrl_z_waits() {
    for model in every_state() {
        for key in ["y", "#", "a", "e", "c", "u", "+", "→", "↓"] {
            let (after, effects) = after(model.clone(), key);
            let closes = model.help.first.is_some();
            let scrolls = key == "↓" && model.page == Page::Steps;
            let is_answered = after.message.is_some() || !effects.is_empty();
            assert!(is_answered || scrolls || closes, "{key:?} {model:?}");
        }
        let mut halted = model.clone();
        assert_eq!(halted.may_suspend(), model.is_finished(), "{model:?}");
        let refused = halted.message.is_some_and(|text| text.starts_with("Ctrl-Z"));
        assert_eq!(refused, !model.is_finished());
    }
}

#[test]
fn q_requires_a_stop_exactly_where_the_output_may_be_on() {
    use Phase::{Armed, RampDown, Running, Stopping};
    for phase in phases() {
        let (mut model, effects) = after(in_phase(phase, Target::Sim), "q");
        if matches!(phase, Some(Armed | Running | RampDown | Stopping)) {
            assert_eq!(effects, [], "{phase:?}");
            assert_eq!(model.message.as_deref(), Some("stop first: Space"));
        } else {
            assert_eq!(effects, STOP_AND_QUIT, "{phase:?}");
            assert_eq!(finish(&mut model), [Effect::Leave(Exit::Quit)]);
        }
    }
    // A screen on which no run ever began leaves by itself, so that the reason is printed.
    assert_eq!(finish(&mut Model::new(None)), [Effect::Leave(Exit::Finished)]);
}

#[test]
fn a_worker_that_panics_has_finished() {
    let cell = WorkerCell::default();
    let inner = cell.clone();
    let worker = std::thread::spawn(move || {
        let _guard = inner.finish_on_drop();
        assert_eq!(inner.state(true), WorkerState::Working);
        std::panic::resume_unwind(Box::new("on purpose"));
    });
    assert!(worker.join().is_err());
    assert_eq!(cell.state(false), WorkerState::Finished);
    assert_eq!(cell.state(true), WorkerState::Leave);
}
