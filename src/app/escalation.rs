//! An unknown motor on a live drive: stage after stage, each into a run folder of its own.

use super::failure::{Failure, INTERNAL, INTERRUPTED, LINK, NOT_IDENTIFIABLE, USAGE};
use super::rig::Rig;
use super::strings::Strings;
use crate::identification::escalation::Ending;
use crate::workflow::{Escalate, EscalationResult, scaled_sentence};

/// Runs the stages until the motor is found or the reason why not is named. With a motor the rig goes on with its values
/// as nameplate. `tell` gets a line for each stage.
pub(crate) fn escalate(
    rig: &mut Rig,
    strings: &Strings,
    mut tell: impl FnMut(&str),
) -> Result<EscalationResult, Failure> {
    let mut workflow = Escalate::new(&rig.bench);
    let mut number = 0;
    while let Some(stage) = workflow.stage().cloned() {
        if strings.is_stopped() {
            return Err(Failure::new(
                INTERRUPTED,
                "interrupted; nothing is energised, what was recorded is kept",
            ));
        }
        number += 1;
        tell(&format!(
            "{} {number}: up to {:.3} V ({})",
            stage.kind.name(),
            stage.peak_v,
            stage.reason
        ));
        let name = format!("{}-escalation-{number:02}", rig.bench.name);
        let mut recorded = rig.record_stage(&name, &stage, number > 1, strings)?;
        if let Some(failure) = recorded.run_failure() {
            return Err(failure);
        }
        let folder = recorded.folder.path().display().to_string();
        let record = workflow.ran(&recorded.load()?.run, Some(folder))?;
        recorded.write_result(&record);
        tell(&record.stage.line);
    }
    let mut result = workflow.result();
    if let Some(found) = result.found(&rig.bench) {
        tell(&result.sentence);
        let claimed = !rig.bench.motor.is_unknown();
        if let Some(refusal) = result.scale(&rig.bench, rig.drive_current_limit_a())? {
            return Err(Failure::with_help(
                USAGE,
                format!("plan refused for the motor that was found: {refusal}"),
                refusal.help(),
            ));
        }
        let scaled = result
            .scaled
            .as_ref()
            .ok_or_else(|| Failure::new(INTERNAL, "a motor was found and nothing planned"))?;
        let fits = result
            .nameplate
            .as_ref()
            .is_none_or(|comparison| comparison.fits);
        if let Some(refusal) = scaled.refusal.as_ref().filter(|_| claimed && !fits) {
            // The plate is believed by whoever wrote the sequence: run as written it would be too much.
            if let Some(comparison) = &result.nameplate {
                comparison.text().lines().for_each(&mut tell);
            }
            return Err(Failure::with_help(
                USAGE,
                format!(
                    "the nameplate does not fit, and with the motor that was found the sequence is refused: {refusal}"
                ),
                "correct [motor], or set motor.unknown = true to have the sequence made smaller",
            ));
        }
        tell(&scaled_sentence(scaled));
        rig.bench = scaled.bench.clone();
        rig.bench.motor = (&found).into();
    }
    Ok(result)
}

/// The failure for what stands in the way of a motor: it is the device.
pub fn escalation_failure(result: &EscalationResult) -> Option<Failure> {
    let ending = result.ending.as_ref()?;
    let status = match ending {
        Ending::NotIdentified { .. } => NOT_IDENTIFIABLE,
        _ => LINK,
    };
    Some(Failure::with_help(status, ending.sentence(), ending.help()))
}
