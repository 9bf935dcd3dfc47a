//! The checks on a laptop that stands still now and then, before a drive that sometimes does not answer for as long.

use super::*;
use crate::bench::testing::stalls::{DozingLink, StallingClock, Stalls};

/// Below the silence that is allowed and the drive's watchdog.
const STALLS: Stalls = Stalls {
    share: 0.03,
    longest_s: 0.2,
};

fn report(seed: u64, rate_hz: f64) -> CheckReport {
    let bench = BenchFile::embedded_default();
    let config = EmulatorConfig::embedded("zk-22fc-plain").unwrap();
    let clock = VirtualClock::new();
    let link = MemoryLink::new(
        SoftDrive::new(&config, seed),
        clock.clone(),
        Latency::default(),
    );
    let mut link = DozingLink::new(link, clock.clone(), STALLS, seed);
    let mut clock = StallingClock::new(clock, STALLS, seed + 1_000_000);
    let profile = DriveProfile::named("own").unwrap();
    let plate = bench.nameplate().unwrap();
    let options = CheckOptions {
        rate_hz,
        first_move: Some(FirstMove {
            plate: &plate,
            profile: &profile,
            stopped: &|| false,
        }),
        ..options()
    };
    check(&mut link, &mut clock, &bench.limits(), options).unwrap()
}

#[test]
fn a_good_machine_is_not_refused_because_the_laptop_stood_still() {
    for rate_hz in [20.0, 50.0, 100.0] {
        let refusals: Vec<String> = (0..200)
            .filter_map(|seed| {
                let report = report(seed, rate_hz);
                // A line that loses a tenth of its replies is refused as such, and rightly.
                let refusal = report.refusal().filter(|item| item.name != "link")?;
                Some(format!("{seed}: {}: {}", refusal.name, refusal.text))
            })
            .collect();
        assert!(refusals.is_empty(), "{rate_hz} Hz: {refusals:#?}");
    }
}
