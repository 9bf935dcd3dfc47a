use std::sync::Arc;

use insta::assert_snapshot;
use ratatui::style::{Color, Modifier};

use super::fixtures::{done, hardware, missing, model, running, terminal, text, tripped, workflow};
use crate::bench::Phase;
use crate::tui::live::WorkerState;
use crate::tui::live::model::{Event, Model, Page};

fn finished(mut model: Model) -> Model {
    model.update(Event::Worker(WorkerState::Finished));
    model
}

#[test]
fn live() {
    let model = model(running());
    assert_snapshot!("running_80x24", text(&model, 80, 24));
    assert_snapshot!("running_120x40", text(&model, 120, 40));
    assert_snapshot!("running_40x10", text(&model, 40, 10));
}

#[test]
fn trips_and_ends() {
    assert_snapshot!("tripped_80x24", text(&model(tripped()), 80, 24));
    assert_snapshot!("tripped_40x10", text(&finished(model(tripped())), 40, 10));
    assert_snapshot!("done_80x24", text(&finished(model(done())), 80, 24));
}

#[test]
fn a_lost_link_tells_how_the_search_goes_and_what_came_of_it() {
    let mut lost = running();
    lost.phase = Some(Phase::LinkLost);
    lost.outcome = Some("link_lost");
    lost.reopening = Some("link lost, reopening (attempt 3)…".to_owned());
    for (width, height) in [(80, 24), (120, 40), (40, 10)] {
        let shown = text(&model(lost.clone()), width, height);
        assert!(shown.contains("LINK LOST"), "{shown}");
        assert!(shown.contains("reopening (attempt 3)…"), "{shown}");
    }
    lost.phase = Some(Phase::Safe);
    lost.reopening = Some("x: the same drive is back, stop confirmed".to_owned());
    let shown = text(&finished(model(lost)), 80, 24);
    assert!(shown.contains(" SAFE "), "{shown}");
    assert!(shown.contains("stop confirmed. q = quit."), "{shown}");
}

#[test]
fn hardware_that_waits_and_a_drive_that_gives_little() {
    let mut waiting = model(hardware());
    assert_snapshot!("hardware_80x24", text(&waiting, 80, 24));
    waiting.confirm_start = true;
    assert_snapshot!("hardware_confirm_120x40", text(&waiting, 120, 40));
    assert_snapshot!("missing_80x24", text(&model(missing()), 80, 24));
}

#[test]
fn the_other_screens() {
    let mut model = model(running());
    model.page = Page::Parameters;
    assert_snapshot!("parameters_80x24", text(&model, 80, 24));
    assert_snapshot!("parameters_40x10", text(&model, 40, 10));
    model.update(Event::Workflow(Arc::new(workflow(false))));
    model.page = Page::Steps;
    assert_snapshot!("steps_80x24", text(&model, 80, 24));
    model.page = Page::Live;
    model.help = Some(0);
    assert_snapshot!("help_80x24", text(&model, 80, 24));
}

#[test]
fn the_report_is_shown_when_it_comes() {
    let mut model = finished(model(done()));
    model.update(Event::Workflow(Arc::new(workflow(false))));
    assert_eq!(model.page, Page::Live);
    model.update(Event::Workflow(Arc::new(workflow(true))));
    assert_eq!(model.page, Page::Steps);
    assert_snapshot!("report_80x24", text(&model, 80, 24));
    // Turning away afterwards is respected.
    model.page = Page::Live;
    model.update(Event::Workflow(Arc::new(workflow(true))));
    assert_eq!(model.page, Page::Live);
}

#[test]
fn hardware_is_reversed_and_a_trip_is_white_on_red() {
    let terminal_of = |snapshot| terminal(&model(snapshot), 80, 24);
    let real = terminal_of(hardware());
    let cell = &real.backend().buffer()[(2, 0)];
    assert_eq!((cell.symbol(), cell.fg), ("A", Color::Red));
    assert!(cell.modifier.contains(Modifier::REVERSED));

    let soft = terminal_of(running());
    let cell = &soft.backend().buffer()[(2, 0)];
    assert_eq!((cell.symbol(), cell.fg), ("I", Color::Green));
    assert!(!cell.modifier.contains(Modifier::REVERSED));

    let trip = terminal_of(tripped());
    let cell = &trip.backend().buffer()[(4, 3)];
    assert_eq!(
        (cell.symbol(), cell.fg, cell.bg),
        ("e", Color::White, Color::Red)
    );
}

#[test]
fn a_frozen_view_keeps_its_data_while_bars_and_trips_stay_live() {
    let mut model = model(running());
    model.frozen = Some(Arc::clone(&model.snapshot));
    let mut later = tripped();
    later.trace = Arc::default();
    model.update(Event::Snapshot(Arc::new(later)));
    let text = text(&model, 80, 24);
    assert!(
        text.contains("SAFETY TRIP") && text.contains("TRIPPED"),
        "{text}"
    );
    assert!(
        text.contains("FROZEN") && text.contains('⣀') && text.contains('⠉'),
        "{text}"
    );
}
