//! An unknown motor, from small steps: what each stage has shown decides how large the next one may be.
//!
//! ```text
//! Bounds --> Feel: slow ramps, three times larger each      --- nothing flows ----> open phase
//!            | current shows                \ it turns
//!            v                               \
//!            BreakAway: 50 %, 100 % rated     \           --- current, no motion -> locked rotor
//!            | it turns                        v
//!            +---------------------------> Turn: steps both ways, from R (lower bound) and what was seen before
//!                                            | R, Ke, J known roughly              --- rounds used up -> not identified
//!                                            v
//!                                          Sweep: to a share of the speed limit, slow enough for the current
//!                                            | R, Ke, J known well
//!                                            v
//!                                          Found: the motor; nameplate::compare says whether the plate fits
//! ```
//!
//! Pure arithmetic: a stage goes out, the recorded run comes in. Only the rated values and the limits are taken as
//! certain. Two things keep every stage below the limit of the current without knowing the motor: a ramp that is slow
//! against the sampling is ended as soon as the current or the speed shows (each period adds a few per cent), and a step
//! is no larger than what the lowest resistance that the data still allow turns into the wanted current.

mod ending;
mod observation;
mod stage;

pub use ending::{Ending, Found, Outcome};
pub use observation::{RestWinding, Seen};
pub use stage::{Stage, StageKind};

use serde::Serialize;

use drivebench_model::plant::{MotorKey, Scenario, ScenarioError};
use drivebench_model::sample::{Channel, Origin, ParameterEstimate, Run};
use ending::NoMotion;
use observation::Turned;
use stage::BothWays;

/// Current of the first look, in rated currents.
const FEEL_CURRENT: f64 = 0.3;
/// Largest voltage of the first look, in rated voltages: a motor of which the stall current at rated voltage is not
/// even the rated current would still show a quarter of it.
const SAFE_VOLTAGE: f64 = 0.25;
/// First voltage of the first look, and growth from look to look.
const FIRST_VOLTAGE: f64 = 0.003;
const GROWTH: f64 = 3.0;
/// Current below this share of the rated one counts as none, if it is also within the noise.
const NO_CURRENT: f64 = 0.01;
/// Standard deviations of the noise above which the largest of some hundred samples is a current.
const FLOWS_NOISE: f64 = 6.0;
/// Least resistance that a motor can have, in rated voltages over rated currents: half a per cent of the rated power
/// in the winding. Used only until the data say more.
const LEAST_RESISTANCE: f64 = 0.005;
/// Speed, in limits, at which a look ends: the shaft turns.
const MOVES: f64 = 0.03;
/// Share of the current limit that no step is meant to exceed, and the share of the speed limit.
const CURRENT_SHARE: f64 = 0.8;
const SPEED_SHARE: f64 = 0.5;
/// A sweep goes to this share of the speed limit, to no more than so many times the voltage of before, and takes no
/// longer than this for one slope, s.
const SWEEP_SHARE: f64 = 0.35;
const SWEEP_GROWTH: f64 = 10.0;
const SLOPE_S: f64 = 1.5;
/// Current at which break-away is given up, in rated currents, and the least of it that counts as having been reached.
const BREAK_AWAY: f64 = 1.1;
const REACHED: f64 = 0.85;
/// Rounds of turning, and the relative standard deviation at which R, Ke and J count as found.
const ROUNDS: usize = 8;
const GOOD: f64 = 0.015;
/// Relative standard deviation with which the motor can still be used when the rounds are over.
const USABLE: f64 = 0.15;
/// Relative standard deviation below which a resistance may bound a step.
const KNOWN: f64 = 0.3;
/// Stages of any kind: a guard against going round in circles.
const MOST_STAGES: usize = 24;

/// What is certain before anything is known of the motor.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Bounds {
    pub rated_voltage_v: f64,
    pub rated_current_a: f64,
    pub current_limit_a: f64,
    pub speed_limit_rad_s: f64,
    pub voltage_limit_v: f64,
    /// Period of the samples, s.
    pub period_s: f64,
}

/// One stage that was run, for the record.
#[derive(Clone, Debug, Serialize)]
pub struct StageResult {
    pub kind: StageKind,
    /// Farthest commanded voltage that was reached, V.
    pub peak_v: f64,
    pub peak_current_a: f64,
    pub peak_speed_rad_s: f64,
    /// What came of it, in a sentence.
    pub line: String,
}

