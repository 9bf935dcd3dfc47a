//! Slave codec: examples of the Modbus specification, every exception, framing.

use firmware_protocol::modbus::tcp::TcpError;
use firmware_protocol::modbus::{
    Exception, Length, MAX_PDU, RegisterBank, RtuReceiver, TcpReceiver, expected_response_len,
    request_len, response_len, rtu,
};

use crate::support::{Bank, UNIT, hex, response, rtu_frame, serve, unhex};

/// What is wrong of these questions with their answers, asked one after the other.
#[track_caller]
fn answers(bank: &mut impl RegisterBank, dialogue: &[(&str, &str)]) {
    for (request, answer) in dialogue {
        let said = hex(&response(bank, &unhex(request)));
        assert_eq!(said, *answer, "to {request}");
    }
}

/// 65536 registers without rules.
struct Memory(Vec<u16>);

impl RegisterBank for Memory {
    fn read(&mut self, address: u16, out: &mut [u16]) -> Result<(), Exception> {
        let at = usize::from(address);
        out.copy_from_slice(&self.0[at..at + out.len()]);
        Ok(())
    }
    fn write(&mut self, address: u16, values: &[u16]) -> Result<(), Exception> {
        let at = usize::from(address);
        self.0[at..at + values.len()].copy_from_slice(values);
        Ok(())
    }
    fn identification(&self, _object: u8) -> Option<&str> {
        None
    }
}

#[test]
fn examples_of_the_modbus_specification_are_answered() {
    let mut memory = Memory(vec![0; 0x1_0000]);
    memory.0[107..110].copy_from_slice(&[0x022B, 0x0000, 0x0064]);
    memory.0[8] = 10;
    let dialogue = [
        ("03 00 6b 00 03", "03 06 02 2b 00 00 00 64"),
        ("04 00 08 00 01", "04 02 00 0a"),
        ("06 00 01 00 03", "06 00 01 00 03"),
        ("03 00 01 00 01", "03 02 00 03"),
        ("10 00 01 00 02 04 00 0a 01 02", "10 00 01 00 02"),
        ("08 00 00 a5 37", "08 00 00 a5 37"),
    ];
    answers(&mut memory, &dialogue);
    assert_eq!(memory.0[1..3], [0x000A, 0x0102]);
    memory.0[3..9].copy_from_slice(&[0x00FE, 0x0ACD, 1, 3, 0x000D, 0x00FF]);
    let both = "17 00 03 00 06 00 0e 00 03 06 00 ff 00 ff 00 ff";
    let read = "17 0c 00 fe 0a cd 00 01 00 03 00 0d 00 ff";
    answers(&mut memory, &[(both, read)]);
    assert_eq!(memory.0[14..17], [0xFF; 3]);
    // It writes before it reads.
    let same = "17 00 20 00 01 00 20 00 01 02 be ef";
    answers(&mut memory, &[(same, "17 02 be ef")]);
}

#[test]
fn the_last_address_is_served_and_a_range_past_it_is_refused() {
    let mut memory = Memory(vec![7; 0x1_0000]);
    let dialogue = [
        ("03 ff ff 00 01", "03 02 00 07"),
        ("03 ff ff 00 02", "83 02"),
        ("10 ff ff 00 02 04 00 00 00 00", "90 02"),
        ("17 00 00 00 01 ff ff 00 02 04 00 00 00 00", "97 02"),
        ("17 ff ff 00 02 00 00 00 01 02 00 00", "97 02"),
    ];
    answers(&mut memory, &dialogue);
    assert_eq!(memory.0[0], 7, "a refused request has no effect");
}

#[test]
fn wrong_quantities_lengths_and_functions_have_their_exceptions() {
    let bank = &mut Bank::new();
    let dialogue = [
        ("03 00 00 00 00", "83 03"),
        ("03 00 00 00 7e", "83 03"),
        ("04 00 00 00 00", "84 03"),
        ("03 00 00 00", "83 03"),
        ("03 00 00 00 01 00", "83 03"),
        ("06 00 20 00", "86 03"),
        ("10 00 20 00 00 00", "90 03"),
        ("10 00 20 00 01 04 00 00", "90 03"),
        ("10 00 20 00 01 02 00", "90 03"),
        ("17 00 00 00 00 00 20 00 01 02 00 00", "97 03"),
        ("17 00 00 00 7e 00 20 00 01 02 00 00", "97 03"),
        ("17 00 00 00 01 00 20 00 00 00", "97 03"),
        ("17 00 00 00 01 00 20 00 01 03 00 00", "97 03"),
        ("08 00 01 00 00", "88 01"),
        ("08 00 00", "88 03"),
        ("01 00 00 00 01", "81 01"),
        ("07", "87 01"),
        ("41", "c1 01"),
        ("2b 0d 00 00", "ab 01"),
        ("2b 0e 05 00", "ab 03"),
        ("2b 0e 04 09", "ab 02"),
        ("", ""),
    ];
    answers(bank, &dialogue);
    assert_eq!(bank.writes, 0);
    let memory = &mut Memory(vec![0; 256]);
    assert_eq!(response(memory, &[3, 0, 0, 0, 125]).len(), 252);
    for (function, most) in [(0x10_u8, 123_u8), (0x17, 121)] {
        for (quantity, answer) in [(most, 0), (most + 1, 0x80)] {
            let mut request = vec![function];
            if function == 0x17 {
                request.extend([0, 0, 0, 1]);
            }
            request.extend([0, 0, 0, quantity, 2 * quantity]);
            request.resize(request.len() + 2 * usize::from(quantity), 0);
            let said = response(memory, &request)[0];
            assert_eq!(said, function | answer, "{quantity} registers");
        }
    }
}

