use std::sync::Arc;

use super::fixtures::{done, hardware, missing, model, running, tripped, workflow};
use crate::bench::{Intent, Phase, Snapshot, Target};
use crate::sample::DriveState;
use crate::tui::application::{Effect, Exit};
use crate::tui::keys::Press;
use crate::tui::live::model::{Event, Model, Page};
use crate::tui::live::{WorkerCell, WorkerState};

const PHASES: [Option<Phase>; 11] = [
    None,
    Some(Phase::Connecting),
    Some(Phase::Safe),
    Some(Phase::Armed),
    Some(Phase::Running),
    Some(Phase::RampDown),
    Some(Phase::Stopping),
    Some(Phase::Done),
    Some(Phase::Stopped),
    Some(Phase::Tripped),
    Some(Phase::LinkLost),
];

/// Every key but that which stops and Ctrl-C.
const OTHERS: [Press; 26] = [
    Press::Quit,
    Press::Start,
    Press::Yes,
    Press::Help,
    Press::Freeze,
    Press::Zoom,
    Press::Mark,
    Press::ResetFault,
    Press::Diagnose,
    Press::NextScreen,
    Press::PreviousScreen,
    Press::Page(0),
    Press::Page(2),
    Press::Move(-1),
    Press::Move(1),
    Press::Move(10),
    Press::Open,
    Press::Add,
    Press::Remove,
    Press::Map,
    Press::Next,
    Press::Curve,
    Press::Table,
    Press::Guess,
    Press::Write,
    Press::Other,
];

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
    model(Snapshot {
        phase,
        target,
        drive_state: Some(DriveState::Ready),
        ..missing()
    })
}

/// Every state that changes what keys do.
fn every_state() -> Vec<Model> {
    let mut models = Vec::new();
    for phase in PHASES {
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
        for key in OTHERS {
            let effects = press(&mut model.clone(), key);
            if effects.contains(&START[0]) {
                let is_asked = key == Press::Start && !model.is_hardware();
                let is_confirmed = key == Press::Yes && model.confirm_start;
                let may_start = model.waits_for_start() && (is_asked || is_confirmed);
                assert!(may_start, "{key:?} {model:?}");
            }
            let mut effects = effects.iter();
            let leaves = effects.any(|effect| matches!(effect, Effect::Leave(_)));
            assert!(!(leaves && model.is_energised()), "{key:?} {model:?}");
        }
    }
}

#[test]
fn q_says_stop_first_exactly_where_the_output_may_be_on() {
    for phase in PHASES {
        let mut model = in_phase(phase, Target::Sim);
        let effects = press(&mut model, Press::Quit);
        if matches!(
            phase,
            Some(Phase::Armed | Phase::Running | Phase::RampDown | Phase::Stopping)
        ) {
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
    let left = finish(&mut Model::new(None));
    assert_eq!(left, [Effect::Leave(Exit::Finished)]);
}

#[test]
fn q_leaves_when_the_work_is_over() {
    for snapshot in [running(), tripped(), done(), hardware()] {
        let mut model = model(snapshot);
        assert_eq!(finish(&mut model), []);
        let left = press(&mut model, Press::Quit);
        assert_eq!(left, [Effect::Leave(Exit::Finished)]);
    }
}

#[test]
fn d_goes_on_by_hand_exactly_where_the_report_is_there_and_the_work_over() {
    let mut model = model(done());
    report(&mut model, true);
    assert_eq!(press(&mut model, Press::Diagnose), []);
    finish(&mut model);
    let left = press(&mut model, Press::Diagnose);
    assert_eq!(left, [Effect::Leave(Exit::Diagnosis)]);
    report(&mut model, false);
    assert_eq!(press(&mut model, Press::Diagnose), []);
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
        let third = press(&mut hanging, Press::Interrupt);
        assert!(third.contains(&Effect::Leave(Exit::Forced)));
    }
}

#[test]
fn a_start_on_hardware_is_confirmed_and_anything_else_withdraws_it() {
    let mut soft = in_phase(Some(Phase::Safe), Target::Sim);
    assert_eq!(press(&mut soft, Press::Start), START);
    let mut hard = in_phase(Some(Phase::Safe), Target::Hardware);
    assert_eq!(press(&mut hard, Press::Start), []);
    let (mut refused, mut late) = (hard.clone(), hard.clone());
    assert_eq!(press(&mut hard, Press::Yes), START);
    assert_eq!(press(&mut refused, Press::Next), []);
    assert_eq!(press(&mut refused, Press::Yes), []);
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
        let effects = press(&mut model, Press::ResetFault);
        assert_eq!(effects, expected, "{phase:?} {state:?}");
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
    let marked = Intent::Mark("mark 1".to_owned());
    assert_eq!(press(&mut model, Press::Mark), [Effect::Send(marked)]);
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
