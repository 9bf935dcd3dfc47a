//! The page of the study of the diagnosis: sets, answers, calibration. In Markdown it is
//! `docs/validation/tables.md`.

use drivebench::text::number::{fixed, significant};
use serde_json::{Value, json};

use super::lines;
use crate::charts::{Claims, reliability};
use crate::page::{FiguresAndTables, Findings, Grid, share, with};
use crate::study::{
    Answer, Bin, Bounded, Calibration, Excitation, Group, MysteryAnswer, NOTHING, Outcome, Study,
    Tally, coverage, coverage_of, distinct, median_errors, sizes,
};

/// Heads of the columns of the matrix: numbers, which a row's label explains.
const NUMBERS: &str = "1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20 21 22 23 24 25 26 27 28 29 30 31 32 33 34 35 36 37 38 39 40";

impl Study {
    /// The page; without the parts that were not requested.
    pub fn report(&self) -> Result<FiguresAndTables, String> {
        let counts = json!({
            "mystery_count": self.mysteries.len(),
            "machines": self.answers.len() + self.mysteries.len(),
        });
        let mut findings = Findings::new(self, counts);
        let mut layouts = vec![include_str!("../layouts/validation.md")];
        if !self.answers.is_empty() {
            findings = self.answered(findings.and(self.counted()));
            layouts.push(include_str!("../layouts/answers.md"));
        }
        if !self.records.is_empty() {
            layouts.push(include_str!("../layouts/records.md"));
        }
        if !self.mysteries.is_empty() {
            findings = commissioned(findings, &self.mysteries);
            layouts.push(include_str!("../layouts/mysteries.md"));
        }
        if let Some(found) = &self.lines {
            findings = findings.and(lines::rows(found));
            layouts.push(lines::LAYOUT);
        }
        findings.on(&layouts)
    }

    fn of(&self, keep: impl Fn(&Answer) -> bool) -> Vec<&Answer> {
        self.answers.iter().filter(|answer| keep(answer)).collect()
    }

    /// Of a group, by excitation.
    fn of_excitation(&self, group: Group, name: &str) -> Vec<&Answer> {
        self.of(|answer| answer.group == group && answer.excitation == name)
    }

