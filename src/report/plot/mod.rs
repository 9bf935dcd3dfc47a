//! Plots of our own as inline SVG: no library, no script needed, colours from the page's style sheet.
//!
//! ```text
//! samples -> pieces (cut at gaps) -> decimate (extremes per column) -> panels over one time axis
//! ratios  -> curves over a logarithmic axis (errors of many schemes), one legend
//! rungs   -> bars with the noise floor as the goal
//! error over speed x current -> map
//! what an equation lacks over one axis -> axis_chart
//! given probabilities against what came true -> reliability
//! ```
//!
//! Every line has a dash pattern beside its colour, and every colour is a variable of the page, so that a page printed
//! in grey or shown on a dark screen says the same.

pub mod axis;
mod axis_chart;
mod bars;
mod curves;
pub mod decimate;
mod draw;
mod map;
mod panels;
mod reliability;

pub use axis_chart::AxisChart;
pub use bars::{Bar, BarChart};
pub use curves::{CurveChart, CurvePanel};
pub use map::MapChart;
pub use panels::{Band, Panel, PanelPlot, Series, Style};
pub use reliability::{Claims, ReliabilityChart};

/// A picture as a file of its own: with the page's style sheet, which every viewer of SVG understands.
pub fn standalone(svg: &str) -> String {
    let opened = svg.replacen(
        "<svg ",
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"900\" ",
        1,
    );
    let style = format!(
        "><style>{}svg.plot{{background:var(--paper)}}</style>",
        super::style::STYLE
    );
    format!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n{}\n",
        opened.replacen('>', &style, 1)
    )
}
