//! The most informative next run: it distinguishes two rivals, or excites what the runs in hand did not.
//!
//! ```text
//! menu: recipes (ramp, dither, cycling, ...) --planned within the limits--> Planned: commands, sample times
//!                                                                              |  simulated with rival A
//! present data --J'J--> what rival B may still change   --------------------> separation D(A|B), and D(B|A)
//!                                                                              |
//!                            the best, refitted in full <--- the smaller of the two, over c-hat
//! ```
//!
//! Where no pair is ambiguous, a run is recommended for effects that the runs in hand would not have shown: each recipe is
//! simulated with the estimated model, appended to the runs in hand, and evaluated by the linear problem of the diagnosis
//! (`joint/expected_information`). An effect is expected to show at twice the precision of detection: no repetition
//! of a run in hand doubles the information, so that no run is recommended twice.
//!
//! After the T-optimal designs of Hunter and Reiner (1965) and Atkinson and Fedorov (1975): the best
//! run is the one in which the rival still differs when it has been fitted to the old data and the new.

mod plan;
mod recommend;
mod reveal;
mod separation;

use serde::Serialize;

use super::evidence::{Evidence, HoldoutFrom};
use drivebench_model::findings;
use drivebench_model::numerics::statistics::{largest, median_step};
use drivebench_model::plant::Scenario;

pub use plan::{Peaks, Recipe};
pub use recommend::{menu_within, next_experiment, recommend};

/// Difference of the squared errors, in units of the noise, below which a run distinguishes no rivals: the block test of the
/// decision asks for three standard errors, and its standard error is that of about `4.4/sqrt(D)` (counted on emulated runs
/// with a difference spread over the run as excitations spread it; 2/sqrt(D) where every block has the same share).
pub const SEPARATED: f64 = 150.0;

/// An effect that the recommended run does not show, and the excitation that would.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Hidden {
    pub effect: &'static str,
    #[serde(rename = "code")]
    pub reason: HiddenReason,
}

findings! {
    /// Excitation that would show an effect that the recommended run does not.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub enum HiddenReason {
        AnotherRun = "another_run_shows_it",
        /// A faster change of the voltage than these limits allow.
        Slew { v_per_s: f64 } = "needs_faster_voltage",
        Travel { rad: f64 } = "needs_more_travel",
        Limits { voltage_v: f64, current_a: f64, speed_rad_s: f64, duration_s: f64 } = "needs_wider_limits",
        /// An excitation that no run of the menu has, as the effect's card names it.
        Excitation = "needs_other_excitation",
    }
}

findings! {
    /// What is recommended.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub enum Recommendation {
        /// A run that distinguishes a pair of rivals.
        Distinguishes = "tells_rivals_apart",
        /// No run within the limits does; one with a faster change of the voltage may.
        CannotDistinguish { faster: Option<FasterRun> } = "no_run_tells_rivals_apart",
        /// A run that shows effects which no run in hand would have shown.
        Shows = "shows_more_effects",
        ShowsNothingMore = "no_run_shows_more",
    }
}

/// A run that distinguishes rivals where the voltage may change faster.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FasterRun {
    pub slew_v_per_s: f64,
    pub program: &'static str,
    pub separation: f64,
}

/// The recommended next run, or that no run of the menu is sufficient.
#[derive(Clone, Debug, Serialize)]
pub struct NextExperiment {
    #[serde(rename = "code")]
    pub finding: Recommendation,
    /// A complete bench file; filled in where the bench is known, and none where no run is sufficient.
    pub bench: Option<String>,
    /// The rivals; none where an effect is to be shown that the runs in hand did not excite.
    pub pair: Option<[&'static str; 2]>,
    /// Every pair that the recommended run was to distinguish.
    pub pairs: Vec<PairEntry>,
    /// The effects that become detectable, where there is no pair.
    pub reveals: Vec<&'static str>,
    /// The effects that stay undetectable after it.
    pub hidden: Vec<Hidden>,
    /// Of a pair: expected difference of the squared errors of the wrong and the right one after both have been fitted again, in
    /// units of the noise variance and divided by c-hat, which is above one where the model does not explain the present
    /// data to the noise. Where there is no pair: the precision with which the weakest of what the run reveals would be
    /// known, the squared size of its slab in standard deviations of its size (see [`MenuEntry::needed`]); where no run is
    /// recommended the largest of any.
    pub expected_separation: f64,
    /// Every recipe that the limits allow with the same figure, from linear fits, best first.
    pub menu: Vec<MenuEntry>,
    /// What the recommended run reaches.
    pub peaks: Option<Peaks>,
    #[serde(skip)]
    pub recipe: Option<Recipe>,
}

/// One pair of rivals: its separation by the recommended run, and by its own best run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PairEntry {
    pub pair: [&'static str; 2],
    /// In the recommended run.
    pub expected_separation: f64,
    /// Separation that a diagnosis of that run needs: [`SEPARATED`], and a share of what the effect itself would explain there.
    pub needed: f64,
    /// Best run of the menu for this pair alone, with its separation from linear fits.
    pub best_program: &'static str,
    pub best_separation: f64,
    pub best_needed: f64,
}

impl PairEntry {
    /// Whether the recommended run distinguishes the pair.
    pub fn is_separated(&self) -> bool {
        self.expected_separation >= self.needed
    }
}

/// One run of the menu and its expected separation.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MenuEntry {
    pub program: &'static str,
    /// The smallest over the pairs; where there is no pair, the largest over what it would reveal. Of a run that distinguishes no
    /// pair an upper bound.
    pub expected_separation: f64,
    /// Value that a diagnosis of that run needs: of a pair as in [`PairEntry::needed`], a squared distance; where there is no
    /// pair the precision from which on an effect is expected to show, in the unit of [`NextExperiment::expected_separation`].
    /// The two have different scales.
    pub needed: f64,
}

