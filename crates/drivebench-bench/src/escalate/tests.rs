//! The escalation on the emulated drive, in virtual time. The drive's own current limit is set far away: only
//! the escalation limits the current.

use super::*;
use crate::bench_file::LimitsSection;
use crate::limits::MotorSection;
use crate::session::Outcome as RunOutcome;
use crate::testing::{Tamper, Tampered, TestRun, in_memory, nameplate_of, random_motor, within};
use drivebench_emulator::{EmulatorConfig, MemoryLink, VirtualClock};
use drivebench_identify::escalation::{Ending, Escalation, Outcome};
use drivebench_link::{DriveLink, LinkError};
use drivebench_model::plant::MotorKey;
use drivebench_model::sample::{Command, Sample, Verdict};

/// Samples the true current and speed at 10 kHz.
struct Watched {
    clock: VirtualClock,
    peak_a: f64,
    peak_rad_s: f64,
}

impl Tamper<MemoryLink> for Watched {
    fn exchange(&mut self, link: &mut MemoryLink, command: Command) -> Result<Sample, LinkError> {
        // The drive holds the last command since the last exchange.
        let until_s = self.clock.time_s();
        let mut at_s = link.drive().time_s();
        while at_s < until_s {
            at_s += 1e-4;
            link.advance_to(at_s);
            let plant = link.drive().plant();
            self.peak_a = self.peak_a.max(plant.current_a().abs());
            self.peak_rad_s = self.peak_rad_s.max(plant.speed_rad_s().abs());
        }
        link.exchange(command)
    }
}

struct Done {
    escalation: Escalation,
    outcomes: Vec<RunOutcome>,
    peak_a: f64,
    peak_rad_s: f64,
}

fn escalated(bench: &BenchFile, config: &EmulatorConfig, seed: u64) -> Done {
    let (link, mut clock) = in_memory(config, seed);
    let by = Watched { clock: clock.clone(), peak_a: 0.0, peak_rad_s: 0.0 };
    let mut watched = Tampered { link, by };
    let mut escalation = Escalation::new(bounds(bench));
    let mut outcomes = Vec::new();
    let mut seq = 0;
    while let Some(stage) = escalation.stage() {
        let session = stage_session(bench, stage).unwrap_or_else(|error| {
            panic!("seed {seed}: {error}: {stage:?} {:?}", escalation.history())
        });
        let test = TestRun::at(bench.link.rate_hz);
        let (summary, recorder) = test.run(session.after_seq(seq), &mut watched, &mut clock);
        seq = summary.link.sent + 1;
        let ended = summary.outcome == RunOutcome::Done;
        outcomes.push(summary.outcome);
        if !ended {
            break;
        }
        escalation.learn(&recorder.run("stage").unwrap()).unwrap();
    }
    Done { escalation, outcomes, peak_a: watched.by.peak_a, peak_rad_s: watched.by.peak_rad_s }
}

/// The embedded bench with only the rated values of the motor.
fn unknown_bench() -> BenchFile {
    let mut bench = BenchFile::embedded_default();
    bench.motor = MotorSection {
        unknown: true,
        resistance_ohm: None,
        inductance_h: None,
        back_emf_v_s_per_rad: None,
        inertia_kg_m2: None,
        load_torque_n_m: None,
        ..bench.motor
    };
    bench
}

fn report(done: &Done) -> String {
    let lines = done.escalation.history().iter().zip(&done.outcomes).map(|(stage, outcome)| {
        let (kind, outcome) = (stage.kind.name(), outcome.name());
        let (volts, line) = (stage.peak_v, &stage.line);
        format!("{kind:>10} {volts:>8.3} V: {line} [{outcome}]\n")
    });
    let (last, found) = (done.outcomes.last(), done.escalation.outcome());
    let (peak_a, peak_rad_s) = (done.peak_a, done.peak_rad_s);
    let peaks = format!("peaks {peak_a:.3} A {peak_rad_s:.2} rad/s; {found:?}\n");
    lines.collect::<String>() + &format!("outcomes {last:?}\n") + &peaks
}

/// The parameters that have to be found within five per cent.
const FOUND: [MotorKey; 3] = [MotorKey::Resistance, MotorKey::BackEmf, MotorKey::Inertia];

#[test]
fn a_locked_rotor_gets_little_more_than_its_rated_current() {
    let config = EmulatorConfig::embedded("zk-22fc-locked").unwrap();
    let done = escalated(&unknown_bench(), &config, 3);
    let report = report(&done);
    let Some(Outcome::Named(Ending::LockedRotor { current_a, .. })) = done.escalation.outcome()
    else {
        panic!("{report}");
    };
    within(*current_a, 0.85 * 5.7..1.3 * 5.7);
    assert!(done.peak_a < 1.3 * 5.7, "{report}");
}

