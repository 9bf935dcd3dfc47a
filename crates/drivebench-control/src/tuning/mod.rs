//! Tuning of a PI regulator by rules: modulus optimum (Kessler 1955), symmetrical optimum (Kessler 1958), pole placement;
//! with robust margins over the uncertainty of the plant.
//!
//! ```text
//! LinearPlant + LoopTiming + Request --(rule)--> PiGains --> loops of the plant and of each draw: margins, predicted step
//!                                        ^                        |
//!                     slower, or a notch '--- where margins are missing; else refused, with the reachable bandwidth
//! ```
//!
//! A rule tunes on the rigid plant. Margins are those of the whole plant, at the worst of its draws.

mod loops;

use drivebench_model::tabulated;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use loops::Loops;

use super::response::{Response, response};
use super::{LinearPlant, LoopShape, LoopTiming, Margins, Notch, PiGains, StepPoint};
use drivebench_model::numerics::count;

/// Least phase margin, degrees, and gain margin of a loop.
const LEAST_MARGINS: (f64, f64) = (40.0, 1.8);

tabulated! {
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
    #[serde(rename_all = "kebab-case")]
    pub enum Rule {
        /// Betragsoptimum, Kessler 1955: the closed loop's gain stays one up to as high a frequency as possible.
        #[default]
        ModulusOptimum = ["modulus-optimum", "modulus optimum"],
        /// Symmetrisches Optimum, Kessler 1958: the largest phase margin for a plant that integrates.
        SymmetricalOptimum = ["symmetrical-optimum", "symmetrical optimum"],
        /// The two slow poles are placed by natural frequency and damping.
        PolePlacement = ["pole-placement", "pole placement"],
    }
    const fn row(self) -> [&'static str; 2];
}

impl Rule {
    pub const fn id(self) -> &'static str {
        self.row()[0]
    }

    pub const fn name(self) -> &'static str {
        self.row()[1]
    }
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Request {
    pub rule: Rule,
    /// Closed-loop bandwidth, rad/s; without it the rule's own.
    pub bandwidth_rad_s: Option<f64>,
    pub notch: NotchUse,
}

/// Whether a notch attenuates the frequency of a coupling.
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

/// The same gains over the uncertainty of the fitted parameters.
#[derive(Clone, Debug, Serialize)]
pub struct Draws {
    pub count: usize,
    /// The worst of each over the draws.
    pub worst: Margins,
    pub stable_share: f64,
    /// Those with the least margins.
    #[serde(skip)]
    pub hardest: Vec<LinearPlant>,
}

impl Tuning {
    /// Over the draws, or the plant's own without any.
    pub fn least_gain_margin(&self) -> f64 {
        let draws = self.draws.as_ref();
        draws.map_or(f64::INFINITY, |draws| draws.worst.gain_margin).min(self.margins.gain_margin)
    }

    /// Puts the 5 and 95 % quantiles of the draws about the predicted step.
    pub fn put_band(&mut self, draws: &[LinearPlant]) {
        if draws.is_empty() {
            return;
        }
        let end_s = self.step.last().map_or(0.0, |point| point.time_s);
        let one = |plant| LoopShape::new(plant, &self.timing, &self.gains).step_response(end_s);
        let drawn: Vec<Vec<StepPoint>> = draws.iter().map(one).collect();
        let skipped = count::whole(0.05 * drawn.len() as f64);
        for (n, point) in self.step.iter_mut().enumerate() {
            let mut speeds: Vec<f64> =
                drawn.iter().filter_map(|step| Some(step.get(n)?.speed)).collect();
            speeds.sort_by(f64::total_cmp);
            point.low = speeds.get(skipped).copied();
            point.high = speeds.iter().rev().nth(skipped).copied();
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
    #[error("bandwidth {requested:.4} rad/s ({:.3} Hz) is beyond what a loop of {period_ms:.3} ms with {cycles:.2} cycles of delay can carry (reachable: {reachable:.4} rad/s, {:.3} Hz)", requested / std::f64::consts::TAU, reachable / std::f64::consts::TAU)]
    Bandwidth { requested: f64, reachable: f64, period_ms: f64, cycles: f64 },
    #[error("bandwidth {0} rad/s is not a positive number")]
    NoBandwidth(f64),
    #[error(
        "{rule}: the loop would have {phase_margin_deg:.0} degrees of phase and a gain margin of {gain_margin:.2}{} (needed: {} degrees and {})", of_draws(*draws), LEAST_MARGINS.0, LEAST_MARGINS.1
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
    /// Bandwidth that the loop can carry instead of the requested one; 0 for another error.
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
                "lower the bandwidth, or make the link faster (higher rate, less delay)"
            }
            Self::NoBandwidth(_) => "leave it out for the rule's own",
            Self::Margins { draws: 0, .. } => {
                "use pole-placement with a lower bandwidth, or a faster link"
            }
            Self::Margins { .. } => {
                "identify the motor more precisely (`drivebench plan` shows from which run), or use pole-placement with a lower bandwidth"
            }
        }
    }
}

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

