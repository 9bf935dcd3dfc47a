//! From a model, the measured timing and `[speed]` to a controller and its limiter, or to the reason why not.

use thiserror::Error;

use super::section::{ControllerKind, GainsSection, SpeedSection};
use crate::limits::{Limits, Nameplate};
use crate::timing::whole;
use drivebench_control::tuning::{NotchUse, Request, Tuning, TuningError, tune_over};
use drivebench_control::{
    Actuator, Addc, AddcSettings, AntiWindup, Compensated, Course, CurrentLimit, FeedForward,
    Holding, Limiter, LinearPlant, LoadObserving, LoadObservingSettings, LoopShape, LoopTiming,
    Mrac, MracScales, PaperB, PaperBError, PaperBPlant, PaperBSettings, Pi, PiGains, PlantError,
    SpeedController, TrialMachine, drawn, trial, viscous_n_m_s_per_rad,
};
use drivebench_model::plant::{FittedValue, Model, MotorKey, TorqueMap};

/// Gain margin that gains given by hand have to leave.
const LEAST_GAIN_MARGIN: f64 = 1.6;
/// How far a model may be from the nameplate and still be of this motor: factors either way. A winding that is 100 K
/// warmer has 1.39 times its resistance; the flux of a specimen differs by some 15 %.
const RESISTANCE_FACTOR: f64 = 1.6;
const BACK_EMF_FACTOR: f64 = 1.3;
/// Cycles of the rehearsal, and the step that it takes, as a share of the peak reference.
const REHEARSAL_CYCLES: usize = 600;
const REHEARSAL_STEP: f64 = 0.2;
/// Swing that is left at its end, as a share of the step, with which a loop counts as stable.
const STILL_SWINGS: f64 = 0.25;
/// The same behind a coupling, which rings for long once it is struck.
const STILL_RINGS: f64 = 0.05;
/// Lag of a drive's current loop where the bench file does not say, s: what drives of some kilowatts reach.
const CURRENT_LAG_S: f64 = 0.002;

/// What closes a loop.
pub struct Regulator {
    pub actuator: Actuator,
    /// One for each pass over the reference, and whether it gives the model's effects forward.
    pub passes: Vec<(bool, Box<dyn SpeedController>)>,
    pub limiter: Limiter,
    pub holding: Holding,
    pub timing: LoopTiming,
    /// Standard deviation of a speed sample, rad/s.
    pub noise_rad_s: f64,
    /// Why the gains are what they are, before the motor moves.
    pub reasons: Vec<String>,
}

/// What a regulator is made from.
pub struct Design<'a> {
    pub model: &'a Model,
    /// Standard deviations of what was fitted of it.
    pub fitted: &'a [FittedValue],
    pub motor: &'a Nameplate,
    pub limits: &'a Limits,
    pub section: &'a SpeedSection,
    /// Torques that are given forward as they were measured.
    pub maps: &'a [TorqueMap],
    pub actuator: Actuator,
    pub timing: LoopTiming,
    /// Standard deviation of a speed sample, rad/s.
    pub noise_rad_s: f64,
    pub peak_reference_rad_s: f64,
}

/// Why no loop is closed.
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
        "speed.gains.proportional_v_s_per_rad = {value} is not allowed (expected up to {most:.4} with {cycles:.2} cycles of delay{})", behind(*coupling_hz)
    )]
    Gain { value: f64, most: f64, cycles: f64, coupling_hz: Option<f64> },
    #[error(
        "speed.gains.integral_time_s = {value} s is not allowed: the sampled loop has a radius of {radius:.3} (expected more, for a radius below 1)"
    )]
    IntegralTime { value: f64, radius: f64 },
    #[error(
        "speed.gains is for the controller \"pi\" over a voltage only, and {controller:?} over a {actuator} is asked for"
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
    #[error("speed.feed_forward: nothing can be given forward {why}")]
    NothingForward { why: &'static str },
    #[error(
        "the {name} map asks for {value:.3} N.m (expected up to the {most:.3} N.m of the loop's current limit)"
    )]
    Map { name: &'static str, value: f64, most: f64 },
    #[error(
        "{controller}: with {cycles:.2} cycles of delay{} the loop goes on swinging by {swing:.1} rad/s after a step of {step:.1} rad/s (expected below {most:.1})", behind(*coupling_hz)
    )]
    Swings {
        controller: &'static str,
        cycles: f64,
        coupling_hz: Option<f64>,
        swing: f64,
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
                "the manual's speed loop response time, or a step of the set-point seen on the drive's own scope"
            }
            Self::NothingForward { .. } => "leave --feed-forward out",
            Self::Map { .. } => "take the map of this motor, in N.m",
            Self::Swings { coupling_hz: Some(_), .. } => {
                "ask for less (speed.bandwidth_rad_s), take addc or pi, which are tuned for the coupling, or stiffen it"
            }
            Self::Swings { .. } => {
                "take addc or pi, which are tuned for the delay, or a faster link"
            }
        }
    }
}

