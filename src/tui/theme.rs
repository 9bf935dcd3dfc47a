//! Colours; each repeats what a text or a mark shows. They are the terminal's sixteen, for a dark background; on a light one
//! each is replaced by a darker one.

use ratatui::buffer::Buffer;
use ratatui::style::{Color, Style};

use drivebench_bench::{Level, Target};
use drivebench_model::sample::Verdict;

pub(super) const PLAIN: Style = Style::new();
pub(super) const DIM: Style = Style::new().dark_gray();
pub(super) const BOLD: Style = Style::new().bold();
pub(super) const GOOD: Style = Style::new().green();
pub(super) const CAREFUL: Style = Style::new().yellow();
pub(super) const BAD: Style = Style::new().red().bold();
/// For what must not be overlooked, and the key that stops.
pub(super) const ALARM: Style = Style::new().white().on_red().bold();

/// A model that is too low, or too high, compared with the measurement.
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

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Appearance {
    pub is_light: bool,
    /// Wheel and clicks act on screens; the terminal's own selection of text then needs the Shift key.
    pub takes_mouse: bool,
}

/// Puts the colours for a light background in the place of those that a screen was drawn with.
pub(super) fn lighten(buffer: &mut Buffer) {
    for cell in &mut buffer.content {
        // Letters on a colour stay white: an alarm.
        cell.fg = match (cell.fg, cell.bg) {
            (colour, Color::Reset) => on_light(colour),
            _ => Color::Indexed(231),
        };
        cell.bg = on_light(cell.bg);
    }
}

/// The colour in the place of one of the sixteen: of the 256, which are the same on every terminal. The terminal's own
/// foreground and background stay.
const fn on_light(colour: Color) -> Color {
    Color::Indexed(match colour {
        Color::DarkGray => 240,
        Color::Red => 124,
        Color::Green => 22,
        Color::Yellow => 94,
        Color::Magenta => 90,
        Color::Cyan => 24,
        Color::LightBlue => 26,
        Color::White => 16,
        other => return other,
    })
}
