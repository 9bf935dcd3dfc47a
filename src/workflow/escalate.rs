//! The part of the loop that finds an unknown motor: which stage comes next, and what is handed on to the rest.
//!
//! ```text
//! stage out -> run in -> ... -> outcome -> comparison with the plate -> sequence scaled to the motor
//! ```

use serde::Serialize;

use super::commission::with_keys;
use crate::bench::{BenchFile, Nameplate, Refusal, Scaled, bounds, scale};
use crate::identification::escalation::{Ending, Escalation, Outcome, Stage, StageResult};
use crate::identification::nameplate::{self, Comparison};
use crate::plant::{ModelError, Motor, ScenarioError};
use crate::sample::{ParameterEstimate, Run};

/// One stage with the place of its record.
#[derive(Clone, Debug, Serialize)]
pub struct StageRecord {
    #[serde(flatten)]
    pub stage: StageResult,
    /// Why the stage was as large as it was.
    pub reason: String,
    pub folder: Option<String>,
}

/// The escalation as the driver runs it.
#[derive(Clone, Debug)]
pub struct Escalate {
    escalation: Escalation,
    plate: Motor,
    records: Vec<StageRecord>,
}

/// What it leaves behind.
#[derive(Clone, Debug, Default, Serialize)]
pub struct EscalationResult {
    /// `found`, or the name of what is in the way.
    pub outcome: &'static str,
    pub sentence: String,
    pub stages: Vec<StageRecord>,
    #[serde(serialize_with = "with_keys")]
    pub parameters: Vec<ParameterEstimate>,
    /// Found against the plate; none where the plate says nothing or nothing was found.
    pub nameplate: Option<Comparison>,
    /// Why no motor was found.
    pub ending: Option<Ending>,
    /// The sequence as it was fitted to the motor.
    pub scaled: Option<Scaled>,
    #[serde(skip)]
    pub motor: Option<Motor>,
}

impl Escalate {
    pub fn new(bench: &BenchFile) -> Self {
        Self {
            escalation: Escalation::new(bounds(bench)),
            plate: bench.motor.motor(),
            records: Vec::new(),
        }
    }

    /// What is to be run next; `None`: it is over.
    pub const fn stage(&self) -> Option<&Stage> {
        self.escalation.stage()
    }

    /// Takes the record of the stage and returns what came of it.
    pub fn ran(&mut self, run: &Run, folder: Option<String>) -> Result<StageRecord, ScenarioError> {
        let reason = self.stage().map(|stage| stage.reason.clone());
        self.escalation.learn(run)?;
        let stage = self.escalation.history().last().cloned();
        let record = StageRecord {
            stage: stage.unwrap_or_else(StageResult::nothing),
            reason: reason.unwrap_or_default(),
            folder,
        };
        self.records.push(record.clone());
        Ok(record)
    }

    /// The result so far, without the scaled sequence.
    pub fn result(&self) -> EscalationResult {
        let mut result = EscalationResult {
            outcome: "running",
            stages: self.records.clone(),
            ..EscalationResult::default()
        };
        match self.escalation.outcome() {
            None => {}
            Some(Outcome::Named(ending)) => {
                result.outcome = ending.name();
                result.sentence = ending.sentence();
                result.ending = Some(ending.clone());
            }
            Some(Outcome::Found(found)) => {
                result.outcome = "found";
                result.nameplate = compared(&self.plate, &found.parameters);
                let plate = match &result.nameplate {
                    None => "",
                    Some(comparison) if comparison.fits => ", its nameplate fits",
                    Some(_) => ", its nameplate does NOT fit",
                };
                let stages = self.records.len();
                result.sentence = format!("the motor was found in {stages} stages{plate}");
                result.parameters.clone_from(&found.parameters);
                result.motor = Some(found.motor.clone());
            }
        }
        result
    }
}

impl EscalationResult {
    /// The nameplate with which the rest of the loop is planned.
    pub fn found(&self, bench: &BenchFile) -> Option<Nameplate> {
        bench.motor.with_found(self.motor.as_ref()?)
    }

    /// Fits the bench's sequence to the motor that was found; the refusal where nothing fits.
    pub fn scale(
        &mut self,
        bench: &BenchFile,
        drive_current_limit_a: Option<f64>,
    ) -> Result<Option<Refusal>, ModelError> {
        let Some(found) = self.found(bench) else {
            return Ok(None);
        };
        Ok(match scale(bench, &found, drive_current_limit_a)? {
            Ok(scaled) => {
                self.scaled = Some(scaled);
                None
            }
            Err(refusal) => Some(refusal),
        })
    }

    /// For people: stages, motor, plate, sequence.
    pub fn text(&self) -> String {
        use std::fmt::Write as _;
        let mut text = format!("{}\n", self.sentence);
        for (index, StageRecord { stage, .. }) in self.stages.iter().enumerate() {
            let (number, kind) = (index + 1, stage.kind.name());
            let _ = writeln!(text, "  {number:>2}. {kind:<10} {}", stage.line);
        }
        if let Some(comparison) = &self.nameplate {
            text.push_str(&comparison.text());
        }
        let refused = |scaled: &&Scaled| scaled.refusal.is_some();
        if let Some(scaled) = self.scaled.as_ref().filter(refused) {
            let _ = writeln!(text, "{}", scaled_sentence(scaled));
        }
        text
    }
}

/// Why and how far the sequence was made smaller.
pub fn scaled_sentence(scaled: &Scaled) -> String {
    match &scaled.refusal {
        None => "the sequence fits the motor as it stands in the bench file".to_owned(),
        Some(refusal) => format!(
            "the sequence is run at {:.0} % of its voltages and {:.0} V/s: unchanged it would cross a limit ({refusal})",
            100.0 * scaled.factor,
            scaled.slew_v_per_s
        ),
    }
}

/// The comparison with the plate, where the plate says anything.
pub fn compared(plate: &Motor, found: &[ParameterEstimate]) -> Option<Comparison> {
    let comparison = nameplate::compare(plate, found);
    let mut rows = comparison.rows.iter();
    let says_anything = rows.any(|row| row.nameplate.is_some());
    says_anything.then_some(comparison)
}
