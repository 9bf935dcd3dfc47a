//! Packets of Dynamixel protocol 2.0 (ROBOTIS e-Manual, protocol 2.0).
//!
//! ```text
//! FF FF FD 00 id length16 instruction parameters CRC-16     numbers: lowest byte first
//! FF FF FD 00 id length16 55 error parameters CRC-16        the status packet that answers
//! ```
//!
//! Behind each FF FF FD within instruction and parameters an FD is stuffed, which the length counts. A status carries nothing that
//! names its request but the id and its length.

use super::{Code, Expected, PROOF_WRITE, Search, Turn, crc16};
use crate::exchange::NoData;
use crate::unexpected::Unexpected;

const HEADER: [u8; 4] = [0xFF, 0xFF, 0xFD, 0];
const READ: u8 = 2;
const WRITE: u8 = 3;
const STATUS: u8 = 0x55;
/// Bytes around instruction and parameters: header, id, length, CRC.
const AROUND: usize = 9;
/// Bit of an error: a hardware alert is set. The data are valid nevertheless.
const ALERT: u8 = 0x80;

fn checksum(bytes: &[u8]) -> u16 {
    crc16(0x8005, bytes)
}

pub(super) fn packet(id: u8, body: &[u8]) -> Vec<u8> {
    let mut stuffed = Vec::with_capacity(body.len());
    for byte in body {
        stuffed.push(*byte);
        if stuffed.ends_with(&HEADER[..3]) {
            stuffed.push(0xFD);
        }
    }
    let length = u16::try_from(stuffed.len() + 2).unwrap_or(u16::MAX).to_le_bytes();
    let packet = [&HEADER[..], &[id], &length, &stuffed].concat();
    [&packet[..], &checksum(&packet).to_le_bytes()].concat()
}

/// Id and body of the packet at the start of these bytes, without what was stuffed, and its length with all around it.
fn body(bytes: &[u8]) -> Option<(u8, Vec<u8>, usize)> {
    let [id, low, high] = *bytes.strip_prefix(&HEADER)?.first_chunk()?;
    let end = 7 + usize::from(u16::from_le_bytes([low, high]));
    let (packet, crc) = bytes.get(..end)?.split_last_chunk::<2>()?;
    if checksum(packet) != u16::from_le_bytes(*crc) {
        return None;
    }
    let mut body = Vec::with_capacity(packet.len());
    let mut is_stuffed = false;
    for byte in packet.get(7..)? {
        if is_stuffed && *byte == 0xFD {
            is_stuffed = false;
            continue;
        }
        body.push(*byte);
        is_stuffed = body.ends_with(&HEADER[..3]);
    }
    Some((id, body, end))
}

fn byte_of(cell: u16) -> u8 {
    cell.to_be_bytes()[1]
}

pub(super) fn request(id: u8, turn: Turn<'_>) -> Vec<u8> {
    let body = match (turn.put, turn.read) {
        (Some(put), _) => {
            let head = std::iter::once(WRITE).chain(put.address.to_le_bytes());
            head.chain(put.cells.iter().map(|cell| byte_of(*cell))).collect()
        }
        (None, Some(read)) => {
            [&[READ][..], &[read.address.to_le_bytes(), read.count.to_le_bytes()].concat()].concat()
        }
        (None, None) => Vec::new(),
    };
    packet(id, &body)
}

/// Bytes of a turn on the line, and of its reply, without stuffing.
pub(super) fn bytes(turn: Turn<'_>) -> (usize, usize) {
    let read = turn.read.map_or(0, |read| usize::from(read.count));
    let written = turn.put.map_or(2, |put| put.cells.len());
    (AROUND + 3 + written, AROUND + 2 + read)
}

/// Error and parameters of a status.
fn status(body: &[u8]) -> Option<(u8, &[u8])> {
    match body {
        [STATUS, error, parameters @ ..] => Some((*error, parameters)),
        _ => None,
    }
}

/// A reply by the function codes of the proof of synchronisation: 3 for a read, 2 for a write.
pub(super) fn code_of(frame: &[u8]) -> Option<Code> {
    let (_, body, _) = body(frame)?;
    let (error, parameters) = status(&body)?;
    let function = if parameters.is_empty() { PROOF_WRITE } else { 3 };
    Some(match error & !ALERT {
        0 => Code { function, length: 2 + 2 * parameters.len() },
        _ => Code { function: function | 0x80, length: 2 },
    })
}

