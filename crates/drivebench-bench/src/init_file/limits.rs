//! The rate and every limit, each with its reason: the smallest of what the plate, the profile and the drive itself allow.

use super::{InitRequest, Reasoned, short};
use crate::bench_file::{BenchFile, LimitsSection, Port};
use drivebench_link::register_map::Quantity;
use drivebench_link::{LineBudget, LostReply, Protocol};
use drivebench_model::sample::Channel;

/// Current that an excitation may draw for seconds, in rated currents: what the drive of such a motor gives.
const CURRENT_IN_RATED: f64 = 2.0;
/// Over-speed, in rated speeds: below the usual mechanical test speed.
const SPEED_IN_RATED: f64 = 1.25;
/// Where the intermediate circuit may go from its voltage at rest.
const BUS_LOW: f64 = 0.8;
const BUS_HIGH: f64 = 1.25;
/// Share of the drive's watchdog after which the host ends a run by itself.
const OF_WATCHDOG: f64 = 0.9;
/// Silence without a watchdog to compare with: three cycles, and not below this, s.
const LEAST_SILENCE_S: f64 = 0.1;
/// The same for a drive that is read in several requests, each of which may be repeated, s.
const LEAST_MAPPED_SILENCE_S: f64 = 0.5;
const LONGEST_SILENCE_S: f64 = 1.0;

/// A value that must not be exceeded, and whose it is.
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
    let plate = bound(Some(CURRENT_IN_RATED * rated), |_| {
        format!("{CURRENT_IN_RATED:.1} x rated current {rated} A (nameplate)")
    });
    let own = own_limit(request.told.current_limit_a, "A");
    let profiled =
        bound(request.profile.limits.current_a, |value| format!("the profile's limit {value} A"));
    let untold = untold_limit(request, &own, "its own current limit");
    least("limits.current_a", [plate, own, profiled], untold)
}

fn speed(request: &InitRequest<'_>) -> Reasoned {
    let rated = request.motor.rated_speed_rad_s;
    let plate = bound(Some(SPEED_IN_RATED * rated), |_| {
        format!("{SPEED_IN_RATED} x rated speed {rated} rad/s (nameplate)")
    });
    let profiled = bound(request.profile.limits.speed_rad_s, |value| {
        format!("the profile's limit {value:.1} rad/s")
    });
    let taken = bound(most(request, Quantity::Speed), |value| {
        format!("the most that the drive's reference takes, {value:.1} rad/s (profile)")
    });
    least("limits.speed_rad_s", [plate, profiled, taken], None)
}

fn voltage(request: &InitRequest<'_>) -> Reasoned {
    let plate = bound(Some(request.motor.rated_voltage_v), |rated| {
        format!("rated voltage {rated} V (nameplate)")
    });
    let own = own_limit(request.told.voltage_limit_v, "V");
    let bus = bound(request.told.bus_v, |value| {
        format!("the intermediate circuit's {value:.1} V (read back)")
    });
    let profiled =
        bound(request.profile.limits.voltage_v, |value| format!("the profile's limit {value} V"));
    let taken = bound(most(request, Quantity::Voltage), |value| {
        format!("the most that the drive's set-point takes, {value} V (profile)")
    });
    let untold = untold_limit(request, &own, "its own voltage limit");
    let bounds = [plate, own, bus, profiled, taken];
    least("limits.voltage_v", bounds, untold)
}

fn own_limit(value: Option<f64>, unit: &str) -> Bound {
    bound(value, |value| format!("the drive's own limit {value} {unit} (read back)"))
}

fn untold_limit(request: &InitRequest<'_>, own: &Bound, what: &str) -> Option<String> {
    own.is_none().then(|| untold(request, what))
}

fn bus(request: &InitRequest<'_>) -> [Reasoned; 2] {
    const KEYS: [&str; 2] = ["limits.bus_min_v", "limits.bus_max_v"];
    let has_signal = request.profile.signals.get(Channel::Bus).is_some();
    let Some(bus_v) = request.told.bus_v.filter(|_| has_signal) else {
        let reason = if has_signal {
            untold(request, "the voltage of its intermediate circuit")
        } else {
            "the profile maps no voltage of the intermediate circuit".to_owned()
        };
        return KEYS.map(|key| Reasoned::new(key, None, reason.as_str()));
    };
    let read = format!("x {bus_v:.1} V of the intermediate circuit at rest (read back)");
    let low = format!("{BUS_LOW} {read}: below it the supply gives way");
    let high = format!(
        "{BUS_HIGH} {read}: above it braking energy has nowhere to go; lower it to what the drive stands"
    );
    [
        Reasoned::new(KEYS[0], Some(short(BUS_LOW * bus_v)), low),
        Reasoned::new(KEYS[1], Some(short(BUS_HIGH * bus_v)), high),
    ]
}

