//! Packets of a VESC (vedderb/bldc, comm/packet.c and comm/commands.c).
//!
//! ```text
//! 02 length8 | 03 length16, payload, CRC-16 of the payload, 03      numbers: highest byte first
//! request:  [command, value]  50, mask      two packets in one piece: commands have no reply
//! reply:                      50, mask, the values that the mask selects, in the order of its bits
//! ```
//!
//! The drive repeats the mask as it came. Its upper bits select nothing, so they carry the number of the request; and because it
//! takes packets in order, the reply proves that the command before it has arrived.

use super::{Code, Expected, Search, Turn, crc16};
use crate::cell_bus::{CellTable, ReadRequest};
use crate::exchange::NoData;
use crate::unexpected::Unexpected;

/// Command of the selected values.
const SELECTIVE: u8 = 50;
/// Bytes of each selected value, by the bit of its mask (commands.c, `COMM_GET_VALUES_SELECTIVE`).
const WIDTHS: [u8; 22] = [2, 2, 4, 4, 4, 4, 2, 4, 2, 4, 4, 4, 4, 4, 4, 1, 4, 1, 6, 4, 4, 1];
/// Read behind a command that needs no value, one byte: the fault code.
const LEAST: u32 = 1 << 15;
/// The upper eight bits of the mask carry the number of the request; no firmware from 4.02 to 7.01 gives them a meaning. They come
/// round after 256 requests, half a second at 500 Hz, when no late reply is expected any more.
const NUMBER_SHIFT: u32 = 24;
/// Bytes of a packet around a payload of up to 255 bytes; so many are also command and mask in front of the selected values.
const AROUND: usize = 5;

/// CRC-16 of XMODEM.
fn checksum(bytes: &[u8]) -> u16 {
    crc16(0x1021, bytes)
}

/// A packet around a payload of up to 512 bytes.
pub(super) fn packet(payload: &[u8]) -> Vec<u8> {
    let length = u16::try_from(payload.len()).unwrap_or(u16::MAX).to_be_bytes();
    let head: &[u8] = match length {
        [0, short] => &[2, short],
        [high, low] => &[3, high, low],
    };
    [head, payload, &checksum(payload).to_be_bytes(), &[3]].concat()
}

/// The payload of the packet at the start of these bytes, and its length with all around it; `None` where none begins here, or it
/// has not come to its end.
fn payload(bytes: &[u8]) -> Option<(&[u8], usize)> {
    let (begin, length) = match bytes {
        [2, length, ..] => (2, usize::from(*length)),
        [3, high, low, ..] => (3, usize::from(u16::from_be_bytes([*high, *low]))),
        _ => return None,
    };
    let payload = bytes.get(begin..begin + length).filter(|payload| !payload.is_empty())?;
    let [high, low, end] = *bytes.get(begin + length..)?.first_chunk()?;
    let is_whole = end == 3 && u16::from_be_bytes([high, low]) == checksum(payload);
    is_whole.then_some((payload, begin + length + 3))
}

/// Bytes of the values that a mask selects.
pub(crate) fn width(mask: u32) -> u16 {
    let selected = WIDTHS.iter().enumerate().filter(|(bit, _)| mask >> bit & 1 == 1);
    selected.map(|(_, width)| u16::from(*width)).sum()
}

/// What a turn reads: a mask, or the reply to a command.
const fn wanted(read: Option<ReadRequest>) -> (Option<u8>, u32) {
    match read {
        Some(ReadRequest { table: CellTable::Fields(mask), .. }) => (None, mask),
        Some(ReadRequest { table: CellTable::Reply(command), .. }) => (Some(command), LEAST),
        _ => (None, LEAST),
    }
}

pub(super) fn request(turn: Turn<'_>, number: u32) -> Vec<u8> {
    let (command, mask) = wanted(turn.read);
    let put = turn.put.map(|put| {
        let value = put.cells.iter().map(|cell| cell.to_be_bytes()[1]);
        std::iter::once(put.function).chain(value).collect::<Vec<u8>>()
    });
    let [b3, b2, b1, b0] = (mask | number << NUMBER_SHIFT).to_be_bytes();
    let parts = put.into_iter().chain(command.map(|command| vec![command]));
    parts.chain([vec![SELECTIVE, b3, b2, b1, b0]]).flat_map(|payload| packet(&payload)).collect()
}