    /// Excitations of a group, in their order.
    fn excitations_of(&self, group: Group) -> Vec<&'static str> {
        let all = Excitation::ALL.iter().map(|excitation| excitation.name());
        all.filter(|name| !self.of_excitation(group, name).is_empty()).collect()
    }

    fn counted(&self) -> Value {
        let [single, nothing] =
            [Group::Single, Group::Null].map(|group| Tally::of(self.of(|a| a.group == group)));
        let excitations = Excitation::ALL.iter();
        let excitations = excitations.map(|own| format!("{}: {}.", own.name(), own.description()));
        let of_classes = [true, false].map(|is_null| {
            let of_class = |a: &Answer| matches!(a.group, Group::Class { .. });
            Tally::of(self.of(|a| of_class(a) && (a.class == NOTHING) == is_null))
        });
        let [class_null, class_single] = of_classes;
        let described = distinct(self.answers.iter().filter_map(|answer| match answer.group {
            Group::Class { class } => Some(format!("{}: {}.", class.name, class.description)),
            _ => None,
        }));
        let columns = self.matrix.columns.iter().enumerate();
        let other_columns =
            columns.filter(|(_, column)| !self.matrix.rows.iter().any(|row| row == *column));
        let other_columns = other_columns.map(|(k, column)| format!("; {} {column}", k + 1));
        let mut groups: Vec<Value> = (named_groups(&self.answers).into_iter())
            .map(|name| {
                let all = Calibration::of(self.of(|answer| answer.group.name() == name));
                with_shares(&name, &all)
            })
            .collect();
        groups.push(with_shares("all", &self.calibration));
        let [noisy, lossy] = [Group::Noisy, Group::Lossy].map(|group| {
            let [before, after] = self.against_single(group).map(Tally::of);
            json!({"before": before, "after": after})
        });
        let failures = self.of(|a| matches!(a.outcome, Outcome::Wrong | Outcome::Failed));
        let no_failures = failures.is_empty().then_some("There is none in this study.");
        let failures =
            failures.iter().map(|answer| with(answer, json!({"group": answer.group.name()})));
        let all = &self.calibration;
        let counts = json!({
            "single": single,
            "single_right": Bounded::new(single.right, single.sets),
            "single_wrong": single.wrong_share(),
            "null": nothing,
            "null_wrong": nothing.wrong_share(),
            "excitations": excitations.collect::<Vec<_>>(),
            "classes": described,
            "class_single": class_single,
            "class_null": class_null,
            "other_columns": other_columns.collect::<String>(),
            "contradicted": contradicted(all),
            "missed": missed(all),
            "groups": groups,
            "sizes": sizes(&self.answers),
            "noisy": noisy,
            "lossy": lossy,
            "no_failures": no_failures.as_slice(),
            "failures": failures.collect::<Vec<_>>(),
        });
        with(with_shares("", all), counts)
    }

    /// The answers for the machines that a group shares with the single effects and the nulls: theirs, then the group's.
    fn against_single(&self, group: Group) -> [Vec<&Answer>; 2] {
        let harder = self.of(|a| a.group == group);
        let is_shared = |a: &Answer| harder.iter().any(|other| other.seed == a.seed);
        let plain = self.of(|a| matches!(a.group, Group::Single | Group::Null) && is_shared(a));
        [plain, harder]
    }

    /// The picture, and the tables of outcomes.
    fn answered(&self, findings: Findings) -> Findings {
        let single =
            |keep: &dyn Fn(&Answer) -> bool| self.of(|a| a.group == Group::Single && keep(a));
        let by_excitation = self.excitations_of(Group::Single).into_iter();
        let by_excitation =
            by_excitation.map(|name| (name.to_owned(), self.of_excitation(Group::Single, name)));
        let classes = distinct(single(&|_| true).into_iter().map(|a| a.class.clone())).into_iter();
        let by_effect = classes.map(|class| {
            let own = single(&|a| a.class == class);
            (class, own)
        });
        let rich = self.of_excitation(Group::Single, Excitation::Rich.name());
        let levels = self.answers.iter().filter_map(|answer| match answer.group {
            Group::Background { level } => Some(level),
            _ => None,
        });
        let by_level = distinct(levels)
            .into_iter()
            .map(|level| (level.to_string(), self.of(|a| a.group == Group::Background { level })));
        let harder = [Group::Harsh, Group::Small].into_iter().flat_map(|group| {
            let all = self.excitations_of(group).into_iter();
            all.map(move |name| {
                (format!("{}, {name}", group.name()), self.of_excitation(group, name))
            })
        });
        let mut findings = findings
            .picture("reliability", chart(&self.calibration))
            .grid(confusion(self))
            .grid(self.intervals())
            .grid(tallies("excitations", "excitation", by_excitation))
            .grid(tallies("effects", "hidden", by_effect))
            .grid(tallies(
                "background",
                "level",
                std::iter::once(("0".to_owned(), rich)).chain(by_level),
            ))
            .grid(tallies("harsh-background", "group", harder))
            .grid(tallies("classes", "class", self.by_class(|answer| answer.class != NOTHING)))
            .grid(tallies("class-nulls", "class", self.by_class(|answer| answer.class == NOTHING)));
        for (group, name) in [
            (Group::Null, "nulls"),
            (Group::Unknown, "unknown"),
            (Group::WrongForm, "another-shape"),
            (Group::Pair, "pairs"),
        ] {
            let class = |answer: &Answer| match group {
                Group::Null => answer.excitation.to_owned(),
                _ => answer.class.clone(),
            };
            let own = self.of(|a| a.group == group);
            let mut rows: Vec<_> = distinct(own.iter().map(|answer| class(answer)))
                .into_iter()
                .map(|of| {
                    let of_class = self.of(|a| a.group == group && class(a) == of);
                    (of, of_class)
                })
                .collect();
            if rows.len() > 1 {
                rows.push(("all".to_owned(), own));
            }
            findings = findings.grid(tallies(name, "hidden", rows));
        }
        for (group, name) in [(Group::Noisy, "noise"), (Group::Lossy, "lost-rows")] {
            let [plain, harder] = self.against_single(group);
            let rows = self.excitations_of(group).into_iter().flat_map(|excitation| {
                [(&plain, "as they are"), (&harder, &*group.name())].map(|(all, label)| {
                    let own = all.iter().copied().filter(|a| a.excitation == excitation);
                    (format!("{excitation}, {label}"), own.collect())
                })
            });
            findings = findings.grid(tallies(name, "excitation", rows));
        }
        findings
    }

    /// Answers of each class of motor, and of all of them.
    fn by_class(&self, keep: impl Fn(&Answer) -> bool) -> Vec<(String, Vec<&Answer>)> {
        let is_of_class = |a: &Answer| matches!(a.group, Group::Class { .. });
        let own = self.of(|answer| is_of_class(answer) && keep(answer));
        let names = distinct(own.iter().map(|answer| answer.group.name()));
        let each = names.into_iter().map(|name| {
            let of_class = own.iter().copied().filter(|answer| answer.group.name() == name);
            let of_class = of_class.collect();
            (name, of_class)
        });
        let mut rows: Vec<(String, Vec<&Answer>)> = each.collect();
        if !rows.is_empty() {
            rows.push(("all".to_owned(), own));
        }
        rows
    }

    /// What the intervals of the motor's parameters hold, by group.
    fn intervals(&self) -> Grid {
        let of_group = |name: String| {
            let own = self.of(|answer| answer.group.name() == name);
            (name, coverage(&own))
        };
        let by_group = named_groups(&self.answers).into_iter().map(of_group);
        let by_group = by_group.chain([("all".to_owned(), self.coverage.clone())]);
        let rows = by_group.map(|(name, coverage)| {
            let held = coverage.iter().map(|own| share(&json!(own.hold), "counted"));
            std::iter::once(name).chain(held).collect()
        });
        let parameters = self.coverage.iter().map(|own| own.parameter.key());
        let head = std::iter::once("group").chain(parameters);
        ("coverage", head.collect(), rows.collect())
    }
}

