//! From a plant and its delays to the gains of a PI regulator, with reasons.
//!
//! ```text
//! LinearPlant + LoopTiming + Request --(rule)--> PiGains --> loops of the plant and of each draw: margins, predicted step
//!                                        ^                        |
//!                     slower, or a notch '--- where they do not hold, and refused with what is reachable
//! ```
//!
//! A rule sees the rigid plant. Margins are those of the whole plant, at the worst of its draws.

mod loops;

use serde::{Deserialize, Serialize};
use thiserror::Error;

use loops::Loops;

use super::response::{Response, response};
use super::{LinearPlant, LoopShape, LoopTiming, Margins, Notch, PiGains, StepPoint};
use drivebench_model::numerics::count;

/// Least phase and gain margin with which a loop is handed out.
const LEAST_PHASE_MARGIN_DEG: f64 = 40.0;
const LEAST_GAIN_MARGIN: f64 = 1.8;
/// Length of the predicted step response, in small time constants.
const PREDICTED_SMALL_TIMES: f64 = 60.0;
/// Steps in which a rule without enough margin is slowed down, and where that ends.
const SLOWER_BY: f64 = 1.1;
const SLOWEST: f64 = 30.0;
/// Bisection steps for the reachable bandwidth.
const HALVINGS: usize = 24;
/// Notches that are tried: damping of their poles, and what they leave.
const NOTCH_DAMPINGS: [f64; 5] = [0.1, 0.2, 0.35, 0.6, 1.0];
const NOTCH_DEPTHS: [f64; 2] = [0.1, 0.3];
/// By how much quicker a loop has to be with a notch for it to be worth one.
const WORTH_A_NOTCH: f64 = 1.05;
/// Share of the draws on either side of the band of the predicted step.
const BAND: f64 = 0.05;

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
    pub const ALL: [Self; 3] =
        [Self::ModulusOptimum, Self::SymmetricalOptimum, Self::PolePlacement];

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
    pub notch: NotchUse,
}

/// Whether the frequency of a coupling is taken out of the loop.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum NotchUse {
    /// Where the loop is quicker with it.
    #[default]
    Auto,
    Off,
    /// As wide and deep as this one, at the plant's own frequency.
    Like(Notch),
}

impl NotchUse {
    pub const fn unless(off: bool) -> Self {
        if off { Self::Off } else { Self::Auto }
    }
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
    /// None where no parameter has a standard deviation.
    pub draws: Option<Draws>,
    /// Of the linear loop to a unit step: no limit is met.
    pub response: Response,
    #[serde(skip)]
    pub step: Vec<StepPoint>,
    pub reasons: Vec<String>,
}

/// The same gains on plants that the fit of the parameters leaves possible.
#[derive(Clone, Debug, Serialize)]
pub struct Draws {
    pub count: usize,
    /// The worst of each over the draws.
    pub worst: Margins,
    pub stable_share: f64,
    /// Those that leave the loop least.
    #[serde(skip)]
    pub hardest: Vec<LinearPlant>,
}

impl Tuning {
    /// Over the draws, or the plant's own without any.
    pub fn least_gain_margin(&self) -> f64 {
        let draws = self.draws.as_ref();
        let worst = draws.map_or(f64::INFINITY, |draws| draws.worst.gain_margin);
        worst.min(self.margins.gain_margin)
    }

    /// Puts the band of the draws about the predicted step.
    pub fn put_band(&mut self, draws: &[LinearPlant]) {
        let end_s = self.step.last().map_or(0.0, |point| point.time_s);
        let one = |plant| LoopShape::new(plant, &self.timing, &self.gains).step_response(end_s);
        let drawn: Vec<Vec<StepPoint>> = draws.iter().map(one).collect();
        if drawn.is_empty() {
            return;
        }
        let aside = count::whole(BAND * drawn.len() as f64);
        for (n, point) in self.step.iter_mut().enumerate() {
            let speeds = drawn.iter().filter_map(|step| Some(step.get(n)?.speed));
            let mut speeds: Vec<f64> = speeds.collect();
            speeds.sort_by(f64::total_cmp);
            point.low = speeds.get(aside).copied();
            point.high = speeds.iter().rev().nth(aside).copied();
        }
    }
}

