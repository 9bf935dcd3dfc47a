//! The speed loop as a pilot: reference, controller and limiter, answering to samples.

use super::delay::DelayMeter;
use super::reference::Reference;
use super::regulator::Regulator;
use super::report::{Cycle, GainChange, SpeedReport, Watched, adaptation_csv, figures, tracking};
use crate::pilot::{Pilot, PilotNews};
use crate::trip::{Trip, TripKind};
use drivebench_control::{Adapted, Finding, LoopWatch, Measured, SpeedController};
use drivebench_model::sample::{Channel, Command, Demand, Sample};

/// Cycles that are kept for the figures: at 100 Hz nearly three hours.
const RECORD_MAX: usize = 1_000_000;
/// Changes of the gains, and findings of the watch, that are kept for the result; the events hold all of them.
const CHANGES_MAX: usize = 10_000;
/// Sampling times that a controller is told, in periods: after a gap it must not believe in a jump.
const SHORTEST_PERIODS: f64 = 0.2;
const LONGEST_PERIODS: f64 = 20.0;
/// Until the encoder has been seen to turn in the right direction the controller has this share of its current, but no
/// longer than so many seconds: a shaft that needs more to break away has to get it.
const FIRST_MOVE: f64 = 0.4;
const FIRST_MOVE_S: f64 = 0.3;

/// The loop's settings beside the regulator.
pub struct PilotSettings {
    pub slew_v_per_s: f64,
    /// Longest time for which the last output is held without a speed, s.
    pub silence_s: f64,
    /// What holds a load at rest, in the unit of the command.
    pub hold: f64,
}

/// A speed loop over a voltage, current or speed command.
pub struct SpeedPilot {
    regulator: Regulator,
    /// The pass over the reference, whose controller is at work.
    pass: usize,
    reference: Reference,
    settings: PilotSettings,
    /// The encoder has been seen to turn in the right direction.
    encoder_proven: bool,
    meter: DelayMeter,
    reference_rad_s: Option<f64>,
    /// The sample that the next output answers to, and when it came.
    fresh: Option<Sample>,
    came_s: f64,
    /// Time stamp and speed of the sample that was answered last.
    answered: Option<(f64, f64)>,
    /// Host time of the last sample with a speed.
    heard_s: f64,
    /// Whether the controller waits to be told what left.
    stepped: bool,
    wanted: f64,
    output: f64,
    elapsed_s: f64,
    held_cycles: u64,
    changes: Vec<GainChange>,
    watch: LoopWatch,
    found: Vec<Watched>,
    /// What the watch found and nobody was told of.
    untold: Option<String>,
    /// Drive time, and what the controller followed then.
    adaptation: Vec<(f64, Adapted)>,
    record: Vec<Cycle>,
}

impl SpeedPilot {
    pub fn new(regulator: Regulator, reference: Reference, settings: PilotSettings) -> Self {
        Self {
            encoder_proven: false,
            watch: watch_of(&regulator, 0),
            regulator,
            pass: 0,
            reference,
            settings,
            meter: DelayMeter::default(),
            reference_rad_s: None,
            fresh: None,
            came_s: 0.0,
            answered: None,
            heard_s: 0.0,
            stepped: false,
            wanted: 0.0,
            output: 0.0,
            elapsed_s: 0.0,
            held_cycles: 0,
            changes: Vec::new(),
            found: Vec::new(),
            untold: None,
            adaptation: Vec::new(),
            record: Vec::new(),
        }
    }

    /// One step of the controller on a sample with a speed.
    fn answer(
        &mut self,
        now_s: f64,
        sample: &Sample,
        speed_rad_s: f64,
        elapsed_s: f64,
    ) -> Result<(), Trip> {
        let timing = &self.regulator.timing;
        let shortest_s = SHORTEST_PERIODS * timing.period_s;
        let longest_s = LONGEST_PERIODS * timing.period_s;
        let period_s = match self.answered {
            Some((before_s, _)) => (sample.time_s - before_s).clamp(shortest_s, longest_s),
            None => timing.period_s,
        };
        // The first reference after a start is the speed that is there.
        let reference = match self.answered {
            Some(_) => self.reference.value_at(elapsed_s),
            None => speed_rad_s,
        };
        let gained_rad_s = self.answered.map(|(_, before)| speed_rad_s - before);
        let acceleration = gained_rad_s.map_or(0.0, |gained| gained / period_s);
        let now = Measured {
            speed_rad_s,
            current_a: sample.get(Channel::Current),
            angle_rad: sample.get(Channel::Angle),
            limited: sample.limited,
        };
        self.turn_to_pass(elapsed_s, &now);
        self.look(now_s, reference, &now, period_s)?;
        let (whole, came_s) = (&self.reference, self.came_s);
        let ahead = |ahead_s: f64| whole.value_at(came_s + ahead_s);
        self.regulator.passes[self.pass].1.foresee(&ahead);
        self.wanted = self.controller().step(reference, &now, period_s);
        if let Some(adapted) = self.controller().adapted()
            && self.adaptation.len() < RECORD_MAX
        {
            self.adaptation.push((sample.time_s, adapted));
        }
        let mut limiter = self.regulator.limiter;
        let unproven = !self.encoder_proven && elapsed_s < FIRST_MOVE_S;
        if let Some(current) = limiter.current.as_mut().filter(|_| unproven) {
            current.current_a *= FIRST_MOVE;
        }
        self.output = limiter.limit(self.wanted, speed_rad_s, acceleration);
        self.reference_rad_s = Some(reference);
        self.answered = Some((sample.time_s, speed_rad_s));
        self.stepped = true;
        Ok(())
    }

