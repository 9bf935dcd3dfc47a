//! Runs on a laptop that stands still now and then, with a drive that sometimes does not answer for as long.

use super::*;
use crate::bench::guard::TripKind;
use crate::bench::limits::Limits;
use crate::bench::testing::stalls::{DozingLink, StallingClock, Stalls};

const RATE_HZ: f64 = 50.0;
const LIMIT_A: f64 = 11.0;
/// Below the silence that is allowed and the drive's watchdog.
const STALLS: Stalls = Stalls {
    share: 0.15,
    longest_s: 0.2,
};

/// A square wave of voltage on a drive that itself lets through three times the bench's current.
fn outcome(seed: u64, knows_its_period: bool) -> RunSummary {
    let motor = Nameplate::zk_22fc();
    let limits = Limits {
        current_a: LIMIT_A,
        link_silence_s: 0.45,
        slew_v_per_s: 200.0,
        ..Limits::for_motor(&motor, RATE_HZ)
    };
    let mut config = EmulatorConfig::embedded("zk-22fc-plain").unwrap();
    config.limits.current_limit_a = 33.0;
    // The bound is as good as the nameplate, and as the trip is sharp: both are exact here.
    config.tolerance = 0.0;
    config.noise.current_a = 0.0;
    let clock = VirtualClock::new();
    let drive = SoftDrive::new(&config, seed);
    let link = MemoryLink::new(drive, clock.clone(), Latency::default());
    let mut link = DozingLink::new(link, clock.clone(), STALLS, seed);
    let mut clock = StallingClock::new(clock, STALLS, seed + 1_000_000);
    let mut guard = Guard::new(limits, &motor, Some(33.0));
    if knows_its_period {
        guard = guard.with_period(1.0 / RATE_HZ);
    }
    let program = Wave {
        duration_s: 6.0,
        demand: |time_s| {
            let up = (time_s / 0.5).floor() % 2.0 == 0.0;
            Demand::Voltage(if up { 40.0 } else { -40.0 })
        },
    };
    let session = Session::new(Box::new(program), guard);
    carry_out(session, &mut link, &mut clock, RATE_HZ).0
}

/// Currents beyond the limit that ended the runs, A.
fn beyond_a(knows_its_period: bool) -> Vec<f64> {
    let runs = (0..60).map(|seed| outcome(seed, knows_its_period).outcome);
    runs.filter_map(|outcome| match outcome {
        Outcome::Tripped(trip) if trip.kind == TripKind::OverCurrent => Some(trip.value.abs()),
        other => {
            assert_eq!(other, Outcome::Done);
            None
        }
    })
    .collect()
}

#[test]
fn a_shaft_that_was_not_seen_for_a_while_is_not_braked_beyond_the_limit() {
    // A speed is one period old on a good link too: that much the limit is exceeded by now and then.
    let with = beyond_a(true);
    assert!(with.len() < 4, "{with:?}");
    assert!(with.iter().all(|amps| *amps < 1.02 * LIMIT_A), "{with:?}");
    // What this rests on: without knowing how old a speed is, the same stalls drive far more through the winding.
    let without = beyond_a(false);
    let far = without.iter().filter(|amps| **amps > 1.1 * LIMIT_A);
    assert!(far.count() > 15, "{without:?}");
}
