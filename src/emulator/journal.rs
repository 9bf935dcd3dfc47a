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
#[derive(Clone, Debug, PartialEq)]
pub struct JournalRow {
    /// `CLOCK_MONOTONIC` of this machine, s.
    pub time_s: f64,
    /// What its output is told to be, V; 0 while it is off.
    pub set_point_v: f64,
    pub output_on: bool,
    /// At the terminals.
    pub voltage_v: f64,
    pub current_a: f64,
    pub speed_rad_s: f64,
    /// `disabled`, `ready`, `running` or `fault`.
    pub state: String,
    /// `none`, or why it stopped itself: `watchdog`, `over-speed`.
    pub fault: String,
    /// Number of the connection that asked last, in the order in which they were made; empty before the first.
    pub host: Option<u64>,
    /// Low 16 bits of the number of the last command that was applied.
    pub seq: u16,
    /// So much later than its instant it was written, s: a drive that is kept from running sees nothing.
    pub late_s: f64,
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

    /// A row of the file; `None`: it is none, or not whole.
    pub fn parse(line: &str) -> Option<Self> {
        let cells: [&str; 11] = line.split(',').collect::<Vec<_>>().try_into().ok()?;
        let number = |at: usize| cells[at].parse::<f64>().ok();
        Some(Self {
            time_s: number(0)?,
            set_point_v: number(1)?,
            output_on: match cells[2] {
                "0" => false,
                "1" => true,
                _ => return None,
            },
            voltage_v: number(3)?,
            current_a: number(4)?,
            speed_rad_s: number(5)?,
            state: cells[6].to_owned(),
            fault: cells[7].to_owned(),
            host: match cells[8] {
                "" => None,
                host => Some(host.parse().ok()?),
            },
            seq: cells[9].parse().ok()?,
            late_s: number(10)?,
        })
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
    use crate::emulator::EmulatorConfig;

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
        let rows: Vec<JournalRow> = lines.map(|line| JournalRow::parse(line).unwrap()).collect();
        assert!(
            rows.windows(2)
                .all(|pair| pair[1].time_s - pair[0].time_s < 0.0111)
        );
        assert!(rows[0].output_on && rows[0].host == Some(3));
        assert!((rows[0].set_point_v - 20.0).abs() < 1e-9);
        // Nobody commands it any more: its watchdog of 0.5 s is in it to the millisecond.
        let off = rows.iter().find(|row| !row.output_on).unwrap();
        assert!((off.time_s - 100.5).abs() < 0.0021, "{off:?}");
        assert_eq!((off.fault.as_str(), off.set_point_v), ("watchdog", 0.0));
        assert!((off.late_s - 1.5).abs() < 0.0021, "{off:?}");
        assert_eq!(JournalRow::parse("1.0,2"), None);
        let line = off.text().trim_end().to_owned();
        assert_eq!(JournalRow::parse(&line), Some(off.clone()));
        // What is not told is not taken for an output that is off, or for nobody's request.
        for (told, otherwise) in [(",0,0,", ",0,,"), (",0,0,", ",0,true,"), (",3,1,", ",x,1,")] {
            assert!(line.contains(told), "{line}");
            assert_eq!(JournalRow::parse(&line.replacen(told, otherwise, 1)), None);
        }
        let nobody = JournalRow::parse(&line.replacen(",3,1,", ",,1,", 1));
        assert_eq!(nobody.unwrap().host, None);
    }
}
