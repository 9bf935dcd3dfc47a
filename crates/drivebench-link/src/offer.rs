//! Offer of a drive's signals, what they can carry: a pure judgement over its profile, in sentences for the person at the bench.

use super::profile::DriveProfile;
use super::register_map::{DeviceKind, Quantity, RegisterMap, Signal, SupervisionKind};
use super::settings::Trust;
use drivebench_model::sample::{Channel, Origin};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// A sequence of armature voltages, from which every parameter may follow.
    Voltages,
    /// A sequence of currents that reverse by the speed of the shaft.
    Currents,
    /// A loop around the speed of the shaft.
    SpeedLoop,
    /// Friction and inertia from torque or current and the speed of the shaft.
    Mechanics,
}

/// Why this drive cannot carry the purpose; `None`: it can.
pub fn refusal(profile: &DriveProfile, purpose: Purpose) -> Option<String> {
    let able = profile.capabilities;
    let reason = match purpose {
        Purpose::Voltages if able.voltage_command => no_shaft_speed(profile),
        Purpose::Voltages => Some(no_voltage(profile)),
        Purpose::Currents if able.current_command => no_shaft_speed(profile),
        Purpose::Currents => Some("the drive takes no current command".to_owned()),
        Purpose::SpeedLoop
            if able.voltage_command || able.current_command || able.speed_command =>
        {
            no_shaft_speed(profile)
        }
        Purpose::SpeedLoop => Some(no_reference(profile)),
        Purpose::Mechanics => no_shaft_speed(profile).or_else(|| no_signed_torque(profile)),
    };
    reason.map(|reason| format!("{}: {reason}", profile.name))
}

/// Properties of each measured quantity: origin, sign, side, basis, delays. Empty for our own map, whose
/// telemetry is instantaneous (firmware-protocol/SPEC.md).
pub fn carried(profile: &DriveProfile) -> Vec<(Channel, String)> {
    let Some(map) = &profile.registers else { return Vec::new() };
    let signals = map.signals.iter().filter_map(|signal| {
        let (channel, _) = signal.channel?;
        Some((channel, properties(signal)))
    });
    let mut carried: Vec<_> = signals.collect();
    carried.sort_by_key(|(channel, _)| channel.index());
    carried
}

fn properties(signal: &Signal) -> String {
    let keys = &signal.keys;
    let sign = if signal.is_signed() { "signed" } else { "no sign" };
    let mut parts = vec![keys.origin.unwrap_or_default().name().to_owned(), sign.to_owned()];
    parts.extend(keys.side.map(|side| format!("{} side", side.name())));
    parts.extend(keys.basis.map(|basis| basis.name().to_owned()));
    parts.extend(keys.pole_pairs.map(|pairs| format!("by {pairs} pole pairs")));
    for (what, time_ms) in [("filter", keys.filter_ms), ("update", keys.update_ms)] {
        let not_given = || format!("{what} not given");
        parts.push(time_ms.map_or_else(not_given, |ms| format!("{what} {ms} ms")));
    }
    parts.extend(keys.since_last_read.then(|| "mean since the last read".to_owned()));
    let is_unverified = keys.trust == Some(Trust::Unverified);
    parts.extend(is_unverified.then(|| "unverified".to_owned()));
    format!("{} ({})", parts.join(", "), signal.name)
}

