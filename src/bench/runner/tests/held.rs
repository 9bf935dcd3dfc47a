//! A link that holds an exchange up to its bound, and a little beyond: that is no host that stood still.

use super::*;
use crate::bench::limits::Limits;
use crate::drive::{Identity, LinkError, LinkName};

/// A system under load comes back so much later than it was asked to, s.
const OVER_S: f64 = 0.02;

/// Answers until it is dead; then it takes all the time it is given.
struct Held {
    drive: ScriptedDrive,
    clock: VirtualClock,
    dead_from: u64,
    left_s: f64,
}

impl DriveLink for Held {
    fn name(&self) -> LinkName {
        self.drive.name()
    }

    fn identify(&mut self) -> Result<Identity, LinkError> {
        self.drive.identify()
    }

    fn exchange(&mut self, command: Command) -> Result<Sample, LinkError> {
        let answer = self.drive.exchange(command);
        if command.seq < self.dead_from {
            return answer;
        }
        let until_s = self.clock.time_s() + self.left_s + OVER_S;
        self.clock.set_time_s(until_s);
        Err(LinkError::Timeout {
            link: self.name().0,
            deadline_ms: 0,
            request: "a dead drive".to_owned(),
        })
    }

    fn stop(&mut self) -> Result<(), LinkError> {
        self.drive.stop()
    }

    fn bound(&mut self, left_s: f64) {
        self.left_s = left_s;
    }

    fn statistics(&self) -> LinkStatistics {
        self.drive.statistics()
    }

    fn shortest_cycle_s(&self) -> Option<f64> {
        None
    }
}

#[test]
fn a_silence_that_comes_from_the_link_is_never_called_a_host_that_stood_still() {
    let motor = Nameplate::zk_22fc();
    for dead_from in 60..70 {
        let mut clock = VirtualClock::new();
        let mut link = Held {
            drive: ScriptedDrive::new(0.01),
            clock: clock.clone(),
            dead_from,
            left_s: f64::INFINITY,
        };
        let program = Wave {
            duration_s: 4.0,
            demand: |_| Demand::Voltage(5.0),
        };
        let limits = Limits::for_motor(&motor, 100.0);
        let session = Session::new(Box::new(program), Guard::new(limits, &motor, None));
        let (summary, _) = carry_out(session, &mut link, &mut clock, 100.0);
        let Outcome::LinkLost { reason } = &summary.outcome else {
            panic!("{dead_from}: {:?}", summary.outcome);
        };
        assert!(reason.starts_with("link silent"), "{dead_from}: {reason}");
    }
}
