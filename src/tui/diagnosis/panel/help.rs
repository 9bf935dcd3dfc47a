//! What the keys and the words of the diagnosis mean.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;

use crate::tui::diagnosis::keys::HELP;
use crate::tui::widget;

const MEANING: [&str; 5] = [
    "Errors: free-running model, a run that the fit has not seen, in units of the noise.",
    "Per cent: how likely the effect is there, weighed with all the others at once.",
    "supported: 90 % and more. possible: 10 to 90 %. ruled out: less; it is at most as large as it says.",
    "not excited: this run would not show it. seen from: the smallest size that would have been named.",
    "A name is an equation, not a cause: the card lists causes that share it.",
];

pub(in crate::tui::diagnosis) fn help(first: usize, area: Rect, buffer: &mut Buffer) {
    widget::help::help(&HELP, &MEANING, first, area, buffer);
}
