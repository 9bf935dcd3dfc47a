//! Stages of an escalation: the excitation of each.

use serde::Serialize;

use super::{BREAK_AWAY, Bounds, CURRENT_SHARE, FEEL_CURRENT, RestWinding};
use drivebench_model::excitation::{Ramp, Segment, Standstill, Steps};

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum StageKind {
    /// Slow ramps at tiny voltages.
    #[default]
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

/// Length of the standstill at the begin and of each ramp, s.
fn ramp_s(bounds: &Bounds) -> f64 {
    f64::max(0.4, 30.0 * bounds.period_s)
}

fn standstill(bounds: &Bounds) -> Segment {
    let seconds = ramp_s(bounds);
    Segment::Standstill(Standstill { seconds })
}

fn steps(levels_v: Vec<f64>, hold_s: f64) -> Segment {
    Segment::Steps(Steps { levels_v, hold_s, dither: None })
}

/// Slowly from rest through these levels, each held for a while, and back.
fn slowly(bounds: &Bounds, kind: StageKind, levels_v: &[f64], reason: String) -> Stage {
    let stop_at = match kind {
        StageKind::Feel => FEEL_CURRENT,
        _ => 1.15 * BREAK_AWAY,
    };
    let ramp_s = ramp_s(bounds);
    let hold_s = f64::max(0.3, 20.0 * bounds.period_s);
    let ramp = |from_v: f64, to_v: f64| {
        Segment::Ramp(Ramp { from_v, to_v, seconds: ramp_s, dither: None })
    };
    let (mut segments, mut peak_v) = (vec![standstill(bounds)], 0.0);
    for &level_v in levels_v {
        segments.push(ramp(peak_v, level_v));
        segments.push(steps(vec![level_v], hold_s));
        peak_v = level_v;
    }
    segments.push(ramp(peak_v, 0.0));
    Stage {
        kind,
        segments,
        // Not faster than the ramps: an early end is as gentle as they are.
        slew_v_per_s: 1.05 * peak_v / ramp_s,
        peak_v,
        stop_current_a: (stop_at * bounds.rated_current_a)
            .min(CURRENT_SHARE * bounds.current_limit_a),
        // The shaft turns.
        stop_speed_rad_s: 0.03 * bounds.speed_limit_rad_s,
        winding_v: None,
        back_emf_v_s_per_rad: 0.0,
        reason,
    }
}

/// Slowly to one voltage and back, up to the current of its `kind`.
pub(super) fn look(bounds: &Bounds, kind: StageKind, peak_v: f64, reason: String) -> Stage {
    slowly(bounds, kind, &[peak_v], reason)
}

/// Half the rated current, then the whole.
pub(super) fn break_away(bounds: &Bounds, rest: &RestWinding, most: f64) -> Stage {
    let rated_v = bounds.rated_current_a * rest.resistance_ohm;
    let peak_v = (most * rated_v).min(bounds.voltage_limit_v);
    let reason =
        format!("{:.3} ohm at rest: {peak_v:.2} V drive the rated current", rest.resistance_ohm);
    let levels_v = [0.5 * peak_v, peak_v];
    slowly(bounds, StageKind::BreakAway, &levels_v, reason)
}

/// Forward, back to zero, backward, back to zero, each level held for so long.
pub(super) struct BothWays {
    pub(super) kind: StageKind,
    pub(super) peak_v: f64,
    pub(super) slew_v_per_s: f64,
    pub(super) hold_s: f64,
    /// What the guard allows across the winding, V.
    pub(super) winding_v: f64,
    pub(super) back_emf_v_s_per_rad: f64,
    pub(super) stop_current_a: f64,
    pub(super) reason: String,
}

impl BothWays {
    pub(super) fn stage(self, bounds: &Bounds) -> Stage {
        let peak_v = self.peak_v;
        Stage {
            kind: self.kind,
            segments: vec![standstill(bounds), steps(vec![peak_v, 0.0, -peak_v, 0.0], self.hold_s)],
            slew_v_per_s: self.slew_v_per_s,
            peak_v,
            stop_current_a: self.stop_current_a.min(0.9 * bounds.current_limit_a),
            stop_speed_rad_s: 0.7 * bounds.speed_limit_rad_s,
            winding_v: Some(self.winding_v),
            back_emf_v_s_per_rad: self.back_emf_v_s_per_rad,
            reason: self.reason,
        }
    }
}

/// How long a step is held: three mechanical time constants, as far as they are known.
pub(super) fn step_s(bounds: &Bounds, mechanical_s: Option<f64>) -> f64 {
    let held_s = mechanical_s.map_or(0.3, |s| (3.0 * s).clamp(0.3, 1.5));
    held_s.max(30.0 * bounds.period_s)
}

/// How long a level is held after the slope to it.
pub(super) fn settle_s(bounds: &Bounds, mechanical_s: f64) -> f64 {
    (2.0 * mechanical_s).clamp(0.1, 0.5).max(10.0 * bounds.period_s)
}
