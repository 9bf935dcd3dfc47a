//! The escalation against the software drive, in virtual time. The drive's own current limit is set far away: nothing but
//! the escalation keeps the current down.

use std::sync::atomic::AtomicBool;
use std::sync::mpsc::channel;

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::bench::describe::layout;
use crate::bench::runner::{Bench, RunOptions, run};
use crate::bench::session::Outcome as RunOutcome;
use crate::bench::snapshot::{SnapshotCell, Target};
use crate::emulator::{EmulatorConfig, Latency, MemoryLink, SoftDrive, VirtualClock};
use crate::identification::escalation::{Ending, Escalation, Outcome};
use crate::plant::MotorKey;
use crate::recording::MemoryRecorder;
use crate::sample::{Run, Verdict};

/// A link that looks at the true current and speed ten thousand times a second, as no host could.
struct Watched {
    link: MemoryLink,
    clock: VirtualClock,
    peak_a: f64,
    peak_rad_s: f64,
}

/// What one escalation did.
struct Done {
    escalation: Escalation,
    outcomes: Vec<RunOutcome>,
    peak_a: f64,
    peak_rad_s: f64,
}

const SIGNALS: [Channel; 3] = [Channel::Voltage, Channel::Current, Channel::Speed];

mod watched {
    use super::Watched;
    use crate::drive::{DriveLink, Identity, LinkError, LinkName, LinkStatistics};
    use crate::sample::{Command, Sample};

    impl DriveLink for Watched {
        fn name(&self) -> LinkName {
            self.link.name()
        }
        fn identify(&mut self) -> Result<Identity, LinkError> {
            self.link.identify()
        }
        fn exchange(&mut self, command: Command) -> Result<Sample, LinkError> {
            // The time since the last exchange, in tenths of a millisecond: the drive holds the last command meanwhile.
            let until_s = self.clock.time_s();
            let mut at_s = self.link.drive().time_s();
            while at_s < until_s {
                at_s += 1e-4;
                self.link.advance_to(at_s);
                let plant = self.link.drive().plant();
                self.peak_a = self.peak_a.max(plant.current_a().abs());
                self.peak_rad_s = self.peak_rad_s.max(plant.speed_rad_s().abs());
            }
            self.link.exchange(command)
        }
        fn stop(&mut self) -> Result<(), LinkError> {
            self.link.stop()
        }
        fn statistics(&self) -> LinkStatistics {
            self.link.statistics()
        }
        fn shortest_cycle_s(&self) -> Option<f64> {
            None
        }
    }
}

fn escalated(bench: &BenchFile, config: &EmulatorConfig, seed: u64) -> Done {
    let mut clock = VirtualClock::new();
    let mut watched = Watched {
        link: MemoryLink::new(
            SoftDrive::new(config, seed),
            clock.clone(),
            Latency::default(),
        ),
        clock: clock.clone(),
        peak_a: 0.0,
        peak_rad_s: 0.0,
    };
    let mut escalation = Escalation::new(bounds(bench));
    let mut outcomes = Vec::new();
    let (_keep, intents) = channel();
    let mut seq = 0;
    while let Some(stage) = escalation.stage() {
        let session = stage_session(bench, stage)
            .unwrap_or_else(|error| {
                panic!("seed {seed}: {error}: {stage:?} {:?}", escalation.history())
            })
            .after_seq(seq);
        let mut recorder = MemoryRecorder::new(layout(&SIGNALS));
        let summary = run(
            session,
            Bench {
                link: &mut watched,
                clock: &mut clock,
                recorder: &mut recorder,
                estimator: None,
                intents: &intents,
                interrupted: &AtomicBool::new(false),
                snapshots: &SnapshotCell::default(),
            },
            &RunOptions {
                name: "stage".to_owned(),
                target: Target::Sim,
                rate_hz: bench.link.rate_hz,
                motor: None,
                auto_start: true,
            },
        );
        seq = summary.link.sent + 1;
        recorder.finish();
        let ended = summary.outcome == RunOutcome::Done;
        outcomes.push(summary.outcome);
        if !ended {
            break;
        }
        let recorded: Run = recorder.run("stage").unwrap();
        escalation.learn(&recorded).unwrap();
    }
    Done {
        escalation,
        outcomes,
        peak_a: watched.peak_a,
        peak_rad_s: watched.peak_rad_s,
    }
}