#[derive(Clone, Debug, Error, PartialEq)]
pub enum TuningError {
    #[error(
        "timing: period {period_s} s, delay {delay_s} s, filter {filter_s} s (allowed: a period above 0, the others not negative, a delay of at most {} periods)",
        LoopTiming::MOST_CYCLES
    )]
    Timing { period_s: f64, delay_s: f64, filter_s: f64 },
    #[error("{rule} needs a plant that comes to rest at a speed, this one integrates without end")]
    Integrates { rule: &'static str },
    #[error("bandwidth {asked:.4} rad/s ({:.3} Hz) is beyond what a loop of {period_ms:.3} ms with {cycles:.2} cycles of delay can carry (reachable: {reachable:.4} rad/s, {:.3} Hz)", asked / std::f64::consts::TAU, reachable / std::f64::consts::TAU)]
    Bandwidth { asked: f64, reachable: f64, period_ms: f64, cycles: f64 },
    #[error("bandwidth {0} rad/s is not a positive number")]
    NoBandwidth(f64),
    #[error(
        "{rule}: the loop would have {phase_margin_deg:.0} degrees of phase and a gain margin of {gain_margin:.2}{} (needed: {LEAST_PHASE_MARGIN_DEG} degrees and {LEAST_GAIN_MARGIN})", of_draws(*draws)
    )]
    Margins {
        rule: &'static str,
        phase_margin_deg: f64,
        gain_margin: f64,
        /// Of which these are the worst; 0: the model's own.
        draws: usize,
    },
}

impl TuningError {
    /// Bandwidth that the loop can carry instead of the one that was asked; 0 where that is not the matter.
    const fn reachable(&self) -> f64 {
        match self {
            Self::Bandwidth { reachable, .. } => *reachable,
            _ => 0.0,
        }
    }

    pub const fn help(&self) -> &'static str {
        match self {
            Self::Timing { .. } => "give the measured timing of the link",
            Self::Integrates { .. } => "use symmetrical-optimum or pole-placement",
            Self::Bandwidth { .. } => {
                "ask for less, or make the link faster (higher rate, less delay)"
            }
            Self::NoBandwidth(_) => "leave it out for the rule's own",
            Self::Margins { draws: 0, .. } => {
                "use pole-placement with a lower bandwidth, or a faster link"
            }
            Self::Margins { .. } => {
                "identify the motor more narrowly (`drivebench plan` says from which run), or use pole-placement with a lower bandwidth"
            }
        }
    }
}

/// What a rule has found.
struct Found {
    /// Not slowed down.
    is_the_rules_own: bool,
    gains: PiGains,
    small_time_s: f64,
    reasons: Vec<String>,
}

impl Found {
    fn new(kp_tn_filter: [f64; 3], small_time_s: f64, reason: String) -> Self {
        let [proportional, integral_time_s, reference_filter_s] = kp_tn_filter;
        Self {
            is_the_rules_own: false,
            gains: PiGains { proportional, integral_time_s, reference_filter_s, notch: None },
            small_time_s,
            reasons: vec![reason],
        }
    }
}

/// Where margins are the worst of draws, says so.
fn of_draws(draws: usize) -> String {
    match draws {
        0 => String::new(),
        _ => format!(" in the worst of {draws} draws of the parameters"),
    }
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
    tune_over(plant, &[], timing, request)
}

