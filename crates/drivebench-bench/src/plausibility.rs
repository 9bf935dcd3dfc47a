//! Fault detection of sensors and actuator while the output is on: commands, voltage, current, speed and angle are compared
//! with each other.
//!
//! ```text
//! commands, samples --history.rs--> rows --+-- by the balances: what no factor of 0.5 to 2 makes fit   (contradiction.rs)
//!                                          +-- measured voltage, current or speed against set-points  (readings.rs)
//!                                          +-- readings equal to the bit, while others change         (belief::Repeats)
//!                                          +-- angle against speed; speed beyond its reference        (readings.rs)
//! ```
//!
//! Every quantity is a range over the last cycles, so that a drive which answers some cycles late, or reads a sensor only
//! every few cycles, causes no false alarm. Where the drive stamps its samples and reports the applied command, the ranges
//! are narrow.
//!
//! A fault is found within 200 ms or five cycles, whichever is later, after it becomes observable: after the signals leave
//! their plausible range. At rest without a voltage, or on a plateau, only the lost noise of a sensor is observable. Causes
//! that cannot be distinguished are named together, and end the run.
//!
//! ```text
//! start -> Proven: nothing        gap in the samples -> Symptoms: none
//! plausible   -> Proven grows (sign, scale, direction), Symptoms end
//! implausible -> Symptoms: consecutive windows, or a start time -> confirmed -> Trip
//! ```

mod contradiction;
mod history;
mod readings;
#[cfg(test)]
mod tests;

use self::history::History;
use super::limits::{Limits, Nameplate};
use super::trip::{Trip, TripKind};
use drivebench_identify::belief::{Factor, Plate, Range, Repeats, Row, Scale, Settings, Window};
use drivebench_model::numerics::count::whole;
use drivebench_model::sample::{Channel, Command, Demand, DriveState, Sample};

pub(super) const PLAUSIBILITY: &str = "plausibility";

const CHECK_ENCODER: &str =
    "check the encoder's cable, its counts per turn and its sign in the drive's profile";
const CHECK_CURRENT: &str =
    "check the current sensor's leads, and unit and scale of the current in the drive's profile";
const CHECK_SET_POINT: &str = "check address, scale and word order of the set-point in the drive's profile, and that the bus has the command";

/// Terms of the voltage balance at the first repetition of a speed, V.
#[derive(Clone, Copy, Debug)]
struct RepetitionStart {
    /// Back-EMF by voltage and current.
    emf: f64,
    current: f64,
    /// Of the readings in the window.
    currents: Range,
}

/// A set-point that is not followed.
#[derive(Clone, Copy, Debug)]
struct Departure {
    since_s: f64,
    distance: f64,
}

/// The last set-point and measured voltage that agreed, V.
#[derive(Clone, Copy, Debug)]
struct Agreement {
    set_point_v: f64,
    measured_v: f64,
    /// Since the set-point has moved away and the voltage has not.
    stuck_since_s: Option<f64>,
}

/// A speed that grows beyond its reference against the torque.
#[derive(Clone, Copy, Debug)]
struct Runaway {
    from_rad_s: f64,
    cycles: usize,
}

/// Contradictions between readings, of samples without a gap.
#[derive(Clone, Debug, Default)]
struct Symptoms {
    /// Consecutive windows that misfit the voltage balance, with a current.
    misfits: usize,
    /// Start of a misfit without a current.
    idle_since_s: Option<f64>,
    /// Consecutive windows with an angle that contradicts the speed.
    angle_windows: usize,
    /// Of the speed; and consecutive windows in which it should have changed.
    repetition: Option<RepetitionStart>,
    frozen_windows: usize,
    /// Speed, and whether the shaft was at rest, at the first repetition of the current.
    current_onset: Option<(f64, bool)>,
    /// The last window that fits: voltage, and the sum of the terms of current and speed, V.
    last_fit: Option<(f64, f64)>,
    departure: Option<Departure>,
    agreement: Option<Agreement>,
    /// Start of a standstill under a current.
    stands_since_s: Option<f64>,
    runaway: Option<Runaway>,
}

/// Properties proven by the readings since the start.
#[derive(Clone, Debug, Default)]
struct Proven {
    /// The current has a sign: a clearly negative one was measured.
    current_sign: bool,
    /// The measured voltage has the scale of its set-point.
    voltage_scale: bool,
    /// The encoder turns in the direction of the voltage.
    direction: bool,
    /// Both balances so far, of a motor with a nameplate.
    factor: Option<Factor>,
}

