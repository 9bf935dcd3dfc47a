//! Replies of Modbus, RTU and TCP.
//!
//! A reply is taken only if unit, function, length, echoed fields and check sum (or transaction) all fit the request: RTU has no
//! transaction number, and common clients take a late reply for the next one.

use firmware_protocol::modbus::{
    Length, expected_response_len, request_len, response_len, rtu, tcp,
};

use super::{Code, Expected, FrameKind, Search, Turn, Unframeable};
use crate::unexpected::Unexpected;

impl Expected {
    /// Whether a frame may be the late reply to an earlier request that got none.
    pub(crate) fn may_be_late(&self, frame: &[u8]) -> bool {
        let response = unit_and_pdu(frame).map(|(_, response)| response).unwrap_or_default();
        self.earlier.iter().filter(|(_, is_answered)| !is_answered).any(|(request, _)| {
            unit_and_pdu(request).is_some_and(|(_, pdu)| answers(pdu, response))
        })
    }

    fn is_met_by(&self, pdu: &[u8], response: &[u8]) -> bool {
        let refused = response.first().is_some_and(|code| code & 0x80 != 0);
        answers(pdu, response)
            && (refused
                || self
                    .echo
                    .is_none_or(|echo| response.get(echo.at..echo.at + 2) == Some(&echo.bytes)))
    }
}

/// RTU frames of a read of so many registers and of its reply, bytes.
pub(crate) const fn read_bytes(count: usize) -> (usize, usize) {
    (8, 5 + 2 * count)
}

/// The same of a write of several registers, and of one with function code 6.
pub(crate) const fn write_bytes(function: u8, count: usize) -> (usize, usize) {
    (if function == 6 { 8 } else { 9 + 2 * count }, 8)
}

/// The same of function code 23.
pub(crate) const fn read_write_bytes(written: usize, read: usize) -> (usize, usize) {
    (13 + 2 * written, 5 + 2 * read)
}

pub(super) fn bytes(turn: Turn<'_>) -> (usize, usize) {
    let read = turn.read.map(|read| usize::from(read.count));
    match (turn.put, read) {
        (None, read) => read_bytes(read.unwrap_or_default()),
        (Some(put), None) => write_bytes(put.function, put.cells.len()),
        (Some(put), Some(read)) => read_write_bytes(put.cells.len(), read),
    }
}

pub(super) fn code_of(kind: FrameKind, frame: &[u8]) -> Option<Code> {
    let (before, behind) = match kind {
        FrameKind::Tcp => (tcp::HEADER, 0),
        _ => (1, 2),
    };
    Some(Code { function: *frame.get(before)?, length: frame.len().checked_sub(before + behind)? })
}

/// Whether bytes that are no frame of Modbus TCP begin with one of RTU.
pub(crate) fn begins_with_rtu(received: &[u8]) -> bool {
    rtu_frame_len(received, response_len).is_some()
}

pub(super) fn search_rtu(expected: &Expected, received: &[u8]) -> Search {
    let mut found = Search::default();
    let request = &expected.request;
    let (unit, pdu) = unit_and_pdu(request).unwrap_or_default();
    let request_sent = match expected.earlier.back() {
        Some((last, _)) if request.is_empty() => last,
        _ => request,
    };
    // The reply to these equals the request: without knowing the line a copy cannot be called an echo.
    let reply_is_copy = matches!(pdu.first(), Some(5 | 6 | 8));
    let mut at = 0;
    if !request.is_empty() {
        if received.starts_with(request) && (expected.echoes || !reply_is_copy) {
            found.echo = true;
            at = request.len();
        } else if expected.echoes && request.starts_with(received) {
            return found;
        }
    }
    while at < received.len() {
        let tail = &received[at..];
        let Some(length) = rtu_frame_len(tail, response_len) else {
            // Only another master sends these; our own came back as an echo.
            let request = rtu_frame_len(tail, request_len);
            let own = !request_sent.is_empty() && tail.starts_with(request_sent);
            if request.is_some() && !own {
                found.foreign(Unexpected::Frame);
                found.foreign_writes += usize::from(writes_to(request_sent, tail));
            }
            at += request.unwrap_or(1);
            continue;
        };
        let response = &tail[1..length - 2];
        // Registers that are read often hold such frames by chance: all ones before zeros fit the check sum.
        // Addresses of units end here; those above are reserved (MODBUS over Serial Line V1.02, 2.2).
        if tail[0] != unit && (tail[0] > 247 || matches!(response, [0x80..=0xFF, 0])) {
            at += 1;
            continue;
        }
        if tail[0] == unit && expected.is_met_by(pdu, response) {
            found.reply = Some((at, at + length));
            return found;
        }
        let is_old = |request: &Vec<u8>| {
            unit_and_pdu(request)
                .is_some_and(|(unit, pdu)| tail[0] == unit && answers(pdu, response))
        };
        if is_old(request) || expected.earlier.iter().any(|(request, _)| is_old(request)) {
            found.old.extend(Code::of(FrameKind::Rtu, &tail[..length]));
        } else {
            found.foreign(match tail[0] {
                other if other != unit => Unexpected::Unit(other),
                _ => difference(pdu, response),
            });
            // The drive's own answer to such a request, with a length that does not fit, is no other master's.
            let is_misfit = pdu.first() == Some(&23) && response.first() == Some(&23);
            found.foreign_writes += usize::from(!is_misfit && writes_to(request_sent, tail));
        }
        at += length;
    }
    found
}

