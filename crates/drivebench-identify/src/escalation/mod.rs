//! Identification of an unknown motor by stages: the result of each limits the size of the next.
//!
//! ```text
//! Bounds --> Feel: slow ramps, three times larger each      --- nothing flows ----> open phase
//!            | current shows                \ it turns
//!            v                               \
//!            BreakAway: 50 %, 100 % rated     \           --- current, no motion -> locked rotor
//!            | it turns                        v
//!            +---------------------------> Turn: steps both ways, from a lower bound of R and the stages before
//!                                            | R, Ke, J known roughly              --- rounds used up -> not identified
//!                                            v
//!                                          Sweep: to a share of the speed limit, slow enough for the current
//!                                            | R, Ke, J known well
//!                                            v
//!                                          Found: the motor; nameplate::compare sets it beside the nameplate
//! ```
//!
//! A pure state machine: its output is a stage, its input the record of that stage. Only the rated values and the limits are
//! taken as certain. Two rules keep every stage below the current limit: a ramp, which is slow against the sampling, ends as
//! soon as current or speed exceed the noise (each period adds a few per cent), and a step is at most the wanted current times
//! the lower bound of the resistance.

mod ending;
mod observation;
mod stage;

pub use ending::{Ending, Found, Outcome};
pub use observation::{Observation, RestWinding};
pub use stage::{Stage, StageKind};

use serde::Serialize;

use crate::belief;
use drivebench_model::plant::{MotorKey, Scenario, ScenarioError};
use drivebench_model::sample::{Channel, Origin, ParameterEstimate, Run};
use observation::Turned;
use stage::BothWays;

/// Current of a ramp of the first kind, in rated currents.
const FEEL_CURRENT: f64 = 0.3;
/// Largest voltage of such a ramp, in rated voltages: even a motor with a stall current at rated voltage of no more than the
/// rated current then draws a quarter of it.
const SAFE_VOLTAGE: f64 = 0.25;
/// Growth of the voltage from ramp to ramp.
const GROWTH: f64 = 3.0;
/// Largest current of a step, as a share of the current limit.
const CURRENT_SHARE: f64 = 0.8;
/// Largest speed of a step, as a share of the speed limit.
const SPEED_SHARE: f64 = 0.5;
/// Speed of a sweep, as a share of the speed limit.
const SWEEP_SHARE: f64 = 0.35;
/// Largest current of the break-away ramp, in rated currents.
const BREAK_AWAY: f64 = 1.1;
const ROUNDS: usize = 8;
/// Largest relative standard deviation of a usable motor after the last round.
const USABLE: f64 = 0.15;
/// Largest relative standard deviation of a resistance that bounds a step.
const KNOWN: f64 = 0.3;
/// Stages of any kind, so that every escalation ends.
const MOST_STAGES: usize = 24;

/// Rated values and limits, the only certain figures of the motor.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Bounds {
    pub rated_voltage_v: f64,
    pub rated_current_a: f64,
    pub current_limit_a: f64,
    pub speed_limit_rad_s: f64,
    pub voltage_limit_v: f64,
    pub period_s: f64,
}

impl Bounds {
    /// Largest voltage before a current shows, V.
    fn safe_v(&self) -> f64 {
        (SAFE_VOLTAGE * self.rated_voltage_v).min(self.voltage_limit_v)
    }
}

#[derive(Clone, Debug, Default, Serialize)]
pub struct StageResult {
    pub kind: StageKind,
    /// Farthest commanded voltage that was reached, V.
    pub peak_v: f64,
    pub peak_current_a: f64,
    pub peak_speed_rad_s: f64,
    /// The result, in a sentence.
    pub line: String,
}

/// The state of an escalation: a stage to run, or how it ended.
#[derive(Clone, Debug)]
pub struct Escalation {
    bounds: Bounds,
    next: Next,
    history: Vec<StageResult>,
    rest: Option<RestWinding>,
    /// Break-away current of the last stage, A.
    break_away_a: Option<f64>,
    turned: Option<Turned>,
    /// The round with the best estimates, and whether it was a sweep.
    best: Option<(bool, Turned)>,
    rounds: usize,
    /// Back-EMF constant from the first motion and its standard deviation, V.s/rad: rough, but enough to bound a speed.
    first_back_emf: Option<(f64, f64)>,
    /// Voltage that the last stage reached, V, and the current with it, A.
    last_v: f64,
    last_a: f64,
    /// Whether the shaft turned in it.
    last_moved: bool,
}