/// Where the load hangs on a coupling, says so.
fn behind(coupling_hz: Option<f64>) -> String {
    coupling_hz.map_or_else(String::new, |hertz| format!(" and the coupling at {hertz:.1} Hz"))
}

/// Refuses a model of another motor: gains tuned on one are not for another.
pub fn check_kinship(model: &Model, motor: &Nameplate) -> Result<(), RegulatorError> {
    let name = &model.motor.name;
    if !name.is_empty() && *name != motor.name {
        return Err(RegulatorError::OtherName { model: name.clone(), bench: motor.name.clone() });
    }
    let (resistance, back_emf) = (motor.resistance_ohm, motor.back_emf_v_s_per_rad);
    for (key, plate, factor) in [
        (MotorKey::Resistance, resistance, RESISTANCE_FACTOR),
        (MotorKey::BackEmf, back_emf, BACK_EMF_FACTOR),
    ] {
        let (low, high) = (plate / factor, plate * factor);
        // What is missing or not physical is for the plant to say.
        let value = model.motor.get(key).filter(|value| *value > 0.0);
        if let Some(value) = value.filter(|value| !(low..=high).contains(value)) {
            return Err(RegulatorError::OtherMotor { key: key.key(), value, low, high });
        }
    }
    Ok(())
}

/// The loop's timing: what was measured on the link, and what the model knows to lie behind it.
pub fn timing(model: &Model, period_s: f64, link_delay_s: f64) -> LoopTiming {
    let path = model.known_path();
    let behind_s = path.command_delay_s + path.speed_delay_s;
    LoopTiming {
        period_s,
        delay_s: link_delay_s + behind_s.max(0.0),
        filter_s: path.speed_filter_s.max(0.0),
    }
}

/// What a design is tuned on: the plant, and draws of what is not known of it.
struct Plants {
    own: LinearPlant,
    draws: Vec<LinearPlant>,
}

