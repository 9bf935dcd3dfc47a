//! Keys of the page of traces on runs with a fan, and any state at any size.

use proptest::prelude::*;
use ratatui::Terminal;
use ratatui::backend::TestBackend;

use super::{FRAMES, Shows, StoppedAt, TracesPage, view};
use crate::tui::testing::{self, fan_traces};
use drivebench_diagnose::Quantity;
use drivebench_model::sample::Channel;

fn page() -> TracesPage {
    let mut page = TracesPage::default();
    page.take(fan_traces(false));
    page
}

fn pressed(mut page: TracesPage, keys: &str) -> TracesPage {
    for key in keys.chars() {
        page.press(testing::key(key));
    }
    page
}

fn length_s(page: &TracesPage) -> f64 {
    let (from_s, to_s) = page.window_s();
    to_s - from_s
}

fn terminal(page: &TracesPage, width: u16, height: u16) -> Terminal<TestBackend> {
    testing::terminal((width, height), |frame| {
        view(page, frame.area(), frame.buffer_mut());
    })
}

fn text(page: &TracesPage, width: u16, height: u16) -> String {
    terminal(page, width, height).backend().to_string()
}

#[test]
fn a_run_that_was_stopped_opens_there_and_only_once() {
    let opened = |run: &str, shows| {
        let stop = StoppedAt { run: run.to_owned(), at_s: 2.5, shows, text: String::new() };
        let mut page = TracesPage { opens_at: Some(stop), ..TracesPage::default() };
        page.take(fan_traces(false));
        page
    };
    let page = opened("run-a", None);
    assert_eq!(page.run().unwrap().run, "run-a");
    assert_eq!((page.cursor_s, &page.chosen), (Some(2.5), &None));
    let (from_s, to_s) = page.window_s();
    assert!((from_s - 0.5).abs() < 1e-9 && (to_s - 3.5).abs() < 1e-9);
    let mut page = pressed(page, ".");
    let moved = page.window_s();
    page.take(fan_traces(true));
    assert_eq!(page.window_s(), moved);
    let page = opened("run-b", Some(Channel::Current));
    let first = page.chosen.as_deref().unwrap()[0].0;
    let quantity = page.run().unwrap().signals[first].quantity;
    assert_eq!(quantity, Quantity::Channel(Channel::Current));
    // A run that is not among the traces.
    let page = opened("run-c", None);
    assert_eq!((page.run, page.cursor_s), (0, None));
}

#[test]
fn zoom_and_pan_stay_within_the_run() {
    let whole = page().window_s();
    let mut page = pressed(page(), "+++");
    assert!((length_s(&page) - (whole.1 - whole.0) / 8.0).abs() < 1e-9);
    for key in [".", ","] {
        for _ in 0..40 {
            page = pressed(page, key);
            let (from_s, to_s) = page.window_s();
            assert!(from_s >= whole.0 - 1e-9 && to_s <= whole.1 + 1e-9);
        }
        let (from_s, to_s) = page.window_s();
        let end = if key == "." { to_s - whole.1 } else { from_s - whole.0 };
        assert!(end.abs() < 1e-9, "it comes to the end: {end}");
    }
    let page = pressed(page, &"+".repeat(40));
    assert!(length_s(&page) > 0.03, "some samples are always shown: {}", length_s(&page));
    assert_eq!(pressed(page, &"-".repeat(40)).window_s(), whole);
}

#[test]
fn j_goes_round_the_worst_places_each_under_the_cursor() {
    let page = pressed(page(), "j");
    let first_s = page.cursor_s.unwrap();
    let speed = &page.run().unwrap().signals[0];
    let rms = |at_s: f64| {
        let pairs = speed.time_s.iter().zip(speed.residual());
        let near = pairs.filter(|(t, _)| (**t - at_s).abs() < 0.05);
        let (sum, n) = near.fold((0.0, 0.0), |(sum, n), (_, r)| (sum + r * r, n + 1.0));
        f64::sqrt(sum / n)
    };
    let ends = [0.2, 1.0, 1.7, 2.6].map(rms);
    assert!(ends.iter().all(|end| *end <= rms(first_s)), "{ends:?}");
    let (from_s, to_s) = page.window_s();
    assert!(from_s <= first_s && first_s <= to_s);
    let page = pressed(page, "j");
    assert_ne!(page.cursor_s, Some(first_s));
    assert_eq!(pressed(page, &"j".repeat(super::WORST_PLACES - 1)).cursor_s, Some(first_s));
}

#[test]
fn the_cursor_moves_the_window_along() {
    let mut page = pressed(page(), "+");
    for _ in 0..400 {
        page = pressed(page, "→");
        let (from_s, to_s) = page.window_s();
        let at_s = page.cursor_s.unwrap();
        assert!(from_s <= at_s && at_s <= to_s, "{from_s} {at_s} {to_s}");
    }
    assert_eq!(page.cursor_s, Some(page.run().unwrap().span_s().1));
}

#[test]
fn signals_are_chosen_freely_and_another_run_has_its_own() {
    let page = page();
    let voltage = page.panels().iter().position(|(place, shows)| {
        let quantity = page.run().unwrap().signals[*place].quantity;
        quantity == Quantity::Channel(Channel::VoltageCmd) && *shows == Shows::Both
    });
    let choice = format!("o{}⏎␛", "↓".repeat(voltage.unwrap()));
    let chosen = pressed(page.clone(), &choice);
    for (page, part, has_voltage) in [
        (page, "current: measured - model", false),
        (chosen.clone(), "voltage command", true),
        (pressed(chosen, "⇥"), "fit run: run-a", false),
    ] {
        let shown = text(&page, 100, 40);
        assert!(shown.contains(part), "{shown}");
        assert_eq!(shown.contains("voltage command"), has_voltage, "{shown}");
    }
}

#[test]
fn a_change_is_drawn_from_left_to_right_over_the_old_model() {
    let mut page = page();
    let rms = |page: &TracesPage| {
        let shown = text(page, 120, 12);
        let after = shown.split(" = ").nth(1).unwrap_or_else(|| panic!("{shown}"));
        after.split(' ').next().unwrap().parse::<f64>().unwrap()
    };
    let before = text(&page, 100, 30);
    assert!(rms(&page) > 5.0 && !before.contains("before the change"));
    page.take(fan_traces(false));
    assert!(!page.is_moving(), "the same model is no change");
    page.take(fan_traces(true));
    assert!(page.drawn_share() < 1e-9);
    for _ in 0..FRAMES {
        assert!(page.is_moving());
        page.frame();
    }
    assert!(!page.is_moving());
    assert!((page.drawn_share() - 1.0).abs() < 1e-9);
    // The new residual is that of the noise.
    assert!((rms(&page) - 1.0).abs() < 0.2, "{}", rms(&page));
    let after = text(&page, 100, 30);
    assert!(after.contains("model before the change"));
    page.set_before(true);
    assert!(text(&page, 100, 30).contains("model after the change"));
    page.set_before(false);
    assert_eq!(text(&page, 100, 30), after);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(100))]

    #[test]
    fn any_keys_leave_a_page_that_can_be_drawn_at_any_size(
        keys in "[j+,.→←o↓⏎⇥␛-]{0,40}",
        width in 1..=200_u16,
        height in 1..=60_u16,
    ) {
        let page = pressed(page(), &keys);
        let (from_s, to_s) = page.window_s();
        prop_assert!(from_s < to_s);
        terminal(&page, width, height);
    }
}

#[test]
fn every_small_size() {
    for (width, height) in testing::sizes() {
        terminal(&page(), width, height);
    }
}
