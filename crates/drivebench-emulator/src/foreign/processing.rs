//! What a drive makes of its signals before it reports them, as its profile states: a speed behind a filter, a current as its mean
//! since it was last read, and a time-out as of its last look at the clock.

use drivebench_link::register_map::{Quantity, RegisterMap};
use drivebench_model::numerics::count::whole;

/// The processed signals of one drive.
#[derive(Debug, Default)]
pub(super) struct Processing {
    filter_s: f64,
    averages_current: bool,
    /// Whether the current is counted in the direction of the voltage, and that of the last voltage that was not zero.
    is_driving: bool,
    direction: f64,
    speed_rad_s: f64,
    at_s: f64,
    /// Sum and number of the currents since the last read, the time of that, and what it read.
    current: (f64, u32),
    read_s: f64,
    mean_a: f64,
    /// Whether the drive had lost its host when it last looked.
    is_lost: bool,
    looked: u64,
}

impl Processing {
    pub(super) fn of(map: &RegisterMap) -> Self {
        let stated = map.sensors();
        Self {
            filter_s: stated.speed.filter_s,
            averages_current: stated.averages_current,
            is_driving: map.of_quantity(Quantity::DrivingCurrent).is_some(),
            direction: 1.0,
            ..Self::default()
        }
    }

    /// Whether the profile states anything of the kind.
    pub(super) const fn is_needed(&self) -> bool {
        self.filter_s > 0.0 || self.averages_current
    }

    /// Takes what the sensors read now under this commanded voltage.
    pub(super) fn follow(
        &mut self,
        time_s: f64,
        [current_a, speed_rad_s]: [f64; 2],
        voltage_v: f64,
    ) {
        if voltage_v != 0.0 {
            self.direction = voltage_v.signum();
        }
        let decay =
            if self.filter_s > 0.0 { (-(time_s - self.at_s) / self.filter_s).exp() } else { 0.0 };
        self.speed_rad_s = speed_rad_s + (self.speed_rad_s - speed_rad_s) * decay;
        self.at_s = time_s;
        self.current.0 += if self.is_driving { self.direction * current_a } else { current_a };
        self.current.1 += 1;
    }

    /// Notes whether the host is lost, where the drive looks now.
    pub(super) fn look(&mut self, time_s: f64, is_lost: bool) {
        // Every 10 ms, as VESC does (timeout.c).
        let look = whole((100.0 * time_s).floor()) as u64;
        if look > self.looked {
            (self.looked, self.is_lost) = (look, is_lost);
        }
    }

    pub(super) const fn had_lost_host(&self) -> bool {
        self.is_lost
    }

    pub(super) const fn speed_rad_s(&self) -> f64 {
        self.speed_rad_s
    }

    /// The mean since the read before; all signals of one reply have the same.
    pub(super) fn mean_current_a(&mut self, time_s: f64) -> f64 {
        let (sum, count) = self.current;
        if time_s > self.read_s && count > 0 {
            self.mean_a = sum / f64::from(count);
            self.current = (0.0, 0);
            self.read_s = time_s;
        }
        self.mean_a
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_passes_the_filter_and_the_mean() {
        let mut processing = Processing { filter_s: 0.05, ..Processing::default() };
        for step in 1..=1000 {
            let current_a = if step > 900 { 2.0 } else { 0.0 };
            processing.follow(1e-3 * f64::from(step), [current_a, 100.0], 12.0);
            if step == 50 {
                assert!((processing.speed_rad_s() - 63.2).abs() < 0.1);
            }
            if step == 800 {
                assert!(processing.mean_current_a(0.8).abs() < 1e-12);
            }
        }
        let means = [1.0, 1.0, 1.1].map(|time_s| processing.mean_current_a(time_s));
        assert!(means.iter().all(|mean| (mean - 1.0).abs() < 1e-12), "{means:?}");
    }
}
