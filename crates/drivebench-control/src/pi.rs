//! PI regulator with anti-windup, bumpless start and bumpless change of gains (Åström and Hägglund, Advanced PID Control,
//! 2006, sections 3.5 and 13.3).

use serde::{Deserialize, Serialize};

use super::limiter::limited;
use super::loop_shape::lag_share;
use super::notch::NotchMemory;
use super::{Holding, Measured, NextStep, PiGains, SpeedController};

/// What the integral part does while the output is limited.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AntiWindup {
    /// It integrates on: windup, for comparison.
    Off,
    /// Conditional integration: it stands still while the error would drive it further into the limit.
    Clamp,
    /// Tracking: it follows the steady-state output of the speed at which the next output acts, so that the loop leaves the
    /// limit as from steady state at that speed.
    #[default]
    Hold,
}

/// `u = Kp e + I`, `I` grows by `Kp T/Tn e` per cycle; `e` after the notch, where the gains have one.
#[derive(Clone, Debug)]
pub struct Pi {
    gains: PiGains,
    /// Of the tuned proportional gain.
    pub(super) share: f64,
    anti_windup: AntiWindup,
    holding: Holding,
    /// From a sample to the end of its limited output, s.
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
    /// Integral part beyond the holding output: the load that the model does not have.
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

    /// For a loop in which a limited output ends so long after its sample, s.
    #[must_use]
    pub const fn leaving_after(mut self, leaving_s: f64) -> Self {
        self.leaving_s = leaving_s;
        self
    }

    pub const fn gains(&self) -> &PiGains {
        &self.gains
    }

    /// A reduced share as text after the gain.
    pub(super) fn share_text(&self) -> String {
        if self.share < 1.0 {
            format!(" ({:.0} % of the tuned one, because the loop oscillated)", 100.0 * self.share)
        } else {
            String::new()
        }
    }

    pub fn is_limited(&self) -> bool {
        self.limited.abs() > 0.0
    }

    /// New gains without a step of the output in the next cycle: the error that counts is the one behind the reference's
    /// filter and the notch.
    pub fn set_gains(&mut self, gains: PiGains, next: NextStep) {
        let NextStep { reference_rad_s, speed_rad_s, period_s } = next;
        let error = |pi: &Self| {
            let error = pi.filtered(reference_rad_s, speed_rad_s, period_s) - speed_rad_s;
            pi.gains.proportional * pi.notch.output(pi.gains.notch.as_ref(), error, period_s)
        };
        let before = error(self);
        self.gains = gains;
        self.integral += before - error(self);
    }

    /// The reference after its filter in this cycle.
    fn filtered(&self, reference_rad_s: f64, speed_rad_s: f64, period_s: f64) -> f64 {
        if self.is_planned {
            return reference_rad_s;
        }
        let share = lag_share(period_s, self.gains.reference_filter_s);
        // A start from rest or after a stop begins at the measured speed.
        let before = self.reference_rad_s.unwrap_or(speed_rad_s);
        before + share * (reference_rad_s - before)
    }
}

