//! Calibration on the page: what probabilities, bounds and sizes are worth.

use super::study::none_as_dot;
use super::{number, or_dash};
use crate::report::plot::{Claims, reliability};
use crate::report::reproduce::Section;
use crate::text::number::{fixed, significant};
use crate::workflow::reproduce::study::{
    Answer, Bin, Bounded, Calibration, Coverage, Study, coverage, distinct, sizes,
};

/// Probabilities from which on an effect is called supported, and below which ruled out.
const SUPPORTED: f64 = 0.9;
const POSSIBLE: f64 = 0.1;

/// How often what was called likely is there.
pub(super) fn probabilities(study: &Study) -> Section {
    let all = &study.calibration;
    Section::new("How far the probabilities can be believed")
        .say(WEIGHED)
        .say(in_short(all))
        .say(beside_what_is_so(all))
        .say(missed(all))
        .picture("reliability", chart(all), "Across: the probability that was given, the mean of each bin. Up: the share of these effects that are there, with its 90 % interval. Where probabilities are right the points lie on the line. Both axes are in log odds.")
        .table(
            "reliability",
            "All effects of all sets, by the probability that they were given.",
            &all.bins,
            &[
                ("probability", &|bin| range(bin)),
                ("effects", &|bin| bin.there.of.to_string()),
                ("there", &|bin| bin.there.count.to_string()),
                ("mean given", &|bin| number(bin.mean, 3)),
                ("share there", &|bin| share(bin.there)),
                ("the counts allow", &|bin| allowed(bin.there)),
            ],
        )
        .table(
            "reliability-groups",
            "By group. Of what was given 0.9 or more, and less than 0.1: how many are there. Named: of all effects that are there, by a right name. False names: of all names; of these, twins of what is there (delay and filter of one signal, drag and fan), and those that the answer itself calls open against what is there.",
            groups(&study.answers),
            &[
                ("group", &|(name, _)| name.clone()),
                ("sets", &|(_, all)| all.sets.to_string()),
                ("given 0.9 or more", &|(_, all)| counted(at_least(all, SUPPORTED))),
                ("given under 0.1", &|(_, all)| counted(below(all, POSSIBLE))),
                ("Brier score", &|(_, all)| number(all.brier, 2)),
                ("named", &|(_, all)| counted(all.recalled)),
                ("false names", &|(_, all)| counted(all.false_names)),
                ("twins", &|(_, all)| none_as_dot(all.false_twins)),
                ("open", &|(_, all)| none_as_dot(all.false_but_open)),
            ],
        )
}

/// Whether "at most" and "would have shown" hold, and how large what was named is.
pub(super) fn bounds(study: &Study) -> Section {
    Section::new("Bounds")
        .say(SIZES)
        .say(bounds_in_short(&study.calibration))
        .table(
            "bounds",
            BOUNDS,
            groups(&study.answers),
            &[
                ("group", &|(name, _)| name.clone()),
                ("falsely ruled out", &|(_, all)| counted(all.falsely_ruled_out)),
                ("bounds hold", &|(_, all)| counted(all.bounds_hold)),
                ("should have shown", &|(_, all)| counted(all.should_have_shown)),
                ("absent: ruled out", &|(_, all)| counted(all.absent_ruled_out)),
                ("bound / detectable", &|(_, all)| number(all.bound_over_detectable, 2)),
                ("intervals hold", &|(_, all)| counted(all.intervals_hold)),
                ("size error", &|(_, all)| percent_of(all.size_error)),
                ("false \"none\"", &|(_, all)| counted(all.false_none)),
                ("false \"unexplained\"", &|(_, all)| counted(all.false_unexplained)),
            ],
        )
        .table(
            "sizes",
            "Sizes of right names over all groups, by effect: how many 95 % intervals hold the truth, and the median error with its sign.",
            sizes(&study.answers),
            &[
                ("effect", &|own| own.effect.to_owned()),
                ("intervals hold", &|own| counted(own.intervals_hold)),
                ("error", &|own| percent_of(own.error)),
            ],
        )
}

/// What the intervals of the motor's parameters hold.
pub(super) fn parameters(study: &Study) -> Section {
    let of_group = |name: String| {
        let is_own = |answer: &&Answer| answer.group.name() == name;
        let own: Vec<&Answer> = study.answers.iter().filter(is_own).collect();
        (name, coverage(&own))
    };
    let by_group = named_groups(&study.answers).into_iter().map(of_group);
    let by_group = by_group.chain([("all".to_owned(), study.coverage.clone())]);
    let by_group = by_group.map(|(name, coverage)| {
        let held = coverage.iter().map(|own| counted(own.hold));
        std::iter::once(name).chain(held).collect()
    });
    let mut head = vec!["group"];
    head.extend(study.coverage.iter().map(|own| own.parameter.key()));
    let section = Section::new("Intervals of the motor's parameters").say(PARAMETERS);
    let section = section.grid(
        "coverage",
        "95 % intervals that hold the truth.",
        head,
        by_group,
    );
    intervals(
        section,
        "All groups together",
        "parameters",
        &study.coverage,
    )
}

/// What the intervals of some machines' parameters are worth.
pub(super) fn intervals(
    section: Section,
    whose: &str,
    name: &str,
    coverage: &[Coverage],
) -> Section {
    section.table(
        name,
        format!(
            "{whose}: 95 % intervals that hold the truth, root mean square of the errors in their standard deviations (1 where intervals are right), medians of the error and of its standard deviation in %, and machines on which the parameter was not settled."
        ),
        coverage,
        &[
            ("parameter", &|own| own.parameter.key().to_owned()),
            ("intervals hold", &|own| counted(own.hold)),
            ("spread", &|own| number(own.spread, 2)),
            ("error", &|own| number(own.error_percent, 2)),
            ("std", &|own| number(own.std_percent, 2)),
            ("not settled", &|own| none_as_dot(own.not_settled)),
        ],
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
fn counted(all: Bounded) -> String {
    match all.of {
        0 => "-".to_owned(),
        of => format!("{} of {of} ({})", all.count, share(all)),
    }
}

fn share(all: Bounded) -> String {
    let percent = 100.0 * all.count as f64 / all.of as f64;
    or_dash((all.of > 0).then_some(percent), |percent| {
        format!("{} %", fixed(percent, 1))
    })
}

fn allowed(all: Bounded) -> String {
    let [lower, upper] = [all.lower_percent, all.upper_percent].map(|percent| fixed(percent, 1));
    or_dash((all.of > 0).then_some(()), |()| {
        format!("{lower} to {upper} %")
    })
}

fn percent_of(value: Option<f64>) -> String {
    or_dash(value, |value| {
        format!("{} %", significant(100.0 * value, 2))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnosis::DiagnosisVerdict;
    use crate::workflow::reproduce::study::calibration::by_hand::{absent, answer, missed, named};
    use crate::workflow::reproduce::study::{Group, matrix};

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

    fn text(study: &Study) -> String {
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
