//! The study of the diagnosis on the page: what was asked, what was answered, what may be claimed.

use std::fmt::Write as _;

use super::{number, or_dash};
use crate::report::plot::{Claims, reliability};
use crate::report::reproduce::{Column, Reproduction, Section};
use crate::text::number::{fixed, significant};
use crate::workflow::reproduce::lines::LineStudy;
use crate::workflow::reproduce::study::{
    Answer, Bin, Bounded, Calibration, Coverage, Excitation, Group, Matrix, MysteryAnswer, Outcome,
    ParameterFinding, Study, Tally, coverage, coverage_of, distinct, median_errors, sizes,
};

/// Heads of the columns of the matrix: numbers, which a row's label explains.
const NUMBERS: [&str; 40] = [
    "1", "2", "3", "4", "5", "6", "7", "8", "9", "10", "11", "12", "13", "14", "15", "16", "17",
    "18", "19", "20", "21", "22", "23", "24", "25", "26", "27", "28", "29", "30", "31", "32", "33",
    "34", "35", "36", "37", "38", "39", "40",
];

impl Study {
    /// The page, which as Markdown is `docs/validation.md`.
    pub fn report(&self) -> Reproduction {
        Reproduction {
            title: "How often the diagnosis is right".to_owned(),
            subtitle: format!(
                "Written by `drivebench reproduce discovery --sets {} --mysteries {} --seed {}`: {} machines with a known truth, each diagnosed from its recorded runs.",
                self.sets_in_each_cell,
                self.mysteries.len(),
                self.seed,
                self.answers.len() + self.mysteries.len()
            ),
            lead: ("In short".to_owned(), self.in_short()),
            sections: self.sections(),
        }
    }

    fn sections(&self) -> Vec<Section> {
        let mut sections = vec![what_is_claimed()];
        if !self.answers.is_empty() {
            sections.extend([
                how_it_is_done(),
                self.by_excitation(),
                self.by_effect(),
                self.confusion(),
                self.beside(Group::Null, "nulls", NULLS),
                self.beside(Group::Unknown, "unknown", UNKNOWN),
                self.beside(Group::WrongForm, "another-shape", ANOTHER_SHAPE),
                self.beside(Group::Pair, "pairs", PAIRS),
                probabilities(self),
                bounds(self),
                parameters(self),
                self.background(),
            ]);
            sections.extend(self.against_single(Group::Noisy, "noise", NOISE));
            sections.extend(self.against_single(Group::Lossy, "lost-rows", LOST_ROWS));
            sections.push(self.failures());
        }
        if !self.records.is_empty() {
            sections.push(self.real_machines());
        }
        if !self.mysteries.is_empty() {
            sections.push(mysteries(&self.mysteries));
        }
        sections.extend(self.lines.as_ref().map(LineStudy::section));
        sections
    }

    fn of(&self, keep: impl Fn(&Answer) -> bool) -> Vec<&Answer> {
        self.answers.iter().filter(|answer| keep(answer)).collect()
    }

    fn in_short(&self) -> String {
        let mut text = self.in_virtual_time();
        text.extend(mysteries_in_short(&self.mysteries));
        text.trim_start().to_owned()
    }

    fn in_virtual_time(&self) -> String {
        if self.answers.is_empty() {
            return String::new();
        }
        let single = Tally::of(self.of(|a| a.group == Group::Single));
        let null = Tally::of(self.of(|a| a.group == Group::Null));
        let right = Bounded::new(single.right, single.sets);
        format!(
            "Of {} machines with one hidden effect {} were named exactly ({} %; at least {} % with 95 % confidence), {} were given a wrong name ({}). Of {} machines with nothing hidden {} were given a name ({}). {}",
            single.sets,
            single.right,
            percent(single.right, single.sets),
            fixed(right.lower_percent, 0),
            single.wrong,
            at_most(single.wrong_share()),
            null.sets,
            null.wrong,
            at_most(null.wrong_share()),
            in_short(&self.calibration),
        )
    }

    /// Machines with one hidden effect, all or some of them.
    fn single(&self, keep: impl Fn(&Answer) -> bool) -> Vec<&Answer> {
        self.of(|answer| answer.group == Group::Single && keep(answer))
    }

