//! Every limit and its reason: the smallest of what the plate, the profile and the drive itself allow.

use super::{InitRequest, Reasoned, short};
use crate::bench::bench_file::{BenchFile, LimitsSection};
use crate::drive::LostReply;
use crate::drive::register_map::Quantity;
use crate::sample::Channel;

/// Current that an excitation may draw for seconds, in rated currents: what the drive of such a motor gives.
const CURRENT_IN_RATED: f64 = 2.0;
/// Over-speed, in rated speeds: below the usual mechanical test speed.
const SPEED_IN_RATED: f64 = 1.25;
/// Where the intermediate circuit may go from its voltage at rest.
const BUS_LOW: f64 = 0.8;
const BUS_HIGH: f64 = 1.25;
/// Share of the drive's watchdog after which the host ends a run by itself.
const OF_WATCHDOG: f64 = 0.9;
/// Silence without a watchdog to compare with: three cycles, and not below this, s (LINKS.md 5.2).
const LEAST_SILENCE_S: f64 = 0.1;
/// The same for a drive that is read in several requests, each of which may be repeated, s.
const LEAST_MAPPED_SILENCE_S: f64 = 0.5;
const LONGEST_SILENCE_S: f64 = 1.0;

/// A value that must not be exceeded, and whose it is.
struct Bound {
    value: f64,
    what: String,
}

/// Every limit but the slew and the time, which follow from the sequence.
pub(super) fn reasons(request: &InitRequest<'_>, bench: &BenchFile) -> Vec<Reasoned> {
    let mut reasons = vec![current(request), speed(request), voltage(request)];
    reasons.push(Reasoned {
        key: "limits.travel_rad".to_owned(),
        value: None,
        reason: "the shaft may turn freely; give the angle in rad from that at arming where the load has ends"
            .to_owned(),
    });
    reasons.extend(bus(request));
    reasons.push(silence(request, bench));
    reasons
}

/// Puts the values where the bench file has them.
pub(super) fn apply(section: &mut LimitsSection, reasons: &[Reasoned]) {
    for reason in reasons {
        let slot = match reason.key.as_str() {
            "limits.current_a" => &mut section.current_a,
            "limits.speed_rad_s" => &mut section.speed_rad_s,
            "limits.voltage_v" => &mut section.voltage_v,
            "limits.bus_min_v" => &mut section.bus_min_v,
            "limits.bus_max_v" => &mut section.bus_max_v,
            "limits.link_silence_s" => &mut section.link_silence_s,
            "limits.slew_v_per_s" => &mut section.slew_v_per_s,
            "limits.time_s" => &mut section.time_s,
            _ => continue,
        };
        *slot = reason.value;
    }
}

fn current(request: &InitRequest<'_>) -> Reasoned {
    let rated = request.motor.rated_current_a;
    let plate = Bound {
        value: CURRENT_IN_RATED * rated,
        what: format!("{CURRENT_IN_RATED:.1} x rated current {rated} A (nameplate)"),
    };
    let own = request.told.current_limit_a.map(|value| Bound {
        value,
        what: format!("the drive's own limit {value} A (read back)"),
    });
    let profiled = request.profile.limits.current_a.map(|value| Bound {
        value,
        what: format!("the profile's limit {value} A"),
    });
    let untold = own
        .is_none()
        .then(|| untold(request, "its own current limit"));
    least("limits.current_a", [Some(plate), own, profiled], untold)
}

fn speed(request: &InitRequest<'_>) -> Reasoned {
    let rated = request.motor.rated_speed_rad_s;
    let plate = Bound {
        value: SPEED_IN_RATED * rated,
        what: format!("{SPEED_IN_RATED} x rated speed {rated} rad/s (nameplate)"),
    };
    let profiled = request.profile.limits.speed_rad_s.map(|value| Bound {
        value,
        what: format!("the profile's limit {value:.1} rad/s"),
    });
    let told = set_point(request, Quantity::Speed).map(|(_, high)| Bound {
        value: high,
        what: format!("the most that the drive's reference takes, {high:.1} rad/s (profile)"),
    });
    least("limits.speed_rad_s", [Some(plate), profiled, told], None)
}

fn voltage(request: &InitRequest<'_>) -> Reasoned {
    let rated = request.motor.rated_voltage_v;
    let plate = Bound {
        value: rated,
        what: format!("rated voltage {rated} V (nameplate)"),
    };
    let told = &request.told;
    let own = told.voltage_limit_v.map(|value| Bound {
        value,
        what: format!("the drive's own limit {value} V (read back)"),
    });
    let bus = told.bus_v.map(|value| Bound {
        value,
        what: format!("the intermediate circuit's {value:.1} V (read back)"),
    });
    let profiled = request.profile.limits.voltage_v.map(|value| Bound {
        value,
        what: format!("the profile's limit {value} V"),
    });
    let taken = set_point(request, Quantity::Voltage).map(|(_, high)| Bound {
        value: high,
        what: format!("the most that the drive's set-point takes, {high} V (profile)"),
    });
    let untold = own
        .is_none()
        .then(|| untold(request, "its own voltage limit"));
    least(
        "limits.voltage_v",
        [Some(plate), own, bus, profiled, taken],
        untold,
    )
}

