use std::sync::Arc;

use proptest::prelude::*;

use super::fixtures::{done, hardware, model, running, terminal, tripped, workflow};
use crate::bench::{Level, Notice, Snapshot, TracePoint};
use crate::sample::{ParameterEstimate, Verdict};
use crate::tui::live::WorkerState;
use crate::tui::live::model::{Event, Model, Page, ZOOM_S};

fn number() -> impl Strategy<Value = f64> {
    prop_oneof![
        4 => -300.0..300.0_f64,
        1 => any::<f64>(),
        1 => Just(f64::NAN),
        1 => Just(f64::INFINITY),
        1 => Just(f64::MAX),
        1 => Just(-f64::MAX),
        1 => Just(0.0),
    ]
}

fn point() -> impl Strategy<Value = TracePoint> {
    (number(), number(), number(), number(), number(), number()).prop_map(
        |(time_s, voltage_v, current_a, speed_rad_s, model_speed_rad_s, reference_rad_s)| {
            TracePoint {
                time_s,
                voltage_v,
                current_a,
                speed_rad_s,
                model_speed_rad_s,
                reference_rad_s,
            }
        },
    )
}

fn estimate() -> impl Strategy<Value = ParameterEstimate> {
    use Verdict::{Fixed, Invalid, NotObservable, Searching, Settled};
    let verdicts = vec![Settled, Searching, NotObservable, Invalid, Fixed];
    let (verdict, reason) = (prop::sample::select(verdicts), ".{0,80}");
    let figure = || prop::option::of(number());
    (
        ".{0,30}",
        figure(),
        figure(),
        verdict,
        prop::option::of(reason),
    )
        .prop_map(|(key, value, std, verdict, reason)| ParameterEstimate {
            key,
            value,
            std,
            unit: "kg.m2",
            verdict,
            reason,
        })
}

fn snapshot() -> impl Strategy<Value = Snapshot> {
    (
        prop::sample::select(vec![running(), tripped(), done(), hardware()]),
        (number(), number()),
        prop::collection::vec(point(), 0..60),
        any::<bool>(),
        prop::collection::vec(estimate(), 0..9),
        (".{0,90}", ".{0,90}", number()),
    )
        .prop_map(
            |(mut base, (elapsed, total), mut points, sorted, estimates, texts)| {
                if sorted {
                    points.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
                }
                base.elapsed_s = elapsed;
                base.total_s = total;
                base.trace = Arc::new(points);
                base.estimates = Arc::new(estimates);
                base.segment = Some(texts.0.clone());
                base.link = texts.1.clone();
                base.timing.rate_achieved_hz = texts.2;
                base.timing.lateness_p99_s = texts.2;
                base.notices.push(Notice {
                    level: Level::Error,
                    text: texts.0,
                });
                if let Some(trip) = &mut base.trip {
                    trip.reason = texts.1;
                }
                base
            },
        )
}

fn screens() -> impl Strategy<Value = (usize, bool, bool, usize, usize, Option<bool>, bool)> {
    (
        0..Page::ALL.len(),
        any::<bool>(),
        any::<bool>(),
        0..ZOOM_S.len(),
        0..200_usize,
        prop::option::of(any::<bool>()),
        any::<bool>(),
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn any_snapshot_can_be_drawn_at_any_size(
        snapshot in snapshot(),
        (screen, help, frozen, zoom, scroll, steps, finished) in screens(),
        width in 1..=200_u16,
        height in 1..=60_u16,
    ) {
        let mut model: Model = model(snapshot);
        if let Some(over) = steps {
            model.update(Event::Workflow(Arc::new(workflow(over))));
        }
        model.page = Page::ALL[screen];
        (model.help, model.zoom, model.scroll) = (help.then_some(0), zoom, scroll);
        if frozen {
            model.frozen = Some(Arc::clone(&model.snapshot));
        }
        if finished {
            model.update(Event::Worker(WorkerState::Finished));
        }
        let shown = terminal(&model, width, height).backend().to_string();
        if width >= 30 && height >= 6 {
            prop_assert!(shown.contains("Space = STOP"), "{shown}");
        }
    }
}

#[test]
fn every_small_width() {
    let mut model = model(tripped());
    model.update(Event::Workflow(Arc::new(workflow(true))));
    for page in Page::ALL {
        model.page = page;
        for width in (1..=40).chain([72, 110, 200]) {
            for height in [1, 2, 3, 5, 6, 7, 9, 12, 20, 60] {
                terminal(&model, width, height);
            }
        }
    }
}