/// Bytes that the status to a request carries.
fn awaited(request: &[u8]) -> Option<(u8, usize)> {
    let (id, body, _) = body(request)?;
    match body.as_slice() {
        [READ, _, _, low, high] => Some((id, u16::from_le_bytes([*low, *high]).into())),
        [WRITE, ..] => Some((id, 0)),
        _ => None,
    }
}

pub(super) fn search(expected: &Expected, received: &[u8]) -> Search {
    let mut found = Search::default();
    let request = &expected.request;
    let awaits = awaited(request);
    let mut at = 0;
    // A bus of one wire returns what was sent.
    if !request.is_empty() && received.starts_with(request) {
        found.echo = true;
        at = request.len();
    }
    while at < received.len() {
        let Some((id, body, length)) = body(&received[at..]) else {
            at += 1;
            continue;
        };
        let answers = |awaits: Option<(u8, usize)>| {
            status(&body).zip(awaits).is_some_and(|((error, parameters), (of, count))| {
                let is_refusal = error & !ALERT != 0 && parameters.is_empty();
                of == id && (parameters.len() == count || is_refusal)
            })
        };
        if answers(awaits) {
            found.reply = Some((at, at + length));
            return found;
        }
        if expected.earlier.iter().any(|(request, _)| answers(awaited(request))) {
            found.old.extend(code_of(&received[at..]));
        } else {
            found.foreign(match awaits {
                Some((of, _)) if of != id => Unexpected::Unit(id),
                Some((_, expected)) => {
                    Unexpected::Length { found: body.len().saturating_sub(2), expected }
                }
                None => Unexpected::Frame,
            });
            let is_write = body.first() == Some(&WRITE);
            found.foreign_writes += usize::from(is_write && awaits.is_some_and(|(of, _)| of == id));
        }
        at += length;
    }
    found
}

/// Name of an error number (e-Manual, protocol 2.0, 4.4.2).
const fn error_name(error: u8) -> &'static str {
    match error {
        1 => "it could not carry it out",
        2 => "unknown instruction",
        3 => "check sum",
        4 => "value out of range, or stopped by its watchdog",
        5 => "data length",
        6 => "value beyond a limit",
        7 => "no access: torque is on, or the table is read-only",
        _ => "an error without a name",
    }
}

