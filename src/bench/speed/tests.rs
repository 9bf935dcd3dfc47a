//! The loop in a session on the emulated drive, in virtual time: what is lost, what lies, what starts again.

use super::*;
use crate::bench::bench_file::BenchFile;
use crate::bench::guard::{Guard, TripKind};
use crate::bench::session::{Action, Input, Intent, Lost, Outcome, Phase, Session};
use crate::bench::testing::{Fault, ScriptedDrive};
use crate::control::Actuator;
use crate::drive::DriveLink;
use crate::emulator::{EmulatorConfig, FaultsConfig, Latency, MemoryLink, SoftDrive, VirtualClock};
use crate::plant::{Model, MotorKey};
use crate::sample::{Channel, Command, Demand, DriveState, Sample};

mod actuators;
mod monte_carlo;

const PERIOD_S: f64 = 0.01;

fn bench() -> BenchFile {
    BenchFile::embedded_default()
}

fn design<'a>(
    bench: &'a BenchFile,
    model: &'a Model,
    motor: &'a crate::bench::Nameplate,
    limits: &'a crate::bench::Limits,
    delay_cycles: f64,
) -> Design<'a> {
    Design {
        model,
        motor,
        limits,
        section: bench.speed.as_ref().unwrap(),
        actuator: bench
            .speed
            .as_ref()
            .unwrap()
            .actuator
            .unwrap_or(Actuator::Voltage),
        timing: timing(model, PERIOD_S, delay_cycles * PERIOD_S),
        noise_rad_s: 0.15,
        peak_reference_rad_s: 110.0,
    }
}

fn refusal(bench: &BenchFile, model: &Model, delay_cycles: f64) -> Option<RegulatorError> {
    let (motor, limits) = (bench.nameplate().unwrap(), bench.limits());
    design(bench, model, &motor, &limits, delay_cycles)
        .regulator()
        .err()
}

fn session(bench: &BenchFile) -> Session {
    session_on(bench, &Model::baseline(bench.motor.motor()))
}

fn session_on(bench: &BenchFile, model: &Model) -> Session {
    let motor = bench.nameplate().unwrap();
    let limits = bench.limits();
    let section = bench.speed.as_ref().unwrap();
    let regulator = design(bench, model, &motor, &limits, 1.0)
        .regulator()
        .unwrap();
    let settings = PilotSettings {
        slew_v_per_s: section.slew_v_per_s(&motor, &limits, PERIOD_S),
        silence_s: limits.link_silence_s,
        hold: 0.0,
    };
    let reference = bench.reference(section).unwrap();
    let pilot = SpeedPilot::new(regulator, reference, settings);
    Session::with_pilot(Box::new(pilot), Guard::new(limits, &motor, Some(11.4)))
}

/// A session on a link; `spoil` may change a sample or lose it, by the number of the exchange.
struct Lab<L, F> {
    session: Session,
    link: L,
    clock: VirtualClock,
    now_s: f64,
    exchanges: u64,
    spoil: F,
    sent: Vec<Command>,
    log: Vec<Action>,
}

impl<L: DriveLink, F: FnMut(u64, Sample) -> Option<Sample>> Lab<L, F> {
    fn feed(&mut self, input: Input) {
        let mut actions = Vec::new();
        self.session.step(self.now_s, input, &mut actions);
        for action in actions {
            self.log.push(action.clone());
            if let Action::Send(command) = action {
                self.sent.push(command);
                self.exchanges += 1;
                let sample = self.link.exchange(command).unwrap();
                let reply = match (self.spoil)(self.exchanges, sample) {
                    Some(sample) => Input::Sample(Box::new(sample)),
                    None => Input::Lost(Lost::Transient("spoilt".to_owned())),
                };
                self.feed(reply);
            }
        }
    }

    fn cycles(&mut self, cycles: u32) {
        for _ in 0..cycles {
            self.now_s += PERIOD_S;
            self.clock.set_time_s(self.now_s);
            self.feed(Input::Cycle);
        }
    }

    fn start(&mut self) {
        self.cycles(3);
        self.feed(Input::Intent(Intent::Start));
    }

