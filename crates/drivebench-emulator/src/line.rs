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

#[cfg(test)]
mod tests {
    use super::*;
    use drivebench_model::sample::{Channel, Command, Demand};

    fn link(seed: u64, config: &EmulatorConfig) -> (Box<dyn DriveLink>, VirtualClock) {
        let clock = VirtualClock::new();
        let mut profile = DriveProfile::named("own").unwrap();
        profile.link.emulated = true;
        (open_line(None, config, seed, &profile, clock.clone()).unwrap(), clock)
    }

    /// What an exchange of each cycle gave, and when it was over.
    fn samples(seed: u64) -> Vec<(f64, Option<f64>, f64)> {
        let (mut link, clock) = link(seed, &EmulatorConfig::embedded_default());
        assert!(link.identify().unwrap().is_emulator);
        let begun_s = clock.time_s();
        let exchanges = (1..=200_u32).map(|cycle| {
            let at_s = begun_s + f64::from(cycle) * 0.02;
            clock.set_time_s(at_s);
            let demand = Demand::Voltage(30.0 * f64::from(cycle % 7));
            let sample = link.exchange(Command { seq: cycle.into(), demand }).unwrap();
            let took_s = clock.time_s() - at_s;
            // 58 characters at 115200 baud, one silence, the turnaround.
            assert!((took_s - 0.007_285).abs() < 2e-5, "{took_s}");
            (sample.time_s, sample.get(Channel::Speed), clock.time_s())
        });
        exchanges.collect()
    }

    #[test]
    fn one_seed_gives_the_same_samples_at_the_same_times_to_the_bit() {
        let first = samples(5);
        assert_eq!(first, samples(5));
        assert_ne!(first, samples(6));
        assert!(first.iter().any(|(_, speed, _)| speed.unwrap() > 20.0));
    }
}
