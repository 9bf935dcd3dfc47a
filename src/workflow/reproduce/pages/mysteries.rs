//! The mysteries that the whole program was given, on the study's page.

use super::discovery::{table, tally_head, tally_row};
use super::{calibration, cells};
use crate::report::page::Cell;
use crate::report::reproduce::{NamedTable, Section};
use crate::text::number::significant;
use crate::workflow::reproduce::discovery::{
    MysteryAnswer, Outcome, ParameterFinding, Tally, coverage_of, median_errors,
};

const HOW: &str = "Each seed draws what a software drive hides: one effect of the catalogue with a random size, sometimes nothing, sometimes an effect that no catalogue has. For each seed the program itself is started: `drivebench commission --headless --port sim: --mystery SEED --json` (checks, four runs at 100 Hz in virtual time, identification, diagnosis), and its answer is marked as `drivebench reveal` does.";

impl Outcome {
    const fn word(self) -> &'static str {
        match self {
            Self::Right => "right",
            Self::Twin => "twin",
            Self::Ambiguous => "set",
            Self::Partial => "partial",
            Self::NotExcited => "not excited",
            Self::Abstained => "silent",
            Self::Wrong => "WRONG",
            Self::Failed => "failed",
        }
    }
}

/// One sentence for the head of the page; none where no mystery was given.
pub(super) fn in_short(answers: &[MysteryAnswer]) -> Option<String> {
    let tally = Tally::of_mysteries(answers);
    (tally.sets > 0).then(|| {
        format!(
            " Of {} mystery drives, through the whole program, {} were answered rightly ({} of them that the run cannot show the effect), {} were given a wrong name.",
            tally.sets,
            tally.right + tally.not_excited,
            tally.not_excited,
            tally.wrong
        )
    })
}

/// Counts, intervals of the motor's parameters, and every answer that is not simply right.
pub(super) fn section(answers: &[MysteryAnswer]) -> Section {
    let errors = answers
        .iter()
        .filter(|answer| !answer.effects.is_empty())
        .filter_map(|answer| Some((answer.holdout_before?, answer.holdout_after?)));
    let counts = tally_row(
        "all".to_owned(),
        Tally::of_mysteries(answers),
        median_errors(errors),
    );
    let parameters = answers.iter().flat_map(|answer| &answer.parameters);
    let parameters: Vec<&ParameterFinding> = parameters.collect();
    let others = answers
        .iter()
        .filter(|answer| answer.outcome != Outcome::Right);
    Section {
        heading: "Mystery drives, through the whole program".to_owned(),
        paragraphs: vec![HOW.to_owned()],
        tables: vec![
            table(
                "Counts. The errors are over the drives on which an effect was named.",
                "mysteries",
                tally_head("mysteries"),
                vec![counts],
            ),
            calibration::intervals(
                "Whatever was hidden and found",
                "mystery-parameters",
                &coverage_of(&parameters),
            ),
            confusion(answers),
            table(
                "Drives that were not simply answered rightly. Errors are held out, in units of the sensors' noise; of the sizes the largest error is given.",
                "mystery-drives",
                vec![
                    "seed",
                    "hidden",
                    "answer",
                    "",
                    "error before",
                    "after",
                    "size off by",
                ],
                others.map(row).collect(),
            ),
        ],
        ..Section::default()
    }
}

fn confusion(answers: &[MysteryAnswer]) -> (String, NamedTable) {
    let mut pairs: Vec<(&str, String, usize)> = Vec::new();
    for answer in answers {
        let column = answer.column();
        match pairs
            .iter_mut()
            .find(|pair| pair.0 == answer.hidden && pair.1 == column)
        {
            Some(pair) => pair.2 += 1,
            None => pairs.push((&answer.hidden, column, 1)),
        }
    }
    pairs.sort();
    let rows = pairs
        .into_iter()
        .map(|(hidden, column, count)| cells([hidden.to_owned(), column, count.to_string()]));
    table(
        "Who is taken for whom.",
        "mystery-confusion",
        vec!["hidden", "answer", "drives"],
        rows.collect(),
    )
}

/// A reason without the paths of the machine on which it came about: the page is read elsewhere.
fn without_paths(reason: &str) -> String {
    let words = reason.split(' ').map(|word| match word.strip_prefix('/') {
        Some(path) if path.ends_with(':') => "port:",
        Some(_) => "port",
        None => word,
    });
    words.collect::<Vec<_>>().join(" ")
}

fn row(answer: &MysteryAnswer) -> Vec<Cell> {
    let number = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |v| significant(v, 3));
    let said = match answer.outcome {
        Outcome::Failed => without_paths(&answer.reason),
        _ => answer.column(),
    };
    cells([
        answer.seed.to_string(),
        answer.hidden.clone(),
        said,
        answer.outcome.word().to_owned(),
        number(answer.holdout_before),
        number(answer.holdout_after),
        answer
            .size_error_percent
            .map_or_else(|| "-".to_owned(), |e| format!("{} %", significant(e, 2))),
    ])
}

#[cfg(test)]
mod tests {
    #[test]
    fn a_reason_names_no_path_and_keeps_everything_else() {
        let reason = "error: /dev/pts/7: no reply within 42 ms, 3 of /dev/pts/7 at 5 m/s";
        assert_eq!(
            super::without_paths(reason),
            "error: port: no reply within 42 ms, 3 of port at 5 m/s"
        );
    }
}
