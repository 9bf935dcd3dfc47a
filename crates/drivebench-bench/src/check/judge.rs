//! Evaluation of the pulse: signs of current and speed, and the nameplate by the voltage equation `u = R i + Ke w`. Pure.
//!
//! ```text
//! last samples at rest:   R = u/i            in motion:   Ke = (u - u at rest - R (i - i at rest))/w
//! ```
//!
//! Each is an interval: noise, tolerance of a specimen, a warm winding and constant voltage drops. An interval that lies
//! wholly outside the plausible range is another unit or another motor, and is refused. The current of the friction is the
//! same before and after breakaway, so drops of brushes and bridge cancel out of Ke. A sample after a pause of host or line
//! is not evaluated: what the drive did meanwhile is not known.

use std::ops::Range;

use super::motion;
use super::pulse::{Leg, Point, Size};
use crate::limits::Nameplate;
use drivebench_control::Actuator;
use drivebench_identify::belief::{self, Settings, nearest};
use drivebench_model::units::rpm_from_rad_s;

/// What is known of the sensors and the motor.
#[derive(Clone, Copy, Debug)]
pub(super) struct Known<'a> {
    pub(super) nameplate: &'a Nameplate,
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
    /// The drive turns the field by an encoder on the shaft.
    pub(super) is_field_oriented: bool,
    /// Back-EMF constant by the flux linkage that the drive stores, V.s/rad, where it and the speed depend on the drive's pole pairs.
    pub(super) by_flux_linkage: Option<f64>,
}

impl Known<'_> {
    pub(super) fn moved_rad_s(&self) -> f64 {
        (Settings::CLEAR_STD * self.speed.1).max(0.1 * self.size.goal_rad_s)
    }

    pub(super) fn flowed_a(&self) -> f64 {
        (Settings::CLEAR_STD * self.current.1)
            .max(Settings::IDLE_CURRENT * self.nameplate.rated_current_a)
    }
}

struct Extremes {
    demand: f64,
    /// Largest current beyond the hold, with its sign; `None`: not measured.
    current_a: Option<f64>,
    /// Change of the current from the smallest demand to the largest.
    rise_a: Option<f64>,
    /// Mean of the last two samples; `None`: not measured.
    speed_rad_s: Option<f64>,
    /// By voltage and current, at the end.
    by_voltage_rad_s: Option<f64>,
}

impl Extremes {
    fn of(known: &Known<'_>, leg: &Leg) -> Self {
        let points = || leg.points.iter();
        let larger = |a: f64, b: f64| if b.abs() > a.abs() { b } else { a };
        let current = |point: &Point| Some(point.current_a? - known.current.0 - known.size.hold_a);
        let speeds: Vec<f64> =
            points().rev().filter_map(|point| point.speed_rad_s).take(2).collect();
        let mean = speeds.iter().sum::<f64>() / speeds.len().max(1) as f64 - known.speed.0;
        let with_current =
            || points().filter_map(|point| Some((point.demand.abs(), point.current_a?)));
        let least = with_current().min_by(|a, b| a.0.total_cmp(&b.0));
        let most = with_current().max_by(|a, b| a.0.total_cmp(&b.0));
        Self {
            demand: points().map(|point| point.demand).fold(0.0, larger),
            current_a: points().filter_map(current).reduce(larger),
            rise_a: least.zip(most).map(|(least, most)| most.1 - least.1),
            speed_rad_s: (!speeds.is_empty()).then_some(mean),
            by_voltage_rad_s: points().last().and_then(|point| known.size.by_voltage_rad_s(point)),
        }
    }

    fn text(&self, kind: Actuator) -> String {
        let figure = |value: Option<f64>, unit| {
            value.map_or_else(|| "not measured".to_owned(), |v| format!("{v:.2} {unit}"))
        };
        format!(
            "{:+.2} {}: current {}, speed {}",
            self.demand,
            kind.unit(),
            figure(self.current_a, "A"),
            figure(self.speed_rad_s, "rad/s")
        )
    }
}

