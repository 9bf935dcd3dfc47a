//! The mysteries that the whole program was given in real time, on the study's page.

use super::cells;
use super::discovery::{table, tally_head, tally_row};
use crate::report::number::{fixed, significant};
use crate::report::page::Cell;
use crate::report::reproduce::Section;
use crate::workflow::reproduce::discovery::{LiveAnswer, LiveLink, Outcome, Tally, median_errors};

const HOW: &str = "Each seed draws what a software drive hides: one effect of the catalogue with a random size, sometimes nothing, sometimes an effect that no catalogue has. The drive is served behind a pseudo-terminal in real time. For each seed and link the program itself is started: `drivebench run` twice (to fit, and held out), `drivebench diagnose`, and `drivebench add` for every effect that is named. Unlike the sections above this one is not the same to the bit when it is written again: the stamps of the samples depend on the machine.";

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

/// One sentence for the head of the page; none where no mystery was run.
pub(super) fn in_short(answers: &[LiveAnswer], asked: usize) -> Option<String> {
    let tally = Tally::of_live(answers);
    (tally.sets > 0).then(|| {
        let mut text = format!(
            " Of {} mystery drives in real time, through the whole program, {} were answered rightly ({} of them that the run cannot show the effect), {} were given a wrong name.",
            tally.sets,
            tally.right + tally.not_excited,
            tally.not_excited,
            tally.wrong
        );
        text.extend(unfinished(answers, asked));
        text
    })
}

/// Where the study was interrupted.
fn unfinished(answers: &[LiveAnswer], asked: usize) -> Option<String> {
    (answers.len() < asked).then(|| {
        format!(
            " The study was interrupted: these are {} of the {asked} drives that were asked for.",
            answers.len()
        )
    })
}

/// Counts over each link, and every answer.
pub(super) fn section(answers: &[LiveAnswer], asked: usize) -> Section {
    let of = |link: LiveLink| answers.iter().filter(move |answer| answer.link == link);
    let counts = LiveLink::ALL
        .into_iter()
        .filter(|link| of(*link).next().is_some());
    let counts = counts.map(|link| {
        let label = format!("{}, {} Hz", link.protocol(), fixed(link.pace().0, 0));
        let errors =
            of(link).filter_map(|answer| Some((answer.holdout_before?, answer.holdout_after?)));
        tally_row(label, Tally::of_live(of(link)), median_errors(errors))
    });
    let mut how = HOW.to_owned();
    how.extend(unfinished(answers, asked));
    Section {
        heading: "Mystery drives, through the whole program in real time".to_owned(),
        paragraphs: vec![how],
        tables: vec![
            table(
                "Counts. The errors are over the drives to which an effect was added.",
                "mysteries",
                tally_head("link"),
                counts.collect(),
            ),
            confusion(answers),
            table(
                "Every drive. Errors are held out, in units of the sensors' noise; of the sizes the largest error is given.",
                "mystery-drives",
                vec![
                    "link",
                    "seed",
                    "rows/s",
                    "hidden",
                    "answer",
                    "",
                    "error before",
                    "after",
                    "size off by",
                ],
                answers.iter().map(row).collect(),
            ),
        ],
        ..Section::default()
    }
}

fn confusion(answers: &[LiveAnswer]) -> (String, crate::report::reproduce::NamedTable) {
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
        "Who is taken for whom, over both links.",
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

fn row(answer: &LiveAnswer) -> Vec<Cell> {
    let number = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |v| significant(v, 3));
    let said = match answer.outcome {
        Outcome::Failed => without_paths(&answer.reason),
        _ => answer.column(),
    };
    cells([
        answer.link.protocol().to_owned(),
        answer.seed.to_string(),
        answer
            .rows_per_s
            .map_or_else(|| "-".to_owned(), |rate| fixed(rate, 0)),
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