fn named(emulator: &str) -> Done {
    let bench = unknown_bench();
    escalated(&bench, &EmulatorConfig::embedded(emulator).unwrap(), 3)
}

/// The embedded bench without a word about the motor but its rated values.
fn unknown_bench() -> BenchFile {
    let mut bench = BenchFile::embedded_default();
    bench.motor.unknown = true;
    for value in [
        &mut bench.motor.resistance_ohm,
        &mut bench.motor.inductance_h,
        &mut bench.motor.back_emf_v_s_per_rad,
        &mut bench.motor.inertia_kg_m2,
        &mut bench.motor.load_torque_n_m,
    ] {
        *value = None;
    }
    bench
}

fn report(done: &Done) -> String {
    use std::fmt::Write as _;
    let mut text = String::new();
    for (stage, outcome) in done.escalation.history().iter().zip(&done.outcomes) {
        let _ = writeln!(
            text,
            "{:>10} {:>8.3} V: {} [{}]",
            stage.kind.name(),
            stage.peak_v,
            stage.line,
            outcome.name()
        );
    }
    let _ = writeln!(text, "outcomes {:?}", done.outcomes.last());
    let _ = writeln!(
        text,
        "peaks {:.3} A {:.2} rad/s; {:?}",
        done.peak_a,
        done.peak_rad_s,
        done.escalation.outcome()
    );
    text
}

#[test]
fn a_locked_rotor_and_an_open_phase_are_named_with_their_numbers() {
    let done = named("zk-22fc-locked");
    let Some(Outcome::Named(ending @ Ending::LockedRotor { current_a, .. })) =
        done.escalation.outcome()
    else {
        panic!("{}", report(&done));
    };
    assert!(
        (0.85 * 5.7..1.3 * 5.7).contains(current_a),
        "{}",
        report(&done)
    );
    assert!(
        ending.sentence().starts_with("locked rotor"),
        "{}",
        ending.sentence()
    );
    assert!(done.peak_a < 1.3 * 5.7, "{}", report(&done));

    let done = named("zk-22fc-open");
    let Some(Outcome::Named(
        ending @ Ending::OpenPhase {
            voltage_v, below_a, ..
        },
    )) = done.escalation.outcome()
    else {
        panic!("{}", report(&done));
    };
    assert!(
        (*voltage_v - 27.5).abs() < 0.1 && *below_a < 0.2,
        "{}",
        ending.sentence()
    );
    assert!(
        done.outcomes
            .iter()
            .all(|outcome| *outcome == RunOutcome::Done)
    );
}

#[test]
fn the_motor_behind_the_plate_is_found_whatever_the_plate_says() {
    let emulators = [
        "zk-22fc-plain",
        "small-servo-behind-zk-22fc",
        "large-motor-behind-zk-22fc",
    ];
    for (name, seed) in emulators
        .into_iter()
        .flat_map(|name| [1, 2, 3].map(|seed| (name, seed)))
    {
        let config = EmulatorConfig::embedded(name).unwrap();
        let done = escalated(&unknown_bench(), &config, seed);
        let truth = config.motor.specimen(config.tolerance, seed);
        let Some(Outcome::Found(found)) = done.escalation.outcome() else {
            panic!("{name}: {}", report(&done));
        };
        for (key, value) in [
            (MotorKey::Resistance, truth.resistance_ohm),
            (MotorKey::BackEmf, truth.back_emf_v_s_per_rad),
            (MotorKey::Inertia, truth.inertia_kg_m2),
        ] {
            let ratio = found.motor.get(key).unwrap() / value;
            assert!(
                (ratio - 1.0).abs() < 0.05,
                "{name} {} {ratio}\n{}",
                key.key(),
                report(&done)
            );
        }
        // The limits of the bench: 13 A and 340 rad/s.
        assert!(
            done.peak_a < 13.0 && done.peak_rad_s < 340.0,
            "{}",
            report(&done)
        );
    }
}