fn confusion(study: &Study) -> Grid {
    let matrix = &study.matrix;
    let columns = &matrix.columns;
    let head = std::iter::once("hidden").chain(NUMBERS.split(' ').take(columns.len()));
    let rows = matrix.rows.iter().zip(&matrix.counts).map(|(row, counts)| {
        let number = columns.iter().position(|column| column == row);
        let label = number.map_or_else(|| row.clone(), |k| format!("{} {row}", k + 1));
        let counts = counts.iter().map(|count| none_as_dot(*count));
        std::iter::once(label).chain(counts).collect()
    });
    ("confusion", head.collect(), rows.collect())
}

/// Counts of the outcomes of some answers, and medians of their errors before and after.
fn tallies<'a>(
    name: &'static str,
    first: &'static str,
    rows: impl IntoIterator<Item = (String, Vec<&'a Answer>)>,
) -> Grid {
    let rows = rows.into_iter().map(|(label, answers)| {
        let errors = median_errors(answers.iter().filter_map(|answer| answer.errors()));
        tallied(label, Tally::of(answers), errors)
    });
    (name, outcomes(first), rows.collect())
}

fn outcomes(first: &'static str) -> Vec<&'static str> {
    let others =
        "sets|right|twin|set|partial|not excited|silent|wrong|at most|failed|error before|after";
    std::iter::once(first).chain(others.split('|')).collect()
}

fn tallied(label: String, tally: Tally, errors: Option<(f64, f64)>) -> Vec<String> {
    let error = |error: Option<f64>| error.map_or("-".to_owned(), |error| significant(error, 3));
    vec![
        label,
        tally.sets.to_string(),
        none_as_dot(tally.right),
        none_as_dot(tally.twin),
        none_as_dot(tally.ambiguous),
        none_as_dot(tally.partial),
        none_as_dot(tally.not_excited),
        none_as_dot(tally.abstained),
        none_as_dot(tally.wrong),
        format!("{} %", fixed(tally.wrong_share().upper_percent, 1)),
        none_as_dot(tally.failed),
        error(errors.map(|errors| errors.0)),
        error(errors.map(|errors| errors.1)),
    ]
}

fn none_as_dot(count: usize) -> String {
    match count {
        0 => ".".to_owned(),
        count => count.to_string(),
    }
}

/// Counts, intervals of the motor's parameters, and every answer other than "right".
fn commissioned(findings: Findings, answers: &[MysteryAnswer]) -> Findings {
    let named = answers.iter().filter(|answer| !answer.effects.is_empty());
    let errors = named.filter_map(|answer| Some((answer.holdout_before?, answer.holdout_after?)));
    let tally = Tally::of_outcomes(answers.iter().map(|answer| answer.outcome));
    let counts = tallied("all".to_owned(), tally, median_errors(errors));
    let parameters: Vec<_> = answers.iter().flat_map(|answer| &answer.parameters).collect();
    let others = answers.iter().filter(|answer| answer.outcome != Outcome::Right);
    let others = others.map(|answer| {
        let shown = match answer.outcome {
            Outcome::Failed => without_paths(&answer.reason),
            _ => answer.column(),
        };
        with(answer, json!({"answer": shown}))
    });
    findings
        .and(json!({
            "tally": tally,
            "answered_rightly": tally.right + tally.not_excited,
            "mystery_coverage": coverage_of(&parameters),
            "mystery_pairs": pairs(answers),
            "mystery_others": others.collect::<Vec<_>>(),
        }))
        .grid(("mysteries", outcomes("mysteries"), vec![counts]))
}

/// What was hidden, what was answered, how often.
fn pairs(answers: &[MysteryAnswer]) -> Vec<(&str, String, usize)> {
    let mut pairs: Vec<(&str, String, usize)> = Vec::new();
    for answer in answers {
        let column = answer.column();
        let same = |pair: &&mut (&str, String, usize)| pair.0 == answer.hidden && pair.1 == column;
        match pairs.iter_mut().find(same) {
            Some(pair) => pair.2 += 1,
            None => pairs.push((&answer.hidden, column, 1)),
        }
    }
    pairs.sort();
    pairs
}

/// A reason without the paths of the machine that ran the study.
fn without_paths(reason: &str) -> String {
    let words = reason.split(' ').map(|word| match word.strip_prefix('/') {
        Some(path) if path.ends_with(':') => "port:",
        Some(_) => "port",
        None => word,
    });
    words.collect::<Vec<_>>().join(" ")
}

/// Probabilities from which on an effect is called supported, and below which ruled out.
const SUPPORTED: f64 = 0.9;
const POSSIBLE: f64 = 0.1;

/// A calibration with its group, and the shares of supported and of ruled-out effects that are there.
fn with_shares(group: &str, all: &Calibration) -> Value {
    let of = |keep: &dyn Fn(&Bin) -> bool| together(all.bins.iter().filter(|bin| keep(bin)));
    let whole = of(&|_| true);
    // Brier score of the answer that gives every effect the share of effects that are there.
    let share = whole.count as f64 / whole.of as f64;
    let more = json!({
        "group": group,
        "supported": of(&|bin| bin.from >= SUPPORTED),
        "under": of(&|bin| bin.to <= POSSIBLE),
        "indifferent": (whole.of > 0).then_some(share * (1.0 - share)),
    });
    with(all, more)
}

/// Which of the given probabilities the counts contradict.
fn contradicted(all: &Calibration) -> String {
    let contradicted = all.bins.iter().filter_map(|bin| {
        let mean = 100.0 * bin.mean?;
        let side = if mean < bin.there.lower_percent {
            "too low"
        } else if mean > bin.there.upper_percent {
            "too high"
        } else {
            return None;
        };
        let share = 100.0 * bin.there.count as f64 / bin.there.of as f64;
        let [given, there] = [mean, share].map(|percent| fixed(percent, 1));
        let (from, to) = (bin.from, bin.to);
        Some(format!("{from} to {to} ({side}: {given} % given, {there} % there)"))
    });
    let contradicted: Vec<String> = contradicted.collect();
    if contradicted.is_empty() {
        "The counts contradict the probabilities in no bin.".to_owned()
    } else {
        format!(
            "The counts contradict the probabilities in these bins: {}.",
            contradicted.join(", ")
        )
    }
}

fn missed(all: &Calibration) -> String {
    let instead = all.missed;
    let parts = [
        (instead.twin, "its twin named"),
        (instead.open, "called not to be told from what was named"),
        (instead.possible, "called possible"),
        (instead.ruled_out, "called ruled out"),
        (instead.not_excited, "called not excited"),
        (instead.other_order, "named with another number of waves"),
    ];
    let shown: Vec<String> = (parts.iter())
        .filter(|(count, _)| *count > 0)
        .map(|(count, what)| format!("{what} {count}"))
        .collect();
    let there = all.recalled.of;
    match there - all.recalled.count {
        0 => format!("All {there} effects that are there were named."),
        unnamed => format!(
            "Of {there} effects that are there {unnamed} went unnamed: {}.",
            shown.join(", ")
        ),
    }
}

fn chart(all: &Calibration) -> String {
    let claims = all.bins.iter().filter_map(|bin| {
        Some(Claims {
            given: bin.mean?,
            share: bin.there.count as f64 / bin.there.of as f64,
            low: 0.01 * bin.there.lower_percent,
            high: 0.01 * bin.there.upper_percent,
            count: bin.there.of,
        })
    });
    reliability(
        "How often effects are there, over the probability that they were given",
        "share of effects that are there",
        "probability that was given",
        &claims.collect::<Vec<_>>(),
    )
}

/// The groups in the order in which they come, and all together.
fn named_groups(answers: &[Answer]) -> Vec<String> {
    distinct(answers.iter().map(|answer| answer.group.name()))
}

fn together<'a>(bins: impl Iterator<Item = &'a Bin>) -> Bounded {
    let (there, of) =
        bins.fold((0, 0), |(there, of), bin| (there + bin.there.count, of + bin.there.of));
    Bounded::new(there, of)
}

