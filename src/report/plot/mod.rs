//! Plots of our own as inline SVG: no library, no script needed, colours from the page's style sheet.
//!
//! ```text
//! chart: margins, scales (linear, logarithmic), axes with their ticks, pieces of SVG: the same for all
//! samples -> pieces (cut at gaps) -> decimate (extremes per column) -> panels over one time axis
//!                                '-> detail: the points for zooming in, decimated far less
//! error of an equation over one axis, curve of an effect; magnitude, phase and coherence over frequency -> axis chart, which a
//! terminal draws as well
//! rungs -> bars with the noise floor as the goal    error over speed x current -> map
//! ```
//!
//! Every line has a dash pattern besides its colour, and every colour is a variable of the page, so that a page can be
//! printed in grey or shown on a dark screen.

pub mod axis;
pub mod chart;
mod charts;
mod decimate;
mod detail;
mod panels;

pub use charts::{AxisChart, AxisPanel, Drawn, MapChart, Place, PointSet, bars};
pub use decimate::GAP;
pub use detail::MOST_POINTS;
pub use panels::{Panel, Style, TIME, stacked};

/// Light, dark and printed. Every kind of line has a dash pattern besides its colour.
pub(super) const STYLE: &str = include_str!("plot.css");

/// A picture and, where its lines run over one axis, the points behind them, with which the script of a page zooms.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Plot {
    pub svg: String,
    /// One line of text for each line of the picture, in its order; empty where there is nothing to zoom.
    pub points: String,
    /// The columns to which those points were thinned, with their unit, where they are not all.
    pub thinned: Option<String>,
}

impl From<String> for Plot {
    fn from(svg: String) -> Self {
        Self { svg, ..Self::default() }
    }
}

/// Every picture of a page as a file of its own, in their order.
pub fn pictures(html: &str) -> Vec<String> {
    let begins = html.match_indices("<svg class=\"plot").map(|(at, _)| &html[at..]);
    let whole = |rest: &str| {
        let mut open = 0;
        let mut from = 0;
        loop {
            // A tag that closes ends the picture once all that were opened are closed.
            let close = from + rest[from..].find("</svg>")?;
            open += rest[from..close].matches("<svg ").count();
            from = close + "</svg>".len();
            open -= 1;
            if open == 0 {
                return Some(standalone(&rest[..from]));
            }
        }
    };
    begins.filter_map(whole).collect()
}

/// A picture as a file of its own: with the style sheet, which every viewer of SVG understands.
pub fn standalone(svg: &str) -> String {
    let opened =
        svg.replacen("<svg ", "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"900\" ", 1);
    let style = format!("><style>{STYLE}svg.plot{{background:var(--paper)}}</style>");
    format!("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n{}\n", opened.replacen('>', &style, 1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_picture_of_a_page_is_a_file_however_it_is_nested() {
        let values = [0.0, 1.0, 2.0];
        let panel = || Panel::new("a", "b").sampled("c", Style::After, &values, &values);
        let svg = stacked("<d>", TIME, &[panel(), panel()], 100).svg;
        let html = format!("<p><svg class=\"icon\"></svg></p>{svg}<b></b>{svg}<p></p>");
        assert_eq!(pictures(&html), [standalone(&svg), standalone(&svg)]);
        assert!(pictures(&html[..html.len() / 3]).is_empty());
    }
}
