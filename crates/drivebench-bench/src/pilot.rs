//! Demands of a run: a program, which is a function of time, or a pilot with feedback.

use super::speed::SpeedReport;
use super::trip::Trip;
use drivebench_model::excitation::Program;
use drivebench_model::sample::{Command, Demand, Sample};

#[derive(Clone, Debug, PartialEq)]
pub enum PilotEvent {
    Gains(String),
    Watch(String),
}

/// One run's source of demands, called by the session; time is an argument.
///
/// In each cycle `demand` is called first, then `sent` with the command as shaped by the guard, then `sample`, unless the reply
/// was lost.
pub trait Pilot: Send {
    fn duration_s(&self) -> f64;

    fn segment_at(&self, time_s: f64) -> usize;

    fn segment_name(&self, index: usize) -> &str;

    /// Zero in the quantity that is commanded.
    fn zero(&self) -> Demand;

    /// Fastest change of the voltage while it runs, V/s; `None`: the bench's.
    fn slew_v_per_s(&self) -> Option<f64> {
        None
    }

    /// The run begins, the first time or again; all states begin anew from the last sample.
    fn begin(&mut self, _now_s: f64, _sample: Option<&Sample>) {}

    /// The demand for this cycle, or why the run has to end.
    fn demand(&mut self, now_s: f64, elapsed_s: f64) -> Result<Demand, Trip>;

    fn sent(&mut self, _command: &Command) {}

    /// A sample of the run without a trip; `encoder_proven`: the encoder turned in the right direction.
    fn sample(&mut self, _now_s: f64, _elapsed_s: f64, _sample: &Sample, _encoder_proven: bool) {}

    fn reference_rad_s(&self) -> Option<f64> {
        None
    }

    /// The next line of the log since the last cycle.
    fn next_event(&mut self) -> Option<PilotEvent> {
        None
    }

    /// `None` for a program.
    fn report(&self) -> Option<SpeedReport> {
        None
    }
}

/// A program is a function of the time since its begin, without feedback; `Disable` lets the motor coast.
impl Pilot for Program {
    fn duration_s(&self) -> f64 {
        Self::duration_s(self)
    }

    fn segment_at(&self, time_s: f64) -> usize {
        let spans = self.spans();
        spans.partition_point(|span| span.end_s <= time_s).min(spans.len().saturating_sub(1))
    }

    fn segment_name(&self, index: usize) -> &str {
        self.spans().get(index).map_or("", |span| &span.name)
    }

    fn zero(&self) -> Demand {
        Demand::Voltage(0.0)
    }

    fn demand(&mut self, _now_s: f64, elapsed_s: f64) -> Result<Demand, Trip> {
        Ok(self.value_at(elapsed_s).into())
    }
}
