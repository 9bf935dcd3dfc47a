//! Screens drawn on a terminal of the test's own, and any number that they may be given.

use proptest::prelude::*;
use ratatui::backend::TestBackend;
use ratatui::{Frame, Terminal};

/// What `view` draws on so many cells.
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