    fn outcome(&self) -> Option<&Outcome> {
        self.log.iter().find_map(|action| match action {
            Action::Finished(outcome) => Some(outcome),
            _ => None,
        })
    }

    #[track_caller]
    fn trip(&self) -> (TripKind, String) {
        match self.outcome() {
            Some(Outcome::Tripped(trip)) => (trip.kind, trip.reason.clone()),
            other => panic!("{other:?}"),
        }
    }

    fn volts(&self) -> Vec<f64> {
        let volts = self.sent.iter().map(|command| match command.demand {
            Demand::Voltage(volts) => volts,
            _ => f64::NAN,
        });
        volts.collect()
    }

    /// What of a quantity was recorded.
    fn largest(&self, channel: Channel) -> f64 {
        let rows = self.log.iter().filter_map(|action| match action {
            Action::Row(sample) => sample.get(channel),
            _ => None,
        });
        rows.fold(0.0, |largest, value| value.abs().max(largest))
    }
}

fn lab<F: FnMut(u64, Sample) -> Option<Sample>>(
    faults: FaultsConfig,
    spoil: F,
) -> Lab<MemoryLink, F> {
    let mut config = EmulatorConfig::embedded("zk-22fc-plain").unwrap();
    config.faults = faults;
    config.tolerance = 0.0;
    lab_of(&config, 1, session(&bench()), spoil)
}

fn lab_of<F: FnMut(u64, Sample) -> Option<Sample>>(
    config: &EmulatorConfig,
    seed: u64,
    session: Session,
    spoil: F,
) -> Lab<MemoryLink, F> {
    let clock = VirtualClock::new();
    let drive = SoftDrive::new(config, seed);
    Lab {
        session,
        link: MemoryLink::new(drive, clock.clone(), Latency::default()),
        clock,
        now_s: 0.0,
        exchanges: 0,
        spoil,
        sent: Vec::new(),
        log: Vec::new(),
    }
}

#[expect(clippy::unnecessary_wraps, reason = "as the others, which lose some")]
fn healthy(_: u64, sample: Sample) -> Option<Sample> {
    Some(sample)
}

#[test]
fn a_healthy_loop_follows_its_steps_to_the_end() {
    let mut lab = lab(FaultsConfig::default(), healthy);
    lab.start();
    lab.cycles(1600);
    assert_eq!(lab.outcome(), Some(&Outcome::Done));
    let report = lab.session.report().unwrap();
    assert_eq!((report.controller, report.steps.len()), ("addc", 6));
    assert!((report.delay.unwrap().median_cycles - 1.0).abs() < 0.01);
    assert_eq!(report.held_cycles, 0);
    for step in &report.steps {
        let response = &step.response;
        assert!(response.overshoot_percent < 10.0, "{step:?}");
        assert!(response.settling_s.unwrap() < 0.6, "{step:?}");
    }
    // Current through the winding within the controller's limit, but for noise and what the speed does within a cycle.
    assert!(lab.largest(Channel::Current) < 11.0);
}

#[test]
fn a_lost_reply_holds_the_last_output_and_the_loop_goes_on() {
    let lost = 60..64;
    let mut lab = lab(FaultsConfig::default(), |n, sample| {
        (!lost.contains(&n)).then_some(sample)
    });
    lab.start();
    lab.cycles(55);
    lab.cycles(12);
    let volts = lab.volts();
    // The reply to command 60 is lost: commands 61 to 64 repeat it, 65 answers again.
    assert!(
        volts[60..64]
            .iter()
            .all(|held| held.to_bits() == volts[59].to_bits()),
        "{volts:?}"
    );
    assert_ne!(volts[64].to_bits(), volts[63].to_bits(), "{volts:?}");
    lab.cycles(1600);
    assert_eq!(lab.outcome(), Some(&Outcome::Done));
    assert_eq!(lab.session.report().unwrap().held_cycles, 4);
}

