//! Every page of every screen at three sizes, and the contrast of its colours on a white background.

use insta::assert_snapshot;
use ratatui::Frame;
use ratatui::buffer::Buffer;
use ratatui::style::{Color, Modifier};

use super::{diagnosis, live, response, testing, theme};

/// One of each layout: no page has another one beyond 110 columns and 36 rows.
const SIZES: [(u16, u16); 3] = [(40, 10), (80, 24), (120, 40)];
/// More room is tried on one page of each screen.
const ROOMY: (u16, u16) = (200, 50);
const ON_ROOMY: [&str; 3] = ["live_running", "diagnosis_answered", "response_mechanics"];

pub(super) type Page = (&'static str, Box<dyn Fn(&mut Frame<'_>)>);

fn pages() -> impl Iterator<Item = (String, Page)> {
    let live = live::tests::pages().into_iter().map(|page| (format!("live_{}", page.0), page));
    let diagnosis = diagnosis::tests::pages().into_iter();
    let diagnosis = diagnosis.map(|page| (format!("diagnosis_{}", page.0), page));
    let response = response::tests::pages().into_iter();
    live.chain(diagnosis).chain(response.map(|page| (format!("response_{}", page.0), page)))
}

/// The rows of a page without the blanks at their ends.
fn text(buffer: &Buffer) -> String {
    let rows = buffer.content.chunks(usize::from(buffer.area.width)).map(|row| {
        let row: String = row.iter().map(ratatui::buffer::Cell::symbol).collect();
        format!("|{}\n", row.trim_end())
    });
    rows.collect()
}

#[test]
fn every_page_at_every_size() {
    for (name, (_, draw)) in pages() {
        let roomy = ON_ROOMY.contains(&name.as_str()).then_some(ROOMY);
        let sizes = SIZES.into_iter().chain(roomy).map(|(width, height)| {
            let terminal = testing::terminal((width, height), |frame| draw(frame));
            format!("{width}x{height}\n{}", text(terminal.backend().buffer()))
        });
        assert_snapshot!(name, sizes.collect::<Vec<_>>().join("\n"));
    }
}

/// Red, green and blue of a colour of the 256 that are the same on every terminal.
fn rgb(index: u8) -> [f64; 3] {
    const STEPS: [f64; 6] = [0.0, 95.0, 135.0, 175.0, 215.0, 255.0];
    match index {
        0..16 => panic!("{index} is the terminal's own"),
        16..232 => [36, 6, 1].map(|weight| STEPS[usize::from((index - 16) / weight % 6)]),
        232.. => [8.0 + 10.0 * f64::from(index - 232); 3],
    }
}

/// Relative luminance and contrast as WCAG 2 defines them.
fn contrast(one: [f64; 3], other: [f64; 3]) -> f64 {
    let luminance = |rgb: [f64; 3]| {
        let linear = rgb.map(|value| {
            let share = value / 255.0;
            if share <= 0.04045 { share / 12.92 } else { ((share + 0.055) / 1.055).powf(2.4) }
        });
        0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]
    };
    let (a, b) = (luminance(one), luminance(other));
    (a.max(b) + 0.05) / (a.min(b) + 0.05)
}

#[test]
fn on_white_every_letter_has_a_contrast_of_four_and_a_half() {
    let own = |colour: Color, reset: [f64; 3]| match colour {
        Color::Reset => reset,
        Color::Indexed(index) => rgb(index),
        other => panic!("{other:?} is the terminal's own"),
    };
    let (black, white) = ([0.0; 3], [255.0; 3]);
    assert!((contrast(black, white) - 21.0).abs() < 1e-9);
    let mut colours = std::collections::BTreeSet::new();
    for (name, (_, draw)) in pages() {
        let mut terminal = testing::terminal((120, 40), |frame| {
            draw(frame);
            theme::lighten(frame.buffer_mut());
        });
        for cell in &terminal.backend_mut().buffer().content {
            let found = contrast(own(cell.fg, black), own(cell.bg, white));
            assert!(found >= 4.5, "{name}: {cell:?} has {found:.2}");
            assert!(!cell.modifier.contains(Modifier::DIM), "{name}: {cell:?}");
            colours.insert(format!("{:?} on {:?}", cell.fg, cell.bg));
        }
    }
    assert!(colours.len() >= 9, "the pages show every colour: {colours:?}");
}
