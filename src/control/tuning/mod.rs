//! From a plant and its delays to the gains of a PI regulator, with reasons.
//!
//! ```text
//! LinearPlant + LoopTiming + Request --(one file per rule)--> PiGains --> LoopShape: margins, predicted step
//!                                                               |
//!                                  refused, with what is reachable, where the margins do not hold
//! ```

mod modulus_optimum;
mod pole_placement;
mod symmetrical_optimum;
#[cfg(test)]
mod tests;

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::response::{Response, response};
use super::{LinearPlant, LoopShape, LoopTiming, Margins, PiGains, StepPoint};

/// Least phase and gain margin with which a loop is handed out.
const LEAST_PHASE_MARGIN_DEG: f64 = 40.0;
const LEAST_GAIN_MARGIN: f64 = 1.8;
/// Length of the predicted step response, in small time constants.
const PREDICTED_SMALL_TIMES: f64 = 60.0;
/// Share of the new speed within which a response has settled.
pub(crate) const SETTLED_SHARE: f64 = 0.05;
/// Steps in which a rule without enough margin is slowed down, and where that ends.
const SLOWER_BY: f64 = 1.1;
const SLOWEST: f64 = 30.0;
/// Bisection steps for the reachable bandwidth.
const HALVINGS: usize = 24;

/// How gains follow from a plant.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Rule {
    /// Betragsoptimum, Kessler 1955: the closed loop's gain stays one as far up as possible.
    #[default]
    ModulusOptimum,
    /// Symmetrisches Optimum, Kessler 1958: the most phase margin for a plant that integrates.
    SymmetricalOptimum,
    /// The two slow poles are placed by natural frequency and damping.
    PolePlacement,
}

impl Rule {
    pub const ALL: [Self; 3] = [
        Self::ModulusOptimum,
        Self::SymmetricalOptimum,
        Self::PolePlacement,
    ];

    pub const fn id(self) -> &'static str {
        match self {
            Self::ModulusOptimum => "modulus-optimum",
            Self::SymmetricalOptimum => "symmetrical-optimum",
            Self::PolePlacement => "pole-placement",
        }
    }

    pub const fn name(self) -> &'static str {
        match self {
            Self::ModulusOptimum => "modulus optimum",
            Self::SymmetricalOptimum => "symmetrical optimum",
            Self::PolePlacement => "pole placement",
        }
    }
}

/// What is asked of the tuning.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Request {
    pub rule: Rule,
    /// Closed-loop bandwidth, rad/s; without it the rule's own, which is what the small time constant carries.
    pub bandwidth_rad_s: Option<f64>,
}

/// Gains with their reasons.
#[derive(Clone, Debug, Serialize)]
pub struct Tuning {
    pub rule: Rule,
    pub gains: PiGains,
    /// The motor's small time constant, dead time and filters together, s.
    pub small_time_s: f64,
    pub timing: LoopTiming,
    pub margins: Margins,
    /// Of the linear loop to a unit step: no limit is met.
    pub response: Response,
    #[serde(skip)]
    pub step: Vec<StepPoint>,
    pub reasons: Vec<String>,
}

#[derive(Clone, Debug, Error, PartialEq)]
pub enum TuningError {
    #[error(
        "timing: period {period_s} s, delay {delay_s} s, filter {filter_s} s (allowed: a period above 0, the others not negative)"
    )]
    Timing {
        period_s: f64,
        delay_s: f64,
        filter_s: f64,
    },
    #[error("{rule} needs a plant that comes to rest at a speed, this one integrates without end")]
    Integrates { rule: &'static str },
    #[error("bandwidth {asked:.4} rad/s ({:.3} Hz) is beyond what a loop of {period_ms:.3} ms with {cycles:.2} cycles of delay can carry (reachable: {reachable:.4} rad/s, {:.3} Hz)", asked / std::f64::consts::TAU, reachable / std::f64::consts::TAU)]
    Bandwidth {
        asked: f64,
        reachable: f64,
        period_ms: f64,
        cycles: f64,
    },
    #[error("bandwidth {0} rad/s is not a positive number")]
    NoBandwidth(f64),
    #[error(
        "{rule}: the loop would have {phase_margin_deg:.0} degrees of phase and a gain margin of {gain_margin:.2} (needed: {LEAST_PHASE_MARGIN_DEG} degrees and {LEAST_GAIN_MARGIN})"
    )]
    Margins {
        rule: &'static str,
        phase_margin_deg: f64,
        gain_margin: f64,
    },
}

impl TuningError {
    pub const fn help(&self) -> &'static str {
        match self {
            Self::Timing { .. } => "give the measured timing of the link",
            Self::Integrates { .. } => "use symmetrical-optimum or pole-placement",
            Self::Bandwidth { .. } => {
                "ask for less, or make the link faster (higher rate, less delay)"
            }
            Self::NoBandwidth(_) => "leave it out for the rule's own",
            Self::Margins { .. } => "use pole-placement with a lower bandwidth, or a faster link",
        }
    }
}

/// What a rule has found.
struct Found {
    gains: PiGains,
    small_time_s: f64,
    reasons: Vec<String>,
}