/// Remarks for the user of this drive, in addition to what it cannot do.
pub fn remarks(profile: &DriveProfile) -> Vec<String> {
    let Some(map) = &profile.registers else { return Vec::new() };
    let mut remarks: Vec<String> = map.device.note.clone().into_iter().collect();
    for (channel, reason) in &map.missing {
        remarks.push(format!("{channel} is missing: {reason}"));
    }
    if let Some(speed) = map.of_channel(Channel::Speed)
        && speed.keys.quantity == Quantity::OutputSpeed
    {
        remarks.push(
            "speed_rad_s is what the drive puts out or computes; the shaft lags by the slip"
                .to_owned(),
        );
    }
    if let Some(current) = map.of_channel(Channel::Current)
        && !current.is_signed()
    {
        remarks.push("current_a has no sign: driving and braking look alike".to_owned());
    }
    if let Some(converter) = map.converter {
        let quadrants = match converter.quadrants {
            1 => "one quadrant: it drives one way and cannot brake",
            2 => "two quadrants: current flows one way only",
            _ => "four quadrants",
        };
        let ms = converter.dead_time_ms;
        remarks.push(format!(
            "thyristor bridge, {quadrants}; a command takes effect up to {ms} ms late"
        ));
        remarks.push(match (map.of_quantity(Quantity::FieldCurrent), map.field_min_a) {
            (Some(field), Some(least)) => {
                format!("{} below {least} A is a trip: the field is lost", field.name)
            }
            (Some(field), None) => format!(
                "{} is read, but limits.field_min_a is not given: a loss of the field is not detected",
                field.name
            ),
            (None, _) => "the field current is not read".to_owned(),
        });
    }
    let watchdog = &map.watchdog;
    match (watchdog.keys.kind, watchdog.default_s()) {
        (SupervisionKind::Unknown | SupervisionKind::Gateway, _) => {
            remarks.push("whether the drive stops when the host is silent is not known".to_owned());
        }
        (SupervisionKind::None, _) => remarks.push("the drive has no watchdog".to_owned()),
        (_, Some(0.0)) if watchdog.keys.set_ms.is_none() => {
            remarks.push(match watchdog.time {
                Some(_) => "its watchdog is off as delivered: give watchdog.set_ms in the profile, or set it at the drive".to_owned(),
                None => "its watchdog is off as delivered: set it at the drive".to_owned(),
            });
        }
        _ => {}
    }
    if watchdog.keys.auto_resume {
        remarks.push(
            "after its watchdog has stopped it, the next command resumes the old one".to_owned(),
        );
    }
    if map.commands.reset.is_empty() {
        remarks.push("a fault cannot be cleared over the bus: reset it at the drive".to_owned());
    }
    if map.commands.coast.is_empty() {
        remarks.push(
            "nothing is left to try where its stop command fails: it has no coast".to_owned(),
        );
    }
    if watchdog.keys.boot_delay_s > 0.0 {
        let blind_s = watchdog.keys.boot_delay_s;
        remarks.push(format!("its watchdog is blind for {blind_s} s after power-up"));
    }
    remarks
}

fn no_voltage(profile: &DriveProfile) -> String {
    let registers = profile.registers.as_deref();
    match registers.map(|map| map.device.kind) {
        Some(DeviceKind::Ac) => "a frequency converter takes no armature voltage, so a sequence of voltages cannot be run on it".to_owned(),
        Some(DeviceKind::ThyristorDc) => "this converter takes a speed or a torque, no armature voltage; a sequence of voltages cannot be run on it".to_owned(),
        _ => {
            let duty = registers.is_some_and(|map| map.set_points.iter().any(|p| p.keys.quantity == Quantity::Duty));
            if duty {
                "it takes a share of its supply voltage, and the profile does not say what that supply is; give the setpoint quantity \"voltage\", unit V and the scale".to_owned()
            } else {
                "the drive takes no voltage command, so a sequence of voltages cannot be run on it".to_owned()
            }
        }
    }
}

fn no_reference(profile: &DriveProfile) -> String {
    let map = profile.registers.as_deref();
    let mut points = map.into_iter().flat_map(|map| &map.set_points);
    let point = points.find(|p| p.keys.quantity == Quantity::Speed);
    match point {
        Some(point) => format!(
            "its reference {} is in {}, and what that is as a speed depends on the motor: give the profile a scale in rpm, pole_pairs for Hz, or counts_per_turn for counts/s",
            point.name,
            point.numbers.unit.name()
        ),
        None => {
            "the drive takes no speed, current or voltage that a loop could act with".to_owned()
        }
    }
}

fn no_shaft_speed(profile: &DriveProfile) -> Option<String> {
    let origin = profile.signals.get(Channel::Speed).or(profile.signals.get(Channel::Angle));
    let Some(map) = &profile.registers else {
        let none = || "the drive gives no speed".to_owned();
        return origin.is_none().then(none);
    };
    let signal = map.of_channel(Channel::Speed);
    match signal.map(|signal| (signal.keys.quantity, origin)) {
        Some((Quantity::ShaftSpeed, Some(Origin::Measured))) => None,
        Some(_) => Some(
            "its speed is an output frequency or computed by the drive, no speed of the shaft: slip and torsion cannot be seen in it".to_owned(),
        ),
        None => Some(format!("it gives no speed of the shaft: {}", missing(map, Channel::Speed))),
    }
}

