//! The rate and every limit, each with its reason: the smallest of what nameplate, profile and drive allow.

use super::{InitRequest, Reasoned};
use crate::bench_file::{BenchFile, LimitsSection, Port};
use crate::limits::{OVER_SPEED_IN_RATED, short};
use drivebench_link::register_map::Quantity;
use drivebench_link::{LineBudget, LostReply};
use drivebench_model::sample::Channel;

/// A value that must not be exceeded, with its origin.
type Bound = Option<(f64, String)>;

fn bound(value: Option<f64>, what: impl FnOnce(f64) -> String) -> Bound {
    value.map(|value| (value, what(value)))
}

/// Every limit but the slew and the time, which follow from the sequence.
pub(super) fn reasons(request: &InitRequest<'_>, bench: &BenchFile) -> Vec<Reasoned> {
    let mut reasons = vec![current(request), speed(request), voltage(request)];
    let free = "the shaft may turn freely; give the angle in rad from that at arming where the load has ends";
    reasons.push(Reasoned::new("limits.travel_rad", None, free));
    reasons.extend(bus(request));
    reasons.push(silence(request, bench));
    reasons
}

/// Puts the values where the bench file has them.
pub(super) fn apply(section: &mut LimitsSection, reasons: &[Reasoned]) {
    for (key, _, slot) in section.rows() {
        let key = format!("limits.{key}");
        if let Some(reason) = reasons.iter().find(|reason| reason.key == key) {
            *slot = reason.value;
        }
    }
}

fn current(request: &InitRequest<'_>) -> Reasoned {
    let rated = request.motor.rated_current_a;
    // A drive for this motor gives twice the rated current for seconds.
    let nameplate =
        bound(Some(2.0 * rated), |_| format!("2.0 x rated current {rated} A (nameplate)"));
    let own = drive_limit(request.readback.current_limit_a, "A");
    let of_profile =
        bound(request.profile.limits.current_a, |value| format!("the profile's limit {value} A"));
    let unread = own.is_none().then(|| unread(request, "its own current limit"));
    smallest("limits.current_a", [nameplate, own, of_profile], unread)
}

fn speed(request: &InitRequest<'_>) -> Reasoned {
    let rated = request.motor.rated_speed_rad_s;
    let nameplate = bound(Some(OVER_SPEED_IN_RATED * rated), |_| {
        format!("{OVER_SPEED_IN_RATED} x rated speed {rated} rad/s (nameplate)")
    });
    let of_profile = bound(request.profile.limits.speed_rad_s, |value| {
        format!("the profile's limit {value:.1} rad/s")
    });
    let of_set_point = bound(largest_set_point(request, Quantity::Speed), |value| {
        format!("the most that the drive's reference takes, {value:.1} rad/s (profile)")
    });
    smallest("limits.speed_rad_s", [nameplate, of_profile, of_set_point], None)
}

fn voltage(request: &InitRequest<'_>) -> Reasoned {
    let nameplate = bound(Some(request.motor.rated_voltage_v), |rated| {
        format!("rated voltage {rated} V (nameplate)")
    });
    let own = drive_limit(request.readback.voltage_limit_v, "V");
    let bus = bound(request.readback.bus_v, |value| {
        format!("the intermediate circuit's {value:.1} V (read back)")
    });
    let of_profile =
        bound(request.profile.limits.voltage_v, |value| format!("the profile's limit {value} V"));
    let of_set_point = bound(largest_set_point(request, Quantity::Voltage), |value| {
        format!("the most that the drive's set-point takes, {value} V (profile)")
    });
    let unread = own.is_none().then(|| unread(request, "its own voltage limit"));
    smallest("limits.voltage_v", [nameplate, own, bus, of_profile, of_set_point], unread)
}

fn drive_limit(value: Option<f64>, unit: &str) -> Bound {
    bound(value, |value| format!("the drive's own limit {value} {unit} (read back)"))
}

fn bus(request: &InitRequest<'_>) -> [Reasoned; 2] {
    const KEYS: [&str; 2] = ["limits.bus_min_v", "limits.bus_max_v"];
    let has_signal = request.profile.signals.get(Channel::Bus).is_some();
    let Some(bus_v) = request.readback.bus_v.filter(|_| has_signal) else {
        let reason = if has_signal {
            unread(request, "the voltage of its intermediate circuit")
        } else {
            "the profile maps no voltage of the intermediate circuit".to_owned()
        };
        return KEYS.map(|key| Reasoned::new(key, None, reason.as_str()));
    };
    let read = format!("x {bus_v:.1} V of the intermediate circuit at rest (read back)");
    let low = format!("0.8 {read}: below it the supply is overloaded");
    let high = format!(
        "1.25 {read}: above it braking energy is not absorbed; lower it to what the drive withstands"
    );
    [
        Reasoned::new(KEYS[0], Some(short(0.8 * bus_v)), low),
        Reasoned::new(KEYS[1], Some(short(1.25 * bus_v)), high),
    ]
}