/// The nameplate of a software drive, without its tolerance.
fn behind(emulator: &str) -> Nameplate {
    let truth = EmulatorConfig::embedded(emulator).unwrap().motor;
    Nameplate {
        name: truth.name,
        rated_voltage_v: truth.rated_voltage_v,
        rated_current_a: truth.rated_current_a,
        rated_speed_rad_s: truth.rated_speed_rad_s,
        resistance_ohm: truth.resistance_ohm,
        inductance_h: truth.inductance_h,
        back_emf_v_s_per_rad: truth.back_emf_v_s_per_rad,
        inertia_kg_m2: truth.inertia_kg_m2,
        load_torque_n_m: truth.load_torque_n_m,
    }
}

#[test]
fn the_sequence_is_left_alone_or_made_smaller_until_every_limit_holds() {
    let bench = BenchFile::embedded_default();
    let same = scale(&bench, &behind("zk-22fc-plain"), Some(11.4))
        .unwrap()
        .unwrap();
    assert!((same.factor - 1.0).abs() < 1e-12 && same.refusal.is_none());
    assert_eq!(same.bench.sequence, bench.sequence);

    let servo = scale(&bench, &behind("small-servo-behind-zk-22fc"), Some(11.4))
        .unwrap()
        .unwrap();
    let refusal = servo.refusal.as_ref().unwrap();
    assert_eq!(refusal.quantity, "peak speed");
    // 340 rad/s are 17 V of 97.
    assert!((0.12..0.18).contains(&servo.factor), "{}", servo.factor);
    assert!(!servo.plan.is_refused() && servo.plan.peak_speed_rad_s > 250.0);

    let large = scale(&bench, &behind("large-motor-behind-zk-22fc"), Some(11.4))
        .unwrap()
        .unwrap();
    assert_eq!(large.refusal.as_ref().unwrap().quantity, "peak current");
    assert!(
        !large.plan.is_refused() && large.plan.peak_current_a > 3.0,
        "{:?}",
        large.plan.peak_current_a
    );
    let (voltage, smaller) = (
        bench.program(1).unwrap().peak_v(),
        large.bench.program(1).unwrap().peak_v(),
    );
    assert!(smaller < voltage, "{smaller} of {voltage}");
}