#[test]
fn silence_beyond_the_limit_stops() {
    let mut lab = lab(FaultsConfig::default(), |n, sample| {
        (n < 60).then_some(sample)
    });
    lab.start();
    lab.cycles(300);
    // 0.45 s of silence, then stop in every cycle.
    let stop = lab
        .sent
        .iter()
        .position(|command| command.demand == Demand::Stop)
        .unwrap();
    assert!((103..=107).contains(&stop), "{stop}");
    assert!(matches!(lab.outcome(), Some(Outcome::LinkLost { .. })));
}

#[test]
fn a_missing_speed_is_held_and_after_three_the_loop_stops() {
    let without_speed = |n: u64, from: u64, to: u64, mut sample: Sample| {
        if (from..to).contains(&n) {
            sample.set(Channel::Speed, f64::NAN);
        }
        Some(sample)
    };
    let mut two = lab(FaultsConfig::default(), |n, sample| {
        without_speed(n, 60, 62, sample)
    });
    two.start();
    two.cycles(80);
    let volts = two.volts();
    assert!(
        volts[60..62]
            .iter()
            .all(|held| held.to_bits() == volts[59].to_bits()),
        "{volts:?}"
    );
    assert!(
        volts
            .iter()
            .all(|volts| !volts.is_nan() || volts.is_nan() && two.outcome().is_none())
    );
    assert_eq!(two.session.phase(), Phase::Running);
    let mut three = lab(FaultsConfig::default(), |n, sample| {
        without_speed(n, 60, 99, sample)
    });
    three.start();
    three.cycles(80);
    assert_eq!(three.trip().0, TripKind::SignalMissing);
    let energised = three.sent[62..]
        .iter()
        .filter(|command| command.demand.energises());
    assert_eq!(energised.count(), 0, "three samples and no more");
}

#[test]
fn a_reversed_encoder_is_stopped_in_the_first_move() {
    let mut lab = lab(
        FaultsConfig {
            encoder_reversed: true,
            ..FaultsConfig::default()
        },
        healthy,
    );
    lab.start();
    lab.cycles(300);
    let (kind, reason) = lab.trip();
    assert_eq!(kind, TripKind::EncoderReversed, "{reason}");
    // It is at work from the first cycle on, so the drive is off within a tenth of a second and a few per cent of speed.
    assert!(lab.largest(Channel::Speed) < 0.05 * 340.0, "{reason}");
    let energised = lab.sent.iter().filter(|command| command.demand.energises());
    assert!(energised.count() < 30, "{reason}");
}

#[test]
fn a_frozen_encoder_is_stopped_wherever_it_freezes() {
    // At rest; during the start; at 110 rad/s just before the first step down.
    for (from_s, most_cycles) in [(0.0, 20), (0.15, 15), (1.9, 40)] {
        let mut lab = lab(
            FaultsConfig {
                encoder_frozen_from_s: Some(from_s),
                ..FaultsConfig::default()
            },
            healthy,
        );
        lab.start();
        lab.cycles(600);
        let (kind, reason) = lab.trip();
        assert_eq!(kind, TripKind::EncoderFrozen, "{from_s}: {reason}");
        let energised = lab.sent.iter().filter(|command| command.demand.energises());
        let after = energised.count() as f64 - from_s / PERIOD_S;
        assert!(
            after < f64::from(most_cycles),
            "{from_s}: {after} cycles, {reason}"
        );
    }
}

