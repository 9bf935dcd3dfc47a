//! The run that would tell what these runs cannot: which of two rivals it is, or what they did not excite.
//!
//! ```text
//! menu: recipes (ramp, dither, cycling, ...) --planned within the limits--> Planned: commands, sample times
//!                                                                              |  simulated with rival A
//! present data --J'J--> what rival B may still change   --------------------> separation D(A|B), and D(B|A)
//!                                                                              |
//!                            the best, refitted in full <--- the smaller of the two, over c-hat
//! ```
//!
//! DISCOVERY.md 2.11, after the T-optimal designs of Hunter and Reiner (1965) and Atkinson and Fedorov (1975): the best
//! run is the one in which the rival still differs when it has been fitted to the old data and the new.

mod equivalence;
mod limits;
mod menu;
mod planned;
mod recommend;
mod reveal;
mod rival;
mod separation;
mod words;

use std::path::Path;

use serde::Serialize;

pub use equivalence::equivalences;
pub use limits::ExperimentLimits;
pub use menu::Recipe;
pub use planned::Peaks;
pub use recommend::{menu_within, next_experiment, recommend};

/// Difference of the squared errors, in units of the noise, below which a run tells nothing apart: the block test of the
/// decision asks for three standard errors, and its standard error is that of about `4.4/sqrt(D)` (counted on emulated runs
/// with a difference spread over the run as excitations spread it; 2/sqrt(D) where every block has the same share).
pub const SEPARATED: f64 = 150.0;

/// What to run next, or that no run of this kind will do.
#[derive(Clone, Debug, Serialize)]
pub struct NextExperiment {
    /// For a person: what to run, why, and what it will show.
    pub sentence: String,
    /// A complete bench file; filled in where the bench is known, and none where no run will do.
    pub bench: Option<String>,
    /// The rivals; none where an effect is to be seen that the runs in hand did not excite.
    pub pair: Option<[&'static str; 2]>,
    /// Every pair that the recommended run was asked to tell apart.
    pub pairs: Vec<PairEntry>,
    /// The effects that become visible, where there is no pair.
    pub reveals: Vec<&'static str>,
    /// Expected difference of the squared errors of the wrong and the right one after both have been fitted again, in
    /// units of the noise variance and divided by c-hat, which is above one where the model does not explain the present
    /// data to the noise.
    pub expected_separation: f64,
    /// Every recipe that the limits allow with the same figure, from linear fits, best first.
    pub menu: Vec<MenuEntry>,
    /// What the recommended run reaches.
    pub peaks: Option<Peaks>,
    #[serde(skip)]
    pub recipe: Option<Recipe>,
}

impl NextExperiment {
    /// What to call after the run. Of rivals the run in hand says something too, so it is the hold-out; what it did not
    /// excite it cannot judge.
    pub fn diagnose_command(&self, in_hand: &Path) -> String {
        if self.pair.is_some() {
            format!(
                "drivebench diagnose NEW_RUN --holdout {}",
                in_hand.display()
            )
        } else {
            "drivebench diagnose NEW_RUN".to_owned()
        }
    }
}

/// One pair of rivals: what the recommended run tells of it, and the run that would tell most.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PairEntry {
    pub pair: [&'static str; 2],
    /// In the recommended run.
    pub expected_separation: f64,
    /// What a diagnosis of that run asks for: [`SEPARATED`], and a share of what the effect itself would explain there.
    pub needed: f64,
    /// Best run of the menu for this pair alone, with its separation from linear fits.
    pub best_program: &'static str,
    pub best_separation: f64,
    pub best_needed: f64,
}

impl PairEntry {
    /// Whether the recommended run tells the pair apart.
    pub fn is_told(&self) -> bool {
        self.expected_separation >= self.needed
    }
}

/// One run of the menu and what it would tell.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MenuEntry {
    pub program: &'static str,
    /// The smallest over the pairs; where there is no pair, the largest over what it would reveal. Of a run that tells no
    /// pair apart it is what it could be at most.
    pub expected_separation: f64,
    /// What a diagnosis of that run asks for, as in [`PairEntry::needed`].
    pub needed: f64,
}

impl MenuEntry {
    /// Whether the run tells every pair apart.
    pub fn is_told(&self) -> bool {
        self.expected_separation >= self.needed
    }
}

#[cfg(test)]
mod tests;
