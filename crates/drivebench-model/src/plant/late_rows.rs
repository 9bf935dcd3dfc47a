//! Rows whose exchange took far longer than the others: when their speed was read is not known.
//!
//! A balance of torques takes the rate of the speed between rows. At 500 rad/s2 a stamp that is off by a quarter of a period of 10 ms
//! makes an error of a tenth of the torque, and of several times that behind the inverse of a filter.

use crate::numerics::statistics::{finite, median, median_step};
use crate::sample::{Channel, Run};

/// The run without the speeds of these rows; `None` where there are none.
pub(super) fn left_out(run: &Run) -> Option<Run> {
    let (widths, speed) = (run.column(Channel::TimeHalfWidth)?, run.column(Channel::Speed)?);
    let times: Vec<f64> = run.points(Channel::Speed).map(|point| point.0).collect();
    let read: Vec<f64> =
        widths.iter().zip(speed).filter(|row| row.1.is_finite()).map(|row| row.0.abs()).collect();
    // A tenth of a period and three usual half-widths.
    let least_s = (0.1 * median_step(&times)).max(3.0 * median(&finite(&read)));
    let is_late = |row: &usize| widths[*row].abs() > least_s && speed[*row].is_finite();
    let late: Vec<usize> = (0..speed.len()).filter(is_late).collect();
    if late.is_empty() {
        return None;
    }
    let mut kept = speed.to_vec();
    for row in late {
        kept[row] = f64::NAN;
    }
    let mut without = run.clone();
    without.set_column(Channel::Speed, kept, run.origin(Channel::Speed)).ok()?;
    Some(without)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample::Origin;

    #[test]
    fn a_row_of_a_late_exchange_has_no_speed() {
        let times: Vec<f64> = (0..100).map(|row| 0.01 * f64::from(row)).collect();
        let run_with = |widths: Vec<f64>| {
            let mut run = Run::new("drive", times.clone()).unwrap();
            run.set_column(Channel::Speed, times.clone(), Origin::Measured).unwrap();
            run.set_column(Channel::TimeHalfWidth, widths, Origin::Derived).unwrap();
            run
        };
        let mut widths = vec![2e-5; 100];
        assert!(left_out(&run_with(widths.clone())).is_none());
        (widths[40], widths[41]) = (2.4e-3, 2e-4);
        let found = left_out(&run_with(widths)).unwrap();
        let speed = found.column(Channel::Speed).unwrap();
        assert!(speed[40].is_nan() && speed[39].is_finite() && speed[41].is_finite());
        // Where all stamps are as uncertain none stands out.
        assert!(left_out(&run_with(vec![2.4e-3; 100])).is_none());
    }
}
