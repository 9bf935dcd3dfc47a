//! Start of a burst capture within the sequence.

use super::bench_file::BenchFile;
use super::limits::Nameplate;
use drivebench_model::excitation::Segment;

/// The part of the sequence, from 1, whose first command should start a burst capture: the first in which the voltage
/// jumps. `None` where nothing jumps, or where the loop samples the transient itself, with a period no longer than L/R.
pub fn burst_part(bench: &BenchFile, motor: &Nameplate) -> Option<usize> {
    use Segment::{Prbs, Staircase, Steps};
    let period_s = bench.period_s();
    if period_s <= motor.inductance_h / motor.resistance_ohm {
        return None;
    }
    let jumps = |segment: &Segment| matches!(segment, Steps(_) | Staircase(_) | Prbs(_));
    let first = bench.sequence.iter().position(jumps)?;
    Some(first + 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_burst_is_for_a_period_longer_than_l_over_r() {
        let mut bench = BenchFile::embedded_default();
        let motor = bench.nameplate().unwrap();
        // L/R is 9 ms, the period 10 ms; the first two parts have no jump.
        assert_eq!(burst_part(&bench, &motor), Some(3));
        bench.link.rate_hz = 200.0;
        assert_eq!(burst_part(&bench, &motor), None);
        bench.link.rate_hz = 10.0;
        bench.sequence.truncate(2);
        assert_eq!(burst_part(&bench, &motor), None);
    }
}
