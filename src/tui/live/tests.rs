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
use crate::workflow::{Progress, Provisional, Role, Step, StepState, StepView};
use drivebench_bench::{
    Excitation, InnovationPoint, Intent, Level, Notice, Phase, Snapshot, Stop, Target, Timing,
    TracePoint, Trip, TripKind,
};
use drivebench_diagnose::Leaning;
use drivebench_identify::online::Frozen;
use drivebench_link::LinkStatistics;
use drivebench_model::sample::{DriveState, ParameterEstimate, Verdict};
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
        ParameterEstimate::not_observable("load_torque_n_m", "N.m", carried),
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

/// The same while its residual leans on something.
fn leaning(snapshot: Snapshot) -> Model {
    let mut model = model(snapshot);
    let leaning = |effect, share| Leaning { effect, equation: "torque", share, windows: 212 };
    model.update(Event::Leaning(Arc::new(Provisional {
        effects: vec![leaning("quadratic_load", 0.93), leaning("viscous_friction", 0.41)],
        seconds: 8.4,
    })));
    model
}

fn pressed(mut model: Model, key: Press) -> Model {
    press(&mut model, key);
    model
}

fn finished(mut model: Model) -> Model {
    finish(&mut model);
    model
}

#[test]
fn estimates_that_learn_nothing_under_a_limit_of_the_drive_are_shown_as_frozen_until_they_learn_again()
 {
    let shown = |since_s| {
        let frozen = Frozen { rows: 120, seconds: 1.2, since_s };
        let running = Snapshot { frozen, ..running() };
        [(120, 40), (80, 24)].map(|(width, height)| text(&model(running.clone()), width, height))
    };
    let [wide, narrow] = shown(Some(7.2));
    assert!(wide.contains("frozen: the drive limits, 1.2 s, 120 rows"), "{wide}");
    assert!(narrow.contains("frozen: drive limits 1.2 s"), "{narrow}");
    assert!(shown(None).iter().all(|text| !text.contains("frozen")));
}

#[test]
fn a_value_that_is_gone_for_a_while_stays_with_its_age_until_the_run_is_over() {
    let mut model = between_two_values();
    let shown = text(&model, 120, 40);
    assert!(shown.contains("0.0046 ± 0.0019 kg.m2"), "{shown}");
    assert!(shown.contains("value of 3.2 s ago"), "{shown}");
    let last = Snapshot { estimates: Arc::clone(&model.snapshot.estimates), ..done() };
    model.update(Event::Snapshot(Arc::new(last)));
    let shown = text(&model, 120, 40);
    assert!(!shown.contains("0.0046 ± 0.0019"), "{shown}");
}

#[test]
fn a_frozen_page_keeps_the_values_of_its_moment() {
    let mut model = pressed(between_two_values(), Press::Freeze);
    model.page = Page::Parameters;
    let before = text(&model, 120, 40);
    assert!(before.contains("value of 3.2 s ago"), "{before}");
    let mut later = running();
    later.elapsed_s = 14.0;
    model.update(Event::Snapshot(Arc::new(later)));
    let parameters = model.parameters();
    model.update(Event::Snapshot(Arc::new(done())));
    assert_eq!(model.parameters(), parameters);
    let reason = parameters[3].reason.as_deref().unwrap_or_default();
    assert!(reason.starts_with("value of 3.2 s ago"), "{reason}");
}

#[test]
fn a_value_that_physics_forbids_does_not_come_back() {
    let mut model = between_two_values();
    let gone = Arc::clone(&model.snapshot.estimates);
    let mut estimates = running().estimates.to_vec();
    estimates[3].verdict = Verdict::Invalid;
    for estimates in [Arc::new(estimates), gone] {
        let snapshot = Snapshot { elapsed_s: 12.0, estimates, ..running() };
        model.update(Event::Snapshot(Arc::new(snapshot)));
    }
    assert_eq!(model.parameters()[3].value, None);
}

