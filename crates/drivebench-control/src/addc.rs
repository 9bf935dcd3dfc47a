//! ADDC of paper A: a PI regulator whose gains follow the inertia that is identified on line.
//!
//! The paper prints no tuning rule: here it is one of [`tuning`](super::tuning), worked out for every inertia beforehand.
//! Where the winding's time constant is identified as well, its share of Kp follows ([`super::electrical`]).
//! Gains change at a bounded rate, within bounds from the estimate's uncertainty, and stand still while the estimate is
//! not settled or the output is limited.

use super::adaptation::LoadEstimator;
use super::electrical::Electrical;
use super::tuning::{NotchUse, Request, TuningError};
use super::{
    Adapted, AntiWindup, Holding, LinearPlant, LoopTiming, Measured, Pi, Schedule, SpeedController,
};
use drivebench_model::plant::{Model, MotorKey};

/// Time in which a gain may change by a factor of e, s.
const GAIN_TIME_S: f64 = 0.1;
/// Relative change of the proportional gain below which it stays, at least and in standard deviations of the estimate: no
/// hunting for noise.
const DEAD_BAND: f64 = 0.05;
const DEAD_STDS: f64 = 3.0;
/// Relative change that is worth a line of the log, once the gains have come to rest.
const NEWS: f64 = 0.01;
/// Standard deviations of the estimate that the bounds allow for.
const DOUBT: f64 = 2.0;
/// Forgetting factor of paper A's Figure 6.
const FORGETTING: f64 = 0.96;

const NOT_SETTLED: &str = "the estimate is not settled";

/// What the regulator is made of.
#[derive(Clone, Debug)]
pub struct AddcSettings {
    pub request: Request,
    pub forgetting: f64,
    /// Standard deviation of a speed sample, rad/s.
    pub noise_rad_s: f64,
    pub holding: Holding,
    /// Draws of what is not known of the plant.
    pub draws: Vec<LinearPlant>,
}

impl AddcSettings {
    pub fn new(holding: Holding, noise_rad_s: f64) -> Self {
        Self {
            request: Request::default(),
            forgetting: FORGETTING,
            noise_rad_s,
            holding,
            draws: Vec::new(),
        }
    }
}

/// The self-tuning regulator.
#[derive(Clone, Debug)]
pub struct Addc {
    pi: Pi,
    schedule: Schedule,
    estimator: LoadEstimator,
    electrical: Option<Electrical>,
    /// What is given beside its output: the winding has both.
    beside: f64,
    request: Request,
    draws: Vec<LinearPlant>,
    torque_n_m_per_a: f64,
    /// Kt/J of the model: the ratio of the schedule refers to it.
    model_acceleration_per_a: f64,
    /// Mechanical time constant of the model, s.
    model_mechanical_s: f64,
    /// Why the gains do not move in this cycle.
    still: Option<&'static str>,
    /// The gains moved in this cycle.
    moved: bool,
    told_proportional: f64,
    told_ratio: f64,
    told_jumps: u32,
}

impl Addc {
    pub const ID: &str = "addc";