#[test]
fn the_table_guards_addresses_access_halves_and_ranges() {
    let bank = &mut Bank::new();
    let dialogue = [
        ("03 00 10 00 01", "83 02"), // nothing at 16
        ("03 00 0f 00 02", "83 02"), // runs out of the block
        ("06 00 07 00 00", "86 02"), // telemetry is read-only
        ("06 00 22 00 00", "86 02"), // half a set-point
        ("10 00 20 00 03 06 00 00 00 03 00 00", "90 02"),
        ("06 00 21 00 06", "86 03"),                // control word 6
        ("06 00 49 00 00", "86 03"),                // watchdog off
        ("06 00 49 13 89", "86 03"),                // watchdog 5001 ms
        ("10 00 22 00 02 04 80 00 00 00", "90 03"), // set-point "not available"
        ("17 00 10 00 01 00 49 00 01 02 00 64", "97 02"), // unreadable: nothing is written
    ];
    answers(bank, &dialogue);
    assert_eq!(bank.writes, 0);
    let taken = ["06 00 49 13 88", "06 00 21 00 03"];
    answers(bank, &taken.map(|request| (request, request)));
    assert_eq!(bank.writes, 2);
}

#[test]
fn a_long_identification_comes_in_several_answers() {
    let bank = &mut Bank::new();
    bank.names = (0..=6).map(|id| (id, "x".repeat(100))).collect();
    let mut seen = Vec::new();
    let mut object = 0;
    loop {
        let response = response(bank, &[43, 14, 2, object]);
        assert_eq!(response_len(&response), Length::Known(response.len()));
        let number = response[6];
        seen.extend((0..usize::from(number)).map(|k| response[7 + 102 * k]));
        if response[4] == 0 {
            break;
        }
        assert!(response[5] > object, "no progress");
        object = response[5];
    }
    assert_eq!(seen, [0, 1, 2, 3, 4, 5, 6]);
    // An object that does not exist begins the stream anew; one longer than an answer is cut, not lost.
    bank.names = vec![(0, "y".repeat(400)), (1, "z".to_owned())];
    let response = response(bank, &[43, 14, 1, 77]);
    assert_eq!(response.len(), MAX_PDU);
    assert_eq!((&response[4..7], response[8]), (&[0xFF, 1, 1][..], 244));
}

#[test]
fn the_checksum_has_its_published_check_value() {
    assert_eq!(rtu::crc16(b"123456789"), 0x4B37);
    assert_eq!(hex(&frame(0x11, "03 00 6b 00 03")), "11 03 00 6b 00 03 76 87");
}

fn frame(unit: u8, pdu: &str) -> Vec<u8> {
    rtu_frame(unit, &unhex(pdu))
}

#[test]
fn silent_on_wrong_checksum_other_unit_and_broadcast() {
    let (mut receiver, mut bank) = (RtuReceiver::new(UNIT), Bank::new());
    let mut damaged = frame(UNIT, "06 00 49 00 64");
    damaged[3] ^= 1;
    assert!(serve(&mut receiver, &mut bank, &damaged, true).is_empty());
    let other = frame(2, "06 00 49 00 64");
    assert!(serve(&mut receiver, &mut bank, &other, false).is_empty());
    assert_eq!(bank.writes, 0);
    let all = frame(0, "06 00 49 00 64");
    assert_eq!(serve(&mut receiver, &mut bank, &all, false), [""]);
    assert_eq!(bank.writes, 1);
    assert_eq!(receiver.statistics().foreign, 1);
}

