//! What needs no voltage: the angle against the speed, and a speed that grows beyond its reference.

use super::history::Range;
use super::{
    ANY, CHECK_ENCODER, CONFIRM, Plausibility, REST_SPEED, RUNAWAY_BEYOND, RUNAWAY_CYCLES,
    RUNAWAY_GROWTH, SAME, WINDOW,
};
use crate::bench::guard::{Trip, TripKind};

impl Plausibility {
    /// The angle turned over the last cycles against the speed.
    pub(super) fn by_angle(&mut self, now_s: f64) -> Option<Trip> {
        // An angle that is read more seldom than it is asked stays for some cycles; the confirmations come on top.
        let times = if self.is_exact() { 1 } else { 2 };
        let rows = times * self.cycles() - CONFIRM;
        let all = self.history.rows();
        if all.len() < rows {
            return None;
        }
        let (mut seconds, mut turned, mut speeds) = (0.0, 0.0, None);
        let (mut by_speed, mut widest) = (0.0, 0.0_f64);
        // A counter that was set anew is no motion: the one row that fits least does not count.
        let mut worst = (0.0, 0.0, 0.0);
        for row in all.iter().skip(all.len() - rows) {
            let row_rad = row.turned_rad?;
            let misfit = (row_rad - row.speed_rad_s * row.seconds).abs();
            if misfit >= worst.0 {
                worst = (misfit, row_rad, row.seconds);
            }
            turned += row_rad;
            by_speed += row.speed_rad_s * row.seconds;
            widest = widest.max(row.speed_change_rad_s.abs());
            seconds += row.seconds;
            let half = 0.5 * row.speed_change_rad_s.abs();
            let range = Range::around(row.speed_rad_s, half);
            speeds = Some(speeds.map_or(range, |speeds: Range| speeds.hull(range)));
        }
        let rate = (turned - worst.1) / (seconds - worst.2);
        // Where each speed has its time the mean says more than the lowest and the highest of them.
        let speeds = if self.is_exact() {
            Range::around(by_speed / seconds, widest)
        } else {
            speeds?
        };
        let believed = speeds.times(ANY).wider(2.0 * REST_SPEED * self.scale.rad_s);
        if believed.gap(Range::new(rate, rate)) <= 0.0 {
            self.angle_disagrees = 0;
            return None;
        }
        self.angle_disagrees += 1;
        if self.angle_disagrees < CONFIRM {
            return None;
        }
        let speed = speeds.middle();
        let what = format!(
            "the angle turns by {rate:.1} rad/s, the measured speed is {speed:.1} rad/s, {:.1} to {:.1} rad/s would be believed; {CHECK_ENCODER}",
            believed.low, believed.high
        );
        let kind = if self.speed.run() >= SAME {
            TripKind::EncoderFrozen
        } else {
            TripKind::AngleImplausible
        };
        Some(Trip::implausible(kind, now_s, (rate, speed), &what))
    }

    /// The speed grows beyond its reference although the torque is against it.
    pub(super) fn runs_away(&mut self, now_s: f64) -> Option<Trip> {
        let row = *self.history.rows().back()?;
        let speed = self.history.last()?.speed_rad_s?;
        let reference = self.reference_rad_s?;
        let direction = speed.signum();
        let beyond = direction * (speed - reference);
        let grows = direction * row.speed_change_rad_s > 0.0;
        let braked = direction * row.current_a < 0.0;
        if !(grows && braked && beyond > RUNAWAY_BEYOND * self.speed_limit_rad_s) {
            self.away.clear();
            return None;
        }
        if self.away.is_empty() {
            self.away.push(speed - row.speed_change_rad_s);
        }
        self.away.push(speed);
        let growth = direction * (speed - self.away[0]);
        let long = self.away.len() > RUNAWAY_CYCLES;
        if !(long && growth > RUNAWAY_GROWTH * self.speed_limit_rad_s) {
            return None;
        }
        // Seen by a reversed encoder the shaft runs away as soon as it moves.
        let window = self
            .plate
            .and_then(|plate| Some((plate, self.window(&plate, WINDOW)?)));
        Some(match window {
            Some((plate, window)) if window.misfit(-1.0) < window.misfit(1.0) => {
                self.speed_trip(TripKind::EncoderReversed, now_s, &plate, &window)
            }
            _ => Trip::runaway(now_s, speed, reference),
        })
    }
}
