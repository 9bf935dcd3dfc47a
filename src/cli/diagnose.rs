//! `diagnose`: which physical effect is missing.

use std::fmt::Write as _;
use std::io::IsTerminal as _;
use std::path::PathBuf;

use super::data::{EvidenceArguments, prepare};
use super::discovery::{self, Shown};
use super::failure::{Failure, INTERRUPTED, USAGE};
use super::next_experiment::NextArguments;
use super::sanity_report::Judging;
use super::{output, pages, progress, signals};
use crate::diagnosis::{Candidate, Diagnosis, Reached, diagnose_with};
use crate::plant::effect::Axis;
use crate::sample::ParameterEstimate;
use crate::workflow::Discovery;

/// Name the physical effect that a model is missing, judged on data the fit has not seen
#[derive(clap::Args)]
#[command(after_help = "Examples:
  drivebench diagnose runs/a --model model.toml --holdout runs/b
  drivebench diagnose runs/a --holdout runs/b --html page.html     the same with every picture
  drivebench diagnose runs/a --next-bench next.toml     and, where two effects are not told apart, the run that would:
  drivebench run next.toml && drivebench diagnose runs/NEW --holdout runs/a
  drivebench diagnose runs/a --holdout runs/b --screen     see where it fails, add the effect with one key
  drivebench diagnose runs/a --holdout runs/b --screen --guess     name it yourself first")]
pub(super) struct Arguments {
    /// Run folder, samples.csv, or any CSV with --map
    run: PathBuf,
    /// Model file; without it the run folder's, else a fitted baseline
    #[arg(long)]
    model: Option<PathBuf>,
    /// Name every effect that the runs ask for; so it is without this, too, which scripts may go on giving
    #[arg(long)]
    until_floor: bool,
    #[command(flatten)]
    evidence: EvidenceArguments,
    #[command(flatten)]
    on_screen: ScreenArguments,
    #[command(flatten)]
    next: NextArguments,
    /// Write the page: ladder, where the model fails, every effect that was tried; never overwritten
    #[arg(long, value_name = "PAGE.html")]
    html: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// The diagnosis on the screen.
#[derive(clap::Args)]
struct ScreenArguments {
    /// Work on the screen: see where the model fails, add and remove effects, write the model
    #[arg(long, conflicts_with = "json")]
    screen: bool,
    /// On the screen: no name is shown before you have given one
    #[arg(long, requires = "screen")]
    guess: bool,
    /// On the screen: where the model is written to; never overwritten
    #[arg(long, value_name = "MODEL2.toml", requires = "screen")]
    output: Option<PathBuf>,
}

pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    let on_screen = &arguments.on_screen;
    if on_screen.screen && !std::io::stdout().is_terminal() {
        return Err(Failure::with_help(
            USAGE,
            "--screen: standard output is not a terminal",
            "leave --screen out: the answer is printed as text",
        ));
    }
    if let Some(path) = &on_screen.output {
        output::refuse_existing(path, "--output")?;
    }
    if let Some(path) = &arguments.html {
        output::refuse_existing(path, "--html")?;
    }
    let mut attended = Some((signals::endable()?, progress::begin("diagnose")));
    let prepared = prepare(
        &arguments.run,
        arguments.model.as_ref(),
        &arguments.evidence,
        Judging::Refits,
    )?;
    let place = arguments.next.place(&prepared)?;
    let original = prepared.model.file.model.clone();
    let mut by_hand = String::new();
    let mut known_next = None;
    let mut diagnosis = if on_screen.screen {
        // From here on the screen owns the terminal and hears the signals.
        drop(attended.take());
        let shown = Shown {
            title: prepared.about.title.clone(),
            guess_first: on_screen.guess,
            fitted_on: prepared.run.run.name.clone(),
            history: prepared.model.file.history.clone(),
            output: on_screen.output.clone(),
        };
        let evidence = prepared.evidence.clone();
        let discovery = Discovery::new(original.clone(), evidence).with_limits(place.limits());
        let left = discovery::show(discovery, shown)?;
        attended = Some((signals::endable()?, progress::begin("diagnose")));
        // Asked only now: from here on a signal ends the program by itself.
        if left.is_interrupted() {
            return Err(Failure::new(INTERRUPTED, "interrupted"));
        }
        by_hand = left.standing.heading();
        known_next = left.standing.next;
        left.standing
            .diagnosis
            .ok_or_else(|| Failure::new(INTERRUPTED, "left before there was an answer"))?
    } else {
        diagnose_with(&original, prepared.evidence.clone(), &progress::diagnosis)?
    };
    if let Some(next) = known_next {
        place.take_over(&mut diagnosis, next);
    } else {
        progress::stage("looks for the run that would tell more", 0);
        place.recommend(&mut diagnosis, &prepared.evidence)?;
    }
    let _endable = attended.map(|(endable, _)| endable);
    arguments.next.write(&place, &diagnosis, &arguments.run)?;
    if let Some(path) = &arguments.html {
        let page = pages::diagnosis(
            &prepared.about,
            &prepared.run,
            &prepared.evidence,
            &diagnosis,
        )?;
        pages::write(path, &page)?;
    }
    let mut value = serde_json::to_value(&diagnosis).unwrap_or_default();
    value["rows_dropped"] = prepared.run.run.rows_dropped.into();
    value["notes"] = prepared.run.run.notes.clone().into();
    output::result(&value, arguments.json, |_| {
        format!("{by_hand}{}", text(&diagnosis))
    })
}

