//! Keys of the page of traces on runs with a fan, and any state at any size.

use proptest::prelude::*;
use ratatui::Terminal;
use ratatui::backend::TestBackend;

use super::{FRAMES, Shows, StoppedAt, TracesPage, view};
use crate::tui::keys::Press;
use crate::tui::testing::{self, fan_traces};
use drivebench_diagnose::Quantity;
use drivebench_model::sample::Channel;

fn page() -> TracesPage {
    let mut page = TracesPage::default();
    page.take(fan_traces(false));
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
    let stop =
        |run: &str| StoppedAt { run: run.to_owned(), at_s: 2.5, shows: None, text: String::new() };
    let opened = |stop: StoppedAt| {
        let mut page = TracesPage { opens_at: Some(stop), ..TracesPage::default() };
        page.take(fan_traces(false));
        page
    };
    let mut page = opened(stop("run-a"));
    assert_eq!(page.run().unwrap().run, "run-a");
    assert_eq!(page.cursor_s, Some(2.5));
    assert_eq!(page.chosen, None);
    let (from_s, to_s) = page.window_s();
    assert!((from_s - 0.5).abs() < 1e-9 && (to_s - 3.5).abs() < 1e-9);
    page.press(Press::Pan(1));
    let moved = page.window_s();
    page.take(fan_traces(true));
    assert_eq!(page.window_s(), moved);
    let page = opened(StoppedAt { shows: Some(Channel::Current), ..stop("run-b") });
    let quantity = page.run().unwrap().signals[page.chosen.as_deref().unwrap()[0].0].quantity;
    assert_eq!(quantity, Quantity::Channel(Channel::Current));
    // Of another run, which is not shown, nothing is known here.
    let page = opened(stop("run-c"));
    assert_eq!((page.run, page.cursor_s), (0, None));
}

#[test]
fn zoom_and_pan_stay_within_the_run() {
    let mut page = page();
    let whole = page.window_s();
    for _ in 0..3 {
        assert!(page.press(Press::Zoomed(true)));
    }
    assert!((length_s(&page) - (whole.1 - whole.0) / 8.0).abs() < 1e-9);
    for way in [1, -1] {
        for _ in 0..40 {
            page.press(Press::Pan(way));
            let (from_s, to_s) = page.window_s();
            assert!(from_s >= whole.0 - 1e-9 && to_s <= whole.1 + 1e-9);
        }
        let end = if way > 0 { page.window_s().1 - whole.1 } else { page.window_s().0 - whole.0 };
        assert!(end.abs() < 1e-9, "it comes to the end: {end}");
    }
    for _ in 0..40 {
        page.press(Press::Zoomed(true));
    }
    assert!(length_s(&page) > 0.03, "some samples are always seen: {}", length_s(&page));
    for _ in 0..40 {
        page.press(Press::Zoomed(false));
    }
    assert_eq!(page.window_s(), whole);
}

#[test]
fn j_goes_through_the_worst_places_and_the_cursor_is_on_the_largest_residual() {
    let mut page = page();
    page.press(Press::Worst);
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
    page.press(Press::Worst);
    assert_ne!(page.cursor_s, Some(first_s));
    for _ in 0..super::WORST_PLACES - 1 {
        page.press(Press::Worst);
    }
    assert_eq!(page.cursor_s, Some(first_s), "and comes round");
}

#[test]
fn the_cursor_goes_on_into_what_is_not_in_sight() {
    let mut page = page();
    page.press(Press::Zoomed(true));
    for _ in 0..400 {
        page.press(Press::Cursor(1));
        let (from_s, to_s) = page.window_s();
        let at_s = page.cursor_s.unwrap();
        assert!(from_s <= at_s && at_s <= to_s, "{from_s} {at_s} {to_s}");
    }
    assert_eq!(page.cursor_s, Some(page.run().unwrap().span_s().1));
}

#[test]
fn signals_are_chosen_freely_and_another_run_has_its_own() {
    let mut page = page();
    let shown = text(&page, 100, 40);
    assert!(
        shown.contains("current: measured - model") && !shown.contains("voltage command"),
        "{shown}"
    );
    page.press(Press::Signals);
    let place = page.panels().iter().position(|(place, shows)| {
        let quantity = page.run().unwrap().signals[*place].quantity;
        quantity == Quantity::Channel(Channel::VoltageCmd) && *shows == Shows::Both
    });
    page.press(Press::Move(i32::try_from(place.unwrap()).unwrap()));
    page.press(Press::Open);
    page.press(Press::Stop);
    let shown = text(&page, 100, 40);
    assert!(shown.contains("voltage command"), "{shown}");
    page.press(Press::NextScreen);
    let shown = text(&page, 100, 40);
    assert!(shown.contains("fit run: run-a") && !shown.contains("voltage command"), "{shown}");
}

#[test]
fn a_change_is_drawn_from_left_to_right_and_every_dot_is_of_one_of_the_models() {
    let mut page = page();
    let before = text(&page, 100, 30);
    page.take(fan_traces(false));
    assert!(!page.is_moving(), "the same model is no change");
    page.take(fan_traces(true));
    let mut frames = 0;
    let mut shares = vec![page.drawn_share()];
    while page.is_moving() {
        page.frame();
        frames += 1;
        shares.push(page.drawn_share());
    }
    assert_eq!(frames, FRAMES);
    assert!(shares[0] < 1e-9 && (shares[shares.len() - 1] - 1.0).abs() < 1e-9);
    let after = text(&page, 100, 30);
    assert!(after.contains("model before the change") && !before.contains("before the change"));
    page.see_before(true);
    assert!(text(&page, 100, 30).contains("model after the change"));
    page.see_before(false);
    assert_eq!(text(&page, 100, 30), after);
}

#[test]
fn a_residual_within_the_noise_is_told_so_and_a_larger_one_is_not() {
    let mut page = page();
    let rms = |page: &TracesPage| {
        let shown = text(page, 120, 12);
        let after = shown.split(" = ").nth(1).unwrap_or_else(|| panic!("{shown}"));
        after.split(' ').next().unwrap().parse::<f64>().unwrap()
    };
    assert!(rms(&page) > 5.0);
    page.take(fan_traces(true));
    while page.is_moving() {
        page.frame();
    }
    assert!((rms(&page) - 1.0).abs() < 0.2, "{}", rms(&page));
}

fn keys() -> impl Strategy<Value = Vec<Press>> {
    let key = prop::sample::select(vec![
        Press::Worst,
        Press::Zoomed(true),
        Press::Zoomed(false),
        Press::Pan(1),
        Press::Pan(-1),
        Press::Cursor(1),
        Press::Cursor(-1),
        Press::Signals,
        Press::Move(1),
        Press::Open,
        Press::NextScreen,
        Press::Stop,
    ]);
    prop::collection::vec(key, 0..40)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(100))]

    #[test]
    fn any_keys_leave_a_page_that_can_be_drawn_at_any_size(
        keys in keys(),
        width in 1..=200_u16,
        height in 1..=60_u16,
    ) {
        let mut page = page();
        for key in keys {
            page.press(key);
        }
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
