//! Pieces of SVG: numbers, text, lines.

use std::fmt::Write;

use crate::report::escape::escape;

/// A coordinate; one decimal of a pixel is finer than any screen.
pub(super) fn px(value: f64) -> String {
    // Anything that is not a number would void the whole picture: callers pass finite values only.
    debug_assert!(value.is_finite(), "coordinate {value}");
    let text = format!("{:.1}", value.clamp(-1e6, 1e6) + 0.0);
    text.strip_suffix(".0").map_or(text.clone(), str::to_owned)
}

pub(super) fn text(out: &mut String, class: &str, x: f64, y: f64, content: &str) {
    let _ = write!(
        out,
        "<text class=\"{class}\" x=\"{}\" y=\"{}\">{}</text>",
        px(x),
        px(y),
        escape(content)
    );
}

pub(super) fn line(out: &mut String, class: &str, from: (f64, f64), to: (f64, f64)) {
    let _ = write!(
        out,
        "<path class=\"{class}\" d=\"M{} {}L{} {}\"/>",
        px(from.0),
        px(from.1),
        px(to.0),
        px(to.1)
    );
}

pub(super) fn rectangle(out: &mut String, class: &str, x: f64, y: f64, width: f64, height: f64) {
    let _ = write!(
        out,
        "<rect class=\"{class}\" x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\"/>",
        px(x),
        px(y),
        px(width.max(0.0)),
        px(height.max(0.0))
    );
}

/// Width that a 12 px label takes in the widest of the usual fonts (`DejaVu Sans`), px; keeps labels apart.
pub(super) fn width(content: &str) -> f64 {
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
