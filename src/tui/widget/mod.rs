//! One file per widget, each a function of its data and an area; every one copes with any size.

pub(super) mod banner;
pub(super) mod help;
pub(super) mod hints;
pub(super) mod link_panel;
pub(super) mod notices;
pub(super) mod parameters;
mod plot;
pub(super) mod progress_bar;
pub(super) mod scope;
pub(super) mod top_bar;