#[test]
fn the_motor_is_identified_with_a_wrong_nameplate() {
    for name in ["zk-22fc-plain", "small-servo-behind-zk-22fc", "large-motor-behind-zk-22fc"] {
        let config = EmulatorConfig::embedded(name).unwrap();
        for seed in 1..=3 {
            let done = escalated(&unknown_bench(), &config, seed);
            let report = report(&done);
            let truth = nameplate_of(config.motor.specimen(config.tolerance, seed)).motor();
            let Some(Outcome::Found(found)) = done.escalation.outcome() else {
                panic!("{name}: {report}");
            };
            for key in FOUND {
                let ratio = found.motor.get(key).unwrap() / truth.get(key).unwrap();
                let key = key.key();
                assert!((ratio - 1.0).abs() < 0.05, "{name} {key} {ratio}\n{report}");
            }
            // The limits of the bench: 13 A and 340 rad/s.
            assert!(done.peak_a < 13.0 && done.peak_rad_s < 340.0, "{report}");
        }
    }
}

#[test]
fn the_sequence_is_scaled_until_every_limit_holds() {
    let bench = BenchFile::embedded_default();
    let scaled = |emulator| {
        let nameplate = nameplate_of(EmulatorConfig::embedded(emulator).unwrap().motor);
        scale(&bench, &nameplate, Some(11.4)).unwrap().unwrap()
    };
    let same = scaled("zk-22fc-plain");
    assert!((same.factor - 1.0).abs() < 1e-12 && same.refusal.is_none());
    assert_eq!(same.bench.sequence, bench.sequence);

    let servo = scaled("small-servo-behind-zk-22fc");
    let refusal = servo.refusal.as_ref().unwrap();
    assert_eq!(refusal.quantity, "peak speed");
    // 340 rad/s are 17 V of 97.
    within(servo.factor, 0.12..0.18);
    assert!(!servo.plan.is_refused() && servo.plan.peak_speed_rad_s > 250.0);

    let large = scaled("large-motor-behind-zk-22fc");
    assert_eq!(large.refusal.as_ref().unwrap().quantity, "peak current");
    assert!(!large.plan.is_refused());
    within(large.plan.peak_current_a, 3.0..);
    let peak_v = |bench: &BenchFile| bench.program(1).unwrap().peak_v();
    within(peak_v(&large.bench), ..peak_v(&bench));
}

/// A random motor, of which only the rated values are known.
fn random_bench(seed: u64) -> (BenchFile, EmulatorConfig) {
    let config = random_motor(seed);
    let mut bench = unknown_bench();
    bench.motor.rated_voltage_v = config.motor.rated_voltage_v;
    bench.motor.rated_current_a = config.motor.rated_current_a;
    bench.motor.rated_speed_rad_s = config.motor.rated_speed_rad_s;
    bench.limits = LimitsSection {
        time_s: bench.limits.time_s,
        link_silence_s: bench.limits.link_silence_s,
        travel_rad: bench.limits.travel_rad,
        ..LimitsSection::default()
    };
    (bench, config)
}

fn fault_of(seed: u64) -> Option<String> {
    let (bench, config) = random_bench(seed);
    let done = escalated(&bench, &config, seed);
    let limits = bench.limits();
    let truth = &config.motor;
    let about = |what: String| Some(format!("seed {seed}: {what}\n{truth:?}\n{}", report(&done)));
    if done.outcomes.iter().any(|outcome| *outcome != RunOutcome::Done) {
        return about("a trip".to_owned());
    }
    if done.peak_a > limits.current_a || done.peak_rad_s > limits.speed_rad_s {
        return about("beyond a limit".to_owned());
    }
    let Some(Outcome::Found(found)) = done.escalation.outcome() else {
        return about("not found".to_owned());
    };
    for key in FOUND {
        let estimate = found.get(key).unwrap();
        if estimate.verdict == Verdict::NotObservable {
            continue;
        }
        let ratio = estimate.value.unwrap() / nameplate_of(truth.clone()).motor().get(key).unwrap();
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
    let count: u64 = std::env::var("COUNT").ok().and_then(|n| n.parse().ok()).unwrap_or(40);
    let faults: Vec<String> = (0..count).into_par_iter().filter_map(fault_of).collect();
    let (failed, all) = (faults.len(), faults.join("\n"));
    assert!(faults.is_empty(), "{failed} of {count} random motors:\n{all}");
}
