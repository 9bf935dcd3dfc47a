//! The loop over a current and over a speed command, and with the model's effects given forward.

use super::*;
use crate::emulator::EmulatorConfig;

fn over(actuator: Actuator, change: impl FnOnce(&mut SpeedSection)) -> BenchFile {
    let mut bench = bench();
    let section = bench.speed.as_mut().unwrap();
    section.actuator = Some(actuator);
    section.rule = None;
    change(section);
    bench
}

fn plain() -> EmulatorConfig {
    let mut config = EmulatorConfig::embedded("zk-22fc-plain").unwrap();
    config.tolerance = 0.0;
    config
}

fn followed(config: &EmulatorConfig, bench: &BenchFile, model: &Model, cycles: u32) -> SpeedReport {
    let mut lab = lab_of(config, 1, session_on(bench, model), healthy);
    lab.start();
    lab.cycles(cycles);
    assert_eq!(lab.outcome(), Some(&Outcome::Done));
    assert!(lab.largest(Channel::Current) < 13.0);
    lab.session.report().unwrap()
}

#[test]
fn a_drive_that_takes_a_current_is_regulated_and_its_inertia_is_followed() {
    for controller in [ControllerKind::Pi, ControllerKind::Addc] {
        let bench = over(Actuator::Current, |section| section.controller = controller);
        let model = Model::baseline(bench.motor.motor());
        let report = followed(&plain(), &bench, &model, 1800);
        assert_eq!(report.actuator, Actuator::Current);
        assert_eq!(report.steps.len(), 6);
        for step in &report.steps[1..] {
            assert!(step.response.overshoot_percent < 10.0, "{step:?}");
            assert!(
                step.response
                    .settling_s
                    .is_some_and(|seconds| seconds < 0.8),
                "{step:?}"
            );
        }
    }
}

#[test]
fn a_drive_that_takes_a_speed_is_trimmed_from_outside() {
    let bench = over(Actuator::Speed, |section| {
        section.controller = ControllerKind::Pi;
        section.drive_lag_s = Some(0.06);
    });
    let model = Model::baseline(bench.motor.motor());
    let report = followed(&plain(), &bench, &model, 1800);
    assert_eq!((report.actuator, report.steps.len()), (Actuator::Speed, 6));
    for step in &report.steps[1..] {
        assert!(step.response.overshoot_percent < 15.0, "{step:?}");
        assert!(
            step.response
                .settling_s
                .is_some_and(|seconds| seconds < 1.0),
            "{step:?}"
        );
    }
}

#[test]
fn what_an_actuator_does_not_allow_is_refused_by_name() {
    let refused = |bench: &BenchFile| {
        let model = Model::baseline(bench.motor.motor());
        let error = refusal(bench, &model, 1.0).unwrap();
        assert!(!error.help().is_empty());
        error.to_string()
    };
    let no_lag = over(Actuator::Speed, |section| {
        section.controller = ControllerKind::Pi;
    });
    assert!(refused(&no_lag).contains("speed.drive_lag_s is missing"));
    let adaptive = over(Actuator::Speed, |section| section.drive_lag_s = Some(0.05));
    assert!(
        refused(&adaptive)
            .contains("\"addc\" does not act with a speed (expected one of voltage, current)")
    );
    let paper = over(Actuator::Current, |section| {
        section.controller = ControllerKind::PaperB;
    });
    assert!(refused(&paper).contains("\"paper-b\" does not act with a current"));
    let forward = over(Actuator::Speed, |section| {
        section.controller = ControllerKind::Pi;
        section.drive_lag_s = Some(0.05);
        section.feed_forward = ForwardUse::On;
    });
    assert!(refused(&forward).contains("nothing can be given forward with a speed command"));
}

#[test]
fn what_the_model_knows_given_forward_lowers_the_tracking_error() {
    let mut config = EmulatorConfig::embedded("zk-22fc-fan").unwrap();
    config.tolerance = 0.0;
    let fan = config.hidden[0].parameters()[0].1;
    for actuator in [Actuator::Voltage, Actuator::Current] {
        let bench = over(actuator, |section| {
            section.controller = ControllerKind::Pi;
            section.feed_forward = ForwardUse::Compare;
            section.reference = vec![ReferencePart::Polyline {
                points: vec![[0.0, 20.0], [2.0, -20.0], [4.0, 20.0], [6.0, -20.0]],
            }];
        });
        let mut model = Model::baseline(bench.motor.motor())
            .with_effect("quadratic_load")
            .unwrap();
        model.effects[0].values = vec![Some(fan)];
        let report = followed(&config, &bench, &model, 2200);
        let [without, with] = report.tracking.as_slice() else {
            panic!("{:?}", report.tracking);
        };
        assert!(!without.feed_forward && with.feed_forward);
        // What is left is the lag behind the ramp.
        let falls =
            with.rms_rad_s < 0.8 * without.rms_rad_s && with.peak_rad_s < 0.6 * without.peak_rad_s;
        assert!(falls, "{actuator:?}: {without:?} {with:?}");
    }
}

#[test]
fn behind_a_current_command_a_broken_encoder_is_stopped_too() {
    for frozen in [false, true] {
        let bench = over(Actuator::Current, |section| {
            section.controller = ControllerKind::Pi;
        });
        let model = Model::baseline(bench.motor.motor());
        let mut config = plain();
        config.faults.encoder_reversed = !frozen;
        config.faults.encoder_frozen_from_s = frozen.then_some(1.0);
        let mut lab = lab_of(&config, 1, session_on(&bench, &model), healthy);
        lab.start();
        lab.cycles(1800);
        let (kind, reason) = lab.trip();
        assert!(lab.largest(Channel::Speed) < 340.0);
        assert_eq!(kind == TripKind::EncoderFrozen, frozen, "{reason}");
    }
}
