//! Drives whose language is packets: VESC and Dynamixel, as the makers' documents describe them; and lines of text.
//!
//! The register profile says where each value lies; framing, check sums and the order of the fields are written here a second time,
//! without code of the host, so that two implementations check each other.

use super::ForeignDrive;
use super::registers::{bits, number_of};
use drivebench_link::register_map::{Kind, Signal};
use drivebench_link::{CellTable, KickedBy, Protocol};

/// Whether commands of the host are accepted now, evaluated for each of them.
type MayCommand<'a> = &'a mut dyn FnMut() -> bool;

/// Bytes of each selected value of a VESC, by its bit (commands.c).
const SELECTED: [u16; 22] = [2, 2, 4, 4, 4, 4, 2, 4, 2, 4, 4, 4, 4, 4, 4, 1, 4, 1, 6, 4, 4, 1];

/// Polynomial division, highest bit first, without a final inversion.
fn crc16(polynomial: u16, bytes: &[u8]) -> u16 {
    let mut crc: u16 = 0;
    for bit in bytes.iter().flat_map(|byte| (0..8).rev().map(move |at| byte >> at & 1)) {
        let carries = (crc >> 15) as u8 != bit;
        crc = (crc << 1) ^ if carries { polynomial } else { 0 };
    }
    crc
}

/// Collects the bytes of one connection.
#[derive(Debug, Default)]
pub(crate) struct PacketReceiver {
    bytes: Vec<u8>,
}

impl PacketReceiver {
    /// Takes a byte; the body of the packet that it ends: the payload of a VESC's, or id, instruction and parameters.
    pub(crate) fn push(&mut self, protocol: Protocol, byte: u8) -> Option<Vec<u8>> {
        if protocol == Protocol::Lines {
            if !matches!(byte, b'\r' | b'\n') {
                self.bytes.push(byte);
                return None;
            }
            return Some(std::mem::take(&mut self.bytes)).filter(|line| !line.is_empty());
        }
        self.bytes.push(byte);
        loop {
            let whole = match protocol {
                Protocol::Vesc => vesc_packet(&self.bytes),
                _ => dynamixel_packet(&self.bytes),
            };
            match whole {
                Whole::Not => drop(self.bytes.remove(0)),
                Whole::Yet => return None,
                Whole::Packet(body) => {
                    self.bytes.clear();
                    return Some(body);
                }
            }
            if self.bytes.is_empty() {
                return None;
            }
        }
    }
}

enum Whole {
    /// No packet begins here.
    Not,
    /// One may begin here.
    Yet,
    Packet(Vec<u8>),
}

fn vesc_packet(bytes: &[u8]) -> Whole {
    let (begin, length) = match *bytes {
        [2, length, ..] if length > 0 => (2, usize::from(length)),
        [3, high, low, ..] if high > 0 || low == 255 => {
            (3, usize::from(high) * 256 + usize::from(low))
        }
        [2 | 3] | [3, _] => return Whole::Yet,
        _ => return Whole::Not,
    };
    // The longest payload that the firmware takes.
    if length > 512 {
        return Whole::Not;
    }
    let Some(tail) = bytes.get(begin + length..begin + length + 3) else { return Whole::Yet };
    let payload = &bytes[begin..begin + length];
    let [crc_high, crc_low] = crc16(0x1021, payload).to_be_bytes();
    if tail == [crc_high, crc_low, 3] { Whole::Packet(payload.to_vec()) } else { Whole::Not }
}

fn dynamixel_packet(bytes: &[u8]) -> Whole {
    let header = [0xFF, 0xFF, 0xFD, 0];
    let has = bytes.len().min(4);
    if bytes[..has] != header[..has] {
        return Whole::Not;
    }
    let Some(length) = bytes.get(5..7).map(|two| usize::from(two[0]) + 256 * usize::from(two[1]))
    else {
        return Whole::Yet;
    };
    if !(3..=256).contains(&length) {
        return Whole::Not;
    }
    let Some(packet) = bytes.get(..7 + length) else { return Whole::Yet };
    let (checked, crc) = packet.split_at(5 + length);
    if crc16(0x8005, checked).to_le_bytes() != crc {
        return Whole::Not;
    }
    let mut body = vec![packet[4]];
    for byte in &checked[7..] {
        // What was stuffed behind FF FF FD.
        if !(*byte == 0xFD && body[1..].ends_with(&[0xFF, 0xFF, 0xFD])) {
            body.push(*byte);
        }
    }
    Whole::Packet(body)
}

