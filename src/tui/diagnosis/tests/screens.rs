use insta::assert_snapshot;
use proptest::prelude::*;

use super::fixtures::{
    added, answered, at_the_floor, begun, diagnosis, hear, press, searching, terminal, text,
};
use crate::diagnosis::{DiagnosisVerdict, Event as Found};
use crate::tui::diagnosis::state::{Over, State};
use crate::tui::keys::Press;
use crate::workflow::News;

#[test]
fn while_the_effects_are_judged() {
    assert_snapshot!("begun_80x24", text(&begun(false), 80, 24));
    assert_snapshot!("searching_80x24", text(&searching(false), 80, 24));
    assert_snapshot!("guessing_80x24", text(&searching(true), 80, 24));
}

#[test]
fn the_answer_and_the_ladder() {
    assert_snapshot!("answered_80x24", text(&answered(), 80, 24));
    assert_snapshot!("answered_120x40", text(&answered(), 120, 40));
    assert_snapshot!("answered_40x10", text(&answered(), 40, 10));
    assert_snapshot!("at_the_floor_80x24", text(&at_the_floor(), 80, 24));
    let mut refused = answered();
    press(&mut refused, Press::Move(1));
    press(&mut refused, Press::Add);
    hear(&mut refused, added("cogging", false));
    assert_snapshot!("refused_80x24", text(&refused, 80, 24));
}

#[test]
fn what_lies_over_the_screen() {
    let mut state = answered();
    press(&mut state, Press::Open);
    assert_snapshot!("card_80x24", text(&state, 80, 24));
    state.over = Over::Map(0);
    assert_snapshot!("map_80x24", text(&state, 80, 24));
    state.over = Over::Help(0);
    assert_snapshot!("help_80x24", text(&state, 80, 24));
}

fn number() -> impl Strategy<Value = f64> {
    prop_oneof![
        4 => -10.0..300.0_f64,
        1 => any::<f64>(),
        1 => Just(f64::NAN),
        1 => Just(f64::INFINITY),
        1 => Just(f64::MAX),
    ]
}

fn state() -> impl Strategy<Value = State> {
    let over = prop_oneof![
        Just(Over::Nothing),
        (0..400_usize).prop_map(Over::Card),
        Just(Over::Map(0)),
        Just(Over::Map(1)),
        (0..400_usize).prop_map(Over::Next),
        (0..400_usize).prop_map(Over::Help),
        (0..3_usize, 0..40_usize).prop_map(|(index, row)| Over::Curve(index, row)),
    ];
    let verdict = prop::sample::select(vec![
        DiagnosisVerdict::Effect,
        DiagnosisVerdict::Ambiguous,
        DiagnosisVerdict::None,
        DiagnosisVerdict::Unexplained,
    ]);
    (
        0..5_usize,
        over,
        verdict,
        prop::collection::vec(number(), 8),
        ".{0,120}",
        0..40_i32,
        any::<bool>(),
    )
        .prop_map(|(kind, over, verdict, numbers, words, down, speaks)| {
            let mut state = match kind {
                0 => begun(false),
                1 => searching(false),
                2 => searching(true),
                3 => at_the_floor(),
                _ => answered(),
            };
            let mut answer = diagnosis();
            answer.verdict = verdict;
            answer.sentence.clone_from(&words);
            answer.holdout_before = numbers[0];
            for (candidate, number) in answer.candidates.iter_mut().zip(&numbers) {
                candidate.explained_percent = Some(*number);
                candidate.detectable = Some(*number);
                candidate.upper_bound = Some(*number);
                candidate.probability = *number;
                for parameter in &mut candidate.parameters {
                    parameter.value = Some(*number);
                    parameter.std = Some(numbers[7]);
                }
            }
            if kind > 2 {
                hear(&mut state, News::Diagnosed(Box::new(answer)));
            } else {
                let found = Found::Screened {
                    effect: "cogging",
                    share: numbers[1],
                };
                hear(&mut state, News::Progress(found));
            }
            for (step, number) in state.ladder.iter_mut().zip(&numbers) {
                step.error = *number;
            }
            for _ in 0..down {
                press(&mut state, Press::Move(1));
            }
            state.over = over;
            state.title.clone_from(&words);
            state.message = speaks.then_some(words);
            state
        })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn any_diagnosis_can_be_drawn_at_any_size(
        state in state(),
        width in 1..=200_u16,
        height in 1..=60_u16,
    ) {
        terminal(&state, width, height);
    }
}

#[test]
fn every_small_size() {
    for state in [begun(false), searching(true), answered(), at_the_floor()] {
        for over in [
            Over::Nothing,
            Over::Card(2),
            Over::Map(0),
            Over::Next(1),
            Over::Help(0),
            Over::Help(7),
            Over::Curve(0, 2),
        ] {
            let mut state = state.clone();
            state.over = over;
            for width in (1..=40).chain([72, 110, 200]) {
                for height in [1, 2, 3, 5, 6, 7, 9, 12, 14, 20, 60] {
                    terminal(&state, width, height);
                }
            }
        }
    }
}

#[test]
fn the_selected_row_is_always_in_sight() {
    let mut state = searching(true);
    for _ in 0..40 {
        let shown = text(&state, 80, 24);
        assert!(shown.contains('▶'), "{shown}");
        press(&mut state, Press::Move(1));
    }
}
