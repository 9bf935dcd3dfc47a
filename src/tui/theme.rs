//! Colours, each beside a word or a mark that says the same.

use ratatui::style::{Color, Modifier, Style};

use crate::bench::{Level, Target};
use crate::sample::Verdict;

pub(super) const PLAIN: Style = Style::new();
pub(super) const DIM: Style = Style::new().fg(Color::DarkGray);
pub(super) const BOLD: Style = Style::new().add_modifier(Modifier::BOLD);
pub(super) const GOOD: Style = Style::new().fg(Color::Green);
pub(super) const CAREFUL: Style = Style::new().fg(Color::Yellow);
pub(super) const BAD: Style = Style::new().fg(Color::Red).add_modifier(Modifier::BOLD);
/// For what must not be overlooked.
pub(super) const ALARM: Style = Style::new()
    .fg(Color::White)
    .bg(Color::Red)
    .add_modifier(Modifier::BOLD);
pub(super) const STOP_KEY: Style = Style::new()
    .fg(Color::White)
    .bg(Color::Red)
    .add_modifier(Modifier::BOLD);

pub(super) const VOLTAGE: Style = Style::new().fg(Color::Yellow);
pub(super) const CURRENT: Style = Style::new().fg(Color::Magenta);
pub(super) const SPEED: Style = Style::new().fg(Color::Cyan);
pub(super) const MODEL: Style = Style::new().fg(Color::White);

pub(super) const fn target(target: Target) -> Style {
    match target {
        Target::Sim => Style::new().fg(Color::Green).add_modifier(Modifier::BOLD),
        Target::Hardware => Style::new()
            .fg(Color::Red)
            .add_modifier(Modifier::BOLD)
            .add_modifier(Modifier::REVERSED),
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
