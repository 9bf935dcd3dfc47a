//! Electrical time constant Ta = L/R while the loop runs: recursive identification by scheme 3 over measurements and applied
//! voltages, and a second scheduling variable of the gains.
//!
//! Ta is part of the small time constant of the loop, and so of Kp. The gains are tuned beforehand for half and for twice the
//! model's Ta and interpolated between. Without settled R and L the model's is kept.

use super::schedule::{Schedule, Scheduled};
use super::tuning::{Request, TuningError};
use super::{LinearPlant, LoopTiming, Measured};
use drivebench_identify::recursive::{Memory, Scheme3, StartValues};
use drivebench_model::plant::{Model, MotorKey};
use drivebench_model::sample::{ParameterEstimate, Verdict};

/// Bounds of Ta, as a factor of the model's either way.
const RANGE: f64 = 2.0;
/// Cycles between two evaluations of the estimates: a winding warms up in minutes.
const CYCLES: u32 = 10;

#[derive(Clone, Debug)]
pub(super) struct Electrical {
    scheme: Scheme3,
    delay_s: f64,
    model_s: f64,
    time_s: f64,
    until_evaluation: u32,
    /// Ta over the model's, and its standard deviation.
    found: Option<(f64, f64)>,
    shortest: Schedule,
    longest: Schedule,
}

impl Electrical {
    /// `None` for a model without a winding.
    pub(super) fn new(
        model: &Model,
        viscous_n_m_s_per_rad: f64,
        draws: &[LinearPlant],
        timing: &LoopTiming,
        request: &Request,
    ) -> Result<Option<Self>, TuningError> {
        let motor = &model.motor;
        let (Some(model_s), Some(l)) =
            (motor.electrical_time_constant_s(), motor.get(MotorKey::Inductance))
        else {
            return Ok(None);
        };
        let plant = |factor: f64| {
            let mut other = model.clone();
            other.motor.set(MotorKey::Inductance, factor * l);
            LinearPlant::voltage(&other, viscous_n_m_s_per_rad)
        };
        let (Ok(short), Ok(long)) = (plant(1.0 / RANGE), plant(RANGE)) else { return Ok(None) };
        let schedule = |plant: &LinearPlant, factor: f64| {
            let scaled = draws.iter().map(|draw| draw.with_inductance_ratio(factor));
            Schedule::new(plant, &scaled.collect::<Vec<_>>(), timing, request)
        };
        Ok(Some(Self {
            scheme: Scheme3::new(
                Memory::default(),
                motor.torque_constant(),
                StartValues::from_motor(motor),
            ),
            delay_s: timing.delay_s,
            model_s,
            time_s: 0.0,
            until_evaluation: CYCLES,
            found: None,
            shortest: schedule(&short, 1.0 / RANGE)?,
            longest: schedule(&long, RANGE)?,
        }))
    }

    /// Ta, s, where it is known.
    pub(super) fn time_constant_s(&self) -> Option<f64> {
        self.found.map(|(ratio, _)| ratio * self.model_s)
    }

    pub(super) fn text(&self) -> String {
        match self.found {
            Some((ratio, _)) => {
                format!("Ta = {:.2} ms ({ratio:.2} times the model's)", 1e3 * ratio * self.model_s)
            }
            None => format!("Ta = {:.2} ms is the model's", 1e3 * self.model_s),
        }
    }

    pub(super) fn push(&mut self, now: &Measured, period_s: f64) {
        self.time_s += period_s;
        let Some(current) = now.current_a else { return };
        self.scheme.set_limited(now.limited);
        self.scheme.push(self.time_s, current, now.speed_rad_s);
        self.until_evaluation = self.until_evaluation.saturating_sub(1);
        if self.until_evaluation == 0 {
            self.until_evaluation = CYCLES;
            self.found = self.evaluate().or(self.found);
        }
    }

    /// The voltage computed from the last sample.
    pub(super) fn applied(&mut self, voltage_v: f64) {
        self.scheme.voltage_applied(self.time_s + self.delay_s, voltage_v);
    }

    /// Settled estimates with a relative standard deviation below a tenth.
    fn evaluate(&self) -> Option<(f64, f64)> {
        let estimates = self.scheme.estimates();
        let of = |key: MotorKey| {
            let found = ParameterEstimate::find(&estimates, key.key())?;
            let settled = found.verdict == Verdict::Settled;
            let (value, std) = found.value.zip(found.std).filter(|_| settled)?;
            (value > 0.0).then_some((value, std / value))
        };
        let (r, l) = (of(MotorKey::Resistance)?, of(MotorKey::Inductance)?);
        let ratio = l.0 / r.0 / self.model_s;
        let relative = r.1.hypot(l.1);
        (relative < 0.1).then_some((ratio, ratio * relative))
    }

