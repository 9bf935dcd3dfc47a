//! PI regulator with anti-windup, bumpless start and bumpless change of gains.

use serde::{Deserialize, Serialize};

use super::limiter::limited;
use super::loop_shape::lag_share;
use super::notch::NotchMemory;
use super::{Holding, Measured, PiGains, SpeedController};

/// Share of the error by which the speed is at most taken further than it is seen: what would gain more until it leaves the
/// limit is another inertia than the gains are for.
const MOST_LEAD: f64 = 0.4;

/// What the integral part does while the output is limited.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AntiWindup {
    /// It goes on: the textbook's windup, for comparison.
    Off,
    /// It stands still while the error would drive it further into the limit.
    Clamp,
    /// It follows what holds the speed that is there when an output acts, so that the loop leaves the limit as from rest at
    /// that speed.
    #[default]
    Hold,
}

/// `u = Kp e + I`, `I` grows by `Kp T/Tn e` per cycle; `e` behind the notch, where the gains have one.
#[derive(Clone, Debug)]
pub struct Pi {
    gains: PiGains,
    /// What is left of the proportional gain that the tuning gives.
    share: f64,
    anti_windup: AntiWindup,
    holding: Holding,
    /// By how much what is seen is older than what leaves the limit, s.
    leaving_s: f64,
    /// Of the last cycle.
    speed_rad_s: f64,
    integral: f64,
    /// The reference after its filter; `None` before the first step.
    reference_rad_s: Option<f64>,
    notch: NotchMemory,
    wanted: f64,
    /// Sign of the limit that held the last output: +1 where more was wanted than was given.
    limited: f64,
    /// What the integral holds beyond the model: the load that nobody told us.
    load: f64,
    /// The reference is a planned motion: it needs no filter, and no holding output of this controller.
    is_planned: bool,
}

impl Pi {
    pub const ID: &str = "pi";

    pub const fn new(gains: PiGains, anti_windup: AntiWindup, holding: Holding) -> Self {
        Self {
            gains,
            share: 1.0,
            anti_windup,
            holding,
            leaving_s: 0.0,
            speed_rad_s: 0.0,
            integral: 0.0,
            reference_rad_s: None,
            notch: NotchMemory::at_rest(),
            wanted: 0.0,
            limited: 0.0,
            load: 0.0,
            is_planned: false,
        }
    }

    /// The same in a loop that leaves its limit so late after what it sees.
    #[must_use]
    pub const fn leaving_after(mut self, leaving_s: f64) -> Self {
        self.leaving_s = leaving_s;
        self
    }

    pub const fn gains(&self) -> &PiGains {
        &self.gains
    }

    /// What is left of the proportional gain that the tuning gives: less where the loop swung.
    pub const fn share(&self) -> f64 {
        self.share
    }

    /// The same in words, after the gain; empty where it is the tuned one.
    pub(super) fn softened_text(&self) -> String {
        if self.share < 1.0 {
            let percent = 100.0 * self.share;
            format!(" ({percent:.0} % of the tuned one, for the loop swung)")
        } else {
            String::new()
        }
    }

    /// Whether the last output was cut by a limit.
    pub fn is_limited(&self) -> bool {
        self.limited.abs() > 0.0
    }

    /// New gains without a step of the output in the cycle that comes, which has this reference and this speed: the error
    /// that counts is the one behind the reference's filter and the notch.
    pub fn set_gains(
        &mut self,
        gains: PiGains,
        reference_rad_s: f64,
        speed_rad_s: f64,
        period_s: f64,
    ) {
        let error = |pi: &Self| {
            let error = pi.filtered(reference_rad_s, speed_rad_s, period_s) - speed_rad_s;
            let notch = pi.gains.notch.as_ref();
            pi.gains.proportional * pi.notch.answer(notch, error, period_s)
        };
        let before = error(self);
        self.gains = gains;
        self.integral += before - error(self);
    }

    /// The reference behind its filter in this cycle.
    fn filtered(&self, reference_rad_s: f64, speed_rad_s: f64, period_s: f64) -> f64 {
        if self.is_planned {
            return reference_rad_s;
        }
        let share = lag_share(period_s, self.gains.reference_filter_s);
        // A start from rest or after a stop begins at the speed that is there.
        let before = self.reference_rad_s.unwrap_or(speed_rad_s);
        before + share * (reference_rad_s - before)
    }
}