#[derive(Clone, Debug)]
enum Next {
    Run(Stage),
    Over(Box<Outcome>),
}

impl Escalation {
    pub fn new(bounds: Bounds) -> Self {
        let first_v = (0.003 * bounds.rated_voltage_v).min(bounds.voltage_limit_v);
        let reason = "no parameter is known yet".to_owned();
        let first = stage::look(&bounds, StageKind::Feel, first_v, reason);
        Self {
            bounds,
            next: Next::Run(first),
            history: Vec::new(),
            rest: None,
            break_away_a: None,
            turned: None,
            best: None,
            rounds: 0,
            first_back_emf: None,
            last_v: first_v,
            last_a: 0.0,
            last_moved: false,
        }
    }

    /// The stages that may follow the first, in sentences: the result of each limits the size of the next.
    pub fn outlook() -> Vec<String> {
        vec![
            format!(
                "feel: without a current or a motion, the same {GROWTH} times larger, up to {SAFE_VOLTAGE} of the rated voltage"
            ),
            format!("break away: slowly up to {BREAK_AWAY} rated currents, until the shaft turns"),
            format!(
                "turn: steps both ways, by the lower bound of the resistance, to at most {CURRENT_SHARE} of the current limit and {SPEED_SHARE} of the speed limit; {ROUNDS} rounds at most"
            ),
            format!(
                "sweep: to {SWEEP_SHARE} of the speed limit, as fast as the current allows; then the sequence is fitted to the motor that was found. {MOST_STAGES} stages at most"
            ),
        ]
    }

    /// The stage to run next; `None` once it is over.
    pub const fn stage(&self) -> Option<&Stage> {
        match &self.next {
            Next::Run(stage) => Some(stage),
            Next::Over(_) => None,
        }
    }

    pub fn outcome(&self) -> Option<&Outcome> {
        match &self.next {
            Next::Run(_) => None,
            Next::Over(outcome) => Some(outcome),
        }
    }

    pub fn history(&self) -> &[StageResult] {
        &self.history
    }

    /// Evaluates the record of the stage.
    pub fn learn(&mut self, run: &Run) -> Result<(), ScenarioError> {
        let Next::Run(stage) = &self.next else { return Ok(()) };
        let stage = stage.clone();
        let scenario = scenario_of(run)?;
        let observation = Observation::of(&scenario, run, &self.bounds);
        // A drive rounds its smallest commands to zero: the whole stage was harmless then.
        let applied_v = observation.peak_v.abs();
        self.last_v = if applied_v > 0.0 { applied_v } else { stage.peak_v };
        self.last_a = observation.peak_current_a.abs();
        self.last_moved = observation.moves();
        let (next, line) = self.judge(&stage, &scenario, &observation);
        self.history.push(StageResult {
            kind: stage.kind,
            peak_v: observation.peak_v,
            peak_current_a: observation.peak_current_a,
            peak_speed_rad_s: observation.peak_speed_rad_s,
            line,
        });
        self.next = if self.history.len() >= MOST_STAGES && matches!(next, Next::Run(_)) {
            not_identified(format!("{MOST_STAGES} stages were run"))
        } else {
            next
        };
        Ok(())
    }

    fn judge(
        &mut self,
        stage: &Stage,
        scenario: &Scenario,
        observation: &Observation,
    ) -> (Next, String) {
        if let Some(ending) = ending::wrong_sign(observation) {
            return ended(ending);
        }
        match stage.kind {
            StageKind::Feel => self.felt(scenario, observation),
            StageKind::BreakAway => self.broke_away(scenario, observation),
            StageKind::Turn | StageKind::Sweep => self.turned(stage.kind, scenario, observation),
        }
    }