fn no_signed_torque(profile: &DriveProfile) -> Option<String> {
    let Some(map) = &profile.registers else {
        let any = profile.signals.current_a.or(profile.signals.torque_n_m);
        let none = || "the drive gives neither torque nor current".to_owned();
        return any.is_none().then(none);
    };
    let signed = |channel| map.of_channel(channel).is_some_and(Signal::is_signed);
    if signed(Channel::Current) || signed(Channel::Torque) {
        return None;
    }
    Some(match map.of_channel(Channel::Current) {
        Some(_) => "its current has no sign and no torque in N.m is mapped: friction and inertia do not follow from them".to_owned(),
        None => format!("it gives no signed torque or current: {}", missing(map, Channel::Current)),
    })
}

fn missing(map: &RegisterMap, channel: Channel) -> String {
    map.missing
        .get(channel.key())
        .cloned()
        .unwrap_or_else(|| "the profile does not map it".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(name: &str, purpose: Purpose) -> Option<String> {
        refusal(&DriveProfile::named(name).unwrap(), purpose)
    }

    #[test]
    fn each_drive_carries_what_its_signals_allow() {
        use Purpose::{Mechanics, SpeedLoop, Voltages};
        let converters = [
            "siemens-v20",
            "delta-ms300",
            "schneider-atv312",
            "toshiba-vfs11",
            "vacon10",
            "yaskawa-a1000",
            "abb-efb",
        ];
        for name in converters {
            let voltages = refused(name, Purpose::Voltages).unwrap();
            assert!(voltages.contains("takes no armature voltage"), "{voltages}");
            let mechanics = refused(name, Purpose::Mechanics).unwrap();
            assert!(mechanics.contains("speed of the shaft"), "{mechanics}");
            assert!(refused(name, Purpose::SpeedLoop).is_some(), "{name}");
        }
        for (name, purpose, reason) in [
            ("own", Voltages, None),
            ("own", SpeedLoop, None),
            ("own", Mechanics, None),
            ("siemens-v20", SpeedLoop, Some("speed_ref is in %")),
            ("epulse50-dc", SpeedLoop, None),
            ("epulse50-dc", Mechanics, None),
            ("abb-dcs-gateway", SpeedLoop, None),
            ("roboteq-dc", Mechanics, None),
            ("roboteq-dc", Voltages, Some("share of its supply voltage")),
            ("abb-dcs-gateway", Mechanics, Some("gateway does not map")),
        ] {
            let refused = refused(name, purpose);
            let is_right = match (&refused, reason) {
                (Some(refused), Some(reason)) => refused.contains(reason),
                (refused, reason) => refused.is_none() && reason.is_none(),
            };
            assert!(is_right, "{name} {purpose:?}: {refused:?}");
        }
    }

    #[test]
    fn each_channel_has_origin_sign_side_and_delays() {
        let text = DriveProfile::text("epulse50-dc").unwrap().replacen(
            "side = \"terminal\"",
            "side = \"terminal\"\nbasis = \"rms\"\nfilter_ms = 12.0\nupdate_ms = 2.5",
            1,
        );
        let profile = DriveProfile::parse("epulse50-dc", &text).unwrap();
        let current = "measured, signed, terminal side, rms, filter 12 ms, update 2.5 ms (current)";
        let speed = "measured, signed, filter not given, update not given (speed)";
        let expected = [(Channel::Current, current), (Channel::Speed, speed)]
            .map(|(channel, text)| (channel, text.to_owned()));
        assert_eq!(carried(&profile), expected);
        assert_eq!(carried(&DriveProfile::named("own").unwrap()), []);
    }

    #[test]
    fn remarks_name_dead_time_field_sign_and_watchdog() {
        let of = |name| remarks(&DriveProfile::named(name).unwrap()).join("\n");
        for (name, text) in [
            ("abb-dcs-gateway", "four quadrants"),
            ("abb-dcs-gateway", "3.3 ms"),
            ("abb-dcs-gateway", "field_current is read, but limits.field_min_a"),
            ("siemens-v20", "no sign"),
            ("roboteq-dc", "resumes the old one"),
            ("abb-efb", "blind for 30 s"),
            ("delta-ms300", "off as delivered"),
        ] {
            assert!(of(name).contains(text), "{name}: {}", of(name));
        }
        assert_eq!(of("own"), "");
    }
}