impl ForeignDrive {
    /// What answers the body of a packet; nothing where the language has no reply to it, or it is for another.
    pub fn answer_packet(&mut self, body: &[u8], may_command: MayCommand<'_>) -> Option<Vec<u8>> {
        match self.map.protocol {
            Protocol::Vesc => self.answer_vesc(body, may_command),
            Protocol::Lines => self.answer_line(body, may_command),
            _ => self.answer_dynamixel(body, may_command),
        }
    }

    /// What a line of text is answered with, by the templates of the profile.
    fn answer_line(&mut self, body: &[u8], may_command: MayCommand<'_>) -> Option<Vec<u8>> {
        let map = std::sync::Arc::clone(&self.map);
        let grammar = map.lines.as_deref()?;
        let mut line = std::str::from_utf8(body).ok()?.trim();
        if grammar.checksum {
            let (text, sum) = line.rsplit_once('*')?;
            // A line with another sum is ignored without an answer.
            (text.bytes().fold(0, |sum, byte| sum ^ byte) == sum.parse::<u8>().ok()?)
                .then_some(())?;
            line = text.trim_end();
        }
        let [write, read, answer] = &grammar.scratch;
        let reply = if let Some(number) = in_template(write, line) {
            number.clone_into(&mut self.scratch);
            grammar.ack.clone()
        } else if line == read {
            Some(answer.replace("{}", &self.scratch))
        } else {
            let known = grammar.lines.iter().enumerate().find_map(|(at, known)| {
                Some((CellTable::Lines(1 << at), known, in_template(&known.send, line)?.to_owned()))
            });
            match known {
                Some((table, known, value))
                    if map.set_points.iter().any(|point| point.location.table == table) =>
                {
                    if may_command() {
                        self.take_number(table, &value);
                    }
                    Some(known.answer.clone())
                }
                Some((table, known, _)) => Some(self.answer_of(table, &known.answer)),
                None => grammar.errors.first().cloned(),
            }
        };
        let reply = reply.filter(|reply| !reply.is_empty())?;
        let sum = reply.bytes().fold(0, |sum, byte| sum ^ byte);
        let sum = if grammar.checksum { format!("*{sum}") } else { String::new() };
        Some(format!("{reply}{sum}\r\n").into_bytes())
    }

    /// A set-point as text.
    fn take_number(&mut self, table: CellTable, value: &str) {
        let map = std::sync::Arc::clone(&self.map);
        let point = map.set_points.iter().find(|point| point.location.table == table);
        // A line without a number is a command for itself.
        let value = if value.is_empty() { "0" } else { value };
        let (Some(point), Ok(value)) = (point, value.parse::<f64>()) else { return };
        let location = point.location;
        let [b3, b2, b1, b0] = bits(location.layout.kind, value).to_be_bytes();
        self.written(location.address, u16::from_be_bytes([b3, b2]));
        self.written(location.address + 1, u16::from_be_bytes([b1, b0]));
        self.apply_write(location.address, 2);
    }

    /// The answer to a line: each hole the value of the signal that stands there.
    fn answer_of(&mut self, table: CellTable, template: &str) -> String {
        let map = std::sync::Arc::clone(&self.map);
        let mut pieces = template.split("{}");
        let mut text = pieces.next().unwrap_or_default().to_owned();
        for (hole, piece) in (0..).zip(pieces) {
            let mut signals = map.signals.iter().map(|signal| signal.location);
            let at = signals.find(|at| at.table == table && at.address == 2 * hole);
            let kind = at.map_or(Kind::F32, |at| at.layout.kind);
            let cells =
                [2 * hole, 2 * hole + 1].map(|cell| self.register(table, cell).unwrap_or(0));
            let number = number_of(kind, u32::from(cells[0]) << 16 | u32::from(cells[1]));
            let number =
                if kind == Kind::F32 { format!("{number:.6}") } else { number.to_string() };
            text.extend([&number, piece]);
        }
        text
    }

    fn answer_vesc(&mut self, payload: &[u8], may_command: MayCommand<'_>) -> Option<Vec<u8>> {
        let (command, rest) = payload.split_first()?;
        let reply = match (*command, rest) {
            (50, [b3, b2, b1, b0]) => {
                let mask = u32::from_be_bytes([*b3, *b2, *b1, *b0]);
                let mut reply = payload.to_vec();
                for (bit, width) in
                    SELECTED.iter().enumerate().filter(|(bit, _)| mask >> bit & 1 == 1)
                {
                    reply.extend(self.bytes(CellTable::Fields(1 << bit), 0, *width));
                }
                reply
            }
            // The alive message keeps the last command.
            (30, _) => {
                self.kick(KickedBy::Command);
                return None;
            }
            (command, []) => {
                let table = CellTable::Reply(command);
                let reads = self.map.signals.iter().map(Signal::request);
                // As far as the profile reads it.
                let ends = reads.filter(|at| at.table == table).map(|at| at.address + at.count);
                [vec![command], self.bytes(table, 0, ends.max()?)].concat()
            }
            (command, value) => {
                if may_command() {
                    self.take_command(command, value);
                }
                return None;
            }
        };
        let crc = crc16(0x1021, &reply).to_be_bytes();
        let head = match count(&reply).to_be_bytes() {
            [0, short] => vec![2, short],
            [high, low] => vec![3, high, low],
        };
        Some([head, reply, crc.to_vec(), vec![3]].concat())
    }

