//! From the map to the profile that the bench sees.

use super::super::facts::{Quantity, RegisterMap};
use super::super::schema::ProfileFile;
use crate::drive::profile::{
    Capabilities, DriveLimits, DriveProfile, LinkSettings, SignalOrigins, SignalSides, Watchdog,
};
use crate::sample::Channel;
use crate::units::rad_s_from_rpm;

/// What the bench sees of it.
pub(super) fn profile_of(file: &ProfileFile, map: &RegisterMap) -> DriveProfile {
    let link = file.link.get_ref();
    let origin = |channel| {
        map.of_channel(channel)
            .and_then(|signal| signal.traits.origin)
    };
    let side = |channel| {
        map.of_channel(channel)
            .and_then(|signal| signal.traits.side)
    };
    let able = |quantity| map.demand(quantity).is_some();
    DriveProfile {
        name: map.device.id.clone(),
        source: map.device.source.clone(),
        trust: map.device.trust,
        link: LinkSettings {
            protocol: link.protocol,
            baud: link.baud,
            unit: link.unit,
            framing: link.framing,
            reply_ms: link.reply_ms,
            gap_us: link.gap_us,
            deadline_ms: link.deadline_ms,
            emulated: false,
        },
        capabilities: Capabilities {
            voltage_command: able(Quantity::Voltage),
            current_command: able(Quantity::Current),
            speed_command: able(Quantity::Speed),
        },
        signals: SignalOrigins {
            voltage_cmd_v: None,
            voltage_v: origin(Channel::Voltage),
            current_a: origin(Channel::Current),
            speed_rad_s: origin(Channel::Speed),
            angle_rad: origin(Channel::Angle),
            torque_n_m: origin(Channel::Torque),
            bus_v: origin(Channel::Bus),
            temperature_c: origin(Channel::Temperature),
        },
        sides: SignalSides {
            voltage_v: side(Channel::Voltage),
            current_a: side(Channel::Current),
        },
        watchdog: Watchdog {
            kicked_by: map.watchdog.kicked_by,
            // Off as delivered is no time.
            default_ms: map
                .watchdog
                .default_s
                .filter(|time_s| *time_s > 0.0)
                .map(|time_s| time_s * 1e3),
        },
        limits: DriveLimits {
            current_a: file.limits.current_a,
            voltage_v: file.limits.voltage_v,
            speed_rad_s: file.limits.speed_rpm.map(rad_s_from_rpm),
        },
        registers: None,
    }
}
