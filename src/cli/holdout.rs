//! Whether another run can be judged by: of the same motor, moving, long enough, and not the data that are fitted.

use std::cell::OnceCell;
use std::path::Path;

use super::output;
use super::sanity_report::Judging;
use crate::diagnosis::{Fingerprint, Kinship, fingerprint, matches, shared_samples};
use crate::identification::lost_rows;
use crate::identification::sanity::{self, Kind};
use crate::plant::{Model, Scenario};
use crate::recording::LoadedRun;
use crate::sample::{Channel, Run};

/// Shortest hold-out, s: twenty blocks that hold some transients of the current each.
const SHORTEST_S: f64 = 1.0;
/// Share of a hold-out's samples that may be those of the fitted run.
const MOST_SHARED: f64 = 0.5;

/// The run that is fitted, for comparing others with it.
pub(super) struct Beside<'a> {
    pub(super) model: &'a Model,
    pub(super) fitted: &'a Scenario,
    pub(super) judging: Judging,
    pub(super) fingerprint: OnceCell<Option<Fingerprint>>,
}

/// What became of a run to judge by.
#[derive(Default)]
pub(super) struct Judged {
    /// None where it was set aside.
    pub(super) used: Option<Scenario>,
    /// Whether something speaks against it.
    pub(super) objected: bool,
}

impl Beside<'_> {
    /// `other` where it can serve as what `role` says. Where it cannot, the reason goes to stderr and to `notes`, and a
    /// command that fits goes on without it; one that compares a model as given compares all the same.
    pub(super) fn judge(
        &mut self,
        role: &str,
        other: (LoadedRun, Scenario),
        instead: &str,
        notes: &mut Vec<String>,
    ) -> Judged {
        let (loaded, scenario) = other;
        let Some((reason, forbids)) = self.objection(&loaded.run, &scenario) else {
            return Judged {
                used: Some(scenario),
                objected: false,
            };
        };
        let sets_aside = forbids && self.judging != Judging::AsGiven;
        let sentence = if sets_aside {
            format!("{role}: {reason}; it is not used, {instead}")
        } else {
            format!("{role}: {reason}")
        };
        output::warn(std::slice::from_ref(&sentence));
        notes.push(sentence);
        Judged {
            used: (!sets_aside).then_some(scenario),
            objected: true,
        }
    }

    /// What speaks against it, and whether nothing can be judged by it.
    fn objection(&mut self, run: &Run, scenario: &Scenario) -> Option<(String, bool)> {
        if shared_samples(self.fitted, scenario) > MOST_SHARED {
            let same = "its samples are those of the run that is fitted, so that it tests nothing";
            return Some((same.to_owned(), true));
        }
        let times = &scenario.sample_time_s;
        let length_s = times[times.len() - 1] - times[0];
        if length_s < SHORTEST_S {
            let short = format!("it lasts {length_s:.3} s, and at least {SHORTEST_S} s are needed");
            return Some((short, true));
        }
        let findings = sanity::examine(run, scenario, self.model);
        if let Some(finding) = findings.iter().find(|finding| finding.refuses) {
            let help = match finding.kind {
                Kind::Unit | Kind::Swapped | Kind::Reversed => {
                    finding.help.replace("--map ", "--map-holdout ")
                }
                _ => String::new(),
            };
            let separator = if help.is_empty() { "" } else { "; " };
            return Some((format!("{}{separator}{help}", finding.sentence), true));
        }
        let (model, fitted) = (self.model, self.fitted);
        let here = *self.fingerprint.get_or_init(|| fingerprint(model, fitted));
        let found = matches(here?, fingerprint(model, scenario)?);
        (found.kinship != Kinship::Same).then(|| (found.sentence, found.kinship == Kinship::Other))
    }
}

/// Says that a model is judged by what it was fitted on, as far as its file tells: `holdout`, or the last part of `run`.
pub(super) fn was_fitted_on(
    fitted_on: &[String],
    run: &Path,
    holdout: Option<&Path>,
) -> Option<String> {
    let judge = holdout.unwrap_or(run);
    let name = fitted_on
        .iter()
        .find(|name| is_same(Path::new(name), judge))?;
    Some(if holdout.is_some() {
        format!(
            "hold-out: the model was fitted on it (its file names {name}), so that its held-out figures are those of a fit and \
             test nothing"
        )
    } else {
        format!(
            "the model was fitted on this run (its file names {name}): what is held out, its last 40 %, may have been fitted \
             too; give another run with --holdout"
        )
    })
}