    fn by_excitation(&self) -> Section {
        let rows = Excitation::ALL.iter().filter_map(|excitation| {
            let answers = self.single(|a| a.excitation == excitation.name());
            (!answers.is_empty()).then(|| tallied(excitation.name(), &answers))
        });
        let section = Section::new("One hidden effect, by excitation").say(OUTCOMES);
        let described = |section: Section, excitation: &Excitation| {
            let (name, description) = (excitation.name(), excitation.description());
            section.say(format!("{name}: {description}."))
        };
        Excitation::ALL.iter().fold(section, described).table(
            "excitations",
            "Every effect of the catalogue in turn. Errors are medians on the hold-out, in units of the sensors' noise, before and after the named effects are added.",
            rows,
            &tally_columns("excitation"),
        )
    }

    fn by_effect(&self) -> Section {
        let classes = distinct(self.single(|_| true).into_iter().map(|a| a.class.clone()));
        let rows = classes.into_iter().map(|class| {
            let answers = self.single(|a| a.class == class);
            tallied(class, &answers)
        });
        Section::new("One hidden effect, by effect").table(
            "effects",
            "The same sets, over all excitations.",
            rows,
            &tally_columns("hidden"),
        )
    }

    fn confusion(&self) -> Section {
        let Matrix {
            rows,
            columns,
            counts,
        } = &self.matrix;
        let mut head = vec!["hidden"];
        head.extend(NUMBERS.iter().take(columns.len()));
        let body = rows.iter().zip(counts).map(|(row, counts)| {
            let number = columns.iter().position(|column| column == row);
            let label = number.map_or_else(|| row.clone(), |k| format!("{} {row}", k + 1));
            let counts = counts.iter().map(|count| none_as_dot(*count));
            std::iter::once(label).chain(counts).collect()
        });
        let mut legend = "Rows: what was hidden. Columns: the first name of the answer, by the numbers of the rows".to_owned();
        for (k, column) in columns.iter().enumerate() {
            if !rows.iter().any(|row| row == column) {
                let _ = write!(legend, "; {} {column}", k + 1);
            }
        }
        legend.push('.');
        Section::new("Who is taken for whom").grid("confusion", legend, head, body)
    }

    /// A group beside the single effects, by what is hidden and by excitation.
    fn beside(&self, group: Group, name: &str, about: (&str, &str)) -> Section {
        let answers = self.of(|a| a.group == group);
        let class = |answer: &Answer| match group {
            Group::Null => answer.excitation.to_owned(),
            _ => answer.class.clone(),
        };
        let rows = distinct(answers.iter().map(|answer| class(answer))).into_iter();
        let of_class = |of: &String| self.of(|a| a.group == group && class(a) == *of);
        let mut rows: Vec<Tallied> = rows.map(|of| tallied(&of, &of_class(&of))).collect();
        if rows.len() > 1 {
            rows.push(tallied("all", &answers));
        }
        Section::new(about.0).table(name, about.1, rows, &tally_columns("hidden"))
    }

    fn background(&self) -> Section {
        let rich = Excitation::Rich.name();
        let mut rows = vec![tallied("0", &self.single(|a| a.excitation == rich))];
        let levels = self.answers.iter().filter_map(|answer| match answer.group {
            Group::Background { level } => Some(level),
            _ => None,
        });
        rows.extend(distinct(levels).into_iter().map(|level| {
            let answers = self.of(|a| a.group == Group::Background { level });
            tallied(level.to_string(), &answers)
        }));
        let harder = [Group::Harsh, Group::Small].into_iter().flat_map(|group| {
            self.excitations_of(group).into_iter().map(move |name| {
                let answers = self.of(|a| a.group == group && a.excitation == name);
                tallied(format!("{}, {name}", group.name()), &answers)
            })
        });
        Section::new("Backgrounds")
            .say(BACKGROUND)
            .say(HARDER)
            .table(
                "background",
                "One hidden effect each, every effect of the catalogue, excitation: rich.",
                rows,
                &tally_columns("level"),
            )
            .table(
                "harsh-background",
                "Harsh backgrounds, and backgrounds alone, by excitation.",
                harder,
                &tally_columns("group"),
            )
    }

