//! The order of a brake that holds a load: torque, then release; rest, then the brake, then the output off.
//!
//! The drive works the brake (or a relay on its "running" output): no register of ours does. What the session can keep is
//! the order and the times: it holds the load by torque while the brake opens, and again until it has closed. After a trip
//! the drive's own stop acts, and with it its brake.

use serde_json::json;

use super::{Action, Session};
use crate::bench::bench_file::Brake;
use crate::sample::DriveState;

/// One brake with what has been seen since the last start.
#[derive(Clone, Copy, Debug)]
pub(super) struct BrakeOrder {
    brake: Brake,
    /// Since when the drive runs with the holding torque, s.
    held_since_s: Option<f64>,
    /// Since when the shaft rests under it at the end, s.
    resting_since_s: Option<f64>,
}

impl BrakeOrder {
    pub(super) const fn new(brake: Brake) -> Self {
        Self {
            brake,
            held_since_s: None,
            resting_since_s: None,
        }
    }
}

impl Session {
    /// Whether the load may move: the drive has held it for as long as the brake takes to open.
    pub(super) fn is_brake_open(&mut self, now_s: f64, actions: &mut Vec<Action>) -> bool {
        let runs = self.drive_state() != Some(DriveState::Disabled) && !self.shaping.any();
        let Some(order) = self.brake.as_mut() else {
            return true;
        };
        order.resting_since_s = None;
        if !runs {
            order.held_since_s = None;
            return false;
        }
        let begins = order.held_since_s.is_none();
        let since_s = *order.held_since_s.get_or_insert(now_s);
        let release_s = order.brake.release_s;
        let open = now_s - since_s >= release_s;
        if begins {
            let detail = json!({ "brake": "releases", "seconds": release_s });
            self.event(now_s, "brake", detail, actions);
        }
        open
    }

    /// Whether the output may go off: the shaft has rested for as long as the brake takes to close.
    pub(super) fn is_brake_shut(&mut self, now_s: f64, actions: &mut Vec<Action>) -> bool {
        let Some(order) = self.brake.as_mut() else {
            return true;
        };
        order.held_since_s = None;
        let begins = order.resting_since_s.is_none();
        let since_s = *order.resting_since_s.get_or_insert(now_s);
        let apply_s = order.brake.apply_s;
        if begins {
            let detail = json!({ "brake": "applies", "seconds": apply_s });
            self.event(now_s, "brake", detail, actions);
        }
        now_s - since_s >= apply_s
    }
}