fn silence(request: &InitRequest<'_>, bench: &BenchFile) -> Reasoned {
    let mapped = request.profile.registers.as_ref();
    let least_s = mapped.map_or(LEAST_SILENCE_S, |_| LEAST_MAPPED_SILENCE_S);
    // A lost reply that is asked for again is no lost link.
    let lost_s = LostReply::of(request.profile).map_or(0.0, |lost| lost.total_s());
    let least_s = least_s.max((100.0 * lost_s).ceil() * 0.01);
    let cycles_s = (3.0 * bench.period_s()).max(least_s);
    let set_s = mapped.and_then(|map| map.watchdog.set_s());
    let default_ms = request.profile.watchdog.default_ms;
    // What the profile sets is in force whenever anything is energised, whatever the drive holds now.
    let (source, watchdog_s) = match (set_s, request.told.watchdog_s, default_ms) {
        (Some(set_s), _, _) => ("set by the profile, watchdog.set_ms", Some(set_s)),
        (None, Some(read_s), _) => ("read back", Some(read_s)),
        (None, None, Some(default_ms)) => ("as delivered, not read back", Some(1e-3 * default_ms)),
        (None, None, None) => ("", None),
    };
    let cycles = format!("three cycles, at least {least_s} s");
    let (value, reason) = match watchdog_s.filter(|time_s| *time_s > 0.0) {
        Some(watchdog_s) if OF_WATCHDOG * watchdog_s >= cycles_s => (
            (OF_WATCHDOG * watchdog_s).min(LONGEST_SILENCE_S),
            format!(
                "below the drive's watchdog of {watchdog_s} s ({source}): the host ends a run before the drive has to"
            ),
        ),
        Some(watchdog_s) => {
            let why = format!(
                "the drive's watchdog of {watchdog_s} s ({source}) stops the motor before that"
            );
            (cycles_s, format!("{cycles}; {why}"))
        }
        None => {
            let why = "no time of a watchdog is known to compare with";
            (cycles_s, format!("{cycles}; {why}"))
        }
    };
    Reasoned::new("limits.link_silence_s", Some(short(value)), reason)
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

/// The most that a set-point takes, SI.
fn most(request: &InitRequest<'_>, quantity: Quantity) -> Option<f64> {
    set_point(request, quantity).map(|(_, high)| high)
}

fn least<const N: usize>(key: &str, bounds: [Bound; N], untold: Option<String>) -> Reasoned {
    let bounds: Vec<(f64, String)> = bounds.into_iter().flatten().collect();
    let values = bounds.iter().map(|(value, _)| *value);
    let value = values.fold(f64::INFINITY, f64::min);
    let names: Vec<&str> = bounds.iter().map(|(_, what)| what.as_str()).collect();
    let mut reason = match names.as_slice() {
        [one] => (*one).to_owned(),
        [one, other] => format!("smaller of {one} and {other}"),
        [others @ .., last] => format!("smallest of {} and {last}", others.join(", ")),
        [] => String::new(),
    };
    if let Some(untold) = untold {
        reason = format!("{reason}; {untold}");
    }
    Reasoned::new(key, Some(short(value)), reason)
}

/// Share of the arithmetic rate that is asked for.
const SHARE: f64 = 0.85;
/// Over a network nothing is known beforehand, Hz.
const NETWORK_HZ: f64 = 100.0;
/// What a host without a real-time kernel keeps, Hz.
const HOST_HZ: f64 = 500.0;

/// How often the link can be used: by the line's arithmetic, with a margin for a computer that does other things too.
pub(super) struct Rate {
    pub(super) hz: f64,
    pub(super) reason: Reasoned,
    pub(super) remarks: Vec<String>,
}

pub(super) fn rate(request: &InitRequest<'_>) -> Rate {
    let profile = request.profile;
    let is_network = matches!(Port::parse(request.port), Some(Port::Tcp(_)))
        || profile.link.protocol == Protocol::ModbusTcp;
    let budget = (!is_network).then(|| LineBudget::of(profile)).flatten();
    let reply = budget.as_ref().and_then(LineBudget::reply_text);
    let line_hz = budget.map(|budget| budget.usual_rate_hz());
    let (carried_hz, why) = match (line_hz, &profile.registers) {
        (Some(hz), _) => (
            SHARE * hz,
            format!(
                "the line carries {hz:.0} Hz by arithmetic ({} over {} at {} baud, an adapter of 1.2 ms); {:.0} % of it",
                if profile.registers.is_some() {
                    "the fast signals and one set-point"
                } else {
                    "one exchange"
                },
                profile.link.protocol.name(),
                profile.link.baud,
                100.0 * SHARE
            ),
        ),
        (None, Some(map)) => (map.rates.fast_hz, "the profile's rates.fast_hz".to_owned()),
        (None, None) => (
            NETWORK_HZ,
            "a network has no arithmetic: `drivebench run` measures the round trip before it begins"
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
    if hz > HOST_HZ {
        hz = HOST_HZ;
        why += "; no more than a computer of every day keeps";
    }
    let rate_hz = nice(hz);
    let mut remarks: Vec<String> = reply.into_iter().collect();
    if rate_hz < 50.0 && request.motor.is_unknown() {
        remarks.push(format!(
            "at {rate_hz} Hz an unknown motor may not be found from small steps: a faster line, or a whole nameplate, is better"
        ));
    }
    Rate { hz: rate_hz, reason: Reasoned::new("link.rate_hz", Some(rate_hz), why), remarks }
}

/// A round number at or below.
fn nice(rate_hz: f64) -> f64 {
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
        let rates = [483.0, 79.4, 19.9, 3.9, 0.4].map(|hz| nice(hz).to_string());
        assert_eq!(rates, ["480", "75", "19", "3.5", "1"]);
    }
}
