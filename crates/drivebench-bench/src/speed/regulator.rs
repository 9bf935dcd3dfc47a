//! Design of the controller and its limiter from a model, the measured timing and `[speed]`.

use thiserror::Error;

use super::section::{ControllerKind, GainsSection, SpeedSection};
use crate::limits::{Limits, Nameplate};
use drivebench_control::tuning::{NotchUse, Request, Tuning, TuningError, tune_over};
use drivebench_control::{
    Actuator, Addc, AddcSettings, AntiWindup, Compensated, CurrentLimit, FeedForward, Holding,
    Limiter, LinearPlant, LoadObserving, LoadObservingSettings, LoopShape, LoopTiming, Mrac,
    MracScales, PaperB, PaperBError, PaperBPlant, PaperBSettings, Pi, PiGains, PlantError,
    SpeedController, Trial, TrialMachine, drawn, viscous_n_m_s_per_rad,
};
use drivebench_model::numerics::count::whole;
use drivebench_model::numerics::statistics::extent;
use drivebench_model::plant::{FittedValue, Model, MotorKey, TorqueMap};

pub struct Regulator {
    pub controller: ControllerKind,
    pub actuator: Actuator,
    /// One for each pass over the reference, and whether it has feed-forward.
    pub passes: Vec<(bool, Box<dyn SpeedController>)>,
    pub limiter: Limiter,
    pub holding: Holding,
    pub timing: LoopTiming,
    /// Standard deviation of a speed sample, rad/s.
    pub noise_rad_s: f64,
    pub reasons: Vec<String>,
}

pub struct Design<'a> {
    pub model: &'a Model,
    /// Standard deviations of what was fitted of it.
    pub fitted: &'a [FittedValue],
    pub motor: &'a Nameplate,
    pub limits: &'a Limits,
    pub section: &'a SpeedSection,
    /// Measured torques for the feed-forward.
    pub maps: &'a [TorqueMap],
    pub actuator: Actuator,
    pub timing: LoopTiming,
    /// Standard deviation of a speed sample, rad/s.
    pub noise_rad_s: f64,
    pub peak_reference_rad_s: f64,
}

#[derive(Debug, Error)]
pub enum RegulatorError {
    #[error(transparent)]
    Plant(#[from] PlantError),
    #[error("{rule}: {error}")]
    Tuning {
        rule: &'static str,
        #[source]
        error: TuningError,
    },
    #[error("paper-b: {0}")]
    PaperB(#[source] PaperBError),
    #[error("load-observer: {0}")]
    LoadObserver(#[source] PaperBError),
    #[error("the model is of the motor {model:?} (expected {bench:?}, which the bench file names)")]
    OtherName { model: String, bench: String },
    #[error(
        "the model's {key} = {value} is that of another motor (expected {low:.4} to {high:.4}, about the nameplate)"
    )]
    OtherMotor { key: &'static str, value: f64, low: f64, high: f64 },
    #[error(
        "speed.gains.proportional_v_s_per_rad = {value} is not allowed (expected up to {most:.4} with {cycles:.2} cycles of delay{})", with_coupling(*coupling_hz)
    )]
    Gain { value: f64, most: f64, cycles: f64, coupling_hz: Option<f64> },
    #[error(
        "speed.gains.integral_time_s = {value} s is not allowed: the sampled loop has a radius of {radius:.3} (expected more, for a radius below 1)"
    )]
    IntegralTime { value: f64, radius: f64 },
    #[error(
        "speed.gains is for the controller \"pi\" over a voltage only, and {controller:?} over a {actuator} is requested"
    )]
    GainsOf { controller: &'static str, actuator: &'static str },
    #[error(
        "the controller {controller:?} does not act with a {actuator} (expected one of {allowed})"
    )]
    Acts { controller: &'static str, actuator: &'static str, allowed: String },
    #[error(
        "speed.drive_lag_s is missing (needed for a speed command: the time in which the drive's own loop follows)"
    )]
    NoLag,
    #[error("speed.feed_forward: nothing can be fed forward {why}")]
    NothingForward { why: &'static str },
    #[error(
        "the {name} map needs {value:.3} N.m (expected up to the {most:.3} N.m of the loop's current limit)"
    )]
    Map { name: &'static str, value: f64, most: f64 },
    #[error(
        "{controller}: with {cycles:.2} cycles of delay{} the loop still oscillates by {oscillation_rad_s:.1} rad/s after a step of {step:.1} rad/s (expected below {most:.1})", with_coupling(*coupling_hz)
    )]
    Oscillates {
        controller: &'static str,
        cycles: f64,
        coupling_hz: Option<f64>,
        oscillation_rad_s: f64,
        step: f64,
        most: f64,
    },
}

