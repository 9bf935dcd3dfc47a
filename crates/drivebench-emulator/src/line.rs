//! In-memory Modbus RTU line to the software drive: every byte through codec and line timing, in virtual time.

use super::codec::{Codec, Responder, UNIT};
use super::line_faults::LineFaults;
use super::pace::Pace;
use super::{
    EmulatorConfig, EmulatorConfigError, FaultEntry, ForeignDrive, Guise, LineConfig, SoftDrive,
};
use drivebench_link::virtual_line::{FarEnd, VirtualLink};
use drivebench_link::{DriveLink, DriveProfile, Protocol, VirtualClock};

/// Opens a link to the drive, under the profile of another where one is given, over a line in memory.
pub fn open_line(
    guise: Option<&Guise>,
    config: &EmulatorConfig,
    seed: u64,
    profile: &DriveProfile,
    clock: VirtualClock,
) -> Result<Box<dyn DriveLink>, EmulatorConfigError> {
    let spoken = guise.map(|guise| guise.map.protocol).filter(|protocol| !protocol.is_modbus());
    let protocol = spoken.unwrap_or(Protocol::ModbusRtu);
    config.suits(guise.is_some(), protocol)?;
    let drive: Box<dyn Responder> = match guise {
        Some(guise) => Box::new(ForeignDrive::new(guise, config, seed)),
        None => Box::new(SoftDrive::new(config, seed)),
    };
    let mut line = guise.map_or(&config.line, |guise| &guise.line).clone();
    line.baud = profile.link.baud;
    let unit = guise.map_or(UNIT, |guise| guise.unit);
    let far = DriveOnLine::new(drive, protocol, unit, &line, &config.faulty, seed);
    Ok(Box::new(VirtualLink::open("sim:rtu", profile, clock, far)))
}

struct DriveOnLine {
    line_faults: LineFaults,
    drive: Box<dyn Responder>,
    codec: Codec,
    pace: Pace,
    /// When the silence behind the last byte has ended a frame, s.
    silent_from_s: f64,
}

impl FarEnd for DriveOnLine {
    fn receive(&mut self, now_s: f64, bytes: &[u8]) -> Vec<(f64, Vec<u8>)> {
        let mut answers = Vec::new();
        let mut sent = Vec::new();
        if now_s >= self.silent_from_s {
            self.codec.idle(self.drive.as_mut(), &mut answers);
            answers.clear();
        }
        let mut at_s = now_s;
        for byte in bytes {
            at_s = self.pace.arrival_s(now_s);
            self.drive.advance_to(at_s);
            self.line_faults.host_byte(*byte);
            let mut drive = self.line_faults.before(self.drive.as_mut(), at_s);
            // Only a peer that is no Modbus TCP cannot be framed.
            let _ = self.codec.push(*byte, &mut drive, &mut || true, &mut answers);
            self.send(at_s, &mut answers, &mut sent);
        }
        self.silent_from_s = at_s + self.pace.gap_s();
        // A request whose length does not follow from its bytes ends with the silence; the host writes it in one piece.
        let mut drive = self.line_faults.before(self.drive.as_mut(), at_s);
        self.codec.idle(&mut drive, &mut answers);
        self.send(self.silent_from_s, &mut answers, &mut sent);
        self.line_faults.silence();
        // Bytes without a request are computed 0.25 s ahead, until the next call.
        let ahead_s = now_s + 0.25;
        sent.extend(self.line_faults.unrequested(now_s, ahead_s, self.drive.as_mut()));
        sent
    }
}

impl DriveOnLine {
    fn new(
        drive: Box<dyn Responder>,
        protocol: Protocol,
        unit: u8,
        line: &LineConfig,
        faults: &[FaultEntry],
        seed: u64,
    ) -> Self {
        Self {
            line_faults: LineFaults::new(faults, protocol, unit, seed),
            drive,
            codec: Codec::new(protocol, unit),
            pace: Pace::serial(line, protocol == Protocol::ModbusRtu),
            silent_from_s: 0.0,
        }
    }

    fn send(&mut self, end_s: f64, answers: &mut Vec<Vec<u8>>, sent: &mut Vec<(f64, Vec<u8>)>) {
        for answer in answers.drain(..) {
            let due_s = self.pace.delivery_s(end_s, answer.len());
            sent.extend(self.line_faults.reply(answer, end_s, due_s, self.drive.ran_s()));
        }
    }
}

#[cfg(test)]
mod fault_tests;
