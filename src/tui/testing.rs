//! Screens drawn on a terminal of the test's own, and any number that they may be given.

use proptest::prelude::*;
use ratatui::backend::TestBackend;
use ratatui::{Frame, Terminal};

use super::keys::{CHARACTERS, Press};
use drivebench_diagnose::{Evidence, RecordedChannels, Traces};
use drivebench_model::plant::testing::with_a_fan;
use drivebench_model::plant::{ActiveEffect, Model, Motor, effect};

pub(super) fn terminal(
    (width, height): (u16, u16),
    view: impl FnOnce(&mut Frame<'_>),
) -> Terminal<TestBackend> {
    let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
    terminal.draw(view).unwrap();
    terminal
}

/// Every size below that of any layout, and some above.
pub(super) fn sizes() -> impl Iterator<Item = (u16, u16)> {
    let widths = (1..=40).chain([72, 110, 200]);
    let heights = [1, 2, 3, 5, 6, 7, 9, 12, 14, 20, 60];
    widths.flat_map(move |width| heights.map(|height| (width, height)))
}

/// Mostly one that a machine may have, and what is none.
pub(super) fn number() -> impl Strategy<Value = f64> {
    prop_oneof![
        4 => -300.0..300.0_f64,
        1 => any::<f64>(),
        1 => Just(f64::NAN),
        1 => Just(f64::INFINITY),
        1 => Just(f64::MAX),
        1 => Just(-f64::MAX),
        1 => Just(0.0),
    ]
}

/// The key that a character stands for; arrows, Enter, Esc, Tab and Ctrl-C by their signs.
pub(super) fn key(sign: char) -> Press {
    match sign {
        '↑' => Press::Move(-1),
        '↓' => Press::Move(1),
        '←' => Press::Cursor(-1),
        '→' => Press::Cursor(1),
        '⏎' => Press::Open,
        '␛' => Press::Stop,
        '⇥' => Press::NextScreen,
        '⇤' => Press::PreviousScreen,
        '^' => Press::Interrupt,
        sign => CHARACTERS.iter().find(|key| key.0 == sign).map_or(Press::Other, |key| key.1),
    }
}

/// The motor of the runs with a fan, with it or without it in the model.
pub(super) fn fan_model(has_fan: bool) -> Model {
    let mut model = Model::baseline(Motor::zk_22fc());
    if has_fan {
        model.effects.push(ActiveEffect::with(effect::find("quadratic_load").unwrap(), &[4e-6]));
    }
    model
}

/// Traces of such a model over two runs; the second has a gap.
pub(super) fn fan_traces(has_fan: bool) -> Traces {
    let (mut fitted, mut held_out) = (with_a_fan(0), with_a_fan(1));
    (fitted.name, held_out.name) = ("run-a".to_owned(), "run-b".to_owned());
    fitted.speed_rad_s[300..360].fill(f64::NAN);
    let evidence = Evidence::new(fitted, Some(held_out), None);
    Traces::of(&fan_model(has_fan), &evidence, &RecordedChannels::default()).unwrap()
}
