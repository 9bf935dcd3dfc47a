//! What probabilities, bounds and sizes are worth, on the page.

use super::cells;
use super::discovery::table;
use crate::report::page::Cell;
use crate::report::plot::{Claims, ReliabilityChart};
use crate::report::reproduce::{NamedTable, Picture, Section};
use crate::text::number::{fixed, significant};
use crate::workflow::reproduce::discovery::{
    Answer, Bin, Bounded, Calibration, Coverage, Discovery, coverage, sizes,
};

/// Probabilities from which on an effect is called supported, and below which ruled out.
const SUPPORTED: f64 = 0.9;
const POSSIBLE: f64 = 0.1;

/// How often what was called likely is there.
pub(super) fn probabilities(study: &Discovery) -> Section {
    let all = &study.calibration;
    let rows = all.bins.iter().map(|bin| {
        cells([
            range(bin),
            bin.there.of.to_string(),
            bin.there.count.to_string(),
            number(bin.mean, 3),
            share(bin.there),
            allowed(bin.there),
        ])
    });
    let groups = groups(&study.answers).into_iter().map(|(name, of_group)| {
        cells([
            name,
            of_group.sets.to_string(),
            counted(at_least(&of_group, SUPPORTED)),
            counted(below(&of_group, POSSIBLE)),
            number(of_group.brier, 2),
            counted(of_group.recalled),
            counted(of_group.false_names),
            none_as_dot(of_group.false_twins),
            none_as_dot(of_group.false_but_open),
        ])
    });
    Section {
        heading: "How far the probabilities can be believed".to_owned(),
        paragraphs: vec![
            WEIGHED.to_owned(),
            in_short(all),
            beside_what_is_so(all),
            missed(all),
        ],
        pictures: vec![Picture {
            name: "reliability",
            svg: chart(all),
            caption: "Across: the probability that was given, the mean of each bin. Up: the share of these effects that are there, with its 90 % interval. Where probabilities are right the points lie on the line. Both axes are in log odds.".to_owned(),
        }],
        tables: vec![
            table(
                "All effects of all sets, by the probability that they were given.",
                "reliability",
                vec![
                    "probability",
                    "effects",
                    "there",
                    "mean given",
                    "share there",
                    "the counts allow",
                ],
                rows.collect(),
            ),
            table(
                "By group. Of what was given 0.9 or more, and less than 0.1: how many are there. Named: of all effects that are there, by a right name. False names: of all names; of these, twins of what is there (delay and filter of one signal, drag and fan), and those that the answer itself calls open against what is there.",
                "reliability-groups",
                vec![
                    "group",
                    "sets",
                    "given 0.9 or more",
                    "given under 0.1",
                    "Brier score",
                    "named",
                    "false names",
                    "twins",
                    "open",
                ],
                groups.collect(),
            ),
        ],
        ..Section::default()
    }
}

/// Whether "at most" and "would have shown" hold, and how large what was named is.
pub(super) fn bounds(study: &Discovery) -> Section {
    let rows = groups(&study.answers).into_iter().map(|(name, of_group)| {
        cells([
            name,
            counted(of_group.falsely_ruled_out),
            counted(of_group.bounds_hold),
            counted(of_group.should_have_shown),
            counted(of_group.absent_ruled_out),
            number(of_group.bound_over_detectable, 2),
            counted(of_group.intervals_hold),
            percent_of(of_group.size_error),
            counted(of_group.false_none),
            counted(of_group.false_unexplained),
        ])
    });
    let of_effects = sizes(&study.answers).into_iter();
    let by_effect = of_effects.map(|of_effect| {
        cells([
            of_effect.effect.to_owned(),
            counted(of_effect.intervals_hold),
            percent_of(of_effect.error),
        ])
    });
    Section {
        heading: "Bounds".to_owned(),
        paragraphs: vec![SIZES.to_owned(), bounds_in_short(&study.calibration)],
        tables: vec![
            table(
                BOUNDS,
                "bounds",
                vec![
                    "group",
                    "falsely ruled out",
                    "bounds hold",
                    "should have shown",
                    "absent: ruled out",
                    "bound / detectable",
                    "intervals hold",
                    "size error",
                    "false \"none\"",
                    "false \"unexplained\"",
                ],
                rows.collect(),
            ),
            table(
                "Sizes of right names over all groups, by effect: how many 95 % intervals hold the truth, and the median error with its sign.",
                "sizes",
                vec!["effect", "intervals hold", "error"],
                by_effect.collect(),
            ),
        ],
        ..Section::default()
    }
}

