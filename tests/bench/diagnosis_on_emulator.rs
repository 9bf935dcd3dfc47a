//! The whole measuring chain in virtual time: every embedded emulator, whose hidden effects have other forms than the
//! catalogue's, is excited with the embedded bench, recorded, and diagnosed from nothing but its rows.

use std::sync::atomic::AtomicBool;
use std::sync::mpsc::channel;

use drivebench::bench::{
    self, Bench, BenchFile, CheckOptions, CheckReport, Guard, Outcome, RunOptions, Session,
    SnapshotCell, Target, Waivers, check,
};
use drivebench::diagnosis::{DiagnosisVerdict, ErrorOf, Evidence, compare, diagnose};
use drivebench::emulator::{EmulatorConfig, Latency, MemoryLink, SoftDrive, VirtualClock};
use drivebench::plant::{Model, Scenario};
use drivebench::recording::MemoryRecorder;
use drivebench::report::wording::diagnosis::diagnosis as sentence;
use drivebench::sample::{Channel, Origin};

/// A specimen of a machine on its bench, in virtual time.
pub(crate) struct Specimen {
    link: MemoryLink,
    clock: VirtualClock,
    report: CheckReport,
    last_seq: u64,
}

impl Specimen {
    pub(crate) fn new(config: &EmulatorConfig, seed: u64) -> Self {
        let file = BenchFile::embedded_default();
        let time = VirtualClock::new();
        let mut clock = time.clone();
        let mut link = MemoryLink::new(SoftDrive::new(config, seed), time, Latency::default());
        let options = CheckOptions {
            rate_hz: file.link.rate_hz,
            hardware_allowed: false,
            hardware_confirmed: false,
            waivers: Waivers::default(),
            first_move: None,
            stopped: &|| false,
            reset_fault: false,
        };
        let report = check(&mut link, &mut clock, &file.limits(), options).unwrap();
        assert!(report.passed(), "{:?}", report.refusal());
        let last_seq = report.last_seq;
        Self { link, clock, report, last_seq }
    }

    /// The sequence of a bench file, recorded.
    pub(crate) fn run(&mut self, file: &BenchFile, run_seed: u64) -> Scenario {
        let guard = Guard::new(
            file.limits(),
            &file.nameplate().unwrap(),
            self.report.identity.current_limit_a,
        );
        let program = Box::new(file.program(run_seed).unwrap());
        let session = Session::new(program, guard).after_seq(self.last_seq);
        let mut recorder =
            MemoryRecorder::new(bench::layout(&[Channel::VoltageCmd], &self.report.signals));
        let (_screen, intents) = channel();
        let summary = bench::run(
            session,
            Bench {
                link: &mut self.link,
                clock: &mut self.clock,
                recorder: &mut recorder,
                estimator: None,
                intents: &intents,
                interrupted: &AtomicBool::new(false),
                snapshots: &SnapshotCell::default(),
            },
            &RunOptions {
                name: "run".to_owned(),
                target: Target::Sim,
                rate_hz: file.link.rate_hz,
                motor: file.nameplate(),
                auto_start: true,
            },
        );
        assert_eq!(summary.outcome, Outcome::Done, "{:?}", summary.notices);
        self.last_seq += summary.link.sent + 1;
        let mut run = recorder.run("run").unwrap();
        for (channel, origin) in
            [(Channel::VoltageCmd, Origin::Commanded), (Channel::Voltage, Origin::Measured)]
        {
            run.set_column(channel, run.column(channel).unwrap().to_vec(), origin).unwrap();
        }
        Scenario::from_run(&run).unwrap()
    }
}

/// Runs of one specimen, one for each seed of its excitation.
pub(crate) fn record(config: &EmulatorConfig, seed: u64, run_seeds: &[u64]) -> Vec<Scenario> {
    let file = BenchFile::embedded_default();
    let mut specimen = Specimen::new(config, seed);
    let run = |run_seed: &u64| specimen.run(&file, *run_seed);
    run_seeds.iter().map(run).collect()
}

