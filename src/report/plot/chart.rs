//! One chart: margins, scales, axes with ticks and labels, and the pieces of SVG of which every picture is made.

use std::fmt::Write;

use super::axis::{Domain, labels};
use crate::report::html::escape;

/// Width of every picture and margins about its frame, px.
pub const WIDTH: f64 = 900.0;
pub const LEFT: f64 = 66.0;
pub const RIGHT: f64 = 24.0;
pub const HEAD: f64 = 26.0;
pub const FOOT: f64 = 44.0;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Along {
    Linear,
    /// Powers of ten; the domain is that of the exponents, and values outside it are drawn at the edge.
    Log,
}

impl Along {
    pub fn place(self, value: f64) -> f64 {
        match self {
            Self::Linear => value,
            Self::Log => value.log10(),
        }
    }
}

#[derive(Clone, Copy, Debug)]
pub struct Scale {
    pub along: Along,
    /// Of the places.
    pub domain: Domain,
    pub from_px: f64,
    pub to_px: f64,
}

impl Scale {
    pub fn new(along: Along, domain: Domain, from_px: f64, to_px: f64) -> Self {
        Self { along, domain, from_px, to_px }
    }

    /// Across the picture between the usual margins.
    pub fn across(along: Along, domain: Domain) -> Self {
        Self::new(along, domain, LEFT, WIDTH - RIGHT)
    }

    pub fn px(&self, value: f64) -> f64 {
        let Domain { from, to } = self.domain;
        let share = (self.along.place(value) - from) / (to - from);
        let share = match self.along {
            Along::Linear => share,
            Along::Log => share.clamp(0.0, 1.0),
        };
        self.from_px + share * (self.to_px - self.from_px)
    }
}

#[derive(Default)]
pub struct Svg(pub String);

impl Svg {
    /// The whole picture; `more` are further attributes, `description` is for screen readers.
    pub fn close(self, class: &str, height: f64, description: &str, more: &str) -> String {
        format!(
            "<svg class=\"{class}\" viewBox=\"0 0 {} {}\" role=\"img\" aria-label=\"{}\"{more}>{}</svg>",
            px(WIDTH),
            px(height),
            escape(description),
            self.0
        )
    }

    pub fn write(&mut self, piece: std::fmt::Arguments<'_>) {
        // Writing into a string cannot fail.
        let _ = self.0.write_fmt(piece);
    }

    pub fn text(&mut self, class: &str, x: f64, y: f64, content: &str) {
        let (x, y, content) = (px(x), px(y), escape(content));
        self.write(format_args!("<text class=\"{class}\" x=\"{x}\" y=\"{y}\">{content}</text>"));
    }

    pub fn path(&mut self, class: &str, path: &str) {
        self.write(format_args!("<path class=\"{class}\" d=\"{path}\"/>"));
    }

    pub fn line(&mut self, class: &str, from: (f64, f64), to: (f64, f64)) {
        self.path(class, &polyline([from, to]));
    }

    pub fn rectangle(&mut self, class: &str, x: f64, y: f64, width: f64, height: f64) {
        self.write(format_args!(
            "<rect class=\"{class}\" x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\"/>",
            px(x),
            px(y),
            px(width.max(0.0)),
            px(height.max(0.0))
        ));
    }

    pub fn dot(&mut self, class: &str, (x, y): (f64, f64), radius: u8) {
        let (x, y) = (px(x), px(y));
        self.write(format_args!(
            "<circle class=\"knot {class}\" cx=\"{x}\" cy=\"{y}\" r=\"{radius}\"/>"
        ));
    }

    /// A label with a sample of its line, the label's end at `right`; returns where the next one on the left ends.
    pub fn legend_entry(&mut self, right: f64, base: f64, class: &str, label: &str) -> f64 {
        const SAMPLE: f64 = 26.0;
        self.text("legend end", right, base, label);
        let (right, at) = (right - width(label) - 5.0, base - 4.0);
        self.line(&format!("key {class}"), (right - SAMPLE, at), (right, at));
        right - SAMPLE - 13.0
    }

    pub fn frame(&mut self, x: &Scale, upper: f64, lower: f64) {
        self.rectangle("frame", x.from_px, upper, x.to_px - x.from_px, lower - upper);
    }

    /// What is drawn until the closing `</svg>` is cut off at the frame; its coordinates stay those of the picture.
    pub fn open_clipped(&mut self, class: &str, x: &Scale, upper: f64, lower: f64) {
        let (left, top) = (px(x.from_px), px(upper));
        let (width, height) = (px(x.to_px - x.from_px), px(lower - upper));
        self.write(format_args!(
            "<svg class=\"{class}\" x=\"{left}\" y=\"{top}\" width=\"{width}\" height=\"{height}\" \
             viewBox=\"{left} {top} {width} {height}\">"
        ));
    }

    pub fn grid_across(&mut self, x: &Scale, at: &[f64], upper: f64, lower: f64) {
        for tick in at {
            self.line("grid", (x.px(*tick), upper), (x.px(*tick), lower));
        }
    }

    /// Grid and labels of what runs across, each label below its line.
    pub fn axis_across(&mut self, x: &Scale, at: &[f64], upper: f64, base: f64) {
        for (label, tick) in labels(at).iter().zip(at) {
            self.line("grid", (x.px(*tick), upper), (x.px(*tick), base));
            self.text("tick middle", x.px(*tick), base + 16.0, label);
        }
    }

    pub fn labels_across(&mut self, x: &Scale, at: &[f64], base: f64) {
        for (label, tick) in labels(at).iter().zip(at) {
            self.text("tick middle", x.px(*tick), base + 16.0, label);
        }
    }

    pub fn unit_across(&mut self, x: &Scale, level: f64, name: &str) {
        self.text("unit middle", 0.5 * (x.from_px + x.to_px), level, name);
    }

    /// Grid and labels of the values, each label next to its line.
    pub fn axis_upwards(&mut self, x: &Scale, y: &Scale, at: &[f64], labels: &[String]) {
        for (label, tick) in labels.iter().zip(at) {
            let class = if *tick == 0.0 { "grid zero" } else { "grid" };
            self.line(class, (x.from_px, y.px(*tick)), (x.to_px, y.px(*tick)));
            self.text("tick end", x.from_px - 7.0, y.px(*tick) + 4.0, label);
        }
    }
}

pub fn polyline(points: impl IntoIterator<Item = (f64, f64)>) -> String {
    let mut path = String::new();
    for (index, (x, y)) in points.into_iter().enumerate() {
        let letter = if index == 0 { 'M' } else { 'L' };
        let _ = write!(path, "{letter}{} {}", px(x), px(y));
    }
    path
}

/// A coordinate; one decimal of a pixel is finer than any screen.
pub fn px(value: f64) -> String {
    // Anything that is not a number would void the whole picture: callers pass finite values only.
    debug_assert!(value.is_finite(), "coordinate {value}");
    let text = format!("{:.1}", value.clamp(-1e6, 1e6) + 0.0);
    text.strip_suffix(".0").map_or(text.clone(), str::to_owned)
}

/// Width that a 12 px label takes in the widest of the usual fonts (`DejaVu Sans`), px; keeps labels apart.
pub fn width(content: &str) -> f64 {
    content
        .chars()
        .map(|character| match character {
            'i' | 'j' | 'l' | '.' | ',' | ' ' => 3.8,
            'f' | 'r' | 't' | '-' => 4.9,
            'm' | 'w' | 'M' | 'W' | '%' => 11.8,
            _ => 7.7,
        })
        .sum()
}
