//! Style sheet and plot cursor of the page.

/// Light and dark, narrow and printed. Every kind of line has a dash pattern beside its colour.
pub(super) const STYLE: &str = include_str!("page.css");

/// A cursor with values over the plots; the page is complete without it.
pub(super) const SCRIPT: &str = include_str!("page.js");
