//! Any diagnosis on the screen, at any size.

use proptest::prelude::*;

use super::*;
use crate::tui::testing::number;

fn state() -> impl Strategy<Value = State> {
    let over = prop_oneof![
        Just(Over::Nothing),
        (0..400_usize).prop_map(Over::Card),
        Just(Over::Map(0)),
        Just(Over::Map(1)),
        (0..400_usize).prop_map(Over::Next),
        (0..3_usize, prop::option::of(0..40_usize))
            .prop_map(|(index, point)| Over::Curve(index, point)),
        Just(Over::Traces),
    ];
    let verdict = prop::sample::select(vec![
        DiagnosisVerdict::Effect,
        DiagnosisVerdict::Ambiguous,
        DiagnosisVerdict::None,
        DiagnosisVerdict::Unexplained,
        DiagnosisVerdict::NotFitted,
    ]);
    let numbers = prop::collection::vec(number(), 8);
    let (kind, down) = (0..7_usize, 0..40_i32);
    (kind, over, verdict, numbers, ".{0,120}", down, any::<bool>()).prop_map(
        |(kind, over, verdict, numbers, text, down, has_text)| {
            let mut state = match kind {
                0 => begun(),
                1 => searching(),
                2 => at_the_floor(),
                3 => of_a_fan(),
                4 => falling(),
                5 => compared_alone(),
                _ => answered(),
            };
            let mut answer = diagnosis();
            answer.verdict = verdict;
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
            if kind > 1 && kind != 5 {
                receive(&mut state, News::Diagnosed(Box::new(answer)));
            } else {
                let found = Found::Screened { effect: "cogging", share: numbers[1] };
                receive(&mut state, News::Progress(found));
            }
            for (step, number) in state.ladder.iter_mut().zip(&numbers) {
                step.error = *number;
            }
            state = pressed(state, &"↓".repeat(down as usize));
            state.over = over;
            state.help.first = has_text.then_some(down as usize);
            state.title.clone_from(&text);
            state.message = has_text.then_some(text);
            state
        },
    )
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
