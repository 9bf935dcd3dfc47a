//! Journal of a software drive: true state of its motor over time, independent of any host.
//!
//! ```text
//! requests, time --> Journaled --> the drive
//!                        '--> FILE: a row at each change, and one every 10 ms at least
//! ```

use std::fs::File;
use std::io::{self, Write};
use std::path::Path;

use firmware_protocol::{State, stream};

use super::SoftDrive;
use super::codec::{Received, Responder};

/// Columns of the file. `time_s` is `CLOCK_MONOTONIC` of this machine, for comparison with other processes; `late_s` is the delay
/// with which the row was written, large if the process was not scheduled.
const COLUMNS: &str =
    "time_s,set_point_v,output_on,voltage_v,current_a,speed_rad_s,state,fault,host,seq,late_s";

/// A row that is written at once if it differs from the last one written: set-point in V (0 while the output is off), whether
/// it is on, `disabled`, `ready`, `running` or `fault`, why it stopped itself, the connection of the last request, and the
/// low 16 bits of the number of the last command that was applied.
type Discrete = (u64, bool, &'static str, &'static str, Option<u64>, u16);

/// A file that is written as the drive goes, row by row.
pub struct Journal {
    /// Gone once it cannot be written any more: a journal that ends early shows so by its last row.
    file: Option<File>,
    /// What the last row had, and its time, s.
    last: Option<(Discrete, f64)>,
    host: Option<u64>,
    /// Drive time 0 on `CLOCK_MONOTONIC`, s.
    origin_s: f64,
}

impl Journal {
    /// A new file; one that exists is not touched.
    pub fn create(path: &Path) -> io::Result<Self> {
        let mut file = File::create_new(path)?;
        writeln!(file, "{COLUMNS}")?;
        Ok(Self { file: Some(file), last: None, host: None, origin_s: 0.0 })
    }

    fn note(&mut self, drive: &SoftDrive, now_s: f64) {
        let time_s = self.origin_s + drive.time_s();
        let state = match drive.state() {
            State::Disabled => "disabled",
            State::Ready => "ready",
            State::Running => "running",
            State::Fault => "fault",
        };
        let (set_point_v, is_on) = (drive.output_v(), drive.state() == State::Running);
        let (fault, seq) = (drive.fault().name(), drive.seq());
        let discrete = (set_point_v.to_bits(), is_on, state, fault, self.host, seq);
        // Between two rows where nothing changes, s.
        let is_due =
            |(last, last_s): (Discrete, f64)| last != discrete || time_s - last_s >= 0.01 - 1e-6;
        if !self.last.is_none_or(is_due) {
            return;
        }
        let host = self.host.map_or_else(String::new, |host| host.to_string());
        let plant = drive.plant();
        let row = format!(
            "{time_s:.4},{set_point_v},{},{:.4},{:.4},{:.4},{state},{fault},{host},{seq},{:.4}\n",
            u8::from(is_on),
            plant.terminal_v(),
            plant.current_a(),
            plant.speed_rad_s(),
            (now_s - drive.time_s()).max(0.0)
        );
        let written = self.file.as_mut().map(|file| file.write_all(row.as_bytes()));
        if let Some(Err(_)) = written {
            self.file = None;
        }
        self.last = Some((discrete, time_s));
    }
}

/// A drive whose every change is noted.
pub(super) struct Journaled {
    drive: Box<dyn Responder>,
    journal: Journal,
    /// Drive time by the clock, s.
    clock: Box<dyn Fn() -> f64 + Send>,
}

impl Journaled {
    /// `origin_s`: drive time 0 on `CLOCK_MONOTONIC`.
    pub(super) fn new(
        drive: Box<dyn Responder>,
        mut journal: Journal,
        origin_s: f64,
        clock: Box<dyn Fn() -> f64 + Send>,
    ) -> Self {
        journal.origin_s = origin_s;
        Self { drive, journal, clock }
    }

    fn note(&mut self) {
        self.journal.note(self.drive.soft(), (self.clock)());
    }
}

impl Responder for Journaled {
    fn soft(&self) -> &SoftDrive {
        self.drive.soft()
    }

    fn advance_to(&mut self, time_s: f64) {
        loop {
            // Resolution of changes, s.
            let next_s = time_s.min(self.soft().time_s() + 0.001);
            self.drive.advance_to(next_s);
            self.note();
            if next_s >= time_s {
                return;
            }
        }
    }

    fn modbus(&mut self, request: &[u8]) -> Vec<u8> {
        let answer = self.drive.modbus(request);
        self.note();
        answer
    }

    fn stream(&mut self, received: &Received) -> Option<stream::Frame> {
        let answer = self.drive.stream(received);
        self.note();
        answer
    }

    fn packet(&mut self, body: &[u8], may_command: &mut dyn FnMut() -> bool) -> Option<Vec<u8>> {
        let answer = self.drive.packet(body, may_command);
        self.note();
        answer
    }

    fn foreign_write(&self) -> Vec<u8> {
        self.drive.foreign_write()
    }

    fn request_from(&mut self, session: u64) {
        self.journal.host = Some(session);
        self.drive.request_from(session);
    }
}

#[cfg(test)]
mod tests {
    use firmware_protocol::{Control, DriveCommand};

    use super::*;
    use crate::EmulatorConfig;

    #[test]
    fn every_change_has_a_row_and_every_10_ms_has_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("journal.csv");
        let mut soft = SoftDrive::new(&EmulatorConfig::embedded("zk-22fc-plain").unwrap(), 1);
        soft.command(DriveCommand::new(1, Control::Voltage(20.0)));
        let journal = Journal::create(&path).unwrap();
        assert!(Journal::create(&path).is_err(), "it is never overwritten");
        let mut drive = Journaled::new(Box::new(soft), journal, 100.0, Box::new(|| 2.0));
        drive.request_from(3);
        drive.advance_to(1.0);
        let text = std::fs::read_to_string(&path).unwrap();
        let mut lines = text.lines();
        assert_eq!(lines.next(), Some(COLUMNS));
        let rows: Vec<Vec<&str>> = lines.map(|line| line.split(',').collect()).collect();
        let number = |row: &[&str], at: usize| row[at].parse::<f64>().unwrap();
        assert!(rows.windows(2).all(|pair| number(&pair[1], 0) - number(&pair[0], 0) < 0.0111));
        assert_eq!((rows[0][2], rows[0][8]), ("1", "3"), "on, by this host");
        assert!((number(&rows[0], 1) - 20.0).abs() < 1e-9);
        // Nobody commands it any more: its watchdog of 0.5 s is in it to the millisecond.
        let off = rows.iter().find(|row| row[2] == "0").unwrap();
        assert!((number(off, 0) - 100.5).abs() < 0.0021, "{off:?}");
        assert_eq!((off[7], number(off, 1)), ("watchdog", 0.0));
        assert!((number(off, 10) - 1.5).abs() < 0.0021, "{off:?}");
    }
}
