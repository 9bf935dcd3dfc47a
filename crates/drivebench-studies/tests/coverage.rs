//! 95 % intervals of records over a line cover the truth, counted over many machines.
//!
//! `cargo test --release -p drivebench-studies --test coverage -- --nocapture` prints the table.

use drivebench_studies::lines::{self, ALL_ERRORS, HOST_STAMPED, StampWidths, VoltageKnown};

const RUNS: usize = 100;

/// Records of a host that stamps what it sends and receives. Of every kind the intervals hold; with the stamps taken as exact, the values are
/// far off: a command is applied, and a sample taken, somewhere within its exchange.
#[test]
fn what_a_host_stamps_covers() {
    let (mut bad, mut sampled, mut clocked) = (ALL_ERRORS, ALL_ERRORS, ALL_ERRORS);
    (bad.late, bad.lost, bad.doubled) = (0.01, 0.01, 0.01);
    sampled.voltage = VoltageKnown::Sampled;
    clocked.stamps = false;
    let mut wrong = Vec::new();
    for (name, errors) in [
        ("host's stamps", ALL_ERRORS),
        ("1 % late, lost, doubled", bad),
        ("voltage sampled only", sampled),
        ("drive's stamps", clocked),
    ] {
        let row = lines::row(name.into(), HOST_STAMPED, errors, RUNS, 500_000, StampWidths::Used);
        for (key, found) in lines::KEYS.iter().zip(&row.parameters) {
            println!(
                "{name:24} {:22} valued {:3} covered {:5.1} %, median error {:.3} %, std {:.3} %",
                key.key(),
                found.valued,
                100.0 * found.coverage(),
                found.error_percent,
                found.std_percent
            );
            // Standard deviations of a binomial share that a count may lie outside.
            let tolerance = 2.6 * (0.93 * 0.07 / found.valued.max(1) as f64).sqrt();
            if found.coverage() < 0.93 - tolerance || found.valued * 3 < 2 * RUNS {
                wrong.push(format!("{name} {} {found:?}", key.key()));
            }
        }
    }
    let ignored = lines::row(
        "stamps believed".into(),
        HOST_STAMPED,
        ALL_ERRORS,
        RUNS,
        500_000,
        StampWidths::Ignored,
    );
    // What the stamps do not say bends R and L by far more; the form of a late command, which it resembles, is in their intervals.
    assert!(ignored.parameters[0].error_percent > 1.0, "{ignored:?}");
    assert!(ignored.parameters[1].error_percent > 10.0, "{ignored:?}");
    assert!(wrong.is_empty(), "{wrong:#?}");
}
