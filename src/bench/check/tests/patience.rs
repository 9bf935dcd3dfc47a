//! How long the checks wait for a drive: by its own time, at whatever rate.

use super::*;
use crate::drive::CommandTimes;

/// The checks at `rate_hz` with the watchdog waived, before a drive that may take 2 s to run.
fn checked(drive: &mut ScriptedDrive, rate_hz: f64) -> CheckReport {
    drive.times.enable_s = 2.0;
    let asked = CheckOptions {
        rate_hz,
        waivers: Waivers {
            watchdog: true,
            ..Waivers::default()
        },
        ..options()
    };
    let limits = BenchFile::embedded_default().limits();
    check(drive, &mut VirtualClock::new(), &limits, asked).unwrap()
}

fn first_energised(drive: &ScriptedDrive) -> u64 {
    let demands = drive.demands.iter();
    let before = demands.take_while(|demand| !demand.energises());
    before.count() as u64
}

#[test]
fn a_drive_that_takes_its_time_to_run_passes_at_a_high_rate_too() {
    let mut prompt = ScriptedDrive::new(0.001);
    checked(&mut prompt, 1000.0);
    let first = first_energised(&prompt);
    let mut slow = ScriptedDrive::new(0.001).with(first, first + 1500, Fault::NeverRuns);
    let report = checked(&mut slow, 1000.0);
    assert!(report.passed(), "{:?}", report.refusal());
}

#[test]
fn a_drive_that_never_runs_is_given_up_after_the_time_that_is_told() {
    for rate_hz in [4.0, 100.0, 1000.0] {
        let mut drive = ScriptedDrive::new(1.0 / rate_hz).with(0, u64::MAX, Fault::NeverRuns);
        let report = checked(&mut drive, rate_hz);
        let times = CommandTimes {
            enable_s: 2.0,
            ..CommandTimes::default()
        };
        let waited_s = times.asked_every(1.0 / rate_hz).enable_s;
        let refusal = report.refusal().unwrap();
        assert_eq!(
            refusal.text,
            format!("the drive does not run at zero within {waited_s:.2} s")
        );
        let asked = drive.demands.iter().filter(|d| d.energises()).count() as f64;
        assert!(
            (asked - waited_s * rate_hz).abs() < 1.5,
            "{rate_hz}: {asked}"
        );
    }
}
