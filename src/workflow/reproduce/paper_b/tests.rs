//! What paper B says of its regulator, as figures that can fail.

use super::noise::Disturbance;
use super::*;
use crate::workflow::reproduce::loops::{Case, Kind};

#[test]
fn figure_4_the_compensation_takes_the_error_that_friction_leaves() {
    let figure = figures::figure_4(&bench());
    let [without, with] = &figure.courses;
    assert!(without.flat_mean_rad_s > 0.5);
    assert!(with.flat_mean_rad_s.abs() < 0.1 * without.flat_mean_rad_s);
    assert!(with.absolute_error_rad < 0.7 * without.absolute_error_rad);
}

#[test]
fn figure_5_the_compensation_takes_a_load_that_the_feedback_alone_leaves() {
    let figure = figures::figure_5(&bench());
    let [without, with] = &figure.courses;
    assert!(without.applied.lasting_rad_s > 1.0 && without.applied.recovery_s.is_none());
    assert!(
        with.applied.lasting_rad_s.abs() < 0.1 && with.applied.recovery_s.is_some_and(|s| s < 0.3)
    );
    assert!(with.removed.recovery_s.is_some_and(|s| s < 0.3));
}

#[test]
fn the_gains_stop_within_some_dozen_iterations_and_k3_alone_swings() {
    let design = design::design(&bench());
    for stop in &design.stops {
        assert!(
            stop.filter_iterations <= 100 && stop.feedback_iterations <= 120,
            "{stop:?}"
        );
    }
    assert!(design.radius < 1.0);
    let quiet: Vec<f64> = design.ratios.iter().map(|row| row.effort_v).collect();
    assert!(quiet.is_sorted(), "{quiet:?}");
    let left: Vec<f64> = design.ratios.iter().map(|row| -row.lasting_rad_s).collect();
    assert!(left.is_sorted() && left[0] < 4.0 * left[6], "{left:?}");
    // Share 1 of K3, mu = 0.1: swings; ours does not.
    assert!(design.radii.damping[0][2] < 0.15 && design.radii.damping[3][3] > 0.9);
}

#[test]
fn the_compensation_takes_slow_loads_and_pays_with_white_noise() {
    let found = noise::noise(&bench());
    let of = |disturbance| found.of(disturbance).unwrap().speed_variance;
    let [without, with] = of(Disturbance::Load);
    assert!(with < 0.5 * without);
    let [without, with] = of(Disturbance::Sensor);
    assert!(with > without);
}

#[test]
fn edges_that_come_seldom_make_the_loop_swing() {
    let found = hall::hall(&bench());
    for row in &found.speeds {
        assert!(row.std_rad_s[0] < 1e-3, "{row:?}");
    }
    // More than 50 periods from edge to edge; some five.
    let [slowest, .., fast, _] = &found.speeds[..] else {
        panic!("{:?}", found.speeds)
    };
    assert!(slowest.std_rad_s[1] > 0.1 * slowest.speed_rad_s);
    assert!(fast.std_rad_s[1] < 0.01 * fast.speed_rad_s);
}

#[test]
fn the_back_emf_that_the_paper_leaves_out_is_an_error_that_stays() {
    let found = back_emf::back_emf(&bench());
    for row in &found.closed {
        let bare = row.full_motor && !row.compensated && !row.fed_forward;
        assert_eq!(row.lasting_rad_s > 5.0, bare, "{row:?}");
        assert!(bare || row.lasting_rad_s.abs() < 0.01, "{row:?}");
    }
    let [paper, full] = found.open_end_rad_s;
    assert!(paper > 3.0 * full && found.apart_after_s.is_some_and(|s| s < 0.05));
}

#[test]
fn every_regulator_is_in_the_table_in_every_case() {
    let found = comparison(&bench(), &SIZES);
    assert_eq!(found.rows.len(), Case::ALL.len() * Kind::ALL.len());
    let row = |kind, case| found.row(kind, case).unwrap();
    for case in [Case::Lighter, Case::Heavier] {
        let addc = row(Kind::Addc, case);
        assert!(addc.overshoot_percent.unwrap() < 10.0, "{addc:?}");
    }
    for kind in Kind::ALL {
        let load = row(kind, Case::Load);
        assert!(load.recovery_s.flatten().is_some(), "{load:?}");
    }
}
