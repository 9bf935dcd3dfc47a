use crossterm::event::{KeyCode, KeyEvent, KeyEventKind, KeyModifiers};

use super::fixtures::{
    added, answered, at_the_floor, begun, diagnosis, hear, letter, nothing_more, press, searching,
    text,
};
use crate::diagnosis::next_experiment::MenuEntry;
use crate::diagnosis::{DiagnosisVerdict, NextExperiment, Rung};
use crate::identification::noise::FloorSource;
use crate::tui::Exit;
use crate::tui::diagnosis::guess::{Guess, Guessing, compared};
use crate::tui::diagnosis::keys::HELP;
use crate::tui::diagnosis::state::{Over, State};
use crate::tui::diagnosis::update::{Effect, Event};
use crate::workflow::{News, Order};

fn every_state() -> Vec<State> {
    let mut failed = begun(false);
    hear(&mut failed, News::Failed("the run is too short".to_owned()));
    let mut states = vec![
        begun(false),
        searching(false),
        searching(true),
        answered(),
        at_the_floor(),
        failed,
    ];
    for index in 0..states.len() {
        for over in [
            Over::Card(3),
            Over::Map(0),
            Over::Map(1),
            Over::Next(1),
            Over::Help(0),
            Over::Help(7),
            Over::Curve(0, 2),
        ] {
            let mut state = states[index].clone();
            state.over = over;
            states.push(state);
        }
    }
    states
}

fn selected(state: &State) -> &'static str {
    let rows = state.rows();
    rows[state.selected(&rows)].key()
}

#[test]
fn a_adds_the_selected_effect_and_the_ladder_shows_the_fall() {
    let mut state = answered();
    assert_eq!(selected(&state), "stribeck_friction");
    assert_eq!(
        letter(&mut state, 'a'),
        Some(Effect::Order(Order::Add("stribeck_friction")))
    );
    // Not twice.
    assert_eq!(letter(&mut state, 'a'), None);
    hear(&mut state, added("stribeck_friction", true));
    assert_eq!(state.present, ["stribeck_friction"]);
    assert!(state.diagnosis.is_none() && state.working.is_some());
    hear(&mut state, News::Diagnosed(Box::new(nothing_more())));
    let errors: Vec<f64> = state.ladder.iter().map(|step| step.error).collect();
    assert_eq!(errors, [5.1, 1.03]);
    let shown = text(&state, 80, 24);
    assert!(shown.contains("at the floor"), "{shown}");
    assert!(shown.contains("NOTHING MISSING"), "{shown}");
}

#[test]
fn a_refused_effect_leaves_the_model_and_says_why() {
    let mut state = answered();
    press(&mut state, KeyCode::Down);
    assert_eq!(
        letter(&mut state, 'a'),
        Some(Effect::Order(Order::Add("cogging")))
    );
    hear(&mut state, added("cogging", false));
    assert!(state.present.is_empty() && state.ladder.len() == 1);
    assert!(state.diagnosis.is_some() && state.working.is_none());
    let shown = text(&state, 80, 24);
    assert!(
        shown.contains("refused: cogging helps only in training"),
        "{shown}"
    );
}

#[test]
fn r_removes_what_is_in_the_model_and_nothing_else() {
    let mut state = answered();
    assert_eq!(letter(&mut state, 'r'), None);
    assert_eq!(
        state.message.as_deref(),
        Some("the model has no effect yet")
    );
    let mut state = at_the_floor();
    assert_eq!(letter(&mut state, 'r'), None, "a candidate is selected");
    press(&mut state, KeyCode::Up);
    assert_eq!(selected(&state), "stribeck_friction");
    assert_eq!(letter(&mut state, 'a'), None);
    assert_eq!(
        letter(&mut state, 'r'),
        Some(Effect::Order(Order::Remove("stribeck_friction")))
    );
}

#[test]
fn orders_wait_for_the_worker_and_q_always_leaves() {
    for state in every_state() {
        let busy = state.working.is_some();
        let guessing = state.guessing == Guessing::Choosing;
        for key in ['a', 'r', 'w'] {
            let effect = letter(&mut state.clone(), key);
            assert!(effect.is_none() || !(busy || guessing), "{key} {state:?}");
        }
        let mut left = state.clone();
        // A first q closes what lies over the screen.
        let first = letter(&mut left, 'q');
        let effect = first.or_else(|| letter(&mut left, 'q'));
        let exit = if busy { Exit::Quit } else { Exit::Finished };
        assert_eq!(effect, Some(Effect::Leave(exit)), "{state:?}");
        let control = KeyEvent::new(KeyCode::Char('c'), KeyModifiers::CONTROL);
        assert_eq!(
            state.clone().update(Event::Key(control)),
            Some(Effect::Leave(Exit::Interrupted))
        );
        let release = KeyEvent::new_with_kind(
            KeyCode::Char('q'),
            KeyModifiers::NONE,
            KeyEventKind::Release,
        );
        assert_eq!(state.clone().update(Event::Key(release)), None);
    }
}