#[derive(Clone, Copy, Debug, Default)]
struct Bounds {
    speed_rad_s: f64,
    current_a: f64,
    /// Current from which the drive may limit by itself, A.
    limiting_a: f64,
    /// A load pulls at the shaft: it may stand still under a current.
    vertical: bool,
}

/// The fault detection of one session.
#[derive(Clone, Debug, Default)]
pub struct Plausibility {
    /// Host time of the latest sample, s.
    now_s: f64,
    scale: Scale,
    plate: Option<Plate>,
    bounds: Bounds,
    /// The checks that need a nameplate which fits are waived.
    waived: bool,
    reference_rad_s: Option<f64>,
    history: History,
    speed: Repeats,
    current: Repeats,
    proven: Proven,
    symptoms: Symptoms,
}

impl Plausibility {
    /// For a motor with a nameplate. `drive_current_limit_a`: the drive's own limit, if it reports one.
    pub(super) fn of(
        limits: &Limits,
        motor: &Nameplate,
        drive_current_limit_a: Option<f64>,
    ) -> Self {
        let scale = Scale {
            volts: motor.rated_voltage_v,
            amps: motor.rated_current_a,
            rad_s: motor.rated_speed_rad_s,
        };
        let from_a = drive_current_limit_a.unwrap_or(motor.rated_current_a);
        let mut watch = Self::new(limits, scale);
        watch.plate = Some(motor.plate());
        watch.bounds.limiting_a = Settings::LIMITING_CURRENT * from_a.max(motor.rated_current_a);
        watch.proven.factor = Some(Factor::new(scale));
        watch
    }

    /// For a motor that is not known.
    pub(super) fn of_unknown(limits: &Limits) -> Self {
        let scale =
            Scale { volts: limits.voltage_v, amps: limits.current_a, rad_s: limits.speed_rad_s };
        Self::new(limits, scale)
    }

    fn new(limits: &Limits, scale: Scale) -> Self {
        Self {
            scale,
            bounds: Bounds {
                speed_rad_s: limits.speed_rad_s,
                current_a: limits.current_a,
                limiting_a: Settings::LIMITING_CURRENT * scale.amps,
                vertical: limits.load.vertical,
            },
            ..Self::default()
        }
    }

    /// Switches off the checks that need a nameplate which fits.
    pub(super) const fn waive(&mut self) {
        self.waived = true;
    }

    /// Takes the noise of the sensors from readings at rest with the output off. A drive may read nothing while it is off, so
    /// equal readings are no evidence.
    pub(super) fn estimate_noise(&mut self, rest: &[Sample]) {
        for (channel, sensor) in
            [(Channel::Speed, &mut self.speed), (Channel::Current, &mut self.current)]
        {
            let reading = |sample: &Sample| Some((sample.time_s, sample.get(channel)?));
            let readings: Vec<(f64, f64)> = rest.iter().filter_map(reading).collect();
            let differ = |pair: &[(f64, f64)]| pair[0].1.to_bits() != pair[1].1.to_bits();
            if readings.windows(2).any(differ) {
                for (time_s, value) in readings {
                    sensor.push(time_s, value, true);
                }
            }
        }
    }

    pub(super) fn sent(&mut self, command: &Command) {
        self.history.sent(command);
    }

    /// The reference of a speed loop, rad/s.
    pub(super) const fn follow(&mut self, reference_rad_s: Option<f64>) {
        self.reference_rad_s = reference_rad_s;
    }

    /// A start resets all proofs: the wiring may have changed meanwhile.
    pub(super) fn begin(&mut self) {
        self.symptoms = Symptoms::default();
        self.speed.begin();
        self.current.begin();
        self.history.clear();
        self.proven =
            Proven { factor: self.plate.map(|_| Factor::new(self.scale)), ..Proven::default() };
        self.reference_rad_s = None;
    }

    /// Whether the encoder turned in the right direction since the start.
    pub const fn has_proven_direction(&self) -> bool {
        self.proven.direction
    }

    /// No contradiction to the measured speed.
    pub(super) const fn speed_is_plausible(&self) -> bool {
        self.symptoms.misfits == 0
            && self.symptoms.angle_windows == 0
            && self.speed.run() < Settings::REPEATED
    }

