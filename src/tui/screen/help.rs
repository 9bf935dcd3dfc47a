//! What the keys and the panels of the live screen mean.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;

use crate::tui::keys::HELP;
use crate::tui::widget;

const MEANING: [&str; 5] = [
    "The model runs free under the applied voltage: where it leaves the measurement, it misses something.",
    "A bar is a parameter's standard deviation, 100 % to 0.1 % of its value; it shrinks as the data come in.",
    "searching: still moving. settled: narrow and steady. not observable: these data do not carry it.",
    "lost: requests without a valid reply. late: how long after its deadline a cycle began. missed: cycles left out.",
    "The program's stop is best effort; the drive's watchdog and an emergency stop are behind it.",
];

/// In the middle of the area; the screen beneath stays live, and Space still stops.
pub(crate) fn help(first: usize, area: Rect, buffer: &mut Buffer) {
    widget::help::help(&HELP, &MEANING, first, area, buffer);
}