#[cfg(test)]
mod tests {
    use drivebench::diagnosis::DiagnosisVerdict;

    use super::*;
    use crate::study::calibration::by_hand::{absent, answer, missed, named};
    use crate::study::matrix;

    #[test]
    fn a_reason_names_no_path_and_keeps_everything_else() {
        let reason = "error: /dev/pts/7: no reply within 42 ms, 3 of /dev/pts/7 at 5 m/s";
        assert_eq!(
            super::without_paths(reason),
            "error: port: no reply within 42 ms, 3 of port at 5 m/s"
        );
    }

    fn study(answers: Vec<Answer>) -> Study {
        Study {
            study: "discovery",
            seed: 1,
            sets_in_each_cell: 1,
            counts: vec![],
            matrix: matrix(&answers),
            calibration: Calibration::of(&answers),
            coverage: coverage(&answers.iter().collect::<Vec<_>>()),
            answers,
            records: vec![],
            mysteries: vec![],
            lines: None,
        }
    }

    fn good() -> Vec<Answer> {
        let findings = || {
            let others = ["backlash", "load_step", "supply_sag"];
            let others = others.iter().map(|id| absent(id, 0.004));
            others.chain([named("cogging", 0.99)]).collect()
        };
        let of = |group| answer(group, DiagnosisVerdict::Effect, findings());
        vec![of(Group::Single), of(Group::Harsh)]
    }

