//! The part of the loop that finds an unknown motor: which stage comes next, and what is handed on to the rest.
//!
//! ```text
//! stage out -> run in -> ... -> outcome -> comparison with the plate -> sequence scaled to the motor
//! ```

use serde::Serialize;

use super::named_estimate::NamedEstimate;
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
#[derive(Clone, Debug, Serialize)]
pub struct EscalationResult {
    /// `found`, or the name of what is in the way.
    pub outcome: &'static str,
    pub sentence: String,
    pub stages: Vec<StageRecord>,
    pub parameters: Vec<NamedEstimate>,
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
        let reason = self
            .stage()
            .map(|stage| stage.reason.clone())
            .unwrap_or_default();
        self.escalation.learn(run)?;
        let record = StageRecord {
            stage: self
                .escalation
                .history()
                .last()
                .cloned()
                .unwrap_or_else(StageResult::nothing),
            reason,
            folder,
        };
        self.records.push(record.clone());
        Ok(record)
    }

    /// The result so far, without the scaled sequence.
    pub fn result(&self) -> EscalationResult {
        let mut result = EscalationResult {
            outcome: "running",
            sentence: String::new(),
            stages: self.records.clone(),
            parameters: Vec::new(),
            nameplate: None,
            ending: None,
            scaled: None,
            motor: None,
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
                result.sentence = format!(
                    "the motor was found in {} stages{}",
                    self.records.len(),
                    match &result.nameplate {
                        None => String::new(),
                        Some(comparison) if comparison.fits => ", its nameplate fits".to_owned(),
                        Some(_) => ", its nameplate does NOT fit".to_owned(),
                    }
                );
                result.parameters = NamedEstimate::list(&found.parameters);
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
        for (index, record) in self.stages.iter().enumerate() {
            let _ = writeln!(
                text,
                "  {:>2}. {:<10} {}",
                index + 1,
                record.stage.kind.name(),
                record.stage.line
            );
        }
        if let Some(comparison) = &self.nameplate {
            text.push_str(&comparison.text());
        }
        if let Some(scaled) = self
            .scaled
            .as_ref()
            .filter(|scaled| scaled.refusal.is_some())
        {
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
    comparison
        .rows
        .iter()
        .any(|row| row.nameplate.is_some())
        .then_some(comparison)
}
