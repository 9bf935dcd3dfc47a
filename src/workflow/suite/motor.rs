//! What the motor of a software drive did, by the journal of the drive: when its output went to zero, and whether it came back.

use serde::Serialize;

use crate::emulator::JournalRow;

/// What counts as zero output, V.
const ZERO_V: f64 = 0.05;
/// A set-point that changes by less stays the same, V: dither and rounding of registers.
const STEP_V: f64 = 0.15;

/// Figures that a suite can put limits on, as `motor.zero_after_s`.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct MotorFigures {
    /// From the act until the set-point is zero for good, s; `null`: it never is, or nothing was noted after the act.
    pub zero_after_s: Option<f64>,
    /// From the act until the magnitude of the set-point falls for the last time, s: where a ramp down begins.
    pub falls_after_s: Option<f64>,
    /// The output is on, or its set-point not zero, at the end.
    pub on_at_end: bool,
    /// The output was switched on again after it had been off since the act.
    pub armed_again: bool,
    /// Largest magnitudes of all that was noted.
    pub peak_set_point_v: f64,
    pub peak_current_a: f64,
    pub peak_speed_rad_s: f64,
    /// At the end: `none`, or why the drive stopped itself.
    pub fault: String,
}

/// The figures of what was noted; times count from `act_s`.
pub fn figures(rows: &[JournalRow], act_s: f64) -> MotorFigures {
    let mut found = MotorFigures::default();
    // The last rise, and the first fall after it, of the magnitude.
    let (mut level_v, mut fell_s, mut zero_s) = (0.0_f64, None, None);
    let (mut was_off, mut sees_end) = (false, false);
    for row in rows {
        let volts = row.set_point_v.abs();
        found.peak_set_point_v = found.peak_set_point_v.max(volts);
        found.peak_current_a = found.peak_current_a.max(row.current_a.abs());
        found.peak_speed_rad_s = found.peak_speed_rad_s.max(row.speed_rad_s.abs());
        if volts > level_v + STEP_V {
            fell_s = None;
            level_v = volts;
        } else if volts < level_v - STEP_V {
            fell_s = fell_s.or(Some(row.time_s));
            level_v = volts;
        }
        if volts > ZERO_V {
            zero_s = None;
        } else {
            zero_s = zero_s.or(Some(row.time_s));
        }
        if row.time_s >= act_s {
            sees_end = true;
            found.armed_again |= was_off && row.output_on;
            was_off |= !row.output_on;
        }
    }
    let after = |at_s: f64| (at_s - act_s).max(0.0);
    found.zero_after_s = zero_s.filter(|_| sees_end).map(after);
    found.falls_after_s = fell_s.filter(|_| sees_end).map(after);
    if let Some(last) = rows.last() {
        found.on_at_end = last.output_on || last.set_point_v.abs() > ZERO_V;
        found.fault.clone_from(&last.fault);
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One row a tenth of a second.
    fn rows(volts: &[f64]) -> Vec<JournalRow> {
        let row = |(index, &set_point_v): (usize, &f64)| JournalRow {
            time_s: index as f64 * 0.1,
            set_point_v,
            output_on: set_point_v != 0.0,
            voltage_v: set_point_v,
            current_a: -set_point_v / 10.0,
            speed_rad_s: 1.0,
            state: String::new(),
            fault: "none".to_owned(),
            host: Some(0),
            seq: 0,
            late_s: 0.0,
        };
        volts.iter().enumerate().map(row).collect()
    }

    fn near(found: Option<f64>, wanted: f64) -> bool {
        found.is_some_and(|found| (found - wanted).abs() < 1e-9)
    }

    #[test]
    fn the_end_is_where_it_falls_and_is_zero_for_good() {
        let volts = [0.0, 5.0, 0.0, 40.0, 40.1, 40.0, 30.0, 10.0, 0.0, 0.0];
        let found = figures(&rows(&volts), 0.45);
        assert!(
            near(found.falls_after_s, 0.15) && near(found.zero_after_s, 0.35),
            "{found:?}"
        );
        assert!(!found.on_at_end && !found.armed_again);
        assert!((found.peak_current_a - 4.01).abs() < 1e-9);
        let again = [&volts[..], &[3.0, 0.0]].concat();
        let found = figures(&rows(&again), 0.45);
        assert!(
            found.armed_again && near(found.zero_after_s, 0.65),
            "{found:?}"
        );
        let on = [&volts[..], &[3.0]].concat();
        let found = figures(&rows(&on), 0.45);
        assert!(found.on_at_end && found.zero_after_s.is_none(), "{found:?}");
        // Nothing was noted after the act: nothing can be said.
        assert_eq!(figures(&rows(&volts), 5.0).zero_after_s, None);
    }
}
