//! One parameter in two or three rows: value with deviation; verdict and how wide the uncertainty still is; how far the
//! data carry it at all. Where there is no room for the third row, the excitation is one block at the edge.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::Style;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Block, Paragraph, Widget, Wrap};

use crate::bench::Excitation;
use crate::sample::{ParameterEstimate, Verdict};
use crate::text::lines::cut;
use crate::tui::theme;

/// From this width on names are written out.
const WIDE: u16 = 44;
/// Relative deviations at the full and at the empty end of the bar.
const WIDEST: f64 = 1.0;
const NARROWEST: f64 = 1e-3;

/// Blocks of one cell, from nothing to all.
const BLOCKS: [&str; 8] = ["▁", "▂", "▃", "▄", "▅", "▆", "▇", "█"];
/// Excitation from which on the estimators believe a value.
const CARRIED: f64 = 0.7;

/// Panel with a frame; three rows for each parameter, two or one where there is no room.
pub(crate) fn parameters(
    estimates: &[ParameterEstimate],
    excitation: &Excitation,
    area: Rect,
    buffer: &mut Buffer,
) {
    let inner_height = usize::from(area.height.saturating_sub(2));
    let three_rows = estimates.len() * 3 <= inner_height && !excitation.is_empty();
    let two_rows = estimates.len() * 2 <= inner_height;
    let block = Block::bordered().title(match (area.width >= WIDE, three_rows) {
        (true, true) => " parameters  (bars: uncertainty, excitation) ",
        (true, false) => " parameters  (bar: uncertainty, 100 % to 0.1 %) ",
        (false, _) if excitation.is_empty() => " parameters ",
        (false, true) => " parameters ",
        (false, false) => " parameters (▁ to █: excited) ",
    });
    let inner = block.inner(area);
    block.render(area, buffer);
    if estimates.is_empty() {
        Line::styled("no estimates yet", theme::DIM).render(inner, buffer);
        return;
    }
    let mut lines: Vec<Line<'static>> = Vec::new();
    for estimate in estimates {
        let share = excitation.get(estimate.key.as_str()).copied();
        if !two_rows {
            lines.push(with_block(short_line(estimate), share, inner.width));
            continue;
        }
        let value = value_line(estimate, inner.width);
        if three_rows {
            lines.push(value);
            lines.push(verdict_line(estimate, inner.width));
            lines.push(excitation_line(share, inner.width));
        } else {
            lines.push(with_block(value, share, inner.width));
            lines.push(verdict_line(estimate, inner.width));
        }
    }
    Paragraph::new(lines).render(inner, buffer);
}

/// Every parameter with its name, its key and the whole reason.
pub(crate) fn table(
    estimates: &[ParameterEstimate],
    excitation: &Excitation,
    area: Rect,
    buffer: &mut Buffer,
) {
    let mut lines = Vec::new();
    for estimate in estimates {
        let share = excitation.get(estimate.key.as_str()).copied();
        lines.push(with_bar(
            value_line(estimate, area.width),
            share,
            area.width,
        ));
        let mut second = verdict_line(estimate, area.width);
        if let Some(reason) = &estimate.reason {
            second = Line::from(vec![
                Span::raw("   "),
                verdict_span(estimate),
                Span::raw(format!(": {reason}")),
            ]);
        }
        lines.push(second);
    }
    if lines.is_empty() {
        lines.push(Line::styled("no estimates yet", theme::DIM));
    }
    Paragraph::new(lines)
        .wrap(Wrap { trim: false })
        .render(area, buffer);
}

fn excitation_style(share: f64) -> Style {
    if share >= CARRIED {
        theme::GOOD
    } else {
        theme::CAREFUL
    }
}

/// One block at the right edge; left out where the text needs the room.
fn with_block(mut line: Line<'static>, share: Option<f64>, width: u16) -> Line<'static> {
    let gap = usize::from(width).checked_sub(line.width() + 1);
    if let (Some(share), Some(gap)) = (share, gap) {
        let at = (share.clamp(0.0, 1.0) * (BLOCKS.len() - 1) as f64).round() as usize;
        line.push_span(" ".repeat(gap));
        line.push_span(Span::styled(BLOCKS[at], excitation_style(share)));
    }
    line
}

/// A bar with its percentage at the right edge, or one block.
fn with_bar(mut line: Line<'static>, share: Option<f64>, width: u16) -> Line<'static> {
    const LENGTH: usize = 10;
    // `excited `, the bar, ` 100 %`.
    const ROOM: usize = 8 + LENGTH + 6;
    let gap = usize::from(width).saturating_sub(line.width() + ROOM);
    match share {
        Some(share) if gap > 0 => {
            line.push_span(" ".repeat(gap));
            line.push_span("excited ");
            line.extend(bar(share, LENGTH));
            line
        }
        _ => with_block(line, share, width),
    }
}

/// The third row: how far the data carry the parameter.
fn excitation_line(share: Option<f64>, width: u16) -> Line<'static> {
    // In one column with the bar of the uncertainty.
    const HEAD: &str = "   excited   ";
    const PERCENT: usize = 7;
    let length = usize::from(width)
        .saturating_sub(HEAD.len() + PERCENT)
        .min(20);
    let mut line = Line::raw(HEAD);
    if let Some(share) = share {
        line.extend(bar(share, length));
    }
    line
}

fn bar(share: f64, length: usize) -> [Span<'static>; 3] {
    let share = share.clamp(0.0, 1.0);
    let full = (share * length as f64).round() as usize;
    [
        Span::styled("█".repeat(full), excitation_style(share)),
        Span::styled("░".repeat(length - full), theme::DIM),
        Span::raw(format!(" {:3.0} %", 100.0 * share)),
    ]
}

fn verdict_span(estimate: &ParameterEstimate) -> Span<'static> {
    Span::styled(estimate.verdict.name(), theme::verdict(estimate.verdict))
}

