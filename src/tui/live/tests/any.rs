//! Any snapshot on any screen, at any size.

use super::*;

fn point() -> impl Strategy<Value = TracePoint> {
    prop::array::uniform6(number()).prop_map(|of| TracePoint {
        time_s: of[0],
        voltage_v: of[1],
        current_a: of[2],
        speed_rad_s: of[3],
        model_speed_rad_s: of[4],
        reference_rad_s: of[5],
        command_v: of[1],
        applied_s: of[0],
    })
}

fn estimate() -> impl Strategy<Value = ParameterEstimate> {
    use Verdict::{Fixed, Invalid, NotObservable, Searching, Settled};
    let verdicts = vec![Settled, Searching, NotObservable, Invalid, Fixed];
    let figure = || prop::option::of(number());
    let reason = prop::option::of(".{0,80}");
    let verdict = prop::sample::select(verdicts);
    (".{0,30}", figure(), figure(), verdict, reason).prop_map(|found| ParameterEstimate {
        key: found.0,
        value: found.1,
        std: found.2,
        unit: "kg.m2",
        verdict: found.3,
        reason: found.4,
        code: None,
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
        .prop_map(|(mut base, (elapsed, total), mut points, sorted, estimates, texts)| {
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
            base.notices.push(Notice { level: Level::Error, text: texts.0 });
            if let Some(trip) = &mut base.trip {
                trip.reason = texts.1;
            }
            base
        })
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
        if frozen {
            press(&mut model, Press::Freeze);
        }
        if let Some(over) = steps {
            report(&mut model, over);
        }
        model.page = Page::ALL[screen];
        (model.help.first, model.zoom, model.scroll) = (help.then_some(0), zoom, scroll);
        if finished {
            finish(&mut model);
        }
        let shown = terminal(&model, width, height).backend().to_string();
        if width >= 30 && height >= 6 {
            let label = match (finished, &model.snapshot.stop_error) {
                (false, _) => "Space = STOP",
                (true, None) => "output off",
                (true, Some(_)) => "Stop NOT confirmed",
            };
            prop_assert!(shown.contains(label), "{shown}");
        }
    }
}

#[test]
fn every_small_width() {
    let mut model = model(tripped());
    report(&mut model, true);
    for page in Page::ALL {
        model.page = page;
        for (width, height) in testing::sizes() {
            terminal(&model, width, height);
        }
    }
}
