//! What the paper says of its adaptive loop, as figures that can fail.

use std::sync::OnceLock;

use super::*;
use crate::workflow::reproduce::loops::{Case, Kind, Step};

/// Computed once for the tests that read it.
fn figure_7() -> &'static Figure7 {
    static FOUND: OnceLock<Figure7> = OnceLock::new();
    FOUND.get_or_init(|| figure_7::figure_7(&bench()))
}

#[test]
fn figure_5_the_response_gets_better_when_the_adaptation_joins() {
    let figure = steps::figure_5(&bench());
    let worst = |steps: &[Step]| {
        let overshoots = steps.iter().map(|step| step.response.overshoot_percent);
        overshoots.fold(0.0, f64::max)
    };
    let mut adapted = figure.after[1..].iter();
    assert!(worst(&figure.before) > 25.0);
    assert!(worst(&figure.after[1..]) < 10.0);
    assert!(adapted.all(|step| step.response.settling_s.is_some()));
}

#[test]
fn figure_6_the_fixed_gains_deteriorate_as_the_paper_shows_and_the_adaptive_ones_do_not() {
    let figure = steps::figure_6(&bench());
    for row in figure.adapted(1) {
        let overshoot = row.fixed.response.overshoot_percent;
        assert!((25.0..55.0).contains(&overshoot), "{overshoot}");
        assert_eq!(row.fixed.response.settling_s, None, "{row:?}");
    }
    for row in figure.adapted(1).chain(figure.adapted(2)) {
        let response = row.adaptive.response;
        let settles = response
            .settling_s
            .is_some_and(|s| s <= row.allowed_settling_s);
        assert!(response.overshoot_percent < 10.0 && settles, "{row:?}");
        let error = row.estimate_s / row.mechanical_s - 1.0;
        assert!(error.abs() < 0.1, "{row:?}");
    }
}

#[test]
fn figure_7_mrac_fails_in_saturation_where_it_stays_connected() {
    let figure = figure_7();
    let end = |kind| figure.saturated_of(kind).unwrap().end_error_rad_s();
    assert!(end(Kind::MracConnected) > 20.0);
    assert!(end(Kind::MracDisconnected) < 5.0);
    assert!(end(Kind::Addc) < 1.0);
}

#[test]
fn figure_7_who_adapts_sooner_is_measured_out_of_saturation() {
    let figure = figure_7();
    let [slower, forgetting] = figure.addc_slower;
    assert_eq!((slower.by_end, forgetting.by_end), (0, 0));
    assert!(slower.jumps >= 4, "{slower:?}");
    for [addc, forgets, mrac] in figure.fair() {
        assert!(addc.adapted_error_s < addc.error_s, "{addc:?}");
        assert!(addc.adapted_after_s.is_some_and(|s| s < 2.0), "{addc:?}");
        // As the paper says where the inertia falls; not where it rises.
        let falls = addc.mechanical_s < MECHANICAL_S[0];
        assert_eq!(addc.error_s > mrac.error_s, falls, "{addc:?} {mrac:?}");
        assert_eq!(forgets.error_s > addc.error_s, falls, "{forgets:?}");
        // In steps this small MRAC does not come where it would be if it were adapted.
        assert!(mrac.adapted_after_s.is_none(), "{mrac:?}");
    }
    assert_eq!(figure.shown.len(), 3);
}

#[test]
fn every_regulator_is_in_the_table_in_every_case() {
    let found = comparison(&bench(), &SIZES);
    assert_eq!(found.rows.len(), Case::ALL.len() * Kind::ALL.len());
    let row = |kind, case| found.row(kind, case).unwrap();
    let overshoot = |kind, case| row(kind, case).overshoot_percent.unwrap();
    for case in [Case::Nominal, Case::Lighter, Case::Heavier] {
        assert!(overshoot(Kind::Addc, case) < 10.0, "{case:?}");
    }
    // Everything that does not adapt was made for four times this inertia.
    for kind in [Kind::Pi, Kind::PaperB, Kind::LoadObserver] {
        assert!(overshoot(kind, Case::Lighter) > 25.0, "{kind:?}");
    }
    assert_eq!(row(Kind::MracConnected, Case::Start).settling_s, Some(None));
    // The load observer knows the load, the others see only the speed that it takes.
    let dip = |kind| row(kind, Case::Load).dip_rad_s.unwrap();
    let others = [Kind::Pi, Kind::Addc, Kind::MracDisconnected, Kind::PaperB];
    assert!(
        others
            .into_iter()
            .all(|kind| dip(kind) > dip(Kind::LoadObserver))
    );
}