#[test]
fn an_answer_to_a_key_gives_the_keys_back_after_a_while() {
    let mut model = model(running());
    assert!(!model.may_suspend());
    assert!(!model.forgets() && model.message.is_some());
    let looks = (0..1000).position(|_| model.forgets());
    assert!(looks.is_some_and(|looks| looks > 100), "{looks:?}");
    assert_eq!(model.message, None);
}

#[test]
fn q_says_where_it_leads_where_the_run_went_to_its_end() {
    let leads = |own: &mut Model| own.leads = Some("back to the loop");
    let unsure = Snapshot { stop_error: Some("no reply within 200 ms".to_owned()), ..done() };
    for (snapshot, is_led) in
        [(done(), true), (unsure, false), (tripped(), false), (running(), false)]
    {
        let mut model = with(&model(snapshot), leads);
        assert_eq!(model.quits(), "quit", "the work is not over");
        finish(&mut model);
        let expected = if is_led { "back to the loop" } else { "quit" };
        let shown = text(&model, 120, 40);
        assert!(shown.contains(&format!("q {expected}")), "{shown}");
        assert!(shown.contains(&format!("q = {expected}.")) || !is_led, "{shown}");
    }
}

#[test]
fn a_key_that_does_nothing_says_why() {
    for model in every_state().into_iter().filter(|own| own.help.is_none()) {
        for key in [
            Press::Yes,
            Press::Other,
            Press::Add,
            Press::Map,
            Press::Curve,
            Press::Undo,
            Press::Zoomed(true),
            Press::Cursor(1),
            Press::Move(1),
        ] {
            let mut model = model.clone();
            let effects = press(&mut model, key);
            let is_answered = model.message.is_some() || !effects.is_empty();
            let scrolls = key == Press::Move(1) && model.page == Page::Steps;
            assert!(is_answered || scrolls, "{key:?} {model:?}");
        }
    }
}

#[test]
fn what_is_provisional_is_said_so_and_is_gone_when_the_run_is_over() {
    let run = leaning(running());
    let shown = text(&run, 80, 24);
    assert!(shown.contains("provisional, 8 s: torque residual leans on"), "{shown}");
    let shown = text(&finished(leaning(done())), 80, 24);
    assert!(!shown.contains("provisional"), "{shown}");
}

#[test]
fn a_lost_link_tells_how_the_search_goes_and_what_came_of_it() {
    let mut lost = running();
    lost.phase = Some(Phase::LinkLost);
    lost.outcome = Some("link_lost");
    lost.reopening = Some("link lost, reopening (attempt 3)…".to_owned());
    for (width, height) in [(80, 24), (120, 40), (40, 10)] {
        let shown = text(&model(lost.clone()), width, height);
        assert!(shown.contains("LINK LOST"), "{shown}");
        assert!(shown.contains("reopening (attempt 3)…"), "{shown}");
    }
    lost.phase = Some(Phase::Safe);
    lost.reopening = Some("x: the same drive is back, stop confirmed".to_owned());
    let shown = text(&finished(model(lost)), 80, 24);
    assert!(shown.contains(" SAFE "), "{shown}");
    assert!(shown.contains("stop confirmed. q = quit."), "{shown}");
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
        let mut unsure = done();
        (unsure.phase, unsure.outcome) = (Some(phase), Some(outcome));
        unsure.stop_error = Some("no reply within 200 ms".to_owned());
        let shown = text(&finished(model(unsure)), 80, 24);
        assert!(shown.contains("Stop NOT confirmed"), "{outcome}: {shown}");
        assert!(!shown.contains("Output off"), "{outcome}: {shown}");
    }
}

fn shows_the_card(model: &Model) {
    let shown = text(model, 80, 24);
    assert!(shown.contains("EFFECT FOUND: quadratic_load"), "{shown}");
}

