//! Panels beside the scope: parameters with uncertainty and excitation, and the link with every exchange accounted for.
//!
//! A parameter has two or three rows: value with deviation; verdict and how wide the uncertainty still is; how far the
//! data carry it at all. Where there is no room for the third row, the excitation is one block at the edge.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::Style;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Block, Paragraph, Widget, Wrap};

use crate::bench::Snapshot;
use crate::sample::{ParameterEstimate, Verdict};
use crate::text::lines::cut;
use crate::text::number::shortest;
use crate::tui::frame::bar_spans;
use crate::tui::theme;

/// From this width on names are written out.
const WIDE: u16 = 44;
/// Relative deviations at the full and at the empty end of the bar.
const WIDEST: f64 = 1.0;
const NARROWEST: f64 = 1e-3;
/// Longest bar, and the room for its percentage, in a panel.
const BAR: usize = 20;
const PERCENT: usize = 7;

/// Blocks of one cell, from nothing to all.
const BLOCKS: [&str; 8] = ["▁", "▂", "▃", "▄", "▅", "▆", "▇", "█"];
/// Excitation from which on the estimators believe a value.
const CARRIED: f64 = 0.7;

/// Panel with a frame; three rows for each parameter, two or one where there is no room.
pub(super) fn parameters(snapshot: &Snapshot, area: Rect, buffer: &mut Buffer) {
    let (estimates, excitation) = (&snapshot.estimates, &snapshot.excitation);
    let inner_height = usize::from(area.height.saturating_sub(2));
    let three_rows = estimates.len() * 3 <= inner_height && !excitation.is_empty();
    let two_rows = estimates.len() * 2 <= inner_height;
    let block = Block::bordered().title(match (area.width >= WIDE, three_rows) {
        (true, true) => " parameters  (bars: uncertainty, excitation) ",
        (true, false) => " parameters  (bar: uncertainty, 100 % to 0.1 %) ",
        (false, false) if !excitation.is_empty() => " parameters (▁ to █: excited) ",
        (false, _) => " parameters ",
    });
    let inner = block.inner(area);
    block.render(area, buffer);
    if estimates.is_empty() {
        Line::styled("no estimates yet", theme::DIM).render(inner, buffer);
        return;
    }
    let mut lines: Vec<Line<'static>> = Vec::new();
    for estimate in estimates.iter() {
        let share = excitation.get(estimate.key.as_str()).copied();
        let value = value_line(estimate, inner.width);
        if three_rows {
            lines.push(value);
            lines.push(verdict_line(estimate, inner.width));
            lines.push(excitation_line(share, inner.width));
        } else if two_rows {
            lines.push(with_block(value, share, inner.width));
            lines.push(verdict_line(estimate, inner.width));
        } else {
            lines.push(with_block(short_line(estimate), share, inner.width));
        }
    }
    Paragraph::new(lines).render(inner, buffer);
}

/// Every parameter with its name, its key and the whole reason.
pub(super) fn table(snapshot: &Snapshot, area: Rect, buffer: &mut Buffer) {
    let mut lines = Vec::new();
    for estimate in snapshot.estimates.iter() {
        let share = snapshot.excitation.get(estimate.key.as_str()).copied();
        lines.push(with_bar(
            value_line(estimate, area.width),
            share,
            area.width,
        ));
        lines.push(match &estimate.reason {
            None => verdict_line(estimate, area.width),
            Some(reason) => Line::from(vec![
                Span::raw("   "),
                verdict_span(estimate),
                Span::raw(format!(": {reason}")),
            ]),
        });
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
            line.extend(excitation_bar(share, LENGTH));
            line
        }
        _ => with_block(line, share, width),
    }
}

/// The third row: how far the data carry the parameter.
fn excitation_line(share: Option<f64>, width: u16) -> Line<'static> {
    // In one column with the bar of the uncertainty.
    const HEAD: &str = "   excited   ";
    let length = usize::from(width).saturating_sub(HEAD.len() + PERCENT);
    let mut line = Line::raw(HEAD);
    line.extend(
        share
            .into_iter()
            .flat_map(|share| excitation_bar(share, length.min(BAR))),
    );
    line
}

fn excitation_bar(share: f64, length: usize) -> [Span<'static>; 3] {
    let share = share.clamp(0.0, 1.0);
    let [full, empty] = bar_spans(share, length, excitation_style(share));
    [full, empty, Span::raw(format!(" {:3.0} %", 100.0 * share))]
}

fn verdict_span(estimate: &ParameterEstimate) -> Span<'static> {
    Span::styled(estimate.verdict.name(), theme::verdict(estimate.verdict))
}

