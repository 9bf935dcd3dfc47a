//! Fault detection of sensors and actuator by parity equations (Isermann, Fault-Diagnosis Systems, 2006, ch. 10), while the
//! output is on: commands, voltage, current, speed and angle are compared with each other.
//!
//! ```text
//! commands, samples --history.rs--> rows --+-- u = R i + L di/dt + Ke w, no factor of 0.5 to 2 makes it fit (balance.rs)
//!                                          +-- measured voltage, current or speed against the set-points   (readings.rs)
//!                                          +-- readings equal to the bit, while others change             (repeats.rs)
//!                                          +-- current by the balances of voltage and torque              (balance.rs)
//!                                          +-- angle against speed; speed beyond its reference             (readings.rs)
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

mod balance;
mod history;
mod readings;
mod repeats;
mod settings;
#[cfg(test)]
mod tests;

use self::balance::{Factor, Parameters, Window, negative};
use self::history::{History, Range, Row, Scale};
use self::repeats::Repeats;
use self::settings::SETTINGS;
use super::limits::{Limits, Nameplate};
use super::timing::whole;
use super::trip::{Trip, TripKind};
use drivebench_model::sample::{Channel, Command, Demand, DriveState, Sample};

/// Name of the waiver.
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

/// A residual of the voltage balance.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
enum BalanceSymptom {
    #[default]
    None,
    /// Without a current.
    Idle { since_s: f64 },
    /// With a current, in consecutive windows.
    Misfit { windows: usize },
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
    balance: BalanceSymptom,
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

/// Limits of the machine.
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
    nameplate: Option<Parameters>,
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
        watch.nameplate = Some(Parameters {
            resistance: motor.resistance_ohm,
            inductance: motor.inductance_h,
            back_emf: motor.back_emf_v_s_per_rad,
            inertia: motor.inertia_kg_m2,
            friction: motor.load_torque_n_m.abs(),
        });
        watch.bounds.limiting_a = SETTINGS.limiting_current * from_a.max(motor.rated_current_a);
        watch.proven.factor = Some(Factor::new(&scale));
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
                limiting_a: SETTINGS.limiting_current * scale.amps,
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
        self.proven = Proven {
            factor: self.nameplate.map(|_| Factor::new(&self.scale)),
            ..Proven::default()
        };
        self.reference_rad_s = None;
    }

    /// Whether the encoder turned in the right direction since the start.
    pub const fn has_proven_direction(&self) -> bool {
        self.proven.direction
    }

    /// No contradiction to the measured speed.
    pub(super) const fn speed_is_plausible(&self) -> bool {
        !matches!(self.symptoms.balance, BalanceSymptom::Misfit { .. })
            && self.symptoms.angle_windows == 0
            && self.speed.run() < SETTINGS.frozen_readings
    }

    /// The checks that this drive and this motor do not allow.
    pub fn unwatched(&self) -> Option<&'static str> {
        let last = self.history.last()?;
        match last.demand? {
            _ if self.nameplate.is_none() => {
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
                Demand::Voltage(volts) => volts.abs() < SETTINGS.rest_voltage * self.scale.volts,
                Demand::Current(amps) => amps.abs() < SETTINGS.rest_voltage * self.scale.amps,
                Demand::Speed(rad_s) => rad_s.abs() < SETTINGS.rest_voltage * self.scale.rad_s,
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
        let period_s = self.history.period_s().unwrap_or(SETTINGS.latency_s);
        whole((SETTINGS.latency_s / period_s).ceil())
            .clamp(SETTINGS.latency_cycles, SETTINGS.most_rows + 2)
    }

    fn is_exact(&self) -> bool {
        self.history.last().is_some_and(|last| last.exact)
    }

    /// Repeats of a speed that count: more of a drive that may read its sensors less often than once a cycle.
    fn frozen_readings(&self) -> usize {
        if self.is_exact() {
            SETTINGS.frozen_readings
        } else {
            SETTINGS.frozen_readings.max(self.cycles() - 1)
        }
    }

    /// The voltage balance over the last rows, where their voltage is known.
    fn window(&self, nameplate: &Parameters, rows: usize) -> Option<Window> {
        let all = self.history.rows();
        if all.len() < rows || rows == 0 {
            return None;
        }
        let last = || all.iter().skip(all.len() - rows);
        // Without a measured voltage a limit of the drive is not observable.
        let is_measured = self.history.last()?.voltage_v.is_some();
        let unknown = |row: &Row| !is_measured && row.current_a.abs() > self.bounds.limiting_a;
        if last().any(unknown) {
            return None;
        }
        let terms: Option<Vec<_>> = last().map(|row| nameplate.terms(row, rows as f64)).collect();
        let mut window = terms?.into_iter().reduce(Window::and)?;
        if !self.proven.current_sign {
            // A drive may report only the magnitude.
            let most = window.current.low.abs().max(window.current.high.abs());
            window.current = Range::new(-most, most);
            window.mean_current = window.mean_current.abs().copysign(window.mean_volts);
        }
        Some(window)
    }

    fn window_rows(&self) -> usize {
        if self.is_exact() { SETTINGS.stamped_rows } else { self.cycles() - 2 }
    }

    /// The window fits a motor with a warm winding and the flux of another specimen.
    fn fits(&self, window: &Window) -> bool {
        window.gap(SETTINGS.winding_factor, SETTINGS.flux_factor, self.drop_v()) <= 0.0
    }

    /// No reading within its tolerance makes the window fit.
    fn misfits(&self, window: &Window) -> bool {
        window.gap(SETTINGS.any_factor, SETTINGS.any_factor, self.drop_v()) > 0.0
    }

    fn drop_v(&self) -> f64 {
        SETTINGS.drop * self.scale.volts
    }

    fn idle_a(&self) -> f64 {
        SETTINGS.idle_current * self.scale.amps
    }

    fn rest_rad_s(&self) -> f64 {
        SETTINGS.rest_speed * self.scale.rad_s
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
        let needs_current = moved > SETTINGS.moved_speed * self.scale.rad_s;
        let stays = from_rest && needs_current && self.current.run() >= SETTINGS.frozen_readings;
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
        let nameplate = self.nameplate.filter(|_| !self.bounds.vertical)?;
        let row = *self.history.rows().back()?;
        let friction_a = SETTINGS.standing_friction * nameplate.friction / nameplate.back_emf;
        let least_a = self.scale.amps.max(friction_a);
        let stands = row.current_a.abs() >= least_a && row.speed_rad_s.abs() < self.rest_rad_s();
        let last_s = self.history.last()?.time_s;
        if !stands {
            self.symptoms.stands_since_s = None;
            return None;
        }
        let since_s = *self.symptoms.stands_since_s.get_or_insert(last_s);
        let longest_s = SETTINGS.standing_s.max(SETTINGS.latency_cycles as f64 * row.seconds);
        let torque = nameplate.back_emf * row.current_a.abs();
        let what = format!(
            "the shaft is locked, or the encoder stands still: {:.2} rad/s for {:.2} s under {:.2} A, which give {torque:.3} N.m where friction is {:.3} N.m by the nameplate; {longest_s:.2} s are allowed; check brake and load, turn the shaft by hand and watch the speed",
            row.speed_rad_s,
            last_s - since_s,
            row.current_a,
            nameplate.friction
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

    /// Faults by the voltage balance.
    fn by_balance(&mut self) -> Option<Trip> {
        let nameplate = self.nameplate?;
        let row = *self.history.rows().back()?;
        if !(self.waived || row.limited)
            && row.exact
            && let Some(balances) = self.proven.factor.as_mut()
            && let Some(factor) =
                balances.push(&row, self.proven.current_sign, &nameplate, &self.scale)
        {
            // Both balances fit either sign; only one of them goes against the voltage.
            let is_against = |window: &Window| window.mean_speed * window.mean_volts < 0.0;
            let window = self
                .window(&nameplate, SETTINGS.stamped_rows)
                .filter(is_against)
                .filter(|_| factor < 0.0);
            return Some(match window {
                Some(window) => self.misread(TripKind::EncoderReversed, &nameplate, &window),
                None => self.current_scaled(factor),
            });
        }
        if self.is_idle() {
            self.end_misfit();
            return self.idle(&nameplate);
        }
        if let BalanceSymptom::Idle { .. } = self.symptoms.balance {
            self.symptoms.balance = BalanceSymptom::None;
        }
        let Some(window) = self.window(&nameplate, self.window_rows()) else {
            self.end_misfit();
            return None;
        };
        if let Some(trip) = self.frozen(&nameplate, &window) {
            return Some(trip);
        }
        let misfits = !self.waived && self.misfits(&window);
        if !(misfits || self.accelerates_against_current(&window)) {
            self.end_misfit();
            let fits = self.fits(&window);
            let turns = window.mean_speed.abs() > SETTINGS.proven_voltage * self.scale.volts;
            self.proven.direction |= fits && turns && window.mean_speed * window.mean_volts > 0.0;
            if fits {
                let response = window.mean_current + window.mean_speed;
                self.symptoms.last_fit = Some((window.mean_volts, response));
            }
            return None;
        }
        let windows = match self.symptoms.balance {
            BalanceSymptom::Misfit { windows } => windows + 1,
            _ => 1,
        };
        self.symptoms.balance = BalanceSymptom::Misfit { windows };
        if windows < SETTINGS.confirming_windows {
            return None;
        }
        self.isolate(&nameplate, &window)
    }

    const fn end_misfit(&mut self) {
        if let BalanceSymptom::Misfit { .. } = self.symptoms.balance {
            self.symptoms.balance = BalanceSymptom::None;
        }
    }

    /// The shaft gains or loses speed against its current and speed, and the opposite sign of one would fit.
    fn accelerates_against_current(&self, window: &Window) -> bool {
        let rows = self.history.rows().iter().rev().take(SETTINGS.stamped_rows);
        let gain: f64 = rows.map(|row| row.speed_change_rad_s).sum();
        if gain.abs() < self.rest_rad_s() {
            return false;
        }
        let (volts, speed, current) = (window.mean_volts, window.mean_speed, window.mean_current);
        let drives = !self.proven.current_sign || current * volts > 0.0;
        let encoder = drives
            && speed * volts < 0.0
            && gain * volts < 0.0
            && self.is_mirrored(window, speed, current, SETTINGS.moved_voltage);
        // A braked shaft may lose speed under a current that drives it, where a load takes more.
        let least_share =
            if current * volts < 0.0 { SETTINGS.moved_voltage } else { SETTINGS.drop };
        let sensor = self.proven.current_sign
            && speed * volts > 0.0
            && gain * current < 0.0
            && self.is_mirrored(window, current, speed, least_share);
        encoder || sensor
    }

    /// A reading of at least this share of the rated voltage fits only with the opposite sign.
    fn is_mirrored(&self, window: &Window, reading: f64, other: f64, least_share: f64) -> bool {
        let (rest, size) = (window.mean_volts - other, reading.abs());
        let slack = SETTINGS.rest_voltage * self.scale.volts;
        let as_read = (rest - reading).abs() - 0.5 * window.volts.width();
        let mirrored = (rest + reading).abs();
        size > least_share * self.scale.volts
            && as_read > size + slack
            && mirrored < 0.5 * size + slack
    }

    /// No current flows that would drive anything.
    fn is_idle(&self) -> bool {
        let rows = self.history.rows();
        let mut last = rows.iter().rev().take(SETTINGS.stamped_rows);
        rows.len() >= SETTINGS.stamped_rows && last.all(|row| row.current_a.abs() < self.idle_a())
    }

    /// No current flows although the voltage is not that of the speed, or although the shaft is driven.
    fn idle(&mut self, nameplate: &Parameters) -> Option<Trip> {
        let last = *self.history.last()?;
        let (speed, current) = (last.speed_rad_s?, last.current_a?);
        if let Some(trip) = self.driven_without_current(current, speed) {
            return Some(trip);
        }
        let window = self.window(nameplate, self.window_rows())?;
        let none = window.with(Range::new(0.0, 0.0), window.speed);
        let (volts, emf) = (window.mean_volts, window.mean_speed);
        // A coasting shaft is not driven, and a converter may not be able to brake it.
        let coasts = volts.abs() < emf.abs() && self.speed.run() < self.frozen_readings();
        if none.gap(SETTINGS.any_factor, SETTINGS.flux_factor, self.drop_v()) <= 0.0 || coasts {
            self.symptoms.balance = BalanceSymptom::None;
            return None;
        }
        let since_s = match self.symptoms.balance {
            BalanceSymptom::Idle { since_s } => since_s,
            _ => last.time_s,
        };
        self.symptoms.balance = BalanceSymptom::Idle { since_s };
        if last.time_s - since_s < SETTINGS.idle_s {
            return None;
        }
        let by_voltage = volts / nameplate.back_emf;
        let figures = format!(
            "{current:.3} A flow at {volts:.1} V and {speed:.1} rad/s for {:.2} s, {} s are allowed",
            last.time_s - since_s,
            SETTINGS.idle_s
        );
        if speed.abs() >= self.rest_rad_s() {
            if self.waived {
                return None;
            }
            let what = format!(
                "no current drives the shaft, so it should turn at about {by_voltage:.1} rad/s: {figures}; {CHECK_ENCODER}"
            );
            let kind = if self.speed.run() >= self.frozen_readings() {
                TripKind::EncoderFrozen
            } else {
                TripKind::SpeedImplausible
            };
            return Some(self.trip(kind, (speed, by_voltage), &what));
        }
        let expected_a = volts / nameplate.resistance;
        Some(if last.voltage_v.is_some() {
            let what = format!(
                "the armature circuit is open, or the output is not on, or current and speed are both not measured: {figures}; check the motor's leads, its fuses and the drive's enable and release inputs"
            );
            self.trip(TripKind::OpenCircuit, (current, expected_a), &what)
        } else {
            let what = format!(
                "the drive does not follow, or its output is not on, or the armature circuit is open (it reports no voltage to distinguish them): {figures}; {CHECK_SET_POINT}; check the motor's leads"
            );
            self.trip(TripKind::SetPointIgnored, (current, expected_a), &what)
        })
    }

    /// A shaft that speeds up with the voltage and without a current.
    fn driven_without_current(&self, current: f64, speed: f64) -> Option<Trip> {
        let (idle_a, most) = (self.idle_a(), SETTINGS.driven_speed * self.scale.rad_s);
        let (mut seconds, mut gain) = (0.0, 0.0);
        for row in self.history.rows().iter().rev() {
            let volts = row.volts?.middle();
            let drives =
                volts * speed > 0.0 && volts.abs() > SETTINGS.rest_voltage * self.scale.volts;
            seconds += row.seconds;
            if row.current_a.abs() > idle_a || !drives || seconds > SETTINGS.driven_s {
                break;
            }
            gain += row.speed_change_rad_s * speed.signum();
        }
        let what = format!(
            "{current:.3} A are measured while the voltage speeds the shaft up by {gain:.1} rad/s to {speed:.1} rad/s; without a current {most:.1} rad/s are allowed; {CHECK_CURRENT}"
        );
        (gain > most).then(|| self.trip(TripKind::CurrentStuck, (current, idle_a), &what))
    }

    /// A speed that repeats itself, while the back-EMF has changed or cannot be that of this speed.
    fn frozen(&mut self, nameplate: &Parameters, window: &Window) -> Option<Trip> {
        // The whole window must lie within the repetition.
        if self.speed.run() < self.window_rows() {
            self.symptoms.frozen_windows = 0;
            return None;
        }
        let emf = window.mean_volts - window.mean_current;
        let rows = self.history.rows().iter().rev().take(self.window_rows());
        let readings = rows.map(|row| nameplate.resistance * row.ends().0);
        let currents = Range::of(readings).unwrap_or(window.current);
        let start = *self.symptoms.repetition.get_or_insert(RepetitionStart {
            emf,
            current: window.mean_current,
            currents,
        });
        if self.speed.run() < self.frozen_readings() {
            return None;
        }
        let by_current = (window.mean_current - start.current).abs();
        let idle_v = self.idle_a() * nameplate.resistance;
        // The drop of brushes and bridge appears with the current and changes its sign with it. A window in which the
        // current does both counts for either.
        let most = |range: Range, sign: f64| (sign * range.low).max(sign * range.high);
        let flows = |currents: Range, sign: f64| most(currents, sign) > idle_v;
        let both = |sign: f64| flows(start.currents, sign) && flows(currents, -sign);
        let turns = start.current.abs() < idle_v || both(1.0) || both(-1.0);
        let drops_v =
            if turns { 2.0 * self.drop_v() } else { SETTINGS.rest_voltage * self.scale.volts };
        let tolerance_v =
            drops_v + (1.0 - SETTINGS.winding_factor.low) * by_current + 0.5 * window.volts.width();
        // From the first back-EMF and from that of the measured speed: the first may be of a current in transit.
        let beyond = |other_v: f64| SETTINGS.flux_factor.low * (emf - other_v).abs() > tolerance_v;
        let moved = beyond(start.emf) && beyond(window.mean_speed);
        let is_impossible = !self.fits(window);
        if !(moved || is_impossible) {
            self.symptoms.frozen_windows = 0;
            return None;
        }
        self.symptoms.frozen_windows += 1;
        // A drive that does not stamp its samples may have read the speed some cycles ago.
        let needed = if self.is_exact() { 1 } else { self.cycles() };
        (self.symptoms.frozen_windows >= needed)
            .then(|| self.misread(TripKind::EncoderFrozen, nameplate, window))
    }

    /// Fault isolation: the reading that does not fit.
    fn isolate(&mut self, nameplate: &Parameters, window: &Window) -> Option<Trip> {
        let drop_v = self.drop_v();
        let is_ignored = self.symptoms.last_fit.is_some_and(|(volts, response)| {
            let step = (window.mean_volts - volts).abs();
            let change = (window.mean_current + window.mean_speed - response).abs();
            step > 2.0 * drop_v && change < 0.25 * step
        });
        let last = *self.history.last()?;
        let misread =
            |plausibility: &Self, kind| Some(plausibility.misread(kind, nameplate, window));
        let mirrored = window.with(window.current, negative(window.speed));
        let drives_back = window.mean_speed * window.mean_volts < 0.0
            && window.mean_current * window.mean_volts.signum() >= -drop_v;
        // A speed loop may have reversed the voltage too.
        let opposite = window.mean_speed.abs() > 2.0 * drop_v
            && window.misfit(-1.0) < 0.3 * window.misfit(1.0);
        let turns = last.speed_rad_s?.abs() >= self.rest_rad_s();
        if self.speed.run() >= self.frozen_readings() {
            misread(self, TripKind::EncoderFrozen)
        } else if drives_back && self.fits(&mirrored) || opposite {
            misread(self, TripKind::EncoderReversed)
        } else if self.proven.current_sign
            && self.is_mirrored(
                window,
                window.mean_current,
                window.mean_speed,
                SETTINGS.moved_voltage,
            )
        {
            misread(self, TripKind::CurrentReversed)
        } else if let Some(trip) = self.swapped() {
            Some(trip)
        } else if is_ignored && last.voltage_v.is_none() {
            let (volts, response) = (window.mean_volts, window.mean_current + window.mean_speed);
            let what = format!(
                "the set-point went to {volts:.1} V, current and speed are those of {response:.1} V as before; {CHECK_SET_POINT}"
            );
            Some(self.trip(TripKind::SetPointIgnored, (response, volts), &what))
        } else if !turns {
            misread(self, TripKind::EncoderFrozen)
        } else if self.waived {
            self.end_misfit();
            None
        } else if window.mean_speed.abs() >= window.mean_current.abs() {
            misread(self, TripKind::SpeedImplausible)
        } else {
            misread(self, TripKind::CurrentImplausible)
        }
    }

    /// The speed, or else the current, that contradicts the balance.
    fn misread(&self, kind: TripKind, nameplate: &Parameters, window: &Window) -> Trip {
        use TripKind::{CurrentReversed, EncoderFrozen, EncoderReversed, SpeedImplausible};
        let is_speed = matches!(kind, EncoderFrozen | EncoderReversed | SpeedImplausible);
        let (speed, current) = (window.mean_speed, window.mean_current);
        let (name, unit, digits, per_unit, check) = if is_speed {
            ("speed", "rad/s", 1, nameplate.back_emf, CHECK_ENCODER)
        } else {
            ("current", "A", 2, nameplate.resistance, CHECK_CURRENT)
        };
        let (reading, other, range) = if is_speed {
            (speed, current, window.current)
        } else {
            (current, speed, window.speed)
        };
        let (measured, by_voltage) = (reading / per_unit, (window.mean_volts - other) / per_unit);
        let plausible = window.volts.plus(negative(range.times(SETTINGS.any_factor)));
        let plausible = plausible.wider(self.drop_v()).times(SETTINGS.any_factor);
        let (low, high) = (plausible.low / per_unit, plausible.high / per_unit);
        let how = match kind {
            EncoderFrozen => "stays at",
            EncoderReversed | CurrentReversed => "has the wrong sign:",
            _ => "is",
        };
        let other = if is_speed { "current" } else { "speed" };
        let ratio = measured / by_voltage;
        let scale = match kind {
            SpeedImplausible if ratio.is_finite() => {
                format!(
                    "; it reads {ratio:.2} times what it should (or Ke of the nameplate is off by as much)"
                )
            }
            _ => String::new(),
        };
        let what = format!(
            "the measured {name} {how} {measured:.digits$} {unit}, by voltage and {other} it is {by_voltage:.digits$} {unit}, {low:.digits$} to {high:.digits$} {unit} is plausible{scale}; {check}"
        );
        self.trip(kind, (measured, by_voltage), &what)
    }

    /// A current that contradicts both balances.
    fn current_scaled(&self, factor: f64) -> Trip {
        let current = self.history.last().and_then(|last| last.current_a).unwrap_or(0.0);
        let kind =
            if factor < 0.0 { TripKind::CurrentReversed } else { TripKind::CurrentImplausible };
        let what = format!(
            "the measured current reads {factor:.2} times what voltage and acceleration require, 0.5 to 2 is allowed; now it is {current:.2} A; {CHECK_CURRENT}"
        );
        self.trip(kind, (factor, 1.0), &what)
    }
}
