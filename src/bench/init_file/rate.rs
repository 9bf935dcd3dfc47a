//! How often the link can be used: by the line's arithmetic, with a margin for a computer that does other things too.

use super::{InitRequest, Reasoned};
use crate::bench::bench_file::Port;
use crate::drive::{LineBudget, Protocol};

/// Share of the arithmetic rate that is asked for.
const SHARE: f64 = 0.85;
/// Over a network nothing is known beforehand, Hz.
const NETWORK_HZ: f64 = 100.0;
/// What a host without a real-time kernel keeps, Hz.
const HOST_HZ: f64 = 500.0;
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
    let mut rate = (carried_hz, why);
    if let Some(map) = &profile.registers
        && map.rates.fast_hz < rate.0
    {
        rate = (
            map.rates.fast_hz,
            format!(
                "the profile's rates.fast_hz, below the {:.0} Hz that the line would carry",
                rate.0
            ),
        );
    }
    if rate.0 > HOST_HZ {
        rate = (
            HOST_HZ,
            format!("{}; no more than a computer of every day keeps", rate.1),
        );
    }
    let rate_hz = nice(rate.0);
    let mut remarks: Vec<String> = reply.into_iter().collect();
    if rate_hz < 50.0 && request.motor.is_unknown() {
        remarks.push(format!(
            "at {rate_hz} Hz an unknown motor may not be found from small steps: a faster line, or a whole nameplate, is better"
        ));
    }
    Rate {
        hz: rate_hz,
        reason: Reasoned {
            key: "link.rate_hz".to_owned(),
            value: Some(rate_hz),
            reason: rate.1,
        },
        remarks,
    }
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
        for (from, to) in [
            (483.0, 480.0),
            (79.4, 75.0),
            (19.9, 19.0),
            (3.9, 3.5),
            (0.4, 1.0),
        ] {
            assert!((nice(from) - to).abs() < 1e-9, "{from}: {}", nice(from));
        }
    }
}