/// Whether two paths are of one run; a folder that is no longer there is known by its name.
fn is_same(recorded: &Path, path: &Path) -> bool {
    let folder = |path: &Path| {
        let is_samples = path.file_name().is_some_and(|name| name == "samples.csv");
        let parent = path.parent().filter(|_| is_samples);
        parent.unwrap_or(path).to_owned()
    };
    match (recorded.canonicalize(), path.canonicalize()) {
        (Ok(recorded), Ok(path)) => folder(&recorded) == folder(&path),
        _ => folder(recorded).file_name() == folder(path).file_name(),
    }
}

/// Whether a confirming run is another than the hold-out, which selected; else the reason goes to stderr and to `notes`.
pub(super) fn had_no_part(
    confirm: &Scenario,
    holdout: Option<&Scenario>,
    notes: &mut Vec<String>,
) -> bool {
    let shared = holdout.map_or(0.0, |holdout| shared_samples(holdout, confirm));
    if shared <= MOST_SHARED {
        return true;
    }
    let sentence = "confirming run: its samples are those of the hold-out, which selected; it is not used, nothing is confirmed"
        .to_owned();
    output::warn(std::slice::from_ref(&sentence));
    notes.push(sentence);
    false
}

/// What a run does not say by itself: rows without a voltage, signals without values, times without rows.
pub(super) fn cautions(run: &Run, scenario: &Scenario) -> Vec<String> {
    let mut cautions = Vec::new();
    let channel = scenario.input_channel;
    cautions.extend(lost_rows::sentence(run, scenario));
    let whole = scenario.unknown_input.is_empty();
    if let (true, Channel::Voltage, Some(cells)) = (whole, channel, run.column(channel)) {
        let begin_s = scenario.begin_s();
        let rows = run.time_s().iter().filter(|time_s| **time_s >= begin_s);
        let missing = run
            .time_s()
            .iter()
            .zip(cells)
            .filter(|(time_s, cell)| **time_s >= begin_s && !cell.is_finite())
            .count();
        if missing > 0 {
            cautions.push(format!(
                "{}: {} is empty in {missing} of {} rows: the value before is taken as held there",
                run.name,
                channel.key(),
                rows.count()
            ));
        }
    }
    for (channel, cells) in [
        (Channel::Current, &scenario.current_a),
        (Channel::Speed, &scenario.speed_rad_s),
    ] {
        let missing = cells.iter().filter(|cell| !cell.is_finite()).count();
        if run.column(channel).is_none() || missing * MANY_MISSING < cells.len() {
            continue;
        }
        let (name, key, samples) = (&run.name, channel.key(), cells.len());
        cautions.push(if missing == samples {
            format!("{name}: {key} has no value in any sample: it counts as not measured")
        } else {
            format!("{name}: {key} is missing in {missing} of {samples} samples: they are left out")
        });
    }
    let times = &scenario.sample_time_s;
    let period_s = (times[times.len() - 1] - times[0]) / (times.len() - 1) as f64;
    let longest = times
        .windows(2)
        .max_by(|a, b| (a[1] - a[0]).total_cmp(&(b[1] - b[0])));
    if let Some([from_s, to_s]) = longest
        && whole
        && to_s - from_s > LONG_GAP * period_s
        && to_s - from_s > LONG_GAP_S
    {
        cautions.push(format!(
            "{}: no rows between {from_s:.3} s and {to_s:.3} s: the voltage is taken as held through it, and what the motor \
             really did there is taken for an error of the model; cut the file there",
            run.name
        ));
    }
    cautions
}

/// One sample of so many without a value is worth a word.
const MANY_MISSING: usize = 10;
/// A time without rows that is worth a word: so many mean periods, and so many seconds.
const LONG_GAP: f64 = 50.0;
const LONG_GAP_S: f64 = 0.2;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_model_that_was_fitted_on_what_judges_it_is_told_by_its_file() {
        let folder = tempfile::tempdir().unwrap();
        let run = |name: &str| {
            let path = folder.path().join(name);
            std::fs::create_dir(&path).unwrap();
            path
        };
        let (fit, select) = (run("20260101T000000Z-fit"), run("20260101T000000Z-select"));
        let history = [fit.display().to_string()];
        let says = |run: &Path, holdout: Option<&Path>| was_fitted_on(&history, run, holdout);
        let warning = says(&select, Some(&fit)).unwrap();
        assert!(
            warning.contains("held-out figures are those of a fit"),
            "{warning}"
        );
        assert!(says(&select, Some(&fit.join("samples.csv"))).is_some());
        let warning = says(&fit, None).unwrap();
        assert!(warning.contains("its last 40 %"), "{warning}");
        // The run that a model was fitted on may stand beside one that it was not.
        assert_eq!(says(&fit, Some(&select)), None);
        assert_eq!(says(&select, None), None);
        // The record moved since.
        let moved = ["/gone/20260101T000000Z-fit".to_owned()];
        assert!(was_fitted_on(&moved, &select, Some(&fit)).is_some());
    }
}
