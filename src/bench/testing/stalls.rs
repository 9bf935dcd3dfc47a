//! A laptop that stands still now and then, and a drive that for a while answers nothing: in virtual time, by dice.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{RngCore, SeedableRng};

use crate::bench::clock::Clock;
use crate::drive::{DriveLink, Identity, LinkError, LinkName, LinkStatistics};
use crate::emulator::{MemoryLink, VirtualClock};
use crate::sample::{Command, Sample};

/// How often and how long.
#[derive(Clone, Copy)]
pub(in crate::bench) struct Stalls {
    /// Part of the cycles that are followed by one.
    pub(in crate::bench) share: f64,
    pub(in crate::bench) longest_s: f64,
}

impl Stalls {
    /// None most of the time.
    fn length_s(self, dice: &mut ChaCha8Rng) -> f64 {
        let mut uniform = || f64::from(dice.next_u32()) / f64::from(u32::MAX);
        if uniform() < self.share {
            self.longest_s * uniform()
        } else {
            0.0
        }
    }
}

/// The host's clock: some waits end late.
pub(in crate::bench) struct StallingClock {
    clock: VirtualClock,
    stalls: Stalls,
    dice: ChaCha8Rng,
}

impl StallingClock {
    pub(in crate::bench) fn new(clock: VirtualClock, stalls: Stalls, seed: u64) -> Self {
        let dice = ChaCha8Rng::seed_from_u64(seed);
        Self {
            clock,
            stalls,
            dice,
        }
    }
}

impl Clock for StallingClock {
    fn now_s(&self) -> f64 {
        self.clock.time_s()
    }

    fn sleep_until_s(&mut self, until_s: f64) {
        let late_s = self.stalls.length_s(&mut self.dice);
        self.clock
            .set_time_s(self.clock.time_s().max(until_s) + late_s);
    }

    fn is_real(&self) -> bool {
        false
    }
}

/// The drive's side: while it dozes, requests are lost and the output stays as it is.
pub(in crate::bench) struct DozingLink {
    pub(in crate::bench) link: MemoryLink,
    clock: VirtualClock,
    stalls: Stalls,
    dice: ChaCha8Rng,
    wakes_s: f64,
}

impl DozingLink {
    pub(in crate::bench) fn new(
        link: MemoryLink,
        clock: VirtualClock,
        stalls: Stalls,
        seed: u64,
    ) -> Self {
        Self {
            link,
            clock,
            stalls,
            dice: ChaCha8Rng::seed_from_u64(seed),
            wakes_s: 0.0,
        }
    }
}

impl DriveLink for DozingLink {
    fn name(&self) -> LinkName {
        self.link.name()
    }

    fn identify(&mut self) -> Result<Identity, LinkError> {
        self.link.identify()
    }

    fn exchange(&mut self, command: Command) -> Result<Sample, LinkError> {
        let now_s = self.clock.time_s();
        if now_s < self.wakes_s {
            return Err(LinkError::Timeout {
                link: self.name().0,
                deadline_ms: 8,
                request: "a dozing drive".to_owned(),
            });
        }
        let sample = self.link.exchange(command);
        self.wakes_s = now_s + self.stalls.length_s(&mut self.dice);
        sample
    }

    fn stop(&mut self) -> Result<(), LinkError> {
        self.link.stop()
    }

    fn statistics(&self) -> LinkStatistics {
        self.link.statistics()
    }

    fn shortest_cycle_s(&self) -> Option<f64> {
        None
    }
}
