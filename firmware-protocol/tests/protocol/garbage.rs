//! 64 KiB of garbage: the work is counted, not timed, and grows with the bytes and no faster; memory is that of the receiver.

use firmware_protocol::modbus::{MAX_PDU, RtuReceiver, TcpReceiver, rtu, tcp};
use firmware_protocol::stream::{self, Decoder};
use proptest::prelude::*;

use crate::properties::config;
use crate::support::UNIT;

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

/// Bytes that checksums ran over.
fn rtu_work(pattern: &[u8], length: usize, asks_late: bool) -> u64 {
    let mut receiver = RtuReceiver::new(UNIT);
    for (at, byte) in pattern.iter().cycle().take(length).enumerate() {
        receiver.push(*byte);
        if !asks_late || at % rtu::MAX_FRAME == 0 {
            while receiver.take_frame().is_some() {}
        }
    }
    receiver.idle();
    while receiver.take_frame().is_some() {}
    receiver.statistics().checked
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 40, ..config() })]

    #[test]
    fn the_work_of_the_rtu_receiver_is_linear(pattern in pattern(), asks_late in any::<bool>()) {
        let [quarter, whole] = [LONG / 4, LONG].map(|length| rtu_work(&pattern, length, asks_late));
        prop_assert!(whole <= most_work(LONG), "{whole}");
        // One longest frame more or less at the ends.
        let edge = most_work(2 * rtu::MAX_FRAME);
        prop_assert!(whole <= 4 * quarter + 4 * edge, "{quarter} {whole}");
    }
}

#[test]
fn receivers_are_as_large_as_their_buffers() {
    // The crate has no allocator, so this is all there is.
    assert!(size_of::<RtuReceiver>() <= 2 * rtu::MAX_FRAME + 80);
    assert!(size_of::<TcpReceiver>() <= tcp::HEADER + MAX_PDU + 40);
    assert!(size_of::<Decoder>() <= stream::MAX_FRAME + 16);
}
