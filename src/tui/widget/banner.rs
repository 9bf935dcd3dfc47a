//! The box that cannot be overlooked: a trip, the end, or a question.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::Style;
use ratatui::widgets::{Block, BorderType, Clear, Paragraph, Widget, Wrap};

use crate::bench::{Level, Phase};
use crate::tui::model::Model;
use crate::tui::theme;

/// What the box says.
pub(crate) struct Banner {
    title: String,
    text: String,
    style: Style,
}

impl Banner {
    /// The most urgent thing there is to say, if any.
    pub(crate) fn of(model: &Model) -> Option<Self> {
        let snapshot = &model.snapshot;
        if model.confirm_start {
            return Some(Self::new(
                "HARDWARE",
                "A real motor is about to turn. Shaft clear? y = start, any other key = no",
                theme::ALARM,
            ));
        }
        if let Some(text) = &snapshot.reopening {
            let safe = snapshot.phase == Some(Phase::Safe);
            let (title, style) = if safe {
                ("SAFE", theme::CAREFUL)
            } else {
                ("LINK LOST", theme::ALARM)
            };
            let end = if model.is_finished() {
                " q = quit."
            } else {
                ""
            };
            return Some(Self::new(title, format!("{text}.{end}"), style));
        }
        if let Some(trip) = &snapshot.trip {
            return Some(Self::new(
                "SAFETY TRIP",
                format!("{}.{}", trip.reason, end_of(model)),
                theme::ALARM,
            ));
        }
        if snapshot.phase == Some(Phase::LinkLost) {
            let last = snapshot.notices.iter().rev();
            let error = last.into_iter().find(|notice| notice.level == Level::Error);
            let reason = error.map_or("the drive does not answer any more", |notice| {
                notice.text.as_str()
            });
            return Some(Self::new(
                "LINK LOST",
                format!("{reason}.{}", end_of(model)),
                theme::ALARM,
            ));
        }
        let (title, text, style) = match (snapshot.outcome?, model.is_finished()) {
            (_, false) => return None,
            ("done", true) => ("DONE", "The run went to its end.", theme::GOOD),
            ("stopped", true) => ("STOPPED", "The run was stopped.", theme::CAREFUL),
            ("interrupted", true) => ("INTERRUPTED", "The run was interrupted.", theme::CAREFUL),
            (other, true) => (other, "The run has ended.", theme::CAREFUL),
        };
        Some(Self::new(title, format!("{text}{}", end_of(model)), style))
    }

    fn new(title: &str, text: impl Into<String>, style: Style) -> Self {
        Self {
            title: format!(" {title} "),
            text: text.into(),
            style,
        }
    }

    /// Rows that it takes, with its frame, in a screen of this width.
    pub(crate) fn height(&self, width: u16) -> u16 {
        let inner = usize::from(width.saturating_sub(2)).max(1);
        let (mut rows, mut used) = (1_usize, 1);
        for word in self.text.split(' ') {
            let length = word.chars().count();
            if used + length > inner {
                rows += 1;
                used = 0;
            }
            used += length + 1;
        }
        2 + (rows.clamp(1, 4) as u16)
    }

    pub(crate) fn render(&self, area: Rect, buffer: &mut Buffer) {
        Clear.render(area, buffer);
        let block = Block::bordered()
            .border_type(BorderType::Double)
            .title(self.title.as_str())
            .style(self.style);
        Paragraph::new(format!(" {}", self.text))
            .wrap(Wrap { trim: false })
            .block(block)
            .render(area, buffer);
    }
}

fn end_of(model: &Model) -> &'static str {
    if model.is_finished() {
        " Output off, q = quit."
    } else {
        ""
    }
}
