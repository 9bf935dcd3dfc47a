//! The whole frame as a function of the state.

use std::fmt::Write as _;

use ratatui::Frame;
use ratatui::buffer::Buffer;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::text::{Line, Span};
use ratatui::widgets::{Paragraph, Widget, Wrap};

use super::guess::Guessing;
use super::panel::{candidates, card, failing, help, ladder, map, next};
use super::state::{Over, State};
use crate::diagnosis::{Diagnosis, DiagnosisVerdict};
use crate::tui::theme;

/// The smallest screen that can be read.
const SMALLEST: (u16, u16) = (30, 6);
/// Rungs that are shown; the latest ones where there are more.
const MOST_RUNGS: usize = 5;

pub(super) fn view(state: &State, frame: &mut Frame<'_>) {
    let area = frame.area();
    let buffer = frame.buffer_mut();
    if area.width < SMALLEST.0 || area.height < SMALLEST.1 {
        let text = format!("too small: {}x{}, q = leave", area.width, area.height);
        Line::styled(text, theme::CAREFUL).render(area, buffer);
        return;
    }
    let tall = area.height >= 20;
    let verdict_rows = if tall { 2 } else { 1 };
    let failing_rows = match area.height {
        0..=11 => 0,
        12..=19 => 2,
        20..=29 => 6,
        _ => 9,
    };
    let rungs = state.ladder.len().min(MOST_RUNGS) as u16;
    let ladder_rows = match area.height {
        0..=13 => 0,
        _ if rungs == 0 => 0,
        14..=19 => 2 + u16::from(state.change.is_some()),
        _ => 1 + rungs + u16::from(state.change.is_some()),
    };
    let [top, verdict, where_area, list, ladder_area, bottom] = Layout::vertical([
        Constraint::Length(1),
        Constraint::Length(verdict_rows),
        Constraint::Length(failing_rows),
        Constraint::Fill(1),
        Constraint::Length(ladder_rows),
        Constraint::Length(1),
    ])
    .areas(area);
    top_bar(state, top, buffer);
    Paragraph::new(verdict_line(state))
        .wrap(Wrap { trim: false })
        .render(verdict, buffer);
    let body = Rect {
        height: where_area.height + list.height + ladder_area.height,
        ..where_area
    };
    match state.over {
        Over::Card(line) => card::card(state, line, body, buffer),
        Over::Map(index) => map::map(state, index, body, buffer),
        Over::Next(line) => next::next(state, line, body, buffer),
        Over::Nothing | Over::Help => {
            failing::failing(state, where_area, buffer);
            candidates::candidates(state, list, buffer);
            ladder::ladder(state, ladder_area, buffer);
        }
    }
    if state.over == Over::Help {
        help::help(body, buffer);
    }
    hints(state, bottom, buffer);
}

fn top_bar(state: &State, area: Rect, buffer: &mut Buffer) {
    let work = match (&state.working, &state.failure) {
        (Some(work), _) => Span::styled(format!(" … {work} "), theme::CAREFUL),
        (None, Some(_)) => Span::styled(" FAILED ", theme::BAD),
        (None, None) => Span::styled(" ready ", theme::GOOD),
    };
    Line::from(vec![
        Span::styled(" DIAGNOSIS ", theme::BOLD),
        Span::styled(format!("{} ", state.title), theme::DIM),
    ])
    .render(area, buffer);
    let width = (work.width() as u16).min(area.width);
    let right = Rect {
        x: area.right() - width,
        width,
        ..area
    };
    Line::from(work).render(right, buffer);
}

fn verdict_line(state: &State) -> Line<'static> {
    if let Some(failure) = &state.failure {
        return Line::styled(format!(" ERROR: {failure}"), theme::BAD);
    }
    if state.guessing == Guessing::Choosing {
        return Line::styled(guess_first(state), theme::BOLD);
    }
    let Some(diagnosis) = &state.diagnosis else {
        let judged = state.judged.values();
        let screened = judged
            .clone()
            .filter(|judged| judged.share.is_some())
            .count();
        let refitted = judged.filter(|judged| judged.error.is_some()).count();
        let mut text = format!(" {screened} effects screened, {refitted} refitted");
        for (id, error) in &state.taken {
            let _ = write!(text, "; {id} taken, held-out error {error:.2}");
        }
        return Line::styled(text, theme::CAREFUL);
    };
    let (word, style) = word(diagnosis);
    let mut spans = vec![
        Span::styled(format!(" {word} "), style),
        Span::raw(diagnosis.sentence.clone()),
    ];
    if matches!(
        diagnosis.verdict,
        DiagnosisVerdict::Effect | DiagnosisVerdict::Ambiguous
    ) && !diagnosis.sufficient
    {
        spans.push(Span::raw("; this is not all: much is still unexplained"));
    }
    Line::from(spans)
}

fn guess_first(state: &State) -> String {
    let best = state
        .judged
        .values()
        .filter_map(|judged| judged.share)
        .fold(f64::NAN, f64::max);
    if let Some(diagnosis) = &state.diagnosis {
        let (before, after) = (diagnosis.holdout_before, diagnosis.holdout_after);
        let found = if diagnosis.effects.is_empty() {
            "and adds nothing".to_owned()
        } else {
            format!("and takes the held-out error from {before:.2} to {after:.2} times the noise")
        };
        return format!(" the tool has its answer {found}; what is yours? g = guess the selected");
    }
    if best.is_finite() {
        let percent = 100.0 * best.clamp(0.0, 1.0);
        return format!(
            " the tool is at work, its best effect explains {percent:.0} %; what is your guess?"
        );
    }
    " the tool is at work; what is your guess?".to_owned()
}

/// The verdict as a word, which the colour only repeats.
fn word(diagnosis: &Diagnosis) -> (&'static str, ratatui::style::Style) {
    match diagnosis.verdict {
        DiagnosisVerdict::Effect if diagnosis.sufficient => ("✓ EFFECT", theme::GOOD),
        DiagnosisVerdict::Effect => ("~ EFFECT, IN PART", theme::CAREFUL),
        DiagnosisVerdict::Ambiguous => ("? AMBIGUOUS", theme::CAREFUL),
        DiagnosisVerdict::None => ("✓ NOTHING MISSING", theme::GOOD),
        DiagnosisVerdict::Unexplained => ("✗ UNEXPLAINED", theme::BAD),
    }
}

/// The last line: the answer to the last key, else the keys.
fn hints(state: &State, area: Rect, buffer: &mut Buffer) {
    if let Some(message) = &state.message {
        Line::styled(format!(" > {message}"), theme::CAREFUL.patch(theme::BOLD))
            .render(area, buffer);
        return;
    }
    let keys = match state.over {
        Over::Card(_) => " Up Down scroll  Esc back  a add  r remove  q back",
        Over::Next(_) => " Up Down scroll  n Esc back  q back",
        Over::Map(0) => " m the other equation  Esc back  q back",
        Over::Map(_) => " m Esc back  q back",
        Over::Help => " any key closes the help",
        Over::Nothing if state.guessing == Guessing::Choosing => {
            " Up Down choose  g guess it  Enter card  m map  Esc show names  q leave"
        }
        Over::Nothing if state.working.is_some() => {
            " Up Down select  Enter card  g guess first  m map  ? help  q leave"
        }
        Over::Nothing => {
            " a add  r remove  Enter card  m map  n next run  w write  ? help  q leave"
        }
    };
    Line::styled(keys, theme::DIM).render(area, buffer);
}
