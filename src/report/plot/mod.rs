//! Plots of our own as inline SVG: no library, no script needed, colours from the page's style sheet.
//!
//! ```text
//! samples -> pieces (cut at gaps) -> decimate (extremes per column) -> panels over one time axis
//! rungs   -> bars with the noise floor as the goal
//! ```
//!
//! Every line has a dash pattern beside its colour, and every colour is a variable of the page, so that a page printed
//! in grey or shown on a dark screen says the same.

pub mod axis;
mod bars;
pub mod decimate;
mod draw;
mod panels;

pub use bars::{Bar, BarChart};
pub use panels::{Band, Panel, PanelPlot, Series, Style};
