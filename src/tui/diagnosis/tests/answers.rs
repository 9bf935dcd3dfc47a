//! What a key says that can do nothing now.

use super::*;

#[test]
fn a_key_that_does_nothing_says_why() {
    for state in every_state() {
        for key in [
            Press::Start,
            Press::Yes,
            Press::Freeze,
            Press::Mark,
            Press::ResetFault,
            Press::Experiment,
            Press::SpeedLoop,
            Press::Page(1),
            Press::Zoom,
            Press::Other,
        ] {
            let mut state = state.clone();
            assert_eq!(press(&mut state, key), None);
            assert!(state.message.is_some(), "{key:?} {:?}", state.over);
        }
    }
}

#[test]
fn before_the_comparison_there_is_no_picture_and_it_is_said_so() {
    for key in [Press::Curve, Press::Traces, Press::Worst] {
        let mut state = State::new(String::new());
        press(&mut state, key);
        assert_eq!(state.over, Over::Nothing, "{key:?}");
        assert!(told(&state).starts_with("not yet"), "{key:?}: {}", told(&state));
    }
}

#[test]
fn after_a_failure_only_what_there_is_is_offered() {
    let failed = |mut state: State| {
        hear(&mut state, News::Failed("the run is too short".to_owned()));
        state
    };
    let mut bare = failed(State::new(String::new()));
    let shown = text(&bare, 80, 24);
    assert!(!shown.contains("v traces") && !shown.contains("e map"), "{shown}");
    for key in [Press::Traces, Press::Map, Press::Curve, Press::Diagnose] {
        press(&mut bare, key);
        assert!(told(&bare).contains("has failed"), "{key:?}: {}", told(&bare));
    }
    press(&mut bare, DOWN);
    assert_eq!(told(&bare), "no effect has been judged");
    // The comparison was there before.
    let shown = text(&failed(begun()), 80, 24);
    assert!(!shown.contains("v traces") && shown.contains("e map"), "{shown}");
}

#[test]
fn d_says_whether_it_is_searched_or_what_is_done_instead() {
    let comparing = State::of_a_comparison(String::new(), ErrorOf::Model);
    for (mut state, expected) in [
        (comparing, "at work already: comparing"),
        (searching(), "at work already: "),
        (answered(), "what is missing has been searched"),
    ] {
        assert_eq!(press(&mut state, Press::Diagnose), None);
        assert!(told(&state).starts_with(expected), "{}", told(&state));
    }
}
