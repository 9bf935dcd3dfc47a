use std::sync::Arc;

use crossterm::event::{KeyCode, KeyEvent, KeyEventKind, KeyModifiers};

use super::fixtures::{done, hardware, missing, model, running, tripped, workflow};
use crate::bench::{Intent, Phase, Snapshot, Target};
use crate::sample::DriveState;
use crate::tui::Exit;
use crate::tui::keys::HELP;
use crate::tui::model::{Model, Screen};
use crate::tui::update::{Effect, Event};
use crate::tui::worker::WorkerState;

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

fn key(code: KeyCode) -> Event {
    Event::Key(KeyEvent::new(code, KeyModifiers::NONE))
}

fn letter(letter: char) -> Event {
    key(KeyCode::Char(letter))
}

fn ctrl_c() -> Event {
    Event::Key(KeyEvent::new(KeyCode::Char('c'), KeyModifiers::CONTROL))
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
                    1 => model.help = true,
                    2 => {
                        model.update(letter('f'));
                    }
                    3 => {
                        model.update(Event::Workflow(Arc::new(workflow(true))));
                    }
                    4 => model.confirm_start = true,
                    5 => {
                        model.update(Event::Worker(WorkerState::Finished));
                    }
                    _ => {}
                }
                models.push(model);
            }
        }
    }
    models
}

fn stop() -> Vec<Effect> {
    vec![Effect::Send(Intent::Stop), Effect::RequestStop]
}

#[test]
fn space_and_escape_stop_in_every_state() {
    for model in every_state() {
        let alt = Event::Key(KeyEvent::new(KeyCode::Char('q'), KeyModifiers::ALT));
        for event in [letter(' '), key(KeyCode::Esc), alt] {
            assert_eq!(model.clone().update(event), stop(), "{model:?}");
        }
        let release = KeyEvent::new_with_kind(
            KeyCode::Char(' '),
            KeyModifiers::NONE,
            KeyEventKind::Release,
        );
        assert_eq!(model.clone().update(Event::Key(release)), vec![]);
    }
}

#[test]
fn no_key_but_the_confirmed_start_starts_and_none_leaves_while_energised() {
    let codes: Vec<KeyCode> = (' '..='~')
        .map(KeyCode::Char)
        .chain([
            KeyCode::Enter,
            KeyCode::Tab,
            KeyCode::BackTab,
            KeyCode::Up,
            KeyCode::Down,
            KeyCode::PageUp,
            KeyCode::PageDown,
            KeyCode::Home,
            KeyCode::F(1),
            KeyCode::Backspace,
        ])
        .collect();
    for model in every_state() {
        for code in &codes {
            let mut after = model.clone();
            let effects = after.update(key(*code));
            if effects.contains(&Effect::Send(Intent::Start)) {
                assert!(model.waits_for_start(), "{code:?} {model:?}");
                let asked = matches!(code, KeyCode::Enter | KeyCode::Char('a' | 'A'));
                let confirmed = model.confirm_start && matches!(code, KeyCode::Char('y' | 'Y'));
                assert!(
                    (asked && !model.is_hardware()) || confirmed,
                    "{code:?} {model:?}"
                );
            }
            let leaves = effects
                .iter()
                .any(|effect| matches!(effect, Effect::Leave(_)));
            assert!(!(leaves && model.is_energised()), "{code:?} {model:?}");
        }
    }
}

#[test]
fn q_says_stop_first_exactly_where_the_output_may_be_on() {
    for phase in PHASES {
        let mut model = in_phase(phase, Target::Sim);
        let effects = model.update(letter('q'));
        let may_be_on = matches!(
            phase,
            Some(Phase::Armed | Phase::Running | Phase::RampDown | Phase::Stopping)
        );
        if may_be_on {
            assert_eq!(effects, vec![], "{phase:?}");
            assert_eq!(model.message.as_deref(), Some("stop first: Space"));
        } else {
            assert_eq!(
                effects,
                vec![Effect::Send(Intent::Quit), Effect::RequestStop],
                "{phase:?}"
            );
            assert_eq!(
                model.update(Event::Worker(WorkerState::Finished)),
                vec![Effect::Leave(Exit::Quit)]
            );
        }
    }
    // Found running by somebody else, before this program ever started it.
    let mut found = in_phase(Some(Phase::Connecting), Target::Hardware);
    Arc::make_mut(&mut found.snapshot).drive_state = Some(DriveState::Running);
    assert_eq!(found.update(letter('q')), vec![]);
}

#[test]
fn a_screen_on_which_no_run_ever_began_leaves_by_itself_so_that_the_reason_is_told() {
    let over = Event::Worker(WorkerState::Finished);
    let mut refused = Model::new(None);
    assert_eq!(refused.update(over), vec![Effect::Leave(Exit::Finished)]);
}

#[test]
fn q_leaves_when_the_work_is_over() {
    for snapshot in [running(), tripped(), done(), hardware()] {
        let mut model = model(snapshot);
        assert_eq!(model.update(Event::Worker(WorkerState::Finished)), vec![]);
        assert_eq!(
            model.update(letter('q')),
            vec![Effect::Leave(Exit::Finished)]
        );
    }
}

