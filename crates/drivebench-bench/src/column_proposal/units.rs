//! The units of speed and angle against each other: the speed is the derivative of the angle.

use super::Confidence;
use super::choice::of_channel;
use super::finding::{Doubt, Reason};
use super::known::{Factor, Unit};
use super::reading::UnitFrom;
use super::source::Source;
use drivebench_identify::sanity;
use drivebench_model::numerics::statistics::largest_but_outliers;
use drivebench_model::sample::{Channel, Origin, Run};

fn near(ratio: f64, expected: f64) -> bool {
    (ratio / expected - 1.0).abs() < 0.03
}

/// Integral of the speed over the change of the angle, both as they stand in the file.
fn ratio(time_s: &[f64], speed: &Source, angle: &Source) -> Option<f64> {
    let mut run = Run::new("preview", time_s.to_vec()).ok()?;
    for (channel, source) in [(Channel::Speed, speed), (Channel::Angle, angle)] {
        let raw = source.values.iter().map(|value| value / source.factor.value).collect();
        run.set_column(channel, raw, Origin::Unknown).ok()?;
    }
    sanity::speed_over_angle(&run)
}

/// Settles the units of speed and angle, and the pole pairs of an electrical speed.
pub(super) fn settle_units(time_s: &[f64], chosen: &mut [Source], angle: Option<&mut Source>) {
    let Some(speed) = of_channel(chosen, Channel::Speed) else { return };
    if let Some(angle) = angle
        && angle.factor.number.is_none()
        && let Some(ratio) = ratio(time_s, speed, angle)
    {
        against_angle(ratio, speed, angle);
    }
    if speed.unit_from == UnitFrom::Open && speed.factor.number.is_none() {
        let reaches = largest_but_outliers(&speed.values);
        let is_si = (speed.factor.value.abs() - 1.0).abs() < 1e-9;
        speed.confidence = Confidence::Unsure;
        // 1,500 rad/s is 14,300 r/min.
        let doubt = if reaches > 1500.0 && is_si {
            speed.scale(Unit::of("r/min").map_or(1.0, |unit| unit.factor.value));
            Doubt::TakenAsRpm { reaches }
        } else {
            let unit = if is_si { "rad/s" } else { "turns/s" };
            Doubt::SpeedUnit { unit, reaches: reaches / speed.factor.value.abs() }
        };
        speed.doubts.push(doubt);
    }
}

/// The units that a source may be in, with their factors.
fn units_of(source: &Source, usual: &[&str]) -> Vec<(Option<&'static str>, f64)> {
    if source.unit_from == UnitFrom::Stated {
        return vec![(None, source.factor.value.abs())];
    }
    let usual = usual.iter().filter_map(|name| Unit::of(name));
    usual.map(|unit| (Some(unit.name), unit.factor.value)).collect()
}

fn against_angle(over_angle: f64, speed: &mut Source, angle: &mut Source) {
    let is_stated = |source: &Source| source.unit_from == UnitFrom::Stated;
    if speed.factor.number == Some(("POLE_PAIRS", -1)) {
        let pairs = (over_angle * speed.factor.value / angle.factor.value).abs();
        let whole = pairs.round();
        if is_stated(angle) && (1.0..=50.0).contains(&whole) && near(pairs, whole) {
            speed.factor = Factor::of(speed.factor.value);
            speed.scale(1.0 / whole);
            speed.at_least(Confidence::Likely);
            speed.reasons.push(Reason::PolePairs { over_angle, pairs: whole });
        }
        return;
    }
    if speed.factor.number.is_some() {
        return;
    }
    // Unit and factor of the speed, factor of the angle.
    let mut pairs = Vec::new();
    for (speed_unit, speed_factor) in units_of(speed, &["rad/s", "r/min", "deg/s", "turns/s"]) {
        for (_, angle_factor) in units_of(angle, &["rad", "deg", "turns"]) {
            if near(over_angle.abs(), angle_factor / speed_factor) {
                pairs.push((speed_unit, speed_factor, angle_factor));
            }
        }
    }
    match pairs.as_slice() {
        [(speed_unit, speed_factor, angle_factor)] => {
            speed.scale(speed_factor / speed.factor.value.abs());
            angle.scale(angle_factor / angle.factor.value.abs());
            if !is_stated(speed) {
                speed.confidence = Confidence::Likely;
                speed.unit_from = UnitFrom::Convention;
            }
            let units = speed_unit.iter().copied().collect();
            speed.reasons.push(Reason::OverAngle { over_angle, units });
            angle.unit_from = UnitFrom::Stated;
        }
        [] if is_stated(speed) && is_stated(angle) => {
            let in_units = over_angle * speed.factor.value / angle.factor.value;
            speed.confidence = Confidence::Unsure;
            speed.doubts.push(Doubt::OverAngle { over_angle, in_units });
        }
        [] => {}
        several => {
            let units: Vec<&'static str> = several.iter().filter_map(|pair| pair.0).collect();
            if !units.is_empty() {
                speed.reasons.push(Reason::OverAngle { over_angle, units });
            }
        }
    }
}
