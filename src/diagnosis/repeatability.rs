//! What a machine does not repeat from one run of an excitation to the next: how much that is, and what it follows.

use super::evidence::{Evidence, not_repeated};
use super::explained::{Floor, in_noise};
use super::joint::Noise;
use super::joint::free_run::unseen_in;
use super::location::{FailureLocation, locate_difference};
use crate::identification::noise::FloorSource;
use crate::identification::output_error::FitError;
use crate::plant::Model;

/// Multiple of the sensors' noise by which two runs of the same excitation may differ and still repeat.
const REPEATS: f64 = 1.5;

/// Two runs of the same excitation, each with its own fit of one model.
#[derive(Clone, Debug, Default)]
pub(super) struct Repeatability {
    /// What differs between them, in units of the sensors' noise.
    pub(super) floor: Option<f64>,
    /// What the difference follows, where it is more than noise; the most first.
    pub(super) follows: Vec<FailureLocation>,
    /// Why nothing is known of it, where a run was repeated.
    pub(super) why_not: Option<String>,
}

impl Repeatability {
    /// Under `model`, with what is random in the runs beside it; empty without a repeated run, or where the sensors' noise is
    /// not known at rest. Where lost rows make much of what two runs differ by, they do whether the machine repeats or not.
    pub(super) fn of(model: &Model, evidence: &Evidence, noise: Noise) -> Self {
        let is_known = evidence.noise.source == FloorSource::Standstill;
        let Some(repeat) = evidence.repeat.as_ref().filter(|_| is_known) else {
            return Self::default();
        };
        let runs = [&evidence.training, repeat];
        let unseen = runs.map(|run| {
            let unseen = unseen_in(run, model, noise, is_known)?;
            in_noise(unseen.map(Some), &evidence.noise)
        });
        let [Some(first), Some(second)] = unseen else {
            return Self {
                why_not: Some(
                    "whether this machine repeats is not known: the model cannot be followed on both runs"
                        .to_owned(),
                ),
                ..Self::default()
            };
        };
        let floor = Floor::new(evidence, first.hypot(second) / f64::sqrt(2.0));
        if floor.highest() > REPEATS {
            return Self {
                why_not: Some(
                    "whether this machine repeats is not known: too many rows were lost".to_owned(),
                ),
                ..Self::default()
            };
        }
        let found = || -> Result<Self, FitError> {
            let floor = in_noise(not_repeated(model, runs, &evidence.noise)?, &evidence.noise);
            let follows = if floor.is_some_and(|floor| floor > REPEATS) {
                locate_difference(model, runs, &evidence.noise)?
            } else {
                Vec::new()
            };
            let why_not = None;
            Ok(Self {
                floor,
                follows,
                why_not,
            })
        };
        found().unwrap_or_else(|error| Self {
            why_not: Some(format!(
                "whether this machine repeats is not known: {error}"
            )),
            ..Self::default()
        })
    }

    /// Whether the difference is little more than the sensors' noise; none where it is not known.
    pub(super) fn repeats(&self) -> Option<bool> {
        self.floor.map(|floor| floor <= REPEATS)
    }

    /// A sensor may be a little noisier in motion than at rest, which a repeated run tells: by so much.
    pub(super) fn in_motion(&self) -> f64 {
        self.floor.map_or(1.0, |floor| floor.clamp(1.0, REPEATS))
    }
}
