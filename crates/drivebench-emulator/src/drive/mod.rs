//! The software drive: state machine, watchdog and inverter around the true machine, as a pure function of drive time.
//!
//! ```text
//! command block --> [ state machine ] --> [ output stage: loops, limits ] --> terminals --> [ truth ]
//! watchdog, trips --^                                                                         |
//! telemetry, capture <------------------------- sensors <-------------------------------------+
//! supply_and_brake.rs: a supply that takes nothing back, a brake on the shaft
//! encoder.rs applies encoder faults to speed and angle
//! delay_line.rs holds set-points back where a hidden delay is at work
//! drive_faults.rs: what goes wrong in the drive itself
//! registers.rs and stream.rs: its registers and its stream
//! ```

mod capture;
mod delay_line;
mod drive_faults;
mod encoder;
mod output;
mod registers;
mod stream;
mod supply_and_brake;

use firmware_protocol::{
    CommandBlock, Control, DeviceKind, DriveCommand, Fault, Identity, PROTOCOL_VERSION, State,
    Status, Telemetry,
};

use self::capture::Capture;
use self::drive_faults::DriveFaults;
use self::encoder::Encoder;
use self::output::{Output, OutputStage};
use self::supply_and_brake::SupplyAndBrake;
use super::config::EmulatorConfig;
use super::fault::FaultKind;
use super::truth::effect::Site;
use super::truth::{MotorTruth, Plant, Reading, Sensors};
use drivebench_model::numerics::count::whole;

pub(super) use self::stream::answer as answer_stream;

/// Period of the drive's control and of the plant's integration.
const TICK_US: u16 = 50;
const TICK_S: f64 = TICK_US as f64 * 1e-6;
const TICKS_PER_MS: u64 = 1000 / TICK_US as u64;
/// Distance of captured samples, in ticks.
const CAPTURE_TICKS: u16 = 2;

/// The software drive. Time only moves in [`SoftDrive::advance_to`] and, by at most one tick, in
/// [`SoftDrive::command`].
pub struct SoftDrive {
    identity: Identity,
    winding_limit_c: f64,
    specimen: MotorTruth,
    plant: Plant,
    sensors: Sensors,
    encoder: Encoder,
    supply_and_brake: SupplyAndBrake,
    faults: DriveFaults,
    output_stage: OutputStage,
    output: Output,
    /// The output of this tick is decided already.
    output_fresh: bool,
    capture: Capture,
    state: State,
    fault: Fault,
    /// The set-point in force while running.
    control: Control,
    seq: u16,
    applied_tick: u64,
    kicked_tick: u64,
    applied_unread: bool,
    tick: u64,
    ran_s: Option<f64>,
    /// Of the watchdog, after each power-up.
    watchdog_as_set_ms: u16,
    command_block: CommandBlock,
    /// The two other registers that the host writes.
    capture_control: u16,
    window_index: u16,
}

impl SoftDrive {
    /// A drive just powered up: disabled, motor cold and at rest, drive time 0. The seed fixes the specimen; with the day,
    /// noise and random loads.
    pub fn new(config: &EmulatorConfig, seed: u64) -> Self {
        let specimen = config.motor.specimen(config.tolerance, seed);
        // 2^64 / golden ratio (Knuth, *The Art of Computer Programming*, vol. 3, §6.4): separates the days of one seed from those
        // of its neighbours.
        let chance = seed.wrapping_add(config.day.wrapping_mul(0x9E37_79B9_7F4A_7C15));
        let site = Site { motor: specimen.clone(), bus_v: config.limits.bus_v, seed: chance };
        let plant = Plant::on_site(site, &config.hidden)
            .broken(config.faults.locked_rotor, config.faults.open_phase)
            .with_changes(config.changes.clone());
        let path = *plant.path();
        Self {
            identity: identity(config, seed),
            winding_limit_c: config.limits.winding_limit_c,
            plant,
            specimen,
            sensors: Sensors::new(config.noise.clone(), config.quantisation.clone(), chance)
                .behind(path, TICK_S),
            encoder: Encoder::new(config.faults),
            supply_and_brake: SupplyAndBrake::new(config),
            faults: DriveFaults::new(&config.faulty),
            output_stage: OutputStage::new(&config.limits, &config.motor, &path),
            output: Output::off(config.limits.output_off, config.limits.bus_v),
            output_fresh: false,
            capture: Capture::default(),
            state: State::Disabled,
            fault: Fault::None,
            control: Control::Disable,
            seq: 0,
            applied_tick: 0,
            kicked_tick: 0,
            applied_unread: false,
            tick: 0,
            ran_s: None,
            watchdog_as_set_ms: config.watchdog_ms,
            command_block: CommandBlock::default(),
            capture_control: 0,
            window_index: 0,
        }
    }

    pub fn time_s(&self) -> f64 {
        self.tick as f64 * TICK_S
    }

    /// Lets drive time reach `time_s`; a time that has passed changes nothing.
    pub fn advance_to(&mut self, time_s: f64) {
        // The small addend keeps rounding from turning n ticks into one less.
        let target = whole(time_s / TICK_S + 1e-6) as u64;
        while self.tick < target {
            self.step();
        }
    }

