//! The two messages of the burst capture.

use super::payload::{Plain, Reader};
use crate::capture::{CaptureSample, CaptureState};
use crate::registers as r;
use crate::wire::{Sink, Source};

/// Samples in one block at most.
pub const CAPTURE_BLOCK_SAMPLES: usize = 32;

/// State of the capture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CaptureStatus {
    /// State.
    pub state: CaptureState,
    /// Samples recorded so far.
    pub count: u16,
    /// Drive time of captured sample 0, microseconds.
    pub first_time_us: u32,
}

impl CaptureStatus {
    pub(super) fn write(self, writer: &mut Plain) {
        writer.raw(&r::CAPTURE_STATE, self.state.code().into());
        writer.raw(&r::CAPTURE_COUNT, self.count.into());
        writer.raw(&r::CAPTURE_TIME, self.first_time_us.into());
    }

    pub(super) fn read(reader: &mut Reader<'_>) -> Option<Self> {
        Some(Self {
            state: CaptureState::from_code(reader.u16(&r::CAPTURE_STATE))?,
            count: reader.u16(&r::CAPTURE_COUNT),
            first_time_us: reader.u32(&r::CAPTURE_TIME),
        })
    }
}

/// Captured samples from `index` on. Fewer than [`CAPTURE_BLOCK_SAMPLES`] only at the end of the record.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CaptureBlock {
    /// Index of the first sample.
    pub index: u16,
    count: u8,
    samples: [CaptureSample; CAPTURE_BLOCK_SAMPLES],
}

impl CaptureBlock {
    /// A block of the first [`CAPTURE_BLOCK_SAMPLES`] of `samples`.
    pub fn new(index: u16, samples: &[CaptureSample]) -> Self {
        let mut block =
            Self { index, count: 0, samples: [CaptureSample::default(); CAPTURE_BLOCK_SAMPLES] };
        for (slot, sample) in block.samples.iter_mut().zip(samples) {
            *slot = *sample;
            block.count += 1;
        }
        block
    }

    /// The samples.
    pub fn samples(&self) -> &[CaptureSample] {
        &self.samples[..usize::from(self.count)]
    }

    pub(super) fn write(&self, writer: &mut Plain) {
        writer.extend(&self.index.to_be_bytes());
        writer.extend(&[self.count]);
        for sample in self.samples() {
            for (register, value) in sample.fields() {
                writer.value(&register, value);
            }
        }
    }

    pub(super) fn read(reader: &mut Reader<'_>) -> Option<Self> {
        let index = u16::from_be_bytes(reader.bytes()?);
        let [count] = reader.bytes()?;
        let mut block = Self { count, ..Self::new(index, &[]) };
        for sample in block.samples.get_mut(..usize::from(count))? {
            *sample = CaptureSample {
                voltage_v: reader.value(&r::WINDOW_VOLTAGE),
                current_a: reader.value(&r::WINDOW_CURRENT),
                speed_rad_s: reader.value(&r::WINDOW_SPEED),
            };
        }
        Some(block)
    }
}
