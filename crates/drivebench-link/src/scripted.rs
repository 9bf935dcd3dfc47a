//! The far end of a line in memory as a test scripts it: which bytes answer which request, and when.

use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use firmware_protocol::modbus::{Length, request_len, rtu};

use super::virtual_line::Device;
use super::waiting::now;

/// Bytes, and how long after the request they arrive.
pub(super) type Delayed = (Duration, Vec<u8>);

/// Hands each Modbus RTU request with its number, from 0, to the script.
pub(super) struct Scripted<S> {
    script: S,
    received: Vec<u8>,
    /// Requests, and when they came.
    pub(super) requests: Vec<(Instant, Vec<u8>)>,
}

impl<S: FnMut(usize, &[u8]) -> Vec<Delayed> + Send> Scripted<S> {
    pub(super) fn new(script: S) -> Arc<Mutex<Self>> {
        Arc::new(Mutex::new(Self { script, received: Vec::new(), requests: Vec::new() }))
    }
}

impl<S: FnMut(usize, &[u8]) -> Vec<Delayed> + Send> Device for Scripted<S> {
    fn receive(&mut self, bytes: &[u8]) -> Vec<Delayed> {
        self.received.extend_from_slice(bytes);
        let mut sent = Vec::new();
        while let Some(request) = take_request(&mut self.received) {
            sent.extend((self.script)(self.requests.len(), &request));
            self.requests.push((now(), request));
        }
        sent
    }
}

fn take_request(received: &mut Vec<u8>) -> Option<Vec<u8>> {
    let Length::Known(length) = request_len(received.get(1..)?) else { return None };
    (received.len() >= length + 3).then(|| received.drain(..length + 3).collect())
}

pub(super) fn frame(unit: u8, pdu: &[u8]) -> Vec<u8> {
    rtu::encode_frame(unit, pdu).to_vec()
}