    /// Current, motion, or a larger ramp.
    fn felt(&mut self, scenario: &Scenario, observation: &Observation) -> (Next, String) {
        self.update_rest(scenario, observation);
        let bounds = &self.bounds;
        if observation.moves() {
            return (self.turn(), format!("it turns already, {}", observation.text()));
        }
        let rated_a = bounds.rated_current_a;
        let shows = observation.peak_current_a.abs() >= 0.8 * FEEL_CURRENT * rated_a;
        let safe_v = bounds.safe_v();
        let line = format!("at rest, {}", observation.text());
        // Beyond the safe voltage only on a current that is not the largest of some hundred samples of noise.
        let flows = observation.peak_current_a.abs()
            > (belief::Settings::IDLE_CURRENT * rated_a)
                .max(belief::Settings::CLEAR_STD * observation.noise_a);
        if shows && flows || (self.last_v >= safe_v * 0.999 && self.rest.is_some() && flows) {
            return (self.break_away(), line);
        }
        if self.last_v >= safe_v * 0.999 {
            let idle_a = belief::Settings::IDLE_CURRENT * rated_a;
            return ended(ending::no_current(observation, idle_a));
        }
        // A resistance that is known spares ramps in between; one that is not allows no more than the usual growth.
        let (least_v, most_v) = (1.2 * self.last_v, GROWTH * self.last_v);
        let known = self.rest.filter(|rest| rest.relative() < KNOWN);
        let mut wanted_v = known.map_or(most_v, |rest| {
            (1.05 * FEEL_CURRENT * rated_a * rest.lowest_ohm()).clamp(least_v, most_v)
        });
        // No further ramp for the last few per cent.
        if wanted_v > 0.9 * safe_v {
            wanted_v = safe_v;
        }
        (Next::Run(stage::look(bounds, StageKind::Feel, wanted_v, self.allows_more())), line)
    }

    fn broke_away(&mut self, scenario: &Scenario, observation: &Observation) -> (Next, String) {
        let before = self.rest;
        self.update_rest(scenario, observation);
        if observation.moves() {
            return (self.turn(), format!("it breaks away, {}", observation.text()));
        }
        let bounds = &self.bounds;
        let reached_a = belief::Settings::LIMITING_CURRENT * bounds.rated_current_a;
        if let Some(ending) = ending::no_motion(observation, before, reached_a, bounds) {
            return ended(ending);
        }
        let line = format!("the speed may be below its noise, {}", observation.text());
        let wanted_v = (GROWTH * self.last_v).min(bounds.safe_v());
        if wanted_v < 1.2 * self.last_v {
            let reason = format!("no speed above its noise at {:.1} V", self.last_v);
            return (not_identified(reason), line);
        }
        let reason = "a back-EMF is detected, a speed not yet".to_owned();
        (Next::Run(stage::look(bounds, StageKind::BreakAway, wanted_v, reason)), line)
    }

    fn turned(
        &mut self,
        kind: StageKind,
        scenario: &Scenario,
        observation: &Observation,
    ) -> (Next, String) {
        self.rounds += 1;
        let found = observation::turned(scenario, self.rest);
        let line = match &found {
            Ok(found) => found.text(),
            Err(reason) => format!("{}: {reason}", observation.text()),
        };
        let failure = found.as_ref().err().cloned();
        let is_sweep = kind == StageKind::Sweep;
        if let Ok(found) = found {
            // A sweep covers more of the motor's range than any step and is preferred to a more accurate estimate of a step, if it is
            // usable: behind the filters of a drive its slow current says little.
            let is_usable = |own: &Turned| own.worst() <= USABLE;
            let is_better = self.best.as_ref().is_none_or(|(of_sweep, best)| {
                if is_usable(&found) != is_usable(best) {
                    return is_usable(&found);
                }
                let is_sharper = found.worst() < best.worst();
                is_sweep && !of_sweep || is_sharper && is_sweep == *of_sweep
            });
            if is_better {
                self.best = Some((is_sweep, found.clone()));
            }
            self.turned = Some(found);
        }
        let within = |most| self.turned.as_ref().is_some_and(|it| it.worst() <= most);
        let best = self.best.as_ref();
        let best_is_usable = best.is_some_and(|(_, best)| best.worst() <= USABLE);
        if (within(0.015) && is_sweep) || (best_is_usable && self.rounds >= ROUNDS) {
            return (self.found(), line);
        }
        if self.rounds >= ROUNDS {
            let worst = || self.turned.as_ref().map(Turned::worst_text);
            let reason = failure.or_else(worst).unwrap_or_else(|| NOTHING.to_owned());
            return (not_identified(reason), line);
        }
        let sweep = within(USABLE).then(|| self.sweep()).flatten();
        (sweep.unwrap_or_else(|| self.turn()), line)
    }