/// What the intervals of the motor's parameters hold.
pub(super) fn parameters(study: &Discovery) -> Section {
    let by_group = named_groups(&study.answers);
    let all = ("all".to_owned(), study.coverage.clone());
    let by_group = by_group.into_iter().map(|name| {
        let own = study.answers.iter();
        let own: Vec<&Answer> = own.filter(|answer| answer.group.name() == name).collect();
        (name, coverage(&own))
    });
    let by_group = by_group.chain([all]).map(|(name, coverage)| {
        let held = coverage.iter().map(|own| counted(own.hold));
        let row = std::iter::once(name).chain(held);
        row.map(Cell::text).collect()
    });
    let mut head = vec!["group"];
    head.extend(study.coverage.iter().map(|own| own.parameter.key()));
    Section {
        heading: "Intervals of the motor's parameters".to_owned(),
        paragraphs: vec![PARAMETERS.to_owned()],
        tables: vec![
            table(
                "95 % intervals that hold the truth.",
                "coverage",
                head,
                by_group.collect(),
            ),
            intervals("All groups together", "parameters", &study.coverage),
        ],
        ..Section::default()
    }
}

/// What the intervals of some machines' parameters are worth.
pub(super) fn intervals(whose: &str, id: &str, coverage: &[Coverage]) -> (String, NamedTable) {
    let of_one = |own: &Coverage| {
        cells([
            own.parameter.key().to_owned(),
            counted(own.hold),
            number(own.spread, 2),
            number(own.error_percent, 2),
            number(own.std_percent, 2),
            none_as_dot(own.not_settled),
        ])
    };
    table(
        &format!(
            "{whose}: 95 % intervals that hold the truth, root mean square of the errors in their standard deviations (1 where intervals are right), medians of the error and of its standard deviation in %, and machines on which the parameter was not settled."
        ),
        id,
        vec![
            "parameter",
            "intervals hold",
            "spread",
            "error",
            "std",
            "not settled",
        ],
        coverage.iter().map(of_one).collect(),
    )
}

const PARAMETERS: &str = "R, L, Ke, J and Mc of the model with all named effects beside what each machine was made of, as far as they were called settled. Where an effect changes a parameter (a winding that warms, a field that drifts, iron that saturates) the truth is that at the beginning, cold, at rest and without current. Machines with something in no catalogue and answers with a wrong name are counted too.";
const WEIGHED: &str = "In every set every effect of the catalogue is given a probability that it is there, beside all others that may be. Here each is held against what is so: what was hidden, and what a background is made of. Of a shape that lies between two names both count as there; a wave under the right name with another number of cogs counts as not there. The effects of one set depend on each other, so that the intervals, which count them as independent, are somewhat too narrow. How common an effect is here was chosen with the study, while the diagnosis takes each for there in one machine of ten beforehand: bins in the middle say as much of that choice as of the diagnosis.";
const SIZES: &str = "A size needs a condition at which the emulator's form and the catalogue's are held against each other. Drag, fan and direction-dependent drag: their torque at half the rated speed, divided by that of the catalogue's form. Friction near standstill: the same at half the speed at which it falls. A drifting field: its change six seconds after the start. All others: what the key says (a saturation at rated current, a resistance at the beginning, a delay, an offset, the first harmonic of a wave). Effects of the same name in one machine add up, but for waves of different order, of which the largest counts. The natural frequency of an elastic coupling is no size.";
const BOUNDS: &str = "Falsely ruled out: of all effects that are there, those called ruled out with a bound below 0.8 of their size. Bounds hold: \"at most\" of effects that are there and were not named. Should have shown: of all effects that are there, those that were not named although they are larger than what was said to show. Absent, ruled out: of all effects that are not there, not named, and that the runs excite. Bound / detectable: their median; a bound that claims little is easily right. Intervals hold: of the sizes of right names, those whose 95 % interval holds the truth. Size error: its median. False \"none\": that nothing is missing, where something is that the runs excite. False \"unexplained\": where all that is hidden is the catalogue's and there is no background.";