#[test]
fn no_name_is_shown_before_the_guess() {
    let mut state = searching(true);
    while selected(&state) != "stribeck_friction" {
        press(&mut state, KeyCode::Down);
    }
    for _ in 0..2 {
        let shown = text(&state, 120, 60);
        for word in ["missing: stribeck", "supported", "refitted"] {
            assert!(!shown.contains(word), "{word}: {shown}");
        }
        for key in ['a', 'n', 'r', 'w'] {
            assert_eq!(letter(&mut state, key), None);
            assert!(!text(&state, 120, 60).contains("supported"));
        }
        press(&mut state, KeyCode::Enter);
        let card = text(&state, 120, 60);
        assert!(
            card.contains("equation: ") && !card.contains("here: "),
            "{card}"
        );
        press(&mut state, KeyCode::Enter);
        hear(&mut state, News::Diagnosed(Box::new(diagnosis())));
    }
    for _ in 0..40 {
        press(&mut state, KeyCode::Up);
    }
    assert_eq!(selected(&state), "nothing is missing");
    assert_eq!(letter(&mut state, 'g'), None);
    assert_eq!(state.guessing, Guessing::Guessed(Guess::Nothing));
    assert_eq!(
        state.message.as_deref(),
        Some("you: nothing is missing. The tool: stribeck_friction")
    );
    assert!(text(&state, 120, 60).contains("supported"));
}

#[test]
fn a_guess_is_compared_with_the_answer() {
    let said = |guess: &'static str, verdict: DiagnosisVerdict, rivals: Vec<[&'static str; 2]>| {
        let mut state = searching(true);
        while selected(&state) != guess {
            press(&mut state, KeyCode::Down);
        }
        letter(&mut state, 'g');
        let mut answer = diagnosis();
        (answer.verdict, answer.confusable) = (verdict, rivals);
        hear(&mut state, News::Diagnosed(Box::new(answer)));
        state.message.unwrap()
    };
    let effect = DiagnosisVerdict::Effect;
    assert!(said("stribeck_friction", effect, Vec::new()).starts_with("right: "));
    let wrong = said("viscous_friction", effect, Vec::new());
    assert!(
        wrong.contains("ruled out: held-out error 5.10 -> 5.08"),
        "{wrong}"
    );
    let pair = vec![["stribeck_friction", "viscous_friction"]];
    let rival = said("viscous_friction", DiagnosisVerdict::Ambiguous, pair);
    assert!(rival.starts_with("as good: "), "{rival}");
    assert!(said("nothing is missing", DiagnosisVerdict::None, Vec::new()).starts_with("right"));
    let unknown = said(
        "nothing of the catalogue",
        DiagnosisVerdict::Unexplained,
        Vec::new(),
    );
    assert!(unknown.starts_with("right"), "{unknown}");
}

#[test]
fn without_a_floor_nothing_is_said_in_multiples_of_it() {
    let without = || {
        let mut diagnosis = diagnosis();
        diagnosis.noise_floor_from = FloorSource::None;
        diagnosis.sentence = "missing: stribeck_friction".to_owned();
        diagnosis
    };
    for id in ["cogging", "viscous_friction"] {
        let text = compared(Guess::Effect(id), &without());
        assert!(text.contains("times the baseline's residual"), "{text}");
    }
    let mut state = searching(true);
    hear(&mut state, News::Diagnosed(Box::new(without())));
    let shown = text(&state, 120, 30);
    assert!(
        shown.contains("to 1.03 times the baseline's residual"),
        "{shown}"
    );
    let mut state = answered();
    hear(&mut state, News::Diagnosed(Box::new(without())));
    letter(&mut state, 'a');
    let News::Added(mut change) = added("stribeck_friction", true) else {
        unreachable!("it adds");
    };
    let [before, after] = [5.1, 0.4].map(|holdout_rmse| Rung {
        effects: Vec::new(),
        holdout_rmse,
    });
    change.confirm = Some([before, after]);
    change.before.noise_floor_from = FloorSource::None;
    change.after.noise_floor_from = FloorSource::None;
    hear(&mut state, News::Added(change));
    let shown = text(&state, 160, 40);
    assert!(
        shown.contains("0.40 times the baseline's residual"),
        "{shown}"
    );
    assert!(!shown.contains("times the noise"), "{shown}");
}

#[test]
fn guessing_ends_with_escape_and_is_refused_after_the_answer() {
    let mut state = searching(false);
    letter(&mut state, 'g');
    assert_eq!(state.guessing, Guessing::Choosing);
    press(&mut state, KeyCode::Esc);
    assert_eq!(state.guessing, Guessing::Off);
    let mut state = answered();
    letter(&mut state, 'g');
    assert_eq!(state.guessing, Guessing::Off);
    assert!(state.message.unwrap().starts_with("too late"));
}

#[test]
fn the_selection_stays_on_its_effect_while_the_order_changes() {
    let mut state = searching(false);
    press(&mut state, KeyCode::Down);
    assert_eq!(selected(&state), "cogging");
    hear(
        &mut state,
        News::Progress(crate::diagnosis::Event::Screened {
            effect: "quadratic_load",
            share: 0.99,
        }),
    );
    assert_eq!(selected(&state), "cogging");
    for _ in 0..99 {
        press(&mut state, KeyCode::PageDown);
    }
    assert_eq!(selected(&state), "voltage_drop");
}