    /// A command of a VESC replaces the one before it.
    fn take_command(&mut self, command: u8, value: &[u8]) {
        let map = std::sync::Arc::clone(&self.map);
        let mut points = map.set_points.iter();
        let Some(point) = points.find(|point| point.function == command) else { return };
        if self.ignored.as_ref() != Some(&point.name) {
            self.written.clear();
        }
        for (address, byte) in (point.location.address..).zip(value) {
            self.written(address, (*byte).into());
        }
        self.apply_write(point.location.address, point.location.layout.cells());
    }

    fn answer_dynamixel(&mut self, body: &[u8], may_command: MayCommand<'_>) -> Option<Vec<u8>> {
        let [id, instruction, parameters @ ..] = body else { return None };
        if *id != self.unit {
            return None;
        }
        self.kick(KickedBy::Any);
        let (error, data) = match (*instruction, parameters) {
            // Ping: model and firmware.
            (1, []) => (0, self.bytes(CellTable::Bytes, 0, 2)),
            (2, [a0, a1, n0, n1]) => {
                let (address, count) =
                    (u16::from_le_bytes([*a0, *a1]), u16::from_le_bytes([*n0, *n1]));
                (0, self.bytes(CellTable::Bytes, address, count))
            }
            (3, [a0, a1, data @ ..]) if may_command() => {
                (self.write_bytes(u16::from_le_bytes([*a0, *a1]), data), Vec::new())
            }
            // Result fail, and an instruction that it does not know.
            (3, _) => (1, Vec::new()),
            _ => (2, Vec::new()),
        };
        let mut body = vec![0x55, error];
        for byte in data {
            body.push(byte);
            if body.ends_with(&[0xFF, 0xFF, 0xFD]) {
                body.push(0xFD);
            }
        }
        let length = (count(&body) + 2).to_le_bytes();
        let packet = [&[0xFF, 0xFF, 0xFD, 0, *id][..], &length, &body].concat();
        Some([&packet[..], &crc16(0x8005, &packet).to_le_bytes()].concat())
    }

    /// Writes a control table; the error number.
    fn write_bytes(&mut self, address: u16, data: &[u8]) -> u8 {
        let is_lapsed = self.has_lost_host();
        if !(address..).take(data.len()).all(|address| self.is_writable(address)) {
            return 7;
        }
        let map = std::sync::Arc::clone(&self.map);
        let mut points = map.set_points.iter().filter(|point| point.location.address == address);
        // After its watchdog has stopped it, goals are refused until that is cleared.
        if is_lapsed && points.any(|point| point.keys.quantity.moves()) {
            return 4;
        }
        for (address, byte) in (address..).zip(data) {
            self.written(address, (*byte).into());
        }
        self.apply_write(address, count(data));
        0
    }

    /// So many bytes from there on; zeros where nothing is mapped.
    fn bytes(&mut self, table: CellTable, first: u16, count: u16) -> Vec<u8> {
        let addresses = first..first.saturating_add(count);
        let cells = addresses.map(|address| self.register(table, address).unwrap_or(0));
        cells.map(|cell| cell.to_le_bytes()[0]).collect()
    }
}

/// What stands in the one hole of a template, or nothing where it has none and is the line.
fn in_template<'a>(template: &str, line: &'a str) -> Option<&'a str> {
    match template.split_once("{}") {
        Some((before, behind)) => line.strip_prefix(before)?.strip_suffix(behind),
        None => (template == line).then_some(""),
    }
}

fn count(bytes: &[u8]) -> u16 {
    u16::try_from(bytes.len()).unwrap_or(u16::MAX)
}

#[cfg(test)]
mod tests {
    use super::super::Guise;
    use super::*;
    use crate::EmulatorConfig;
    use drivebench_link::DriveProfile;

    fn drive(profile: &str) -> ForeignDrive {
        let guise = Guise::of(&DriveProfile::named(profile).unwrap()).unwrap();
        ForeignDrive::new(&guise, &EmulatorConfig::embedded("zk-22fc-plain").unwrap(), 1)
    }