#[test]
fn the_report_is_shown_when_it_comes() {
    let mut model = finished(model(done()));
    report(&mut model, false);
    assert_eq!(model.page, Page::Live);
    report(&mut model, true);
    assert_eq!(model.page, Page::Steps);
    shows_the_card(&model);
    // Turning away afterwards is respected.
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
fn a_frozen_view_keeps_its_data_while_bars_and_trips_stay_live() {
    let mut model = model(running());
    press(&mut model, Press::Freeze);
    let mut later = tripped();
    later.trace = Arc::default();
    model.update(Event::Snapshot(Arc::new(later)));
    let text = text(&model, 80, 24);
    assert!(text.contains("SAFETY TRIP") && text.contains("TRIPPED"), "{text}");
    assert!(text.contains("FROZEN") && text.contains('⣀') && text.contains('⠉'), "{text}");
}

fn phases() -> impl Iterator<Item = Option<Phase>> {
    use Phase::{Armed, Connecting, Done, LinkLost, RampDown, Running, Safe};
    use Phase::{Stopped, Stopping, Tripped};
    let before = [Connecting, Safe, Armed, Running, RampDown];
    let after = [Stopping, Done, Stopped, Tripped, LinkLost];
    std::iter::once(None).chain(before.into_iter().chain(after).map(Some))
}

/// Every key but that which stops and Ctrl-C.
fn others() -> impl Iterator<Item = Press> {
    use Press::{Move, NextScreen, Open, Other, PreviousScreen};
    let more = [NextScreen, PreviousScreen, Move(-1), Move(1), Move(10), Open, Other];
    CHARACTERS.into_iter().map(|(_, press)| press).filter(|press| *press != Press::Stop).chain(more)
}

const STOP: [Effect; 2] = [Effect::Send(Intent::Stop), Effect::RequestStop];
const STOP_AND_QUIT: [Effect; 2] = [Effect::Send(Intent::Quit), Effect::RequestStop];
const START: [Effect; 1] = [Effect::Send(Intent::Start)];

fn press(model: &mut Model, press: Press) -> Vec<Effect> {
    model.update(Event::Press(press))
}

fn finish(model: &mut Model) -> Vec<Effect> {
    model.update(Event::Worker(WorkerState::Finished))
}

fn report(model: &mut Model, is_there: bool) {
    model.update(Event::Workflow(Arc::new(workflow(is_there))));
}

fn in_phase(phase: Option<Phase>, target: Target) -> Model {
    model(Snapshot { phase, target, drive_state: Some(DriveState::Ready), ..missing() })
}

/// Every state that changes what keys do.
fn every_state() -> Vec<Model> {
    let mut models = Vec::new();
    for phase in phases() {
        for target in [Target::Sim, Target::Hardware] {
            for variant in 0..6 {
                let mut model = in_phase(phase, target);
                match variant {
                    1 => model.help = Some(0),
                    2 => drop(press(&mut model, Press::Freeze)),
                    3 => report(&mut model, true),
                    4 => model.confirm_start = true,
                    5 => drop(finish(&mut model)),
                    _ => {}
                }
                models.push(model);
            }
        }
    }
    models
}

#[test]
fn space_and_escape_stop_in_every_state() {
    for mut model in every_state() {
        assert_eq!(press(&mut model, Press::Stop), STOP, "{model:?}");
    }
}

#[test]
fn no_key_but_the_confirmed_start_starts_and_none_leaves_while_energised() {
    for model in every_state() {
        for key in others() {
            let effects = press(&mut model.clone(), key);
            if effects.contains(&START[0]) {
                let is_asked = key == Press::Start && !model.is_hardware();
                let is_confirmed = key == Press::Yes && model.confirm_start;
                assert!(model.waits_for_start() && (is_asked || is_confirmed), "{key:?} {model:?}");
            }
            let leaves = effects.iter().any(|effect| matches!(effect, Effect::Leave(_)));
            assert!(!(leaves && model.is_energised()), "{key:?} {model:?}");
        }
    }
}

#[test]
fn q_says_stop_first_exactly_where_the_output_may_be_on() {
    for phase in phases() {
        let mut model = in_phase(phase, Target::Sim);
        let effects = press(&mut model, Press::Quit);
        if matches!(phase, Some(Phase::Armed | Phase::Running | Phase::RampDown | Phase::Stopping))
        {
            assert_eq!(effects, [], "{phase:?}");
            assert_eq!(model.message.as_deref(), Some("stop first: Space"));
        } else {
            assert_eq!(effects, STOP_AND_QUIT, "{phase:?}");
            assert_eq!(finish(&mut model), [Effect::Leave(Exit::Quit)]);
        }
    }
    // Found running by somebody else, before this program ever started it.
    let mut found = in_phase(Some(Phase::Connecting), Target::Hardware);
    Arc::make_mut(&mut found.snapshot).drive_state = Some(DriveState::Running);
    assert_eq!(press(&mut found, Press::Quit), []);
}

#[test]
fn a_screen_on_which_no_run_ever_began_leaves_by_itself_so_that_the_reason_is_told() {
    assert_eq!(finish(&mut Model::new(None)), [Effect::Leave(Exit::Finished)]);
}

#[test]
fn q_leaves_when_the_work_is_over() {
    for snapshot in [running(), tripped(), done(), hardware()] {
        let mut model = model(snapshot);
        assert_eq!(finish(&mut model), []);
        assert_eq!(press(&mut model, Press::Quit), [Effect::Leave(Exit::Finished)]);
    }
}

#[test]
fn d_goes_on_by_hand_exactly_where_the_report_is_there_and_the_work_over() {
    let mut model = model(done());
    report(&mut model, true);
    assert_eq!(press(&mut model, Press::Diagnose), []);
    finish(&mut model);
    assert_eq!(press(&mut model, Press::Diagnose), [Effect::Leave(Exit::Diagnosis)]);
    report(&mut model, false);
    assert_eq!(press(&mut model, Press::Diagnose), []);
}

#[test]
fn d_goes_on_from_a_run_that_went_to_its_end_and_from_no_other() {
    let mut whole = model(done());
    assert_eq!(press(&mut whole, Press::Diagnose), [], "the work is not over");
    finish(&mut whole);
    assert_eq!(press(&mut whole, Press::Diagnose), [Effect::Leave(Exit::Diagnosis)]);
    let shown = terminal(&whole, 80, 24).backend().to_string();
    assert!(shown.contains("d = diagnosis by hand, q = quit"), "{shown}");
    assert!(shown.contains("output off") && !shown.contains("Space = STOP"), "{shown}");
    let mut halted = model(tripped());
    finish(&mut halted);
    assert_eq!(press(&mut halted, Press::Diagnose), []);
}

#[test]
fn ctrl_z_is_refused_for_as_long_as_the_bench_is_at_work() {
    for mut model in every_state() {
        let may = model.may_suspend();
        assert_eq!(may, model.is_finished(), "{model:?}");
        assert_eq!(may, !model.message.is_some_and(|text| text.starts_with("Ctrl-Z")));
    }
}

#[test]
fn what_follows_the_report_is_left_for_only_where_it_is_offered() {
    let keys = [
        (Press::Experiment, Step::Experiment, Exit::Experiment),
        (Press::SpeedLoop, Step::SpeedLoop, Exit::SpeedLoop),
    ];
    for (key, step, exit) in keys {
        let mut model = model(done());
        assert_eq!(press(&mut model, key), [], "a plain run");
        // What was done is done again where a command still does it: a next run, if there is one.
        let again = || Some("drivebench run next.toml".to_owned());
        for (state, command, is_left) in [
            (StepState::Waiting, None, false),
            (StepState::Offered, None, true),
            (StepState::Done, again(), true),
            (StepState::Done, None, false),
            // What came of it could not be judged: made again.
            (StepState::Failed, again(), true),
            (StepState::Failed, None, false),
        ] {
            let mut workflow = workflow(true);
            workflow.steps.push(StepView {
                state,
                command,
                line: "none would tell more".to_owned(),
                ..StepView::new(step)
            });
            let mut model = model.clone();
            model.update(Event::Workflow(Arc::new(workflow)));
            assert_eq!(press(&mut model, key), [], "the work is under way");
            finish(&mut model);
            let left = press(&mut model, key);
            if is_left {
                assert_eq!(left, [Effect::Leave(exit)], "{state:?}");
            } else {
                assert_eq!(left, [], "{state:?}");
                let said = model.message.unwrap_or_default();
                assert!(said.contains("none would tell more"), "{state:?}: {said}");
            }
        }
    }
}

#[test]
fn ctrl_c_stops_then_quits_and_the_third_leaves_a_worker_that_hangs() {
    for mut model in every_state() {
        let left = [Effect::Leave(Exit::Interrupted)];
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
        assert!(press(&mut hanging, Press::Interrupt).contains(&Effect::Leave(Exit::Forced)));
    }
}

#[test]
fn a_start_on_hardware_is_confirmed_and_anything_else_withdraws_it() {
    let mut soft = in_phase(Some(Phase::Safe), Target::Sim);
    assert_eq!(press(&mut soft, Press::Start), START);
    let mut hard = in_phase(Some(Phase::Safe), Target::Hardware);
    assert_eq!(press(&mut hard, Press::Start), []);
    for other in [Press::Next, Press::Click(Position::ORIGIN), Press::Wheel(1)] {
        let mut refused = hard.clone();
        assert_eq!(press(&mut refused, other), []);
        assert_eq!(press(&mut refused, Press::Yes), [], "{other:?}");
    }
    let mut late = hard.clone();
    assert_eq!(press(&mut hard, Press::Yes), START);
    // A question that is no longer one is withdrawn.
    late.update(Event::Snapshot(Arc::new(tripped())));
    assert!(!late.confirm_start);
    assert_eq!(press(&mut late, Press::Yes), []);
}

#[test]
fn faults_are_reset_only_where_there_is_one_and_nothing_is_energised() {
    let reset = vec![Effect::Send(Intent::ResetFault)];
    for (phase, state, expected) in [
        (Phase::Connecting, DriveState::Fault, reset),
        (Phase::Running, DriveState::Fault, vec![]),
        (Phase::Safe, DriveState::Ready, vec![]),
    ] {
        let mut model = in_phase(Some(phase), Target::Sim);
        Arc::make_mut(&mut model.snapshot).drive_state = Some(state);
        assert_eq!(press(&mut model, Press::ResetFault), expected, "{phase:?} {state:?}");
    }
}

#[test]
fn view_keys_change_the_view_and_send_nothing() {
    let mut model = model(running());
    for is_frozen in [true, false] {
        assert_eq!(press(&mut model, Press::Freeze), []);
        assert_eq!(model.frozen.is_some(), is_frozen);
    }
    let before_s = model.window_s();
    assert_eq!(press(&mut model, Press::Zoom), []);
    assert!(model.window_s() < before_s);
    press(&mut model, Press::Help);
    press(&mut model, Press::Move(3));
    assert_eq!(model.help, Some(3));
    assert_eq!(press(&mut model, Press::Quit), []);
    assert!(model.help.is_none() && model.message.is_none());
    assert_eq!(press(&mut model, Press::Mark), [Effect::Send(Intent::Mark("mark 1".to_owned()))]);
}

#[test]
fn tab_goes_round_the_pages_that_there_are() {
    let mut model = model(running());
    for (key, page) in [
        (Press::NextScreen, Page::Parameters),
        (Press::NextScreen, Page::Live),
        (Press::Page(2), Page::Live),
    ] {
        press(&mut model, key);
        assert_eq!(model.page, page, "{key:?}");
    }
    report(&mut model, false);
    for (key, page) in [
        (Press::PreviousScreen, Page::Steps),
        (Press::NextScreen, Page::Live),
        (Press::Page(2), Page::Steps),
    ] {
        press(&mut model, key);
        assert_eq!(model.page, page, "{key:?}");
    }
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
