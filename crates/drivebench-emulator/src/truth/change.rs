//! Changes of the load while the drive runs: what turns with the shaft, and what pulls at it.

use serde::{Deserialize, Serialize};

/// From `time_s` on; what is left out is as without a change.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Change {
    pub time_s: f64,
    /// Inertia from then on, of the motor's; the speed stays as it is.
    #[serde(default = "one")]
    pub inertia_ratio: f64,
    /// Constant torque against positive motion, N.m; it also pulls at a shaft at rest.
    #[serde(default)]
    pub load_n_m: f64,
}

const fn one() -> f64 {
    1.0
}

impl Change {
    pub(super) const NONE: Self = Self { time_s: 0.0, inertia_ratio: 1.0, load_n_m: 0.0 };

    /// The first value that makes no sense, with what is allowed: `(key, value, allowed)`. Changes stand in the order of
    /// their times.
    pub(crate) fn refused(changes: &[Self]) -> Option<(&'static str, f64, &'static str)> {
        let mut before_s = -1.0;
        for change in changes {
            let time = ("change.time_s", change.time_s);
            let inertia = ("change.inertia_ratio", change.inertia_ratio);
            let load = ("change.load_n_m", change.load_n_m);
            for ((key, value), is_allowed, allowed) in [
                (time, (0.0..=86_400.0).contains(&time.1), "0 to 86400 s"),
                (time, time.1 > before_s, "later than the change before it"),
                (inertia, (0.01..=100.0).contains(&inertia.1), "0.01 to 100"),
                (load, load.1.abs() <= 1000.0, "-1000 to 1000 N.m"),
            ] {
                if !is_allowed {
                    return Some((key, value, allowed));
                }
            }
            before_s = change.time_s;
        }
        None
    }
}

/// The changes of one machine and the one in force.
#[derive(Clone, Debug)]
pub(super) struct Changes {
    list: Vec<Change>,
    next: usize,
    now: Change,
}

impl Changes {
    /// `list` in the order of its times.
    pub(super) const fn new(list: Vec<Change>) -> Self {
        Self { list, next: 0, now: Change::NONE }
    }

    pub(super) const fn restart(&mut self) {
        (self.next, self.now) = (0, Change::NONE);
    }

    pub(super) fn advance_to(&mut self, time_s: f64) {
        while let Some(change) = self.list.get(self.next)
            && change.time_s <= time_s
        {
            (self.next, self.now) = (self.next + 1, *change);
        }
    }

    pub(super) const fn now(&self) -> &Change {
        &self.now
    }
}