pub(super) fn bytes(turn: Turn<'_>) -> (usize, usize) {
    let (command, mask) = wanted(turn.read);
    let values = 2 * AROUND + usize::from(width(mask));
    // The reply to a command carries the command itself, and up to the last byte that is wanted.
    let reply = match (command, turn.read) {
        (Some(_), Some(read)) => AROUND + 2 + usize::from(read.address + read.count),
        _ => 0,
    };
    (request(turn, 0).len(), values + reply)
}

/// Command and mask of a request, by its packets.
fn parts_of(request: &[u8]) -> (Option<u8>, Option<[u8; AROUND]>) {
    let (mut command, mut mask, mut at) = (None, None, 0);
    while let Some((payload, length)) = request.get(at..).and_then(payload) {
        match payload {
            [command_only] => command = Some(*command_only),
            [SELECTIVE, ..] => mask = payload.first_chunk().copied(),
            _ => {}
        }
        at += length;
    }
    (command, mask)
}

pub(super) fn code_of(frame: &[u8]) -> Option<Code> {
    let (payload, _) = payload(frame)?;
    Some(Code { function: *payload.first()?, length: payload.len() })
}

pub(super) fn search(expected: &Expected, received: &[u8]) -> Search {
    let mut found = Search::default();
    let (command, mask) = parts_of(&expected.request);
    let values = mask.map(|[_, mask @ ..]| AROUND + usize::from(width(u32::from_be_bytes(mask))));
    let mut began = None;
    let mut at = 0;
    while at < received.len() {
        let Some((payload, length)) = payload(&received[at..]) else {
            at += 1;
            continue;
        };
        let is_ours = mask.is_some_and(|mask| payload.starts_with(&mask));
        if command.is_some() && payload.first().copied() == command {
            began = Some(at);
        } else if is_ours && Some(payload.len()) == values && (command.is_none() || began.is_some())
        {
            found.reply = Some((began.unwrap_or(at), at + length));
            return found;
        } else if payload[0] == SELECTIVE {
            let is_old = |(request, _): &(Vec<u8>, bool)| {
                let (_, mask) = parts_of(request);
                mask.is_some_and(|mask| payload.starts_with(&mask))
            };
            match code_of(&received[at..]).filter(|_| expected.earlier.iter().any(is_old)) {
                Some(code) => found.old.push(code),
                None => found.foreign(Unexpected::Frame),
            }
        } else {
            found.foreign(Unexpected::Frame);
        }
        at += length;
    }
    found
}