impl StageResult {
    /// Before any stage was run.
    pub fn nothing() -> Self {
        Self {
            kind: StageKind::Feel,
            peak_v: 0.0,
            peak_current_a: 0.0,
            peak_speed_rad_s: 0.0,
            line: String::new(),
        }
    }
}

/// The state of an escalation: a stage to run, or how it ended.
#[derive(Clone, Debug)]
pub struct Escalation {
    bounds: Bounds,
    next: Next,
    history: Vec<StageResult>,
    rest: Option<RestWinding>,
    /// Current at which the shaft was last seen to leave rest, A.
    break_away_a: Option<f64>,
    turned: Option<Turned>,
    /// The round that knew the motor best.
    best: Option<Turned>,
    best_is_sweep: bool,
    rounds: usize,
    /// Back-EMF constant from the first motion and its standard deviation, V.s/rad: rough, but enough to bound a speed.
    first_back_emf: Option<(f64, f64)>,
    /// Voltage that the last stage reached, V, and the current that was seen with it, A.
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
        let first_v = (FIRST_VOLTAGE * bounds.rated_voltage_v).min(bounds.voltage_limit_v);
        let nothing = "nothing is known yet".to_owned();
        let first = stage::look(&bounds, StageKind::Feel, first_v, nothing);
        Self {
            bounds,
            next: Next::Run(first),
            history: Vec::new(),
            rest: None,
            break_away_a: None,
            turned: None,
            best: None,
            best_is_sweep: false,
            rounds: 0,
            first_back_emf: None,
            last_v: first_v,
            last_a: 0.0,
            last_moved: false,
        }
    }

    /// What may follow the first stage, in sentences: how large each will be is decided by what the one before has shown.
    pub fn outlook() -> Vec<String> {
        vec![
            format!(
                "feel: as long as neither current nor motion shows, the same {GROWTH} times larger, up to {SAFE_VOLTAGE} of the rated voltage"
            ),
            format!(
                "break away: slowly up to {BREAK_AWAY} rated currents, until the shaft leaves its rest"
            ),
            format!(
                "turn: steps both ways, through the least resistance that the data allow, to at most {CURRENT_SHARE} of the current limit and {SPEED_SHARE} of the speed limit; {ROUNDS} rounds at most"
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

    /// How it ended.
    pub fn outcome(&self) -> Option<&Outcome> {
        match &self.next {
            Next::Run(_) => None,
            Next::Over(outcome) => Some(outcome),
        }
    }

    /// What was run so far.
    pub fn history(&self) -> &[StageResult] {
        &self.history
    }

    /// Takes the record of the stage that was asked for.
    pub fn learn(&mut self, run: &Run) -> Result<(), ScenarioError> {
        let Next::Run(stage) = &self.next else {
            return Ok(());
        };
        let stage = stage.clone();
        let scenario = scenario_of(run)?;
        let seen = Seen::of(&scenario, run, &self.bounds);
        (self.last_v, self.last_a) = (seen.peak_v.abs(), seen.peak_current_a.abs());
        self.last_moved = seen.moves();
        let (next, line) = self.judge(&stage, &scenario, &seen);
        self.history.push(StageResult {
            kind: stage.kind,
            peak_v: seen.peak_v,
            peak_current_a: seen.peak_current_a,
            peak_speed_rad_s: seen.peak_speed_rad_s,
            line,
        });
        self.next = if self.history.len() >= MOST_STAGES && matches!(next, Next::Run(_)) {
            not_identified(format!("{MOST_STAGES} stages were run"))
        } else {
            next
        };
        Ok(())
    }

    fn judge(&mut self, stage: &Stage, scenario: &Scenario, seen: &Seen) -> (Next, String) {
        if let Some(ending) = ending::wrong_sign(seen) {
            return ended(ending);
        }
        match stage.kind {
            StageKind::Feel => self.felt(scenario, seen),
            StageKind::BreakAway => self.broke_away(scenario, seen),
            StageKind::Turn | StageKind::Sweep => self.turned(stage.kind, scenario, seen),
        }
    }

    /// Current, motion, or a larger look.
    fn felt(&mut self, scenario: &Scenario, seen: &Seen) -> (Next, String) {
        self.learn_rest(scenario, seen);
        let bounds = &self.bounds;
        if seen.moves() {
            return (self.turn(), format!("it turns already, {}", seen.text()));
        }
        let rated_a = bounds.rated_current_a;
        let shows = seen.peak_current_a.abs() >= 0.8 * FEEL_CURRENT * rated_a;
        let safe_v = (SAFE_VOLTAGE * bounds.rated_voltage_v).min(bounds.voltage_limit_v);
        let line = format!("at rest, {}", seen.text());
        // Beyond the safe voltage only on a current that noise does not make.
        let flows =
            seen.peak_current_a.abs() > (NO_CURRENT * rated_a).max(FLOWS_NOISE * seen.noise_a);
        if shows && flows || (self.last_v >= safe_v * 0.999 && self.rest.is_some() && flows) {
            return (self.break_away(), line);
        }
        if self.last_v >= safe_v * 0.999 {
            return ended(ending::no_current(seen, NO_CURRENT * rated_a));
        }
        // A resistance that is known spares looks in between; one that is not allows no more than the usual growth.
        let (least_v, most_v) = (1.2 * self.last_v, GROWTH * self.last_v);
        let known = self.rest.filter(|rest| rest.relative() < KNOWN);
        let mut wanted_v = known.map_or(most_v, |rest| {
            (1.05 * FEEL_CURRENT * rated_a * rest.lowest_ohm()).clamp(least_v, most_v)
        });
        // No further look for the last few per cent.
        if wanted_v > 0.9 * safe_v {
            wanted_v = safe_v;
        }
        (
            Next::Run(stage::look(
                bounds,
                StageKind::Feel,
                wanted_v,
                self.leaves_room(),
            )),
            line,
        )
    }

    fn broke_away(&mut self, scenario: &Scenario, seen: &Seen) -> (Next, String) {
        let before = self.rest;
        self.learn_rest(scenario, seen);
        if seen.moves() {
            return (self.turn(), format!("it breaks away, {}", seen.text()));
        }
        let bounds = &self.bounds;
        let reached_a = REACHED * bounds.rated_current_a;
        match ending::no_motion(seen, before, reached_a, bounds) {
            NoMotion::Named(ending) => ended(ending),
            NoMotion::TooSlowToSee => {
                let line = format!("it may turn too slowly to be seen, {}", seen.text());
                let safe_v = (SAFE_VOLTAGE * bounds.rated_voltage_v).min(bounds.voltage_limit_v);
                let wanted_v = (GROWTH * self.last_v).min(safe_v);
                if wanted_v < 1.2 * self.last_v {
                    let reason = format!("no speed that can be seen at {:.1} V", self.last_v);
                    return (not_identified(reason), line);
                }
                let reason = "a back-EMF shows, a speed not yet".to_owned();
                let stage = stage::look(bounds, StageKind::BreakAway, wanted_v, reason);
                (Next::Run(stage), line)
            }
        }
    }

    fn turned(&mut self, kind: StageKind, scenario: &Scenario, seen: &Seen) -> (Next, String) {
        self.rounds += 1;
        let found = observation::turned(scenario, self.rest);
        let line = match &found {
            Ok(found) => found.text(),
            Err(reason) => format!("{}: {reason}", seen.text()),
        };
        let failure = found.as_ref().err().cloned();
        if let Ok(found) = found {
            // A sweep has seen more of the motor than any step: it counts before a sharper number from a corner of it.
            let best = self.best.as_ref();
            let sharper = best.is_none_or(|best| found.worst() < best.worst());
            let first_sweep = kind == StageKind::Sweep && !self.best_is_sweep;
            if first_sweep || (sharper && (kind == StageKind::Sweep) == self.best_is_sweep) {
                self.best = Some(found.clone());
                self.best_is_sweep = kind == StageKind::Sweep;
            }
            self.turned = Some(found);
        }
        let is_within =
            |found: &Option<Turned>, most| found.as_ref().is_some_and(|it| it.is_within(most));
        let within = |most| is_within(&self.turned, most);
        // Only a sweep has shown more than a corner of what the motor will be used for.
        let best_is_usable = is_within(&self.best, USABLE);
        if (within(GOOD) && kind == StageKind::Sweep) || (best_is_usable && self.rounds >= ROUNDS) {
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

    fn learn_rest(&mut self, scenario: &Scenario, seen: &Seen) {
        let found = observation::at_rest(scenario, seen);
        self.rest = match (self.rest, found) {
            (Some(old), Some(new)) if old.relative() < new.relative() => Some(old),
            (old, new) => new.or(old),
        };
        if seen.moves() {
            self.break_away_a = Some(seen.break_away_current_a);
            self.first_back_emf = Some(seen.back_emf(self.rest));
        }
    }

    fn break_away(&self) -> Next {
        let bounds = &self.bounds;
        let Some(rest) = self.rest else {
            return not_identified(
                "current flows, but not in proportion to the voltage: its resistance cannot be told",
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
        let wanted_a = (share * rated_a)
            .max(friction_a + 0.5 * rated_a)
            .min(most_a);
        let mut volts = wanted_a * lowest_ohm;
        let mut reason = format!("{wanted_a:.2} A through at least {lowest_ohm:.3} ohm");
        if self.rounds > 0 && !self.knows_resistance() && self.last_a < 0.3 * rated_a {
            // A step that drew next to nothing still tells that three times as much is bearable.
            volts = volts.max(GROWTH * self.last_v);
            reason = self.leaves_room();
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
            // What has been borne is no reason to stop; a step that did not turn the shaft is one to go on.
            .max(if self.last_moved { 0.5 } else { 1.5 } * self.last_v)
            .min(bounds.voltage_limit_v);
        if volts > fastest_v {
            volts = fastest_v;
            reason = format!("at most {speed_rad_s:.1} rad/s");
        }
        // A step is never more than four times what was borne before.
        let grown_v = 4.0 * self.last_v;
        if volts > grown_v {
            volts = grown_v;
            reason = format!("four times the {:.3} V of before", self.last_v);
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
        // Half as slow again as what was found: an inertia that was hardly seen may be larger.
        let mechanical_s = 1.5 * turned.mechanical_s()?.max(bounds.period_s);
        let slew_v_per_s = accelerating_a * lowest_ohm / mechanical_s;
        let speed_rad_s = SWEEP_SHARE * bounds.speed_limit_rad_s;
        // The slope may take longer where the friction needs more voltage than it reaches.
        let slope_v = (SLOPE_S * slew_v_per_s).max(1.5 * friction_a * lowest_ohm);
        let peak_v = turned
            .voltage_at(speed_rad_s)?
            .min(bounds.voltage_limit_v)
            .min(SWEEP_GROWTH * self.last_v)
            .min(slope_v);
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

    /// What the data still allow the resistance to be, ohm.
    fn lowest_resistance_ohm(&self) -> f64 {
        let bounds = &self.bounds;
        let least = LEAST_RESISTANCE * bounds.rated_voltage_v / bounds.rated_current_a;
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

    fn knows_resistance(&self) -> bool {
        let turned = self.turned.as_ref().and_then(Turned::resistance);
        self.rest.is_some_and(|rest| rest.relative() < KNOWN) || turned.is_some()
    }

    fn leaves_room(&self) -> String {
        format!("{:.3} A at {:.3} V leave room", self.last_a, self.last_v)
    }

    fn found(&self) -> Next {
        let Some(turned) = &self.best else {
            return not_identified(NOTHING);
        };
        Next::Over(Box::new(Outcome::Found(Found {
            motor: turned.motor.clone(),
            parameters: turned.parameters.clone(),
        })))
    }
}

/// The end, with its sentence.
fn ended(ending: Ending) -> (Next, String) {
    let sentence = ending.sentence();
    (over(ending), sentence)
}

fn over(ending: Ending) -> Next {
    Next::Over(Box::new(Outcome::Named(ending)))
}

const NOTHING: &str = "nothing was learnt";

fn not_identified(reason: impl Into<String>) -> Next {
    let reason = reason.into();
    over(Ending::NotIdentified { reason })
}

/// Relative standard deviation of an estimate that has a value.
fn relative(parameters: &[ParameterEstimate], key: MotorKey) -> Option<f64> {
    let found = ParameterEstimate::find(parameters, key.key())?;
    Some((found.std? / found.value?).abs())
}

/// The run under its commanded voltage: stamped with the instant of application, so no sample of it is missing.
fn scenario_of(run: &Run) -> Result<Scenario, ScenarioError> {
    let mut run = run.clone();
    if let Some(cells) = run.column(Channel::VoltageCmd).map(<[f64]>::to_vec) {
        // The length is the run's own.
        let _ = run.set_column(Channel::VoltageCmd, cells, Origin::Commanded);
        if let Some(cells) = run.column(Channel::Voltage).map(<[f64]>::to_vec) {
            let _ = run.set_column(Channel::Voltage, cells, Origin::Measured);
        }
    }
    Scenario::from_run(&run)
}

#[cfg(test)]
mod tests;
