//! The speed loop as a pilot: reference, controller and limiter, one step for each sample.

use super::delay::DelayMeter;
use super::reference::Reference;
use super::regulator::Regulator;
use super::report::{Cycle, GainChange, SpeedReport, Watched, adaptation_csv, figures, tracking};
use crate::pilot::{Pilot, PilotEvent};
use crate::trip::{Trip, TripKind};
use drivebench_control::{Adapted, Finding, LoopWatch, Measured, NextStep, SpeedController};
use drivebench_model::sample::{Channel, Command, Demand, Sample};

/// Cycles that are kept for the figures: at 100 Hz nearly three hours.
const RECORD_MAX: usize = 1_000_000;
/// Changes of the gains, and findings of the detector, that are kept for the result; the events hold all of them.
const CHANGES_MAX: usize = 10_000;

pub struct PilotSettings {
    pub slew_v_per_s: f64,
    /// Longest time for which the last output is held without a speed, s.
    pub silence_s: f64,
    /// Output that holds a load at rest, in the unit of the command.
    pub hold: f64,
}

/// A speed loop over a voltage, current or speed command.
pub struct SpeedPilot {
    regulator: Regulator,
    /// The present pass over the reference, with its controller.
    pass: usize,
    reference: Reference,
    settings: PilotSettings,
    encoder_proven: bool,
    meter: DelayMeter,
    reference_rad_s: Option<f64>,
    /// The sample for the next step, and its time since the begin of the run, s.
    fresh: Option<Sample>,
    sampled_s: f64,
    /// Time stamp and speed of the sample of the last step.
    stepped: Option<(f64, f64)>,
    /// Host time of the last sample with a speed.
    speed_at_s: f64,
    /// The output after all limits is still to be passed to the controller, for its anti-windup.
    is_output_due: bool,
    wanted: f64,
    output: f64,
    elapsed_s: f64,
    held_cycles: u64,
    changes: Vec<GainChange>,
    watch: LoopWatch,
    found: Vec<Watched>,
    /// A finding that is not in the log yet.
    unlogged: Option<String>,
    /// Drive time, gains and estimates.
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
            sampled_s: 0.0,
            stepped: None,
            speed_at_s: 0.0,
            is_output_due: false,
            wanted: 0.0,
            output: 0.0,
            elapsed_s: 0.0,
            held_cycles: 0,
            changes: Vec::new(),
            found: Vec::new(),
            unlogged: None,
            adaptation: Vec::new(),
            record: Vec::new(),
        }
    }

    /// One step of the controller on a sample with a speed.
    fn step(
        &mut self,
        now_s: f64,
        sample: &Sample,
        speed_rad_s: f64,
        elapsed_s: f64,
    ) -> Result<(), Trip> {
        let period_s = self.regulator.timing.period_s;
        let (period_s, reference, acceleration) = match self.stepped {
            Some((before_s, before_rad_s)) => {
                // After a gap the controller must not take the change of speed for a jump.
                let since_s = sample.time_s - before_s;
                let since_s = since_s.clamp(0.2 * period_s, 20.0 * period_s);
                let acceleration = (speed_rad_s - before_rad_s) / since_s;
                (since_s, self.reference.value_at(elapsed_s), acceleration)
            }
            // A start is bumpless: its first reference is the measured speed.
            None => (period_s, speed_rad_s, 0.0),
        };
        let now = Measured {
            speed_rad_s,
            current_a: sample.get(Channel::Current),
            angle_rad: sample.get(Channel::Angle),
            limited: sample.limited,
        };
        self.switch_pass(elapsed_s, &now);
        self.supervise(now_s, reference, &now, period_s)?;
        let (all, sampled_s) = (&self.reference, self.sampled_s);
        self.regulator.passes[self.pass]
            .1
            .preview(&|ahead_s: f64| all.value_at(sampled_s + ahead_s));
        self.wanted = self.controller().step(reference, &now, period_s);
        if let Some(adapted) = self.controller().adapted()
            && self.adaptation.len() < RECORD_MAX
        {
            self.adaptation.push((sample.time_s, adapted));
        }
        let mut limiter = self.regulator.limiter;
        // Less current until the encoder has turned in the right direction, but not for long: a shaft that needs more to
        // break away has to get it.
        let is_unproven = !self.encoder_proven && elapsed_s < 0.3;
        if let Some(current) = limiter.current.as_mut().filter(|_| is_unproven) {
            current.current_a *= 0.4;
        }
        self.output = limiter.limit(self.wanted, speed_rad_s, acceleration);
        self.reference_rad_s = Some(reference);
        self.stepped = Some((sample.time_s, speed_rad_s));
        self.is_output_due = true;
        Ok(())
    }

    /// The oscillation detector, and the reaction to its finding.
    fn supervise(
        &mut self,
        now_s: f64,
        reference_rad_s: f64,
        now: &Measured,
        period_s: f64,
    ) -> Result<(), Trip> {
        let (limited, speed_rad_s) = (now.limited || self.is_clipped(), now.speed_rad_s);
        let Some(finding) = self.watch.push(reference_rad_s, speed_rad_s, limited) else {
            return Ok(());
        };
        let share = self.watch.share();
        if let Finding::ReduceGain { .. } | Finding::RestoreGain { .. } = finding {
            let next = NextStep { reference_rad_s, speed_rad_s, period_s };
            self.controller().set_gain_share(share, next);
        }
        let (found, error_rad_s, reason) = self.describe(reference_rad_s, &finding);
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
            Finding::Persists { amplitude_rad_s, most_rad_s } => {
                Err(Trip::new(TripKind::LoopSwings, now_s, (amplitude_rad_s, most_rad_s), reason))
            }
            Finding::Saturated { error_rad_s, .. } => {
                Err(Trip::new(TripKind::LoopSaturated, now_s, (error_rad_s, 0.0), reason))
            }
            _ => {
                self.unlogged = Some(reason);
                Ok(())
            }
        }
    }

    /// Name, amplitude or error, and sentence of a finding.
    fn describe(&self, reference_rad_s: f64, finding: &Finding) -> (&'static str, f64, String) {
        let about = |amplitude_rad_s: f64| {
            format!(
                "the speed oscillates by {amplitude_rad_s:.1} rad/s about {reference_rad_s:.1} rad/s"
            )
        };
        match *finding {
            Finding::ReduceGain { amplitude_rad_s, share } => {
                let about = about(amplitude_rad_s);
                let reason = format!("{about}: {:.0} % of the tuned gain", 100.0 * share);
                ("softened", amplitude_rad_s, reason)
            }
            Finding::RestoreGain { amplitude_rad_s } => {
                let reason = format!(
                    "{} with the smallest gains too: it is not the loop's own oscillation, the tuned gain is restored",
                    about(amplitude_rad_s)
                );
                ("given_back", amplitude_rad_s, reason)
            }
            Finding::Oscillates { amplitude_rad_s } => {
                ("swings", amplitude_rad_s, about(amplitude_rad_s))
            }
            Finding::Persists { amplitude_rad_s, most_rad_s } => {
                let why = if self.regulator.passes[self.pass].1.can_reduce_gain() {
                    "smaller gains do not help"
                } else {
                    "and this controller has no gains that could fall"
                };
                let reason = format!(
                    "{} and does not stop, {why}; {most_rad_s:.1} rad/s are allowed; take addc or pi, tuned on a model that was identified on this machine (a coupling or backlash belongs in it; addc follows an inertia that changed), or a faster link",
                    about(amplitude_rad_s)
                );
                ("swings_on", amplitude_rad_s, reason)
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

    /// Whether a limit of the host clipped the last output.
    fn is_clipped(&self) -> bool {
        (self.wanted - self.output).abs() > 1e-9 * self.wanted.abs().max(1.0)
    }

    fn controller(&mut self) -> &mut dyn SpeedController {
        self.regulator.passes[self.pass].1.as_mut()
    }

    /// Each pass over the reference has its own controller, which begins with the present output.
    fn switch_pass(&mut self, elapsed_s: f64, now: &Measured) {
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

fn watch_of(regulator: &Regulator, pass: usize) -> LoopWatch {
    let can_reduce_gain = regulator.passes.get(pass).is_some_and(|(_, one)| one.can_reduce_gain());
    LoopWatch::new(regulator.noise_rad_s, regulator.timing.period_s, can_reduce_gain)
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
        self.controller().reset(&now, output);
        self.fresh = sample.cloned();
        self.speed_at_s = now_s;
        (self.output, self.wanted) = (output, output);
        self.reference_rad_s = Some(speed_rad_s);
    }

    fn demand(&mut self, now_s: f64, elapsed_s: f64) -> Result<Demand, Trip> {
        self.elapsed_s = elapsed_s;
        let fresh = self.fresh.take();
        let speed = fresh.as_ref().and_then(|sample| sample.get(Channel::Speed));
        if let (Some(sample), Some(speed)) = (&fresh, speed) {
            self.step(now_s, sample, speed, elapsed_s)?;
        } else {
            // Without a speed the last output is held, within the allowed silence.
            self.held_cycles += 1;
            self.reference_rad_s = Some(self.reference.value_at(elapsed_s));
            let times_s = (now_s - self.speed_at_s, self.settings.silence_s);
            if times_s.0 > times_s.1 {
                return Err(Trip::after(TripKind::SignalMissing, now_s, times_s, "no speed"));
            }
        }
        Ok(self.regulator.actuator.demand(self.output))
    }

    fn sent(&mut self, command: &Command) {
        let Some(output) = self.regulator.actuator.of(command.demand) else {
            return;
        };
        // As shaped by the guard.
        self.output = output;
        if std::mem::take(&mut self.is_output_due) {
            self.controller().applied(output);
            if let Some((time_s, _)) = self.stepped {
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
        self.speed_at_s = now_s;
        self.fresh = Some(sample.clone());
        self.sampled_s = elapsed_s;
        if self.record.len() < RECORD_MAX {
            self.record.push(Cycle {
                time_s: elapsed_s,
                reference_rad_s: self.reference.value_at(elapsed_s),
                speed_rad_s,
                output: self.output,
                limited: sample.limited || self.is_clipped(),
            });
        }
    }

    fn reference_rad_s(&self) -> Option<f64> {
        self.reference_rad_s
    }

    fn next_event(&mut self) -> Option<PilotEvent> {
        if let Some(found) = self.unlogged.take() {
            return Some(PilotEvent::Watch(found));
        }
        let reason = self.controller().gain_change()?;
        if self.changes.len() < CHANGES_MAX {
            self.changes.push(GainChange { time_s: self.elapsed_s, reason: reason.clone() });
        }
        Some(PilotEvent::Gains(reason))
    }

    fn report(&self) -> Option<SpeedReport> {
        let timing = self.regulator.timing;
        let (_, controller) = &self.regulator.passes[self.pass];
        let passes = self.regulator.passes.iter().zip(self.reference.passes());
        let passes: Vec<_> = passes.map(|((forward, _), pass)| (*forward, *pass)).collect();
        Some(SpeedReport {
            controller: self.regulator.controller.id(),
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
                    let controller = self.regulator.passes.get(self.reference.pass_at(time_s));
                    controller.map_or(0.0, |(_, controller)| controller.preview_s())
                },
                self.regulator.noise_rad_s,
            ),
        })
    }
}