    /// Excitations of a group, in their order.
    fn excitations_of(&self, group: Group) -> Vec<&'static str> {
        let has = |name: &&str| {
            let mut answers = self.answers.iter();
            answers.any(|a| a.group == group && a.excitation == *name)
        };
        let all = Excitation::ALL.iter().map(|excitation| excitation.name());
        all.filter(has).collect()
    }

    /// A group beside the machines that it shares with the single effects and the nulls, by excitation; none where the
    /// study has none.
    fn against_single(&self, group: Group, name: &str, about: (&str, &str)) -> Option<Section> {
        let harder = self.of(|a| a.group == group);
        if harder.is_empty() {
            return None;
        }
        let is_shared = |a: &Answer| harder.iter().any(|other| other.seed == a.seed);
        let plain = self.of(|a| matches!(a.group, Group::Single | Group::Null) && is_shared(a));
        let mut rows = Vec::new();
        for excitation in self.excitations_of(group) {
            for (answers, label) in [(&plain, "as they are"), (&harder, &*group.name())] {
                let answers = answers.iter().filter(|a| a.excitation == excitation);
                let answers: Vec<&Answer> = answers.copied().collect();
                rows.push(tallied(format!("{excitation}, {label}"), &answers));
            }
        }
        let [before, after] = [&plain, &harder].map(|all| Tally::of(all.iter().copied()));
        let compared = format!(
            "Of {} machines {} are right as they are and {} so; {} and {} are given a wrong name.",
            after.sets, before.right, after.right, before.wrong, after.wrong
        );
        let section = Section::new(about.0).say(about.1).say(compared);
        Some(section.table(name, "By excitation.", rows, &tally_columns("excitation")))
    }

    fn real_machines(&self) -> Section {
        Section::new("Real machines").say(REAL).table(
            "records",
            "What each record shows.",
            &self.records,
            &[
                ("machine", &|own| own.machine.to_owned()),
                ("record", &|own| own.source.to_owned()),
                ("error before", &|own| number(own.holdout_before, 3)),
                ("after", &|own| number(own.holdout_after, 3)),
                ("answer", &|own| own.sentence.clone()),
            ],
        )
    }

    fn failures(&self) -> Section {
        let not_right = self.of(|a| matches!(a.outcome, Outcome::Wrong | Outcome::Failed));
        let mut section = Section::new("Every wrong name");
        if not_right.is_empty() {
            section = section.say("There is none in this study.");
        }
        section.table(
            "wrong",
            "In the words of the diagnosis.",
            not_right,
            &[
                ("group", &|answer| answer.group.name()),
                ("excitation", &|answer| answer.excitation.to_owned()),
                ("hidden", &|answer| answer.class.clone()),
                ("what was said", &|answer| answer.sentence.clone()),
            ],
        )
    }
}

const OUTCOMES: &str = "right: every hidden effect is named and nothing else. twin: the delay for the filter of the same signal or the other way round, which only a quick dither tells apart; or a fan for the drag of a background. set: the answer is a list of effects that the run cannot tell apart, and the hidden one is on it. partial: a part of what is hidden is named. not excited: nothing is named, and the run is said not to show this effect. silent: nothing is named, for another reason. wrong: something is named that is not there; \"at most\" is the upper 95 % bound of Clopper and Pearson on its share (for none of n about 3/n).";
const NULLS: (&str, &str) = (
    "Nothing hidden: false alarms",
    "Machines that are exactly the five-parameter motor, with sensor noise. \"right\" is the answer that nothing is missing; \"wrong\" is any name.",
);
const UNKNOWN: (&str, &str) = (
    "What is in no catalogue",
    "A shaker on the frame, a resonance that takes up torque about one speed, a load that wanders at random. \"right\" is the answer that the error is there and nothing known explains it; \"wrong\" is any name.",
);
const ANOTHER_SHAPE: (&str, &str) = (
    "A known effect in another shape",
    "Exponential Stribeck curve, load that grows with speed to the power 1.5 (fan and drag are both right for it), contact drop that builds up slowly, cogging with 40 % second harmonic, load that comes on as a ramp. Over all excitations.",
);
const PAIRS: (&str, &str) = (
    "Two effects at once",
    "\"right\" only if both are named and nothing else. Excitations: rich and steps.",
);
const BACKGROUND: &str = "A real bench has a little of everything. Here each machine carries, besides its hidden effect: random torque (0.75 % of rated), viscous drag (1.5 % of rated torque at rated speed), cogging of order 7 (1.5 %), a command delay of 0.4 ms and 50 milliohm in the supply, all times the level. Naming one of these too is no mistake; naming only them counts as silent. This table, not the first one, is what to expect of a motor on a bench.";
const HARDER: &str = "Harsh: the background of level 1, the hidden effect at half its size, sensors three times as noisy. Small effects only: the background of level 1 with nothing else hidden; \"right\" only if all four are named.";
const NOISE: (&str, &str) = (
    "Three times the noise",
    "The machines of the first table, with 0.45 rad/s and 90 mA of noise instead of 0.15 rad/s and 30 mA.",
);
const LOST_ROWS: (&str, &str) = (
    "Lost rows",
    "The very runs of the first table and of the machines with nothing hidden, of which one row in ten was lost at random, command and sample, and all rows of 0.4 s at a random instant after the standstill.",
);

