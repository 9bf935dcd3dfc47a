//! How good the model is and where it fails: figures, lights, places.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::Style;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Paragraph, Widget, Wrap};

use super::titled;
use crate::diagnosis::{Comparison, ResidualLights};
use crate::text::lines::wrapped;
use crate::text::number::{fixed, percent, share, significant};
use crate::tui::diagnosis::state::State;
use crate::tui::theme;

/// Places that are told.
const MOST_PLACES: usize = 3;
/// Below this width the signals have a row each, where there are so many rows.
const WIDE: u16 = 106;
const TALL: u16 = 4;

pub(in crate::tui::diagnosis) fn failing(state: &State, area: Rect, buffer: &mut Buffer) {
    if area.height == 0 {
        return;
    }
    let inner = titled("held-out run: fit, error, where it fails", area, buffer);
    let lines = state.comparison.as_ref().map_or_else(
        || vec![Line::styled(" comparing ...", theme::DIM)],
        |comparison| lines(comparison, inner),
    );
    Paragraph::new(lines)
        .wrap(Wrap { trim: false })
        .render(inner, buffer);
}

fn lines(comparison: &Comparison, area: Rect) -> Vec<Line<'static>> {
    let mut figures = Vec::new();
    let signals = &comparison.signals;
    let mut figure = |name: &str, unit: &str, fit: f64, rmse: f64, floor: Option<f64>| {
        let times = floor.map_or_else(String::new, |floor| {
            format!(" = {} x noise", fixed(rmse / floor, 2))
        });
        let text = format!(
            " {name} fit {}, error {} {unit}{times} ",
            percent(fit),
            significant(rmse, 3)
        );
        figures.push(Span::styled(text, theme::BOLD));
    };
    if let Some(torque) = &signals.torque_n_m {
        let held = torque.holdout;
        figure(
            "torque",
            "N.m",
            held.fit_percent,
            held.rmse,
            torque.noise_floor,
        );
    }
    let speed = signals.speed_name();
    for (name, unit, signal) in [
        (speed.as_str(), "rad/s", signals.speed_rad_s),
        ("current", "A", signals.current_a),
    ] {
        if let Some(signal) = signal {
            let held = signal.holdout;
            figure(name, unit, held.fit_percent, held.rmse, signal.noise_floor);
        }
    }
    let mut lines: Vec<Line<'static>> = if area.width < WIDE && area.height >= TALL {
        figures.into_iter().map(Line::from).collect()
    } else {
        vec![Line::from(figures)]
    };
    lines.push(lights(&comparison.residual, area.width));
    let undecided = comparison.undecided();
    lines.extend(undecided.map(|sentence| Line::raw(format!(" - {sentence}"))));
    let places = comparison.locations.iter().take(MOST_PLACES);
    lines.extend(places.map(|place| Line::raw(format!(" - {}", place.sentence))));
    if comparison.locations.is_empty() {
        lines.extend(
            comparison
                .balances
                .iter()
                .map(|balance| Line::raw(format!(" - {}", balance.sentence))),
        );
    }
    lines.extend(
        comparison
            .limits
            .iter()
            .map(|limit| Line::styled(format!(" note: {limit}"), theme::DIM)),
    );
    lines
}

/// Rows that there is something for, with the title.
pub(in crate::tui::diagnosis) fn rows(state: &State, width: u16) -> u16 {
    let area = Rect::new(0, 0, width, TALL);
    let rows: usize = state.comparison.as_ref().map_or(1, |comparison| {
        let lines = lines(comparison, area);
        let wide = usize::from(width);
        lines
            .iter()
            .map(|line| wrapped(&line.to_string(), wide.saturating_sub(1)).len())
            .sum()
    });
    u16::try_from(rows + 1).unwrap_or(u16::MAX)
}

/// One light for each question; the word says what the colour does.
fn lights(residual: &ResidualLights, width: u16) -> Line<'static> {
    if !residual.enough_samples {
        return Line::styled(
            " residual: too few samples to say whether only noise is left",
            theme::DIM,
        );
    }
    let light = |passes: bool, good: &str, bad: &str| -> Span<'static> {
        let (text, style): (String, Style) = if passes {
            (format!("✓ {good}  "), theme::GOOD)
        } else {
            (format!("✗ {bad}  "), theme::BAD)
        };
        Span::styled(text, style)
    };
    let mut line = Line::from(vec![
        Span::raw(" residual: "),
        light(residual.white, "white", "not white"),
        light(
            residual.independent_of_input,
            "independent of the input",
            "goes with the input",
        ),
    ]);
    let lags = format!(
        "({} of lags outside)",
        share(residual.autocorrelation_outside_99_percent)
    );
    // Not on a row of its own.
    if line.width() + lags.len() <= usize::from(width) {
        line.push_span(Span::styled(lags, theme::DIM));
    }
    line
}