    /// What is there is called ruled out at a fifth of its size, and its twin is named with certainty.
    fn bad() -> Answer {
        let findings = vec![
            missed("viscous_friction", 0.001).with(|own| own.twin = true),
            absent("quadratic_load", 1.0).with(|own| (own.named, own.twin) = (true, true)),
        ];
        answer(Group::Single, DiagnosisVerdict::Effect, findings)
    }

    #[test]
    fn sentences_follow_the_figures() {
        let text = |answers| study(answers).report().unwrap().text();
        let fine = text(good());
        assert!(fine.contains("The counts contradict the probabilities in no bin."));
        assert!(fine.contains("All 2 effects that are there were named."));
        assert!(fine.contains("0 of 2 (0.0 %) were called ruled out"));
        let worse = text(good().into_iter().chain([bad()]).collect());
        assert!(worse.contains("0 to 0.02 (too low:") && worse.contains("0.98 to 1 (too high:"));
        assert!(worse.contains("Of 3 effects that are there 1 went unnamed: its twin named 1."));
        assert!(worse.contains("1 of 3 (33.3 %) were called ruled out"));
        assert!(worse.contains("\"At most\" holds for 0 of 1 (0.0 %)"));
    }

    #[test]
    fn the_page_has_tables_and_a_picture() {
        let lossy = Answer { group: Group::Lossy, ..bad() };
        let study = study(good().into_iter().chain([bad(), lossy]).collect());
        let page = study.report().unwrap();
        insta::assert_snapshot!(page.text());
        let files = page.files("validation.md");
        let svg = files.iter().find(|(name, _)| name == "reliability.svg");
        assert!(svg.is_some_and(|(_, svg)| svg.matches("class=\"knot after\"").count() == 2));
    }
}
