//! The page of the frequency response: magnitude, phase and coherence of measurement and model over one logarithmic axis; and
//! a screen for this page alone.
//!
//! ```text
//! Compared (measured, model, where they differ) --> ResponsePage: which pathway, cursor --> view: three panels, one axis
//! '-> ResponseScreen: the page with a title and the keys       DiagnosisScreen: the page over its own
//! ```

mod view;

#[cfg(test)]
pub(super) mod tests;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use ratatui::Frame;
use ratatui::layout::{Position, Rect};

use super::application::{Exit, Screen};
use super::frame::Help;
use super::keys::Press;
use drivebench_identify::frequency_response::{Compared, Pathway, PathwayResponse};

pub(super) use view::view;

#[derive(Clone, Debug, Default)]
pub(super) struct ResponsePage {
    compared: Option<Arc<Compared>>,
    /// `None` before a choice: the pathway with the most carried points.
    chosen: Option<Pathway>,
    cursor: Option<usize>,
}

impl ResponsePage {
    pub(super) const KEYS: &'static str = "Tab the next pathway|Left Right cursor";

    pub(super) fn take(&mut self, compared: Compared) {
        self.compared = Some(Arc::new(compared));
        self.cursor = None;
    }

    fn shown(&self) -> Option<(&Compared, &PathwayResponse)> {
        let compared = self.compared.as_deref()?;
        let measured = &compared.measured;
        let chosen = self.chosen.filter(|own| measured.of(*own).is_some());
        Some((compared, measured.of(chosen.or_else(|| measured.telling())?)?))
    }

    /// Whether the key was one of the page's.
    pub(super) fn press(&mut self, press: Press) -> bool {
        let Some((compared, own)) = self.shown() else {
            return false;
        };
        let points = own.points.len();
        let all = &compared.measured.pathways;
        let at = all.iter().position(|other| other.pathway == own.pathway);
        let neighbour = |by: usize| all[(at.unwrap_or(0) + by) % all.len()].pathway;
        match press {
            Press::NextScreen => self.chosen = Some(neighbour(1)),
            Press::PreviousScreen => self.chosen = Some(neighbour(all.len() - 1)),
            Press::Cursor(way) if points > 0 => {
                let first = if way > 0 { 0 } else { points - 1 };
                let next = self
                    .cursor
                    .map_or(first, |at| at.saturating_add_signed(way as isize).min(points - 1));
                self.cursor = Some(next);
            }
            Press::Stop if self.cursor.is_some() => self.cursor = None,
            _ => return false,
        }
        true
    }
}

/// The page as a screen of its own: `bode --screen`.
pub struct ResponseScreen {
    title: String,
    page: ResponsePage,
    help: Help,
    message: Option<String>,
    hang_up: Arc<AtomicBool>,
}

impl ResponseScreen {
    /// `chosen`: the pathway that it opens with. `hang_up` is set by signals: the screen closes by itself.
    pub fn new(
        title: String,
        compared: Compared,
        chosen: Option<Pathway>,
        hang_up: Arc<AtomicBool>,
    ) -> Self {
        let mut page = ResponsePage::default();
        page.take(compared);
        page.chosen = chosen;
        Self { title, page, help: Help::default(), message: None, hang_up }
    }
}

impl Screen for ResponseScreen {
    fn poll(&mut self) -> (bool, Option<Exit>) {
        (false, self.hang_up.load(Ordering::Acquire).then_some(Exit::Interrupted))
    }

    fn press(&mut self, press: Press) -> Option<Exit> {
        self.message = None;
        match press {
            Press::Interrupt => return Some(Exit::Interrupted),
            _ if self.help.press(press) => {}
            Press::Help => self.help.first = Some(0),
            Press::Quit => return Some(Exit::Finished),
            press if self.page.press(press) => {}
            Press::Stop => return Some(Exit::Finished),
            _ => self.notify("that key does nothing here: ? lists those that do"),
        }
        None
    }

    fn click(&mut self, _: Position, _: Rect) {
        self.notify("there is nothing to select here: Left and Right move the cursor");
    }

    fn notify(&mut self, text: &str) {
        self.message = Some(text.to_owned());
    }

    fn draw(&self, frame: &mut Frame<'_>) {
        view::screen(self, frame);
    }
}