/// A motor that somebody could have put on the bench: R and L/R over the whole range, the rest so that it is a motor.
fn random_motor(seed: u64) -> (BenchFile, EmulatorConfig) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut log = |from: f64, to: f64| from * (to / from).powf(rng.random::<f64>());
    let electrical_s = log(0.3e-3, 50e-3);
    // Rated power in the winding as a share; a current of which the drive's resolution of 10 mA is 2 % at most.
    let (resistance, rated_v, loss, rated_a) = loop {
        let (resistance, rated_v, loss) = (log(0.1, 20.0), log(12.0, 220.0), log(0.02, 0.3));
        let rated_a = loss * rated_v / resistance;
        if (0.5..60.0).contains(&rated_a) {
            break (resistance, rated_v, loss, rated_a);
        }
    };
    let rated_rad_s = log(60.0, 500.0);
    let back_emf = (1.0 - loss) * rated_v / rated_rad_s;
    let mechanical_s = log(8e-3, 0.5);
    let friction = log(0.01, 0.3);
    let mut config = EmulatorConfig::embedded("zk-22fc-plain").unwrap();
    config.tolerance = 0.0;
    config.motor.resistance_ohm = resistance;
    config.motor.inductance_h = resistance * electrical_s;
    config.motor.back_emf_v_s_per_rad = back_emf;
    config.motor.inertia_kg_m2 = mechanical_s * back_emf * back_emf / resistance;
    config.motor.load_torque_n_m = friction * rated_a * back_emf;
    (
        config.motor.rated_voltage_v,
        config.motor.rated_current_a,
        config.motor.rated_speed_rad_s,
    ) = (rated_v, rated_a, rated_rad_s);
    // As far away as the registers allow: the drive does not help.
    config.limits.current_limit_a = 650.0;
    config.limits.bus_v = 2.0 * rated_v;
    config.limits.speed_limit_rad_s = 1300.0;
    config.noise.current_a = 0.005 * rated_a;
    config.noise.speed_rad_s = 0.0005 * rated_rad_s;
    config.quantisation.current_a = 0.0;
    let mut bench = unknown_bench();
    bench.motor.rated_voltage_v = rated_v;
    bench.motor.rated_current_a = rated_a;
    bench.motor.rated_speed_rad_s = rated_rad_s;
    bench.limits.current_a = None;
    bench.limits.speed_rad_s = None;
    bench.limits.voltage_v = None;
    bench.limits.slew_v_per_s = None;
    bench.limits.bus_min_v = None;
    bench.limits.bus_max_v = None;
    (bench, config)
}

/// What went wrong with one random motor, if anything.
fn fault_of(seed: u64) -> Option<String> {
    let (bench, config) = random_motor(seed);
    let done = escalated(&bench, &config, seed);
    let limits = bench.limits();
    let truth = &config.motor;
    let about = |what: String| {
        Some(format!(
            "seed {seed}: {what}\n R {} L/R {:.2} ms Ke {} J {} TM {:.1} ms Mc {} rated {:.1} V {:.2} A {:.0} rad/s\n{}",
            truth.resistance_ohm,
            1e3 * truth.inductance_h / truth.resistance_ohm,
            truth.back_emf_v_s_per_rad,
            truth.inertia_kg_m2,
            1e3 * truth.resistance_ohm * truth.inertia_kg_m2 / truth.back_emf_v_s_per_rad.powi(2),
            truth.load_torque_n_m,
            truth.rated_voltage_v,
            truth.rated_current_a,
            truth.rated_speed_rad_s,
            report(&done)
        ))
    };
    if done
        .outcomes
        .iter()
        .any(|outcome| *outcome != RunOutcome::Done)
    {
        return about("a trip".to_owned());
    }
    if done.peak_a > limits.current_a || done.peak_rad_s > limits.speed_rad_s {
        return about("beyond a limit".to_owned());
    }
    let Some(Outcome::Found(found)) = done.escalation.outcome() else {
        return about("not found".to_owned());
    };
    for (key, value) in [
        (MotorKey::Resistance, truth.resistance_ohm),
        (MotorKey::BackEmf, truth.back_emf_v_s_per_rad),
        (MotorKey::Inertia, truth.inertia_kg_m2),
    ] {
        let estimate = found.get(key).unwrap();
        if estimate.verdict == Verdict::NotObservable {
            continue;
        }
        let ratio = estimate.value.unwrap() / value;
        if (ratio - 1.0).abs() > 0.05 {
            return about(format!("{} {ratio:.3} of the truth", key.key()));
        }
    }
    None
}

#[test]
fn random_motors_are_found_without_a_trip_and_below_every_limit() {
    use rayon::prelude::*;
    // Forty in every run of the tests; COUNT=3000 takes a minute with optimisation.
    let asked = std::env::var("COUNT").ok().and_then(|n| n.parse().ok());
    let count: u64 = asked.unwrap_or(40);
    let faults: Vec<String> = (0..count).into_par_iter().filter_map(fault_of).collect();
    assert!(
        faults.is_empty(),
        "{} of {count} random motors:\n{}",
        faults.len(),
        faults.join("\n")
    );
}