/// Diagnoses a specimen and compares the speed error on the confirming run before and after.
fn hidden_effect_is_named(emulator: &str, effect: Option<&str>, seed: u64) {
    let config = EmulatorConfig::embedded(emulator).unwrap();
    // Fit, select, confirm, repeat.
    let runs = record(&config, seed, &[1, 2, 3, 1]);
    let nameplate = Model::baseline(BenchFile::embedded_default().motor.motor());
    let evidence = Evidence::new(runs[0].clone(), Some(runs[1].clone()), None);
    let (evidence, baseline) = evidence.with_baseline(&nameplate).unwrap();
    let evidence = evidence.with_repeat(&baseline.model, runs[3].clone()).unwrap();
    let confirming = Evidence { holdout: runs[2].clone(), ..evidence.clone() };
    let found = diagnose(&nameplate, evidence).unwrap();
    let Some(effect) = effect else {
        assert_eq!(found.verdict, DiagnosisVerdict::None, "{emulator}: {}", sentence(&found));
        return;
    };
    assert_eq!(found.verdict, DiagnosisVerdict::Effect, "{emulator}: {}", sentence(&found));
    assert_eq!(found.effects, [effect], "{emulator}");
    assert_eq!(found.repeats, Some(true), "{emulator}: {:?}", found.repeat_floor);
    let speed_error = |model: &Model| {
        let comparison = compare(model, &confirming, ErrorOf::Structure).unwrap();
        let speed = comparison.signals.speed_rad_s.unwrap();
        (speed.holdout.rmse, speed.noise_floor.unwrap())
    };
    let (before, floor) = speed_error(&found.baseline.model);
    let (after, _) = speed_error(&found.model.model);
    assert!(before > 1.2 * floor, "{emulator}: {before} {floor}");
    // A winding that warms is warmer at the start of the confirming run than it ever was in the run that was fitted.
    // 1.37 floors were left with the sequence whose standstill ends with a level of 1 V.
    let most = if effect == "winding_heating" { 1.45 } else { 1.15 };
    assert!(after < most * floor, "{emulator}: {after} {floor}");
}

#[test]
fn what_each_emulated_machine_hides_is_named() {
    for (emulator, effect, seed) in [
        ("zk-22fc-hidden", Some("stribeck_friction"), 1),
        ("zk-22fc-plain", None, 1),
        ("zk-22fc-plain", None, 2),
        ("zk-22fc-viscous", Some("viscous_friction"), 1),
        ("zk-22fc-fan", Some("quadratic_load"), 1),
        ("zk-22fc-brushes", Some("voltage_drop"), 1),
        // From run to run.
        ("zk-22fc-warming", Some("winding_heating"), 1),
    ] {
        hidden_effect_is_named(emulator, effect, seed);
    }
}

#[test]
fn a_start_so_late_that_the_drive_comes_to_its_current_limit() {
    let plain = include_str!("../../bench-configs/emulators/zk-22fc-plain.toml");
    for (seed, delay_s) in [(2, 0.4), (5, 0.437)] {
        let hidden = format!("\n[[hidden]]\nid = \"start_delay\"\ndelay_s = {delay_s}\n");
        let config = EmulatorConfig::parse("late.toml", &(plain.to_owned() + &hidden)).unwrap();
        let [fit, holdout] = record(&config, seed, &[1, 2]).try_into().unwrap();
        assert!(!fit.limits.is_empty() && !holdout.limits.is_empty());
        let nameplate = Model::baseline(BenchFile::embedded_default().motor.motor());
        let found = diagnose(&nameplate, Evidence::new(fit, Some(holdout), None)).unwrap();
        assert_eq!(found.effects, ["start_delay"], "{}", sentence(&found));
        let found_s = found.candidates[0].parameters[0].value.unwrap();
        assert!((found_s - delay_s).abs() < 2e-3, "{found_s} {delay_s}");
        assert!(found.holdout_after < 1.5, "{}", sentence(&found));
    }
}