    fn bytes_of(text: &str) -> Vec<u8> {
        text.split(' ').map(|byte| u8::from_str_radix(byte, 16).unwrap()).collect()
    }

    fn answers(drive: &mut ForeignDrive, bytes: &[u8]) -> Vec<Vec<u8>> {
        let mut receiver = PacketReceiver::default();
        let protocol = drive.map.protocol;
        let bodies = bytes.iter().filter_map(|byte| receiver.push(protocol, *byte));
        let bodies: Vec<Vec<u8>> = bodies.collect();
        bodies.iter().filter_map(|body| drive.answer_packet(body, &mut || true)).collect()
    }

    /// The requests are those of the makers' libraries.
    #[test]
    fn a_vesc_answers_the_packets_of_its_makers_code() {
        let mut vesc = drive("vesc-dc");
        // Duty .1, twice: among garbage, and damaged.
        let duty = bytes_of("02 05 05 00 00 27 10 AE 17 03");
        let mut damaged = duty.clone();
        damaged[6] ^= 1;
        let values = bytes_of("02 05 32 04 39 81 E0 0C 2F 03");
        let answered = answers(&mut vesc, &[&[3, 2, 9][..], &duty, &damaged, &values].concat());
        assert_eq!(answered.len(), 1, "a duty has no answer");
        assert_eq!(answered[0][2..7], values[2..7], "the mask as it came");
        assert_eq!(answered[0].len(), 36);
        vesc.advance_to(1.0);
        assert!(vesc.speed_rad_s() > 20.0, "a tenth of 120 V turns it");
        // The alive message keeps the last command; silence stops it.
        answers(&mut vesc, &bytes_of("02 01 1E F3 FF 03"));
        vesc.advance_to(1.9);
        assert!(vesc.speed_rad_s() > 20.0);
        vesc.advance_to(4.0);
        assert!(vesc.speed_rad_s() < 1.0, "{}", vesc.speed_rad_s());
        let status = |answer: &[u8]| answer[answer.len() - 4];
        assert_eq!(status(&answers(&mut vesc, &values)[0]), 1, "the time-out shows");
        let current = bytes_of("02 05 06 00 00 00 00 CD 85 03");
        // It acts at once, and the drive looks at its clock every 10 ms.
        assert_eq!(status(&answers(&mut vesc, &[&current[..], &values].concat())[0]), 1);
        vesc.advance_to(4.011);
        assert_eq!(status(&answers(&mut vesc, &values)[0]), 0);
    }

    #[test]
    fn a_dynamixel_refuses_goals_until_its_watchdog_is_cleared() {
        let mut servo = drive("dynamixel-xm430");
        let mut error = |text: &str| answers(&mut servo, &bytes_of(text))[0][8];
        let torque_on = "FF FF FD 00 01 06 00 03 40 00 01 DB 66";
        for (request, expected) in [
            ("FF FF FD 00 01 03 00 01 19 4E", 0),
            ("FF FF FD 00 01 07 00 03 64 00 00 00 4B 8D", 0),
            ("FF FF FD 00 01 06 00 03 62 00 0A 4A E4", 0),
        ] {
            assert_eq!(error(request), expected, "{request}");
        }
        let write = |address: u8, value: u8| {
            let body = [&[0xFF, 0xFF, 0xFD, 0, 1, 6, 0, 3][..], &[address, 0, value]].concat();
            [&body[..], &crc16(0x8005, &body).to_le_bytes()].concat()
        };
        for (address, value) in [(64, 0), (98, 0), (11, 16), (98, 10), (64, 1)] {
            assert_eq!(answers(&mut servo, &write(address, value))[0][8], 0, "{address}");
        }
        assert_eq!(answers(&mut servo, &bytes_of(torque_on))[0][8], 0);
        servo.advance_to(1.0);
        let goal = bytes_of("FF FF FD 00 01 07 00 03 64 00 2C 01 4D 65");
        assert_eq!(answers(&mut servo, &goal)[0][8], 4);
        assert_eq!(servo.bytes(CellTable::Bytes, 98, 1), [255]);
        assert_eq!(answers(&mut servo, &write(98, 0))[0][8], 0);
        assert_eq!(answers(&mut servo, &goal)[0][8], 0);
        // Another id, and an address that is not there.
        assert!(answers(&mut servo, &bytes_of("FF FF FD 00 02 03 00 01 19 72")).is_empty());
        assert_eq!(answers(&mut servo, &write(200, 1))[0][8], 7);
    }
}