fn bus(request: &InitRequest<'_>) -> [Reasoned; 2] {
    let has_signal = request.profile.signals.get(Channel::Bus).is_some();
    let of = |key: &str, value, reason: &str| Reasoned {
        key: key.to_owned(),
        value,
        reason: reason.to_owned(),
    };
    let Some(bus_v) = request.told.bus_v.filter(|_| has_signal) else {
        let reason = if has_signal {
            untold(request, "the voltage of its intermediate circuit")
        } else {
            "the profile maps no voltage of the intermediate circuit".to_owned()
        };
        return [
            of("limits.bus_min_v", None, &reason),
            of("limits.bus_max_v", None, &reason),
        ];
    };
    let read = format!("x {bus_v:.1} V of the intermediate circuit at rest (read back)");
    [
        of(
            "limits.bus_min_v",
            Some(short(BUS_LOW * bus_v)),
            &format!("{BUS_LOW} {read}: below it the supply gives way"),
        ),
        of(
            "limits.bus_max_v",
            Some(short(BUS_HIGH * bus_v)),
            &format!(
                "{BUS_HIGH} {read}: above it braking energy has nowhere to go; lower it to what the drive stands"
            ),
        ),
    ]
}

fn silence(request: &InitRequest<'_>, bench: &BenchFile) -> Reasoned {
    let least_s = if request.profile.registers.is_some() {
        LEAST_MAPPED_SILENCE_S
    } else {
        LEAST_SILENCE_S
    };
    // A lost reply that is asked for again is no lost link.
    let lost_s = LostReply::of(request.profile).map_or(0.0, |lost| lost.total_s());
    let least_s = least_s.max((100.0 * lost_s).ceil() * 0.01);
    let cycles_s = (3.0 * bench.period_s()).max(least_s);
    let set_s = request.profile.registers.as_ref();
    let set_s = set_s.and_then(|map| map.watchdog.set_s());
    let default_ms = request.profile.watchdog.default_ms;
    // What the profile sets is in force whenever anything is energised, whatever the drive holds now.
    let (source, watchdog_s) = match (set_s, request.told.watchdog_s, default_ms) {
        (Some(set_s), _, _) => ("set by the profile, watchdog.set_ms", Some(set_s)),
        (None, Some(read_s), _) => ("read back", Some(read_s)),
        (None, None, Some(default_ms)) => ("as delivered, not read back", Some(1e-3 * default_ms)),
        (None, None, None) => ("", None),
    };
    let (value, reason) = match watchdog_s.filter(|time_s| *time_s > 0.0) {
        Some(watchdog_s) if OF_WATCHDOG * watchdog_s >= cycles_s => (
            (OF_WATCHDOG * watchdog_s).min(LONGEST_SILENCE_S),
            format!(
                "below the drive's watchdog of {watchdog_s} s ({source}): the host ends a run before the drive has to"
            ),
        ),
        Some(watchdog_s) => (
            cycles_s,
            format!(
                "three cycles, at least {least_s} s; the drive's watchdog of {watchdog_s} s ({source}) stops the motor before that"
            ),
        ),
        None => (
            cycles_s,
            format!(
                "three cycles, at least {least_s} s; no time of a watchdog is known to compare with"
            ),
        ),
    };
    Reasoned {
        key: "limits.link_silence_s".to_owned(),
        value: Some(short(value)),
        reason,
    }
}

/// The range of a set-point, SI.
pub(super) fn set_point(request: &InitRequest<'_>, quantity: Quantity) -> Option<(f64, f64)> {
    let map = request.profile.registers.as_ref()?;
    let point = map.demand(quantity)?;
    let ([low, high], si) = (point.keys.limits?, point.si?);
    Some((low * si, high * si))
}

/// Why something is not known of the drive.
fn untold(request: &InitRequest<'_>, what: &str) -> String {
    if request.told.is_offline {
        format!("{what} was not read back (--offline)")
    } else {
        format!("the drive does not tell {what}")
    }
}

fn least<const N: usize>(
    key: &str,
    bounds: [Option<Bound>; N],
    untold: Option<String>,
) -> Reasoned {
    let bounds: Vec<Bound> = bounds.into_iter().flatten().collect();
    let value = bounds
        .iter()
        .map(|bound| bound.value)
        .fold(f64::INFINITY, f64::min);
    let names: Vec<&str> = bounds.iter().map(|bound| bound.what.as_str()).collect();
    let mut reason = match names.as_slice() {
        [one] => (*one).to_owned(),
        [one, other] => format!("smaller of {one} and {other}"),
        [others @ .., last] => format!("smallest of {} and {last}", others.join(", ")),
        [] => String::new(),
    };
    if let Some(untold) = untold {
        reason = format!("{reason}; {untold}");
    }
    Reasoned {
        key: key.to_owned(),
        value: Some(short(value)),
        reason,
    }
}