pub(super) fn in_short(all: &Calibration) -> String {
    format!(
        "Of effects that were given 0.9 or more {} are there, of those that were given less than 0.1 {}. Brier score {} (0 is a probability of 0 or 1 that is always right; who says of every effect how common it is here gets {}).",
        counted(at_least(all, SUPPORTED)),
        counted(below(all, POSSIBLE)),
        number(all.brier, 2),
        number(indifferent(all), 2)
    )
}

/// Brier score of the answer that gives every effect the share of effects that are there.
fn indifferent(all: &Calibration) -> Option<f64> {
    let whole = below(all, f64::INFINITY);
    let share = whole.count as f64 / whole.of as f64;
    (whole.of > 0).then_some(share * (1.0 - share))
}

/// Which of the given probabilities the counts contradict.
fn beside_what_is_so(all: &Calibration) -> String {
    let contradicted = all.bins.iter().filter_map(|bin| {
        let mean = 100.0 * bin.mean?;
        let side = if mean < bin.there.lower_percent {
            "too low"
        } else if mean > bin.there.upper_percent {
            "too high"
        } else {
            return None;
        };
        let range = range(bin);
        Some(format!(
            "{range} ({side}: {} % given, {} there)",
            fixed(mean, 1),
            share(bin.there)
        ))
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
    let said: Vec<String> = (parts.iter())
        .filter(|(count, _)| *count > 0)
        .map(|(count, what)| format!("{what} {count}"))
        .collect();
    let there = all.recalled.of;
    match there - all.recalled.count {
        0 => format!("All {there} effects that are there were named."),
        unnamed => format!(
            "Of {there} effects that are there {unnamed} went unnamed: {}.",
            said.join(", ")
        ),
    }
}

fn bounds_in_short(all: &Calibration) -> String {
    format!(
        "Of effects that are there {} were called ruled out with a bound below 0.8 of their size. \"At most\" holds for {} effects that are there and were not named; {} were said to show at their size and were not named. Of effects that are absent {} were ruled out. The 95 % intervals of sizes hold {}.",
        counted(all.falsely_ruled_out),
        counted(all.bounds_hold),
        counted(all.should_have_shown),
        counted(all.absent_ruled_out),
        counted(all.intervals_hold)
    )
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
    ReliabilityChart {
        title: "share of effects that are there".to_owned(),
        across: "probability that was given".to_owned(),
        claims: claims.collect(),
    }
    .svg("How often effects are there, over the probability that they were given")
}

/// The groups in the order in which they come, and all together.
fn named_groups(answers: &[Answer]) -> Vec<String> {
    let mut names: Vec<String> = Vec::new();
    for answer in answers {
        let name = answer.group.name();
        if !names.contains(&name) {
            names.push(name);
        }
    }
    names
}

fn groups(answers: &[Answer]) -> Vec<(String, Calibration)> {
    let names = named_groups(answers);
    let of = |name: &String| {
        Calibration::of(answers.iter().filter(|answer| answer.group.name() == *name))
    };
    let mut all: Vec<(String, Calibration)> =
        names.iter().map(|name| (name.clone(), of(name))).collect();
    all.push(("all".to_owned(), Calibration::of(answers)));
    all
}

fn together<'a>(bins: impl Iterator<Item = &'a Bin>) -> Bounded {
    let (there, of) = bins.fold((0, 0), |(there, of), bin| {
        (there + bin.there.count, of + bin.there.of)
    });
    Bounded::new(there, of)
}

fn at_least(calibration: &Calibration, from: f64) -> Bounded {
    together(calibration.bins.iter().filter(|bin| bin.from >= from))
}

fn below(calibration: &Calibration, to: f64) -> Bounded {
    together(calibration.bins.iter().filter(|bin| bin.to <= to))
}

fn range(bin: &Bin) -> String {
    format!("{} to {}", bin.from, bin.to)
}

/// `93 of 96 (96.9 %)`.
fn counted(share: Bounded) -> String {
    if share.of == 0 {
        return "-".to_owned();
    }
    let percent = 100.0 * share.count as f64 / share.of as f64;
    format!("{} of {} ({} %)", share.count, share.of, fixed(percent, 1))
}

fn share(bounded: Bounded) -> String {
    if bounded.of == 0 {
        return "-".to_owned();
    }
    let percent = 100.0 * bounded.count as f64 / bounded.of as f64;
    format!("{} %", fixed(percent, 1))
}

fn allowed(bounded: Bounded) -> String {
    if bounded.of == 0 {
        return "-".to_owned();
    }
    format!(
        "{} to {} %",
        fixed(bounded.lower_percent, 1),
        fixed(bounded.upper_percent, 1)
    )
}

fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(|| "-".to_owned(), |value| significant(value, digits))
}