pub(super) fn text(diagnosis: &Diagnosis) -> String {
    let mut text = format!("{}\n", diagnosis.sentence);
    if let Some(confirm) = &diagnosis.confirm {
        let _ = writeln!(text, "{}", confirm.sentence);
    }
    if !diagnosis.sufficient && diagnosis.effect.is_some() {
        let _ = writeln!(
            text,
            "this is not all: much of the error is still unexplained"
        );
    }
    for candidate in &diagnosis.candidates {
        let _ = writeln!(
            text,
            "{:>2} {:<12} {}",
            candidate.rank,
            candidate.status.name(),
            candidate.evidence
        );
        if !candidate.parameters.is_empty() {
            let _ = writeln!(text, "   {:<12} {}", "", sizes(candidate));
            for peak in candidate.reached.iter().flat_map(Reached::peaks) {
                let _ = writeln!(text, "   {:<12} {}", "", peak.text(1.0));
            }
        }
    }
    for part in &diagnosis.unknown {
        let _ = writeln!(text, "unknown: {}", part.sentence);
    }
    if let Some(map) = diagnosis.axis_map.first().filter(|map| map.is_followed()) {
        let _ = writeln!(text, "curve: {}", map.sentence);
        let _ = writeln!(
            text,
            "       --html PAGE draws it, --screen shows it under c"
        );
        if Axis::from_key(map.axis).is_some() {
            let _ = writeln!(
                text,
                "       `drivebench add table --equation {} --axis {}` holds it until its cause is known",
                map.equation, map.axis
            );
        }
    }
    let limits = diagnosis.limits.iter().map(String::as_str);
    for sentence in limits.chain(diagnosis.equivalences.iter().copied()) {
        let _ = writeln!(text, "note: {sentence}");
    }
    if let Some(next) = &diagnosis.next_experiment {
        let _ = writeln!(text, "next: {}", next.sentence);
    }
    text
}

fn sizes(candidate: &Candidate) -> String {
    candidate
        .parameters
        .iter()
        .map(parameter_text)
        .collect::<Vec<_>>()
        .join(", ")
}

/// `key = value ± std unit`, or why there is no value.
pub(super) fn parameter_text(parameter: &ParameterEstimate) -> String {
    let key = parameter.key.rsplit('.').next().unwrap_or(&parameter.key);
    if parameter.value.is_none() {
        let reason = parameter.reason.as_deref().unwrap_or("not observable");
        return format!("{key}: {reason}");
    }
    format!("{key} = {}", parameter.text(1.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnosis::Peak;
    use crate::sample::Verdict;

    fn estimate(key: &str, value: Option<f64>, std: Option<f64>, unit: &'static str) -> String {
        parameter_text(&ParameterEstimate {
            key: key.to_owned(),
            value,
            std,
            unit,
            verdict: Verdict::Settled,
            reason: None,
        })
    }

    #[test]
    fn numbers_have_the_digits_that_their_uncertainty_carries() {
        for (key, value, std, unit, text) in [
            (
                "supply_sag.sag_ohm",
                0.484_351,
                Some(0.002_801),
                "ohm",
                "sag_ohm = 0.4844 ± 0.0028 ohm",
            ),
            ("cogging.order", 7.0, Some(0.0), "-", "order = 7.0000 ± 0"),
            (
                "inductance_h",
                0.009_042,
                None,
                "H",
                "inductance_h = 0.00904 ± unknown H",
            ),
        ] {
            assert_eq!(estimate(key, Some(value), std, unit), text);
        }
        assert_eq!(estimate("a.b", None, None, "-"), "b: not observable");
        let peak = Peak {
            value: 2.2051,
            std: Some(0.0132),
            interval_95: None,
            unit: "V",
            percent_of_largest: Some(2.31),
        };
        assert_eq!(
            peak.text(1.0),
            "up to 2.205 ± 0.013 V in this run, 2.3 % of the largest"
        );
    }
}
