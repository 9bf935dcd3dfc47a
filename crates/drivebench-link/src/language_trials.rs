//! Trials of the languages whose frames are made here: replies that are late, lost, doubled, cut, flipped and among garbage, in
//! virtual time. No read may give a value that is not the one of its own request.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use super::DriveProfile;
use super::cell_bus::{CellBus, CellTable, Put, ReadRequest};
use super::framing::FrameKind;
use super::line_bus::{Framed, LineBus};
use super::link::LinkError;
use super::virtual_line::{Device, exchange, paused};

/// Where the number stands.
const ADDRESS: u16 = 128;

/// A drive whose every reply holds another number.
struct Numbering {
    kind: FrameKind,
    count: u32,
    random: u64,
    /// Replies with a fault of 256.
    faulty: u64,
    pending: Vec<u8>,
    scratch: String,
}

impl Numbering {
    /// Xorshift (Marsaglia 2003).
    fn random(&mut self, below: u64) -> u64 {
        self.random ^= self.random << 13;
        self.random ^= self.random >> 7;
        self.random ^= self.random << 17;
        (self.random >> 16) % below
    }

    fn byte(&mut self) -> u8 {
        self.random(256).to_le_bytes()[0]
    }

    /// The reply to the request that these bytes end; `None` where they do not.
    fn reply(&mut self) -> Option<Vec<u8>> {
        let sent = std::mem::take(&mut self.pending);
        if self.kind == FrameKind::Lines {
            return self.answers(&sent);
        }
        if self.kind == FrameKind::Vesc {
            // The selected values end each request: mask and check sum.
            let [.., b3, b2, b1, b0, _, _, 3] = sent[..] else {
                self.pending = sent;
                return None;
            };
            self.count += 1;
            let number = self.count.to_be_bytes();
            let mask = u32::from_be_bytes([b3, b2, b1, b0]);
            // Bit 7 has four bytes, bit 15 one.
            let values: &[u8] = if mask & (1 << 7) == 0 { &[0] } else { &number };
            return Some(self.kind.packet(0, &[&[50, b3, b2, b1, b0][..], values].concat()));
        }
        self.count += 1;
        // What stands in front of the number, and how much is read from there.
        let (before, count) = match sent[7] {
            2 => (ADDRESS.saturating_sub(sent[8].into()), sent[10].into()),
            _ => (0, 0),
        };
        let number = self.count.to_le_bytes();
        let data = std::iter::repeat_n(0, before.into()).chain(number).chain([0; 60]).take(count);
        let body: Vec<u8> = [0x55, 0].into_iter().chain(data).collect();
        Some(self.kind.packet(1, &body))
    }

    /// The answers of the drive odrive-0.5 to whole lines with check sums: the scratch number as it is, the bus voltage as the count.
    fn answers(&mut self, sent: &[u8]) -> Option<Vec<u8>> {
        let mut reply = String::new();
        for line in std::str::from_utf8(sent).ok()?.lines() {
            let line = line.rsplit_once(" *")?.0;
            let answer = match line.strip_prefix("w test_property ") {
                Some(number) => {
                    number.clone_into(&mut self.scratch);
                    continue;
                }
                None if line == "r test_property" => self.scratch.clone(),
                None if line == "r vbus_voltage" => {
                    self.count += 1;
                    format!("{}.000000", self.count)
                }
                None => continue,
            };
            let sum = answer.bytes().fold(0, |sum, byte| sum ^ byte);
            reply.extend([answer, format!("*{sum}\r\n")]);
        }
        Some(reply.into_bytes())
    }
}

impl Device for Numbering {
    fn receive(&mut self, bytes: &[u8]) -> Vec<(Duration, Vec<u8>)> {
        let ms = Duration::from_micros;
        self.pending.extend_from_slice(bytes);
        let Some(mut reply) = self.reply() else { return Vec::new() };
        let usual = ms(1000 + self.random(300));
        if self.random(256) >= self.faulty {
            return vec![(usual, reply)];
        }
        let at = usize::try_from(self.random(reply.len() as u64)).unwrap();
        match self.random(8) {
            0 => Vec::new(),
            1 => vec![(ms(20_000 + self.random(300_000)), reply)],
            2 => vec![(usual, reply.clone()), (usual + ms(self.random(15_000)), reply)],
            3 => vec![(usual, reply[..at].to_vec())],
            4 => {
                reply[at] ^= 1 << self.random(8);
                vec![(usual, reply)]
            }
            5 => {
                let garbage: Vec<u8> = (0..self.random(40)).map(|_| self.byte()).collect();
                vec![(usual, [garbage, reply].concat())]
            }
            6 => {
                reply.insert(at, self.byte());
                vec![(usual, reply)]
            }
            _ => {
                let rest = reply.split_off(at);
                vec![(usual, reply), (usual + ms(self.random(9_000)), rest)]
            }
        }
    }
}

