//! Any bytes of a stream: a decoded frame is the same after it is encoded and decoded again.
#![no_main]

use firmware_protocol::stream::{Decoder, encode};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let mut decoder = Decoder::new();
    for byte in bytes {
        let Some(Ok(frame)) = decoder.push(*byte) else {
            continue;
        };
        let mut again = Decoder::new();
        let bytes = encode(&frame);
        let results = bytes.iter().filter_map(|byte| again.push(*byte));
        let read: Vec<_> = results.collect();
        // NaN is not equal to itself; its text is.
        assert_eq!(format!("{read:?}"), format!("{:?}", [Ok::<_, ()>(frame)]));
    }
});