    /// Takes a command: it is applied on the next control tick, to which the drive advances.
    pub fn command(&mut self, command: DriveCommand) {
        self.step();
        self.command_block.set(command);
        self.apply(command);
    }

    pub fn telemetry(&mut self) -> Telemetry {
        let telemetry = self.true_telemetry();
        self.faults.telemetry(telemetry)
    }

    fn true_telemetry(&mut self) -> Telemetry {
        let reading = self.reading();
        let status = Status::new(self.state)
            .with(Status::CURRENT_LIMIT, self.output.current_limited)
            .with(Status::VOLTAGE_LIMIT, self.output.voltage_limited)
            .with(Status::WATCHDOG, self.fault == Fault::Watchdog)
            .with(Status::COMMAND_APPLIED, std::mem::take(&mut self.applied_unread))
            .with(Status::EMULATOR, true);
        Telemetry {
            status,
            fault: self.fault,
            seq: self.seq,
            time_us: self.micros(self.tick),
            applied_us: self.micros(self.applied_tick),
            voltage_v: reading.voltage_v,
            current_a: reading.current_a,
            speed_rad_s: reading.speed_rad_s,
            angle_rad: reading.angle_rad,
            bus_v: reading.bus_v,
            // This drive has no sensor in its output stage.
            temperature_c: f64::NAN,
            voltage_cmd_v: self.output.volts,
            protocol_version: PROTOCOL_VERSION,
        }
    }

    pub const fn identity(&self) -> &Identity {
        &self.identity
    }

    pub const fn state(&self) -> State {
        self.state
    }

    pub const fn fault(&self) -> Fault {
        self.fault
    }

    pub(super) const fn seq(&self) -> u16 {
        self.seq
    }

    /// Commanded output voltage, V; 0 while it is off.
    pub(super) fn output_v(&self) -> f64 {
        if self.state == State::Running { self.output.volts } else { 0.0 }
    }

    /// Since its last start, s, as long as it ran; `None` where it never did.
    pub const fn ran_s(&self) -> Option<f64> {
        self.ran_s
    }

    pub fn is_powered(&self) -> bool {
        !self.has(FaultKind::PowerLost)
    }

    /// Whether this goes wrong in it now.
    pub(crate) fn has(&self, kind: FaultKind) -> bool {
        self.faults.has(kind)
    }

    /// The true parameters of this specimen: for tests.
    pub const fn truth(&self) -> &MotorTruth {
        &self.specimen
    }

    /// The true machine: for tests and for comparing a sensor with the truth.
    pub const fn plant(&self) -> &Plant {
        &self.plant
    }

    /// Changes the watchdog time; false if it is outside of what the register allows.
    pub(crate) fn set_watchdog_ms(&mut self, ms: u16) -> bool {
        let allowed = firmware_protocol::registers::WATCHDOG.allows(ms.into());
        if allowed {
            self.identity.watchdog_ms = ms;
        }
        allowed
    }

    /// One control period: supervision, output, plant, capture.
    fn step(&mut self) {
        self.apply_faults();
        self.supervise();
        if !std::mem::take(&mut self.output_fresh) {
            self.refresh_output();
        }
        self.plant.brake(self.supply_and_brake.holds() || self.has(FaultKind::Blocked));
        self.plant.advance(self.output.terminals, TICK_S);
        let power_w = self.plant.terminal_v() * self.plant.current_a();
        let is_running = self.state == State::Running;
        self.supply_and_brake.step(TICK_S, is_running, power_w);
        self.tick += 1;
        self.capture.held(self.plant.terminal_v());
        self.sensors.follow(self.plant.current_a(), self.plant.speed_rad_s());
        self.record();
    }

    /// What goes wrong in the drive itself.
    fn apply_faults(&mut self) {
        if self.state == State::Running {
            self.ran_s = Some(self.plant.time_s());
        }
        if !self.faults.look(self.time_s(), self.ran_s) {
            return;
        }
        if self.has(FaultKind::Trip) {
            self.trip(Fault::Internal);
        }
        if !self.is_powered() {
            self.power_up();
        }
    }

    /// As after power-up; its clock begins anew.
    fn power_up(&mut self) {
        (self.state, self.fault) = (State::Disabled, Fault::None);
        (self.seq, self.control) = (0, Control::Disable);
        self.applied_tick = self.tick;
        (self.output_fresh, self.applied_unread) = (false, false);
        self.command_block = CommandBlock::default();
        self.capture = Capture::default();
        (self.capture_control, self.window_index) = (0, 0);
        self.identity.watchdog_ms = self.watchdog_as_set_ms;
        self.faults.clock_from(self.tick);
    }

    /// Drive time as the protocols carry it.
    fn micros(&self, tick: u64) -> u32 {
        micros(tick).wrapping_add(self.faults.clock_us())
    }