#[test]
fn a_loop_whose_signals_are_broken_under_way_is_stopped_with_the_signal_s_name() {
    // At the 150th exchange it follows 110 rad/s; the next step comes at 2 s.
    let spoilt = |change: fn(&mut Sample)| {
        let mut lab = lab(FaultsConfig::default(), move |n, mut sample| {
            if n >= 150 {
                change(&mut sample);
            }
            Some(sample)
        });
        lab.start();
        lab.cycles(400);
        let energised = lab.sent.iter().filter(|command| command.demand.energises());
        (lab.trip().0, energised.count())
    };
    let (kind, cycles) = spoilt(|sample| sample.set(Channel::Current, 0.0));
    assert!(
        kind == TripKind::CurrentStuck && cycles < 235,
        "{kind:?} {cycles}"
    );
    let (kind, cycles) = spoilt(|sample| {
        let speed = sample.get(Channel::Speed).unwrap();
        sample.set(Channel::Angle, f64::NAN);
        sample.set(Channel::Speed, 0.3 * speed);
    });
    assert!(
        kind == TripKind::SpeedImplausible && cycles < 172,
        "{kind:?} {cycles}"
    );
    let (kind, cycles) = spoilt(|sample| {
        let speed = sample.get(Channel::Speed).unwrap();
        sample.set(Channel::Angle, f64::NAN);
        sample.set(Channel::Speed, -speed);
    });
    // The loop reverses its voltage within a cycle: whether sign or scale is wrong may not be told from so few.
    let named = matches!(kind, TripKind::EncoderReversed | TripKind::SpeedImplausible);
    assert!(named && cycles < 172, "{kind:?} {cycles}");
    let (kind, cycles) = spoilt(|sample| {
        let (speed, current) = (sample.get(Channel::Speed), sample.get(Channel::Current));
        sample.set(Channel::Speed, current.unwrap());
        sample.set(Channel::Current, speed.unwrap());
    });
    assert!(
        kind == TripKind::SignalsSwapped && cycles < 172,
        "{kind:?} {cycles}"
    );
}

#[test]
fn a_second_start_begins_at_rest_with_nothing_of_the_first() {
    let mut lab = lab(FaultsConfig::default(), healthy);
    lab.start();
    lab.cycles(150);
    assert!(lab.largest(Channel::Speed) > 80.0);
    let first: Vec<f64> = lab.volts()[3..40].to_vec();
    lab.feed(Input::Intent(Intent::Stop));
    lab.cycles(300);
    assert_eq!(lab.outcome(), Some(&Outcome::Stopped));
    lab.feed(Input::Intent(Intent::Rearm));
    assert_eq!(lab.session.phase(), Phase::Safe);
    let before = lab.sent.len();
    lab.feed(Input::Intent(Intent::Start));
    let mut references = Vec::new();
    for _ in 0..40 {
        lab.cycles(1);
        if lab.session.phase() == Phase::Running {
            references.push(lab.session.reference_rad_s().unwrap());
        }
    }
    // The reference starts at the measured speed, and the output at what holds it: no integral of the first run.
    assert!(references[0].abs() < 1.0, "{references:?}");
    assert!((references[1] - 110.0).abs() < 1e-9);
    let again: Vec<f64> = lab.volts()[before..].to_vec();
    let begun = |volts: &[f64]| volts.iter().position(|volts| volts.abs() > 2.0).unwrap();
    let (one, two) = (begun(&first), begun(&again));
    for n in 0..15 {
        assert!(
            (first[one + n] - again[two + n]).abs() < 1.0,
            "{n}: {first:?} {again:?}"
        );
    }
}

#[test]
fn a_drive_that_never_echoes_a_command_is_still_regulated() {
    // The scripted drive has no physics that the encoder watch could believe, but it is quick and obeys.
    let drive = ScriptedDrive::new(PERIOD_S).with(0, 0, Fault::Timeout);
    let mut lab = Lab {
        session: session(&bench()),
        link: drive,
        clock: VirtualClock::new(),
        now_s: 0.0,
        exchanges: 0,
        spoil: |_, mut sample: Sample| {
            sample.applied = None;
            sample.seq = None;
            Some(sample)
        },
        sent: Vec::new(),
        log: Vec::new(),
    };
    lab.start();
    lab.cycles(150);
    assert_eq!(lab.session.phase(), Phase::Running, "{:?}", lab.outcome());
    assert_eq!(lab.session.report().unwrap().delay, None);
    let last = lab.session.last_sample().unwrap();
    assert_eq!(last.state, Some(DriveState::Running));
    assert!(
        (last.get(Channel::Speed).unwrap() - 110.0).abs() < 3.0,
        "{last:?}"
    );
}