    /// The checks that this drive and this motor do not allow.
    pub fn unwatched(&self) -> Option<&'static str> {
        let last = self.history.last()?;
        match last.demand? {
            _ if self.plate.is_none() => {
                Some("without a nameplate speed and current are not compared with the voltage")
            }
            Demand::Speed(_) => Some(
                "behind the drive's own speed loop speed and current are not compared with the voltage",
            ),
            Demand::Current(_) if last.voltage_v.is_none() => {
                Some("the drive reports no voltage, so speed and current are not compared with it")
            }
            Demand::Voltage(_) if last.voltage_v.is_none() => Some(
                "the drive reports no voltage, so its output is checked by current and speed only",
            ),
            _ => None,
        }
    }

    /// Checks one sample; not `armed`, it only takes the noise of the sensors.
    pub(super) fn check(&mut self, now_s: f64, sample: &Sample, armed: bool) -> Option<Trip> {
        self.now_s = now_s;
        let runs = matches!(sample.state, None | Some(DriveState::Running));
        let (speed, current) = (sample.get(Channel::Speed), sample.get(Channel::Current));
        let still = speed.is_some_and(|speed| speed.abs() < self.rest_rad_s());
        if !(armed && runs && !self.history.commands.is_empty()) {
            self.read(sample.time_s, speed, current, still && !runs);
            self.history.clear();
            self.symptoms = Symptoms::default();
            return None;
        }
        let continues = self.history.push(sample, &self.scale);
        let at_rest = still && self.commands_rest();
        self.read(sample.time_s, speed, current, at_rest);
        if !continues {
            self.symptoms = Symptoms::default();
            return None;
        }
        self.note_onsets(speed, at_rest);
        let runaway = self.runs_away();
        self.follows()
            .or_else(|| self.stuck())
            .or_else(|| self.stands())
            .or_else(|| self.by_balance())
            .or_else(|| self.by_angle())
            .or(runaway)
    }

    fn read(&mut self, time_s: f64, speed: Option<f64>, current: Option<f64>, at_rest: bool) {
        if let Some(speed) = speed {
            self.speed.push(time_s, speed, at_rest);
        }
        if let Some(current) = current {
            self.current.push(time_s, current, at_rest);
        }
    }

    /// The set-points of the last cycles are zero.
    fn commands_rest(&self) -> bool {
        self.history.demands().is_some_and(|mut demands| {
            demands.all(|demand| match demand {
                Demand::Voltage(volts) => volts.abs() < self.rest_v(),
                Demand::Current(amps) => amps.abs() < Settings::REST * self.scale.amps,
                Demand::Speed(rad_s) => rad_s.abs() < self.rest_rad_s(),
                Demand::Disable | Demand::Stop | Demand::ResetFault => true,
            })
        })
    }

    fn note_onsets(&mut self, speed: Option<f64>, at_rest: bool) {
        let last = self.history.rows().back();
        self.proven.current_sign |= last.is_some_and(|row| row.current_a < -3.0 * self.idle_a());
        if self.current.run() == 0 || at_rest {
            self.symptoms.current_onset = speed.map(|speed| (speed, at_rest));
        }
        if self.speed.run() == 0 {
            self.symptoms.repetition = None;
        }
    }

    /// Cycles within which a fault has to be found.
    fn cycles(&self) -> usize {
        let period_s = self.history.period_s().unwrap_or(Settings::LATENCY_S);
        whole((Settings::LATENCY_S / period_s).ceil())
            .clamp(Settings::LATENCY_CYCLES, Settings::MOST_ROWS + 2)
    }

    fn is_exact(&self) -> bool {
        self.history.last().is_some_and(|last| last.exact)
    }

    /// Repeats of a speed that count: more of a drive that may read its sensors less often than once a cycle.
    fn frozen_readings(&self) -> usize {
        if self.is_exact() { Settings::REPEATED } else { Settings::REPEATED.max(self.cycles() - 1) }
    }

    fn latest(&self, rows: usize) -> impl Iterator<Item = &Row> {
        self.history.rows().iter().rev().take(rows)
    }

    /// The voltage balance over the last rows, where their voltage is known.
    fn window(&self, plate: &Plate, rows: usize) -> Option<Window> {
        // Without a measured voltage a limit of the drive is not observable.
        let is_measured = self.history.last()?.voltage_v.is_some();
        let unknown = |row: &Row| !is_measured && row.current_a.abs() > self.bounds.limiting_a;
        if self.history.rows().len() < rows || self.latest(rows).any(unknown) {
            return None;
        }
        let window = plate.window(self.latest(rows))?;
        // A drive may report only the magnitude.
        Some(if self.proven.current_sign { window } else { window.with_magnitude() })
    }

    fn window_rows(&self) -> usize {
        if self.is_exact() { Settings::STAMPED_ROWS } else { self.cycles() - 2 }
    }

    fn drop_v(&self) -> f64 {
        Settings::DROP * self.scale.volts
    }

    fn idle_a(&self) -> f64 {
        Settings::IDLE_CURRENT * self.scale.amps
    }

    fn rest_rad_s(&self) -> f64 {
        Settings::REST * self.scale.rad_s
    }

    fn rest_v(&self) -> f64 {
        Settings::REST * self.scale.volts
    }

    /// Equal to the bit, by the noise of the sensor at rest, or through a motion from rest.
    fn stuck(&self) -> Option<Trip> {
        let last = self.history.last()?;
        let (speed, current) = (last.speed_rad_s?, last.current_a?);
        let excited = !self.commands_rest();
        let turns = speed.abs() > self.rest_rad_s();
        let other_changes = self.current.run() < self.speed.run();
        if excited && (self.speed.is_silent() || self.speed.is_stuck() && turns && other_changes) {
            let what = format!(
                "the measured speed stays at {speed:.2} rad/s to the last bit in {} samples, {:.2} s; by its noise at rest {:.0} are allowed; {CHECK_ENCODER}",
                self.speed.run() + 1,
                last.time_s - self.speed.since_s(),
                self.speed.needed().unwrap_or(0.0)
            );
            return Some(self.trip(TripKind::EncoderFrozen, (speed, speed), &what));
        }
        let (from, from_rest) = self.symptoms.current_onset.unwrap_or((speed, false));
        let moved = (speed - from).abs();
        let needs_current = moved > Settings::CLEAR * self.scale.rad_s;
        let stays = from_rest && needs_current && self.current.run() >= Settings::REPEATED;
        if excited
            && (self.current.is_silent() || self.current.is_stuck() && needs_current || stays)
        {
            let what = format!(
                "the measured current stays at {current:.3} A to the last bit in {} samples, {:.2} s, while the speed went by {moved:.1} rad/s to {speed:.1} rad/s; {CHECK_CURRENT}",
                self.current.run() + 1,
                last.time_s - self.current.since_s()
            );
            return Some(self.trip(TripKind::CurrentStuck, (current, current), &what));
        }
        None
    }

    /// A shaft that does not turn although it should.
    fn stands(&mut self) -> Option<Trip> {
        let plate = self.plate.filter(|_| !self.bounds.vertical)?;
        let row = *self.history.rows().back()?;
        let least_a = self.scale.amps.max(plate.turning_a());
        let stands = row.current_a.abs() >= least_a && row.speed_rad_s.abs() < self.rest_rad_s();
        let last_s = self.history.last()?.time_s;
        if !stands {
            self.symptoms.stands_since_s = None;
            return None;
        }
        let since_s = *self.symptoms.stands_since_s.get_or_insert(last_s);
        let longest_s = f64::max(0.5, Settings::LATENCY_CYCLES as f64 * row.seconds);
        let torque = plate.torque_n_m(row.current_a);
        let what = format!(
            "the shaft is locked, or the encoder stands still: {:.2} rad/s for {:.2} s under {:.2} A, which give {torque:.3} N.m where friction is {:.3} N.m by the nameplate; {longest_s:.2} s are allowed; check brake and load, turn the shaft by hand and watch the speed",
            row.speed_rad_s,
            last_s - since_s,
            row.current_a,
            plate.friction_n_m
        );
        (last_s - since_s >= longest_s).then(|| {
            let figures = (row.speed_rad_s, 0.0);
            self.trip(TripKind::ShaftHeld, figures, &what)
        })
    }

    /// `figures`: the value and the expected one.
    fn trip(&self, kind: TripKind, figures: (f64, f64), what: &str) -> Trip {
        Trip::new(kind, self.now_s, figures, what)
    }
}