    /// Gains for an inertia within two ratios to the model's, `base` at the model's Ta, at the Ta that was found; they keep
    /// their margin over two standard deviations of it.
    pub(super) fn at(&self, base: Scheduled, low: f64, ratio: f64) -> Scheduled {
        let Some((found, std)) = self.found else { return base };
        let at = |electrical: f64| {
            let position = electrical.clamp(1.0 / RANGE, RANGE).ln() / RANGE.ln();
            let bound = [&self.shortest, &self.longest][usize::from(position > 0.0)];
            base.interpolated(&bound.within(low, ratio), position.abs())
        };
        let mut scheduled = at(found);
        for end in [found - 2.0 * std, found + 2.0 * std] {
            let most = at(end).most_proportional;
            scheduled.most_proportional = scheduled.most_proportional.min(most);
        }
        let gains = &mut scheduled.gains;
        gains.proportional = gains.proportional.min(scheduled.most_proportional);
        scheduled
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{assert_close, inertia, machine, model, plant, timing};
    use crate::{
        Actuator, Addc, AddcSettings, Compensated, FeedForward, Holding, Limiter, SpeedController,
        Trial, TrialMachine,
    };

    #[test]
    fn the_gains_at_an_identified_ta_are_those_of_tuning_for_it() {
        let (model, timing, request) = (model(inertia(0.2)), timing(1.0), Request::default());
        let base = Schedule::new(&plant(inertia(0.2)), &[], &timing, &request).unwrap();
        let mut electrical = Electrical::new(&model, 0.0, &[], &timing, &request).unwrap().unwrap();
        let at = |electrical: &Electrical, ratio| {
            electrical.at(base.within(ratio, ratio), ratio, ratio).gains
        };
        assert_eq!(at(&electrical, 1.0), base.at(1.0).gains);
        for (ta, ratio) in [(0.6, 1.0), (1.5, 1.0), (0.8, 3.0), (2.0, 0.5)] {
            electrical.found = Some((ta, 0.0));
            let mut other = model.clone();
            other.motor.set(MotorKey::Inductance, 0.0099 * ta);
            other.motor.set(MotorKey::Inertia, inertia(0.2) * ratio);
            let plant = LinearPlant::voltage(&other, 0.0).unwrap();
            let exact = crate::tuning::tune(&plant, &timing, &request).unwrap();
            let found = at(&electrical, ratio);
            assert_close(found.proportional / exact.gains.proportional, 1.0, 0.06);
            assert_close(found.integral_time_s / exact.gains.integral_time_s, 1.0, 0.06);
        }
    }

    #[test]
    fn half_the_inductance_is_found_and_raises_the_gain() {
        let (model, timing) = (model(inertia(0.2)), timing(1.0));
        let plant = plant(inertia(0.2));
        let settings = AddcSettings::new(Holding::of(&model, Actuator::Voltage, 0.0), 0.15);
        let addc = Addc::new(&model, &plant, &timing, &settings).unwrap();
        let mut addc = addc.adapting_to_the_winding(&model, 0.0, &timing).unwrap();
        let machine = TrialMachine {
            inductance_h: 0.0055,
            drive_current_limit_a: 1e3,
            delay_periods: 1,
            speed_noise_rad_s: 0.05,
            current_noise_a: 0.01,
            ..machine(1.0)
        };
        let reference = |t: f64| if (t / 0.5).floor() % 2.0 == 0.0 { 90.0 } else { 100.0 };
        let limiter = Limiter { output: 110.0, current: None };
        // The feed-forward is part of the winding's voltage.
        let forward = FeedForward::new(&model, &[], Actuator::Voltage, &timing, 1e3).unwrap();
        let mut compensated = Compensated::new(Box::new(addc.clone()), forward);
        for controller in [&mut addc as &mut dyn SpeedController, &mut compensated] {
            Trial::new(machine, limiter, inertia(0.2), reference).run(controller, 20.0);
            let found = controller.adapted().and_then(|now| now.electrical_s);
            assert_close(found.unwrap() / 0.005, 1.0, 0.1);
        }
        let fixed = Addc::new(&model, &plant, &timing, &settings).unwrap();
        let [fixed, adapted] = [&fixed, &addc].map(|addc| addc.pi().gains().proportional);
        assert!(adapted > 1.08 * fixed, "{fixed} {adapted}");
    }
}