fn bytes(cells: &[u16]) -> [u8; 4] {
    let bytes: Vec<u8> = cells.iter().map(|cell| cell.to_le_bytes()[0]).collect();
    bytes.try_into().unwrap()
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a count below 2^24")]
fn number(value: f32) -> u32 {
    value as u32
}

/// Reads so many times with so many faults: how many had a value, and how many of those a wrong one.
fn trial(profile: &str, exchanges: u32, faulty: u64, seed: u64) -> (u32, u32) {
    let profile = DriveProfile::named(profile).unwrap();
    let map = profile.registers.as_deref().unwrap();
    let kind = FrameKind::serial(profile.link.protocol);
    let bus = map.signal("bus").map(|signal| signal.location.request());
    let (table, address, count, function) = match kind {
        FrameKind::Lines => (bus.unwrap().table, 0, 2, 2),
        FrameKind::Vesc => (CellTable::Fields(1 << 7), 0, 4, 5),
        _ => (CellTable::Bytes, ADDRESS, 4, 2),
    };
    let (pending, scratch) = (Vec::new(), String::new());
    let device = Numbering { kind, count: 0, random: seed, faulty, pending, scratch };
    let device = Arc::new(Mutex::new(device));
    paused(|| {
        let line = exchange("virtual", kind, &profile.link, &device);
        let mut bus = LineBus::new(Framed::new(1, map.lines.clone()), line, map);
        let (mut values, mut wrong) = (0, 0);
        for turn in 0..exchanges {
            bus.bound(f64::INFINITY);
            let read = ReadRequest { table, address, count };
            let put = Put {
                function,
                address: if kind == FrameKind::Lines { 0 } else { 100 },
                cells: &[0, 0],
            };
            let read = match turn % 3 {
                0 if kind == FrameKind::Vesc => bus.read_write(put, read),
                1 => {
                    drop(bus.write(put));
                    continue;
                }
                _ => bus.read(read),
            };
            let right = device.lock().unwrap().count;
            match read {
                Ok(read) => {
                    let found = match kind {
                        FrameKind::Lines => {
                            let bits = u32::from(read.cells[0]) << 16 | u32::from(read.cells[1]);
                            let value = f32::from_bits(bits);
                            // No number is a missing one.
                            if value.is_nan() {
                                continue;
                            }
                            number(value)
                        }
                        FrameKind::Vesc => u32::from_be_bytes(bytes(&read.cells)),
                        _ => u32::from_le_bytes(bytes(&read.cells)),
                    };
                    values += 1;
                    wrong += u32::from(found != right);
                }
                Err(error) => assert!(!matches!(error, LinkError::Gone { .. }), "{error}"),
            }
        }
        assert!(bus.statistics().balances());
        (values, wrong)
    })
}

#[test]
fn no_fault_of_a_line_gives_a_value_of_another_request() {
    for profile in ["vesc-dc", "dynamixel-xm430", "odrive-0.5"] {
        let (values, wrong) = trial(profile, 3000, 0, 1);
        assert_eq!((values, wrong), (2000, 0), "{profile}: a clean line");
        let everything = std::env::var_os("DRIVEBENCH_EVERYTHING").is_some();
        let (exchanges, seeds) = if everything { (100_000, 1..=10) } else { (12_000, 2..=2) };
        for seed in seeds {
            let (values, wrong) = trial(profile, exchanges, 13, seed);
            assert_eq!(wrong, 0, "{profile}, seed {seed}: {values} values");
            assert!(12 * values > 7 * exchanges, "{profile}, seed {seed}: {values} values");
        }
    }
}