#[test]
fn d_goes_on_by_hand_exactly_where_the_report_is_there_and_the_work_over() {
    let mut model = model(done());
    model.update(Event::Workflow(Arc::new(workflow(true))));
    assert_eq!(model.update(letter('d')), vec![]);
    model.update(Event::Worker(WorkerState::Finished));
    assert_eq!(
        model.update(letter('d')),
        vec![Effect::Leave(Exit::Diagnosis)]
    );
    model.update(Event::Workflow(Arc::new(workflow(false))));
    assert_eq!(model.update(letter('d')), vec![]);
}

#[test]
fn ctrl_c_stops_then_quits_and_the_third_leaves_a_worker_that_hangs() {
    for mut model in every_state() {
        if model.is_finished() {
            let left = vec![Effect::Leave(Exit::Interrupted)];
            assert_eq!(model.update(ctrl_c()), left);
            continue;
        }
        let stop_and_quit = vec![Effect::Send(Intent::Quit), Effect::RequestStop];
        let mut hanging = model.clone();
        assert_eq!(model.update(ctrl_c()), stop_and_quit);
        assert_eq!(
            model.update(Event::Worker(WorkerState::Finished)),
            vec![Effect::Leave(Exit::Interrupted)]
        );
        assert_eq!(hanging.update(ctrl_c()), stop_and_quit);
        assert_eq!(hanging.update(ctrl_c()), stop_and_quit);
        assert!(
            hanging
                .update(ctrl_c())
                .contains(&Effect::Leave(Exit::Forced))
        );
    }
}

#[test]
fn a_start_on_hardware_is_confirmed_and_anything_else_withdraws_it() {
    for event in [letter('a'), key(KeyCode::Enter)] {
        let mut soft = in_phase(Some(Phase::Safe), Target::Sim);
        assert_eq!(
            soft.update(event.clone()),
            vec![Effect::Send(Intent::Start)]
        );
        let mut hard = in_phase(Some(Phase::Safe), Target::Hardware);
        assert_eq!(hard.update(event), vec![]);
        let mut refused = hard.clone();
        assert_eq!(hard.update(letter('y')), vec![Effect::Send(Intent::Start)]);
        assert_eq!(refused.update(letter('n')), vec![]);
        assert_eq!(refused.update(letter('y')), vec![]);
    }
    // A question that is no longer one is withdrawn.
    let mut late = in_phase(Some(Phase::Safe), Target::Hardware);
    late.update(letter('a'));
    late.update(Event::Snapshot(Arc::new(tripped())));
    assert!(!late.confirm_start);
    assert_eq!(late.update(letter('y')), vec![]);
}

#[test]
fn faults_are_reset_only_where_there_is_one_and_nothing_is_energised() {
    let fault = |phase| {
        let mut model = in_phase(Some(phase), Target::Sim);
        Arc::make_mut(&mut model.snapshot).drive_state = Some(DriveState::Fault);
        model.update(letter('r'))
    };
    assert_eq!(
        fault(Phase::Connecting),
        vec![Effect::Send(Intent::ResetFault)]
    );
    assert_eq!(fault(Phase::Running), vec![]);
    let mut well = in_phase(Some(Phase::Safe), Target::Sim);
    assert_eq!(well.update(letter('r')), vec![]);
}

#[test]
fn view_keys_change_the_view_and_send_nothing() {
    let mut model = model(running());
    assert_eq!(model.update(letter('f')), vec![]);
    assert!(model.frozen.is_some());
    model.update(letter('f'));
    assert!(model.frozen.is_none());
    let before_s = model.window_s();
    model.update(letter('z'));
    assert!(model.window_s() < before_s);
    model.update(letter('?'));
    assert!(model.help);
    assert_eq!(model.update(letter('q')), vec![]);
    assert!(!model.help && model.message.is_none());
    assert_eq!(
        model.update(letter('m')),
        vec![Effect::Send(Intent::Mark("mark 1".to_owned()))]
    );
}

#[test]
fn tab_goes_round_the_screens_that_there_are() {
    let mut model = model(running());
    let mut seen = Vec::new();
    for _ in 0..2 {
        model.update(key(KeyCode::Tab));
        seen.push(model.screen);
    }
    assert_eq!(seen, [Screen::Parameters, Screen::Live]);
    model.update(letter('3'));
    assert_eq!(model.screen, Screen::Live);
    model.update(Event::Workflow(Arc::new(workflow(false))));
    model.update(key(KeyCode::BackTab));
    assert_eq!(model.screen, Screen::Steps);
    model.update(key(KeyCode::Tab));
    assert_eq!(model.screen, Screen::Live);
}

#[test]
fn the_help_names_every_key_that_does_something() {
    let shown: String = HELP.iter().map(|(keys, _)| *keys).collect();
    for word in ["Space", "Esc", "Enter", "Tab", "Ctrl-C", "Up", "Down"] {
        assert!(shown.contains(word), "{word}");
    }
    for letter in ['a', 'q', 'd', 'f', 'z', 'm', 'r', '?', '1', '2', '3'] {
        assert!(
            HELP.iter()
                .any(|(keys, _)| keys.split(' ').any(|word| word == letter.to_string())),
            "{letter}"
        );
    }
}