/// The cells of a reply, each a byte.
pub(super) fn cells(reply: &[u8], turn: Turn<'_>) -> Result<Vec<u16>, NoData> {
    let frame = body(reply);
    let (error, parameters) =
        frame.as_ref().and_then(|(_, body, _)| status(body)).unwrap_or_default();
    match error & !ALERT {
        0 => {}
        error => return Err(NoData::Refused { code: ALERT | error, name: error_name(error) }),
    }
    debug_assert_eq!(parameters.len(), turn.read.map_or(0, |read| read.count.into()));
    Ok(parameters.iter().skip(turn.skipped.into()).map(|byte| u16::from(*byte)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cell_bus::{CellTable, Put, ReadRequest};

    fn bytes_of(text: &str) -> Vec<u8> {
        text.split(' ').map(|byte| u8::from_str_radix(byte, 16).unwrap()).collect()
    }

    const fn read(address: u16, count: u16) -> Turn<'static> {
        Turn::read(ReadRequest { table: CellTable::Bytes, address, count })
    }

    const fn write(address: u16, cells: &[u16]) -> Turn<'_> {
        Turn::write(Put { function: PROOF_WRITE, address, cells })
    }

    /// Vectors of the maker's host library (`DynamixelSDK` 4.1).
    #[test]
    fn every_packet_is_that_of_the_makers_library() {
        for (turn, packet_bytes) in [
            (write(11, &[16]), "FF FF FD 00 01 06 00 03 0B 00 10 21 63"),
            (write(100, &[0, 0]), "FF FF FD 00 01 07 00 03 64 00 00 00 4B 8D"),
            (write(100, &[0x2C, 1]), "FF FF FD 00 01 07 00 03 64 00 2C 01 4D 65"),
            (write(98, &[10]), "FF FF FD 00 01 06 00 03 62 00 0A 4A E4"),
            (write(64, &[1]), "FF FF FD 00 01 06 00 03 40 00 01 DB 66"),
            (read(120, 27), "FF FF FD 00 01 07 00 02 78 00 1B 00 36 E7"),
            (read(100, 2), "FF FF FD 00 01 07 00 02 64 00 02 00 33 81"),
            (write(64, &[0]), "FF FF FD 00 01 06 00 03 40 00 00 DE E6"),
            (write(100, &[0x8B, 0xFC]), "FF FF FD 00 01 07 00 03 64 00 8B FC 49 B5"),
            (read(38, 2), "FF FF FD 00 01 07 00 02 26 00 02 00 2D A9"),
            (read(44, 4), "FF FF FD 00 01 07 00 02 2C 00 04 00 2D 35"),
            (read(98, 4), "FF FF FD 00 01 07 00 02 62 00 04 00 33 ED"),
            (read(33, 113), "FF FF FD 00 01 07 00 02 21 00 71 00 28 6F"),
        ] {
            assert_eq!(request(1, turn), bytes_of(packet_bytes));
            assert_eq!(bytes(turn).0, request(1, turn).len());
        }
        let stuffed = "FF FF FD 00 01 0A 00 03 74 00 FF FF FD FD 00 21 E7";
        assert_eq!(request(1, write(116, &[0xFF, 0xFF, 0xFD, 0])), bytes_of(stuffed));
        for (id, instruction, packet_bytes) in [
            (1, 1, "FF FF FD 00 01 03 00 01 19 4E"),
            (7, 1, "FF FF FD 00 07 03 00 01 19 36"),
            (1, 8, "FF FF FD 00 01 03 00 08 2F 4E"),
        ] {
            assert_eq!(packet(id, &[instruction]), bytes_of(packet_bytes));
        }
    }

    #[test]
    fn what_is_stuffed_is_taken_out_again() {
        let odd = [STATUS, 0, 0xFF, 0xFF, 0xFD, 0xFD, 0xFF, 0xFF, 0xFD, 0];
        let bytes = packet(7, &odd);
        assert_eq!(bytes.len(), AROUND + odd.len() + 2);
        let (id, found, length) = body(&bytes).unwrap();
        assert_eq!((id, found.as_slice(), length), (7, &odd[..], bytes.len()));
    }

    #[test]
    fn only_a_status_of_the_right_id_and_length_is_taken() {
        let mut expected = Expected { request: request(1, read(100, 2)), ..Expected::default() };
        expected.earlier.push_back((request(1, read(120, 27)), false));
        let status =
            |id, error, parameters: &[u8]| packet(id, &[&[STATUS, error][..], parameters].concat());
        let right = status(1, 0, &[7, 0]);
        let mut damaged = right.clone();
        damaged[9] ^= 1;
        for (received, reply, old, foreign) in [
            (right.clone(), Some((0, 13)), 0, 0),
            (status(1, ALERT, &[7, 0]), Some((0, 13)), 0, 0),
            (status(1, 7, &[]), Some((0, 11)), 0, 0),
            (status(1, 0, &[0; 27]), None, 1, 0),
            (status(1, 0, &[0; 5]), None, 0, 1),
            (status(2, 0, &[7, 0]), None, 0, 1),
            ([status(1, 0, &[0; 27]), right.clone()].concat(), Some((38, 51)), 1, 0),
            ([expected.request.clone(), right.clone()].concat(), Some((14, 27)), 0, 0),
            (request(1, write(64, &[1])), None, 0, 1),
            (damaged, None, 0, 0),
            (right[..12].to_vec(), None, 0, 0),
        ] {
            let found = search(&expected, &received);
            let counts = (found.reply, found.old.len(), found.foreign);
            assert_eq!(counts, (reply, old, foreign), "{received:02x?}");
        }
        assert!(matches!(cells(&right, read(100, 2)), Ok(cells) if cells == [7, 0]));
        let refused = cells(&status(1, 7, &[]), write(11, &[16]));
        assert!(matches!(refused, Err(NoData::Refused { code: 0x87, .. })));
    }
}
