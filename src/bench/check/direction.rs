//! Whether current and speed went the way that was asked. Pure.

use super::pulse::{Kind, Leg, Point, Size};
use crate::bench::limits::Nameplate;

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
struct Seen {
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

impl Seen {
    fn of(known: &Known<'_>, leg: &Leg) -> Self {
        let currents = leg
            .points
            .iter()
            .filter_map(|point| Some(point.current_a? - known.current.0 - known.size.hold_a));
        let speeds: Vec<f64> = leg
            .points
            .iter()
            .rev()
            .filter_map(|point| point.speed_rad_s)
            .take(2)
            .collect();
        let mean = speeds.iter().sum::<f64>() / speeds.len().max(1) as f64 - known.speed.0;
        Self {
            asked: leg
                .points
                .iter()
                .map(|p| p.asked)
                .fold(0.0, |a: f64, b| if b.abs() > a.abs() { b } else { a }),
            current_a: currents.reduce(|a, b| if b.abs() > a.abs() { b } else { a }),
            rise_a: rise_a(leg),
            speed_rad_s: (!speeds.is_empty()).then_some(mean),
            by_voltage_rad_s: leg
                .points
                .last()
                .and_then(|point| known.size.by_voltage_rad_s(point)),
        }
    }

    fn text(&self, kind: Kind) -> String {
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
pub(super) fn judge(known: &Known<'_>, legs: &[Leg]) -> (String, Option<(String, &'static str)>) {
    let seen: Vec<Seen> = legs.iter().map(|leg| Seen::of(known, leg)).collect();
    let kind = known.size.kind;
    let figures: Vec<String> = seen.iter().map(|seen| seen.text(kind)).collect();
    let mut figures = figures.join("; ");
    let mut refusal = None;
    for (leg, seen) in legs.iter().zip(&seen) {
        refusal = refusal.or_else(|| fault(known, leg.direction, seen));
    }
    let slack = |seen: &Seen| {
        let flows = seen
            .current_a
            .is_none_or(|amps| amps.abs() > known.flowed_a());
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

fn fault(known: &Known<'_>, direction: f64, seen: &Seen) -> Option<(String, &'static str)> {
    let flows = |amps: f64| amps.abs() > known.flowed_a();
    let current = seen.current_a.filter(|amps| flows(*amps));
    if known.signed_current
        && let Some(amps) = current
        && amps * direction < 0.0
    {
        // A sensor the wrong way round shows a change the wrong way round too.
        if let Some(rise_a) = seen
            .rise_a
            .filter(|rise| rise * direction > known.flowed_a())
        {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::limits::Limits;
    use crate::bench::testing::has;
    use crate::sample::{Channel, Demand, Sample};

    /// A pulse both ways that ends with these figures for the positive way, and the same the other way.
    fn judged(
        volts: f64,
        current_a: f64,
        speed_rad_s: f64,
        signed_current: bool,
    ) -> (String, String) {
        let plate = Nameplate::zk_22fc();
        let limits = Limits::for_motor(&plate, 100.0);
        let size = Size::of(&plate, &limits, Demand::Voltage(0.0), 0.15, 0.01);
        let legs = [1.0, -1.0].map(|direction| {
            let mut leg = Leg::new(direction);
            for _ in 0..3 {
                let sample = Sample::at(0.0)
                    .with(Channel::Current, direction * current_a)
                    .with(Channel::Speed, direction * speed_rad_s);
                leg.push(&size, volts * direction, &sample);
            }
            leg
        });
        let known = Known {
            plate: &plate,
            size,
            current: (0.0, 0.03),
            speed: (0.0, 0.15),
            signed_current,
            set_point: None,
        };
        let (figures, refusal) = judge(&known, &legs);
        (figures, refusal.map_or_else(String::new, |(text, _)| text))
    }

    #[test]
    fn each_fault_has_its_own_words() {
        let (figures, refusal) = judged(5.0, 1.8, 9.0, true);
        assert_eq!(refusal, "");
        has(&figures, "+5.00 V: current 1.80 A, speed 9.00 rad/s");
        assert!(figures.contains("-5.00 V: current -1.80 A"), "{figures}");
        for (volts, current, speed, words) in [
            (5.0, 1.8, -9.0, "encoder reversed"),
            (5.0, -1.8, 9.0, "wrong sign: -1.80 A"),
            (3.3, 3.0, 0.1, "the shaft is held"),
            (10.0, 1.4, 0.1, "encoder frozen or not connected"),
            (1.7, 1.5, 0.1, "cannot be told at this size"),
            (5.0, 0.01, 0.1, "open armature circuit"),
        ] {
            let (_, refusal) = judged(volts, current, speed, true);
            assert!(refusal.contains(words), "{words}: {refusal}");
        }
    }

    #[test]
    fn a_current_that_starts_elsewhere_and_goes_with_the_voltage_is_an_offset() {
        let plate = Nameplate::zk_22fc();
        let limits = Limits::for_motor(&plate, 100.0);
        let size = Size::of(&plate, &limits, Demand::Voltage(0.0), 0.15, 0.01);
        let known = Known {
            plate: &plate,
            size,
            current: (0.0, 0.03),
            speed: (0.0, 0.15),
            signed_current: true,
            set_point: None,
        };
        let pulse = |current_a: fn(f64) -> f64| {
            let mut leg = Leg::new(1.0);
            for step in 0..8 {
                let volts = 0.4 * f64::from(step);
                let sample = Sample::at(0.0)
                    .with(Channel::Current, current_a(volts))
                    .with(Channel::Speed, 0.0);
                leg.push(&size, volts, &sample);
            }
            judge(&known, &[leg])
                .1
                .map_or_else(String::new, |(text, _)| text)
        };
        // Of a ramp to 2.8 V the motor gets 2.3 V less.
        let offset = pulse(|volts| (volts - 2.3) / 1.1);
        assert!(
            offset.starts_with("an offset: the current is -2.09 A"),
            "{offset}"
        );
        assert!(offset.contains("by +2.55 A"), "{offset}");
        let reversed = pulse(|volts| -volts / 1.1);
        assert!(reversed.contains("wrong sign"), "{reversed}");
    }

    #[test]
    fn a_current_without_a_sign_or_within_its_noise_is_not_held_against_the_drive() {
        let (figures, refusal) = judged(5.0, -1.8, 9.0, false);
        assert_eq!(refusal, "");
        assert!(figures.contains("has no sign"), "{figures}");
        let (figures, refusal) = judged(5.0, 0.05, 9.0, true);
        assert_eq!(refusal, "");
        assert!(figures.contains("sign cannot be told"), "{figures}");
    }
}
