//! ADDC of paper A: a self-tuning PI regulator (Åström and Wittenmark, Adaptive Control, 1995, chapter 3), scheduled by the
//! inertia that is identified on line.
//!
//! The paper prints no tuning rule: here it is one of [`tuning`](super::tuning), worked out for every inertia beforehand.
//! Where the winding's time constant is identified as well, its share of Kp follows ([`super::electrical`]).
//! Gains change at a bounded rate, within bounds from the estimate's uncertainty (cautious control), and are held while
//! the estimate is not settled or the output is limited.

use super::adaptation::LoadEstimator;
use super::electrical::Electrical;
use super::tuning::{NotchUse, Request, TuningError};
use super::{
    Adapted, AntiWindup, Holding, LinearPlant, LoopTiming, Measured, NextStep, Pi, PiGains,
    Schedule, SpeedController,
};
use drivebench_model::plant::{Model, MotorKey};

const NOT_SETTLED: &str = "the estimate is not settled";

#[derive(Clone, Debug)]
pub struct AddcSettings {
    pub request: Request,
    /// Forgetting factor; that of paper A's Figure 6 by default.
    pub forgetting: f64,
    /// Standard deviation of a speed sample, rad/s.
    pub noise_rad_s: f64,
    pub holding: Holding,
    pub draws: Vec<LinearPlant>,
}

impl AddcSettings {
    pub fn new(holding: Holding, noise_rad_s: f64) -> Self {
        Self {
            request: Request::default(),
            forgetting: 0.96,
            noise_rad_s,
            holding,
            draws: Vec::new(),
        }
    }
}

#[derive(Clone, Debug)]
pub struct Addc {
    pi: Pi,
    schedule: Schedule,
    estimator: LoadEstimator,
    electrical: Option<Electrical>,
    /// Part of the winding's voltage.
    fed_forward_v: f64,
    request: Request,
    draws: Vec<LinearPlant>,
    torque_n_m_per_a: f64,
    /// Kt/J of the model: the ratio of the schedule refers to it.
    model_acceleration_per_a: f64,
    model_mechanical_s: f64,
    /// Why the gains do not move in this cycle.
    hold_reason: Option<&'static str>,
    moved: bool,
    /// Gain, inertia ratio and jumps of the last line of the log.
    logged: (f64, f64, u32),
}

impl Addc {
    pub const ID: &str = "addc";

    pub fn new(
        model: &Model,
        plant: &LinearPlant,
        timing: &LoopTiming,
        settings: &AddcSettings,
    ) -> Result<Self, TuningError> {
        let schedule = Schedule::new(plant, &settings.draws, timing, &settings.request)?;
        let value = |key| model.motor.get(key).unwrap_or(0.0);
        let inertia = value(MotorKey::Inertia);
        let acceleration_per_a = model.motor.torque_constant().unwrap_or(0.0) / inertia;
        let estimator = LoadEstimator::new(
            acceleration_per_a,
            value(MotorKey::LoadTorque) / inertia,
            settings.forgetting,
            settings.noise_rad_s,
        );
        let estimator = match plant.coupling() {
            Some(coupling) => estimator.with_torsion_period(coupling.frequency_hz.recip()),
            None => estimator,
        };
        let gains = schedule.at(1.0).gains;
        Ok(Self {
            pi: Pi::new(gains, AntiWindup::Hold, settings.holding)
                .leaving_after(timing.leaving_s()),
            schedule,
            estimator,
            electrical: None,
            fed_forward_v: 0.0,
            request: Request {
                notch: gains.notch.map_or(NotchUse::Off, NotchUse::Like),
                ..settings.request
            },
            draws: settings.draws.clone(),
            torque_n_m_per_a: model.motor.torque_constant().unwrap_or(f64::NAN),
            model_acceleration_per_a: acceleration_per_a,
            model_mechanical_s: model.motor.mechanical_time_constant_s().unwrap_or(0.0),
            hold_reason: Some(NOT_SETTLED),
            moved: false,
            logged: (gains.proportional, 1.0, 0),
        })
    }

    /// With gains that follow the time constant of the winding too; over a voltage only.
    pub fn adapting_to_the_winding(
        mut self,
        model: &Model,
        viscous_n_m_s_per_rad: f64,
        timing: &LoopTiming,
    ) -> Result<Self, TuningError> {
        let (draws, request) = (&self.draws, &self.request);
        self.electrical = Electrical::new(model, viscous_n_m_s_per_rad, draws, timing, request)?;
        Ok(self)
    }

    /// With exponential forgetting alone, as in paper A.
    #[must_use]
    pub fn without_change_detection(mut self) -> Self {
        self.estimator = self.estimator.without_change_detection();
        self
    }

    pub fn is_settled(&self) -> bool {
        self.estimator.load().settled
    }

    pub fn inertia_ratio(&self) -> f64 {
        self.model_acceleration_per_a / self.estimator.load().acceleration_per_a
    }

    pub const fn pi(&self) -> &Pi {
        &self.pi
    }

    fn mechanical_text(&self) -> String {
        let ratio = self.inertia_ratio();
        if self.is_settled() {
            let mechanical_s = ratio * self.model_mechanical_s;
            format!("TM = {mechanical_s:.4} s ({ratio:.3} times the model's inertia)")
        } else {
            "TM is not settled".to_owned()
        }
    }

