//! The journal of a software drive: what its motor did, by the drive's own truth and no host's word.
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
use super::dialogue::{Answering, Received};

/// Columns of the file. `time_s` is `CLOCK_MONOTONIC` of this machine, so that other processes can tell what was when.
const COLUMNS: &str =
    "time_s,set_point_v,output_on,voltage_v,current_a,speed_rad_s,state,fault,host,seq,late_s";
/// Changes are seen this far apart, s.
const STEP_S: f64 = 0.001;
/// Between two rows where nothing changes, s.
const PERIOD_S: f64 = 0.01;

/// The drive at one instant.
struct JournalRow {
    /// `CLOCK_MONOTONIC` of this machine, s.
    time_s: f64,
    /// What its output is told to be, V; 0 while it is off.
    set_point_v: f64,
    output_on: bool,
    /// At the terminals.
    voltage_v: f64,
    current_a: f64,
    speed_rad_s: f64,
    /// `disabled`, `ready`, `running` or `fault`.
    state: String,
    /// `none`, or why it stopped itself: `watchdog`, `over-speed`.
    fault: String,
    /// Number of the connection that asked last, in the order in which they were made; empty before the first.
    host: Option<u64>,
    /// Low 16 bits of the number of the last command that was applied.
    seq: u16,
    /// So much later than its instant it was written, s: a drive that is kept from running sees nothing.
    late_s: f64,
}

impl JournalRow {
    fn text(&self) -> String {
        let host = self.host.map_or_else(String::new, |host| host.to_string());
        format!(
            "{:.4},{},{},{:.4},{:.4},{:.4},{},{},{host},{},{:.4}\n",
            self.time_s,
            self.set_point_v,
            u8::from(self.output_on),
            self.voltage_v,
            self.current_a,
            self.speed_rad_s,
            self.state,
            self.fault,
            self.seq,
            self.late_s
        )
    }

    /// Whether there is something between them that has to be seen at once.
    fn differs(&self, other: &Self) -> bool {
        self.set_point_v.to_bits() != other.set_point_v.to_bits()
            || self.output_on != other.output_on
            || self.state != other.state
            || self.fault != other.fault
            || self.host != other.host
            || self.seq != other.seq
    }
}

/// A file that is written as the drive goes, row by row.
pub struct Journal {
    /// Gone once it cannot be written any more: a journal that ends early says so by its last row.
    file: Option<File>,
    last: Option<JournalRow>,
    host: Option<u64>,
    /// Drive time 0 on `CLOCK_MONOTONIC`, s.
    origin_s: f64,
}

impl Journal {
    /// A new file; one that exists is not touched.
    pub fn create(path: &Path) -> io::Result<Self> {
        let mut file = File::create_new(path)?;
        writeln!(file, "{COLUMNS}")?;
        Ok(Self {
            file: Some(file),
            last: None,
            host: None,
            origin_s: 0.0,
        })
    }

    fn note(&mut self, drive: &SoftDrive, now_s: f64) {
        let row = JournalRow {
            time_s: self.origin_s + drive.time_s(),
            set_point_v: drive.output_v(),
            output_on: drive.state() == State::Running,
            voltage_v: drive.plant().terminal_v(),
            current_a: drive.plant().current_a(),
            speed_rad_s: drive.plant().speed_rad_s(),
            state: state(drive.state()).to_owned(),
            fault: drive.fault().name().to_owned(),
            host: self.host,
            seq: drive.seq(),
            late_s: (now_s - drive.time_s()).max(0.0),
        };
        let is_due = self
            .last
            .as_ref()
            .is_none_or(|last| row.time_s - last.time_s >= PERIOD_S - 1e-6 || row.differs(last));
        if !is_due {
            return;
        }
        let written = self
            .file
            .as_mut()
            .map(|file| file.write_all(row.text().as_bytes()));
        if let Some(Err(_)) = written {
            self.file = None;
        }
        self.last = Some(row);
    }
}

const fn state(state: State) -> &'static str {
    match state {
        State::Disabled => "disabled",
        State::Ready => "ready",
        State::Running => "running",
        State::Fault => "fault",
    }
}

/// A drive whose every change is noted.
pub(super) struct Journaled {
    drive: Box<dyn Answering>,
    journal: Journal,
    /// Drive time by the clock, s.
    clock: Box<dyn Fn() -> f64 + Send>,
}

impl Journaled {
    /// `origin_s`: drive time 0 on `CLOCK_MONOTONIC`.
    pub(super) fn new(
        drive: Box<dyn Answering>,
        mut journal: Journal,
        origin_s: f64,
        clock: Box<dyn Fn() -> f64 + Send>,
    ) -> Self {
        journal.origin_s = origin_s;
        Self {
            drive,
            journal,
            clock,
        }
    }

    fn note(&mut self) {
        self.journal.note(self.drive.soft(), (self.clock)());
    }
}

impl Answering for Journaled {
    fn soft(&self) -> &SoftDrive {
        self.drive.soft()
    }

    fn advance_to(&mut self, time_s: f64) {
        loop {
            let next_s = time_s.min(self.soft().time_s() + STEP_S);
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

    fn ran_s(&self) -> Option<f64> {
        self.drive.ran_s()
    }

    fn is_powered(&self) -> bool {
        self.drive.is_powered()
    }

    fn foreign_write(&self) -> Vec<u8> {
        self.drive.foreign_write()
    }

    fn asked_by(&mut self, session: u64) {
        self.journal.host = Some(session);
        self.drive.asked_by(session);
    }
}

#[cfg(test)]
mod tests {
    use firmware_protocol::{Control, DriveCommand};

    use super::*;
    use crate::EmulatorConfig;

    #[test]
    fn every_change_has_its_row_and_a_drive_that_is_told_nothing_one_every_10_ms() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("journal.csv");
        let mut soft = SoftDrive::new(&EmulatorConfig::embedded("zk-22fc-plain").unwrap(), 1);
        soft.command(DriveCommand::new(1, Control::Voltage(20.0)));
        let journal = Journal::create(&path).unwrap();
        assert!(Journal::create(&path).is_err(), "it is never overwritten");
        let mut drive = Journaled::new(Box::new(soft), journal, 100.0, Box::new(|| 2.0));
        drive.asked_by(3);
        drive.advance_to(1.0);
        let text = std::fs::read_to_string(&path).unwrap();
        let mut lines = text.lines();
        assert_eq!(lines.next(), Some(COLUMNS));
        let rows: Vec<Vec<&str>> = lines.map(|line| line.split(',').collect()).collect();
        let number = |row: &[&str], at: usize| row[at].parse::<f64>().unwrap();
        assert!(
            rows.windows(2)
                .all(|pair| number(&pair[1], 0) - number(&pair[0], 0) < 0.0111)
        );
        assert_eq!((rows[0][2], rows[0][8]), ("1", "3"), "on, by this host");
        assert!((number(&rows[0], 1) - 20.0).abs() < 1e-9);
        // Nobody commands it any more: its watchdog of 0.5 s is in it to the millisecond.
        let off = rows.iter().find(|row| row[2] == "0").unwrap();
        assert!((number(off, 0) - 100.5).abs() < 0.0021, "{off:?}");
        assert_eq!((off[7], number(off, 1)), ("watchdog", 0.0));
        assert!((number(off, 10) - 1.5).abs() < 0.0021, "{off:?}");
    }
}