fn value_line(estimate: &ParameterEstimate, width: u16) -> Line<'static> {
    let (symbol, name) = parameter(&estimate.key);
    let head = if width + 2 >= WIDE && !estimate.key.contains('.') {
        format!("{symbol:<3}{name:<16}")
    } else if width + 2 >= WIDE {
        format!("{name:<19}")
    } else {
        format!("{symbol:<3}")
    };
    Line::from(vec![
        Span::styled(head, theme::BOLD),
        Span::raw(estimate.number(1.0)),
        Span::styled(format!(" {}", estimate.unit), theme::DIM),
    ])
}

fn verdict_line(estimate: &ParameterEstimate, width: u16) -> Line<'static> {
    const INDENT: usize = 3;
    let mut verdict = verdict_span(estimate);
    if estimate.reason.is_none() {
        // Bars begin in one column.
        verdict.content = format!("{:<9}", verdict.content).into();
    }
    let room = usize::from(width).saturating_sub(INDENT + verdict.width() + 1);
    let mut spans = vec![Span::raw(" ".repeat(INDENT)), verdict, Span::raw(" ")];
    match (&estimate.reason, relative_std(estimate)) {
        (Some(reason), _) => spans.push(Span::styled(cut(reason, room), theme::DIM)),
        (None, Some(share)) => {
            const PERCENT: usize = 7;
            let length = room.saturating_sub(PERCENT).min(20);
            let full = (uncertainty(share) * length as f64).round() as usize;
            spans.push(Span::styled(
                "█".repeat(full),
                theme::verdict(estimate.verdict),
            ));
            spans.push(Span::styled("░".repeat(length - full), theme::DIM));
            spans.push(Span::raw(format!(" {}", percent(share))));
        }
        (None, None) => {}
    }
    Line::from(spans)
}

fn short_line(estimate: &ParameterEstimate) -> Line<'static> {
    Line::from(vec![
        Span::styled(format!("{:<3}", parameter(&estimate.key).0), theme::BOLD),
        Span::raw(format!("{} {} ", estimate.number(1.0), estimate.unit)),
        verdict_span(estimate),
    ])
}

/// Standard deviation over value, where there are both.
fn relative_std(estimate: &ParameterEstimate) -> Option<f64> {
    let share = (estimate.std? / estimate.value?).abs();
    (share.is_finite() && estimate.verdict != Verdict::Fixed).then_some(share)
}

/// Length of the bar, 0 to 1, on a logarithmic scale.
fn uncertainty(share: f64) -> f64 {
    ((share / NARROWEST).log10() / (WIDEST / NARROWEST).log10()).clamp(0.0, 1.0)
}

/// Symbol and name of a parameter by its key; an effect's parameter goes by its own key without the unit.
pub(crate) fn parameter(key: &str) -> (String, String) {
    let known = match key {
        "resistance_ohm" => ("R", "resistance"),
        "inductance_h" => ("L", "inductance"),
        "back_emf_v_s_per_rad" => ("Ke", "back-EMF"),
        "torque_n_m_per_a" => ("Kt", "torque constant"),
        "inertia_kg_m2" => ("J", "inertia"),
        "load_torque_n_m" => ("Tl", "load torque"),
        _ => ("", ""),
    };
    if !known.0.is_empty() {
        return (known.0.to_owned(), known.1.to_owned());
    }
    let own = key.rsplit('.').next().unwrap_or(key);
    let mut words = own.split('_');
    let first = words.next().unwrap_or(own);
    (first.to_owned(), own.replace('_', " "))
}

/// A relative deviation as a percentage.
fn percent(share: f64) -> String {
    let percent = share * 100.0;
    if percent >= 1000.0 {
        ">999 %".to_owned()
    } else if percent >= 10.0 {
        format!("{percent:.0} %")
    } else if percent >= 0.1 {
        format!("{percent:.1} %")
    } else {
        "<0.1 %".to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bar_is_logarithmic_from_a_thousandth_to_the_whole() {
        for (share, expected) in [
            (10.0, 1.0),
            (1.0, 1.0),
            (0.01, 1.0 / 3.0),
            (1e-3, 0.0),
            (0.0, 0.0),
        ] {
            assert!((uncertainty(share) - expected).abs() < 1e-12, "{share}");
        }
    }

    #[test]
    fn a_parameter_has_a_symbol_and_a_name() {
        assert_eq!(parameter("inertia_kg_m2").0, "J");
        assert_eq!(
            parameter("stribeck_friction.stribeck_n_m"),
            ("stribeck".to_owned(), "stribeck n m".to_owned())
        );
    }
}