/// The same, checked on `draws` of the plant too: the worst of them has to hold.
///
/// # Errors
/// As [`tune`].
pub fn tune_over(
    plant: &LinearPlant,
    draws: &[LinearPlant],
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
    let loops = Loops::new(plant, draws, timing);
    let task = Task { plant, loops: &loops, timing, rule: request.rule, notch: None };
    let found = task.found(request)?;
    let shape = loops.own(&found.gains);
    let margins = loops.margins(&found.gains);
    let drawn = loops.draws(&found.gains, draws);
    let worst = drawn.as_ref().map(|drawn| drawn.worst);
    for (margins, draws) in [(Some(margins), 0), (worst, draws.len())] {
        if let Some(margins) = margins.filter(|margins| !is_safe(margins)) {
            return Err(TuningError::Margins {
                rule: request.rule.name(),
                phase_margin_deg: margins.phase_margin_deg,
                gain_margin: margins.gain_margin,
                draws,
            });
        }
    }
    let length_s = PREDICTED_SMALL_TIMES * found.small_time_s + 4.0 * found.gains.integral_time_s;
    let step = shape.step_response(length_s.max(20.0 * timing.period_s));
    let trace: Vec<(f64, f64)> = step.iter().map(|point| (point.time_s, point.speed)).collect();
    let mut reasons = found.reasons;
    if let Some(coupling) = plant.coupling().filter(|_| plant.let_go().is_some()) {
        reasons.push(format!(
            "within its play of {} rad the motor alone is stable too; what the play itself does is not in the margins",
            coupling.gap_rad
        ));
    }
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
        draws: drawn,
        response: response(&trace, 0.0, 1.0),
        step,
        reasons,
    })
}

/// Least Tn of a motor that swings, in dead times.
const LEAST_PROPORTIONAL: f64 = 0.5;

const DAMPING: f64 = 0.9;

/// Natural frequency times small time constant: what the neglected small time constant leaves of the damping.
const FREQUENCY_TIMES_SMALL: f64 = 0.35;

/// Kessler's choice: Tn over the small time constant is its square; a phase margin of 37 degrees at `a` = 2 on a pure
/// integrator. The overshoot of the reference comes from the zero, and the filter takes it.
const A: f64 = 2.4;

/// Where a loop is to be closed, by which rule, and with which notch.
#[derive(Clone, Copy)]
struct Task<'a> {
    plant: &'a LinearPlant,
    loops: &'a Loops,
    timing: &'a LoopTiming,
    rule: Rule,
    notch: Option<Notch>,
}