    fn adapt(&mut self, next: NextStep) {
        let load = self.estimator.load();
        self.moved = false;
        let limited = self.pi.is_limited().then_some("the output is limited");
        self.hold_reason = (!load.settled).then_some(NOT_SETTLED).or(limited);
        if self.hold_reason.is_some() {
            return;
        }
        let ratio = |acceleration: f64| self.model_acceleration_per_a / acceleration;
        // The gain has its margin within two standard deviations of the estimate.
        let lightest = ratio(load.acceleration_per_a + 2.0 * load.std);
        let middle = ratio(load.acceleration_per_a);
        let mut wanted = self.schedule.within(lightest, middle);
        if let Some(electrical) = &self.electrical {
            wanted = electrical.at(wanted, lightest, middle);
        }
        let now = *self.pi.gains();
        let proportional = self.pi.share * wanted.gains.proportional;
        let change = proportional / now.proportional;
        let outside = now.proportional > wanted.most_proportional;
        // Noise changes no gain.
        let band = 0.05_f64.max(3.0 * load.std / load.acceleration_per_a);
        if (change - 1.0).abs() < band && !outside {
            return;
        }
        // A gain changes by a factor of e in a tenth of a second at most.
        let most = (next.period_s / 0.1).exp();
        let moved = |from: f64, to: f64| to.clamp(from / most, from * most);
        let gains = PiGains {
            proportional: moved(now.proportional, proportional),
            integral_time_s: moved(now.integral_time_s, wanted.gains.integral_time_s),
            ..wanted.gains
        };
        self.pi.set_gains(gains, next);
        self.moved = true;
    }
}

impl SpeedController for Addc {
    fn follow_plan(&mut self) -> bool {
        self.pi.follow_plan()
    }

    fn step(&mut self, reference_rad_s: f64, now: &Measured, period_s: f64) -> f64 {
        self.estimator.push(now.current_a, now.speed_rad_s, period_s);
        if let Some(electrical) = &mut self.electrical {
            electrical.push(now, period_s);
        }
        self.adapt(NextStep { reference_rad_s, speed_rad_s: now.speed_rad_s, period_s });
        self.pi.step(reference_rad_s, now, period_s)
    }

    fn fed_forward(&mut self, output: f64) {
        self.fed_forward_v = output;
    }

    fn applied(&mut self, output: f64) {
        self.pi.applied(output);
        if let Some(electrical) = &mut self.electrical {
            electrical.applied(output + self.fed_forward_v);
        }
    }

    fn reset(&mut self, now: &Measured, output: f64) {
        self.pi.reset(now, output);
    }

    fn explain(&self) -> Vec<String> {
        let hold_reason = self.hold_reason.map(|why| format!("are held: {why}"));
        let state = hold_reason.unwrap_or_else(|| "follow the estimate".to_owned());
        let electrical = self.electrical.as_ref().map(|one| format!("; {}", one.text()));
        vec![
            format!("{}; {}", self.pi.gains().text(&self.pi.share_text()), self.mechanical_text()),
            format!("gains {state}{}", electrical.unwrap_or_default()),
        ]
    }

    fn gain_change(&mut self) -> Option<String> {
        let gains = self.pi.gains();
        let (logged_proportional, logged_ratio, logged_jumps) = self.logged;
        let jumps = self.estimator.jumps;
        // One line for a change that takes some cycles, at its end.
        let has_changed = |now: f64, logged: f64| (now / logged - 1.0).abs() > 0.01;
        let arrived = !self.moved && has_changed(gains.proportional, logged_proportional);
        if !arrived && jumps <= logged_jumps {
            return None;
        }
        let ratio = self.inertia_ratio();
        let because = if jumps > logged_jumps {
            "the load changed: the covariance of the estimate was reset"
        } else if has_changed(ratio, logged_ratio) {
            "the estimate changed"
        } else {
            "the gains have reached the estimate"
        };
        let line = format!(
            "Kp {logged_proportional:.4} -> {:.4}, Tn {:.4} s: {because}; {}",
            gains.proportional,
            gains.integral_time_s,
            self.mechanical_text()
        );
        self.logged = (gains.proportional, ratio, jumps);
        Some(line)
    }

    fn adapted(&self) -> Option<Adapted> {
        let gains = self.pi.gains();
        let load = Some(self.estimator.load()).filter(|load| load.settled);
        let inertia = load.map(|load| self.torque_n_m_per_a / load.acceleration_per_a);
        Some(Adapted {
            proportional: gains.proportional,
            integral_time_s: gains.integral_time_s,
            mechanical_s: load.map(|_| self.inertia_ratio() * self.model_mechanical_s),
            electrical_s: self.electrical.as_ref().and_then(Electrical::time_constant_s),
            inertia_kg_m2: inertia,
            load_torque_n_m: load.zip(inertia).map(|(load, j)| load.friction_rad_s2 * j),
        })
    }

    fn can_reduce_gain(&self) -> bool {
        true
    }

    fn set_gain_share(&mut self, share: f64, next: NextStep) {
        self.pi.set_gain_share(share, next);
        // The caller logs this change.
        self.logged.0 = self.pi.gains().proportional;
    }
}
