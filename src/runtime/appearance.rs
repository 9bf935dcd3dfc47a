//! How screens are shown on this terminal, from the program's arguments.

use std::sync::OnceLock;

use crate::tui::Appearance;

static APPEARANCE: OnceLock<Appearance> = OnceLock::new();

/// Set once, before any command is carried out.
pub(crate) fn set(appearance: Appearance) {
    let _ = APPEARANCE.set(appearance);
}

pub(crate) fn get() -> Appearance {
    APPEARANCE.get().copied().unwrap_or_default()
}
