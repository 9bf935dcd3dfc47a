//! Judgement of the voltage pulse: signs of the signals, and the nameplate. Pure.
//!
//! Signs: whether current and speed went the way that was asked. Nameplate: whether voltage, current and speed fit it, as
//! `u = R i + Ke w`.
//!
//! ```text
//! last samples before the shaft turns: u/i -> R           then the same with w: (u - u at rest - R (i - i at rest))/w -> Ke
//! ```
//!
//! Each with the doubt of a small pulse, and what a specimen, a warm winding and drops that depend on nothing may make of
//! it: what lies outside with all of its interval is no tolerance but another unit or another motor, and is refused. The
//! friction's current is the same before and after it breaks away, so drops of brushes and bridge cancel out of Ke.
//! A sample after a pause of host or line is none of these: what the drive did meanwhile is not known.

use std::ops::Range;

use super::pulse::{Leg, Point, Size};
use crate::limits::Nameplate;
use drivebench_control::Actuator;
use drivebench_model::units::rpm_from_rad_s;

/// Standard deviations at rest, and shares of the goal or the rated current, below which nothing has moved or flowed.
const NOISE_FACTOR: f64 = 6.0;
const MOVED_SHARE: f64 = 0.1;
const FLOWED_SHARE: f64 = 0.02;
/// A speed by voltage and current of so many times the goal is no doubt of the nameplate.
const UNSEEN_FACTOR: f64 = 1.5;
/// A torque so many times the friction of the nameplate would turn a free shaft.
const CLEARLY: f64 = 1.7;

/// What is known of the sensors and the motor.
#[derive(Clone, Copy, Debug)]
pub(super) struct Known<'a> {
    pub(super) plate: &'a Nameplate,
    pub(super) size: Size,
    /// Mean and standard deviation at rest with the output off.
    pub(super) current: (f64, f64),
    pub(super) speed: (f64, f64),
    /// Standard deviation of the voltage at rest.
    pub(super) noise_v: f64,
    /// The drive's current has a sign.
    pub(super) signed_current: bool,
    /// The set-point of the profile that is commanded.
    pub(super) set_point: Option<&'a str>,
}

impl Known<'_> {
    pub(super) fn moved_rad_s(&self) -> f64 {
        (NOISE_FACTOR * self.speed.1).max(MOVED_SHARE * self.size.goal_rad_s)
    }

    pub(super) fn flowed_a(&self) -> f64 {
        (NOISE_FACTOR * self.current.1).max(FLOWED_SHARE * self.plate.rated_current_a)
    }
}

/// The ends of one way.
struct Ends {
    asked: f64,
    /// Largest current beside what holds a load, with its sign; `None`: not measured.
    current_a: Option<f64>,
    /// What the current changes by from the first sample to that of the largest demand.
    rise_a: Option<f64>,
    /// Mean of the last two samples; `None`: not measured.
    speed_rad_s: Option<f64>,
    /// By voltage and current, at the end.
    by_voltage_rad_s: Option<f64>,
}

impl Ends {
    fn of(known: &Known<'_>, leg: &Leg) -> Self {
        let points = || leg.points.iter();
        let larger = |a: f64, b: f64| if b.abs() > a.abs() { b } else { a };
        let current = |point: &Point| Some(point.current_a? - known.current.0 - known.size.hold_a);
        let speeds = points().rev().filter_map(|point| point.speed_rad_s);
        let speeds: Vec<f64> = speeds.take(2).collect();
        let mean = speeds.iter().sum::<f64>() / speeds.len().max(1) as f64 - known.speed.0;
        let last = points().last();
        Self {
            asked: points().map(|point| point.asked).fold(0.0, larger),
            current_a: points().filter_map(current).reduce(larger),
            rise_a: rise_a(leg),
            speed_rad_s: (!speeds.is_empty()).then_some(mean),
            by_voltage_rad_s: last.and_then(|point| known.size.by_voltage_rad_s(point)),
        }
    }

