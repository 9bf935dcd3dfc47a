//! `[load]` and `[supply]`: load of the shaft, and sink of the braking energy.

use serde::{Deserialize, Serialize};

use super::bench_file::Refused;
use drivebench_link::DriveLimits;
use drivebench_link::register_map::Converter;
use drivebench_link::{DriveProfile, LostReply};

/// `[load]`; left out: nothing turns the shaft when the motor does not.
#[derive(Clone, Copy, Debug, Default, Deserialize, Serialize, PartialEq)]
#[serde(deny_unknown_fields, default)]
pub struct LoadSection {
    /// The load falls when nothing holds it.
    pub vertical: bool,
    /// Current that holds the load at rest, with its sign, A: commanded before the brake opens.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hold_current_a: Option<f64>,
    /// From the command to run until the brake is open, s.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub brake_release_s: Option<f64>,
    /// From rest until the brake holds, s; only then the output goes off.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub brake_apply_s: Option<f64>,
}

/// A brake that holds a load while the output is off. The drive operates it, so the bench keeps order and times.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Brake {
    pub hold_current_a: f64,
    pub release_s: f64,
    pub apply_s: f64,
}

impl LoadSection {
    pub fn brake(&self) -> Option<Brake> {
        self.vertical.then_some(Brake {
            hold_current_a: self.hold_current_a?,
            release_s: self.brake_release_s?,
            apply_s: self.brake_apply_s?,
        })
    }

    /// Current that holds the load at rest, A: none where nothing pulls.
    pub(crate) fn hold_a(&self) -> f64 {
        self.brake().map_or(0.0, |brake| brake.hold_current_a)
    }

    const fn keys(&self) -> [(&'static str, Option<f64>); 3] {
        [
            ("load.hold_current_a", self.hold_current_a),
            ("load.brake_release_s", self.brake_release_s),
            ("load.brake_apply_s", self.brake_apply_s),
        ]
    }

    /// The first key of the brake that a vertical load lacks.
    pub fn missing(&self) -> Option<&'static str> {
        let (key, _) = self.keys().into_iter().find(|(_, value)| value.is_none())?;
        self.vertical.then_some(key)
    }

    pub(super) fn is_default(&self) -> bool {
        *self == Self::default()
    }

    pub(super) fn refused(&self, current_limit_a: f64) -> Option<Refused> {
        for (key, value) in self.keys() {
            let Some(value) = value else { continue };
            let (is_allowed, allowed) = match key {
                _ if !self.vertical => (false, "nothing without load.vertical = true"),
                "load.hold_current_a" => (
                    value != 0.0 && value.abs() < current_limit_a,
                    "less than limits.current_a, not 0; its sign is that of lifting",
                ),
                _ => ((0.0..=10.0).contains(&value), "0 to 10 s"),
            };
            if !is_allowed {
                return Some(Refused::new(key, value, allowed));
            }
        }
        None
    }
}

/// `[supply]`; left out: it takes back what braking returns.
#[derive(Clone, Copy, Debug, Deserialize, Serialize, PartialEq)]
#[serde(deny_unknown_fields, default)]
pub struct SupplySection {
    /// The supply takes braking energy back, or stores it.
    pub regenerates: bool,
    /// Power of the brake resistor, W; without one only the motor's winding dissipates braking energy.
    pub brake_power_w: Option<f64>,
}

impl Default for SupplySection {
    fn default() -> Self {
        Self { regenerates: true, brake_power_w: None }
    }
}

impl SupplySection {
    /// Largest braking power out of the motor's terminals, W.
    pub fn braking_w(&self) -> Option<f64> {
        (!self.regenerates).then_some(self.brake_power_w.unwrap_or(0.0))
    }

    pub(super) fn is_default(&self) -> bool {
        *self == Self::default()
    }

    pub(super) fn refused(&self) -> Option<Refused> {
        let watts = self.brake_power_w?;
        let key = "supply.brake_power_w";
        if self.regenerates {
            let allowed = "nothing without supply.regenerates = false";
            return Some(Refused::new(key, watts, allowed));
        }
        (!(watts.is_finite() && watts >= 0.0)).then(|| Refused::new(key, watts, "0 or more"))
    }
}

/// The part of the limits that comes from the drive's profile.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DriveFacts {
    pub bounds: DriveLimits,
    pub converter: Option<Converter>,
    /// Field current below which the motor would run away, A.
    pub field_min_a: Option<f64>,
    /// Duration of a cycle with one lost reply, s, where that is more than the period.
    pub lost_reply_s: Option<f64>,
}

impl DriveFacts {
    pub fn of(profile: &DriveProfile) -> Self {
        let map = profile.registers.as_deref();
        Self {
            bounds: profile.limits,
            converter: map.and_then(|map| map.converter),
            field_min_a: map.and_then(|map| map.field_min_a),
            lost_reply_s: LostReply::of(profile).map(|lost| lost.total_s()),
        }
    }
}
