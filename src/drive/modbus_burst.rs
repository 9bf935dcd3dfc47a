//! Burst capture over the registers: armed by one write, read back window by window.
//!
//! A window carries its own index in front, so no late window can be taken for another.

use std::borrow::Cow;

use firmware_protocol::registers::{CAPTURE_CONTROL, CAPTURE_STATE};
use firmware_protocol::{CaptureControl, CaptureState};
use tokio_modbus::{Request, Response};

use super::{Echo, LinkError, ModbusLink, Question, RegisterTable, quantity};
use crate::drive::burst::{Burst, Capture, WINDOW_ADDRESS, WINDOW_WORDS, window_samples};
use crate::drive::clock_map::signed_difference;

/// State, count and the drive time of the first sample.
const HEAD_WORDS: u16 = 4;
/// The window's index stands first in the reply, behind function and length.
const INDEX_AT: usize = 2;

impl ModbusLink {
    /// One window of captured samples.
    fn window(&mut self, index: u16) -> Result<Vec<u16>, LinkError> {
        let words = [index];
        let allowed = self.timing.unhurried(15, 5 + 2 * WINDOW_WORDS);
        let mut attempt = 1;
        loop {
            self.listen()?;
            self.guard.expect(Echo {
                at: INDEX_AT,
                bytes: index.to_be_bytes(),
            });
            let request = Request::ReadWriteMultipleRegisters(
                WINDOW_ADDRESS,
                quantity(WINDOW_WORDS),
                WINDOW_ADDRESS,
                Cow::Borrowed(&words),
            );
            let question = Question {
                is_numbered: true,
                ..Question::plain(request, [23, 0, 0, 0, 0], "captured samples", allowed)
            };
            let window = self.call(question, |response| match response {
                Response::ReadWriteMultipleRegisters(values) => Ok(values),
                other => Err(format!("{other:?}")),
            });
            match window {
                Err(error) if self.may_retry(&error, attempt) => attempt += 1,
                window => return window.map(|answer| answer.value),
            }
        }
    }
}

impl Burst for ModbusLink {
    fn arm(&mut self) -> Result<(), LinkError> {
        self.write_registers(CAPTURE_CONTROL.address, &[CaptureControl::Arm.code()])
    }

    fn fetch(&mut self) -> Result<Option<Capture>, LinkError> {
        let head =
            self.read_registers(RegisterTable::Holding, CAPTURE_STATE.address, HEAD_WORDS)?;
        let [state, count, high, low] = head[..] else {
            return Err(self.mismatch(format!("{} registers of a capture", head.len())));
        };
        if state != CaptureState::Complete.code() {
            return Ok(None);
        }
        let (time_us, now_s) = self.note_clock()?;
        let age_us = signed_difference(time_us, u32::from(high) << 16 | u32::from(low));
        let mut capture = Capture {
            first_s: now_s - f64::from(age_us) * 1e-6,
            period_s: self.capture_period_s,
            samples: Vec::with_capacity(count.into()),
        };
        while capture.samples.len() < usize::from(count) {
            let index = u16::try_from(capture.samples.len()).unwrap_or(u16::MAX);
            let window = self.window(index)?;
            let samples = window_samples(index, &window);
            if samples.is_empty() {
                return Err(self.mismatch(format!("no captured samples from {index} on")));
            }
            capture.samples.extend(samples);
        }
        Ok(Some(capture))
    }
}