#[test]
fn models_that_would_not_be_stable_are_refused_by_name() {
    let bench = bench();
    let baseline = || Model::baseline(bench.motor.motor());
    assert!(refusal(&bench, &baseline(), 1.0).is_none());
    for (key, value, expected) in [
        (
            MotorKey::Inertia,
            -0.004,
            "inertia_kg_m2 = -0.004 is not physical",
        ),
        (
            MotorKey::Inertia,
            f64::NAN,
            "inertia_kg_m2 = NaN is not physical",
        ),
        (
            MotorKey::Resistance,
            0.0,
            "resistance_ohm = 0 is not physical",
        ),
        (
            MotorKey::Resistance,
            2.3,
            "resistance_ohm = 2.3 is that of another motor (expected 0.6875 to 1.7600",
        ),
        (
            MotorKey::BackEmf,
            0.2,
            "back_emf_v_s_per_rad = 0.2 is that of another motor",
        ),
    ] {
        let mut model = baseline();
        model.motor.set(key, value);
        let error = refusal(&bench, &model, 1.0).unwrap();
        assert!(error.to_string().contains(expected), "{error}");
        assert!(!error.help().is_empty());
    }
    let mut other = baseline();
    other.motor.name = "another".to_owned();
    let error = refusal(&bench, &other, 1.0).unwrap().to_string();
    assert!(
        error.contains("\"another\"") && error.contains("ZK-22FC"),
        "{error}"
    );
    let mut short = baseline();
    short.motor.clear(MotorKey::Inductance);
    let error = refusal(&bench, &short, 1.0).unwrap().to_string();
    assert!(error.contains("inductance_h is missing"), "{error}");
}

#[test]
fn gains_by_hand_are_held_within_what_the_delay_leaves() {
    let mut bench = bench();
    let model = Model::baseline(bench.motor.motor());
    let mut with = |controller, proportional, integral_time_s, cycles| {
        let section = bench.speed.as_mut().unwrap();
        section.controller = controller;
        section.gains = Some(GainsSection {
            proportional_v_s_per_rad: proportional,
            integral_time_s,
        });
        refusal(&bench, &model, cycles).map(|error| error.to_string())
    };
    let pi = ControllerKind::Pi;
    assert_eq!(with(pi, 0.25, 0.04, 1.0), None);
    // What one cycle of delay bears five do not.
    let error = with(pi, 0.25, 0.04, 5.0).unwrap();
    assert!(error.contains("proportional_v_s_per_rad = 0.25"), "{error}");
    let error = with(pi, 5.0, 0.04, 1.0).unwrap();
    assert!(
        error.contains("= 5 is not allowed (expected up to"),
        "{error}"
    );
    let error = with(ControllerKind::Addc, 0.25, 0.04, 1.0).unwrap();
    assert!(error.contains("\"pi\" over a voltage only"), "{error}");
}

#[test]
fn a_bandwidth_that_the_link_cannot_carry_is_refused_with_the_one_that_it_can() {
    let mut bench = bench();
    let model = Model::baseline(bench.motor.motor());
    bench.speed.as_mut().unwrap().bandwidth_rad_s = Some(500.0);
    let error = refusal(&bench, &model, 2.0).unwrap().to_string();
    assert!(
        error.contains("bandwidth 500") && error.contains("reachable"),
        "{error}"
    );
}

#[test]
fn every_controller_can_be_made_or_says_why_not() {
    let mut bench = bench();
    let model = Model::baseline(bench.motor.motor().with(MotorKey::Inertia, 0.02276));
    bench.motor.inertia_kg_m2 = Some(0.02276);
    for kind in ControllerKind::ALL {
        bench.speed.as_mut().unwrap().controller = kind;
        let error = refusal(&bench, &model, 1.0);
        assert!(error.is_none(), "{}: {error:?}", kind.id());
    }
    // Paper B knows of no delay: with four cycles its loop swings, which is seen before the motor does.
    bench.speed.as_mut().unwrap().controller = ControllerKind::PaperB;
    let error = refusal(&bench, &model, 4.0).unwrap().to_string();
    assert!(error.contains("paper-b: with 4.00 cycles"), "{error}");
}