impl RegulatorError {
    pub const fn help(&self) -> &'static str {
        match self {
            Self::Plant(error) => error.help(),
            Self::Tuning { error, .. } => error.help(),
            Self::PaperB(error) | Self::LoadObserver(error) => error.help(),
            Self::OtherName { .. } | Self::OtherMotor { .. } => {
                "gains of one motor may be unstable on another: identify this one (drivebench run, identify)"
            }
            Self::Gain { .. } | Self::IntegralTime { .. } => {
                "leave [speed.gains] out: the rule finds gains that are stable"
            }
            Self::GainsOf { .. } => "leave [speed.gains] out, or give --controller pi",
            Self::Acts { .. } => {
                "give another --controller, or another speed.actuator where the drive takes one"
            }
            Self::NoLag => {
                "the manual's speed loop response time, or a step of the set-point on the drive's own scope"
            }
            Self::NothingForward { .. } => "leave --feed-forward out",
            Self::Map { .. } => "take the map of this motor, in N.m",
            Self::Oscillates { coupling_hz: Some(_), .. } => {
                "lower speed.bandwidth_rad_s, take addc or pi, which are tuned for the coupling, or stiffen it"
            }
            Self::Oscillates { .. } => {
                "take addc or pi, which are tuned for the delay, or a faster link"
            }
        }
    }
}

fn with_coupling(coupling_hz: Option<f64>) -> String {
    coupling_hz.map_or_else(String::new, |hertz| format!(" and the coupling at {hertz:.1} Hz"))
}

/// Refuses a model of another motor: gains tuned on one are not for another.
pub fn check_motor(model: &Model, motor: &Nameplate) -> Result<(), RegulatorError> {
    let name = &model.motor.name;
    if !name.is_empty() && *name != motor.name {
        return Err(RegulatorError::OtherName { model: name.clone(), bench: motor.name.clone() });
    }
    let (resistance, back_emf) = (motor.resistance_ohm, motor.back_emf_v_s_per_rad);
    // A winding that is 100 K warmer has 1.39 times its resistance; the flux of a specimen differs by some 15 %.
    for (key, nameplate, factor) in
        [(MotorKey::Resistance, resistance, 1.6), (MotorKey::BackEmf, back_emf, 1.3)]
    {
        let (low, high) = (nameplate / factor, nameplate * factor);
        // Missing or unphysical values are refused with the plant.
        let value = model.motor.get(key).filter(|value| *value > 0.0);
        if let Some(value) = value.filter(|value| !(low..=high).contains(value)) {
            return Err(RegulatorError::OtherMotor { key: key.key(), value, low, high });
        }
    }
    Ok(())
}

/// The loop's timing: the measured delay of the link, and the delays and filters of the model.
pub fn timing(model: &Model, period_s: f64, link_delay_s: f64) -> LoopTiming {
    let path = model.known_path();
    let path_s = path.command_delay_s + path.speed_delay_s;
    LoopTiming {
        period_s,
        delay_s: link_delay_s + path_s.max(0.0),
        filter_s: path.speed_filter_s.max(0.0),
    }
}

/// The plant, and draws over the uncertainty of its parameters.
struct Plants {
    nominal: LinearPlant,
    draws: Vec<LinearPlant>,
}

