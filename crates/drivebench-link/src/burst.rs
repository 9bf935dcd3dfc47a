//! Burst capture: samples that a drive records in its own memory, faster than any link carries them, read afterwards.

use firmware_protocol::CaptureSample;
use firmware_protocol::registers::WINDOW_INDEX;

use super::link_error::{LinkError, Result};
use drivebench_model::sample::{Channel, Origin, Run, RunError};

pub trait Burst {
    /// Starts a burst with the next command that the drive applies; what an earlier one recorded is dropped.
    fn arm(&mut self) -> Result<()>;

    /// Reads the burst; `None` while the drive waits or records. Takes seconds on a slow line, so not during a run.
    fn fetch(&mut self) -> Result<Option<Capture>>;
}

/// A burst, on the time axis of the link's samples.
#[derive(Clone, Debug, PartialEq)]
pub struct Capture {
    pub first_s: f64,
    pub period_s: f64,
    pub samples: Vec<CaptureSample>,
}

impl Capture {
    /// Collects a burst from blocks of samples; `block` reads the one that begins at an index. A block without samples is an
    /// error of `link`.
    pub fn collect(
        link: &str,
        first_s: f64,
        period_s: f64,
        count: u16,
        mut block: impl FnMut(u16) -> Result<Vec<CaptureSample>>,
    ) -> Result<Self> {
        let mut samples = Vec::with_capacity(count.into());
        while samples.len() < usize::from(count) {
            let index = u16::try_from(samples.len()).unwrap_or(u16::MAX);
            let block = block(index)?;
            if block.is_empty() {
                let reason = format!("no captured samples from {index} on");
                return Err(LinkError::Mismatch(link.to_owned(), reason));
            }
            samples.extend(block);
        }
        Ok(Self { first_s, period_s, samples })
    }

    /// The burst as a run: `voltage_v`, `current_a` and `speed_rad_s`, those that the drive has. A captured voltage is
    /// the mean over the period that ends with its sample, and in a run a voltage holds from its row on: each row has
    /// the voltage of the sample after it, and the last sample has no row.
    pub fn run(&self, name: impl Into<String>) -> Result<Run, RunError> {
        type Of = fn(&[CaptureSample]) -> f64;
        let pairs = || self.samples.windows(2);
        let time_s =
            (0..pairs().count()).map(|index| self.first_s + index as f64 * self.period_s).collect();
        let mut run = Run::new(name, time_s)?;
        let columns: [(Channel, Of); 3] = [
            (Channel::Voltage, |pair| pair[1].voltage_v),
            (Channel::Current, |pair| pair[0].current_a),
            (Channel::Speed, |pair| pair[0].speed_rad_s),
        ];
        for (channel, of) in columns {
            let values: Vec<f64> = pairs().map(of).collect();
            if values.iter().any(|value| value.is_finite()) {
                run.set_column(channel, values, Origin::Measured)?;
            }
        }
        Ok(run)
    }
}

/// First register of the window of captured samples, with the index before it, and how many are read at once.
pub const WINDOW_ADDRESS: u16 = WINDOW_INDEX.address;
pub const WINDOW_WORDS: usize = 2 + 40 * CaptureSample::WORDS;

/// The samples of a window as it is read: index, count of valid samples, samples. Empty where the index is another.
pub fn window_samples(index: u16, words: &[u16]) -> Vec<CaptureSample> {
    match words {
        [found, count, samples @ ..] if *found == index => samples
            .as_chunks()
            .0
            .iter()
            .take((*count).into())
            .map(CaptureSample::from_registers)
            .collect(),
        _ => Vec::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(current_a: f64) -> CaptureSample {
        CaptureSample { voltage_v: 10.0 + current_a, current_a, speed_rad_s: f64::NAN }
    }

    #[test]
    fn a_burst_is_a_run_of_what_the_drive_has() {
        let capture = Capture {
            first_s: 2.5,
            period_s: 1e-4,
            samples: (0..5).map(|k| sample(f64::from(k))).collect(),
        };
        let run = capture.run("burst").unwrap();
        assert_eq!(run.rows(), 4);
        assert!((run.time_s()[3] - 2.5003).abs() < 1e-12);
        assert!((run.column(Channel::Current).unwrap()[3] - 3.0).abs() < 1e-12);
        // The voltage between samples 3 and 4 is that of sample 4.
        assert!((run.column(Channel::Voltage).unwrap()[3] - 14.0).abs() < 1e-12);
        assert!(run.column(Channel::Speed).is_none());
    }

    #[test]
    fn a_block_without_samples_is_an_error() {
        let found = Capture::collect("sim:", 0.0, 1e-4, 1, |_| Ok(Vec::new()));
        let text = "sim: the reply belongs to another request: no captured samples from 0 on";
        assert_eq!(found.unwrap_err().to_string(), text);
    }

    #[test]
    fn a_window_is_read_only_with_the_right_index() {
        let samples = (0..40).flat_map(|k| sample(f64::from(k)).to_registers());
        let mut words: Vec<u16> = [80, 2].into_iter().chain(samples).collect();
        assert_eq!(words.len(), WINDOW_WORDS);
        let samples = window_samples(80, &words);
        assert_eq!(samples.len(), 2);
        assert!((samples[1].current_a - 1.0).abs() < 1e-12);
        assert!(samples[1].speed_rad_s.is_nan());
        assert!(window_samples(40, &words).is_empty());
        assert!(window_samples(80, &words[..1]).is_empty());
        words[1] = 41;
        assert_eq!(window_samples(80, &words).len(), 40);
    }
}