fn of_draws(draws: usize) -> String {
    match draws {
        0 => String::new(),
        _ => format!(" in the worst of {draws} draws of the parameters"),
    }
}

/// Gains by a rule, checked on the sampled loop with its delay. Refused: a plant or timing to which the rule does not apply, a bandwidth
/// that the loop cannot carry, too little margin.
pub fn tune(
    plant: &LinearPlant,
    timing: &LoopTiming,
    request: &Request,
) -> Result<Tuning, TuningError> {
    tune_over(plant, &[], timing, request)
}

/// The same, with the margins at the worst of `draws` too.
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
    let shape = loops.nominal(&found.gains);
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
    let length_s = 60.0 * found.small_time_s + 4.0 * found.gains.integral_time_s;
    let step = shape.step_response(length_s.max(20.0 * timing.period_s));
    let trace: Vec<(f64, f64)> = step.iter().map(|point| (point.time_s, point.speed)).collect();
    let mut reasons = found.reasons;
    if let Some(coupling) = plant.coupling().filter(|_| plant.uncoupled().is_some()) {
        reasons.push(format!(
            "within its backlash of {} rad the motor alone is stable too; a limit cycle of the backlash is not in the margins",
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
            Some(requested) => task.for_bandwidth(requested),
            None => task.with_margins(),
        };
        match request.notch {
            NotchUse::Off => by(self),
            NotchUse::Like(like) => {
                let notch = (self.notches().next())
                    .map(|notch| Notch { frequency_hz: notch.frequency_hz, ..like });
                by(&Self { notch, ..*self })
            }
            NotchUse::Auto => match by(self) {
                Ok(found) if found.is_the_rules_own && self.holds(&found) => {
                    Ok(self.without_notch(found))
                }
                Ok(found) if request.bandwidth_rad_s.is_some() && self.holds(&found) => Ok(found),
                without => self.quicker_with_a_notch(without, by),
            },
        }
    }

    fn notches(&self) -> impl Iterator<Item = Notch> {
        let frequency_hz = self.plant.coupling().map(|coupling| coupling.frequency_hz);
        let reached =
            frequency_hz.filter(|hertz| Notch::is_realisable(*hertz, self.timing.period_s));
        reached.into_iter().flat_map(|frequency_hz| {
            [0.1, 0.2, 0.35, 0.6, 1.0].into_iter().flat_map(move |damping_ratio| {
                [0.1, 0.3].map(|depth| Notch { frequency_hz, damping_ratio, depth })
            })
        })
    }

    fn without_notch(&self, mut found: Found) -> Found {
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
            self.loops.nominal(&found.gains).margins().bandwidth_rad_s / std::f64::consts::TAU
        };
        let Some(coupling) = self.plant.coupling() else { return without };
        let before_hz = without.as_ref().ok().filter(|found| self.holds(found)).map_or(0.0, hertz);
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
                // The error with the higher reachable bandwidth remains.
                Err(error) => {
                    if let Err(other) = &refused
                        && error.reachable() > other.reachable()
                    {
                        refused = Err(error);
                    }
                }
            }
        }
        // Less bandwidth than 5 % more is not worth a notch.
        match best {
            Some((reached_hz, notch, mut found)) if reached_hz > 1.05 * before_hz => {
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
                        format!(
                            "a notch there would give {reached_hz:.1} Hz, and below 5 % more it is not worth one"
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

    /// Dead time, filter and notch: the part of the small time constant that is not the motor's, s.
    fn lag_s(&self) -> f64 {
        self.timing.small_time_s() + self.notch.map_or(0.0, |notch| notch.lag_s())
    }

    fn holds(&self, found: &Found) -> bool {
        self.loops.hold(&found.gains)
    }

    /// The rule or, where its approximations leave too little margin, the rule slowed down.
    fn with_margins(&self) -> Result<Found, TuningError> {
        let mut slower = 1.0;
        loop {
            let mut found = self.by_rule(slower)?;
            if self.holds(&found) || slower > 30.0 {
                found.is_the_rules_own = slower <= 1.0;
                if slower > 1.0 {
                    let behind = self.plant.coupling().map_or_else(String::new, |coupling| {
                        format!(" behind the coupling at {:.1} Hz", coupling.frequency_hz)
                    });
                    found.reasons.push(format!(
                        "the rule alone left less than {} degrees or a gain margin below {}{behind}{}: its small time constant is taken {slower:.2} times as large",
                        LEAST_MARGINS.0,
                        LEAST_MARGINS.1,
                        of_draws(self.loops.draws.len())
                    ));
                }
                return Ok(found);
            }
            slower *= 1.1;
        }
    }

    /// The rule, slowed down to the requested bandwidth of the closed loop.
    fn for_bandwidth(&self, requested: f64) -> Result<Found, TuningError> {
        if !(requested.is_finite() && requested > 0.0) {
            return Err(TuningError::NoBandwidth(requested));
        }
        let bandwidth = |slower: f64| {
            Ok(self.loops.nominal(&self.by_rule(slower)?.gains).margins().bandwidth_rad_s)
        };
        let safe = |slower: f64| Ok(self.holds(&self.by_rule(slower)?));
        let faster = |slower: f64| bandwidth(slower).map(|reached| reached > requested);
        // The quickest that still has its margins.
        let (mut quick, mut slow) = (1.0, 1.0);
        while !safe(slow)? && slow < 1e6 {
            (quick, slow) = (slow, 2.0 * slow);
        }
        while safe(quick)? && quick > 1e-3 {
            (quick, slow) = (0.5 * quick, quick);
        }
        let slow = bisected(quick, slow, |slower| safe(slower).map(|safe| !safe))?.1;
        let reachable = bandwidth(slow)?;
        if requested > reachable {
            return Err(TuningError::Bandwidth {
                requested,
                reachable,
                period_ms: 1e3 * self.timing.period_s,
                cycles: self.timing.delay_cycles(),
            });
        }
        let (mut quick, mut slow) = (slow, 2.0 * slow);
        while faster(slow)? && slow < 1e9 {
            (quick, slow) = (slow, 2.0 * slow);
        }
        self.by_rule(bisected(quick, slow, faster)?.0)
    }

    /// Modulus optimum (Kessler 1955): the large time constant is cancelled, the gain set by the sum of the small ones.
    fn modulus_optimum(&self, slower: f64) -> Result<Found, TuningError> {
        let rule = "modulus optimum";
        let integrates = TuningError::Integrates { rule };
        let Some(dominant) = self.plant.dominant() else {
            return self.complex_poles(slower).ok_or(integrates);
        };
        let large_s = dominant.large_s.ok_or(integrates)?;
        let small_time_s = slower * (dominant.small_s + self.lag_s());
        let proportional = 1.0 / (2.0 * dominant.rate * small_time_s);
        let reason = format!(
            "{rule}: Tn = {large_s:.4} s cancels the large time constant, Kp = Tn / (2 K Ts) = {proportional:.4} with the small one Ts = {:.2} ms",
            1e3 * small_time_s
        );
        Ok(Found::new([proportional, large_s, 0.0], small_time_s, reason))
    }

    /// Complex poles, which no real zero cancels: the same condition, a gain of one up to the fourth power of the frequency,
    /// solved for the series of the whole plant with its dead time.
    fn complex_poles(&self, slower: f64) -> Option<Found> {
        let (sum, product) = self.plant.denominator()?;
        let gain = self.plant.gain()?;
        let late = self.lag_s();
        // (1 + sum s + product s^2) exp(late s) / gain = c0 + c1 s + c2 s^2 + c3 s^3 + ..
        let c0 = 1.0 / gain;
        let c1 = (sum + late) / gain;
        let c2 = (product + sum * late + late * late / 2.0) / gain;
        let c3 = (product * late + sum * late * late / 2.0 + late.powi(3) / 6.0) / gain;
        let integral = (c1 * c1 - c0 * c2) / (2.0 * (c1 * c2 / c0 - c3)) / slower;
        let best = integral * c1 / c0 - 0.5 * c0;
        // At least a Tn of half a dead time: the regulator keeps its form.
        let proportional = best.max(0.5 * integral * late);
        let integral_time_s = proportional / integral;
        let reason = format!(
            "modulus optimum for a motor with complex poles (TM below four times Ta): Kp = {proportional:.4}, Tn = {integral_time_s:.4} s from the series of the whole plant"
        );
        let small_time_s = slower * (late + product / sum);
        let gains = [proportional, integral_time_s, 0.0];
        (integral > 0.0).then(|| Found::new(gains, small_time_s, reason))
    }

    /// Pole placement: the two slow poles of the loop by natural frequency and damping; the reference's filter cancels the
    /// zero.
    fn pole_placement(&self, slower: f64) -> Found {
        // The slow part as one time constant (none: an integrator), the rest as the small one.
        let (rate, decay, small_s) = if let Some(dominant) = self.plant.dominant() {
            (dominant.rate, dominant.large_s.map_or(0.0, |large_s| 1.0 / large_s), dominant.small_s)
        } else {
            let (sum, product) = self.plant.denominator().unwrap_or((1.0, 1.0));
            (self.plant.gain().unwrap_or(1.0) / sum, 1.0 / sum, product / sum)
        };
        let small_time_s = slower * (small_s + self.lag_s());
        // At this frequency the neglected small time constant leaves that damping.
        let (damping, frequency_times_small) = (0.9, 0.35);
        let natural = frequency_times_small / small_time_s;
        if decay > damping * natural {
            // A quicker motor would need a negative gain: Tn cancels its pole, and one pole is placed.
            let (proportional, integral_time_s) = (natural / rate, 1.0 / decay);
            let reason = format!(
                "pole placement for a motor that is quicker than the loop: Tn = {integral_time_s:.4} s cancels its pole, Kp = {proportional:.4} places one at {natural:.3} rad/s ({frequency_times_small} over the small time constant of {:.2} ms)",
                1e3 * small_time_s
            );
            return Found::new([proportional, integral_time_s, 0.0], small_time_s, reason);
        }
        let integral = natural * natural / rate;
        let proportional = (2.0 * damping * natural - decay) / rate;
        let integral_time_s = proportional / integral;
        let reason = format!(
            "pole placement: natural frequency {natural:.3} rad/s ({frequency_times_small} over the small time constant of {:.2} ms), damping {damping}: Kp = {proportional:.4}, Tn = {integral_time_s:.4} s; the reference passes a filter of Tn",
            1e3 * small_time_s
        );
        Found::new([proportional, integral_time_s, integral_time_s], small_time_s, reason)
    }

    /// Symmetrical optimum (Kessler 1958): the phase margin is largest where the gain is one, for a plant that integrates.
    fn symmetrical_optimum(&self, slower: f64) -> Result<Found, TuningError> {
        // Square root of Tn over the small time constant. Kessler's 2 has a phase margin of 37 degrees on a pure integrator; the
        // reference's filter takes the overshoot that comes from the zero.
        let a = 2.4_f64;
        let integrating = self.plant.dominant().filter(|dominant| {
            let integral_time_s = a * a * (dominant.small_s + self.lag_s());
            dominant.large_s.is_none_or(|large_s| large_s > integral_time_s)
        });
        let Some(dominant) = integrating else {
            let mut found = self.modulus_optimum(slower)?;
            found.reasons.insert(
            0,
            "the motor is quicker than the Tn of the symmetrical optimum: it is no integrator to the loop, and the modulus optimum is used".to_owned(),
        );
            return Ok(found);
        };
        let small_time_s = slower * (dominant.small_s + self.lag_s());
        let proportional = 1.0 / (a * dominant.rate * small_time_s);
        let integral_time_s = a * a * small_time_s;
        let reason = format!(
            "symmetrical optimum with a = {a}: Kp = 1 / (a k Ts) = {proportional:.4}, Tn = a^2 Ts = {integral_time_s:.4} s with the small time constant Ts = {:.2} ms; the reference passes a filter of Tn",
            1e3 * small_time_s
        );
        Ok(Found::new([proportional, integral_time_s, integral_time_s], small_time_s, reason))
    }
}

/// Bisection of a factor on a logarithmic scale.
fn bisected(
    mut low: f64,
    mut high: f64,
    is_below: impl Fn(f64) -> Result<bool, TuningError>,
) -> Result<(f64, f64), TuningError> {
    for _ in 0..24 {
        let middle = (low * high).sqrt();
        if is_below(middle)? {
            low = middle;
        } else {
            high = middle;
        }
    }
    Ok((low, high))
}

fn is_safe(margins: &Margins) -> bool {
    margins.radius < 1.0
        && margins.phase_margin_deg >= LEAST_MARGINS.0
        && margins.gain_margin >= LEAST_MARGINS.1
}

#[cfg(test)]
mod tests;
