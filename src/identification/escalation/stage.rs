//! What one stage does to the motor.

use serde::Serialize;

use super::{BREAK_AWAY, Bounds, CURRENT_SHARE, FEEL_CURRENT, MOVES, RestWinding};
use crate::excitation::{Ramp, Segment, Standstill, Steps};

/// Standstill at the begin, ramps and holds: seconds, and periods that they have at least.
const STANDSTILL: (f64, f64) = (0.4, 30.0);
const RAMP: (f64, f64) = (0.4, 30.0);
const HOLD: (f64, f64) = (0.3, 20.0);
/// Least and greatest hold of a step, s; in between three mechanical time constants.
const STEP_S: (f64, f64) = (0.3, 1.5);

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum StageKind {
    /// Slow ramps at tiny voltages.
    Feel,
    /// Slowly up to the rated current.
    BreakAway,
    /// Steps in both directions.
    Turn,
    /// Farther up in speed, as fast as the current allows.
    Sweep,
}

impl StageKind {
    pub const fn name(self) -> &'static str {
        match self {
            Self::Feel => "feel",
            Self::BreakAway => "break away",
            Self::Turn => "turn",
            Self::Sweep => "sweep",
        }
    }
}

/// One short run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Stage {
    pub kind: StageKind,
    pub segments: Vec<Segment>,
    pub slew_v_per_s: f64,
    /// Largest voltage that is asked for, V.
    pub peak_v: f64,
    /// The stage ends, without a fault, as soon as one of these is reached.
    pub stop_current_a: f64,
    pub stop_speed_rad_s: f64,
    /// Largest voltage across the winding, V, where the resistance is known well enough to bound it.
    pub winding_v: Option<f64>,
    /// Back-EMF constant around which that bound lies; 0 where it is not known.
    pub back_emf_v_s_per_rad: f64,
    /// Why it is as large as it is.
    pub reason: String,
}

fn seconds((least_s, periods): (f64, f64), bounds: &Bounds) -> f64 {
    least_s.max(periods * bounds.period_s)
}

fn standstill(bounds: &Bounds) -> Segment {
    Segment::Standstill(Standstill {
        seconds: seconds(STANDSTILL, bounds),
    })
}

fn ramp(from_v: f64, to_v: f64, bounds: &Bounds) -> Segment {
    Segment::Ramp(Ramp {
        from_v,
        to_v,
        seconds: seconds(RAMP, bounds),
        dither: None,
    })
}

fn hold(level_v: f64, seconds: f64) -> Segment {
    Segment::Steps(Steps {
        levels_v: vec![level_v],
        hold_s: seconds,
        dither: None,
    })
}

pub(super) fn feel(bounds: &Bounds, peak_v: f64, reason: String) -> Stage {
    Stage {
        kind: StageKind::Feel,
        segments: vec![
            standstill(bounds),
            ramp(0.0, peak_v, bounds),
            hold(peak_v, seconds(HOLD, bounds)),
            ramp(peak_v, 0.0, bounds),
        ],
        // Not faster than the ramps: an early end is as gentle as they are.
        slew_v_per_s: 1.05 * peak_v / seconds(RAMP, bounds),
        peak_v,
        stop_current_a: FEEL_CURRENT * bounds.rated_current_a,
        stop_speed_rad_s: MOVES * bounds.speed_limit_rad_s,
        winding_v: None,
        back_emf_v_s_per_rad: 0.0,
        reason,
    }
}

/// Half the rated current, then the whole.
pub(super) fn break_away(bounds: &Bounds, rest: &RestWinding, most: f64) -> Stage {
    let rated_v = bounds.rated_current_a * rest.resistance_ohm;
    let peak_v = (most * rated_v).min(bounds.voltage_limit_v);
    let half_v = 0.5 * peak_v;
    Stage {
        kind: StageKind::BreakAway,
        segments: vec![
            standstill(bounds),
            ramp(0.0, half_v, bounds),
            hold(half_v, seconds(HOLD, bounds)),
            ramp(half_v, peak_v, bounds),
            hold(peak_v, seconds(HOLD, bounds)),
            ramp(peak_v, 0.0, bounds),
        ],
        slew_v_per_s: 1.05 * peak_v / seconds(RAMP, bounds),
        peak_v,
        stop_current_a: (1.15 * BREAK_AWAY * bounds.rated_current_a)
            .min(CURRENT_SHARE * bounds.current_limit_a),
        stop_speed_rad_s: MOVES * bounds.speed_limit_rad_s,
        winding_v: None,
        back_emf_v_s_per_rad: 0.0,
        reason: format!(
            "{:.3} ohm at rest: {peak_v:.2} V drive the rated current",
            rest.resistance_ohm
        ),
    }
}

/// What a sweep is made of: the motor as far as it is known.
pub(super) struct Sweep {
    pub(super) peak_v: f64,
    pub(super) slew_v_per_s: f64,
    pub(super) winding_v: f64,
    pub(super) back_emf_v_s_per_rad: f64,
    pub(super) mechanical_s: f64,
    pub(super) stop_current_a: f64,
}

/// Forward, back to zero, backward, back to zero, each level held for so long.
fn both_ways(
    bounds: &Bounds,
    kind: StageKind,
    sweep: &Sweep,
    hold_s: f64,
    reason: String,
) -> Stage {
    Stage {
        kind,
        segments: vec![
            standstill(bounds),
            Segment::Steps(Steps {
                levels_v: vec![sweep.peak_v, 0.0, -sweep.peak_v, 0.0],
                hold_s,
                dither: None,
            }),
        ],
        slew_v_per_s: sweep.slew_v_per_s,
        peak_v: sweep.peak_v,
        stop_current_a: sweep.stop_current_a,
        stop_speed_rad_s: 0.7 * bounds.speed_limit_rad_s,
        winding_v: Some(sweep.winding_v),
        back_emf_v_s_per_rad: sweep.back_emf_v_s_per_rad,
        reason,
    }
}

/// Steps in both directions. `winding_v` is what the guard allows across the winding.
pub(super) fn turn(
    bounds: &Bounds,
    volts: f64,
    wanted_a: f64,
    winding_v: f64,
    mechanical_s: Option<f64>,
    reason: String,
) -> Stage {
    let hold_s = mechanical_s
        .map_or(STEP_S.0, |constant_s| {
            (3.0 * constant_s).clamp(STEP_S.0, STEP_S.1)
        })
        .max(30.0 * bounds.period_s);
    let steps = Sweep {
        peak_v: volts,
        // Within one period: a step.
        slew_v_per_s: volts / bounds.period_s.min(0.01),
        winding_v,
        back_emf_v_s_per_rad: 0.0,
        mechanical_s: 0.0,
        stop_current_a: (1.5 * wanted_a).min(0.9 * bounds.current_limit_a),
    };
    both_ways(bounds, StageKind::Turn, &steps, hold_s, reason)
}

/// Up to a speed, to rest, and the same backward, with a slew that the acceleration current bounds.
pub(super) fn sweep(bounds: &Bounds, sweep: &Sweep, reason: String) -> Stage {
    let slope_s = sweep.peak_v / sweep.slew_v_per_s;
    let settle_s = (2.0 * sweep.mechanical_s)
        .clamp(0.1, 0.5)
        .max(10.0 * bounds.period_s);
    both_ways(bounds, StageKind::Sweep, sweep, slope_s + settle_s, reason)
}
