//! Dead time between set-point and output: the drive's command delay and its start delay.
//!
//! ```text
//! set-point -> [ zero until the drive has started ] -> [ line of ticks ] -> output stage
//! ```

use std::collections::VecDeque;

use firmware_protocol::Control;

use super::TICK_S;
use crate::truth::Path;
use drivebench_model::numerics::count::whole;

/// Delays set-points. Switching off is never delayed.
#[derive(Default)]
pub(super) struct DelayLine {
    delay_ticks: u64,
    start_ticks: u64,
    restart_ticks: u64,
    /// Set-points that differ from the one before, with the tick at which they act.
    line: VecDeque<(u64, Control)>,
    acting: Option<Control>,
    last: Option<Control>,
    /// Tick of the first set-point that is not zero since the start.
    began: Option<u64>,
    /// Tick since which zero is set, and that of the last start from rest.
    rests_since: Option<u64>,
    left_rest: Option<u64>,
}

impl DelayLine {
    pub(super) fn new(path: &Path) -> Self {
        Self {
            delay_ticks: ticks(path.command_delay_s),
            start_ticks: ticks(path.start_delay_s),
            restart_ticks: ticks(path.restart_delay_s),
            rests_since: Some(0),
            ..Self::default()
        }
    }

    /// Whether a start from rest still waits at `tick`.
    fn waits(&mut self, control: Control, tick: u64) -> bool {
        if is_zero(control) {
            self.rests_since.get_or_insert(tick);
        } else if let Some(since) = self.rests_since.take()
            // Time at zero that makes a rest, s.
            && (self.left_rest.is_none() || tick >= since + ticks(0.2))
        {
            self.left_rest = Some(tick);
        }
        let ticks = self.restart_ticks;
        self.left_rest.is_some_and(|left| tick < left + ticks)
    }

    /// The set-point that acts at `tick` under the command `control`; `None`: off.
    pub(super) fn acting(&mut self, control: Option<Control>, tick: u64) -> Option<Control> {
        if self.delay_ticks == 0 && self.start_ticks == 0 && self.restart_ticks == 0 {
            return control;
        }
        let Some(control) = control else {
            self.line.clear();
            (self.acting, self.last, self.began) = (None, None, None);
            (self.rests_since, self.left_rest) = (Some(tick), None);
            return None;
        };
        if self.began.is_none() && !is_zero(control) {
            self.began = Some(tick);
        }
        let started = self.began.is_some_and(|began| tick >= began + self.start_ticks);
        let waits = self.waits(control, tick);
        let control =
            if started && !waits || is_zero(control) { control } else { zero_of(control) };
        if self.last != Some(control) {
            self.last = Some(control);
            self.line.push_back((tick + self.delay_ticks, control));
        }
        while let Some((due, control)) = self.line.front().copied()
            && due <= tick
        {
            self.acting = Some(control);
            self.line.pop_front();
        }
        self.acting
    }
}

/// Whole ticks: the resolution of the drive.
fn ticks(delay_s: f64) -> u64 {
    whole((delay_s / TICK_S).round()) as u64
}

fn is_zero(control: Control) -> bool {
    zero_of(control) == control
}

const fn zero_of(control: Control) -> Control {
    match control {
        Control::Voltage(_) => Control::Voltage(0.0),
        Control::Current(_) => Control::Current(0.0),
        Control::Speed(_) => Control::Speed(0.0),
        off => off,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_late_start_swallows_the_first_set_points_of_each_run() {
        let mut late = DelayLine::new(&Path { start_delay_s: 2e-3, ..Path::default() });
        for from in [0, 1000] {
            for tick in from..from + 10 {
                let zero = Some(Control::Voltage(0.0));
                assert_eq!(late.acting(zero, tick), zero);
            }
            for tick in from + 10..from + 100 {
                let volts = if tick < from + 50 { 0.0 } else { 7.0 };
                let acting = late.acting(Some(Control::Voltage(7.0)), tick);
                assert_eq!(acting, Some(Control::Voltage(volts)), "{tick}");
            }
            late.acting(None, from + 100);
        }
    }
}