fn value_line(estimate: &ParameterEstimate, width: u16) -> Line<'static> {
    let (symbol, name) = name(&estimate.key);
    let head = match (width + 2 >= WIDE, estimate.key.contains('.')) {
        (true, false) => format!("{symbol:<3}{name:<16}"),
        (true, true) => format!("{name:<19}"),
        (false, _) => format!("{symbol:<3}"),
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
    let mut line = Line::from(vec![Span::raw(" ".repeat(INDENT)), verdict, Span::raw(" ")]);
    if let Some(reason) = &estimate.reason {
        line.push_span(Span::styled(cut(reason, room), theme::DIM));
    } else if let Some(share) = relative_std(estimate) {
        let length = room.saturating_sub(PERCENT).min(BAR);
        let style = theme::verdict(estimate.verdict);
        line.extend(bar_spans(uncertainty(share), length, style));
        line.push_span(format!(" {}", percent(share)));
    }
    line
}

fn short_line(estimate: &ParameterEstimate) -> Line<'static> {
    Line::from(vec![
        Span::styled(format!("{:<3}", name(&estimate.key).0), theme::BOLD),
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
pub(crate) fn name(key: &str) -> (&str, String) {
    let known = match key {
        "resistance_ohm" => ("R", "resistance"),
        "inductance_h" => ("L", "inductance"),
        "back_emf_v_s_per_rad" => ("Ke", "back-EMF"),
        "torque_n_m_per_a" => ("Kt", "torque constant"),
        "inertia_kg_m2" => ("J", "inertia"),
        "load_torque_n_m" => ("Tl", "load torque"),
        _ => {
            let own = key.rsplit('.').next().unwrap_or(key);
            let first = own.split('_').next().unwrap_or(own);
            return (first, own.replace('_', " "));
        }
    };
    (known.0, known.1.to_owned())
}

/// A relative deviation as a percentage.
fn percent(share: f64) -> String {
    match share * 100.0 {
        1000.0.. => ">999 %".to_owned(),
        percent @ 10.0.. => format!("{percent:.0} %"),
        percent @ 0.1.. => format!("{percent:.1} %"),
        _ => "<0.1 %".to_owned(),
    }
}

/// Rows of the link panel with its frame.
pub(super) const LINK_HEIGHT: u16 = 7;

/// Link, punctuality and recorder.
pub(super) fn link_panel(snapshot: &Snapshot, area: Rect, buffer: &mut Buffer) {
    let block = Block::bordered().title(" link and record ");
    let inner = block.inner(area);
    block.render(area, buffer);
    let (link, timing) = (&snapshot.link_statistics, &snapshot.timing);
    let mut lines = vec![
        Line::raw(format!("sent {}  ok {}  ", link.sent, link.ok)),
        counts(&[
            ("timeout", link.timeout),
            ("crc", link.crc),
            ("stale", link.stale),
        ]),
        counts(&[
            ("mismatch", link.mismatch),
            ("exception", link.exception),
            ("io", link.aborted),
        ]),
        Line::raw(format!(
            "late p50 {} ms p99 {} ms",
            shortest(1e3 * timing.lateness_p50_s, 3),
            shortest(1e3 * timing.lateness_p99_s, 3)
        )),
    ];
    lines[0].extend(counts(&[("missed", timing.missed_cycles)]));
    lines.push(match &snapshot.recorder_error {
        Some(error) => Line::styled(format!("NOT RECORDED: {error}"), theme::BAD),
        None => Line::raw(format!("rows {} recorded", snapshot.rows)),
    });
    if let Some(text) = &snapshot.reopening {
        lines.insert(0, Line::styled(text.clone(), theme::CAREFUL));
    } else if inner.height < lines.len() as u16 {
        // What was not recorded matters more than what was late.
        lines.rotate_right(1);
    }
    Paragraph::new(lines).render(inner, buffer);
}

/// Losses by their names, those that there are in colour.
fn counts(losses: &[(&'static str, u64)]) -> Line<'static> {
    let spans = losses.iter().map(|(name, count)| {
        let style = if *count > 0 {
            theme::CAREFUL
        } else {
            theme::PLAIN
        };
        Span::styled(format!("{name} {count}  "), style)
    });
    spans.collect()
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
        assert_eq!(name("inertia_kg_m2").0, "J");
        let effect = name("stribeck_friction.stribeck_n_m");
        assert_eq!(effect, ("stribeck", "stribeck n m".to_owned()));
    }
}