    /// # Errors
    /// What the tuning refuses at the model's own inertia.
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
            Some(coupling) => estimator.behind(coupling.frequency_hz.recip()),
            None => estimator,
        };
        let gains = schedule.at(1.0).gains;
        Ok(Self {
            pi: Pi::new(gains, AntiWindup::Hold, settings.holding)
                .leaving_after(timing.leaving_s()),
            schedule,
            estimator,
            electrical: None,
            beside: 0.0,
            request: Request {
                notch: gains.notch.map_or(NotchUse::Off, NotchUse::Like),
                ..settings.request
            },
            draws: settings.draws.clone(),
            torque_n_m_per_a: model.motor.torque_constant().unwrap_or(f64::NAN),
            model_acceleration_per_a: acceleration_per_a,
            model_mechanical_s: model.motor.mechanical_time_constant_s().unwrap_or(0.0),
            still: Some(NOT_SETTLED),
            moved: false,
            told_proportional: gains.proportional,
            told_ratio: 1.0,
            told_jumps: 0,
        })
    }

    /// The same with gains that follow the time constant of the winding too; over a voltage only.
    ///
    /// # Errors
    /// What the tuning refuses at a bound of that time constant.
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

    /// The same with an estimate that forgets and does not look for jumps, as paper A's.
    #[must_use]
    pub fn by_forgetting_alone(mut self) -> Self {
        self.estimator = self.estimator.by_forgetting_alone();
        self
    }

    /// Whether the data carry the estimate that the gains would follow.
    pub fn is_settled(&self) -> bool {
        self.estimator.load().settled
    }

    /// Inertia over the model's, as the gains take it.
    pub fn inertia_ratio(&self) -> f64 {
        self.model_acceleration_per_a / self.estimator.load().acceleration_per_a
    }

    pub const fn pi(&self) -> &Pi {
        &self.pi
    }

    /// The mechanical time constant that is known now. One that is being searched for is no number to show.
    fn mechanical_text(&self) -> String {
        let ratio = self.inertia_ratio();
        if self.is_settled() {
            format!(
                "TM = {:.4} s ({ratio:.3} times the model's inertia)",
                ratio * self.model_mechanical_s
            )
        } else {
            "TM is being searched for".to_owned()
        }
    }

    fn electrical_text(&self) -> String {
        let electrical = self.electrical.as_ref();
        electrical.map_or_else(String::new, |one| format!("; {}", one.text()))
    }

    fn adapt(&mut self, reference_rad_s: f64, speed_rad_s: f64, period_s: f64) {
        let load = self.estimator.load();
        self.moved = false;
        let limited = self.pi.is_limited().then_some("the output is limited");
        self.still = (!load.settled).then_some(NOT_SETTLED).or(limited);
        if self.still.is_some() {
            return;
        }
        let ratio = |acceleration: f64| self.model_acceleration_per_a / acceleration;
        let quickest = load.acceleration_per_a + DOUBT * load.std;
        let (low, middle) = (ratio(quickest), ratio(load.acceleration_per_a));
        let wanted = self.schedule.within(low, middle);
        let electrical = self.electrical.as_ref();
        let wanted = electrical.map_or(wanted, |one| one.at(wanted, low, middle));
        let share = self.pi.share();
        let now = *self.pi.gains();
        let proportional = share * wanted.gains.proportional;
        let integral_time_s = wanted.gains.integral_time_s;
        let change = proportional / now.proportional;
        let outside = now.proportional > wanted.most_proportional;
        let band = DEAD_BAND.max(DEAD_STDS * load.std / load.acceleration_per_a);
        if (change - 1.0).abs() < band && !outside {
            return;
        }
        let most = (period_s / GAIN_TIME_S).exp();
        let moved = |from: f64, to: f64| to.clamp(from / most, from * most);
        let mut gains = now;
        gains.proportional = moved(now.proportional, proportional);
        gains.integral_time_s = moved(now.integral_time_s, integral_time_s);
        gains.reference_filter_s = wanted.gains.reference_filter_s;
        gains.notch = wanted.gains.notch;
        (self.pi).set_gains(gains, reference_rad_s, speed_rad_s, period_s);
        self.moved = true;
    }
}

impl SpeedController for Addc {
    fn id(&self) -> &'static str {
        Self::ID
    }

    fn follow_plan(&mut self) -> bool {
        self.pi.follow_plan()
    }

    fn step(&mut self, reference_rad_s: f64, now: &Measured, period_s: f64) -> f64 {
        (self.estimator).push(now.current_a, now.speed_rad_s, period_s);
        if let Some(electrical) = &mut self.electrical {
            electrical.push(now, period_s);
        }
        self.adapt(reference_rad_s, now.speed_rad_s, period_s);
        self.pi.step(reference_rad_s, now, period_s)
    }

    fn beside(&mut self, output: f64) {
        self.beside = output;
    }

    fn applied(&mut self, output: f64) {
        self.pi.applied(output);
        if let Some(electrical) = &mut self.electrical {
            electrical.applied(output + self.beside);
        }
    }

    fn reset(&mut self, now: &Measured, output: f64) {
        self.pi.reset(now, output);
    }

    fn explain(&self) -> Vec<String> {
        let gains = self.pi.gains();
        let still = self.still.map(|why| format!("stand still: {why}"));
        let state = still.unwrap_or_else(|| "follow the estimate".to_owned());
        vec![
            format!("{}; {}", gains.text(&self.pi.softened_text()), self.mechanical_text()),
            format!("gains {state}{}", self.electrical_text()),
        ]
    }

    fn news(&mut self) -> Option<String> {
        let gains = self.pi.gains();
        let change = gains.proportional / self.told_proportional;
        let jumped = self.estimator.jumps() > self.told_jumps;
        // One line for a change that takes some cycles, at its end.
        let arrived = !self.moved && (change - 1.0).abs() > NEWS;
        if !arrived && !jumped {
            return None;
        }
        let ratio = self.inertia_ratio();
        let because = if jumped {
            "the load changed: the memory of the estimate was dropped"
        } else if (ratio / self.told_ratio - 1.0).abs() > NEWS {
            "the estimate moved"
        } else {
            "the gains have come to the estimate"
        };
        let line = format!(
            "Kp {:.4} -> {:.4}, Tn {:.4} s: {because}; {}",
            self.told_proportional,
            gains.proportional,
            gains.integral_time_s,
            self.mechanical_text()
        );
        self.told_proportional = gains.proportional;
        self.told_ratio = ratio;
        self.told_jumps = self.estimator.jumps();
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

    fn softens(&self) -> bool {
        true
    }

    fn soften(&mut self, share: f64, reference_rad_s: f64, speed_rad_s: f64, period_s: f64) {
        (self.pi).soften(share, reference_rad_s, speed_rad_s, period_s);
        // Told of by who asked for it.
        self.told_proportional = self.pi.gains().proportional;
    }
}
