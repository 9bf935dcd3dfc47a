//! `diagnose`: which physical effect is missing.

use std::fmt::Write as _;
use std::path::PathBuf;

use super::arguments::EvidenceArguments;
use super::failure::Failure;
use super::output::{self, lines};
use super::{progress, signals};
use crate::app::by_hand::{self, Shown};
use crate::app::evidence::Judging;
use crate::app::evidence::Place;
use crate::app::{pages, screen};
use crate::diagnosis::{Candidate, Diagnosis, Reached, diagnose_with};
use crate::plant::effect::Axis;
use crate::sample::ParameterEstimate;
use crate::tui::Opens;
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
    /// Bench whose drive, motor and limits the recommended next run keeps; without it that of the run folder, else
    /// nothing beyond what the runs have reached
    #[arg(long, value_name = "BENCH.toml")]
    bench: Option<PathBuf>,
    /// Write the bench file of the recommended next run
    #[arg(long, value_name = "FILE")]
    next_bench: Option<PathBuf>,
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
    if on_screen.screen {
        let help = "leave --screen out: the answer is printed as text";
        screen::needs_terminal("--screen", help)?;
    }
    for (path, option) in [(&on_screen.output, "--output"), (&arguments.html, "--html")] {
        let path = path.as_deref();
        path.map_or(Ok(()), |path| output::refuse_existing(path, option))?;
    }
    let mut attended = Some((signals::endable()?, progress::begin("diagnose")));
    let (model, judging) = (arguments.model.as_deref(), Judging::Refits);
    let (evidence, run) = (&arguments.evidence, &arguments.run);
    let prepared = if on_screen.screen {
        evidence.prepare_for_screen(run, model, judging)?
    } else {
        evidence.prepare(run, model, judging)?
    };
    if let Some(path) = &arguments.next_bench {
        output::refuse_existing(path, "--next-bench")?;
    }
    let place = Place::of(arguments.bench.as_deref(), &prepared)?;
    let original = prepared.model.file.model.clone();
    let evidence = prepared.evidence.clone();
    let mut by_hand = String::new();
    let mut known_next = None;
    let mut diagnosis = if on_screen.screen {
        // From here on the screen owns the terminal and hears the signals.
        drop(attended.take());
        let shown = Shown {
            title: prepared.about.title.clone(),
            guess_first: on_screen.guess,
            opens: Opens::Search,
            fitted_on: prepared.run.run.name.clone(),
            history: prepared.model.file.history.clone(),
            output: on_screen.output.clone(),
        };
        let discovery = Discovery::new(original, evidence)
            .with_limits(place.limits())
            .with_recorded(prepared.recorded.clone());
        let left = by_hand::show(discovery, shown)?;
        attended = Some((signals::endable()?, progress::begin("diagnose")));
        // Asked only now: from here on a signal ends the program by itself.
        if left.is_interrupted() {
            return Err(Failure::interrupted("interrupted"));
        }
        by_hand = left.standing.heading();
        known_next = left.standing.next;
        let no_answer = || Failure::interrupted("left before there was an answer");
        left.standing.diagnosis.ok_or_else(no_answer)?
    } else {
        diagnose_with(&original, evidence, &progress::diagnosis)?
    };
    if let Some(next) = known_next {
        place.take_over(&mut diagnosis, next);
    } else {
        progress::stage("looks for the run that would tell more", 0);
        place.recommend(&mut diagnosis, &prepared)?;
    }
    let _endable = attended.map(|(endable, _)| endable);
    if let Some(path) = &arguments.next_bench {
        place.write(path, &diagnosis, &arguments.run)?;
    }
    if let Some(path) = &arguments.html {
        pages::write(path, &pages::diagnosis(&prepared, &diagnosis)?)?;
    }
    output::result(&prepared.result(&diagnosis), arguments.json, |_| {
        format!("{by_hand}{}", text(&diagnosis))
    })
}

fn text(diagnosis: &Diagnosis) -> String {
    let mut text = format!("{}\n", diagnosis.sentence);
    lines(
        &mut text,
        "",
        diagnosis.confirm.as_ref().map(|run| &run.sentence),
    );
    if !diagnosis.sufficient && diagnosis.effect.is_some() {
        text.push_str("this is not all: much of the error is still unexplained\n");
    }
    for candidate in &diagnosis.candidates {
        let (rank, status) = (candidate.rank, candidate.status.name());
        let _ = writeln!(text, "{rank:>2} {status:<12} {}", candidate.evidence);
        if !candidate.parameters.is_empty() {
            let _ = writeln!(text, "   {:<12} {}", "", sizes(candidate));
            for peak in candidate.reached.iter().flat_map(Reached::peaks) {
                let _ = writeln!(text, "   {:<12} {}", "", peak.text(1.0));
            }
        }
    }
    let unknown = diagnosis.unknown.iter().map(|part| &part.sentence);
    lines(&mut text, "unknown: ", unknown);
    if let Some(map) = diagnosis.axis_map.first().filter(|map| map.is_followed()) {
        let _ = writeln!(text, "curve: {}", map.sentence);
        text.push_str("       --html PAGE draws it, --screen shows it under c\n");
        if Axis::from_key(map.axis).is_some() {
            let (equation, axis) = (map.equation, map.axis);
            let _ = writeln!(
                text,
                "       `drivebench add table --equation {equation} --axis {axis}` holds it until its cause is known"
            );
        }
    }
    lines(&mut text, "note: ", &diagnosis.limits);
    lines(&mut text, "note: ", &diagnosis.equivalences);
    let next = diagnosis.next_experiment.as_ref();
    lines(&mut text, "next: ", next.map(|next| &next.sentence));
    text
}

fn sizes(candidate: &Candidate) -> String {
    let sizes = candidate.parameters.iter().map(parameter_text);
    sizes.collect::<Vec<_>>().join(", ")
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

    #[test]
    fn numbers_have_the_digits_that_their_uncertainty_carries() {
        for (key, value, std, unit, text) in [
            (
                "supply_sag.sag_ohm",
                Some(0.484_351),
                Some(0.002_801),
                "ohm",
                "sag_ohm = 0.4844 ± 0.0028 ohm",
            ),
            (
                "cogging.order",
                Some(7.0),
                Some(0.0),
                "-",
                "order = 7.0000 ± 0",
            ),
            (
                "inductance_h",
                Some(0.009_042),
                None,
                "H",
                "inductance_h = 0.00904 ± unknown H",
            ),
            ("a.b", None, None, "-", "b: not observable"),
        ] {
            let estimate = ParameterEstimate {
                key: key.to_owned(),
                value,
                std,
                unit,
                verdict: Verdict::Settled,
                reason: None,
            };
            assert_eq!(parameter_text(&estimate), text);
        }
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