const REAL: &str = "Records that others have published, each diagnosed from one run, whose last part is held out, and from the model of its publishers. Nobody knows the whole truth of these machines: what is said of them stands here as it was printed. Errors are in units of the noise floor of each record, or where it has none of what its refitted baseline leaves.";

fn what_is_claimed() -> Section {
    Section::new("What is claimed, and what is not")
        .say("Claimed: on machines like these, excited like these, with sensors like these, the diagnosis gives the answers counted below. A count of no wrong names does not mean that there are none: the bound beside it says how many the count still allows.")
        .say("A name is an equation, not a cause. \"Behaves like viscous friction\" covers grease, iron loss and eddy currents alike; direction-dependent Coulomb friction and a constant load torque are the same equation below breakaway and count as one. The card of each effect (`drivebench effects ID`) lists the causes and how to tell them apart on the machine.")
        .say("Not claimed: that a real bench gives the first table. All data behind the counts are simulated. The emulator's effects have other mathematical forms than the catalogue's (a bristle for the Stribeck curve, a shear-thinning fluid for the drag, two thermal bodies for the winding, ...), and its integrator, its friction logic and its sensors are other code than the model's, but both were written by people who read the same books. There is no commutation, no PWM ripple, no temperature of the magnets, one class of motor, and white sensor noise. On a real machine several small effects are always there: look at the table of backgrounds, and record a repeated run and a confirming run.")
}

fn how_it_is_done() -> Section {
    Section::new("How it is done")
        .say("Each set is a specimen of a 110 V, 5.7 A motor (R, L, Ke, J and Mc each within 15 % of the nameplate) with a hidden effect of drawn size, about 3 to 15 % of what the motor is rated for. The software drive is excited in virtual time, twice from rest and cold, with other seeds of excitation and noise: 12 s to fit and 12 s held out. Sensors: 0.15 rad/s and 30 mA of noise, steps of 1 r/min and 10 mA; the shaft angle is measured. The diagnosis starts from the nameplate, refits it, and gets nothing but the rows of the two runs.")
        .say("Everything follows from the seed: the same program with the same --sets and --seed writes this page to the bit.")
}

/// Label, counts, median errors before and after.
type Tallied = (String, Tally, Option<(f64, f64)>);

fn tallied(label: impl Into<String>, answers: &[&Answer]) -> Tallied {
    let errors = answers.iter().filter_map(|answer| answer.errors());
    let tally = Tally::of(answers.iter().copied());
    (label.into(), tally, median_errors(errors))
}

