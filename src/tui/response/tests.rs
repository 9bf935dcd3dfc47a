//! The page on a fixed response, its keys, and any size.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use super::*;
use crate::tui::screens::Page;
use crate::tui::testing;
use drivebench_identify::frequency_response::{
    Departure, FrequencyResponse, Mode, ModeKind, ResponsePoint,
};

/// A shaft with a second inertia: 15.6 Hz against the held motor, 22 Hz against each other; carried from 0.5 to 60 Hz.
fn points(has_coupling: bool, at: Pathway) -> Vec<ResponsePoint> {
    let count = 240;
    let point = |k: i32| {
        let frequency_hz = 0.2 * 10.0_f64.powf(f64::from(k) / 80.0);
        let swings = |hertz: f64, damping: f64| {
            let x = frequency_hz / hertz;
            (1.0 - x * x).hypot(2.0 * damping * x)
        };
        let coupling = if has_coupling { swings(15.6, 0.02) / swings(22.0, 0.02) } else { 1.0 };
        let rolls = (frequency_hz / 4.0).hypot(1.0);
        let magnitude = match at {
            Pathway::VoltageToSpeed => 2.8 * coupling / rolls,
            Pathway::VoltageToCurrent => 0.5 * rolls,
            Pathway::CurrentToSpeed => 12.5 * coupling / frequency_hz,
        };
        let is_carried = (0.5..60.0).contains(&frequency_hz);
        let half = if is_carried { 0.04 } else { 0.6 };
        ResponsePoint {
            frequency_hz,
            magnitude,
            magnitude_low: magnitude * f64::exp(-half),
            magnitude_high: magnitude * f64::exp(half),
            phase_deg: -90.0 * frequency_hz / (frequency_hz + 4.0),
            phase_half_width_deg: half.to_degrees(),
            coherence: if is_carried { 0.97 } else { 0.2 },
            is_carried,
        }
    };
    (0..count).map(point).collect()
}

fn response(has_coupling: bool) -> FrequencyResponse {
    let pathways = Pathway::ALL.map(|pathway| PathwayResponse {
        pathway,
        unit: pathway.unit(),
        points: points(has_coupling, pathway),
    });
    let mode = |kind, frequency_hz| Mode {
        kind,
        pathway: Pathway::CurrentToSpeed,
        frequency_hz,
        frequency_std_hz: 0.02,
        damping_ratio: 0.0201,
        damping_std: 0.0004,
    };
    let modes = [mode(ModeKind::AntiResonance, 15.6), mode(ModeKind::Resonance, 22.01)];
    FrequencyResponse {
        pathways: pathways.into(),
        modes: if has_coupling { modes.into() } else { Vec::new() },
        lowest_hz: 0.2,
        highest_hz: 150.0,
        sampling_hz: 500.0,
        used_s: 31.8,
        stretches: 1,
        cautions: Vec::new(),
    }
}

pub(in crate::tui) fn compared() -> Compared {
    Compared {
        measured: response(true),
        model: Some(response(false)),
        departures: vec![Departure {
            pathway: Pathway::CurrentToSpeed,
            from_hz: 11.2,
            to_hz: 41.8,
            at_hz: 22.4,
            magnitude_db: -27.7,
            phase_deg: -104.0,
        }],
    }
}

fn screen(compared: Compared) -> ResponseScreen {
    let title = "run-a; model: model.toml".to_owned();
    ResponseScreen::new(title, compared, None, Arc::new(AtomicBool::new(false)))
}

fn pressed(mut screen: ResponseScreen, presses: &[Press]) -> ResponseScreen {
    for press in presses {
        assert_eq!(screen.press(*press), None, "{press:?}");
    }
    screen
}

fn text(screen: &ResponseScreen, size: (u16, u16)) -> String {
    testing::terminal(size, |frame| screen.draw(frame)).backend().to_string()
}

/// Measurement alone, without a carried point.
fn nothing_carried() -> Compared {
    let mut compared = compared();
    let measured = &mut compared.measured;
    let points = measured.pathways.iter_mut().flat_map(|own| &mut own.points);
    points.for_each(|point| point.is_carried = false);
    measured.modes.clear();
    measured.cautions = vec!["no frequency has a coherence of 0.8".to_owned()];
    (compared.model, compared.departures) = (None, Vec::new());
    compared
}

pub(in crate::tui) fn pages() -> Vec<Page> {
    let page = |name, screen: ResponseScreen| -> Page {
        (name, Box::new(move |frame| screen.draw(frame)))
    };
    let cursor = [Press::Cursor(1); 40];
    vec![
        page("mechanics", screen(compared())),
        page("cursor", pressed(pressed(screen(compared()), &[Press::NextScreen]), &cursor)),
        page("nothing", screen(nothing_carried())),
        page("help", pressed(screen(compared()), &[Press::Help])),
    ]
}

#[test]
fn tab_goes_through_the_pathways_and_the_cursor_stays() {
    let size = (100, 30);
    let shown = |screen: &ResponseScreen| text(screen, size);
    let mut screen = screen(compared());
    assert!(shown(&screen).contains("current to speed"));
    for name in ["voltage to speed", "voltage to current", "current to speed"] {
        assert_eq!(screen.press(Press::NextScreen), None);
        assert!(shown(&screen).contains(name), "{name}");
    }
    for _ in 0..1000 {
        assert_eq!(screen.press(Press::Cursor(1)), None);
    }
    assert!(shown(&screen).contains("not carried"));
    // The first removes the cursor, the second closes the screen.
    assert_eq!(screen.press(Press::Stop), None);
    assert_eq!(screen.press(Press::Stop), Some(Exit::Finished));
    assert_eq!(screen.press(Press::Quit), Some(Exit::Finished));
    assert_eq!(screen.press(Press::Interrupt), Some(Exit::Interrupted));
}

#[test]
fn no_size_and_no_hole_in_the_data_is_too_much() {
    let mut holed = compared();
    for own in &mut holed.measured.pathways {
        own.points.truncate(1);
        own.points[0].magnitude = 0.0;
        own.points[0].phase_deg = f64::NAN;
    }
    let mut empty = compared();
    empty.measured.pathways.clear();
    for compared in [compared(), nothing_carried(), holed, empty] {
        let screen = pressed(screen(compared), &[]);
        for size in testing::sizes() {
            text(&screen, size);
        }
    }
}
