//! Any bytes of a connection: requests lie within what came, and a wrong header ends it for good.
#![no_main]

use firmware_protocol::modbus::{MAX_PDU, TcpReceiver, tcp};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let mut receiver = TcpReceiver::new();
    let (mut told, mut broken) = (0, false);
    for byte in bytes {
        match receiver.push(*byte) {
            Ok(Some(frame)) => {
                assert!(!broken && (1..=MAX_PDU).contains(&frame.pdu().len()));
                told += tcp::HEADER + frame.pdu().len();
            }
            Ok(None) => assert!(!broken),
            Err(_) => broken = true,
        }
    }
    assert!(told <= bytes.len());
});
