//! The study of the diagnosis on the page: what was asked, what was answered, what may be claimed.

use std::fmt::Write as _;

use super::{calibration, number, or_dash};
use crate::report::reproduce::{Column, Reproduction, Section};
use crate::text::number::{fixed, significant};
use crate::workflow::reproduce::lines::LineStudy;
use crate::workflow::reproduce::study::{
    Answer, Bounded, Excitation, Group, Matrix, MysteryAnswer, Outcome, ParameterFinding, Study,
    Tally, coverage_of, distinct, median_errors,
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
                calibration::probabilities(self),
                calibration::bounds(self),
                calibration::parameters(self),
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
            calibration::in_short(&self.calibration),
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

const REAL: &str = "Records that others have published, each diagnosed from one run, whose last part is held out, and from the model of its publishers. Nobody knows the whole truth of these machines: what is said of them stands here as it was printed. Errors are in units of the floor of each record.";

fn what_is_claimed() -> Section {
    Section::new("What is claimed, and what is not")
        .say("Claimed: on machines like these, excited like these, with sensors like these, the diagnosis gives the answers counted below. A count of no wrong names does not mean that there are none: the bound beside it says how many the count still allows.")
        .say("A name is an equation, not a cause. \"Behaves like viscous friction\" covers grease, iron loss and eddy currents alike; direction-dependent Coulomb friction and a constant load torque are the same equation below breakaway and count as one. The card of each effect (`drivebench effects ID`) lists the causes and how to tell them apart on the machine.")
        .say("Not claimed: that a real bench gives the first table. All data here are simulated. The emulator's effects have other mathematical forms than the catalogue's (a bristle for the Stribeck curve, a shear-thinning fluid for the drag, two thermal bodies for the winding, ...), and its integrator, its friction logic and its sensors are other code than the model's, but both were written by people who read the same books. There is no commutation, no PWM ripple, no temperature of the magnets, one class of motor, and white sensor noise. On a real machine several small effects are always there: look at the table of backgrounds, and record a repeated run and a confirming run.")
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
    let section = calibration::intervals(
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