    fn update_rest(&mut self, scenario: &Scenario, observation: &Observation) {
        let found = observation::at_rest(scenario, observation);
        self.rest = match (self.rest, found) {
            (Some(old), Some(new)) if old.relative() < new.relative() => Some(old),
            (old, new) => new.or(old),
        };
        if observation.moves() {
            self.break_away_a = Some(observation.break_away_current_a);
            self.first_back_emf = Some(observation.back_emf(self.rest));
        }
    }

    fn break_away(&self) -> Next {
        let bounds = &self.bounds;
        let Some(rest) = self.rest else {
            return not_identified(
                "current flows, but not in proportion to the voltage: the resistance is not observable",
            );
        };
        Next::Run(stage::break_away(bounds, &rest, BREAK_AWAY))
    }

    /// The next steps in both directions: the current that is wanted, through the lowest resistance that is possible.
    fn turn(&self) -> Next {
        let bounds = &self.bounds;
        let rated_a = bounds.rated_current_a;
        let lowest_ohm = self.lowest_resistance_ohm();
        let most_a = CURRENT_SHARE * bounds.current_limit_a;
        let turned = self.turned.as_ref();
        let friction_a = turned.and_then(Turned::friction_a);
        let friction_a = friction_a.or(self.break_away_a).unwrap_or(0.0);
        let share = [1.0, 1.5, 2.0][self.rounds.min(2)];
        let wanted_a = (share * rated_a).max(friction_a + 0.5 * rated_a).min(most_a);
        let mut volts = wanted_a * lowest_ohm;
        let mut reason = format!("{wanted_a:.2} A through at least {lowest_ohm:.3} ohm");
        let is_known = self.rest.is_some_and(|rest| rest.relative() < KNOWN)
            || turned.and_then(Turned::resistance).is_some();
        if self.rounds > 0 && !is_known && self.last_a < 0.3 * rated_a {
            // After a step with a small current three times the voltage is allowed.
            volts = volts.max(GROWTH * self.last_v);
            reason = self.allows_more();
        }
        // No faster than a share of the limit, by what the back-EMF is at least.
        let speed_rad_s = SPEED_SHARE * bounds.speed_limit_rad_s;
        let fastest_v = turned
            .and_then(|turned| turned.voltage_at(speed_rad_s))
            .or_else(|| {
                let (value, std) = self.first_back_emf?;
                let back_emf_v = (value - 3.0 * std).max(0.25 * value) * speed_rad_s;
                Some(back_emf_v + friction_a * lowest_ohm)
            })
            .unwrap_or(0.1 * bounds.rated_voltage_v)
            // The voltage of the stage before is allowed; more after a step that did not turn the shaft.
            .max(if self.last_moved { 0.5 } else { 1.5 } * self.last_v)
            .min(bounds.voltage_limit_v);
        if volts > fastest_v {
            volts = fastest_v;
            reason = format!("at most {speed_rad_s:.1} rad/s");
        }
        // A step is never more than four times the one before.
        let most_v = 4.0 * self.last_v;
        if volts > most_v {
            volts = most_v;
            reason = format!("four times the {:.3} V of the stage before", self.last_v);
        }
        let constant_s = turned.and_then(Turned::mechanical_s);
        let steps = BothWays {
            kind: StageKind::Turn,
            peak_v: volts,
            // Within one period: a step.
            slew_v_per_s: volts / bounds.period_s.min(0.01),
            hold_s: stage::step_s(bounds, constant_s),
            winding_v: bounds.current_limit_a * lowest_ohm,
            back_emf_v_s_per_rad: 0.0,
            stop_current_a: 1.5 * wanted_a,
            reason,
        };
        Next::Run(steps.stage(bounds))
    }