/// Whether this frame, which is not ours, writes to the unit of a request, or acknowledges such a write.
fn writes_to(request: &[u8], frame: &[u8]) -> bool {
    matches!(frame, [unit, 5 | 6 | 15 | 16 | 22 | 23, ..] if request.first() == Some(unit))
}

/// How a response of the right unit differs from that to a request.
fn difference(request: &[u8], response: &[u8]) -> Unexpected {
    match (request.first(), response, expected_response_len(request)) {
        (Some(requested @ (3 | 4 | 23)), [answered, data @ ..], Some(length))
            if requested == answered && response.len() != length =>
        {
            Unexpected::Length { found: data.len().saturating_sub(1), expected: length - 2 }
        }
        _ => Unexpected::Frame,
    }
}

fn unit_and_pdu(frame: &[u8]) -> Option<(u8, &[u8])> {
    let end = frame.len().checked_sub(2)?;
    let (&unit, pdu) = frame[..end].split_first()?;
    Some((unit, pdu))
}

/// Length of a whole frame at the start of `bytes`, if there is one with a right checksum.
pub(crate) fn rtu_frame_len(bytes: &[u8], pdu_len: impl Fn(&[u8]) -> Length) -> Option<usize> {
    let Length::Known(pdu) = pdu_len(bytes.get(1..)?) else { return None };
    let (body, rest) = bytes.split_at_checked(pdu + 1)?;
    let crc = rest.first_chunk::<2>()?;
    (pdu + 3 <= rtu::MAX_FRAME && rtu::crc16(body) == u16::from_le_bytes(*crc)).then_some(pdu + 3)
}

/// Whether a response PDU is one to this request PDU.
fn answers(request: &[u8], response: &[u8]) -> bool {
    let (Some(&requested), Some(&answered)) = (request.first(), response.first()) else {
        return false;
    };
    if answered == requested | 0x80 {
        return response.len() == 2;
    }
    let echoed = match requested {
        5 | 6 | 8 => request.len(),
        15 | 16 => 5,
        22 => 7,
        43 => 3,
        _ => 1,
    };
    expected_response_len(request).is_none_or(|length| length == response.len())
        && response.get(..echoed) == request.get(..echoed)
}

