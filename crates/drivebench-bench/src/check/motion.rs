//! The impulse of the current in the two directions of the pulse. Pure.

use super::judge::Known;
use super::pulse::Leg;
use drivebench_control::Actuator;

/// Ratio of the impulses of the two directions beyond which they differ: friction and a small load leave less.
const ONE_SIDED: f64 = 1.6;

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
    use super::super::judge::tests::known;
    use super::super::pulse::Point;
    use super::*;
    use crate::limits::Nameplate;
    use drivebench_model::sample::Demand;

    fn legs(back_factor: f64) -> Vec<Leg> {
        let leg = |direction: f64, amps: f64| {
            let mut leg = Leg::new(direction);
            leg.points.extend((0..60).map(|row| Point {
                time_s: 0.01 * f64::from(row),
                demand: direction,
                voltage_v: None,
                current_a: Some(direction * amps),
                speed_rad_s: Some(direction * 0.15 * f64::from(row)),
                angle_rad: None,
                is_after_pause: false,
            }));
            leg
        };
        vec![leg(1.0, 2.0), leg(-1.0, 2.0 * back_factor)]
    }

    #[test]
    fn a_direction_that_takes_more_current_is_remarked() {
        let nameplate = Nameplate::zk_22fc();
        let by_current = known(&nameplate, Demand::Current(0.0));
        assert_eq!(one_sided(&by_current, &legs(1.2)), None);
        let text = one_sided(&by_current, &legs(2.0)).unwrap();
        assert!(text.contains("backward takes 2.0 times"), "{text}");
        assert_eq!(one_sided(&by_current, &legs(1.0)[..1]), None);
        assert_eq!(one_sided(&known(&nameplate, Demand::Voltage(0.0)), &legs(2.0)), None);
    }
}
