//! The units of speed and angle against each other: the speed is the derivative of the angle.

use super::Confidence;
use super::choice::Chosen;
use super::known::{Factor, Known, Quantity};
use super::reading::UnitFrom;
use super::source::Source;
use drivebench_identify::sanity;
use drivebench_model::numerics::statistics::largest_but_outliers;
use drivebench_model::sample::{Channel, Origin, Run};
use drivebench_model::text::number::shortest;

fn near(ratio: f64, expected: f64) -> bool {
    (ratio / expected - 1.0).abs() < 0.03
}

/// Integral of the speed over the change of the angle, both as they stand in the file.
fn ratio(time_s: &[f64], speed: &Source, angle: &Source) -> Option<f64> {
    let mut run = Run::new("preview", time_s.to_vec()).ok()?;
    let raw = |source: &Source| source.values.iter().map(|value| value / source.factor).collect();
    run.set_column(Channel::Speed, raw(speed), Origin::Unknown).ok()?;
    run.set_column(Channel::Angle, raw(angle), Origin::Unknown).ok()?;
    sanity::speed_over_angle(&run)
}

/// Settles the units of speed and angle, and the pole pairs of an electrical speed.
pub(super) fn settle_units(time_s: &[f64], chosen: &mut Chosen, angle: Option<&mut Source>) {
    let Some(speed) = chosen.get_mut(Channel::Speed) else { return };
    if let Some(angle) = angle
        && angle.hole.is_none()
        && let Some(ratio) = ratio(time_s, speed, angle)
    {
        against_angle(ratio, speed, angle);
    }
    let fast = largest_but_outliers(&speed.values);
    if speed.unit_from == UnitFrom::Open && speed.hole.is_none() {
        let rpm = 0.104_719_755;
        let is_si = (speed.factor.abs() - 1.0).abs() < 1e-9;
        speed.confidence = Confidence::Unsure;
        // 1,500 rad/s is 14,300 r/min.
        if fast > 1500.0 && is_si {
            speed.scale(rpm);
            speed.doubts.push(format!(
                "no unit is written; it reaches {}: taken as r/min, since few motors turn at so many rad/s",
                shortest(fast, 4)
            ));
        } else {
            speed.doubts.push(format!(
                "no unit is written, and the balances hold in any: taken as it stands in {} (it reaches {}); in r/min write *{} instead",
                if is_si { "rad/s" } else { "turns/s" },
                shortest(fast / speed.factor.abs(), 4),
                shortest(rpm, 9),
            ));
        }
    }
}

fn against_angle(ratio: f64, speed: &mut Source, angle: &mut Source) {
    let known = Known::get();
    let evidence = format!("its integral is {} times the change of the angle", shortest(ratio, 4));
    let is_stated = |source: &Source| source.unit_from == UnitFrom::Stated;
    if speed.hole.as_deref().is_some_and(|hole| hole.ends_with("/POLE_PAIRS")) {
        // The factor of the unit stands in the hole, and is in the values.
        let unit: Option<f64> =
            speed.hole.as_deref().and_then(|hole| hole.split('/').next()?.parse().ok());
        let pairs = ratio / angle.factor;
        let whole = pairs.abs().round();
        if is_stated(angle) && (1.0..=50.0).contains(&whole) && near(pairs.abs(), whole) {
            speed.hole = None;
            speed.factor = unit.unwrap_or(1.0) / whole;
            for value in &mut speed.values {
                *value /= whole;
            }
            speed.confidence = speed.confidence.max(Confidence::Likely);
            speed.reasons.push(format!("{evidence}: {whole} pole pairs, or the ratio of a gear"));
        }
        return;
    }
    if speed.hole.is_some() {
        return;
    }
    let unit_of = |quantity, stated: &Source| -> Vec<(String, f64)> {
        if is_stated(stated) {
            return vec![(String::new(), stated.factor.abs())];
        }
        let usual = match quantity {
            Quantity::Angle => &["rad", "deg", "turns"][..],
            _ => &["rad/s", "r/min", "deg/s", "turns/s"],
        };
        let factor = |name: &&str| match known.unit(name)?.factor {
            Factor::Known(factor) => Some(((*name).to_owned(), factor)),
            Factor::Hole(_) => None,
        };
        usual.iter().filter_map(factor).collect()
    };
    let mut pairs = Vec::new();
    for (speed_unit, speed_factor) in unit_of(Quantity::Speed, speed) {
        for (angle_unit, angle_factor) in unit_of(Quantity::Angle, angle) {
            if near(ratio.abs(), angle_factor / speed_factor) {
                pairs.push((speed_unit.clone(), speed_factor, angle_unit, angle_factor));
            }
        }
    }
    match pairs.as_slice() {
        [(speed_unit, speed_factor, _, angle_factor)] => {
            speed.scale(speed_factor / speed.factor.abs());
            angle.scale(angle_factor / angle.factor.abs());
            speed.reasons.push(evidence);
            if !is_stated(speed) {
                speed.reasons.push(format!("so that it is in {speed_unit}"));
                speed.confidence = Confidence::Likely;
                speed.unit_from = UnitFrom::Convention;
            }
            angle.unit_from = UnitFrom::Stated;
        }
        [] if is_stated(speed) && is_stated(angle) => {
            let times = ratio * speed.factor / angle.factor;
            speed.confidence = Confidence::Unsure;
            speed.doubts.push(format!(
                "{evidence}, {} times what its unit says: an electrical speed, another side of a gear, or a wrong unit",
                shortest(times, 4)
            ));
        }
        [] => {}
        several => {
            let named: Vec<&str> = several.iter().map(|pair| pair.0.as_str()).collect();
            if named.iter().all(|name| !name.is_empty()) {
                speed.reasons.push(format!("{evidence}: it is in {}", named.join(" or ")));
            }
        }
    }
}
