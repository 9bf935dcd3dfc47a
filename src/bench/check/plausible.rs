//! Whether voltage, current and speed of the pulse fit the nameplate, as `u = R i + Ke w`. Pure.
//!
//! ```text
//! last samples before the shaft turns: u/i -> R           then the same with w: (u - u at rest - R (i - i at rest))/w -> Ke
//! ```
//!
//! Each with the doubt of a small pulse, and a generous factor beside it: what lies outside with all of its interval is
//! no tolerance but another unit or another motor. The friction's current is the same before and after it breaks away,
//! so drops of brushes and bridge cancel out of Ke.

use super::direction::Known;
use super::pulse::{Kind, Leg, Point};
use crate::units::rpm_from_rad_s;

/// A value may be so many times the nameplate's, or that part of it.
const FACTOR: f64 = 3.0;
/// Doubt of a voltage for drops that depend on nothing, and of a difference of two, as shares of the rated voltage.
const DROP_SHARE: f64 = 0.015;
const DIFFERENCE_SHARE: f64 = 0.003;
/// Doubt of the nameplate's resistance where a difference of currents is multiplied with it, and where a current is.
const RESISTANCE_DOUBT: f64 = 0.3;
const NOISE_FACTOR: f64 = 3.0;
/// Samples that are averaged.
const AVERAGED: usize = 2;
/// A ratio this close to that of two units, as a factor, is named.
const NEAR: f64 = 1.8;

/// What was found of one of the two.
struct Ratio {
    name: &'static str,
    unit: &'static str,
    plate: f64,
    /// Of the nameplate's value: lowest, likeliest, highest.
    interval: (f64, f64, f64),
}

impl Ratio {
    fn text(&self) -> String {
        let (low, value, high) = self.interval;
        let Self {
            name, unit, plate, ..
        } = self;
        if low < 1.0 / FACTOR && high > FACTOR {
            return format!("the {name} cannot be told at this size (nameplate {plate} {unit})");
        }
        format!(
            "{name} {:.3} {unit} ({low:.2} to {high:.2} times the nameplate's {plate})",
            value * plate
        )
    }

    fn is_refused(&self) -> bool {
        let (low, _, high) = self.interval;
        low > FACTOR || high < 1.0 / FACTOR
    }

    /// Which mistake of units would explain it.
    fn suspicion(&self) -> String {
        let ratio = self.interval.1;
        let rpm = rpm_from_rad_s(1.0);
        let mistakes: &[(f64, &str)] = match self.name {
            RESISTANCE => &[
                (
                    1e3,
                    "a current in A that is taken for mA, or milliohm on the nameplate",
                ),
                (1e-3, "a current in mA that is taken for A"),
            ],
            _ => &[
                (
                    rpm,
                    "V per r/min on the nameplate instead of V.s/rad, or a speed in rad/s that is taken for r/min",
                ),
                (1.0 / rpm, "a speed in r/min that is taken for rad/s"),
                (
                    1e-3 * rpm,
                    "V per 1000 r/min on the nameplate instead of V.s/rad",
                ),
                (1e3, "mV on the nameplate"),
            ],
        };
        let near = mistakes
            .iter()
            .map(|(factor, text)| ((ratio / factor).ln().abs(), *factor, *text))
            .filter(|(distance, ..)| *distance < NEAR.ln())
            .min_by(|a, b| a.0.total_cmp(&b.0));
        match near {
            Some((_, factor, text)) => {
                format!("a mistake of units by the factor {factor:.3} would explain it: {text}")
            }
            None => {
                "no usual mistake of units explains it: the nameplate may be that of another motor"
                    .to_owned()
            }
        }
    }
}

const RESISTANCE: &str = "resistance";
const BACK_EMF: &str = "back-EMF constant";

/// Means of some samples, magnitudes along the direction of the pulse.
#[derive(Clone, Copy, Debug)]
struct Mean {
    voltage_v: f64,
    current_a: f64,
    speed_rad_s: f64,
    /// Largest step of the voltage into one of the samples: the winding's current may not have followed it yet.
    step_v: f64,
}