impl SpeedController for Pi {
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
            // A limit within the drive: it cuts on the side of the error.
            self.limited = error.signum();
        }
        let growth = self.gains.proportional * period_s / self.gains.integral_time_s * error;
        let outward = growth * self.limited > 0.0;
        match self.anti_windup {
            AntiWindup::Clamp if outward => {}
            AntiWindup::Hold if outward => {
                let acceleration = (speed_rad_s - self.speed_rad_s) / period_s;
                // A speed that would come nearer than this before the limit is left is that of another inertia than the
                // gains are for.
                let lead = (self.leaving_s * acceleration / error).clamp(0.0, 0.4) * error;
                self.integral = self.holding.output(speed_rad_s + lead) + self.load;
            }
            _ => {
                // Before the growth: the growth by a step that reaches the limit is no load.
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
            AntiWindup::Hold => "follows the steady-state output of the present speed",
        };
        vec![
            if self.share < 1.0 {
                self.gains.text(&self.share_text())
            } else {
                format!("{}, fixed", self.gains.text(""))
            },
            format!("while the output is limited the integral part {integral}"),
        ]
    }

    fn can_reduce_gain(&self) -> bool {
        true
    }

    fn set_gain_share(&mut self, share: f64, next: NextStep) {
        let mut gains = self.gains;
        gains.proportional *= share / self.share;
        self.share = share;
        self.set_gains(gains, next);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Notch;
    use crate::testing::{assert_close, pi_gains};

    fn pi(anti_windup: AntiWindup, notch: Option<Notch>) -> Pi {
        let holding = Holding { per_speed: 0.35, against: 0.0 };
        Pi::new(PiGains { notch, ..pi_gains(2.0, 0.5) }, anti_windup, holding)
    }

    const NOTCH: Notch = Notch { frequency_hz: 22.0, damping_ratio: 0.3, depth: 0.1 };

    #[test]
    fn it_resets_without_a_step_and_is_the_sum_of_its_parts() {
        for notch in [None, Some(NOTCH)] {
            let mut pi = pi(AntiWindup::Hold, notch);
            let mut filter = NotchMemory::at_rest();
            let mut integral = 36.5;
            // A state that the reset clears.
            pi.step(300.0, &Measured::at(0.0), 0.01);
            pi.reset(&Measured::at(100.0), integral);
            for (reference, speed) in
                [(100.0, 100.0), (110.0, 100.0), (110.0, 103.0), (90.0, 106.0), (95.0, 107.0)]
            {
                let output = pi.step(reference, &Measured::at(speed), 0.01);
                pi.applied(output);
                let error = filter.pass(notch.as_ref(), reference - speed, 0.01);
                integral += 2.0 * 0.01 / 0.5 * error;
                assert_close(output, 2.0 * error + integral, 1e-12);
            }
        }
    }

    #[test]
    fn new_gains_do_not_move_the_output() {
        let other = Notch { frequency_hz: 30.0, ..NOTCH };
        for (reference_filter_s, notches) in [
            (0.0, [None, None]),
            (0.2, [None, None]),
            (0.2, [Some(NOTCH), Some(other)]),
            (0.0, [Some(NOTCH), None]),
        ] {
            let gains = |proportional, notch| PiGains {
                reference_filter_s,
                notch,
                ..pi_gains(proportional, 1e9)
            };
            let mut pi = pi(AntiWindup::Hold, None);
            pi.gains = gains(2.0, notches[0]);
            pi.reset(&Measured::at(2.0), 0.7);
            pi.step(10.0, &Measured::at(2.0), 0.01);
            let mut same = pi.clone();
            let next = NextStep { reference_rad_s: 10.0, speed_rad_s: 2.0, period_s: 0.01 };
            pi.set_gains(gains(6.0, notches[1]), next);
            let [moved, stayed] =
                [&mut pi, &mut same].map(|pi| pi.step(10.0, &Measured::at(2.0), 0.01));
            assert_close(moved, stayed, 1e-6);
        }
    }

    /// Overshoot of an integrating load behind a limit of 5 above the back-EMF, at the end of a long acceleration. The limit
    /// is the host's, or the drive's, which reports it or does not.
    fn overshoot(anti_windup: AntiWindup, notch: Option<Notch>, of_drive: Option<bool>) -> f64 {
        let mut pi = pi(anti_windup, notch);
        let (mut speed, mut limited, mut most) = (0.0_f64, false, 0.0_f64);
        for _ in 0..4000 {
            let reported = limited && of_drive == Some(true);
            let now = Measured { limited: reported, ..Measured::at(speed) };
            let wanted = pi.step(100.0, &now, 0.01);
            let back_emf = 0.35 * speed;
            let output = wanted.clamp(back_emf - 5.0, back_emf + 5.0);
            pi.applied(if of_drive.is_some() { wanted } else { output });
            limited = (output - wanted).abs() > 0.0;
            speed += 0.01 * 10.0 * (output - back_emf);
            most = most.max(speed);
        }
        assert_close(speed, 100.0, 1e-3);
        most - 100.0
    }

    #[test]
    fn the_integral_winds_up_only_without_anti_windup() {
        use AntiWindup::{Clamp, Hold, Off};
        for (name, anti_windup, notch, of_drive, winds_up) in [
            ("off", Off, None, None, true),
            ("off, notch", Off, Some(NOTCH), None, true),
            ("clamp", Clamp, None, None, false),
            ("clamp, notch", Clamp, Some(NOTCH), None, false),
            ("hold", Hold, None, None, false),
            ("hold, notch", Hold, Some(NOTCH), None, false),
            ("limit of the drive", Hold, None, Some(true), false),
            ("limit of the drive, not reported", Hold, None, Some(false), true),
        ] {
            let found = overshoot(anti_windup, notch, of_drive);
            assert!(if winds_up { found > 20.0 } else { found < 5.0 }, "{name}: {found}");
        }
    }
}