#[test]
fn an_unknown_function_is_refused_after_the_gap() {
    let (mut receiver, mut bank) = (RtuReceiver::new(UNIT), Bank::new());
    let request = frame(UNIT, "41 01 02 03");
    assert!(serve(&mut receiver, &mut bank, &request, false).is_empty());
    let answers = serve(&mut receiver, &mut bank, &[], true);
    assert_eq!(answers, [hex(&frame(UNIT, "c1 01"))]);
}

#[test]
fn a_frame_is_found_behind_garbage_and_others_answers() {
    let good = frame(UNIT, "03 00 40 00 01");
    for before in [
        unhex("ff 00 55"),
        // Looks like a long write to us: its length must not swallow the request for good.
        unhex("01 10 00 20 00 7b f6"),
        good[..5].to_vec(),
        frame(7, "03 04 01 10 00 20"),
        frame(7, "83 02"),
        vec![UNIT; 700],
        vec![0; 700],
    ] {
        let (mut receiver, mut bank) = (RtuReceiver::new(UNIT), Bank::new());
        let line = [before.clone(), good.clone()].concat();
        let answers = serve(&mut receiver, &mut bank, &line, true);
        assert_eq!(answers.len(), 1, "after {}", hex(&before));
        // A gap between the two is what a master leaves.
        let mut answers = serve(&mut receiver, &mut bank, &before, true);
        answers.extend(serve(&mut receiver, &mut bank, &good, false));
        assert_eq!(answers.len(), 1, "a gap after {}", hex(&before));
    }
}

#[test]
fn an_unread_receiver_stays_bounded_and_finds_the_newest() {
    let (mut receiver, mut bank) = (RtuReceiver::new(UNIT), Bank::new());
    for _ in 0..5000 {
        receiver.push(UNIT);
    }
    for byte in frame(UNIT, "03 00 40 00 01") {
        receiver.push(byte);
    }
    assert_eq!(serve(&mut receiver, &mut bank, &[], true).len(), 1);
    assert_eq!(receiver.statistics().skipped, 5000);
}

#[test]
fn lengths_of_functions_that_only_others_serve() {
    for (request, length) in [
        ("05 00 01 ff 00", 5),
        ("07", 1),
        ("0f 00 13 00 0a 02 cd 01", 8),
        ("14 0e 06 00 04 00 01 00 02 06 00 03 00 09 00 02", 16),
        ("16 00 04 00 f2 00 25", 7),
        ("18 04 de", 3),
    ] {
        assert_eq!(request_len(&unhex(request)), Length::Known(length));
    }
    for (response, length) in [
        ("01 03 cd 6b 05", 5),
        ("07 6d", 2),
        ("0f 00 13 00 0a", 5),
        ("11 02 01 ff", 4),
        ("16 00 04 00 f2 00 25", 7),
        ("2b 0e 01 01 00 00 02 00 01 61 01 02 62 63", 14),
        ("ab 02", 2),
    ] {
        assert_eq!(response_len(&unhex(response)), Length::Known(length));
    }
    assert_eq!(request_len(&[0x41]), Length::Unknown);
    assert_eq!(response_len(&[43, 13]), Length::Unknown);
}

#[test]
fn lengths_for_pacing_are_those_of_real_answers() {
    let bank = &mut Bank::new();
    for request in [
        "03 00 00 00 10",
        "06 00 49 00 64",
        "10 00 20 00 04 08 00 01 00 03 00 00 03 e8",
        "17 00 00 00 10 00 20 00 04 08 00 01 00 03 00 00 03 e8",
        "08 00 00 a5 37",
    ] {
        let request = unhex(request);
        let response = response(bank, &request);
        assert_eq!(expected_response_len(&request), Some(response.len()));
        assert_eq!(response_len(&response), Length::Known(response.len()));
    }
}

#[test]
fn tcp_repeats_transaction_and_unit() {
    let mut receiver = TcpReceiver::new();
    let request = unhex("ca fe 00 00 00 06 11 03 00 40 00 01");
    let (last, first) = request.split_last().unwrap();
    for &byte in first {
        assert_eq!(receiver.push(byte), Ok(None));
    }
    let found = receiver.push(*last).unwrap().unwrap();
    let answer = found.answer(&mut Bank::new());
    assert_eq!(hex(&answer), "ca fe 00 00 00 05 11 03 02 44 42");
    for (header, error) in [
        ("00 00 00 01", TcpError::Protocol(1)),
        ("00 00 00 00 00 01", TcpError::Length(1)),
        ("00 00 00 00 00 ff", TcpError::Length(255)),
    ] {
        let mut receiver = TcpReceiver::new();
        let outcome: Vec<_> = unhex(header).iter().map(|b| receiver.push(*b)).collect();
        assert_eq!(outcome.last(), Some(&Err(error)));
        assert_eq!(receiver.push(0), Err(error), "no way back");
    }
}
