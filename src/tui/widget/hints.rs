//! The last line: the answer to the last key, else the keys.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::text::Line;
use ratatui::widgets::Widget;

use crate::tui::model::Model;
use crate::tui::theme;

pub(crate) fn hints(model: &Model, area: Rect, buffer: &mut Buffer) {
    if let Some(message) = &model.message {
        Line::styled(format!(" > {message}"), theme::CAREFUL.patch(theme::BOLD))
            .render(area, buffer);
        return;
    }
    let screens = model.screens();
    let here = screens.iter().position(|screen| *screen == model.screen);
    let next = screens[(here.unwrap_or(0) + 1) % screens.len()].name();
    let next = format!("Tab {next}");
    let next = next.as_str();
    let keys: &[&str] = if model.waits_for_start() {
        &["Enter start", "Space stop", next]
    } else if model.has_report() {
        &["d diagnosis by hand", next, "Up Down scroll"]
    } else if model.is_finished() {
        &[next, "f freeze", "z zoom"]
    } else {
        &["Space stop", next, "f freeze", "z zoom", "m mark"]
    };
    let keys = keys_that_fit(keys, "? help  q quit", usize::from(area.width));
    Line::styled(keys, theme::DIM).render(area, buffer);
}

/// The keys that fit into a row: `always` is kept, of the others as many as there is room for, the first first.
pub(crate) fn keys_that_fit(keys: &[&str], always: &str, width: usize) -> String {
    let length = |text: &str| text.chars().count();
    let mut room = width.saturating_sub(1 + length(always));
    let mut shown = String::from(" ");
    for key in keys {
        let needed = length(key) + 2;
        if needed > room {
            break;
        }
        room -= needed;
        shown.push_str(key);
        shown.push_str("  ");
    }
    shown + always
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_keys_that_matter_are_never_cut_off() {
        let keys = ["a add", "r remove", "m map"];
        for width in 16..60 {
            let shown = keys_that_fit(&keys, "? help  q leave", width);
            assert!(
                shown.chars().count() <= width && shown.ends_with("q leave"),
                "{shown}"
            );
        }
        assert!(keys_that_fit(&keys, "q", 60).starts_with(" a add  r remove  m map  q"));
    }
}
