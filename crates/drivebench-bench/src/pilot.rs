//! Demands of a run: a program that knows time only, or a pilot that answers to samples.

use super::speed::SpeedReport;
use super::trip::Trip;
use drivebench_model::excitation;
use drivebench_model::sample::{Command, Demand, Sample};

/// A pure function of the time since its begin.
pub trait Program: Send {
    fn duration_s(&self) -> f64;

    /// The demand at `time_s`, before slew and limits. `Disable` lets the motor coast.
    fn demand_at(&self, time_s: f64) -> Demand;

    fn segment_at(&self, time_s: f64) -> usize;

    fn segment_name(&self, index: usize) -> &str;
}

impl Program for excitation::Program {
    fn duration_s(&self) -> f64 {
        Self::duration_s(self)
    }

    fn demand_at(&self, time_s: f64) -> Demand {
        self.value_at(time_s).into()
    }

    fn segment_at(&self, time_s: f64) -> usize {
        let spans = self.spans();
        spans.partition_point(|span| span.end_s <= time_s).min(spans.len().saturating_sub(1))
    }

    fn segment_name(&self, index: usize) -> &str {
        self.spans().get(index).map_or("", |span| &span.name)
    }
}

/// What a pilot has to say in a cycle.
#[derive(Clone, Debug, PartialEq)]
pub enum PilotNews {
    Gains(String),
    /// The watch of the loop has found something.
    Watch(String),
}

/// One run's source of demands, driven by the session; time comes in.
///
/// In each cycle `demand` is asked for first, then `sent` tells what really left after the guard; `sample` comes where
/// the exchange brought one. A cycle without a `sample` after it has lost its reply.
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

    /// The run begins, the first time or again; nothing of before is to be remembered. The last sample is given.
    fn begin(&mut self, _now_s: f64, _sample: Option<&Sample>) {}

    /// The demand for this cycle, or why the run has to end.
    fn demand(&mut self, now_s: f64, elapsed_s: f64) -> Result<Demand, Trip>;

    fn sent(&mut self, _command: &Command) {}

    /// A sample that came while it runs, and nothing speaks against it; `encoder_proven`: the encoder has been seen to turn
    /// in the right direction.
    fn sample(&mut self, _now_s: f64, _elapsed_s: f64, _sample: &Sample, _encoder_proven: bool) {}

    /// The speed reference in force, rad/s.
    fn reference_rad_s(&self) -> Option<f64> {
        None
    }

    /// The next thing that changed or was found since the last cycle and why, as a line of the log.
    fn news(&mut self) -> Option<PilotNews> {
        None
    }

    /// How the loop went; `None` for a program.
    fn report(&self) -> Option<SpeedReport> {
        None
    }
}

/// A program as the simplest pilot: what is measured changes nothing.
pub(super) struct OpenLoop {
    pub(super) program: Box<dyn Program>,
    /// What holds a load at rest, in the quantity that is commanded; the program comes on top.
    pub(super) hold: f64,
}

impl OpenLoop {
    fn held(&self, demand: Demand) -> Demand {
        match demand {
            Demand::Voltage(volts) => Demand::Voltage(volts + self.hold),
            Demand::Current(amps) => Demand::Current(amps + self.hold),
            other => other,
        }
    }
}

impl Pilot for OpenLoop {
    fn duration_s(&self) -> f64 {
        self.program.duration_s()
    }

    fn segment_at(&self, time_s: f64) -> usize {
        self.program.segment_at(time_s)
    }

    fn segment_name(&self, index: usize) -> &str {
        self.program.segment_name(index)
    }

    fn zero(&self) -> Demand {
        self.held(match self.program.demand_at(0.0) {
            Demand::Current(_) => Demand::Current(0.0),
            Demand::Speed(_) => Demand::Speed(0.0),
            _ => Demand::Voltage(0.0),
        })
    }

    fn demand(&mut self, _now_s: f64, elapsed_s: f64) -> Result<Demand, Trip> {
        Ok(self.held(self.program.demand_at(elapsed_s)))
    }
}
