//! What load, supply and converter do not allow of a sequence, and what has to be known about it.

use super::trace::{Point, Trace};
use super::{Plan, Refusal, SegmentPlan};
use crate::bench::limits::{Limits, Nameplate};

pub(super) const FALL: &str = "free fall of a vertical load";
pub(super) const UNHELD: &str = "vertical load without a described brake";
pub(super) const REVERSE_V: &str = "reverse voltage";
pub(super) const REVERSE_A: &str = "reverse current";

/// Share of the rated current below which a reverse current is one of the ripple.
const REVERSE_SHARE: f64 = 0.05;

/// Refusals beside those of the limits, one of a kind for each segment.
pub(super) fn refusals(
    trace: &Trace,
    segments: &[SegmentPlan],
    motor: &Nameplate,
    limits: &Limits,
) -> Vec<Refusal> {
    let mut refusals = Vec::new();
    if limits.load.vertical && limits.load.missing().is_some() {
        refusals.push(Refusal {
            segment: segments
                .first()
                .map_or_else(String::new, |s| s.name.clone()),
            quantity: UNHELD,
            predicted: segments.last().map_or(0.0, |segment| segment.end_s),
            limit: 0.0,
            unit: "s",
        });
    }
    let reverse_a = REVERSE_SHARE * motor.rated_current_a;
    for (index, segment) in segments.iter().enumerate() {
        let points = || trace.points.iter().filter(move |p| p.segment == index);
        let coasts_s = trace.step_s * points().filter(|point| point.coasts).count() as f64;
        let most = |of: &dyn Fn(&Point) -> f64| points().map(of).fold(0.0, f64::max);
        let reverse_v = most(&|point| -point.wanted_v);
        let driven_back = |point: &Point| point.wanted_v < 0.0 && point.current_a < -reverse_a;
        let reverse_i = most(&|point| {
            if driven_back(point) {
                -point.current_a
            } else {
                0.0
            }
        });
        let found = [
            (limits.load.vertical, FALL, coasts_s, "s"),
            (limits.quadrants < 2, REVERSE_V, reverse_v, "V"),
            (limits.quadrants == 2, REVERSE_A, reverse_i, "A"),
        ];
        for (applies, quantity, predicted, unit) in found {
            if applies && predicted > 0.0 {
                refusals.push(Refusal {
                    segment: segment.name.clone(),
                    quantity,
                    predicted,
                    limit: 0.0,
                    unit,
                });
            }
        }
    }
    refusals
}

/// What the person at the bench has to know.
pub(super) fn warnings(trace: &Trace, plan: &Plan, limits: &Limits, rate_hz: f64) -> Vec<String> {
    let mut warnings = Vec::new();
    if let Some(watts) = limits.braking_w {
        let limited = trace.points.iter().filter(|point| point.supply).count();
        let share = 100.0 * limited as f64 / trace.points.len().max(1) as f64;
        warnings.push(format!(
            "the supply takes nothing back and {watts} W are burnt beside the winding: deceleration is limited in \
             {share:.0} % of the run, where the voltage is not that of the sequence; braking returns at most {:.1} W, {:.2} J",
            plan.peak_returned_w, plan.returned_j
        ));
        if limits.bus_max_v.is_none() {
            warnings.push(
                "limits.bus_max_v is not given: a bus that rises under braking does not end the run".to_owned(),
            );
        }
    }
    if limits.dead_time_s > 0.0 {
        let dead_ms = 1e3 * limits.dead_time_s;
        let most_hz = 1.0 / limits.dead_time_s;
        warnings.push(if rate_hz > most_hz {
            format!(
                "the thyristor bridge takes a command up to {dead_ms} ms late: of {rate_hz} Hz it follows {most_hz:.0} Hz"
            )
        } else {
            format!("the thyristor bridge takes a command up to {dead_ms} ms late")
        });
    }
    if limits.quadrants < 4 && trace.points.iter().any(|p| p.current_a < 0.0) {
        warnings.push(
            "the converter gives no negative current: where one is predicted the shaft coasts instead".to_owned(),
        );
    }
    warnings
}