impl Design<'_> {
    /// # Errors
    /// A model that is not physical or of another motor, a loop that the link cannot carry, gains outside their bounds.
    pub fn regulator(&self) -> Result<Regulator, RegulatorError> {
        check_motor(self.model, self.motor)?;
        self.check_kind()?;
        let viscous = viscous_n_m_s_per_rad(self.model, self.actuator)?;
        let (plants, mut reasons) = self.plants()?;
        let holding = Holding::of(self.model, self.actuator, viscous);
        let limiter = self.limiter();
        let mut passes = Vec::new();
        for is_compensated in self.section.feed_forward.passes().iter().copied() {
            let (mut controller, why) = self.controller(&plants, holding)?;
            if passes.is_empty() {
                reasons.extend(why);
            }
            let has_no_margins = matches!(
                self.section.controller,
                ControllerKind::PaperB | ControllerKind::LoadObserver | ControllerKind::Mrac
            );
            // The margins of a linear loop contain neither limits nor the backlash of a coupling.
            let is_coupled = plants.nominal.coupling().is_some();
            if has_no_margins || (is_coupled && self.actuator == Actuator::Voltage) {
                self.simulate(&plants.nominal, controller.as_mut(), &limiter, viscous)?;
                controller = self.controller(&plants, holding)?.0;
            }
            if is_compensated {
                controller = self.compensated(&plants)?;
            }
            passes.push((is_compensated, controller));
        }
        if let Some((_, last)) = passes.last() {
            reasons.extend(last.explain());
        }
        Ok(Regulator {
            controller: self.section.controller,
            actuator: self.actuator,
            passes,
            limiter,
            holding,
            timing: self.timing,
            noise_rad_s: self.noise_rad_s,
            reasons,
        })
    }

    /// The plant with its draws, and the assumptions about it.
    fn plants(&self) -> Result<(Plants, Vec<String>), RegulatorError> {
        let lag_s = self.section.drive_lag_s;
        let (drive_lag_s, reason) = match self.actuator {
            Actuator::Voltage => (0.0, None),
            Actuator::Current => {
                // By default that of drives of some kilowatts.
                let drive_lag_s = lag_s.unwrap_or(0.002);
                let reason = format!(
                    "the drive's current loop is taken for a lag of {:.1} ms ({})",
                    1e3 * drive_lag_s,
                    lag_s.map_or("speed.drive_lag_s is not given", |_| "speed.drive_lag_s")
                );
                (drive_lag_s, Some(reason))
            }
            Actuator::Speed => (lag_s.ok_or(RegulatorError::NoLag)?, None),
        };
        let of = |model: &Model| LinearPlant::of(model, self.actuator, drive_lag_s);
        let nominal = of(self.model)?;
        let draws = match self.actuator {
            // The plant is the drive's own loop, of which nothing was fitted.
            Actuator::Speed => Vec::new(),
            Actuator::Voltage | Actuator::Current => drawn(self.model, self.fitted, of),
        };
        Ok((Plants { nominal, draws }, reason.into_iter().collect()))
    }

    fn check_kind(&self) -> Result<(), RegulatorError> {
        let kind = self.section.controller;
        let actuators = kind.actuators();
        if !actuators.contains(&self.actuator) {
            let names: Vec<&str> = actuators.iter().map(|actuator| actuator.name()).collect();
            return Err(RegulatorError::Acts {
                controller: kind.id(),
                actuator: self.actuator.name(),
                allowed: names.join(", "),
            });
        }
        let by_hand = kind == ControllerKind::Pi && self.actuator == Actuator::Voltage;
        if self.section.gains.is_some() && !by_hand {
            return Err(RegulatorError::GainsOf {
                controller: kind.id(),
                actuator: self.actuator.name(),
            });
        }
        Ok(())
    }

    /// The controller with feed-forward, whose friction is not in its holding output.
    fn compensated(&self, plants: &Plants) -> Result<Box<dyn SpeedController>, RegulatorError> {
        let limit_a = self.current_limit_a();
        let (model, timing) = (self.model, &self.timing);
        if let Some(kt) = model.motor.torque_constant() {
            let most = limit_a * kt;
            if let Some(map) = self.maps.iter().find(|map| map.largest_n_m() > most) {
                return Err(RegulatorError::Map {
                    name: map.torque.name(),
                    value: map.largest_n_m(),
                    most,
                });
            }
        }
        let forward = FeedForward::new(model, self.maps, self.actuator, timing, limit_a);
        let why = match self.actuator {
            Actuator::Speed => "with a speed command: the drive's own loop holds the speed",
            _ => "without the motor's friction, inertia and constants in the model",
        };
        let forward = forward.ok_or(RegulatorError::NothingForward { why })?;
        let rest = Holding { against: 0.0, ..Holding::of(self.model, self.actuator, 0.0) };
        Ok(Box::new(Compensated::new(self.controller(plants, rest)?.0, forward)))
    }

    fn controller(
        &self,
        plants: &Plants,
        holding: Holding,
    ) -> Result<(Box<dyn SpeedController>, Vec<String>), RegulatorError> {
        let request = Request {
            rule: self.section.rule(self.actuator),
            bandwidth_rad_s: self.section.bandwidth_rad_s,
            notch: NotchUse::unless(self.section.no_notch),
        };
        let refused = |error| RegulatorError::Tuning { rule: request.rule.id(), error };
        let tuned = || -> Result<Tuning, RegulatorError> {
            let mut tuning = tune_over(&plants.nominal, &plants.draws, &self.timing, &request)
                .map_err(refused)?;
            if let Some(draws) = &tuning.draws {
                let (count, worst) = (draws.count, &draws.worst);
                tuning.reasons.push(format!(
                    "the worst of {count} draws of the parameters keeps {:.0} degrees of phase and a gain margin of {:.2}",
                    worst.phase_margin_deg, worst.gain_margin
                ));
            }
            Ok(tuning)
        };
        let plant = &plants.nominal;
        let value = |key| self.model.motor.get(key).unwrap_or(f64::NAN);
        Ok(match self.section.controller {
            ControllerKind::Pi => {
                let (gains, reasons) = if let Some(given) = &self.section.gains {
                    (self.checked(plant, given)?, Vec::new())
                } else {
                    let tuning = tuned()?;
                    (tuning.gains, tuning.reasons)
                };
                let pi = Pi::new(gains, AntiWindup::Hold, holding);
                (Box::new(pi.leaving_after(self.timing.leaving_s())), reasons)
            }
            ControllerKind::Addc => {
                let tuning = tuned()?;
                let settings = AddcSettings {
                    request,
                    draws: plants.draws.clone(),
                    ..AddcSettings::new(holding, self.noise_rad_s)
                };
                let mut addc =
                    Addc::new(self.model, plant, &self.timing, &settings).map_err(refused)?;
                if self.actuator == Actuator::Voltage {
                    let viscous = viscous_n_m_s_per_rad(self.model, self.actuator)?;
                    // A rule that refuses a bound of the winding's time constant leaves it at the model's.
                    let fixed = addc.clone();
                    addc = addc
                        .adapting_to_the_winding(self.model, viscous, &self.timing)
                        .unwrap_or(fixed);
                }
                (Box::new(addc), tuning.reasons)
            }
            ControllerKind::Mrac => {
                let scales = MracScales {
                    speed_rad_s: self.peak_reference_rad_s.max(1.0),
                    current_a: self.current_limit_a(),
                };
                let mrac = Mrac::new(plant, &self.timing, scales, true);
                let integrates = RegulatorError::Plant(PlantError::NotPhysical {
                    key: MotorKey::BackEmf.key(),
                    value: value(MotorKey::BackEmf),
                });
                (Box::new(mrac.ok_or(integrates)?), Vec::new())
            }
            ControllerKind::PaperB => {
                let motor = &self.model.motor;
                let (electrical_s, mechanical_s) = motor
                    .electrical_time_constant_s()
                    .zip(motor.mechanical_time_constant_s())
                    .unwrap_or((f64::NAN, f64::NAN));
                let ke = value(MotorKey::BackEmf);
                let plant = PaperBPlant::new(self.timing.period_s, electrical_s, mechanical_s, ke);
                let paper_b = PaperB::new(plant, PaperBSettings::default())
                    .map_err(RegulatorError::PaperB)?;
                (Box::new(paper_b), Vec::new())
            }
            ControllerKind::LoadObserver => {
                let settings = LoadObservingSettings {
                    speed_noise_rad_s: self.noise_rad_s,
                    ..LoadObservingSettings::default()
                };
                let observer = LoadObserving::new(self.model, plant, &self.timing, &settings)
                    .map_err(RegulatorError::LoadObserver)?;
                (Box::new(observer), Vec::new())
            }
        })
    }

    /// Gains given by hand, on the sampled loop with its delay.
    fn checked(
        &self,
        plant: &LinearPlant,
        given: &GainsSection,
    ) -> Result<PiGains, RegulatorError> {
        let gains = PiGains {
            proportional: given.proportional_v_s_per_rad,
            integral_time_s: given.integral_time_s,
            reference_filter_s: 0.0,
            notch: None,
        };
        let margins = LoopShape::new(plant, &self.timing, &gains).margins();
        let least = 1.6;
        if margins.gain_margin < least {
            return Err(RegulatorError::Gain {
                value: gains.proportional,
                most: gains.proportional * margins.gain_margin / least,
                cycles: self.timing.delay_cycles(),
                coupling_hz: plant.coupling().map(|coupling| coupling.frequency_hz),
            });
        }
        if margins.radius >= 1.0 {
            return Err(RegulatorError::IntegralTime {
                value: gains.integral_time_s,
                radius: margins.radius,
            });
        }
        Ok(gains)
    }

    fn current_limit_a(&self) -> f64 {
        self.section.current_limit_a(self.motor.rated_current_a, self.limits)
    }

    fn limiter(&self) -> Limiter {
        let value = |key, nameplate| self.model.motor.get(key).unwrap_or(nameplate);
        let output = match self.actuator {
            Actuator::Voltage => self.limits.voltage_v,
            Actuator::Current => self.current_limit_a(),
            Actuator::Speed => self.limits.speed_rad_s,
        };
        let current = (self.actuator == Actuator::Voltage).then(|| CurrentLimit {
            current_a: self.current_limit_a(),
            resistance_ohm: value(MotorKey::Resistance, self.motor.resistance_ohm),
            back_emf_v_s_per_rad: value(MotorKey::BackEmf, self.motor.back_emf_v_s_per_rad),
            ahead_s: self.timing.dead_time_s(),
        });
        Limiter { output, current }
    }

    /// Simulates two steps, the delay rounded up to whole cycles; refuses a controller that oscillates there.
    fn simulate(
        &self,
        plant: &LinearPlant,
        controller: &mut dyn SpeedController,
        limiter: &Limiter,
        viscous: f64,
    ) -> Result<(), RegulatorError> {
        let value = |key, nameplate| self.model.motor.get(key).unwrap_or(nameplate);
        let ke = value(MotorKey::BackEmf, self.motor.back_emf_v_s_per_rad);
        let inertia = value(MotorKey::Inertia, self.motor.inertia_kg_m2);
        let machine = TrialMachine {
            resistance_ohm: value(MotorKey::Resistance, self.motor.resistance_ohm),
            inductance_h: value(MotorKey::Inductance, self.motor.inductance_h),
            back_emf_v_s_per_rad: ke,
            torque_n_m_per_a: self.model.motor.torque_constant().unwrap_or(ke),
            friction_n_m: value(MotorKey::LoadTorque, 0.0),
            viscous_n_m_s_per_rad: viscous,
            coupling: plant.coupling().copied(),
            drive_current_limit_a: self.limits.current_a,
            period_s: self.timing.period_s,
            delay_periods: whole((self.timing.delay_cycles() - 0.05).ceil().clamp(0.0, 64.0)),
            speed_noise_rad_s: 0.0,
            current_noise_a: 0.0,
        };
        let high = self.peak_reference_rad_s.max(1.0);
        let (step, cycles) = (0.2 * high, 600);
        let half_s = 0.5 * cycles as f64 * self.timing.period_s;
        let reference = |t| if t < half_s { high } else { high - step };
        let trace = Trial::new(machine, *limiter, inertia, reference).run(controller, 2.0 * half_s);
        let speeds = trace[cycles * 9 / 10..].iter().map(|point| point.speed_rad_s);
        // A slow loop with margins may still drift here; of one without margins any change counts.
        let oscillation_rad_s = match self.section.controller {
            ControllerKind::Pi | ControllerKind::Addc => oscillation(speeds),
            ControllerKind::Mrac | ControllerKind::PaperB | ControllerKind::LoadObserver => {
                let (low, high) = extent(speeds);
                high - low
            }
        };
        // The step excites a coupling, which is damped by little: behind one the loop's own part is less.
        let share = if plant.coupling().is_some() { 0.05 } else { 0.25 };
        let most = share * step;
        // False for NaN.
        if oscillation_rad_s <= most {
            return Ok(());
        }
        Err(RegulatorError::Oscillates {
            controller: self.section.controller.id(),
            cycles: self.timing.delay_cycles(),
            coupling_hz: plant.coupling().map(|coupling| coupling.frequency_hz),
            oscillation_rad_s,
            step,
            most,
        })
    }
}

/// The largest rise or the largest fall, whichever is less: a drift is no oscillation. NaN where a value is not finite.
fn oscillation(values: impl Iterator<Item = f64>) -> f64 {
    let (mut low, mut top) = (f64::MAX, f64::MIN);
    let (mut up, mut down) = (0.0_f64, 0.0_f64);
    for value in values {
        if !value.is_finite() {
            return f64::NAN;
        }
        (low, top) = (low.min(value), top.max(value));
        (up, down) = (up.max(value - low), down.max(top - value));
    }
    up.min(down)
}