fn tally_columns(first: &'static str) -> [Column<'static, Tallied>; 13] {
    [
        (first, &|row| row.0.clone()),
        ("sets", &|row| row.1.sets.to_string()),
        ("right", &|row| none_as_dot(row.1.right)),
        ("twin", &|row| none_as_dot(row.1.twin)),
        ("set", &|row| none_as_dot(row.1.ambiguous)),
        ("partial", &|row| none_as_dot(row.1.partial)),
        ("not excited", &|row| none_as_dot(row.1.not_excited)),
        ("silent", &|row| none_as_dot(row.1.abstained)),
        ("wrong", &|row| none_as_dot(row.1.wrong)),
        ("at most", &|row| {
            format!("{} %", fixed(row.1.wrong_share().upper_percent, 1))
        }),
        ("failed", &|row| none_as_dot(row.1.failed)),
        ("error before", &|row| number(row.2.map(|e| e.0), 3)),
        ("after", &|row| number(row.2.map(|e| e.1), 3)),
    ]
}

pub(super) fn none_as_dot(count: usize) -> String {
    match count {
        0 => ".".to_owned(),
        count => count.to_string(),
    }
}

fn percent(count: usize, of: usize) -> String {
    let share = 100.0 * count as f64 / of as f64;
    or_dash((of > 0).then_some(share), |share| fixed(share, 0))
}

fn at_most(share: Bounded) -> String {
    format!(
        "{} %, at most {} % with 95 % confidence",
        percent(share.count, share.of),
        fixed(share.upper_percent, 1)
    )
}

const HOW: &str = "Each seed draws what a software drive hides: one effect of the catalogue with a random size, sometimes nothing, sometimes an effect that no catalogue has. For each seed the program itself is started: `drivebench commission --headless --port sim: --mystery SEED --json` (checks, four runs at 100 Hz in virtual time, identification, diagnosis), and its answer is compared with the truth.";

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

/// One sentence on mysteries for the head of the page; none where no mystery was given.
fn mysteries_in_short(answers: &[MysteryAnswer]) -> Option<String> {
    let tally = Tally::of_outcomes(answers.iter().map(|answer| answer.outcome));
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
fn mysteries(answers: &[MysteryAnswer]) -> Section {
    let named = answers.iter().filter(|answer| !answer.effects.is_empty());
    let errors = named.filter_map(|answer| Some((answer.holdout_before?, answer.holdout_after?)));
    let tally = Tally::of_outcomes(answers.iter().map(|answer| answer.outcome));
    let counts = ("all".to_owned(), tally, median_errors(errors));
    let parameters = answers.iter().flat_map(|answer| &answer.parameters);
    let parameters: Vec<&ParameterFinding> = parameters.collect();
    let is_other = |answer: &&MysteryAnswer| answer.outcome != Outcome::Right;
    let others = answers.iter().filter(is_other);
    let section = Section::new("Mystery drives, through the whole program")
        .say(HOW)
        .table(
            "mysteries",
            "Counts. The errors are over the drives on which an effect was named.",
            [counts],
            &tally_columns("mysteries"),
        );
    let section = intervals(
        section,
        "Whatever was hidden and found",
        "mystery-parameters",
        &coverage_of(&parameters),
    );
    section
        .table(
            "mystery-confusion",
            "Who is taken for whom.",
            pairs(answers),
            &[
                ("hidden", &|pair| pair.0.to_owned()),
                ("answer", &|pair| pair.1.clone()),
                ("drives", &|pair| pair.2.to_string()),
            ],
        )
        .table(
            "mystery-drives",
            "Drives that were not simply answered rightly. Errors are held out, in units of the sensors' noise; of the sizes the largest error is given.",
            others,
            &[
                ("seed", &|answer| answer.seed.to_string()),
                ("hidden", &|answer| answer.hidden.clone()),
                ("answer", &|answer| match answer.outcome {
                    Outcome::Failed => without_paths(&answer.reason),
                    _ => answer.column(),
                }),
                ("", &|answer| answer.outcome.word().to_owned()),
                ("error before", &|answer| number(answer.holdout_before, 3)),
                ("after", &|answer| number(answer.holdout_after, 3)),
                ("size off by", &|answer| {
                    or_dash(answer.size_error_percent, |e| format!("{} %", significant(e, 2)))
                }),
            ],
        )
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

/// A reason without the paths of the machine on which it came about: the page is read elsewhere.
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
        assert!(svg.is_some_and(|(_, svg)| svg.matches("class=\"knot after\"").count() == 2));
    }
}
