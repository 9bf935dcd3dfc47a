//! Colours, each beside a word or a mark that says the same.

use ratatui::style::Style;

use crate::bench::{Level, Target};
use crate::sample::Verdict;

pub(super) const PLAIN: Style = Style::new();
pub(super) const DIM: Style = Style::new().dark_gray();
pub(super) const BOLD: Style = Style::new().bold();
pub(super) const GOOD: Style = Style::new().green();
pub(super) const CAREFUL: Style = Style::new().yellow();
pub(super) const BAD: Style = Style::new().red().bold();
/// For what must not be overlooked, and the key that stops.
pub(super) const ALARM: Style = Style::new().white().on_red().bold();

/// A model that is too low, or too high, beside the measurement.
pub(super) const TOO_LOW: Style = Style::new().red();
pub(super) const TOO_HIGH: Style = Style::new().light_blue();

pub(super) const VOLTAGE: Style = Style::new().yellow();
pub(super) const CURRENT: Style = Style::new().magenta();
pub(super) const SPEED: Style = Style::new().cyan();
pub(super) const MODEL: Style = Style::new().white();

pub(super) const fn target(target: Target) -> Style {
    match target {
        Target::Sim => GOOD.bold(),
        Target::Hardware => BAD.reversed(),
    }
}

pub(super) const fn verdict(verdict: Verdict) -> Style {
    match verdict {
        Verdict::Settled => GOOD,
        Verdict::Searching => CAREFUL,
        Verdict::NotObservable | Verdict::Fixed => DIM,
        Verdict::Invalid => BAD,
    }
}

pub(super) const fn level(level: Level) -> Style {
    match level {
        Level::Info => PLAIN,
        Level::Warning => CAREFUL,
        Level::Error => BAD,
    }
}
