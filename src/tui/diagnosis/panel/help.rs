//! What the keys and the words of the diagnosis mean.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;

use crate::tui::diagnosis::keys::HELP;
use crate::tui::widget;

const MEANING: [&str; 6] = [
    "Errors: free-running model, a run that the fit has not seen, in units of the noise.",
    "supported: pays on the held-out run and is in the answer. possible: pays, but less, or is not told apart.",
    "ruled out: would have shown and does not pay. not excited: this run would not show it.",
    "No share stands where the first-order screen was enough to rule an effect out: it was not refitted.",
    "seen from: the smallest size that this run would have shown.",
    "A name is an equation, not a cause: the card lists causes that share it.",
];

pub(in crate::tui::diagnosis) fn help(first: usize, area: Rect, buffer: &mut Buffer) {
    widget::help::help(&HELP, &MEANING, first, area, buffer);
}