/// The figures of every direction, and the first fault with the next step.
pub(super) fn direction(
    known: &Known<'_>,
    legs: &[Leg],
) -> (String, Option<(String, &'static str)>) {
    let all: Vec<Extremes> = legs.iter().map(|leg| Extremes::of(known, leg)).collect();
    let texts: Vec<String> = all.iter().map(|extremes| extremes.text(known.size.kind)).collect();
    let mut figures = texts.join("; ");
    let refusal =
        legs.iter().zip(&all).find_map(|(leg, extremes)| fault(known, leg.direction, extremes));
    if refusal.is_none() {
        let is_small =
            |found: &Extremes| found.current_a.is_some_and(|amps| amps.abs() <= known.flowed_a());
        if !known.signed_current {
            figures.push_str(
                "; the drive's current has no sign, so only the speed shows the direction",
            );
        } else if all.iter().any(is_small) {
            figures.push_str("; the current stays within its noise, so its sign is not determined");
        }
        figures.extend(motion::one_sided(known, legs));
        if all.iter().all(|extremes| extremes.speed_rad_s.is_none()) {
            figures.push_str("; without a speed the direction of the shaft is not determined");
        }
    }
    (figures, refusal)
}

fn fault(known: &Known<'_>, direction: f64, found: &Extremes) -> Option<(String, &'static str)> {
    let current = found.current_a.filter(|amps| amps.abs() > known.flowed_a());
    if known.signed_current
        && let Some(amps) = current
        && amps * direction < 0.0
    {
        // Of a reversed sensor the change is reversed too.
        if let Some(rise_a) = found.rise_a.filter(|rise| rise * direction > known.flowed_a()) {
            return Some((
                format!(
                    "an offset: the current is {amps:+.2} A against the set-point and yet changes with it, by {rise_a:+.2} A; \
                     the drive puts out a voltage at zero set-point, or its current is not zeroed"
                ),
                "zero the offset of the drive's output and of its current; --waive-direction goes on, and the diagnosis names it",
            ));
        }
        return Some((
            format!("the current has the wrong sign: {amps:+.2} A"),
            "exchange the leads of the current sensor, or set its sign in the drive's profile",
        ));
    }
    let speed = found.speed_rad_s?;
    let moved = speed.abs() > known.moved_rad_s();
    if moved && speed * direction > 0.0 {
        return None;
    }
    if moved {
        // The torque of a current has the sign of the cosine of the offset.
        let (cause, help) = if known.is_field_oriented {
            (
                "its offset to the phases is off by about half an electrical turn",
                "repeat the drive's detection of encoder offset and direction, or set the sign in the drive's profile",
            )
        } else {
            (
                "the armature's leads exchanged",
                "exchange A and B of the encoder, or the two leads of the armature, or set the sign in the drive's profile",
            )
        };
        let against = format!("the speed goes to {speed:+.2} rad/s against the set-point");
        return Some((format!("encoder reversed, or {cause}: {against}"), help));
    }
    let Some(amps) = current else {
        return Some(match found.current_a {
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
    let by_voltage = found.by_voltage_rad_s.unwrap_or(0.0) * direction;
    // Beyond any tolerance of the nameplate.
    if by_voltage > 1.5 * known.size.goal_rad_s {
        return Some((
            format!(
                "encoder frozen or not connected: the speed stays at {speed:+.2} rad/s, by voltage and current it is about {:+.1} rad/s",
                direction * by_voltage
            ),
            "turn the shaft by hand and watch the speed; check the encoder's cable and supply",
        ));
    }
    let plate = known.size.plate;
    let (torque, friction) = (plate.torque_n_m(amps), plate.friction_n_m);
    let with = format!("{torque:.3} N.m by the nameplate, whose friction is {friction:.3} N.m");
    Some(if amps.abs() > plate.turning_a() {
        // A quarter of a turn away a current gives no torque, and with two phases exchanged the field turns against the shaft.
        let phases = if known.is_field_oriented {
            ", or its offset to the phases is off by about a quarter of an electrical turn, or two phases are exchanged"
        } else {
            ""
        };
        (
            format!(
                "the speed stays at {speed:+.2} rad/s although the current gives {with}: the shaft is held (locked, braked, or loaded far beyond the nameplate), or the encoder is dead{phases}"
            ),
            "turn the shaft by hand and watch the speed; check brake, load and the encoder's cable",
        )
    } else {
        (
            format!(
                "the shaft does not turn, and a pulse of this size does not show whether it should: the current gives {with}"
            ),
            "check brake and load; --waive-direction goes on without this check",
        )
    })
}

/// Samples that are averaged.
const AVERAGED: usize = 2;

/// A parameter by the pulse, against the nameplate.
struct Ratio {
    name: &'static str,
    unit: &'static str,
    nameplate: f64,
    /// Shares of the nameplate's value that a specimen may have.
    plausible: belief::Range,
    /// Of the nameplate's value: lowest, likeliest, highest.
    interval: (f64, f64, f64),
}

impl Ratio {
    const BACK_EMF: &'static str = "back-EMF constant";

    /// The resistance; the voltage drop of brushes and bridge counts as winding.
    const fn resistance(nameplate: f64, interval: (f64, f64, f64)) -> Self {
        let plausible = belief::Range::new(Settings::ANY_FACTOR.low, 3.0);
        Self { name: "resistance", unit: "ohm", nameplate, plausible, interval }
    }

    /// The flux of a specimen, cold or warm.
    const fn back_emf(nameplate: f64, interval: (f64, f64, f64)) -> Self {
        let plausible = Settings::FLUX_FACTOR;
        Self { name: Self::BACK_EMF, unit: "V.s/rad", nameplate, plausible, interval }
    }

    fn text(&self) -> String {
        let (low, value, high) = self.interval;
        let Self { name, unit, nameplate, .. } = self;
        if self.is_undetermined() {
            return format!(
                "the {name} is not determined by a pulse of this size ({low:.2} to {high:.2} times the nameplate's {nameplate} {unit})"
            );
        }
        format!(
            "{name} {:.3} {unit} ({low:.2} to {high:.2} times the nameplate's {nameplate})",
            value * nameplate
        )
    }

    /// The interval holds the whole plausible range.
    fn is_undetermined(&self) -> bool {
        self.interval.0 < self.plausible.low && self.interval.2 > self.plausible.high
    }

    /// The interval holds nothing plausible.
    fn is_refused(&self) -> bool {
        self.plausible.gap(belief::Range::new(self.interval.0, self.interval.2)) > 0.0
    }

    fn refusal(&self, known: &Known<'_>) -> String {
        let belief::Range { low: least, high: most } = self.plausible;
        let cause = self.pole_pairs(known).unwrap_or_else(|| self.mistake_of_units());
        format!("{}; {least} to {most} times is plausible; {cause}", self.text())
    }

    /// The stored flux linkage agrees with the pulse and contradicts the nameplate: speed and constant are by pole pairs that the
    /// motor has not.
    fn pole_pairs(&self, known: &Known<'_>) -> Option<String> {
        let stated =
            known.by_flux_linkage.filter(|_| self.name == Self::BACK_EMF)? / self.nameplate;
        let found = belief::Range::new(self.interval.0, self.interval.2);
        let agrees = self.plausible.times(belief::Range::at(stated)).gap(found) <= 0.0;
        let is_far = self.plausible.gap(belief::Range::at(stated)) > 0.0;
        (agrees && is_far).then(|| {
            format!(
                "the flux linkage that the drive stores gives {stated:.2} times too, and the drive's pole pairs are in both: by the nameplate the motor has {:.3} times the pole pairs of the drive's configuration",
                1.0 / stated
            )
        })
    }

    /// Which mistake of units would explain it.
    fn mistake_of_units(&self) -> String {
        let ratio = self.interval.1;
        let rpm = rpm_from_rad_s(1.0);
        let milli = "a current in A that is taken for mA, or milliohm on the nameplate";
        let per_rpm = "V per r/min on the nameplate instead of V.s/rad, or a speed in rad/s that is taken for r/min";
        let per_thousand = "V per 1000 r/min on the nameplate instead of V.s/rad";
        let mistakes: &[(f64, &str)] = match self.name {
            "resistance" => &[(1e3, milli), (1e-3, "a current in mA that is taken for A")],
            _ => &[
                (rpm, per_rpm),
                (1.0 / rpm, "a speed in r/min that is taken for rad/s"),
                (1e-3 * rpm, per_thousand),
                (1e3, "mV on the nameplate"),
            ],
        };
        match nearest(ratio, mistakes, Settings::ANY_FACTOR.high.ln()) {
            Some((factor, text)) => {
                format!("a mistake of units by the factor {factor:.3} would explain it: {text}")
            }
            None => {
                "no usual mistake of units explains it: the nameplate may be that of another motor"
                    .to_owned()
            }
        }
    }
}

/// Means of some samples, along the direction of the pulse.
#[derive(Clone, Copy, Debug, Default)]
struct Mean {
    voltage_v: f64,
    current_a: f64,
    speed_rad_s: f64,
    /// Largest step of the voltage into one of the samples, which the current may not have followed yet.
    step_v: f64,
}

/// Of the last samples of this part that no pause precedes.
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

/// The first sample in motion.
fn moves_at(known: &Known<'_>, leg: &Leg) -> Option<usize> {
    let has_moved = |w: f64| (w - known.speed.0).abs() > known.moved_rad_s();
    leg.points.iter().position(|point| point.speed_rad_s.is_some_and(has_moved))
}

/// The last samples at rest and the last ones in motion.
fn rest_and_motion(known: &Known<'_>, leg: &Leg) -> (Option<Mean>, Option<Mean>) {
    let all = leg.points.len();
    let first = moves_at(known, leg);
    let rest = mean(known, leg, 0..first.unwrap_or(all));
    let motion = first.and_then(|first| mean(known, leg, first..all));
    (rest.filter(|mean| mean.voltage_v > 0.0 && mean.current_a.abs() > known.flowed_a()), motion)
}

fn interval(value: f64, doubt: f64, by: f64, by_doubt: f64) -> (f64, f64, f64) {
    let (value, by) = (value.max(0.0), by.max(1e-12));
    let low = (value - doubt).max(0.0) / (by + by_doubt);
    (low, value / by, if by > by_doubt { (value + doubt) / (by - by_doubt) } else { f64::INFINITY })
}

fn ratios(known: &Known<'_>, leg: &Leg) -> Vec<Ratio> {
    let nameplate = known.nameplate;
    let (r, ke) = (nameplate.resistance_ohm, nameplate.back_emf_v_s_per_rad);
    let [noise_a, noise_rad_s] = [known.current.1, known.speed.1]
        .map(|std| Settings::SIGMAS * std / (AVERAGED as f64).sqrt());
    // Uncertainty of a voltage for constant drops, and of a difference of two voltages, as shares of the rated voltage.
    let (drop_share, difference_share) = (Settings::JUDGED, 0.003);
    let (rest, motion) = rest_and_motion(known, leg);
    let mut ratios = Vec::new();
    if let Some(rest) = rest {
        let drop_v = drop_share * nameplate.rated_voltage_v;
        let by_v = r * rest.current_a.abs();
        let found = interval(rest.voltage_v, drop_v + rest.step_v, by_v, r * noise_a);
        ratios.push(Ratio::resistance(r, found));
    }
    if let Some(motion) = motion {
        let share = rest.map_or(drop_share, |_| difference_share);
        let from = rest.unwrap_or_default();
        let change_a = motion.current_a - from.current_a;
        let by_v = ke * (motion.speed_rad_s - from.speed_rad_s).abs();
        let emf_v = motion.voltage_v - from.voltage_v - r * change_a;
        let doubt_v = from.step_v
            + motion.step_v
            + share * nameplate.rated_voltage_v
            // The resistance of the nameplate may be off, too.
            + r * (Settings::CATALOGUE * change_a.abs() + noise_a);
        ratios.push(Ratio::back_emf(ke, interval(emf_v, doubt_v, by_v, ke * noise_rad_s)));
    }
    ratios
}

/// A drive with a speed set-point: whether it turns at that speed, within a factor of three.
fn followed(known: &Known<'_>, leg: &Leg) -> Option<(String, bool)> {
    let last = leg.points.last().filter(|_| known.size.kind == Actuator::Speed)?;
    let speed = (last.speed_rad_s? - known.speed.0).abs();
    let set_point = last.demand.abs();
    let text = format!("set-point {set_point:.2} rad/s, measured {speed:.2} rad/s");
    Some((text, (1.0 / 3.0..=3.0).contains(&(speed / set_point))))
}

/// Why the last speed may be far from its set-point.
pub(super) fn wrong_speed(known: &Known<'_>, leg: &Leg) -> Option<String> {
    let last = leg.points.last()?;
    let name = known.set_point.unwrap_or("the speed's set-point");
    Some(format!(
        "set-point {:.2} rad/s, measured {:.2} rad/s: is the word order or scale of {name} right? (its unit too: 1 rad/s is {:.2} r/min)",
        last.demand,
        last.speed_rad_s?,
        rpm_from_rad_s(1.0)
    ))
}

/// A pause has left no sample in motion that can be evaluated, or a voltage that is not the one of the pulse.
fn cannot_be_evaluated(known: &Known<'_>, leg: &Leg) -> bool {
    let (rest, motion) = rest_and_motion(known, leg);
    let lost = |first: usize| leg.points[first..].iter().all(|point| point.is_after_pause);
    let is_lost = moves_at(known, leg).is_some_and(lost);
    // Without a pause a step is one cycle of the rise.
    let most_v = 2.5 * known.size.step() + Settings::CLEAR_STD * known.noise_v;
    let steps = |mean: &Mean| mean.step_v > most_v;
    let is_voltage = known.size.kind == Actuator::Voltage;
    let is_driven = is_voltage && rest.iter().chain(&motion).any(steps);
    let is_undetermined = ratios(known, leg).iter().any(Ratio::is_undetermined);
    leg.pause_s.is_some() && (is_lost || is_driven && is_undetermined)
}

/// No pause in this direction makes a repetition necessary.
pub(super) fn is_settled(known: &Known<'_>, leg: &Leg) -> bool {
    let fits = |ratio: &Ratio| !ratio.is_refused() && !ratio.is_undetermined();
    leg.pause_s.is_none()
        || fault(known, leg.direction, &Extremes::of(known, leg)).is_none()
            && !cannot_be_evaluated(known, leg)
            && ratios(known, leg).iter().all(fits)
            && followed(known, leg).is_none_or(|(_, is_near)| is_near)
}

const NAMEPLATE_HELP: &str = "correct [motor] or the units of the drive's profile; `--escalate` finds a motor whose nameplate is in doubt; --waive-plausibility goes on";
const PAUSE_HELP: &str = "see what else keeps the computer or the line busy, or lower link.rate_hz; --waive-plausibility goes on without this check";

/// The parameters by the pulse, and why they are refused, with the next step.
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
                refusal = Some((ratio.refusal(known), NAMEPLATE_HELP));
            }
            texts.push(format!("{way} {text}"));
        }
        if let Some((text, is_near)) = followed(known, leg) {
            if !is_near && refusal.is_none() {
                refusal = wrong_speed(known, leg).map(|text| (text, NAMEPLATE_HELP));
            }
            texts.push(format!("{way} {text}"));
        }
        if let Some(pause_s) = leg.pause_s {
            let text = format!("{way} a pause of {pause_s:.3} s between two samples");
            if cannot_be_evaluated(known, leg) && refusal.is_none() {
                let why = "the pulse was repeated and still cannot be evaluated";
                refusal = Some((format!("{text}: {why}"), PAUSE_HELP));
            }
            texts.push(format!("{text}, the sample after it not evaluated"));
        }
    }
    if texts.is_empty() {
        texts.push("not determined: voltage, current and speed are not all measured".to_owned());
    }
    (texts.join("; "), refusal)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::limits::Limits;
    use crate::testing::has;
    use drivebench_model::sample::{Channel, Demand, Sample};

    pub(in crate::check) fn known(nameplate: &Nameplate, zero: Demand) -> Known<'_> {
        let limits = Limits::zk_22fc();
        Known {
            nameplate,
            size: Size::of(nameplate, &limits, zero, 0.15, 0.01),
            current: (0.0, 0.03),
            speed: (0.0, 0.15),
            noise_v: 0.02,
            signed_current: true,
            set_point: None,
            is_field_oriented: false,
            by_flux_linkage: None,
        }
    }

    fn known_at_voltage(nameplate: &Nameplate) -> Known<'_> {
        known(nameplate, Demand::Voltage(0.0))
    }

    fn push(known: &Known<'_>, leg: &mut Leg, time_s: f64, volts: f64, current_a: f64, speed: f64) {
        let reply =
            Sample::at(time_s).with(Channel::Current, current_a).with(Channel::Speed, speed);
        leg.push(&known.size, volts, Demand::Voltage(volts), &reply);
    }

    #[test]
    fn each_fault_of_a_direction_has_a_message() {
        let nameplate = Nameplate::zk_22fc();
        // Both ways, ending with these figures of the positive one.
        let ended = |volts: f64, current_a: f64, speed: f64, signed_current: bool| {
            let known = Known { signed_current, ..known_at_voltage(&nameplate) };
            let legs = [1.0, -1.0].map(|way| {
                let mut leg = Leg::new(way);
                for _ in 0..3 {
                    push(&known, &mut leg, 0.0, way * volts, way * current_a, way * speed);
                }
                leg
            });
            let (figures, refusal) = direction(&known, &legs);
            (figures, refusal.map_or_else(String::new, |(text, _)| text))
        };
        for (current_a, signed, words) in [
            (1.8, true, "+5.00 V: current 1.80 A, speed 9.00 rad/s; -5.00 V: current -1.80 A"),
            (-1.8, false, "has no sign"),
            (0.05, true, "sign is not determined"),
        ] {
            let (figures, refusal) = ended(5.0, current_a, 9.0, signed);
            assert_eq!(refusal, "");
            has(figures, words);
        }
        for (volts, current, speed, words) in [
            (5.0, 1.8, -9.0, "encoder reversed"),
            (5.0, -1.8, 9.0, "wrong sign: -1.80 A"),
            (3.3, 3.0, 0.1, "the shaft is held"),
            (10.0, 1.4, 0.1, "encoder frozen or not connected"),
            (1.7, 1.5, 0.1, "does not show whether it should"),
            (5.0, 0.01, 0.1, "open armature circuit"),
        ] {
            has(ended(volts, current, speed, true).1, words);
        }
    }

    #[test]
    fn a_current_offset_that_follows_the_voltage_is_found() {
        let nameplate = Nameplate::zk_22fc();
        let known = known_at_voltage(&nameplate);
        let pulse = |current_a: fn(f64) -> f64| {
            let mut leg = Leg::new(1.0);
            for step in 0..8 {
                let volts = 0.4 * f64::from(step);
                push(&known, &mut leg, 0.0, volts, current_a(volts), 0.0);
            }
            direction(&known, &[leg]).1.unwrap().0
        };
        // Of a ramp to 2.8 V the motor gets 2.3 V less.
        let offset = pulse(|volts| (volts - 2.3) / 1.1);
        has(&offset, "an offset: the current is -2.09 A");
        has(&offset, "by +2.55 A");
        has(pulse(|volts| -volts / 1.1), "wrong sign");
    }

    /// The paper's motor in a slow pulse one way. The sensors have these factors, brushes drop this voltage, and this long,
    /// s, comes before a sample.
    fn slow_pulse(
        known: &Known<'_>,
        way: f64,
        (current_factor, speed_factor): (f64, f64),
        drop_v: f64,
        period_s: impl Fn(usize) -> f64,
    ) -> Leg {
        let truth = Nameplate::zk_22fc();
        let mut leg = Leg::new(way);
        let mut time_s = 0.0;
        for step in 1..60 {
            let volts = 0.1 * f64::from(step);
            let friction_a = truth.load_torque_n_m / truth.back_emf_v_s_per_rad;
            let driving_v = (volts - drop_v).max(0.0);
            let current_a = (driving_v / truth.resistance_ohm).min(friction_a);
            let emf_v = (driving_v - truth.resistance_ohm * current_a).max(0.0);
            let speed = speed_factor * emf_v / truth.back_emf_v_s_per_rad;
            time_s += period_s(leg.points.len());
            push(
                known,
                &mut leg,
                time_s,
                way * volts,
                way * current_factor * current_a,
                way * speed,
            );
            if speed > 9.0 {
                break;
            }
        }
        leg
    }

    #[test]
    fn a_nameplate_is_refused_where_it_contradicts_the_pulse() {
        let nameplate = Nameplate::zk_22fc();
        let rpm = rpm_from_rad_s(1.0);
        let per_rpm = Nameplate {
            back_emf_v_s_per_rad: 0.3538 / rpm,
            // The torque constant changes with it.
            load_torque_n_m: 0.455 / rpm,
            ..nameplate.clone()
        };
        let other = Nameplate { resistance_ohm: 12.0, ..nameplate.clone() };
        for (nameplate, factors, drop_v, words) in [
            (&nameplate, (1.0, 1.0), 0.0, None),
            (&nameplate, (1.0, 1.0), 1.2, None),
            (&per_rpm, (1.0, 1.0), 0.0, Some("V per r/min on the nameplate")),
            (&nameplate, (1.0, rpm), 0.0, Some("r/min that is taken for rad/s")),
            (&nameplate, (1e3, 1.0), 0.0, Some("mA that is taken for A")),
            (&other, (1.0, 1.0), 0.0, Some("another motor")),
        ] {
            let known = known_at_voltage(nameplate);
            let leg = slow_pulse(&known, 1.0, factors, drop_v, |_| 0.01);
            let (text, refusal) = plausibility(&known, &[leg]);
            let refusal = refusal.map(|(text, _)| text);
            assert_eq!(refusal.is_some(), words.is_some(), "{drop_v} V: {text}");
            has(&text, "resistance");
            has(refusal.unwrap_or(text), words.unwrap_or("back-EMF constant 0.35"));
        }
    }

    #[test]
    fn a_wrong_speed_is_refused_with_the_set_points_name() {
        let nameplate = Nameplate::zk_22fc();
        let known = Known { set_point: Some("speed_ref"), ..known(&nameplate, Demand::Speed(0.0)) };
        let mut leg = Leg::new(1.0);
        leg.push(&known.size, 7.5, Demand::Speed(7.5), &Sample::at(0.0).with(Channel::Speed, 32.8));
        let text = plausibility(&known, &[leg]).1.unwrap().0;
        has(&text, "set-point 7.50 rad/s, measured 32.80 rad/s");
        has(&text, "word order or scale of speed_ref");
    }

    #[test]
    fn an_interval_is_refused_only_without_a_plausible_value() {
        let flux = |interval| Ratio::back_emf(1.0, interval);
        let winding = |interval| Ratio::resistance(1.0, interval);
        let nameplate = Nameplate::zk_22fc();
        let known = known_at_voltage(&nameplate);
        for ratio in [
            flux((0.0, 0.1, 0.3)),
            flux((0.0, 0.3, 0.68)),
            flux((0.45, 0.55, 0.65)),
            flux((1.5, 1.7, f64::INFINITY)),
            winding((0.0, 0.2, 0.49)),
            winding((3.1, 3.5, 3.9)),
        ] {
            assert!(ratio.is_refused(), "{}", ratio.text());
            let words = if ratio.unit == "ohm" { "0.5 to 3" } else { "0.7 to 1.4" };
            has(ratio.refusal(&known), &format!("{words} times is plausible"));
        }
        // Twice by the pulse: the stored flux linkage says the same, contradicts it, or there is none.
        for (by_flux_linkage, words) in [
            (Some(2.2), "the motor has 0.455 times the pole pairs"),
            (Some(1.1), "no usual mistake of units"),
            (None, "no usual mistake of units"),
        ] {
            let known = Known { by_flux_linkage, ..known };
            has(flux((1.8, 2.0, 2.2)).refusal(&known), words);
        }
        for (ratio, is_undetermined) in [
            (flux((0.0, 0.4, 0.75)), false),
            (flux((0.66, 0.95, 1.27)), false),
            (flux((0.66, 0.95, 1.41)), true),
            (flux((0.0, 0.9, f64::INFINITY)), true),
            (winding((0.48, 1.25, 2.08)), false),
            (winding((2.21, 3.28, 4.44)), false),
            (winding((0.0, 1.4, 3.1)), true),
            (winding(interval(0.5, 1.6, 0.1, 0.09)), true),
        ] {
            let text = ratio.text();
            assert!(!ratio.is_refused(), "{text}");
            assert_eq!(text.contains("is not determined"), is_undetermined, "{text}");
        }
    }

    #[test]
    fn the_samples_after_a_pause_are_not_evaluated() {
        let nameplate = Nameplate::zk_22fc();
        let known = known_at_voltage(&nameplate);
        let pulses = |pause_s: f64, after: fn(usize) -> bool| {
            let period_s = |point| if after(point) { pause_s } else { 0.01 };
            [1.0, -1.0].map(|way| slow_pulse(&known, way, (1.0, 1.0), 0.0, period_s))
        };
        // One cycle without a reply is no pause.
        for leg in pulses(0.02, |_| true) {
            assert!(leg.pause_s.is_none() && is_settled(&known, &leg));
        }
        // Other samples are enough.
        let (text, refusal) = plausibility(&known, &pulses(0.2, |point| point % 3 == 0));
        assert_eq!(refusal, None);
        has(&text, "back-EMF constant 0.35");
        has(&text, "back a pause of 0.200 s between two samples");
        let legs = pulses(0.2, |_| true);
        assert!(!is_settled(&known, &legs[0]));
        let (text, help) = plausibility(&known, &legs).1.unwrap();
        has(&text, "forward a pause of 0.200 s between two samples");
        has(text, "still cannot be evaluated");
        has(help, "--waive-plausibility");
    }
}