pub(super) fn search_tcp(expected: &Expected, received: &[u8]) -> Result<Search, Unframeable> {
    let mut found = Search::default();
    let request = &expected.request;
    let pdu = request.get(tcp::HEADER..).unwrap_or_default();
    let mut at = 0;
    while let Some(tail) = received.get(at..)
        && let Some(header) = tail.first_chunk::<{ tcp::HEADER }>()
    {
        let [_, _, p1, p0, l1, l0, _] = *header;
        let length = usize::from(u16::from_be_bytes([l1, l0]));
        if (p1, p0) != (0, 0) || !(2..=tcp::MAX_FRAME - 6).contains(&length) {
            return Err(Unframeable);
        }
        let Some(frame) = tail.get(..length + 6) else { break };
        let response = &frame[tcp::HEADER..];
        let is_of = |request: &[u8]| request.get(..2) == frame.get(..2);
        let is_unit = request.get(6) == frame.get(6);
        if is_of(request) && is_unit && expected.is_met_by(pdu, response) {
            found.reply = Some((at, at + length + 6));
            return Ok(found);
        }
        let number = |frame: &[u8]| frame.first_chunk().map_or(0, |two| u16::from_be_bytes(*two));
        let other_number =
            || Unexpected::Transaction { found: number(frame), expected: number(request) };
        // The transaction number identifies the request.
        let old = expected.earlier.iter().find(|(request, _)| is_of(request));
        if let Some((_, was_answered)) = old {
            found.old.extend(Code::of(FrameKind::Tcp, frame));
            // No late reply: a server with a number of its own.
            if *was_answered && answers(pdu, response) {
                found.differs(other_number());
            }
        } else if is_of(request) && is_unit && answers(pdu, response) {
            found.old.extend(Code::of(FrameKind::Tcp, frame));
        } else if !is_of(request) && answers(pdu, response) {
            found.foreign(other_number());
        } else if !is_unit && !request.is_empty() {
            found.foreign(Unexpected::Unit(frame[6]));
        } else {
            found.foreign(difference(pdu, response));
        }
        at += length + 6;
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::framing::{EARLIER, Echo, search};
    use crate::scripted::frame;

    fn expecting(request: &[u8], echoes: bool) -> Expected {
        Expected { request: request.to_vec(), echoes, ..Expected::default() }
    }

    fn rtu(request: &[u8], received: &[&[u8]], echoes: bool) -> Search {
        search_rtu(&expecting(request, echoes), &received.concat())
    }

    #[test]
    fn a_foreign_write_to_our_unit_is_another_master() {
        let own = frame(1, &[6, 0, 201, 2, 38]);
        let mut expected = expecting(&frame(1, &[3, 0, 100, 0, 1]), false);
        expected.earlier.push_back((own.clone(), true));
        let many = frame(1, &[16, 0, 201, 0, 1, 2, 0, 0]);
        let acknowledged = frame(1, &[16, 0, 201, 0, 1]);
        for (what, bytes, writes) in [
            ("our own acknowledgement, late", own, 0),
            ("another drive", frame(7, &[6, 0, 201, 0, 0]), 0),
            ("no write", frame(1, &[4, 2, 0, 0]), 0),
            ("one write", frame(1, &[6, 0, 201, 0, 0]), 1),
            ("both ends", [many, acknowledged].concat(), 2),
        ] {
            assert_eq!(search_rtu(&expected, &bytes).foreign_writes, writes, "{what}");
        }
        // Registers that hold a right check sum by chance, and the drive's own reply of another length.
        let command = frame(1, &[23, 0, 0, 0, 2, 0, 32, 0, 1, 2, 0, 7]);
        let chance = rtu(&command, &[&[0xFF, 0xFF, 0, 0, 0]], false);
        assert_eq!((chance.reply, chance.foreign), (None, 0));
        let misfit = rtu(&command, &[&frame(1, &[23, 6, 1, 2, 3, 4, 5, 6])], false);
        assert_eq!((misfit.reply, misfit.foreign, misfit.foreign_writes), (None, 1, 0));
    }

    #[test]
    fn the_number_of_a_command_must_come_back() {
        let request = frame(1, &[23, 0, 0, 0, 2, 0, 32, 0, 1, 2, 0, 7]);
        let reply = |number: u8| frame(1, &[23, 4, 9, 9, 0, number]);
        let mut expected = expecting(&request, false);
        let (at, bytes) = (4, [0, 7]);
        expected.echo = Some(Echo { at, bytes });
        let look = |expected: &Expected, bytes: &[u8]| {
            let found = search_rtu(expected, bytes);
            (found.reply, found.old.len(), found.foreign)
        };
        let late = [reply(6), reply(7)].concat();
        for (bytes, found) in [
            (reply(7), (Some((0, 9)), 0, 0)),
            (reply(6), (None, 1, 0)),
            (late, (Some((9, 18)), 1, 0)),
            (frame(1, &[0x97, 6]), (Some((0, 5)), 0, 0)),
        ] {
            assert_eq!(look(&expected, &bytes), found, "{bytes:?}");
        }
        // After it is over its answer, and that of the one before, are old; another function is foreign.
        expected.retire(true);
        expected.request = frame(1, &[8, 0, 0, 1, 2]);
        assert_eq!(look(&expected, &reply(7)), (None, 1, 0));
        assert_eq!(look(&expected, &frame(1, &[4, 2, 0, 0])), (None, 0, 1));
        for _ in 0..100 {
            expected.request = request.clone();
            expected.retire(true);
        }
        assert_eq!(expected.earlier.len(), EARLIER);
    }

    #[test]
    fn only_the_reply_to_this_request_is_taken() {
        let request = frame(1, &[3, 0, 0, 0, 2]);
        let reply = frame(1, &[3, 4, 1, 2, 3, 4]);
        let alone = rtu(&request, &[&reply], false);
        assert_eq!((alone.reply, alone.foreign, alone.echo), (Some((0, 9)), 0, false));
        for other in [
            frame(2, &[3, 4, 1, 2, 3, 4]),
            frame(1, &[4, 4, 1, 2, 3, 4]),
            frame(1, &[3, 6, 1, 2, 3, 4, 5, 6]),
            frame(1, &[0x84, 2]),
            frame(1, &[6, 0, 0, 0, 2]),
        ] {
            let search = rtu(&request, &[&other], false);
            assert_eq!((search.reply, search.foreign + search.old.len()), (None, 1), "{other:?}");
            let search = rtu(&request, &[&other, &reply], false);
            assert_eq!(search.reply, Some((other.len(), other.len() + 9)));
        }
        let mut damaged = reply.clone();
        damaged[4] ^= 1;
        for nothing in [&damaged[..], &reply[..8]] {
            assert_eq!(rtu(&request, &[nothing], false), Search::default());
        }
        assert_eq!(rtu(&request, &[&[1, 3, 4], &reply], false).reply, Some((3, 12)));
        let echoed = rtu(&request, &[&request, &reply], false);
        assert_eq!((echoed.echo, echoed.reply), (true, Some((8, 17))));
        // Refusals, probes and writes are compared whole.
        let (read, probe) = ([3, 0, 0, 0, 2], [8, 0, 0, 0x12, 0x34]);
        let write = [16, 0, 32, 0, 1, 2, 0, 5];
        for (request, reply, is_taken) in [
            (&read[..], &[0x83, 2][..], true),
            (&probe, &probe, true),
            (&probe, &[8, 0, 0, 0x12, 0x35], false),
            (&write, &[16, 0, 32, 0, 1], true),
            (&write, &[16, 0, 33, 0, 1], false),
        ] {
            let found = rtu(&frame(1, request), &[&frame(1, reply)], false);
            assert_eq!(found.reply.is_some(), is_taken, "{request:?} {reply:?}");
        }
        let probe = frame(1, &probe);
        assert_eq!(rtu(&probe, &[&probe], true).reply, None);
        assert_eq!(rtu(&probe, &[&probe, &probe], true).reply, Some((8, 16)));
    }

    #[test]
    fn tcp_skips_old_transactions_and_gives_up_on_another_protocol() {
        let adu = |transaction, pdu: &[u8]| tcp::encode_frame(transaction, 1, pdu).to_vec();
        let (old, reply) = (adu(6, &[3, 2, 0, 1]), adu(7, &[3, 2, 0, 2]));
        let both = [old.clone(), reply].concat();
        let expected = expecting(&adu(7, &[3, 0, 0, 0, 1]), false);
        let found = search_tcp(&expected, &both).unwrap();
        assert_eq!(found.reply, Some((old.len(), both.len())));
        assert_eq!(found.foreign, 1);
        assert_eq!(search_tcp(&expected, b"HTTP/1.1 400"), Err(Unframeable));
    }

    proptest! {
        #[test]
        fn any_bytes_are_looked_through_without_harm(
            bytes in proptest::collection::vec(any::<u8>(), 0..600),
            echoes in any::<bool>(),
        ) {
            let expected = expecting(&frame(1, &[3, 0, 0, 0, 2]), echoes);
            for kind in [FrameKind::Rtu, FrameKind::Tcp] {
                if let Ok(Search { reply: Some((begin, end)), .. }) = search(kind, &expected, &bytes) {
                    prop_assert!(begin < end && end <= bytes.len());
                }
            }
        }
    }
}