fn silence(request: &InitRequest<'_>, bench: &BenchFile) -> Reasoned {
    let mapped = request.profile.registers.as_ref();
    // A mapped drive is read in several requests, each of which may be repeated.
    let least_s = mapped.map_or(0.1, |_| 0.5_f64);
    // A lost reply with its repetition is no lost link.
    let lost_s = LostReply::of(request.profile).map_or(0.0, |lost| lost.total_s());
    let least_s = least_s.max((100.0 * lost_s).ceil() * 0.01);
    let cycles_s = (3.0 * bench.period_s()).max(least_s);
    let set_s = mapped.and_then(|map| map.watchdog.set_s());
    let default_ms = request.profile.watchdog.default_ms;
    // The value of the profile is set before anything is energised.
    let (source, watchdog_s) = match (set_s, request.readback.watchdog_s, default_ms) {
        (Some(set_s), _, _) => ("set by the profile, watchdog.set_ms", Some(set_s)),
        (None, Some(read_s), _) => ("read back", Some(read_s)),
        (None, None, Some(default_ms)) => ("as delivered, not read back", Some(1e-3 * default_ms)),
        (None, None, None) => ("", None),
    };
    let cycles = format!("three cycles, at least {least_s} s");
    let (value, reason) = match watchdog_s.filter(|time_s| *time_s > 0.0) {
        Some(watchdog_s) if 0.9 * watchdog_s >= cycles_s => (
            (0.9 * watchdog_s).min(1.0),
            format!(
                "below the drive's watchdog of {watchdog_s} s ({source}): the host ends a run before the drive has to"
            ),
        ),
        Some(watchdog_s) => (
            cycles_s,
            format!(
                "{cycles}; the drive's watchdog of {watchdog_s} s ({source}) stops the motor before that"
            ),
        ),
        None => (cycles_s, format!("{cycles}; no time of a watchdog is known to compare with")),
    };
    Reasoned::new("limits.link_silence_s", Some(short(value)), reason)
}

/// The range of a set-point, SI.
pub(super) fn set_point(request: &InitRequest<'_>, quantity: Quantity) -> Option<(f64, f64)> {
    let point = request.profile.registers.as_ref()?.demand(quantity)?;
    let ([low, high], si) = (point.keys.limits?, point.si?);
    Some((low * si, high * si))
}

/// Why a value of the drive is not known.
fn unread(request: &InitRequest<'_>, what: &str) -> String {
    if request.readback.is_offline {
        format!("{what} was not read back (--offline)")
    } else {
        format!("the drive does not report {what}")
    }
}

fn largest_set_point(request: &InitRequest<'_>, quantity: Quantity) -> Option<f64> {
    set_point(request, quantity).map(|(_, high)| high)
}

fn smallest<const N: usize>(key: &str, bounds: [Bound; N], unread: Option<String>) -> Reasoned {
    let bounds: Vec<(f64, String)> = bounds.into_iter().flatten().collect();
    let value = bounds.iter().map(|(value, _)| *value).fold(f64::INFINITY, f64::min);
    let names: Vec<&str> = bounds.iter().map(|(_, what)| what.as_str()).collect();
    let mut reason = match names.as_slice() {
        [one] => (*one).to_owned(),
        [one, other] => format!("smaller of {one} and {other}"),
        [others @ .., last] => format!("smallest of {} and {last}", others.join(", ")),
        [] => String::new(),
    };
    if let Some(unread) = unread {
        reason = format!("{reason}; {unread}");
    }
    Reasoned::new(key, Some(short(value)), reason)
}

/// The rate of the link: by the arithmetic of the line, with a margin for a busy host.
pub(super) struct Rate {
    pub(super) hz: f64,
    pub(super) reason: Reasoned,
    pub(super) remarks: Vec<String>,
}

pub(super) fn rate(request: &InitRequest<'_>) -> Rate {
    let profile = request.profile;
    let is_network = matches!(Port::parse(request.port), Some(Port::Tcp(_)))
        || profile.link.protocol.is_network();
    let budget = (!is_network).then(|| LineBudget::of(profile)).flatten();
    let reply = budget.as_ref().and_then(LineBudget::reply_text);
    let line_hz = budget.map(|budget| budget.usual_rate_hz());
    let (carried_hz, why) = match (line_hz, &profile.registers) {
        (Some(hz), _) => (
            0.85 * hz,
            format!(
                "the line carries {hz:.0} Hz by arithmetic ({} over {} at {} baud, an adapter of 1.2 ms); 85 % of it",
                if profile.registers.is_some() {
                    "the fast signals and one set-point"
                } else {
                    "one exchange"
                },
                profile.link.protocol.name(),
                profile.link.baud
            ),
        ),
        (None, Some(map)) => (map.rates.fast_hz, "the profile's rates.fast_hz".to_owned()),
        (None, None) => (
            100.0,
            "the rate of a network cannot be computed: `drivebench run` measures the round trip before it begins"
                .to_owned(),
        ),
    };
    let (mut hz, mut why) = (carried_hz, why);
    if let Some(map) = &profile.registers
        && map.rates.fast_hz < hz
    {
        why =
            format!("the profile's rates.fast_hz, below the {hz:.0} Hz that the line would carry");
        hz = map.rates.fast_hz;
    }
    if hz > 500.0 {
        hz = 500.0;
        why += "; no more than a host without a real-time kernel keeps";
    }
    let rate_hz = rounded_down(hz);
    let mut remarks: Vec<String> = reply.into_iter().collect();
    if rate_hz < 50.0 && request.motor.is_unknown() {
        remarks.push(format!(
            "at {rate_hz} Hz an unknown motor may not be found from small steps: a faster line, or a whole nameplate, is better"
        ));
    }
    Rate { hz: rate_hz, reason: Reasoned::new("link.rate_hz", Some(rate_hz), why), remarks }
}

/// A round number at or below.
fn rounded_down(rate_hz: f64) -> f64 {
    let step = match rate_hz {
        100.0.. => 10.0,
        20.0.. => 5.0,
        4.0.. => 1.0,
        _ => 0.5,
    };
    ((rate_hz / step + 1e-9).floor() * step).max(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_are_round_and_never_above() {
        let rates = [483.0, 79.4, 19.9, 3.9, 0.4].map(|hz| rounded_down(hz).to_string());
        assert_eq!(rates, ["480", "75", "19", "3.5", "1"]);
    }
}
