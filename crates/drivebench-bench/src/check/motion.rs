//! Motion of the pulse: the angle against the integral of the speed, and the impulse of the current of the two directions. Pure.

use super::judge::Known;
use super::pulse::Leg;
use drivebench_control::Actuator;
use drivebench_identify::belief::{Range, Settings};

/// Ratios of the angle to the integral of the speed that a lag of the speed leaves: the next wrong count of pole pairs is a factor of
/// 1.5 (3 for 2).
const ANGLE_BY_SPEED: Range = Range::new(0.7, 1.4);
/// Ratio of the impulses of the two directions beyond which they differ: friction and a small load leave less.
const ONE_SIDED: f64 = 1.6;

/// The angle that a direction turned, and that by its speed, rad. `None` where one is missing, or a pause lies between.
fn turned(known: &Known<'_>, leg: &Leg) -> Option<(f64, f64)> {
    let (first, last) = (leg.points.first()?, leg.points.last()?);
    let turned = last.angle_rad? - first.angle_rad?;
    let mut by_speed = 0.0;
    for pair in leg.points.windows(2) {
        if pair[1].is_after_pause {
            return None;
        }
        let speeds = f64::midpoint(pair[0].speed_rad_s?, pair[1].speed_rad_s?);
        by_speed += (speeds - known.speed.0) * (pair[1].time_s - pair[0].time_s);
    }
    let noise = Settings::CLEAR_STD * known.speed.1 * (last.time_s - first.time_s);
    let is_clear = by_speed.abs() > noise / (leg.points.len() as f64).sqrt() && turned != 0.0;
    is_clear.then_some((turned, by_speed))
}

/// An angle that is not the integral of the speed, and the next step.
pub(super) fn angle_fault(known: &Known<'_>, legs: &[Leg]) -> Option<(String, &'static str)> {
    let both: Vec<(f64, f64)> = legs.iter().filter_map(|leg| turned(known, leg)).collect();
    let differs =
        |&(turned, by_speed): &(f64, f64)| ANGLE_BY_SPEED.gap(Range::at(turned / by_speed)) > 0.0;
    // In every direction: a single one may have turned through a preset of its counter.
    if both.is_empty() || !both.iter().all(differs) {
        return None;
    }
    let [turned, by_speed] = [|own: &(f64, f64)| own.0.abs(), |own: &(f64, f64)| own.1.abs()]
        .map(|part| both.iter().map(part).sum::<f64>());
    Some((
        format!(
            "the angle turns by {turned:.2} rad, and by the speed it would be {by_speed:.2} rad: {:.2} times",
            turned / by_speed
        ),
        "check the pole pairs, the counts per turn and the gear in the drive and in its profile; --waive-direction goes on without this check",
    ))
}

/// A remark where one direction takes much more current for the same speed.
pub(super) fn one_sided(known: &Known<'_>, legs: &[Leg]) -> Option<String> {
    let [there, back] = legs else { return None };
    let impulse = |leg: &Leg| -> Option<f64> {
        let charge = leg.points.windows(2).map(|pair| {
            Some((pair[1].current_a? - known.size.hold_a) * (pair[1].time_s - pair[0].time_s))
        });
        Some(charge.sum::<Option<f64>>()?.abs())
    };
    let (there, back) = (impulse(there)?, impulse(back)?);
    let ratio = there.max(back) / there.min(back);
    let is_one_sided = known.size.kind == Actuator::Current && ratio > ONE_SIDED;
    is_one_sided.then(|| {
        let way = if there > back { "forward" } else { "backward" };
        format!(
            "; {way} takes {ratio:.1} times the current of the other direction for the same speed: a load that pulls one way, or an offset between the encoder and the phases"
        )
    })
}

#[cfg(test)]
mod tests {
    use super::super::pulse::{Point, Size};
    use super::*;
    use crate::limits::{Limits, Nameplate};
    use drivebench_model::sample::Demand;

    fn legs(angle_factor: f64, back_factor: f64) -> Vec<Leg> {
        let leg = |direction: f64, amps: f64| {
            let mut leg = Leg::new(direction);
            let mut angle = 3.0;
            for row in 0..60 {
                let speed = direction * 0.15 * f64::from(row);
                angle += angle_factor * speed * 0.01;
                leg.points.push(Point {
                    time_s: 0.01 * f64::from(row),
                    demand: direction,
                    voltage_v: None,
                    current_a: Some(direction * amps),
                    speed_rad_s: Some(speed),
                    angle_rad: Some(angle),
                    is_after_pause: false,
                });
            }
            leg
        };
        vec![leg(1.0, 2.0), leg(-1.0, 2.0 * back_factor)]
    }

    #[test]
    fn pole_pairs_and_one_sided_torque_show_in_the_motion() {
        let nameplate = Nameplate::zk_22fc();
        let limits = Limits::for_motor(&nameplate, 100.0);
        let size = Size::of(&nameplate, &limits, Demand::Current(0.0), 0.15, 0.01);
        let known = Known {
            nameplate: &nameplate,
            size,
            current: (0.0, 0.03),
            speed: (0.0, 0.15),
            noise_v: 0.0,
            signed_current: true,
            set_point: None,
        };
        for (factor, is_wrong) in
            [(1.0, false), (1.2, false), (0.5, true), (2.0, true), (1.5, true)]
        {
            let fault = angle_fault(&known, &legs(factor, 1.0));
            assert_eq!(fault.is_some(), is_wrong, "{factor}: {fault:?}");
        }
        let (text, help) = angle_fault(&known, &legs(0.5, 1.0)).unwrap();
        assert!(text.contains("0.5") && help.contains("pole pairs"), "{text}");
        assert_eq!(one_sided(&known, &legs(1.0, 1.2)), None);
        assert!(one_sided(&known, &legs(1.0, 2.0)).unwrap().contains("backward takes 2.0 times"));
        // Noise at rest is no motion.
        let mut still = legs(1.0, 1.0);
        still.iter_mut().flat_map(|leg| &mut leg.points).for_each(|p| p.speed_rad_s = Some(0.01));
        assert_eq!(angle_fault(&known, &still), None);
    }
}
