//! Any bytes of a connection: requests are no longer than the input, and a wrong header ends it.
#![no_main]

use firmware_protocol::modbus::{MAX_PDU, TcpReceiver, tcp};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let mut receiver = TcpReceiver::new();
    let (mut taken, mut broken) = (0, false);
    for byte in bytes {
        match receiver.push(*byte) {
            Ok(Some(frame)) => {
                assert!(!broken && (1..=MAX_PDU).contains(&frame.pdu().len()));
                taken += tcp::HEADER + frame.pdu().len();
            }
            Ok(None) => assert!(!broken),
            Err(_) => broken = true,
        }
    }
    assert!(taken <= bytes.len());
});