/// Gains by a rule, checked on the sampled loop with its delay.
///
/// # Errors
/// A plant or timing for which the rule makes no sense, a bandwidth that the loop cannot carry, too little margin.
pub fn tune(
    plant: &LinearPlant,
    timing: &LoopTiming,
    request: &Request,
) -> Result<Tuning, TuningError> {
    if !timing.is_valid() {
        return Err(TuningError::Timing {
            period_s: timing.period_s,
            delay_s: timing.delay_s,
            filter_s: timing.filter_s,
        });
    }
    let found = match request.bandwidth_rad_s {
        Some(asked) => for_bandwidth(plant, timing, request.rule, asked)?,
        None => with_margins(plant, timing, request.rule)?,
    };
    let shape = LoopShape::new(plant, timing, &found.gains);
    let margins = shape.margins();
    if !is_safe(&margins) {
        return Err(TuningError::Margins {
            rule: request.rule.name(),
            phase_margin_deg: margins.phase_margin_deg,
            gain_margin: margins.gain_margin,
        });
    }
    let length_s = PREDICTED_SMALL_TIMES * found.small_time_s + 4.0 * found.gains.integral_time_s;
    let step = shape.step_response(length_s.max(20.0 * timing.period_s));
    let trace: Vec<(f64, f64)> = step
        .iter()
        .map(|point| (point.time_s, point.speed))
        .collect();
    let mut reasons = found.reasons;
    reasons.push(format!(
        "the link and the computation take {:.2} cycles of {:.3} ms; with the hold that is {:.2} ms of the small time constant of {:.2} ms",
        timing.delay_cycles(),
        1e3 * timing.period_s,
        1e3 * timing.dead_time_s(),
        1e3 * found.small_time_s
    ));
    Ok(Tuning {
        rule: request.rule,
        gains: found.gains,
        small_time_s: found.small_time_s,
        timing: *timing,
        margins,
        response: response(&trace, 0.0, 1.0),
        step,
        reasons,
    })
}

/// `slower` stretches the small time constant: the same rule for a loop of less bandwidth.
fn by_rule(
    plant: &LinearPlant,
    timing: &LoopTiming,
    rule: Rule,
    slower: f64,
) -> Result<Found, TuningError> {
    match rule {
        Rule::ModulusOptimum => modulus_optimum::gains(plant, timing, slower),
        Rule::SymmetricalOptimum => symmetrical_optimum::gains(plant, timing, slower),
        Rule::PolePlacement => Ok(pole_placement::gains(plant, timing, slower)),
    }
}

/// The rule as it is or, where its approximations leave too little margin, slowed down until there is enough.
fn with_margins(
    plant: &LinearPlant,
    timing: &LoopTiming,
    rule: Rule,
) -> Result<Found, TuningError> {
    let mut slower = 1.0;
    loop {
        let mut found = by_rule(plant, timing, rule, slower)?;
        if is_safe(&LoopShape::new(plant, timing, &found.gains).margins()) || slower > SLOWEST {
            if slower > 1.0 {
                found.reasons.push(format!(
                    "the rule alone left less than {LEAST_PHASE_MARGIN_DEG} degrees or a gain margin below {LEAST_GAIN_MARGIN}: its small time constant is taken {slower:.2} times as large"
                ));
            }
            return Ok(found);
        }
        slower *= SLOWER_BY;
    }
}

/// The rule, slowed down until the closed loop has the bandwidth that is asked.
fn for_bandwidth(
    plant: &LinearPlant,
    timing: &LoopTiming,
    rule: Rule,
    asked: f64,
) -> Result<Found, TuningError> {
    if !(asked.is_finite() && asked > 0.0) {
        return Err(TuningError::NoBandwidth(asked));
    }
    let margins = |slower: f64| -> Result<Margins, TuningError> {
        let found = by_rule(plant, timing, rule, slower)?;
        Ok(LoopShape::new(plant, timing, &found.gains).margins())
    };
    // The quickest that still has its margins.
    let (mut quick, mut slow) = (1.0, 1.0);
    while !is_safe(&margins(slow)?) && slow < 1e6 {
        (quick, slow) = (slow, 2.0 * slow);
    }
    while is_safe(&margins(quick)?) && quick > 1e-3 {
        (quick, slow) = (0.5 * quick, quick);
    }
    for _ in 0..HALVINGS {
        let middle = (quick * slow).sqrt();
        if is_safe(&margins(middle)?) {
            slow = middle;
        } else {
            quick = middle;
        }
    }
    let reachable = margins(slow)?.bandwidth_rad_s;
    if asked > reachable {
        return Err(TuningError::Bandwidth {
            asked,
            reachable,
            period_ms: 1e3 * timing.period_s,
            cycles: timing.delay_cycles(),
        });
    }
    let (mut quick, mut slow) = (slow, 2.0 * slow);
    while margins(slow)?.bandwidth_rad_s > asked && slow < 1e9 {
        (quick, slow) = (slow, 2.0 * slow);
    }
    for _ in 0..HALVINGS {
        let middle = (quick * slow).sqrt();
        if margins(middle)?.bandwidth_rad_s > asked {
            quick = middle;
        } else {
            slow = middle;
        }
    }
    by_rule(plant, timing, rule, quick)
}

fn is_safe(margins: &Margins) -> bool {
    margins.radius < 1.0
        && margins.phase_margin_deg >= LEAST_PHASE_MARGIN_DEG
        && margins.gain_margin >= LEAST_GAIN_MARGIN
}