/// The cells of a reply, each a byte.
pub(super) fn cells(reply: &[u8], turn: Turn<'_>) -> Result<Vec<u16>, NoData> {
    let Some(read) = turn.read else { return Ok(Vec::new()) };
    let first = payload(reply).map(|(payload, _)| payload).unwrap_or_default();
    let (begin, end) = match read.table {
        CellTable::Reply(_) => (1 + read.address, 1 + read.address + read.count),
        _ => (5, 5 + read.count),
    };
    let bytes = first.get(begin.into()..end.into()).ok_or_else(|| {
        NoData::Mismatch(format!("{} has {} bytes, {end} are needed", read.text(), first.len()))
    })?;
    Ok(bytes.iter().map(|byte| u16::from(*byte)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cell_bus::Put;
    use crate::framing::FrameKind;

    fn bytes_of(text: &str) -> Vec<u8> {
        text.split(' ').map(|byte| u8::from_str_radix(byte, 16).unwrap()).collect()
    }

    const fn values(mask: u32) -> ReadRequest {
        ReadRequest { table: CellTable::Fields(mask), address: 0, count: 0 }
    }

    /// Vectors of the firmware's own packet.c, which another host library (`PyVESC`) encodes to the same bytes.
    #[test]
    fn every_packet_is_that_of_the_makers_code() {
        for (payload, packet_bytes) in [
            ("00", "02 01 00 00 00 03"),
            ("04", "02 01 04 40 84 03"),
            ("05 00 00 27 10", "02 05 05 00 00 27 10 AE 17 03"),
            ("05 FF FF 9E 58", "02 05 05 FF FF 9E 58 47 8E 03"),
            ("05 00 00 00 00", "02 05 05 00 00 00 00 23 57 03"),
            ("06 00 00 00 00", "02 05 06 00 00 00 00 CD 85 03"),
            ("06 00 00 05 DC", "02 05 06 00 00 05 DC 38 81 03"),
            ("07 00 00 0B B8", "02 05 07 00 00 0B B8 9D FD 03"),
            ("08 00 00 0B B8", "02 05 08 00 00 0B B8 F8 04 03"),
            ("54 00 00 27 10", "02 05 54 00 00 27 10 11 74 03"),
            ("1D", "02 01 1D C3 9C 03"),
            ("0E", "02 01 0E E1 CE 03"),
            ("11", "02 01 11 02 10 03"),
            ("5B", "02 01 5B EB 9E 03"),
            ("32 04 39 81 E0", "02 05 32 04 39 81 E0 0C 2F 03"),
            ("32 08 21 81 C4", "02 05 32 08 21 81 C4 CD 39 03"),
        ] {
            assert_eq!(packet(&bytes_of(payload)), bytes_of(packet_bytes), "{payload}");
        }
        // The short form ends at 255 bytes.
        let heads = (packet(&[0; 255])[..2].to_vec(), packet(&[0; 256])[..3].to_vec());
        assert_eq!(heads, (vec![2, 255], vec![3, 1, 0]));
        assert_eq!(checksum(b"123456789"), 0x31C3);
    }

    #[test]
    fn a_turn_is_a_command_and_its_selected_values() {
        let duty = Put { function: 5, address: 0, cells: &[0, 0, 0x27, 0x10] };
        let both = Turn { put: Some(duty), read: Some(values(0x0039_81E0)), skipped: 0 };
        let expected =
            [bytes_of("02 05 05 00 00 27 10 AE 17 03"), bytes_of("02 05 32 04 39 81 E0 0C 2F 03")];
        assert_eq!(request(both, 4), expected.concat());
        assert_eq!(bytes(both).0, 20);
        // Bits 5 to 8, 15, 16, 19 to 21.
        assert_eq!(bytes(both).1, 10 + 4 + 2 + 4 + 2 + 1 + 4 + 4 + 4 + 1);
        let config = ReadRequest { table: CellTable::Reply(14), address: 157, count: 4 };
        assert_eq!(request(Turn::read(config), 0)[..6], bytes_of("02 01 0E E1 CE 03"));
    }

    #[test]
    fn only_the_reply_with_the_number_of_its_request_is_taken() {
        let turn = Turn::read(values(1 << 8 | 1 << 15));
        let reply = |number: u32| {
            let mask = (1 << 8 | 1 << 15 | number << NUMBER_SHIFT).to_be_bytes();
            packet(&[&[SELECTIVE][..], &mask, &[0, 240, 0]].concat())
        };
        let mut expected = Expected { request: request(turn, 7), ..Expected::default() };
        expected.earlier.push_back((request(turn, 6), false));
        let look = |bytes: &[u8]| {
            let found = super::super::search(FrameKind::Vesc, &expected, bytes).unwrap();
            (found.reply, found.old.len(), found.foreign)
        };
        let mut damaged = reply(7);
        damaged[8] ^= 4;
        let text = packet(b"\x15a text that nothing requests");
        for (received, found) in [
            (reply(7), (Some((0, 13)), 0, 0)),
            (reply(6), (None, 1, 0)),
            ([reply(6), reply(7)].concat(), (Some((13, 26)), 1, 0)),
            (reply(5), (None, 0, 1)),
            (damaged, (None, 0, 0)),
            (reply(7)[..12].to_vec(), (None, 0, 0)),
            ([&[2, 3, 2][..], &reply(7)].concat(), (Some((3, 16)), 0, 0)),
            ([text, reply(7)].concat(), (Some((34, 47)), 0, 1)),
        ] {
            assert_eq!(look(&received), found, "{received:02x?}");
        }
        let turn = Turn::read(ReadRequest { count: 3, ..values(1 << 8 | 1 << 15) });
        assert!(matches!(cells(&reply(7), turn), Ok(cells) if cells == [0, 240, 0]));
    }

    #[test]
    fn the_reply_to_a_command_counts_where_the_numbered_one_follows() {
        let turn = Turn::read(ReadRequest { table: CellTable::Reply(14), address: 2, count: 2 });
        let expected = Expected { request: request(turn, 3), ..Expected::default() };
        let config = packet(&[&[14][..], &[9, 8, 7, 6, 5]].concat());
        let mask = (LEAST | 3 << NUMBER_SHIFT).to_be_bytes();
        let numbered = packet(&[&[SELECTIVE][..], &mask, &[0]].concat());
        let both = [config.clone(), numbered.clone()].concat();
        assert_eq!(search(&expected, &both).reply, Some((0, both.len())));
        assert_eq!(search(&expected, &numbered).reply, None);
        assert_eq!(search(&expected, &config).reply, None);
        assert!(matches!(cells(&both, turn), Ok(cells) if cells == [7, 6]));
        assert!(cells(&packet(&[14, 9]), turn).is_err());
    }
}