impl SpeedController for Pi {
    fn id(&self) -> &'static str {
        Self::ID
    }

    fn follow_plan(&mut self) -> bool {
        self.is_planned = true;
        self.holding = Holding::default();
        true
    }

    fn step(&mut self, reference_rad_s: f64, now: &Measured, period_s: f64) -> f64 {
        let speed_rad_s = now.speed_rad_s;
        let filtered = self.filtered(reference_rad_s, speed_rad_s, period_s);
        self.reference_rad_s = Some(filtered);
        let error = filtered - speed_rad_s;
        let error = (self.notch).pass(self.gains.notch.as_ref(), error, period_s);
        if now.limited && !self.is_limited() {
            // A limit of the drive that this side does not see: what it gives less lies on the side of the error.
            self.limited = error.signum();
        }
        let growth = self.gains.proportional * period_s / self.gains.integral_time_s * error;
        let outward = growth * self.limited > 0.0;
        match self.anti_windup {
            AntiWindup::Clamp if outward => {}
            AntiWindup::Hold if outward => {
                let gained = (speed_rad_s - self.speed_rad_s) / period_s;
                let lead = (self.leaving_s * gained / error).clamp(0.0, MOST_LEAD) * error;
                self.integral = self.holding.output(speed_rad_s + lead) + self.load;
            }
            _ => {
                // Before the growth: that of a step which takes the output to its limit is no load.
                if !self.is_limited() {
                    self.load = self.integral - self.holding.output(speed_rad_s);
                }
                self.integral += growth;
            }
        }
        self.speed_rad_s = speed_rad_s;
        self.wanted = self.gains.proportional * error + self.integral;
        self.wanted
    }

    fn applied(&mut self, output: f64) {
        self.limited = limited(self.wanted, output);
    }

    fn reset(&mut self, now: &Measured, output: f64) {
        self.integral = output;
        self.speed_rad_s = now.speed_rad_s;
        self.load = 0.0;
        self.limited = 0.0;
        self.wanted = output;
        self.reference_rad_s = Some(now.speed_rad_s);
        self.notch = NotchMemory::at_rest();
    }

    fn explain(&self) -> Vec<String> {
        let integral = match self.anti_windup {
            AntiWindup::Off => "goes on growing",
            AntiWindup::Clamp => "stands still",
            AntiWindup::Hold => "follows what holds the present speed",
        };
        vec![
            if self.share < 1.0 {
                self.gains.text(&self.softened_text())
            } else {
                format!("{}, fixed", self.gains.text(""))
            },
            format!("while the output is limited the integral part {integral}"),
        ]
    }

    fn softens(&self) -> bool {
        true
    }

    fn soften(&mut self, share: f64, reference_rad_s: f64, speed_rad_s: f64, period_s: f64) {
        let mut gains = self.gains;
        gains.proportional *= share / self.share;
        self.share = share;
        self.set_gains(gains, reference_rad_s, speed_rad_s, period_s);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Notch;
    use crate::testing::assert_close;

    fn gains() -> PiGains {
        PiGains { proportional: 2.0, integral_time_s: 0.5, reference_filter_s: 0.0, notch: None }
    }

    fn holding() -> Holding {
        Holding { per_speed: 0.35, against: 0.0 }
    }

    #[test]
    fn unlimited_it_is_the_sum_of_its_parts() {
        let mut pi = Pi::new(gains(), AntiWindup::Hold, holding());
        let mut integral = 0.0;
        for (reference, speed) in [(10.0, 0.0), (10.0, 3.0), (-5.0, 6.0), (-5.0, 7.0)] {
            let output = pi.step(reference, &Measured::at(speed), 0.01);
            pi.applied(output);
            integral += 2.0 * 0.01 / 0.5 * (reference - speed);
            assert_close(output, 2.0 * (reference - speed) + integral, 1e-12);
        }
    }

    #[test]
    fn a_reset_starts_without_a_step_of_the_output() {
        let mut pi = Pi::new(gains(), AntiWindup::Hold, holding());
        pi.reset(&Measured::at(100.0), 36.5);
        assert_close(pi.step(100.0, &Measured::at(100.0), 0.01), 36.5, 1e-12);
    }

    const NOTCH: Notch = Notch { frequency_hz: 22.0, damping_ratio: 0.3, depth: 0.1 };

    #[test]
    fn with_a_notch_it_starts_and_resets_without_a_step_and_regulates_what_the_notch_leaves() {
        let gains = PiGains { notch: Some(NOTCH), ..gains() };
        let mut pi = Pi::new(gains, AntiWindup::Hold, holding());
        let mut notch = NotchMemory::at_rest();
        let mut integral = 36.5;
        // Something of before, which is forgotten.
        pi.step(300.0, &Measured::at(0.0), 0.01);
        pi.reset(&Measured::at(100.0), 36.5);
        assert_close(pi.step(100.0, &Measured::at(100.0), 0.01), 36.5, 1e-12);
        notch.pass(Some(&NOTCH), 0.0, 0.01);
        for (reference, speed) in [(110.0, 100.0), (110.0, 103.0), (90.0, 106.0)] {
            let output = pi.step(reference, &Measured::at(speed), 0.01);
            pi.applied(output);
            let error = notch.pass(Some(&NOTCH), reference - speed, 0.01);
            integral += 2.0 * 0.01 / 0.5 * error;
            assert_close(output, 2.0 * error + integral, 1e-12);
        }
    }

    #[test]
    fn new_gains_do_not_move_the_output_whatever_filter_and_notch_hold_back() {
        let other = Notch { frequency_hz: 30.0, ..NOTCH };
        for (reference_filter_s, notches) in [
            (0.0, [None, None]),
            (0.2, [None, None]),
            (0.2, [Some(NOTCH), Some(other)]),
            (0.0, [Some(NOTCH), None]),
        ] {
            let gains = |proportional| PiGains {
                proportional,
                integral_time_s: 1e9,
                reference_filter_s,
                notch: notches[usize::from(proportional > 4.0)],
            };
            let mut pi = Pi::new(gains(2.0), AntiWindup::Hold, holding());
            pi.reset(&Measured::at(2.0), 0.7);
            pi.step(10.0, &Measured::at(2.0), 0.01);
            let mut same = pi.clone();
            pi.set_gains(gains(6.0), 10.0, 2.0, 0.01);
            let [moved, stayed] =
                [&mut pi, &mut same].map(|pi| pi.step(10.0, &Measured::at(2.0), 0.01));
            assert_close(moved, stayed, 1e-6);
        }
    }

    /// An integrating load, limited hard: what is beyond the reference at the end of a long acceleration.
    fn overshoot(anti_windup: AntiWindup, notch: Option<Notch>) -> f64 {
        let gains = PiGains { notch, ..gains() };
        let mut pi = Pi::new(gains, anti_windup, holding());
        let (mut speed, mut most) = (0.0_f64, 0.0_f64);
        for _ in 0..4000 {
            let wanted = pi.step(100.0, &Measured::at(speed), 0.01);
            let back_emf = 0.35 * speed;
            let output = wanted.clamp(back_emf - 5.0, back_emf + 5.0);
            pi.applied(output);
            speed += 0.01 * 10.0 * (output - back_emf);
            most = most.max(speed);
        }
        assert_close(speed, 100.0, 1e-3);
        most - 100.0
    }

    #[test]
    fn a_limit_that_only_the_drive_sees_does_not_wind_up_either() {
        // The drive gives 5 above the back-EMF, whatever is asked, and says that it limits.
        let most_with = |says: bool| {
            let mut pi = Pi::new(gains(), AntiWindup::Hold, holding());
            let (mut speed, mut limited, mut most) = (0.0_f64, false, 0.0_f64);
            for _ in 0..4000 {
                let now = Measured { limited: limited && says, ..Measured::at(speed) };
                let wanted = pi.step(100.0, &now, 0.01);
                pi.applied(wanted);
                let back_emf = 0.35 * speed;
                let output = wanted.clamp(back_emf - 5.0, back_emf + 5.0);
                limited = (output - wanted).abs() > 0.0;
                speed += 0.01 * 10.0 * (output - back_emf);
                most = most.max(speed);
            }
            most - 100.0
        };
        assert!(most_with(true) < 5.0, "{}", most_with(true));
        assert!(most_with(false) > 20.0, "{}", most_with(false));
    }

    #[test]
    fn the_integral_winds_up_only_where_it_is_let() {
        for notch in [None, Some(NOTCH)] {
            let [off, clamp, hold] = [AntiWindup::Off, AntiWindup::Clamp, AntiWindup::Hold]
                .map(|anti_windup| overshoot(anti_windup, notch));
            assert!(off > 20.0, "{off}");
            assert!(clamp < 5.0 && hold < 5.0, "{notch:?}: {clamp} {hold}");
        }
    }
}