    /// What the watch says of the last cycle, and what comes of it.
    fn look(
        &mut self,
        now_s: f64,
        reference_rad_s: f64,
        now: &Measured,
        period_s: f64,
    ) -> Result<(), Trip> {
        let limited = now.limited || self.is_cut();
        let speed_rad_s = now.speed_rad_s;
        let Some(finding) = self.watch.push(reference_rad_s, speed_rad_s, limited) else {
            return Ok(());
        };
        let share = self.watch.share();
        if let Finding::Soften { .. } | Finding::GiveBack { .. } = finding {
            (self.controller()).soften(share, reference_rad_s, speed_rad_s, period_s);
        }
        let (found, error_rad_s, reason) = self.words(reference_rad_s, &finding);
        if self.found.len() < CHANGES_MAX {
            self.found.push(Watched {
                time_s: self.elapsed_s,
                found,
                error_rad_s,
                gain_share: share,
                reason: reason.clone(),
            });
        }
        match finding {
            Finding::SwingsOn { swing_rad_s, most_rad_s } => {
                let figures = (swing_rad_s, most_rad_s);
                Err(Trip::new(TripKind::LoopSwings, now_s, figures, reason))
            }
            Finding::Saturated { error_rad_s, .. } => {
                let figures = (error_rad_s, 0.0);
                Err(Trip::new(TripKind::LoopSaturated, now_s, figures, reason))
            }
            _ => {
                self.untold = Some(reason);
                Ok(())
            }
        }
    }

    /// Name, size and sentence of what the watch found.
    fn words(&self, reference_rad_s: f64, finding: &Finding) -> (&'static str, f64, String) {
        let about = |swing_rad_s: f64| {
            format!("the speed swings by {swing_rad_s:.1} rad/s about {reference_rad_s:.1} rad/s")
        };
        let (_, controller) = &self.regulator.passes[self.pass];
        let why = if controller.softens() {
            "softer gains do not help"
        } else {
            "and this controller has no gains that could fall"
        };
        match *finding {
            Finding::Soften { swing_rad_s, share } => {
                let to = 100.0 * share;
                let reason = format!("{}: {to:.0} % of the tuned gain", about(swing_rad_s));
                ("softened", swing_rad_s, reason)
            }
            Finding::GiveBack { swing_rad_s } => {
                let reason = format!(
                    "{} with the softest gains too: it is not the loop's own, the tuned gain is given back",
                    about(swing_rad_s)
                );
                ("given_back", swing_rad_s, reason)
            }
            Finding::Swings { swing_rad_s } => ("swings", swing_rad_s, about(swing_rad_s)),
            Finding::SwingsOn { swing_rad_s, most_rad_s } => {
                let reason = format!(
                    "{} and goes on, {why}; {most_rad_s:.1} rad/s are allowed; take addc or pi, tuned on a model that was identified on this machine (a coupling or play belongs into it; addc follows an inertia that changed), or a faster link",
                    about(swing_rad_s)
                );
                ("swings_on", swing_rad_s, reason)
            }
            Finding::Saturated { limited_share, error_rad_s } => {
                let reason = format!(
                    "a limit held the output in {:.0} % of the last second, and the error of {error_rad_s:.1} rad/s to {reference_rad_s:.1} rad/s does not fall; lower the reference or the load, or raise speed.current_limit_a",
                    100.0 * limited_share
                );
                ("saturated", error_rad_s, reason)
            }
        }
    }

    /// Whether a limit on this side cut the last output.
    fn is_cut(&self) -> bool {
        (self.wanted - self.output).abs() > 1e-9 * self.wanted.abs().max(1.0)
    }

    fn controller(&mut self) -> &mut dyn SpeedController {
        self.regulator.passes[self.pass].1.as_mut()
    }

    /// Each pass over the reference has its own controller, which begins with what is asked now.
    fn turn_to_pass(&mut self, elapsed_s: f64, now: &Measured) {
        let pass = self.reference.pass_at(elapsed_s);
        let pass = pass.min(self.regulator.passes.len().saturating_sub(1));
        if pass != self.pass {
            self.pass = pass;
            self.watch = watch_of(&self.regulator, pass);
            let output = self.output;
            self.controller().reset(now, output);
        }
    }
}

/// The watch of the controller of a pass.
fn watch_of(regulator: &Regulator, pass: usize) -> LoopWatch {
    let softens = regulator.passes.get(pass).is_some_and(|(_, one)| one.softens());
    LoopWatch::new(regulator.noise_rad_s, regulator.timing.period_s, softens)
}