impl Mean {
    const ZERO: Self = Self {
        voltage_v: 0.0,
        current_a: 0.0,
        speed_rad_s: 0.0,
        step_v: 0.0,
    };
}

/// Voltage before a pulse, V.
fn rest_v(known: &Known<'_>) -> f64 {
    if known.size.kind == Kind::Voltage {
        known.size.hold
    } else {
        0.0
    }
}

/// Of the last of the points.
fn mean(known: &Known<'_>, direction: f64, points: &[Point]) -> Option<Mean> {
    let from = points.len().saturating_sub(AVERAGED);
    let before = |k: usize| {
        k.checked_sub(1)
            .map_or(Some(rest_v(known)), |k| points[k].voltage_v)
    };
    let step_v = (from..points.len())
        .filter_map(|k| Some((points[k].voltage_v? - before(k)?).abs()))
        .fold(0.0, f64::max);
    let points = &points[from..];
    let rows: Vec<(f64, f64, f64)> = points
        .iter()
        .filter_map(|p| Some((p.voltage_v?, p.current_a? - known.current.0, p.speed_rad_s?)))
        .collect();
    let n = rows.len() as f64;
    let of =
        |value: fn(&(f64, f64, f64)) -> f64| direction * rows.iter().map(value).sum::<f64>() / n;
    // A current without a sign is a magnitude already.
    let current_a = if known.signed_current {
        of(|row| row.1)
    } else {
        direction * of(|row| row.1)
    };
    (!rows.is_empty()).then(|| Mean {
        voltage_v: of(|row| row.0),
        current_a,
        speed_rad_s: of(|row| row.2) - direction * known.speed.0,
        step_v,
    })
}

/// The last samples at rest and the last ones in motion of one way.
fn ends(known: &Known<'_>, leg: &Leg) -> (Option<Mean>, Option<Mean>) {
    let moves = |point: &Point| {
        point
            .speed_rad_s
            .is_some_and(|w| (w - known.speed.0).abs() > known.moved_rad_s())
    };
    let first = leg.points.iter().position(moves);
    let rest = &leg.points[..first.unwrap_or(leg.points.len())];
    let rest = mean(known, leg.direction, rest);
    let motion = first.and_then(|_| mean(known, leg.direction, &leg.points));
    (
        rest.filter(|mean| mean.voltage_v > 0.0 && mean.current_a.abs() > known.flowed_a()),
        motion,
    )
}

fn interval(value: f64, doubt: f64, by: f64, by_doubt: f64) -> (f64, f64, f64) {
    let (value, by) = (value.max(0.0), by.max(1e-12));
    let low = (value - doubt).max(0.0) / (by + by_doubt);
    let high = if by > by_doubt {
        (value + doubt) / (by - by_doubt)
    } else {
        f64::INFINITY
    };
    (low, value / by, high)
}

/// What one way says about the two.
fn ratios(known: &Known<'_>, leg: &Leg) -> Vec<Ratio> {
    let plate = known.plate;
    let (r, ke) = (plate.resistance_ohm, plate.back_emf_v_s_per_rad);
    let noise_a = NOISE_FACTOR * known.current.1 / (AVERAGED as f64).sqrt();
    let noise_rad_s = NOISE_FACTOR * known.speed.1 / (AVERAGED as f64).sqrt();
    let (rest, motion) = ends(known, leg);
    let mut ratios = Vec::new();
    if let Some(rest) = rest {
        let drop_v = DROP_SHARE * plate.rated_voltage_v;
        ratios.push(Ratio {
            name: RESISTANCE,
            unit: "ohm",
            plate: r,
            interval: interval(
                rest.voltage_v,
                drop_v + rest.step_v,
                r * rest.current_a.abs(),
                r * noise_a,
            ),
        });
    }
    if let Some(motion) = motion {
        let (from, share) = rest.map_or((Mean::ZERO, DROP_SHARE), |rest| (rest, DIFFERENCE_SHARE));
        let change_a = motion.current_a - from.current_a;
        let emf_v = motion.voltage_v - from.voltage_v - r * change_a;
        let doubt_v = from.step_v
            + motion.step_v
            + share * plate.rated_voltage_v
            + r * (RESISTANCE_DOUBT * change_a.abs() + noise_a);
        ratios.push(Ratio {
            name: BACK_EMF,
            unit: "V.s/rad",
            plate: ke,
            interval: interval(
                emf_v,
                doubt_v,
                ke * (motion.speed_rad_s - from.speed_rad_s).abs(),
                ke * noise_rad_s,
            ),
        });
    }
    ratios
}