impl Design<'_> {
    /// # Errors
    /// A model that is not physical or of another motor, a loop that the link cannot carry, gains outside their bounds.
    pub fn regulator(&self) -> Result<Regulator, RegulatorError> {
        check_kinship(self.model, self.motor)?;
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
            // Beside margins, which are those of a linear loop: what limits and play do behind a coupling.
            let is_coupled = plants.own.coupling().is_some();
            if has_no_margins || (is_coupled && self.actuator == Actuator::Voltage) {
                self.rehearse(&plants.own, controller.as_mut(), &limiter, viscous)?;
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
            actuator: self.actuator,
            passes,
            limiter,
            holding,
            timing: self.timing,
            noise_rad_s: self.noise_rad_s,
            reasons,
        })
    }

    /// The plant with its draws, and what is taken for granted of it.
    fn plants(&self) -> Result<(Plants, Vec<String>), RegulatorError> {
        let lag_s = self.section.drive_lag_s;
        let (taken_s, reason) = match self.actuator {
            Actuator::Voltage => (0.0, None),
            Actuator::Current => {
                let taken_s = lag_s.unwrap_or(CURRENT_LAG_S);
                let reason = format!(
                    "the drive's current loop is taken for a lag of {:.1} ms ({})",
                    1e3 * taken_s,
                    lag_s.map_or("speed.drive_lag_s is not given", |_| "speed.drive_lag_s")
                );
                (taken_s, Some(reason))
            }
            Actuator::Speed => (lag_s.ok_or(RegulatorError::NoLag)?, None),
        };
        let of = |model: &Model| LinearPlant::of(model, self.actuator, taken_s);
        let own = of(self.model)?;
        let draws = match self.actuator {
            // The drive's own loop is all that is seen, and none of it was fitted.
            Actuator::Speed => Vec::new(),
            Actuator::Voltage | Actuator::Current => drawn(self.model, self.fitted, of),
        };
        Ok((Plants { own, draws }, reason.into_iter().collect()))
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

    /// The controller with the model's effects beside it. What is given forward is not for it to hold.
    fn compensated(&self, plants: &Plants) -> Result<Box<dyn SpeedController>, RegulatorError> {
        let limit_a = self.current_limit_a();
        let (model, timing) = (self.model, &self.timing);
        if let Some(kt) = model.motor.torque_constant() {
            let most = limit_a * kt;
            let mut maps = self.maps.iter();
            if let Some(map) = maps.find(|map| map.largest_n_m() > most) {
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
        let inner = self.controller(plants, rest)?.0;
        Ok(Box::new(Compensated::new(inner, forward)))
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
            let tuning = tune_over(&plants.own, &plants.draws, &self.timing, &request);
            let mut tuning = tuning.map_err(refused)?;
            if let Some(draws) = &tuning.draws {
                let (count, worst) = (draws.count, &draws.worst);
                tuning.reasons.push(format!(
                    "the worst of {count} draws of the parameters keeps {:.0} degrees of phase and a gain margin of {:.2}",
                    worst.phase_margin_deg, worst.gain_margin
                ));
            }
            Ok(tuning)
        };
        let plant = &plants.own;
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
                    let adapting =
                        addc.clone().adapting_to_the_winding(self.model, viscous, &self.timing);
                    // A rule that refuses a bound of the winding's time constant leaves it at the model's.
                    addc = adapting.unwrap_or(addc);
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
                let electrical_s = motor.electrical_time_constant_s();
                let times = electrical_s.zip(motor.mechanical_time_constant_s());
                let (electrical_s, mechanical_s) = times.unwrap_or((f64::NAN, f64::NAN));
                let ke = value(MotorKey::BackEmf);
                let plant = PaperBPlant::new(self.timing.period_s, electrical_s, mechanical_s, ke);
                let made = PaperB::new(plant, PaperBSettings::default());
                (Box::new(made.map_err(RegulatorError::PaperB)?), Vec::new())
            }
            ControllerKind::LoadObserver => {
                let settings = LoadObservingSettings {
                    speed_noise_rad_s: self.noise_rad_s,
                    ..LoadObservingSettings::default()
                };
                let made = LoadObserving::new(self.model, plant, &self.timing, &settings);
                let made = made.map_err(RegulatorError::LoadObserver)?;
                (Box::new(made), Vec::new())
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
        if margins.gain_margin < LEAST_GAIN_MARGIN {
            return Err(RegulatorError::Gain {
                value: gains.proportional,
                most: gains.proportional * margins.gain_margin / LEAST_GAIN_MARGIN,
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
        let value = |key, plate| self.model.motor.get(key).unwrap_or(plate);
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

    /// Two steps on the model in virtual time, the delay rounded up to whole cycles: what swings there is not let at the
    /// motor.
    fn rehearse(
        &self,
        plant: &LinearPlant,
        controller: &mut dyn SpeedController,
        limiter: &Limiter,
        viscous: f64,
    ) -> Result<(), RegulatorError> {
        let value = |key, plate| self.model.motor.get(key).unwrap_or(plate);
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
        let step = REHEARSAL_STEP * high;
        let half_s = 0.5 * REHEARSAL_CYCLES as f64 * self.timing.period_s;
        let course = Course {
            reference_rad_s: &|t| if t < half_s { high } else { high - step },
            inertia_kg_m2: &|_| inertia,
            load_n_m: &|_| 0.0,
        };
        let trace = trial(&machine, &course, controller, limiter, REHEARSAL_CYCLES, 1);
        let end = &trace[REHEARSAL_CYCLES * 9 / 10..];
        let speeds = end.iter().map(|point| point.speed_rad_s);
        // A loop with margins may be slow; of the others nothing is known but this.
        let swing = match self.section.controller {
            ControllerKind::Pi | ControllerKind::Addc => swing(speeds),
            ControllerKind::Mrac | ControllerKind::PaperB | ControllerKind::LoadObserver => {
                extent(speeds)
            }
        };
        let share = plant.coupling().map_or(STILL_SWINGS, |_| STILL_RINGS);
        let most = share * step;
        // Also false for what is no number any more.
        if swing <= most {
            return Ok(());
        }
        Err(RegulatorError::Swings {
            controller: self.section.controller.id(),
            cycles: self.timing.delay_cycles(),
            coupling_hz: plant.coupling().map(|coupling| coupling.frequency_hz),
            swing,
            step,
            most,
        })
    }
}

/// From the least to the largest. No number, or below zero, where one of them is none.
fn extent(values: impl Iterator<Item = f64>) -> f64 {
    let (low, top) =
        values.fold((f64::MAX, f64::MIN), |(low, top), value| (low.min(value), top.max(value)));
    top - low
}

/// By how much a quantity goes back and forth: the largest way up or the largest way down, whichever is less, so that what
/// only drifts does not swing. No number where one of them is none.
fn swing(values: impl Iterator<Item = f64>) -> f64 {
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