impl Task<'_> {
    fn found(&self, request: &Request) -> Result<Found, TuningError> {
        let by = |task: &Self| match request.bandwidth_rad_s {
            Some(asked) => task.for_bandwidth(asked),
            None => task.with_margins(),
        };
        match request.notch {
            NotchUse::Off => by(self),
            NotchUse::Like(notch) => {
                let like = self.notches().next();
                let notch = like.map(|own| Notch { frequency_hz: own.frequency_hz, ..notch });
                by(&Self { notch, ..*self })
            }
            NotchUse::Auto => match by(self) {
                Ok(found) if found.is_the_rules_own && self.holds(&found) => Ok(self.plain(found)),
                Ok(found) if request.bandwidth_rad_s.is_some() && self.holds(&found) => Ok(found),
                without => self.quicker_with_a_notch(without, by),
            },
        }
    }

    /// Notches for the frequency of the coupling; none where there is none to take out.
    fn notches(&self) -> impl Iterator<Item = Notch> {
        let frequency_hz = self.plant.coupling().map(|coupling| coupling.frequency_hz);
        let reached = frequency_hz.filter(|hertz| Notch::reaches(*hertz, self.timing.period_s));
        reached.into_iter().flat_map(|frequency_hz| {
            NOTCH_DAMPINGS.into_iter().flat_map(move |damping_ratio| {
                NOTCH_DEPTHS.map(|depth| Notch { frequency_hz, damping_ratio, depth })
            })
        })
    }

    /// What holds its margins behind a coupling without a notch says so.
    fn plain(&self, mut found: Found) -> Found {
        if let Some(coupling) = self.plant.coupling() {
            found.reasons.push(format!(
                "the coupling at {:.1} Hz leaves the rule its margins: no notch is needed",
                coupling.frequency_hz
            ));
        }
        found
    }

    /// The quickest loop with a notch, where it is worth one; else what was found without.
    fn quicker_with_a_notch(
        &self,
        without: Result<Found, TuningError>,
        by: impl Fn(&Self) -> Result<Found, TuningError>,
    ) -> Result<Found, TuningError> {
        let hertz = |found: &Found| {
            let margins = self.loops.own(&found.gains).margins();
            margins.bandwidth_rad_s / std::f64::consts::TAU
        };
        let Some(coupling) = self.plant.coupling() else {
            return without;
        };
        let holding = without.as_ref().ok().filter(|found| self.holds(found));
        let before_hz = holding.map_or(0.0, hertz);
        let mut best: Option<(f64, Notch, Found)> = None;
        let mut refused = without;
        for notch in self.notches() {
            let with = Self { notch: Some(notch), ..*self };
            match by(&with) {
                Ok(found) if self.holds(&found) => {
                    let reached_hz = hertz(&found);
                    if best.as_ref().is_none_or(|(most_hz, ..)| reached_hz > *most_hz) {
                        best = Some((reached_hz, notch, found));
                    }
                }
                Ok(_) => {}
                // Of what cannot be reached either way the higher bandwidth is told.
                Err(error) => {
                    if let Err(other) = &refused
                        && error.reachable() > other.reachable()
                    {
                        refused = Err(error);
                    }
                }
            }
        }
        match best {
            Some((reached_hz, notch, mut found)) if reached_hz > WORTH_A_NOTCH * before_hz => {
                let without = if before_hz > 0.0 {
                    format!("without it {before_hz:.1} Hz")
                } else {
                    "without it the margins do not allow that".to_owned()
                };
                found.reasons.push(format!(
                    "the coupling: a notch at {:.1} Hz keeps {reached_hz:.1} Hz of bandwidth; {without} (damping of its poles {}, it leaves {:.0} %)",
                    notch.frequency_hz,
                    notch.damping_ratio,
                    100.0 * notch.depth
                ));
                Ok(found)
            }
            best => refused.map(|mut found| {
                let with = best.map_or_else(
                    || "no notch there helps".to_owned(),
                    |(reached_hz, ..)| {
                        let least = 100.0 * (WORTH_A_NOTCH - 1.0);
                        format!(
                            "a notch there would give {reached_hz:.1} Hz, and below {least:.0} % more it is not worth one"
                        )
                    },
                );
                found.reasons.push(format!(
                    "the coupling at {:.1} Hz: the lower bandwidth of {before_hz:.1} Hz is taken; {with}",
                    coupling.frequency_hz
                ));
                found
            }),
        }
    }

    /// `slower` stretches the small time constant: the same rule for a loop of less bandwidth.
    fn by_rule(&self, slower: f64) -> Result<Found, TuningError> {
        let mut found = match self.rule {
            Rule::ModulusOptimum => self.modulus_optimum(slower)?,
            Rule::SymmetricalOptimum => self.symmetrical_optimum(slower)?,
            Rule::PolePlacement => self.pole_placement(slower),
        };
        found.gains.notch = self.notch;
        Ok(found)
    }

    /// Dead time, filter and notch: the share of the small time constant that is not the motor's, s.
    fn late_s(&self) -> f64 {
        self.timing.small_time_s() + self.notch.map_or(0.0, |notch| notch.lag_s())
    }

    fn holds(&self, found: &Found) -> bool {
        self.loops.hold(&found.gains)
    }

    /// The rule as it is or, where its approximations leave too little margin, slowed down until there is enough.
    fn with_margins(&self) -> Result<Found, TuningError> {
        let mut slower = 1.0;
        loop {
            let mut found = self.by_rule(slower)?;
            if self.holds(&found) || slower > SLOWEST {
                found.is_the_rules_own = slower <= 1.0;
                if slower > 1.0 {
                    let behind = self.plant.coupling().map_or_else(String::new, |coupling| {
                        format!(" behind the coupling at {:.1} Hz", coupling.frequency_hz)
                    });
                    found.reasons.push(format!(
                        "the rule alone left less than {LEAST_PHASE_MARGIN_DEG} degrees or a gain margin below {LEAST_GAIN_MARGIN}{behind}{}: its small time constant is taken {slower:.2} times as large",
                        of_draws(self.loops.count())
                    ));
                }
                return Ok(found);
            }
            slower *= SLOWER_BY;
        }
    }

    /// The rule, slowed down until the closed loop has the bandwidth that is asked.
    fn for_bandwidth(&self, asked: f64) -> Result<Found, TuningError> {
        if !(asked.is_finite() && asked > 0.0) {
            return Err(TuningError::NoBandwidth(asked));
        }
        let bandwidth = |slower: f64| {
            let margins = self.loops.own(&self.by_rule(slower)?.gains).margins();
            Ok(margins.bandwidth_rad_s)
        };
        let safe = |slower: f64| Ok(self.holds(&self.by_rule(slower)?));
        let faster = |slower: f64| bandwidth(slower).map(|reached| reached > asked);
        // The quickest that still has its margins.
        let (mut quick, mut slow) = (1.0, 1.0);
        while !safe(slow)? && slow < 1e6 {
            (quick, slow) = (slow, 2.0 * slow);
        }
        while safe(quick)? && quick > 1e-3 {
            (quick, slow) = (0.5 * quick, quick);
        }
        let slow = narrowed(quick, slow, |slower| safe(slower).map(|safe| !safe))?.1;
        let reachable = bandwidth(slow)?;
        if asked > reachable {
            return Err(TuningError::Bandwidth {
                asked,
                reachable,
                period_ms: 1e3 * self.timing.period_s,
                cycles: self.timing.delay_cycles(),
            });
        }
        let (mut quick, mut slow) = (slow, 2.0 * slow);
        while faster(slow)? && slow < 1e9 {
            (quick, slow) = (slow, 2.0 * slow);
        }
        self.by_rule(narrowed(quick, slow, faster)?.0)
    }

    /// Modulus optimum (Kessler 1955): the large time constant is cancelled, the gain set by the sum of the small ones.
    fn modulus_optimum(&self, slower: f64) -> Result<Found, TuningError> {
        let rule = "modulus optimum";
        let integrates = TuningError::Integrates { rule };
        let Some(dominant) = self.plant.dominant() else {
            return self.swinging(slower).ok_or(integrates);
        };
        let large_s = dominant.large_s.ok_or(integrates)?;
        let small_time_s = slower * (dominant.small_s + self.late_s());
        let proportional = 1.0 / (2.0 * dominant.rate * small_time_s);
        let reason = format!(
            "{rule}: Tn = {large_s:.4} s cancels the large time constant, Kp = Tn / (2 K Ts) = {proportional:.4} with the small one Ts = {:.2} ms",
            1e3 * small_time_s
        );
        Ok(Found::new([proportional, large_s, 0.0], small_time_s, reason))
    }

    /// The plant's own poles swing: nothing can be cancelled by a real zero. The same condition, gain one up to the fourth
    /// power of the frequency, solved for the series of the whole plant with its dead time.
    fn swinging(&self, slower: f64) -> Option<Found> {
        let (sum, product) = self.plant.denominator()?;
        let gain = self.plant.gain()?;
        let late = self.late_s();
        // (1 + sum s + product s^2) exp(late s) / gain = c0 + c1 s + c2 s^2 + c3 s^3 + ..
        let c0 = 1.0 / gain;
        let c1 = (sum + late) / gain;
        let c2 = (product + sum * late + late * late / 2.0) / gain;
        let c3 = (product * late + sum * late * late / 2.0 + late.powi(3) / 6.0) / gain;
        let integral = (c1 * c1 - c0 * c2) / (2.0 * (c1 * c2 / c0 - c3)) / slower;
        let best = integral * c1 / c0 - 0.5 * c0;
        // A plant that swings hard wants an integrator alone; a little proportional part keeps the form of the regulator.
        let proportional = best.max(LEAST_PROPORTIONAL * integral * late);
        let integral_time_s = proportional / integral;
        let reason = format!(
            "modulus optimum for a motor that swings by itself (TM below four times Ta): Kp = {proportional:.4}, Tn = {integral_time_s:.4} s from the series of the whole plant"
        );
        let small_time_s = slower * (late + product / sum);
        let gains = [proportional, integral_time_s, 0.0];
        (integral > 0.0).then(|| Found::new(gains, small_time_s, reason))
    }

    /// Pole placement: the two slow poles of the loop by natural frequency and damping; the reference's filter takes the zero.
    fn pole_placement(&self, slower: f64) -> Found {
        // The slow part as one time constant (none: an integrator), whatever is quicker as the small one.
        let (rate, decay, small_s) = if let Some(dominant) = self.plant.dominant() {
            (dominant.rate, dominant.large_s.map_or(0.0, |large_s| 1.0 / large_s), dominant.small_s)
        } else {
            let (sum, product) = self.plant.denominator().unwrap_or((1.0, 1.0));
            (self.plant.gain().unwrap_or(1.0) / sum, 1.0 / sum, product / sum)
        };
        let small_time_s = slower * (small_s + self.late_s());
        let natural = FREQUENCY_TIMES_SMALL / small_time_s;
        if decay > DAMPING * natural {
            return quick_motor(rate, decay, natural, small_time_s);
        }
        let integral = natural * natural / rate;
        let proportional = (2.0 * DAMPING * natural - decay) / rate;
        let integral_time_s = proportional / integral;
        let reason = format!(
            "pole placement: natural frequency {natural:.3} rad/s ({FREQUENCY_TIMES_SMALL} over the small time constant of {:.2} ms), damping {DAMPING}: Kp = {proportional:.4}, Tn = {integral_time_s:.4} s; the reference passes a filter of Tn",
            1e3 * small_time_s
        );
        let gains = [proportional, integral_time_s, integral_time_s];
        Found::new(gains, small_time_s, reason)
    }

    /// Symmetrical optimum (Kessler 1958): the phase margin is largest where the gain is one, for a plant that integrates.
    fn symmetrical_optimum(&self, slower: f64) -> Result<Found, TuningError> {
        let integrating = self.plant.dominant().filter(|dominant| {
            let integral_time_s = A * A * (dominant.small_s + self.late_s());
            dominant.large_s.is_none_or(|large_s| large_s > integral_time_s)
        });
        let Some(dominant) = integrating else {
            let mut found = self.modulus_optimum(slower)?;
            found.reasons.insert(
            0,
            "the motor is quicker than the Tn of the symmetrical optimum: to the loop it is no integrator, and the modulus optimum serves".to_owned(),
        );
            return Ok(found);
        };
        let small_time_s = slower * (dominant.small_s + self.late_s());
        let proportional = 1.0 / (A * dominant.rate * small_time_s);
        let integral_time_s = A * A * small_time_s;
        let reason = format!(
            "symmetrical optimum with a = {A}: Kp = 1 / (a k Ts) = {proportional:.4}, Tn = a^2 Ts = {integral_time_s:.4} s with the small time constant Ts = {:.2} ms; the reference passes a filter of Tn",
            1e3 * small_time_s
        );
        let gains = [proportional, integral_time_s, integral_time_s];
        Ok(Found::new(gains, small_time_s, reason))
    }
}