    fn supervise(&mut self) {
        let limit_ticks = u64::from(self.identity.watchdog_ms) * TICKS_PER_MS;
        let is_silent = self.tick - self.kicked_tick >= limit_ticks;
        if self.state == State::Running && is_silent && !self.has(FaultKind::WatchdogDead) {
            self.trip(Fault::Watchdog);
        }
        for cause in [Fault::OverSpeed, Fault::OverTemperature] {
            if self.persists(cause) {
                self.trip(cause);
            }
        }
    }

    /// Whether the cause of a fault is there now.
    fn persists(&self, fault: Fault) -> bool {
        match fault {
            Fault::OverSpeed => self.plant.speed_rad_s().abs() > self.identity.speed_limit_rad_s,
            Fault::OverTemperature => {
                // Temperature around the motor.
                25.0 + self.plant.winding_rise_k() > self.winding_limit_c
            }
            _ => false,
        }
    }

    fn trip(&mut self, fault: Fault) {
        // The first cause stays.
        if self.state != State::Fault {
            self.state = State::Fault;
            self.fault = fault;
            self.output_fresh = false;
            // An old set-point must not come back with a later write of a part of the block.
            self.command_block.forget();
        }
    }

    /// The state machine. Every command kicks the watchdog and is echoed, also where a latched fault keeps it from
    /// having an effect: the echo with the state is how the host learns that.
    fn apply(&mut self, command: DriveCommand) {
        let before = (self.state, self.control.code());
        let control = self.faults.obeyed(self.state, self.control, command.control);
        match (self.state, control) {
            (State::Fault, Control::ResetFault) if !self.persists(self.fault) => {
                self.state = State::Disabled;
                self.fault = Fault::None;
            }
            (State::Fault, _) => {}
            (_, Control::Disable | Control::ResetFault) => self.state = State::Disabled,
            (_, Control::Stop) => self.state = State::Ready,
            (_, set_point) => {
                self.state = State::Running;
                self.control = set_point;
            }
        }
        if before.0 != State::Running && self.state == State::Running {
            self.plant.start();
        }
        if before != (self.state, self.control.code()) {
            self.output_stage.restart(&self.plant);
        }
        self.seq = command.seq;
        self.applied_tick = self.tick;
        self.kicked_tick = self.tick;
        self.applied_unread = true;
        // The new voltage stands at the terminals from this instant on.
        self.refresh_output();
        self.output_fresh = true;
        self.plant.hold(self.output.terminals);
        self.capture.command_applied();
        self.record();
    }

    fn refresh_output(&mut self) {
        let control = (self.state == State::Running).then_some(self.control);
        self.output = self.output_stage.output(control, &self.plant, self.tick);
    }

    fn record(&mut self) {
        if self.capture.is_due(self.tick, CAPTURE_TICKS.into()) {
            // The mean, so that its volt-seconds are right whenever a command came.
            let mean_v = self.capture.mean_voltage_v();
            let reading = self.reading_at(mean_v.unwrap_or(self.plant.terminal_v()));
            self.capture.record(self.tick, &reading);
        }
    }

    fn reading(&mut self) -> Reading {
        self.reading_at(self.plant.terminal_v())
    }

    fn reading_at(&mut self, voltage_v: f64) -> Reading {
        let truth = Reading {
            voltage_v,
            current_a: self.plant.current_a(),
            speed_rad_s: self.plant.speed_rad_s(),
            angle_rad: self.plant.angle_rad(),
            bus_v: self.plant.bus_v() + self.supply_and_brake.rise_v(),
        };
        let reading = self.sensors.read(self.tick, truth);
        let reading = self.encoder.read(self.plant.time_s(), reading);
        self.faults.reading(reading)
    }
}

/// Drive time as the protocols carry it.
#[expect(clippy::cast_possible_truncation, reason = "the counter wraps, as the protocol says")]
const fn micros(tick: u64) -> u32 {
    tick.wrapping_mul(TICK_US as u64) as u32
}

fn identity(config: &EmulatorConfig, seed: u64) -> Identity {
    let [.., b3, b2, b1, b0] = seed.to_be_bytes();
    Identity {
        kind: DeviceKind(
            DeviceKind::EMULATOR | DeviceKind::VOLTAGE | DeviceKind::CURRENT | DeviceKind::SPEED,
        ),
        serial_number: u32::from_be_bytes([b3, b2, b1, b0]),
        firmware_version: 0x0001,
        current_limit_a: config.limits.current_limit_a,
        voltage_limit_v: config.limits.bus_v,
        speed_limit_rad_s: config.limits.speed_limit_rad_s,
        watchdog_ms: config.watchdog_ms,
        pole_pairs: 0,
        rated_voltage_v: config.motor.rated_voltage_v,
        rated_current_a: config.motor.rated_current_a,
        rated_speed_rad_s: config.motor.rated_speed_rad_s,
        control_period_us: TICK_US,
        capture_period_us: TICK_US * CAPTURE_TICKS,
        capture_length: capture::LENGTH,
    }
}

#[cfg(test)]
mod form_tests;
#[cfg(test)]
mod tests;