impl Pilot for SpeedPilot {
    fn duration_s(&self) -> f64 {
        self.reference.duration_s()
    }

    fn segment_at(&self, time_s: f64) -> usize {
        self.reference.part_at(time_s)
    }

    fn segment_name(&self, index: usize) -> &str {
        self.reference.part_name(index)
    }

    fn zero(&self) -> Demand {
        self.regulator.actuator.demand(self.settings.hold)
    }

    fn slew_v_per_s(&self) -> Option<f64> {
        Some(self.settings.slew_v_per_s)
    }

    fn begin(&mut self, now_s: f64, sample: Option<&Sample>) {
        let read = |channel| sample.and_then(|sample| sample.get(channel));
        let speed_rad_s = read(Channel::Speed).unwrap_or(0.0);
        let now = Measured { current_a: read(Channel::Current), ..Measured::at(speed_rad_s) };
        let output = self.regulator.holding.output(speed_rad_s) + self.settings.hold;
        self.pass = 0;
        self.controller().reset(&now, output);
        self.encoder_proven = false;
        self.watch = watch_of(&self.regulator, self.pass);
        self.fresh = sample.cloned();
        self.came_s = 0.0;
        self.answered = None;
        self.heard_s = now_s;
        (self.output, self.wanted) = (output, output);
        self.stepped = false;
        self.reference_rad_s = Some(speed_rad_s);
        self.record.clear();
        self.adaptation.clear();
    }

    fn demand(&mut self, now_s: f64, elapsed_s: f64) -> Result<Demand, Trip> {
        self.elapsed_s = elapsed_s;
        let fresh = self.fresh.take();
        let speed = fresh.as_ref().and_then(|sample| sample.get(Channel::Speed));
        if let (Some(sample), Some(speed)) = (&fresh, speed) {
            self.answer(now_s, sample, speed, elapsed_s)?;
        } else {
            // Nothing to answer to: what was asked last goes on, for as long as may be.
            self.held_cycles += 1;
            self.reference_rad_s = Some(self.reference.value_at(elapsed_s));
            let silent_s = now_s - self.heard_s;
            if silent_s > self.settings.silence_s {
                let (kind, times_s) =
                    (TripKind::SignalMissing, (silent_s, self.settings.silence_s));
                return Err(Trip::after(kind, now_s, times_s, "no speed"));
            }
        }
        Ok(self.regulator.actuator.demand(self.output))
    }

    fn sent(&mut self, command: &Command) {
        let Some(output) = self.regulator.actuator.of(command.demand) else {
            return;
        };
        // What the guard let through.
        self.output = output;
        if std::mem::take(&mut self.stepped) {
            self.controller().applied(output);
            if let Some((time_s, _)) = self.answered {
                self.meter.sent(command.seq, time_s);
            }
        }
    }

    fn sample(&mut self, now_s: f64, elapsed_s: f64, sample: &Sample, encoder_proven: bool) {
        self.meter.sample(sample);
        self.encoder_proven = encoder_proven;
        let Some(speed_rad_s) = sample.get(Channel::Speed) else {
            return;
        };
        self.heard_s = now_s;
        self.fresh = Some(sample.clone());
        self.came_s = elapsed_s;
        if self.record.len() < RECORD_MAX {
            self.record.push(Cycle {
                time_s: elapsed_s,
                reference_rad_s: self.reference.value_at(elapsed_s),
                speed_rad_s,
                output: self.output,
                limited: sample.limited || self.is_cut(),
            });
        }
    }

    fn reference_rad_s(&self) -> Option<f64> {
        self.reference_rad_s
    }

    fn news(&mut self) -> Option<PilotNews> {
        if let Some(found) = self.untold.take() {
            return Some(PilotNews::Watch(found));
        }
        let reason = self.controller().news()?;
        if self.changes.len() < CHANGES_MAX {
            self.changes.push(GainChange { time_s: self.elapsed_s, reason: reason.clone() });
        }
        Some(PilotNews::Gains(reason))
    }

    fn report(&self) -> Option<SpeedReport> {
        let timing = self.regulator.timing;
        let (_, controller) = &self.regulator.passes[self.pass];
        let passes = self.regulator.passes.iter().zip(self.reference.passes());
        let passes: Vec<_> = passes.map(|((forward, _), pass)| (*forward, *pass)).collect();
        Some(SpeedReport {
            controller: controller.id(),
            actuator: self.regulator.actuator,
            timing,
            delay: self.meter.delay(timing.period_s),
            reasons: self.regulator.reasons.clone(),
            gains: controller.explain(),
            gain_changes: self.changes.clone(),
            watch: self.found.clone(),
            adaptation: adaptation_csv(self.regulator.actuator, &self.adaptation),
            held_cycles: self.held_cycles,
            tracking: tracking(&self.record, &passes),
            steps: figures(
                &self.record,
                &self.reference.steps(),
                &|time_s| {
                    let pass = self.reference.pass_at(time_s);
                    let controller = self.regulator.passes.get(pass);
                    controller.map_or(0.0, |(_, controller)| controller.leads_s())
                },
                self.regulator.noise_rad_s,
            ),
        })
    }
}