/// A motor that is quicker than the loop would have to be slowed down by a negative gain: its own pole is left to it, and
/// one pole is placed.
fn quick_motor(rate: f64, decay: f64, natural: f64, small_time_s: f64) -> Found {
    let (proportional, integral_time_s) = (natural / rate, 1.0 / decay);
    let reason = format!(
        "pole placement for a motor that is quicker than the loop: Tn = {integral_time_s:.4} s leaves it its own pole, Kp = {proportional:.4} places one at {natural:.3} rad/s ({FREQUENCY_TIMES_SMALL} over the small time constant of {:.2} ms)",
        1e3 * small_time_s
    );
    Found::new([proportional, integral_time_s, 0.0], small_time_s, reason)
}

/// Nearer limits of a slowing: `low` as long as it is still below, by halves of the ratio.
fn narrowed(
    mut low: f64,
    mut high: f64,
    is_below: impl Fn(f64) -> Result<bool, TuningError>,
) -> Result<(f64, f64), TuningError> {
    for _ in 0..HALVINGS {
        let middle = (low * high).sqrt();
        if is_below(middle)? {
            low = middle;
        } else {
            high = middle;
        }
    }
    Ok((low, high))
}

/// Whether a loop has the margins with which it is handed out.
fn is_safe(margins: &Margins) -> bool {
    margins.radius < 1.0
        && margins.phase_margin_deg >= LEAST_PHASE_MARGIN_DEG
        && margins.gain_margin >= LEAST_GAIN_MARGIN
}

#[cfg(test)]
mod tests;
