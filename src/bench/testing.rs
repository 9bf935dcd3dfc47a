//! Test helpers: the paper's motor, and a scripted drive that does exactly what a test tells it.

pub(super) mod stalls;

use std::collections::VecDeque;

use super::limits::Nameplate;
use super::program::Program;
use crate::drive::{CommandTimes, DriveLink, Identity, LinkError, LinkName, LinkStatistics};
use crate::sample::{Applied, Channel, Command, Demand, DriveState, Sample};

impl Nameplate {
    pub(super) fn zk_22fc() -> Self {
        Self {
            name: "ZK-22FC".to_owned(),
            rated_voltage_v: 110.0,
            rated_current_a: 5.7,
            rated_speed_rad_s: 293.2,
            resistance_ohm: 1.1,
            inductance_h: 0.0099,
            back_emf_v_s_per_rad: 0.3538,
            inertia_kg_m2: 0.0045,
            load_torque_n_m: 0.455,
        }
    }
}

/// Voltage as a function of time.
pub(super) struct Wave<F: Fn(f64) -> Demand + Send> {
    pub(super) duration_s: f64,
    pub(super) demand: F,
}

impl<F: Fn(f64) -> Demand + Send> Program for Wave<F> {
    fn duration_s(&self) -> f64 {
        self.duration_s
    }

    fn demand_at(&self, time_s: f64) -> Demand {
        (self.demand)(time_s)
    }

    fn segment_at(&self, time_s: f64) -> usize {
        usize::from(time_s >= 0.5 * self.duration_s)
    }

    fn segment_name(&self, index: usize) -> &str {
        ["first half", "second half"][index]
    }
}

/// What the scripted drive does wrong, and from which exchange on.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Fault {
    Timeout,
    Gone,
    Set(Channel, f64),
    Missing(Channel),
    TripWith(u16),
    LeavesRunning,
    NeverRuns,
    ClockStops,
    IgnoresStop,
}

/// A drive with a first-order shaft and the current that goes with it: no physics, only states, stamps and faults.
pub(super) struct ScriptedDrive {
    pub(super) period_s: f64,
    pub(super) faults: VecDeque<(u64, u64, Fault)>,
    pub(super) demands: Vec<Demand>,
    pub(super) watchdog_s: Option<f64>,
    pub(super) stops: u32,
    pub(super) is_emulator: bool,
    pub(super) shortest_cycle_s: Option<f64>,
    pub(super) times: CommandTimes,
    /// What a stop outside a run ends with; `None`: it is confirmed.
    pub(super) stop_fails: Option<fn(String) -> LinkError>,
    state: DriveState,
    time_s: f64,
    voltage_v: f64,
    speed_rad_s: f64,
    angle_rad: f64,
    statistics: LinkStatistics,
}

impl ScriptedDrive {
    pub(super) fn new(period_s: f64) -> Self {
        Self {
            period_s,
            faults: VecDeque::new(),
            demands: Vec::new(),
            watchdog_s: Some(0.2),
            stops: 0,
            is_emulator: true,
            shortest_cycle_s: None,
            times: CommandTimes::default(),
            stop_fails: None,
            state: DriveState::Disabled,
            time_s: 0.0,
            voltage_v: 0.0,
            speed_rad_s: 0.0,
            angle_rad: 0.0,
            statistics: LinkStatistics::default(),
        }
    }

    /// The fault holds for exchanges `from..to`.
    pub(super) fn with(mut self, from: u64, to: u64, fault: Fault) -> Self {
        self.faults.push_back((from, to, fault));
        self
    }

    fn has(&self, wanted: &Fault) -> bool {
        let now = self.statistics.sent;
        self.faults
            .iter()
            .any(|(from, to, fault)| (*from..*to).contains(&now) && fault == wanted)
    }
}

impl DriveLink for ScriptedDrive {
    fn name(&self) -> LinkName {
        LinkName("script:".to_owned())
    }

    fn identify(&mut self) -> Result<Identity, LinkError> {
        Ok(Identity {
            vendor: "drivebench".to_owned(),
            product: "script".to_owned(),
            is_emulator: self.is_emulator,
            watchdog_s: self.watchdog_s,
            ..Identity::default()
        })
    }

    fn exchange(&mut self, command: Command) -> Result<Sample, LinkError> {
        self.demands.push(command.demand);
        let link = self.name().0;
        let outcome = (self.has(&Fault::Timeout), self.has(&Fault::Gone));
        if !self.has(&Fault::ClockStops) {
            self.time_s += self.period_s;
        }
        let (never, leaves, deaf) = (
            self.has(&Fault::NeverRuns),
            self.has(&Fault::LeavesRunning),
            self.has(&Fault::IgnoresStop),
        );
        let fault = self
            .faults
            .iter()
            .find_map(|(from, to, fault)| match fault {
                Fault::TripWith(code) if (*from..*to).contains(&self.statistics.sent) => {
                    Some(*code)
                }
                _ => None,
            });
        let values: Vec<(u64, u64, Fault)> = self.faults.iter().cloned().collect();
        let now = self.statistics.sent;
        self.statistics.sent += 1;
        if outcome.0 {
            self.statistics.timeout += 1;
            return Err(LinkError::Timeout {
                link,
                deadline_ms: 5,
                request: "test".to_owned(),
            });
        }
        if outcome.1 {
            self.statistics.aborted += 1;
            return Err(LinkError::Gone(link, "unplugged".to_owned()));
        }
        self.statistics.ok += 1;
        self.voltage_v = command.demand.voltage_v().unwrap_or(0.0);
        self.state = match command.demand {
            demand if demand.energises() && !never && !leaves => DriveState::Running,
            _ if deaf && self.state == DriveState::Running => DriveState::Running,
            _ => DriveState::Disabled,
        };
        let before_rad_s = self.speed_rad_s;
        self.speed_rad_s += 0.2 * (self.voltage_v / 0.3538 - self.speed_rad_s);
        self.angle_rad += 0.5 * (before_rad_s + self.speed_rad_s) * self.period_s;
        let current_a = 0.1 + (self.voltage_v - 0.3538 * self.speed_rad_s) / 1.1;
        let mut sample = Sample::at(self.time_s)
            .with(Channel::Current, current_a)
            .with(Channel::Speed, self.speed_rad_s)
            .with(Channel::Voltage, self.voltage_v)
            .with(Channel::Bus, 140.0)
            .with(Channel::Angle, self.angle_rad);
        sample.seq = Some(command.seq);
        sample.state = Some(self.state);
        sample.applied = Some(Applied {
            seq: command.seq,
            time_s: self.time_s - 0.3 * self.period_s,
        });
        if let Some(code) = fault {
            sample.state = Some(DriveState::Fault);
            sample.fault = Some(code);
        }
        for (_, _, fault) in values
            .iter()
            .filter(|(from, to, _)| (*from..*to).contains(&now))
        {
            match fault {
                Fault::Set(channel, value) => sample.set(*channel, *value),
                Fault::Missing(channel) => sample.set(*channel, f64::NAN),
                _ => {}
            }
        }
        Ok(sample)
    }

    fn stop(&mut self) -> Result<(), LinkError> {
        self.stops += 1;
        if let Some(error) = self.stop_fails {
            return Err(error(self.name().0));
        }
        self.state = DriveState::Disabled;
        self.voltage_v = 0.0;
        Ok(())
    }

    fn command_times(&self) -> CommandTimes {
        self.times
    }

    fn statistics(&self) -> LinkStatistics {
        self.statistics
    }

    fn shortest_cycle_s(&self) -> Option<f64> {
        self.shortest_cycle_s
    }
}