fn percent_of(value: Option<f64>) -> String {
    value.map_or_else(
        || "-".to_owned(),
        |value| format!("{} %", significant(100.0 * value, 2)),
    )
}

fn none_as_dot(count: usize) -> String {
    match count {
        0 => ".".to_owned(),
        count => count.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnosis::DiagnosisVerdict;
    use crate::workflow::reproduce::discovery::calibration::by_hand::{absent, answer, named};
    use crate::workflow::reproduce::discovery::{Finding, Group, matrix};

    fn study(answers: Vec<Answer>) -> Discovery {
        Discovery {
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
        let effect = DiagnosisVerdict::Effect;
        vec![
            answer(Group::Single, effect, findings()),
            answer(Group::Harsh, effect, findings()),
        ]
    }

    /// What is there is called ruled out at a fifth of its size, and its twin is named with certainty.
    fn bad() -> Answer {
        let findings = vec![
            Finding {
                named: false,
                size: None,
                interval_95: None,
                twin: true,
                ..named("viscous_friction", 0.001)
            },
            Finding {
                named: true,
                twin: true,
                ..absent("quadratic_load", 1.0)
            },
        ];
        answer(Group::Single, DiagnosisVerdict::Effect, findings)
    }

    fn text(study: &Discovery) -> String {
        let sections = [probabilities(study), bounds(study)];
        let paragraphs = sections.iter().flat_map(|section| &section.paragraphs);
        paragraphs.cloned().collect::<Vec<_>>().join("\n")
    }

    #[test]
    fn sentences_follow_the_figures() {
        let fine = text(&study(good()));
        assert!(fine.contains("The counts contradict the probabilities in no bin."));
        assert!(fine.contains("All 2 effects that are there were named."));
        assert!(fine.contains("0 of 2 (0.0 %) were called ruled out"));
        let worse = text(&study(good().into_iter().chain([bad()]).collect()));
        assert!(worse.contains("0 to 0.02 (too low:") && worse.contains("0.98 to 1 (too high:"));
        assert!(worse.contains("Of 3 effects that are there 1 went unnamed: its twin named 1."));
        assert!(worse.contains("1 of 3 (33.3 %) were called ruled out"));
        assert!(worse.contains("\"At most\" holds for 0 of 1 (0.0 %)"));
    }

    #[test]
    fn the_page_says_it_in_tables_and_a_picture() {
        let lossy = Answer {
            group: Group::Lossy,
            ..bad()
        };
        let study = study(good().into_iter().chain([bad(), lossy]).collect());
        insta::assert_snapshot!(study.report().text());
        let files = study.report().files();
        let svg = files.iter().find(|(name, _)| name == "reliability.svg");
        assert!(svg.is_some_and(|(_, svg)| svg.matches("class=\"knot\"").count() == 2));
    }
}