    /// Farther up, once the motor is known roughly: the slew is the one of which the lag of the back-EMF draws the wanted
    /// current, `s TM / R`.
    fn sweep(&self) -> Option<Next> {
        let bounds = &self.bounds;
        let turned = self.turned.as_ref()?;
        let lowest_ohm = self.lowest_resistance_ohm();
        let friction_a = turned.friction_a().unwrap_or(0.0);
        let rated_a = bounds.rated_current_a;
        let most_a = CURRENT_SHARE * bounds.current_limit_a;
        let accelerating_a = rated_a.min(most_a - friction_a).max(0.2 * rated_a);
        // Half as slow again as the estimate: an inertia that hardly shows may be larger.
        let mechanical_s = 1.5 * turned.mechanical_s()?.max(bounds.period_s);
        let slew_v_per_s = accelerating_a * lowest_ohm / mechanical_s;
        let speed_rad_s = SWEEP_SHARE * bounds.speed_limit_rad_s;
        // The slope may take longer where the friction needs more voltage than it reaches.
        let slope_v = (1.5 * slew_v_per_s).max(1.5 * friction_a * lowest_ohm);
        let peak_v = turned.voltage_at(speed_rad_s)?.min(bounds.voltage_limit_v);
        let peak_v = peak_v.min(10.0 * self.last_v).min(slope_v);
        let sweep = BothWays {
            kind: StageKind::Sweep,
            peak_v,
            slew_v_per_s,
            hold_s: peak_v / slew_v_per_s + stage::settle_s(bounds, mechanical_s),
            winding_v: bounds.current_limit_a * lowest_ohm,
            back_emf_v_s_per_rad: turned.motor.get(MotorKey::BackEmf)?,
            stop_current_a: 1.5 * (accelerating_a + friction_a),
            reason: format!("{accelerating_a:.2} A of acceleration at {slew_v_per_s:.1} V/s"),
        };
        Some(Next::Run(sweep.stage(bounds)))
    }

    /// Lower bound of the resistance that the data still allow, ohm; until they allow none, half a per cent of the rated power
    /// is in the winding.
    fn lowest_resistance_ohm(&self) -> f64 {
        let bounds = &self.bounds;
        let least = 0.005 * bounds.rated_voltage_v / bounds.rated_current_a;
        let at_rest = self.rest.filter(|rest| rest.relative() < KNOWN);
        let turned = self.turned.as_ref().and_then(Turned::resistance);
        let lowest = match (turned, at_rest) {
            // The sharper one, but not above what the other allows.
            (Some(turned), Some(rest)) if turned.relative() < rest.relative() => {
                turned.lowest_ohm().min(rest.highest_ohm())
            }
            (Some(turned), Some(rest)) => rest.lowest_ohm().min(turned.highest_ohm()),
            (one, other) => one.or(other).map_or(0.0, |known| known.lowest_ohm()),
        };
        lowest.max(least)
    }

    fn allows_more(&self) -> String {
        format!("{:.3} A at {:.3} V allow more", self.last_a, self.last_v)
    }

    fn found(&self) -> Next {
        let Some((_, turned)) = &self.best else { return not_identified(NOTHING) };
        Next::Over(Box::new(Outcome::Found(Found {
            motor: turned.motor.clone(),
            parameters: turned.parameters.clone(),
        })))
    }
}

/// The end, with its sentence.
fn ended(ending: Ending) -> (Next, String) {
    let sentence = ending.sentence();
    (Next::Over(Box::new(Outcome::Named(ending))), sentence)
}

const NOTHING: &str = "no parameter was estimated";

fn not_identified(reason: impl Into<String>) -> Next {
    let reason = reason.into();
    ended(Ending::NotIdentified { reason }).0
}

/// Relative standard deviation of an estimate that has a value.
fn relative(parameters: &[ParameterEstimate], key: MotorKey) -> Option<f64> {
    let found = ParameterEstimate::find(parameters, key.key())?;
    Some((found.std? / found.value?).abs())
}

/// The run under its commanded voltage: stamped with the instant of application, so no sample of it is missing.
fn scenario_of(run: &Run) -> Result<Scenario, ScenarioError> {
    let mut run = run.clone();
    if run.column(Channel::VoltageCmd).is_some() {
        run.set_origin(Channel::VoltageCmd, Origin::Commanded);
        run.set_origin(Channel::Voltage, Origin::Measured);
    }
    Scenario::from_run(&run)
}

#[cfg(test)]
mod tests;