#[test]
fn m_goes_through_both_equations_and_says_where_there_is_no_map() {
    let mut state = answered();
    for over in [Over::Map(0), Over::Map(1), Over::Nothing] {
        letter(&mut state, 'm');
        assert_eq!(state.over, over);
    }
    let mut bare = State::new(String::new(), false);
    letter(&mut bare, 'm');
    assert_eq!(bare.over, Over::Nothing);
    assert!(bare.message.unwrap().starts_with("there is no map"));
}

#[test]
fn n_tells_what_is_not_told_apart_and_the_run_that_would() {
    let mut state = searching(false);
    letter(&mut state, 'n');
    assert_eq!(state.over, Over::Nothing);
    let mut answer = diagnosis();
    answer.confusable = vec![["viscous_friction", "quadratic_load"]];
    hear(&mut state, News::Diagnosed(Box::new(answer)));
    let next = NextExperiment {
        sentence: "run a slow ramp over the whole speed".to_owned(),
        bench: None,
        pair: Some(["viscous_friction", "quadratic_load"]),
        pairs: Vec::new(),
        reveals: Vec::new(),
        expected_separation: 8463.0,
        menu: [("slow_ramp", 8463.0), ("dither", 400.0)]
            .map(|(program, expected_separation)| MenuEntry {
                program,
                expected_separation,
                needed: 612.0,
            })
            .to_vec(),
        peaks: None,
        recipe: None,
    };
    hear(&mut state, News::Recommended(Box::new(next)));
    letter(&mut state, 'n');
    let shown = text(&state, 80, 24);
    for part in [
        "not told apart: viscous_friction and quadratic_load",
        "next run: run a slow ramp",
        "from which on that run tells",
        "✓ slow_ramp",
        // Above the constant, below what that run needs.
        "· dither",
        "of 612",
    ] {
        assert!(shown.contains(part), "{shown}");
    }
    letter(&mut state, 'n');
    assert_eq!(state.over, Over::Nothing);
}

#[test]
fn q_waits_for_a_model_that_is_being_written() {
    let mut state = answered();
    assert_eq!(letter(&mut state, 'w'), Some(Effect::Order(Order::Write)));
    assert!(text(&state, 80, 24).contains("… writing the model"));
    // Not twice.
    assert_eq!(letter(&mut state, 'w'), None);
    assert_eq!(letter(&mut state, 'q'), None);
    assert!(text(&state, 80, 24).contains("leaves when the model is written"));
    assert_eq!(letter(&mut state, 'a'), None);
    let written = || Event::News(News::Written("model written to m.toml".to_owned()));
    let left = Some(Effect::Leave(Exit::Finished));
    assert_eq!(state.clone().update(written()), left);
    let mut stays = state.clone();
    press(&mut stays, KeyCode::Esc);
    assert_eq!(stays.update(written()), None);
    assert!(text(&stays, 80, 24).contains("model written to m.toml"));
    assert!(text(&stays, 80, 24).contains("ready"));
    assert_eq!(letter(&mut stays, 'q'), left);
    // Ctrl-C does not wait.
    let control = KeyEvent::new(KeyCode::Char('c'), KeyModifiers::CONTROL);
    let effect = state.clone().update(Event::Key(control));
    assert_eq!(effect, Some(Effect::Leave(Exit::Interrupted)));
}

#[test]
fn a_model_that_cannot_be_written_keeps_the_screen() {
    let mut state = answered();
    letter(&mut state, 'w');
    letter(&mut state, 'q');
    let mut gone = state.clone();
    hear(&mut state, News::NotWritten("the disk is full".to_owned()));
    assert!(text(&state, 80, 24).contains("NOT WRITTEN: the disk is full"));
    let left = Some(Effect::Leave(Exit::Finished));
    assert_eq!(letter(&mut state, 'q'), left);
    assert_eq!(gone.update(Event::WorkerGone), None);
    assert!(text(&gone, 80, 24).contains("the model is NOT WRITTEN"));
    assert_eq!(letter(&mut gone, 'q'), left);
}

#[test]
fn a_worker_that_has_gone_is_told() {
    let mut state = searching(false);
    state.update(Event::WorkerGone);
    assert!(text(&state, 80, 24).contains("ERROR: the analysis has ended"));
    let mut idle = answered();
    idle.update(Event::WorkerGone);
    assert_eq!(idle.failure, None);
}

#[test]
fn the_help_names_every_key_that_does_something() {
    let named: Vec<&str> = HELP.iter().flat_map(|(keys, _)| keys.split(' ')).collect();
    for key in [
        "Up", "Down", "Enter", "Esc", "Ctrl-C", "a", "r", "m", "n", "c", "t", "g", "w", "?", "q",
    ] {
        assert!(named.contains(&key), "{key}");
    }
}
