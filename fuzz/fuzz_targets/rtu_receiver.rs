//! Any bytes on the line, with a silence after every 0xFE: every byte is accounted for, the work is bounded.
#![no_main]

use firmware_protocol::modbus::{RtuReceiver, rtu};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let mut receiver = RtuReceiver::new(1);
    let mut taken = 0;
    for byte in bytes {
        receiver.push(*byte);
        if *byte == 0xFE {
            receiver.idle();
        }
        while let Some(frame) = receiver.take_frame() {
            taken += frame.pdu().len() as u64 + 3;
        }
    }
    receiver.idle();
    while let Some(frame) = receiver.take_frame() {
        taken += frame.pdu().len() as u64 + 3;
    }
    let counts = receiver.statistics();
    let received = bytes.len() as u64;
    assert!(taken + counts.skipped <= received);
    assert!(counts.foreign > 0 || taken + counts.skipped == received);
    assert!(counts.checked <= 3 * rtu::MAX_FRAME as u64 * received);
});