    fn text(&self, kind: Actuator) -> String {
        let figure = |value: Option<f64>, unit| {
            value.map_or_else(|| "not measured".to_owned(), |v| format!("{v:.2} {unit}"))
        };
        format!(
            "{:+.2} {}: current {}, speed {}",
            self.asked,
            kind.unit(),
            figure(self.current_a, "A"),
            figure(self.speed_rad_s, "rad/s")
        )
    }
}

/// Change of the current from the smallest demand to the largest.
fn rise_a(leg: &Leg) -> Option<f64> {
    let size = |point: &&Point| point.asked.abs();
    let with_current = || leg.points.iter().filter(|point| point.current_a.is_some());
    let least = with_current().min_by(|a, b| size(a).total_cmp(&size(b)))?;
    let most = with_current().max_by(|a, b| size(a).total_cmp(&size(b)))?;
    Some(most.current_a? - least.current_a?)
}

/// The figures of every way, and why they are refused, with the next step; `Ok`: everything went as asked.
pub(super) fn direction(
    known: &Known<'_>,
    legs: &[Leg],
) -> (String, Option<(String, &'static str)>) {
    let seen: Vec<Ends> = legs.iter().map(|leg| Ends::of(known, leg)).collect();
    let kind = known.size.kind;
    let figures: Vec<String> = seen.iter().map(|seen| seen.text(kind)).collect();
    let mut figures = figures.join("; ");
    let mut refusal = None;
    for (leg, seen) in legs.iter().zip(&seen) {
        refusal = refusal.or_else(|| fault(known, leg.direction, seen));
    }
    let slack = |seen: &Ends| {
        let (current, least) = (seen.current_a, known.flowed_a());
        let flows = current.is_none_or(|amps| amps.abs() > least);
        (!flows).then_some("; the current stays within its noise, so its sign cannot be told")
    };
    if refusal.is_none() {
        if !known.signed_current {
            figures.push_str("; the drive's current has no sign, so only the speed tells");
        } else if let Some(text) = seen.iter().find_map(slack) {
            figures.push_str(text);
        }
        if seen.iter().all(|seen| seen.speed_rad_s.is_none()) {
            figures.push_str("; without a speed the direction of the shaft cannot be told");
        }
    }
    (figures, refusal)
}

fn fault(known: &Known<'_>, direction: f64, seen: &Ends) -> Option<(String, &'static str)> {
    let flows = |amps: f64| amps.abs() > known.flowed_a();
    let current = seen.current_a.filter(|amps| flows(*amps));
    if known.signed_current
        && let Some(amps) = current
        && amps * direction < 0.0
    {
        // A sensor the wrong way round shows a change the wrong way round too.
        if let Some(rise_a) = seen.rise_a.filter(|rise| rise * direction > known.flowed_a()) {
            return Some((
                format!(
                    "an offset: the current is {amps:+.2} A against what is asked and goes with it all the same, by {rise_a:+.2} A; \
                     the drive puts out a voltage where none is asked, or its current is not zeroed"
                ),
                "zero the offset of the drive's output and of its current; --waive-direction goes on, and the diagnosis names it",
            ));
        }
        return Some((
            format!("the current has the wrong sign: {amps:+.2} A"),
            "exchange the leads of the current sensor, or set its sign in the drive's profile",
        ));
    }
    let speed = seen.speed_rad_s?;
    let moved = speed.abs() > known.moved_rad_s();
    if moved && speed * direction > 0.0 {
        return None;
    }
    if moved {
        return Some((
            format!(
                "encoder reversed, or the armature's leads exchanged: the speed goes to {speed:+.2} rad/s against what was asked"
            ),
            "exchange A and B of the encoder, or the two leads of the armature, or set the sign in the drive's profile",
        ));
    }
    let Some(amps) = current else {
        return Some(match seen.current_a {
            Some(_) => (
                "neither a current flows nor does the shaft turn: open armature circuit, or an output that is not released"
                    .to_owned(),
                "check the motor's leads, fuses and the drive's enable and release inputs",
            ),
            None => (
                "the shaft does not turn, and no current is measured".to_owned(),
                "check the motor's leads, the brake, and the encoder",
            ),
        });
    };
    let by_voltage = seen.by_voltage_rad_s.unwrap_or(0.0) * direction;
    if by_voltage > UNSEEN_FACTOR * known.size.goal_rad_s {
        return Some((
            format!(
                "encoder frozen or not connected: the speed stays at {speed:+.2} rad/s, by voltage and current it is about {:+.1} rad/s",
                direction * by_voltage
            ),
            "turn the shaft by hand and watch the speed; check the encoder's cable and supply",
        ));
    }
    let torque = known.plate.back_emf_v_s_per_rad * amps.abs();
    let friction = known.plate.load_torque_n_m;
    let with = format!("{torque:.3} N.m by the nameplate, whose friction is {friction:.3} N.m");
    Some(if torque > CLEARLY * friction {
        (
            format!(
                "the speed stays at {speed:+.2} rad/s although the current gives {with}: the shaft is held (locked, braked, or loaded far beyond the nameplate), or the encoder is dead"
            ),
            "turn the shaft by hand and watch the speed; check brake, load and the encoder's cable",
        )
    } else {
        (
            format!(
                "the shaft does not turn, and whether it should cannot be told at this size: the current gives {with}"
            ),
            "check brake and load; --waive-direction goes on without this check",
        )
    })
}

/// Shares of the nameplate's value that are believed: a winding, with what brushes and bridge drop in its voltage; the
/// flux of a specimen, cold or warm.
const WINDING: (f64, f64) = (0.5, 3.0);
const FLUX: (f64, f64) = (0.7, 1.4);
/// A drive that takes a speed turns at what is asked within this factor.
const FOLLOWED_FACTOR: f64 = 3.0;
/// Into a sample the voltage changes by less than so many cycles of the pulse's rise, if nothing was in the way.
const STEPS: f64 = 2.5;
/// Doubt of a voltage for drops that depend on nothing, and of a difference of two, as shares of the rated voltage.
const DROP_SHARE: f64 = 0.015;
const DIFFERENCE_SHARE: f64 = 0.003;
/// Doubt of the nameplate's resistance where a difference of currents is multiplied with it, and where a current is.
const RESISTANCE_DOUBT: f64 = 0.3;
const NOISE_SIGMAS: f64 = 3.0;
/// Samples that are averaged.
const AVERAGED: usize = 2;
/// A ratio this close to that of two units, as a factor, is named.
const NEAR: f64 = 1.8;

/// What was found of one of the two.
struct Ratio {
    name: &'static str,
    unit: &'static str,
    is_winding: bool,
    plate: f64,
    /// Of the nameplate's value: lowest, likeliest, highest.
    interval: (f64, f64, f64),
}

impl Ratio {
    fn text(&self) -> String {
        let (low, value, high) = self.interval;
        let Self { name, unit, plate, .. } = self;
        if self.is_untold() {
            return format!(
                "the {name} cannot be told at this size ({low:.2} to {high:.2} times the nameplate's {plate} {unit})"
            );
        }
        format!(
            "{name} {:.3} {unit} ({low:.2} to {high:.2} times the nameplate's {plate})",
            value * plate
        )
    }

    /// Whatever would be believed, and more, may be true.
    fn is_untold(&self) -> bool {
        let (low, _, high) = self.interval;
        let (least, most) = self.believed();
        low < least && high > most
    }

    /// Nothing that would be believed is true.
    fn is_refused(&self) -> bool {
        let (low, _, high) = self.interval;
        let (least, most) = self.believed();
        low > most || high < least
    }

    const fn believed(&self) -> (f64, f64) {
        if self.is_winding { WINDING } else { FLUX }
    }

    /// Why it is refused.
    fn refusal(&self) -> String {
        let (least, most) = self.believed();
        let (text, suspicion) = (self.text(), self.suspicion());
        format!("{text}; {least} to {most} times would be believed; {suspicion}")
    }

    /// Which mistake of units would explain it.
    fn suspicion(&self) -> String {
        let ratio = self.interval.1;
        let rpm = rpm_from_rad_s(1.0);
        let milli = "a current in A that is taken for mA, or milliohm on the nameplate";
        let per_rpm = "V per r/min on the nameplate instead of V.s/rad, or a speed in rad/s that is taken for r/min";
        let per_thousand = "V per 1000 r/min on the nameplate instead of V.s/rad";
        let mistakes: &[(f64, &str)] = match self.name {
            RESISTANCE => &[(1e3, milli), (1e-3, "a current in mA that is taken for A")],
            _ => &[
                (rpm, per_rpm),
                (1.0 / rpm, "a speed in r/min that is taken for rad/s"),
                (1e-3 * rpm, per_thousand),
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
#[derive(Clone, Copy, Debug, Default)]
struct Mean {
    voltage_v: f64,
    current_a: f64,
    speed_rad_s: f64,
    /// Largest step of the voltage into one of the samples: the winding's current may not have followed it yet.
    step_v: f64,
}

/// Of the last samples of this part of a way that no pause comes before.
fn mean(known: &Known<'_>, leg: &Leg, part: Range<usize>) -> Option<Mean> {
    let direction = leg.direction;
    // Before a pulse over a voltage stands what holds a load.
    let is_voltage = known.size.kind == Actuator::Voltage;
    let rest_v = if is_voltage { known.size.hold } else { 0.0 };
    let before = |k: usize| match k.checked_sub(1) {
        Some(k) => leg.points[k].voltage_v,
        None => Some(rest_v),
    };
    let counts = |k: &usize| !leg.points[*k].is_after_pause;
    let averaged: Vec<usize> = part.rev().filter(counts).take(AVERAGED).collect();
    let step_v = averaged
        .iter()
        .filter_map(|k| Some((leg.points[*k].voltage_v? - before(*k)?).abs()))
        .fold(0.0, f64::max);
    let rows: Vec<(f64, f64, f64)> = averaged
        .iter()
        .map(|k| &leg.points[*k])
        .filter_map(|p| Some((p.voltage_v?, p.current_a? - known.current.0, p.speed_rad_s?)))
        .collect();
    let n = rows.len() as f64;
    let of =
        |value: fn(&(f64, f64, f64)) -> f64| direction * rows.iter().map(value).sum::<f64>() / n;
    // A current without a sign is a magnitude already.
    let sign = if known.signed_current { 1.0 } else { direction };
    (!rows.is_empty()).then(|| Mean {
        voltage_v: of(|row| row.0),
        current_a: sign * of(|row| row.1),
        speed_rad_s: of(|row| row.2) - direction * known.speed.0,
        step_v,
    })
}

/// Where one way comes into motion; `None`: it does not.
fn moves_at(known: &Known<'_>, leg: &Leg) -> Option<usize> {
    let has_moved = |w: f64| (w - known.speed.0).abs() > known.moved_rad_s();
    let moves = |point: &Point| point.speed_rad_s.is_some_and(has_moved);
    leg.points.iter().position(moves)
}

/// The last samples at rest and the last ones in motion of one way.
fn ends(known: &Known<'_>, leg: &Leg) -> (Option<Mean>, Option<Mean>) {
    let all = leg.points.len();
    let first = moves_at(known, leg);
    let rest = mean(known, leg, 0..first.unwrap_or(all));
    let motion = first.and_then(|first| mean(known, leg, first..all));
    (rest.filter(|mean| mean.voltage_v > 0.0 && mean.current_a.abs() > known.flowed_a()), motion)
}

fn interval(value: f64, doubt: f64, by: f64, by_doubt: f64) -> (f64, f64, f64) {
    let (value, by) = (value.max(0.0), by.max(1e-12));
    let low = (value - doubt).max(0.0) / (by + by_doubt);
    let high = if by > by_doubt { (value + doubt) / (by - by_doubt) } else { f64::INFINITY };
    (low, value / by, high)
}

/// What one way says about the two.
fn ratios(known: &Known<'_>, leg: &Leg) -> Vec<Ratio> {
    let plate = known.plate;
    let (r, ke) = (plate.resistance_ohm, plate.back_emf_v_s_per_rad);
    let noise_a = NOISE_SIGMAS * known.current.1 / (AVERAGED as f64).sqrt();
    let noise_rad_s = NOISE_SIGMAS * known.speed.1 / (AVERAGED as f64).sqrt();
    let (rest, motion) = ends(known, leg);
    let mut ratios = Vec::new();
    if let Some(rest) = rest {
        let drop_v = DROP_SHARE * plate.rated_voltage_v;
        let by_v = r * rest.current_a.abs();
        ratios.push(Ratio {
            name: RESISTANCE,
            unit: "ohm",
            is_winding: true,
            plate: r,
            interval: interval(rest.voltage_v, drop_v + rest.step_v, by_v, r * noise_a),
        });
    }
    if let Some(motion) = motion {
        let share = rest.map_or(DROP_SHARE, |_| DIFFERENCE_SHARE);
        let from = rest.unwrap_or_default();
        let change_a = motion.current_a - from.current_a;
        let by_v = ke * (motion.speed_rad_s - from.speed_rad_s).abs();
        let emf_v = motion.voltage_v - from.voltage_v - r * change_a;
        let doubt_v = from.step_v
            + motion.step_v
            + share * plate.rated_voltage_v
            + r * (RESISTANCE_DOUBT * change_a.abs() + noise_a);
        ratios.push(Ratio {
            name: BACK_EMF,
            unit: "V.s/rad",
            is_winding: false,
            plate: ke,
            interval: interval(emf_v, doubt_v, by_v, ke * noise_rad_s),
        });
    }
    ratios
}

/// A drive that takes a speed: whether it turns at about the speed that was asked.
fn followed(known: &Known<'_>, leg: &Leg) -> Option<(String, bool)> {
    let last = leg.points.last().filter(|_| known.size.kind == Actuator::Speed)?;
    let speed = (last.speed_rad_s? - known.speed.0).abs();
    let ratio = speed / last.asked.abs();
    let text = format!("{:.2} rad/s asked, {speed:.2} rad/s measured", last.asked.abs());
    let believed = 1.0 / FOLLOWED_FACTOR..=FOLLOWED_FACTOR;
    Some((text, believed.contains(&ratio)))
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

/// A pause in this way has left no sample in motion that could be judged, or a voltage that is not the one of the pulse.
fn is_spoilt(known: &Known<'_>, leg: &Leg) -> bool {
    let (rest, motion) = ends(known, leg);
    let lost = |first: usize| leg.points[first..].iter().all(|point| point.is_after_pause);
    let is_lost = moves_at(known, leg).is_some_and(lost);
    let most_v = STEPS * known.size.step() + NOISE_FACTOR * known.noise_v;
    let steps = |mean: &Mean| mean.step_v > most_v;
    let is_voltage = known.size.kind == Actuator::Voltage;
    let is_driven = is_voltage && rest.iter().chain(&motion).any(steps);
    let untold = ratios(known, leg).iter().any(Ratio::is_untold);
    leg.pause_s.is_some() && (is_lost || is_driven && untold)
}

/// Nothing in this way has to be looked at once more because of a pause in it.
pub(super) fn is_settled(known: &Known<'_>, leg: &Leg) -> bool {
    let fits = |ratio: &Ratio| !ratio.is_refused() && !ratio.is_untold();
    leg.pause_s.is_none()
        || fault(known, leg.direction, &Ends::of(known, leg)).is_none()
            && !is_spoilt(known, leg)
            && ratios(known, leg).iter().all(fits)
            && followed(known, leg).is_none_or(|(_, good)| good)
}

const NAMEPLATE_HELP: &str = "correct [motor] or the units of the drive's profile; `--escalate` finds a motor whose nameplate is in doubt; --waive-plausibility goes on";
const PAUSE_HELP: &str = "see what else keeps the computer or the line busy, or lower link.rate_hz; --waive-plausibility goes on without this check";

/// What was found, and why it is refused, with the next step.
pub(super) fn plausibility(
    known: &Known<'_>,
    legs: &[Leg],
) -> (String, Option<(String, &'static str)>) {
    let mut texts = Vec::new();
    let mut refusal = None;
    for leg in legs {
        let is_forward = leg.direction > 0.0;
        let way = if is_forward { "forward" } else { "back" };
        for ratio in ratios(known, leg) {
            let text = ratio.text();
            if ratio.is_refused() && refusal.is_none() {
                refusal = Some((ratio.refusal(), NAMEPLATE_HELP));
            }
            texts.push(format!("{way} {text}"));
        }
        if let Some((text, good)) = followed(known, leg) {
            if !good && refusal.is_none() {
                refusal = question(known, leg).map(|text| (text, NAMEPLATE_HELP));
            }
            texts.push(format!("{way} {text}"));
        }
        if let Some(pause_s) = leg.pause_s {
            let text = format!("{way} a pause of {pause_s:.3} s between two samples");
            if is_spoilt(known, leg) && refusal.is_none() {
                let why = "the pulse was made again and still cannot be judged";
                refusal = Some((format!("{text}: {why}"), PAUSE_HELP));
            }
            texts.push(format!("{text}, not judged by what follows it at once"));
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
    use crate::limits::Limits;
    use crate::testing::has;
    use drivebench_model::sample::{Channel, Demand, Sample};

    fn known(plate: &Nameplate, zero: Demand) -> Known<'_> {
        let limits = Limits::for_motor(&Nameplate::zk_22fc(), 100.0);
        Known {
            plate,
            size: Size::of(plate, &limits, zero, 0.15, 0.01),
            current: (0.0, 0.03),
            speed: (0.0, 0.15),
            noise_v: 0.02,
            signed_current: true,
            set_point: None,
        }
    }

    fn reply(current_a: f64, speed_rad_s: f64) -> Sample {
        Sample::at(0.0).with(Channel::Current, current_a).with(Channel::Speed, speed_rad_s)
    }

    /// A pulse both ways that ends with these figures for the positive way, and the same the other way.
    fn ended(volts: f64, current_a: f64, speed_rad_s: f64, signed: bool) -> (String, String) {
        let plate = Nameplate::zk_22fc();
        let known = Known { signed_current: signed, ..known(&plate, Demand::Voltage(0.0)) };
        let legs = [1.0, -1.0].map(|way| {
            let mut leg = Leg::new(way);
            for _ in 0..3 {
                let reply = reply(way * current_a, way * speed_rad_s);
                let asked = volts * way;
                leg.push(&known.size, asked, Demand::Voltage(asked), &reply);
            }
            leg
        });
        let (figures, refusal) = direction(&known, &legs);
        (figures, refusal.map_or_else(String::new, |(text, _)| text))
    }

    #[test]
    fn each_fault_has_its_own_words() {
        let (figures, refusal) = ended(5.0, 1.8, 9.0, true);
        assert_eq!(refusal, "");
        has(&figures, "+5.00 V: current 1.80 A, speed 9.00 rad/s");
        has(&figures, "-5.00 V: current -1.80 A");
        for (volts, current, speed, words) in [
            (5.0, 1.8, -9.0, "encoder reversed"),
            (5.0, -1.8, 9.0, "wrong sign: -1.80 A"),
            (3.3, 3.0, 0.1, "the shaft is held"),
            (10.0, 1.4, 0.1, "encoder frozen or not connected"),
            (1.7, 1.5, 0.1, "cannot be told at this size"),
            (5.0, 0.01, 0.1, "open armature circuit"),
        ] {
            has(ended(volts, current, speed, true).1, words);
        }
    }

    #[test]
    fn a_current_offset_that_follows_the_voltage_is_found() {
        let plate = Nameplate::zk_22fc();
        let known = known(&plate, Demand::Voltage(0.0));
        let pulse = |current_a: fn(f64) -> f64| {
            let mut leg = Leg::new(1.0);
            for step in 0..8 {
                let volts = 0.4 * f64::from(step);
                let sent = Demand::Voltage(volts);
                leg.push(&known.size, volts, sent, &reply(current_a(volts), 0.0));
            }
            direction(&known, &[leg]).1.unwrap().0
        };
        // Of a ramp to 2.8 V the motor gets 2.3 V less.
        let offset = pulse(|volts| (volts - 2.3) / 1.1);
        has(&offset, "an offset: the current is -2.09 A");
        has(&offset, "by +2.55 A");
        has(pulse(|volts| -volts / 1.1), "wrong sign");
    }

    #[test]
    fn a_current_without_sign_or_within_noise_passes() {
        for (current_a, signed, words) in
            [(-1.8, false, "has no sign"), (0.05, true, "sign cannot be told")]
        {
            let (figures, refusal) = ended(5.0, current_a, 9.0, signed);
            assert_eq!(refusal, "");
            has(figures, words);
        }
    }

    /// The paper's motor in a slow pulse, as its sensors tell it with these factors; judged by `plate`.
    fn judged(
        plate: &Nameplate,
        (current_factor, speed_factor): (f64, f64),
        drop_v: f64,
    ) -> (String, String) {
        let truth = Nameplate::zk_22fc();
        let known = known(plate, Demand::Voltage(0.0));
        let mut leg = Leg::new(1.0);
        for step in 1..60 {
            let volts = 0.1 * f64::from(step);
            let friction_a = truth.load_torque_n_m / truth.back_emf_v_s_per_rad;
            let free_a = (volts - drop_v).max(0.0) / truth.resistance_ohm;
            let current_a = free_a.min(friction_a);
            let emf_v = (volts - drop_v - truth.resistance_ohm * current_a).max(0.0);
            let speed = speed_factor * emf_v / truth.back_emf_v_s_per_rad;
            let reply = reply(current_factor * current_a, speed).with(Channel::Voltage, volts);
            leg.push(&known.size, volts, Demand::Voltage(volts), &reply);
            if speed > 9.0 {
                break;
            }
        }
        let (text, refusal) = plausibility(&known, &[leg]);
        (text, refusal.map_or_else(String::new, |(text, _)| text))
    }

    #[test]
    fn a_matching_motor_passes_whatever_its_brushes_drop() {
        let plate = Nameplate::zk_22fc();
        for drop_v in [0.0, 1.2] {
            let (text, refusal) = judged(&plate, (1.0, 1.0), drop_v);
            assert_eq!(refusal, "", "{text}");
            has(&text, "resistance");
            has(&text, "back-EMF constant 0.35");
        }
    }

    #[test]
    fn a_mistake_of_units_is_refused_and_named() {
        let plate = Nameplate::zk_22fc();
        let rpm = rpm_from_rad_s(1.0);
        let per_rpm = Nameplate {
            back_emf_v_s_per_rad: 0.3538 / rpm,
            // Its torque constant goes with it.
            load_torque_n_m: 0.455 / rpm,
            ..plate.clone()
        };
        let other = Nameplate { resistance_ohm: 12.0, ..plate.clone() };
        for (plate, factors, words) in [
            (&per_rpm, (1.0, 1.0), "V per r/min on the nameplate"),
            (&plate, (1.0, rpm), "r/min that is taken for rad/s"),
            (&plate, (1e3, 1.0), "mA that is taken for A"),
            (&other, (1.0, 1.0), "another motor"),
        ] {
            has(judged(plate, factors, 0.0).1, words);
        }
    }

    #[test]
    fn a_wrong_speed_is_refused_with_the_set_points_name() {
        let plate = Nameplate::zk_22fc();
        let known = Known { set_point: Some("speed_ref"), ..known(&plate, Demand::Speed(0.0)) };
        let mut leg = Leg::new(1.0);
        let reply = Sample::at(0.0).with(Channel::Speed, 32.8);
        leg.push(&known.size, 7.5, Demand::Speed(7.5), &reply);
        let (_, refusal) = plausibility(&known, &[leg.clone()]);
        for text in [refusal.unwrap().0, astray(&known, &[leg]).unwrap()] {
            has(&text, "asked 7.50 rad/s, got 32.80 rad/s");
            has(&text, "word order or scale of speed_ref");
        }
    }

    #[test]
    fn an_interval_without_believable_value_is_refused() {
        let ratio = |is_winding, interval| Ratio {
            name: if is_winding { RESISTANCE } else { BACK_EMF },
            unit: "",
            is_winding,
            plate: 1.0,
            interval,
        };
        for (is_winding, interval) in [
            (false, (0.0, 0.1, 0.3)),
            (false, (0.0, 0.3, 0.68)),
            (false, (0.45, 0.55, 0.65)),
            (false, (1.5, 1.7, f64::INFINITY)),
            (true, (0.0, 0.2, 0.49)),
            (true, (3.1, 3.5, 3.9)),
        ] {
            let ratio = ratio(is_winding, interval);
            assert!(ratio.is_refused(), "{interval:?}");
            let words = if is_winding { "0.5 to 3" } else { "0.7 to 1.4" };
            has(ratio.refusal(), &format!("{words} times would be believed"));
        }
        for (is_winding, interval, untold) in [
            (false, (0.0, 0.4, 0.75), false),
            (false, (0.66, 0.95, 1.27), false),
            (false, (0.66, 0.95, 1.41), true),
            (false, (0.0, 0.9, f64::INFINITY), true),
            (true, (0.48, 1.25, 2.08), false),
            (true, (2.21, 3.28, 4.44), false),
            (true, (0.0, 1.4, 3.1), true),
        ] {
            let ratio = ratio(is_winding, interval);
            assert!(!ratio.is_refused(), "{interval:?}");
            let text = ratio.text();
            assert_eq!(text.contains("cannot be told"), untold, "{text}");
        }
    }

    /// A pulse of the paper's motor both ways, with that long before some of the samples, s.
    fn with_pauses(pause_s: f64, after: fn(usize) -> bool) -> [Leg; 2] {
        let plate = Nameplate::zk_22fc();
        let known = known(&plate, Demand::Voltage(0.0));
        [1.0, -1.0].map(|way| {
            let mut leg = Leg::new(way);
            let mut time_s = 0.0;
            for step in 1..60 {
                let volts = 0.1 * f64::from(step);
                let current_a = (volts / 1.1).min(1.29);
                let speed = (volts - 1.1 * current_a) / 0.3538;
                time_s += if after(leg.points.len()) { pause_s } else { 0.01 };
                let mut reply = reply(way * current_a, way * speed);
                reply.time_s = time_s;
                let sent = Demand::Voltage(way * volts);
                leg.push(&known.size, way * volts, sent, &reply);
                if speed > 9.0 {
                    break;
                }
            }
            leg
        })
    }

    #[test]
    fn the_rows_after_a_pause_are_not_judged() {
        let plate = Nameplate::zk_22fc();
        let known = known(&plate, Demand::Voltage(0.0));
        // One cycle without a reply is no pause.
        for leg in with_pauses(0.02, |_| true) {
            assert!(leg.pause_s.is_none() && is_settled(&known, &leg));
        }
        // Wherever one is, the rest of the pulse tells.
        let legs = with_pauses(0.2, |point| point % 3 == 0);
        let (text, refusal) = plausibility(&known, &legs);
        assert_eq!(refusal, None);
        has(&text, "back-EMF constant 0.35");
        has(&text, "back a pause of 0.200 s between two samples");
        let legs = with_pauses(0.2, |_| true);
        assert!(!is_settled(&known, &legs[0]));
        let (text, help) = plausibility(&known, &legs).1.unwrap();
        has(&text, "forward a pause of 0.200 s between two samples");
        has(text, "still cannot be judged");
        has(help, "--waive-plausibility");
    }

    #[test]
    fn what_drowns_in_its_doubt_is_not_told_and_not_refused() {
        let ratio = Ratio {
            name: RESISTANCE,
            unit: "ohm",
            is_winding: true,
            plate: 1.1,
            interval: interval(0.5, 1.6, 0.1, 0.09),
        };
        assert!(!ratio.is_refused());
        has(ratio.text(), "cannot be told at this size");
    }
}