/// A drive that takes a speed: whether it turns at about the speed that was asked.
fn followed(known: &Known<'_>, leg: &Leg) -> Option<(String, bool)> {
    let last = leg
        .points
        .last()
        .filter(|_| known.size.kind == Kind::Speed)?;
    let speed = (last.speed_rad_s? - known.speed.0).abs();
    let ratio = speed / last.asked.abs();
    let text = format!(
        "{:.2} rad/s asked, {speed:.2} rad/s measured",
        last.asked.abs()
    );
    Some((text, (1.0 / FACTOR..=FACTOR).contains(&ratio)))
}

/// What a speed that is not the one that was asked may come from.
fn question(known: &Known<'_>, leg: &Leg) -> Option<String> {
    let last = leg.points.last()?;
    let name = known.set_point.unwrap_or("the speed's set-point");
    Some(format!(
        "asked {:.2} rad/s, got {:.2} rad/s: is the word order or scale of {name} right? (its unit too: 1 rad/s is {:.2} r/min)",
        last.asked,
        last.speed_rad_s?,
        rpm_from_rad_s(1.0)
    ))
}

/// Why a pulse of speed was given up: the last sample was far from what was asked.
pub(super) fn astray(known: &Known<'_>, legs: &[Leg]) -> Option<String> {
    question(known, legs.last()?)
}