impl MenuEntry {
    /// Whether the run distinguishes every pair.
    pub fn is_separated(&self) -> bool {
        self.expected_separation >= self.needed
    }
}

/// Largest magnitudes of a planned run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExperimentLimits {
    pub voltage_v: f64,
    pub current_a: f64,
    pub speed_rad_s: f64,
    /// Root mean square of the current over the run: the heat in the winding. Without a limit of
    /// this or of the current no run is planned.
    pub rms_current_a: f64,
    /// Distance from the angle at the start; none: the shaft turns freely.
    pub travel_rad: Option<f64>,
    pub duration_s: f64,
    /// Largest change of the voltage; infinite: as fast as the current allows.
    pub slew_v_per_s: f64,
    /// Time between two commands.
    pub period_s: f64,
}

/// Longest run where nothing else limits it, s.
const LONGEST_RUN_S: f64 = 60.0;

impl ExperimentLimits {
    /// Nothing beyond what one of the runs in hand has reached.
    pub fn seen_in(evidence: &Evidence) -> Self {
        let mut limits = Self {
            voltage_v: 0.0,
            current_a: 0.0,
            speed_rad_s: 0.0,
            rms_current_a: 0.0,
            travel_rad: None,
            duration_s: LONGEST_RUN_S,
            slew_v_per_s: 0.0,
            period_s: period_s(&evidence.training),
        };
        let mut runs = vec![&evidence.training];
        // A split hold-out is the same run.
        if evidence.holdout_from == HoldoutFrom::Run {
            runs.push(&evidence.holdout);
        } else {
            runs[0] = &evidence.holdout;
        }
        runs.extend(&evidence.confirm);
        for run in runs {
            let voltages = run.events.iter().map(|event| event.1);
            limits.voltage_v = limits.voltage_v.max(largest(voltages));
            limits.slew_v_per_s = limits.slew_v_per_s.max(slew_v_per_s(run));
            limits.current_a = limits.current_a.max(largest(run.current_a.iter().copied()));
            limits.speed_rad_s = limits.speed_rad_s.max(largest(run.speed_rad_s.iter().copied()));
            limits.rms_current_a = limits.rms_current_a.max(mean_square(&run.current_a).sqrt());
        }
        // A signal that was not recorded limits nothing that can be checked.
        for limit in [
            &mut limits.current_a,
            &mut limits.speed_rad_s,
            &mut limits.rms_current_a,
            &mut limits.slew_v_per_s,
        ] {
            if *limit <= 0.0 {
                *limit = f64::INFINITY;
            }
        }
        limits
    }
}

/// Time between two samples, s.
fn period_s(run: &Scenario) -> f64 {
    // Time stamps are rounded; microseconds are enough.
    (median_step(&run.sample_time_s) * 1e6).round() * 1e-6
}

/// Largest change of the voltage from one event to the next, which is made within a sample.
fn slew_v_per_s(run: &Scenario) -> f64 {
    let changes = run.events.windows(2).map(|pair| pair[1].1 - pair[0].1);
    largest(changes) / period_s(run).max(f64::MIN_POSITIVE)
}

fn mean_square(values: &[f64]) -> f64 {
    let present: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
    present.iter().map(|v| v * v).sum::<f64>() / present.len().max(1) as f64
}

#[cfg(test)]
mod tests;
