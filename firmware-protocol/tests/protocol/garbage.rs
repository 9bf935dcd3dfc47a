//! 64 KiB of garbage: the work is counted, not timed, and grows with the bytes and no faster; memory is that of the receiver.

use firmware_protocol::modbus::{MAX_PDU, RtuReceiver, TcpReceiver, rtu, tcp};
use firmware_protocol::stream::{self, Decoder};
use proptest::prelude::*;

use crate::properties::config;
use crate::support::{UNIT, noise, rtu_frame};

const LONG: usize = 65_536;

/// Three checksums of a longest frame for each byte: as request, as answer of another, and once more while it waits.
const fn most_work(bytes: usize) -> u64 {
    (3 * rtu::MAX_FRAME * bytes) as u64
}

/// A pattern repeated, where garbage is worst: beginnings of long frames everywhere.
fn pattern() -> impl Strategy<Value = Vec<u8>> {
    let byte = prop_oneof![
        3 => prop::sample::select(&[0_u8, 1, 2, 3, 14, 15, 16, 20, 23, 43, 100, 200, 246, 250][..]),
        1 => any::<u8>(),
    ];
    prop::collection::vec(byte, 1..40)
}

fn repeated(pattern: &[u8], length: usize) -> impl Iterator<Item = u8> {
    pattern.iter().copied().cycle().take(length)
}

/// Bytes that checksums ran over, and requests found.
fn rtu_work(bytes: impl Iterator<Item = u8>, asks_late: bool) -> u64 {
    let mut receiver = RtuReceiver::new(UNIT);
    for (at, byte) in bytes.enumerate() {
        receiver.push(byte);
        if !asks_late || at % rtu::MAX_FRAME == 0 {
            while receiver.take_frame().is_some() {}
        }
    }
    receiver.idle();
    while receiver.take_frame().is_some() {}
    receiver.statistics().checked
}

fn few() -> ProptestConfig {
    ProptestConfig { cases: 40, ..config() }
}

proptest! {
    #![proptest_config(few())]

    #[test]
    fn the_work_of_the_rtu_receiver_is_linear(pattern in pattern(), asks_late in any::<bool>()) {
        let work = |length| rtu_work(repeated(&pattern, length), asks_late);
        let (quarter, whole) = (work(LONG / 4), work(LONG));
        prop_assert!(whole <= most_work(LONG), "{whole}");
        // One longest frame more or less at the ends.
        let edge = most_work(2 * rtu::MAX_FRAME);
        prop_assert!(whole <= 4 * quarter + 4 * edge, "{quarter} {whole}");
    }

    #[test]
    fn random_garbage_costs_the_rtu_receiver_no_more(seed in any::<u32>()) {
        let bytes = noise(seed).take(LONG);
        prop_assert!(rtu_work(bytes, false) <= most_work(LONG));
    }

    #[test]
    fn a_request_behind_any_garbage_and_a_silence_is_found(pattern in pattern()) {
        let mut receiver = RtuReceiver::new(UNIT);
        for byte in repeated(&pattern, LONG) {
            receiver.push(byte);
            while receiver.take_frame().is_some() {}
        }
        receiver.idle();
        while receiver.take_frame().is_some() {}
        for byte in rtu_frame(UNIT, &[3, 0, 0, 0, 16]) {
            receiver.push(byte);
        }
        prop_assert_eq!(receiver.take_frame().map(|frame| frame.pdu().to_vec()), Some(vec![3, 0, 0, 0, 16]));
    }

    #[test]
    fn each_delimiter_of_the_stream_ends_at_most_one_frame(pattern in pattern()) {
        let mut decoder = Decoder::new();
        let (mut results, mut delimiters) = (0, 0);
        for byte in repeated(&pattern, LONG) {
            delimiters += usize::from(byte == 0);
            results += usize::from(decoder.push(byte).is_some());
        }
        // Each byte is looked at once when it comes and once at its delimiter.
        prop_assert!(results <= delimiters);
    }

    #[test]
    fn the_tcp_receiver_gives_no_more_than_came(pattern in pattern()) {
        let mut receiver = TcpReceiver::new();
        let mut told = 0;
        for byte in repeated(&pattern, LONG) {
            match receiver.push(byte) {
                Ok(frame) => told += frame.map_or(0, |frame| frame.pdu().len() + tcp::HEADER),
                Err(_) => break,
            }
        }
        prop_assert!(told <= LONG);
    }
}

#[test]
fn receivers_are_as_large_as_their_buffers() {
    // The crate has no allocator, so this is all there is.
    assert!(size_of::<RtuReceiver>() <= 2 * rtu::MAX_FRAME + 80);
    assert!(size_of::<TcpReceiver>() <= tcp::HEADER + MAX_PDU + 40);
    assert!(size_of::<Decoder>() <= stream::MAX_FRAME + 16);
}