/// What was found, and why it is refused.
pub(super) fn judge(known: &Known<'_>, legs: &[Leg]) -> (String, Option<String>) {
    let mut texts = Vec::new();
    let mut refusal = None;
    for leg in legs {
        let way = if leg.direction > 0.0 {
            "forward"
        } else {
            "back"
        };
        for ratio in ratios(known, leg) {
            let text = ratio.text();
            if ratio.is_refused() && refusal.is_none() {
                refusal = Some(format!("{text}; {}", ratio.suspicion()));
            }
            texts.push(format!("{way} {text}"));
        }
        if let Some((text, good)) = followed(known, leg) {
            if !good && refusal.is_none() {
                refusal = question(known, leg);
            }
            texts.push(format!("{way} {text}"));
        }
    }
    if texts.is_empty() {
        texts.push(
            "cannot be told at this size: voltage, current and speed are not all there".to_owned(),
        );
    }
    (texts.join("; "), refusal)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::check::pulse::Size;
    use crate::bench::limits::{Limits, Nameplate};
    use crate::bench::testing::has;
    use crate::sample::{Channel, Demand, Sample};

    /// The paper's motor in a slow pulse, as its sensors tell it with these factors; judged by `plate`.
    fn judged(
        plate: &Nameplate,
        current_factor: f64,
        speed_factor: f64,
        drop_v: f64,
    ) -> (String, String) {
        let truth = Nameplate::zk_22fc();
        let limits = Limits::for_motor(&truth, 100.0);
        let size = Size::of(plate, &limits, Demand::Voltage(0.0), 0.15, 0.01);
        let mut leg = Leg::new(1.0);
        for step in 1..60 {
            let volts = 0.1 * f64::from(step);
            let friction_a = truth.load_torque_n_m / truth.back_emf_v_s_per_rad;
            let free_a = (volts - drop_v).max(0.0) / truth.resistance_ohm;
            let current_a = free_a.min(friction_a);
            let emf_v = (volts - drop_v - truth.resistance_ohm * current_a).max(0.0);
            let sample = Sample::at(0.0)
                .with(Channel::Voltage, volts)
                .with(Channel::Current, current_factor * current_a)
                .with(
                    Channel::Speed,
                    speed_factor * emf_v / truth.back_emf_v_s_per_rad,
                );
            leg.push(&size, volts, &sample);
            if speed_factor * emf_v / truth.back_emf_v_s_per_rad > 9.0 {
                break;
            }
        }
        let known = Known {
            plate,
            size,
            current: (0.0, 0.03),
            speed: (0.0, 0.15),
            signed_current: true,
            set_point: None,
        };
        let (text, refusal) = judge(&known, &[leg]);
        (text, refusal.unwrap_or_default())
    }

    #[test]
    fn a_motor_that_fits_passes_with_both_figures_whatever_its_brushes_drop() {
        let plate = Nameplate::zk_22fc();
        for drop_v in [0.0, 1.2] {
            let (text, refusal) = judged(&plate, 1.0, 1.0, drop_v);
            assert_eq!(refusal, "", "{text}");
            has(&text, "resistance");
            has(&text, "back-EMF constant 0.35");
        }
    }

    #[test]
    fn a_mistake_of_units_is_refused_and_named() {
        let plate = Nameplate::zk_22fc();
        let per_rpm = Nameplate {
            back_emf_v_s_per_rad: 0.3538 / rpm_from_rad_s(1.0),
            // Its torque constant goes with it.
            load_torque_n_m: 0.455 / rpm_from_rad_s(1.0),
            ..plate.clone()
        };
        let (_, refusal) = judged(&per_rpm, 1.0, 1.0, 0.0);
        has(&refusal, "V per r/min on the nameplate");
        let (_, refusal) = judged(&plate, 1.0, rpm_from_rad_s(1.0), 0.0);
        has(&refusal, "r/min that is taken for rad/s");
        let (_, refusal) = judged(&plate, 1e3, 1.0, 0.0);
        assert!(refusal.contains("mA that is taken for A"), "{refusal}");
        let other = Nameplate {
            resistance_ohm: 12.0,
            ..plate
        };
        let (_, refusal) = judged(&other, 1.0, 1.0, 0.0);
        assert!(refusal.contains("another motor"), "{refusal}");
    }

    #[test]
    fn a_speed_that_is_not_the_one_asked_is_refused_with_both_and_the_set_point_s_name() {
        let plate = Nameplate::zk_22fc();
        let limits = Limits::for_motor(&plate, 100.0);
        let size = Size::of(&plate, &limits, Demand::Speed(0.0), 0.15, 0.01);
        let known = Known {
            plate: &plate,
            size,
            current: (0.0, 0.03),
            speed: (0.0, 0.15),
            signed_current: true,
            set_point: Some("speed_ref"),
        };
        let mut leg = Leg::new(1.0);
        leg.push(&size, 7.5, &Sample::at(0.0).with(Channel::Speed, 32.8));
        let (_, refusal) = judge(&known, &[leg.clone()]);
        for text in [refusal.unwrap(), astray(&known, &[leg]).unwrap()] {
            has(&text, "asked 7.50 rad/s, got 32.80 rad/s");
            has(&text, "word order or scale of speed_ref");
        }
    }

    #[test]
    fn what_drowns_in_its_doubt_is_not_told_and_not_refused() {
        let ratio = Ratio {
            name: RESISTANCE,
            unit: "ohm",
            plate: 1.1,
            interval: interval(0.5, 1.6, 0.1, 0.09),
        };
        assert!(!ratio.is_refused());
        assert!(
            ratio.text().contains("cannot be told at this size"),
            "{}",
            ratio.text()
        );
    }
}
