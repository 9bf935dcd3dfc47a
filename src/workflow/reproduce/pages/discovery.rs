//! The study of the diagnosis on the page: what was asked, what was answered, what may be claimed.

use std::fmt::Write as _;

use super::{calibration, cells, mysteries};
use crate::report::page::{Cell, Table};
use crate::report::reproduce::{NamedTable, Reproduction, Section};
use crate::text::number::{fixed, significant};
use crate::workflow::reproduce::discovery::{
    Answer, Bounded, Discovery, Excitation, Group, Matrix, Outcome, Tally, median_errors,
};
use crate::workflow::reproduce::lines::LineStudy;

/// Heads of the columns of the matrix: numbers, which a row's label explains.
const NUMBERS: [&str; 40] = [
    "1", "2", "3", "4", "5", "6", "7", "8", "9", "10", "11", "12", "13", "14", "15", "16", "17",
    "18", "19", "20", "21", "22", "23", "24", "25", "26", "27", "28", "29", "30", "31", "32", "33",
    "34", "35", "36", "37", "38", "39", "40",
];

impl Discovery {
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
            sections.push(mysteries::section(&self.mysteries));
        }
        sections.extend(self.lines.as_ref().map(LineStudy::section));
        sections
    }

    fn of(&self, keep: impl Fn(&Answer) -> bool) -> Vec<&Answer> {
        self.answers.iter().filter(|answer| keep(answer)).collect()
    }

    fn in_short(&self) -> String {
        let mut text = self.in_virtual_time();
        text.extend(mysteries::in_short(&self.mysteries));
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

    fn by_excitation(&self) -> Section {
        let rows = Excitation::ALL.iter().filter_map(|excitation| {
            let answers =
                self.of(|a| a.group == Group::Single && a.excitation == excitation.name());
            (!answers.is_empty()).then(|| tally_row_of(excitation.name().to_owned(), &answers))
        });
        let mut paragraphs = vec![OUTCOMES.to_owned()];
        for excitation in Excitation::ALL {
            paragraphs.push(format!(
                "{}: {}.",
                excitation.name(),
                excitation.description()
            ));
        }
        Section {
            heading: "One hidden effect, by excitation".to_owned(),
            paragraphs,
            tables: vec![table(
                "Every effect of the catalogue in turn. Errors are medians on the hold-out, in units of the sensors' noise, before and after the named effects are added.",
                "excitations",
                tally_head("excitation"),
                rows.collect(),
            )],
            ..Section::default()
        }
    }

    fn by_effect(&self) -> Section {
        let mut classes: Vec<&str> = Vec::new();
        for answer in self.of(|a| a.group == Group::Single) {
            if !classes.contains(&answer.class.as_str()) {
                classes.push(&answer.class);
            }
        }
        let rows = classes.into_iter().map(|class| {
            let answers = self.of(|a| a.group == Group::Single && a.class == class);
            tally_row_of(class.to_owned(), &answers)
        });
        Section {
            heading: "One hidden effect, by effect".to_owned(),
            tables: vec![table(
                "The same sets, over all excitations.",
                "effects",
                tally_head("hidden"),
                rows.collect(),
            )],
            ..Section::default()
        }
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
            let count = |count: &usize| match count {
                0 => Cell::text("."),
                count => Cell::text(count.to_string()),
            };
            std::iter::once(Cell::text(label))
                .chain(counts.iter().map(count))
                .collect()
        });
        let mut legend = "Rows: what was hidden. Columns: the first name of the answer, by the numbers of the rows".to_owned();
        for (k, column) in columns.iter().enumerate() {
            if !rows.iter().any(|row| row == column) {
                let _ = write!(legend, "; {} {column}", k + 1);
            }
        }
        legend.push('.');
        Section {
            heading: "Who is taken for whom".to_owned(),
            tables: vec![table(&legend, "confusion", head, body.collect())],
            ..Section::default()
        }
    }

    /// A group beside the single effects, by what is hidden and by excitation.
    fn beside(&self, group: Group, name: &str, about: (&str, &str)) -> Section {
        let answers = self.of(|a| a.group == group);
        let mut classes: Vec<String> = Vec::new();
        for answer in &answers {
            let class = if group == Group::Null {
                answer.excitation.to_owned()
            } else {
                answer.class.clone()
            };
            if !classes.contains(&class) {
                classes.push(class);
            }
        }
        let rows = classes.into_iter().map(|class| {
            let of_class = answers
                .iter()
                .copied()
                .filter(|a| a.class == class || (group == Group::Null && a.excitation == class));
            let of_class: Vec<&Answer> = of_class.collect();
            tally_row_of(class, &of_class)
        });
        let mut rows: Vec<Vec<Cell>> = rows.collect();
        if rows.len() > 1 {
            rows.push(tally_row_of("all".to_owned(), &answers));
        }
        Section {
            heading: about.0.to_owned(),
            tables: vec![table(about.1, name, tally_head("hidden"), rows)],
            ..Section::default()
        }
    }

    fn background(&self) -> Section {
        let rich = Excitation::Rich.name();
        let mut rows = vec![tally_row_of(
            "0".to_owned(),
            &self.of(|a| a.group == Group::Single && a.excitation == rich),
        )];
        let mut levels: Vec<f64> = Vec::new();
        for answer in &self.answers {
            if let Group::Background { level } = answer.group
                && levels.last() != Some(&level)
            {
                levels.push(level);
            }
        }
        for level in levels {
            let answers = self.of(|a| a.group == Group::Background { level });
            rows.push(tally_row_of(format!("{level}"), &answers));
        }
        let harder = [Group::Harsh, Group::Small];
        let harder = harder.into_iter().flat_map(|group| {
            self.excitations_of(group).into_iter().map(move |name| {
                let answers = self.of(|a| a.group == group && a.excitation == name);
                tally_row_of(format!("{}, {name}", group.name()), &answers)
            })
        });
        Section {
            heading: "Backgrounds".to_owned(),
            paragraphs: vec![BACKGROUND.to_owned(), HARDER.to_owned()],
            tables: vec![
                table(
                    "One hidden effect each, every effect of the catalogue, excitation: rich.",
                    "background",
                    tally_head("level"),
                    rows,
                ),
                table(
                    "Harsh backgrounds, and backgrounds alone, by excitation.",
                    "harsh-background",
                    tally_head("group"),
                    harder.collect(),
                ),
            ],
            ..Section::default()
        }
    }

    /// Excitations of a group, in their order.
    fn excitations_of(&self, group: Group) -> Vec<&'static str> {
        let all = Excitation::ALL.iter().map(|excitation| excitation.name());
        all.filter(|name| {
            !self
                .of(|a| a.group == group && a.excitation == *name)
                .is_empty()
        })
        .collect()
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
                rows.push(tally_row_of(format!("{excitation}, {label}"), &answers));
            }
        }
        let [before, after] = [&plain, &harder].map(|all| Tally::of(all.iter().copied()));
        let compared = format!(
            "Of {} machines {} are right as they are and {} so; {} and {} are given a wrong name.",
            after.sets, before.right, after.right, before.wrong, after.wrong
        );
        Some(Section {
            heading: about.0.to_owned(),
            paragraphs: vec![about.1.to_owned(), compared],
            tables: vec![table(
                "By excitation.",
                name,
                tally_head("excitation"),
                rows,
            )],
            ..Section::default()
        })
    }

    fn real_machines(&self) -> Section {
        let error = |value: Option<f64>| {
            let known = value.map(|value| significant(value, 3));
            known.unwrap_or_else(|| "-".to_owned())
        };
        let rows = self.records.iter().map(|own| {
            cells([
                own.machine.to_owned(),
                own.source.to_owned(),
                error(own.holdout_before),
                error(own.holdout_after),
                own.sentence.clone(),
            ])
        });
        Section {
            heading: "Real machines".to_owned(),
            paragraphs: vec![REAL.to_owned()],
            tables: vec![table(
                "What each record shows.",
                "records",
                vec!["machine", "record", "error before", "after", "answer"],
                rows.collect(),
            )],
            ..Section::default()
        }
    }

    fn failures(&self) -> Section {
        let not_right = self.of(|a| matches!(a.outcome, Outcome::Wrong | Outcome::Failed));
        let rows = not_right.iter().map(|answer| {
            cells([
                answer.group.name(),
                answer.excitation.to_owned(),
                answer.class.clone(),
                answer.sentence.clone(),
            ])
        });
        let rows: Vec<Vec<Cell>> = rows.collect();
        Section {
            heading: "Every wrong name".to_owned(),
            paragraphs: if rows.is_empty() {
                vec!["There is none in this study.".to_owned()]
            } else {
                vec![]
            },
            tables: vec![table(
                "In the words of the diagnosis.",
                "wrong",
                vec!["group", "excitation", "hidden", "what was said"],
                rows,
            )],
            ..Section::default()
        }
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
    Section {
        heading: "What is claimed, and what is not".to_owned(),
        paragraphs: vec![
            "Claimed: on machines like these, excited like these, with sensors like these, the diagnosis gives the answers counted below. A count of no wrong names does not mean that there are none: the bound beside it says how many the count still allows.".to_owned(),
            "A name is an equation, not a cause. \"Behaves like viscous friction\" covers grease, iron loss and eddy currents alike; direction-dependent Coulomb friction and a constant load torque are the same equation below breakaway and count as one. The card of each effect (`drivebench effects ID`) lists the causes and how to tell them apart on the machine.".to_owned(),
            "Not claimed: that a real bench gives the first table. All data here are simulated. The emulator's effects have other mathematical forms than the catalogue's (a bristle for the Stribeck curve, a shear-thinning fluid for the drag, two thermal bodies for the winding, ...), and its integrator, its friction logic and its sensors are other code than the model's, but both were written by people who read the same books. There is no commutation, no PWM ripple, no temperature of the magnets, one class of motor, and white sensor noise. On a real machine several small effects are always there: look at the table of backgrounds, and record a repeated run and a confirming run.".to_owned(),
        ],
        ..Section::default()
    }
}

fn how_it_is_done() -> Section {
    Section {
        heading: "How it is done".to_owned(),
        paragraphs: vec![
            "Each set is a specimen of a 110 V, 5.7 A motor (R, L, Ke, J and Mc each within 15 % of the nameplate) with a hidden effect of drawn size, about 3 to 15 % of what the motor is rated for. The software drive is excited in virtual time, twice from rest and cold, with other seeds of excitation and noise: 12 s to fit and 12 s held out. Sensors: 0.15 rad/s and 30 mA of noise, steps of 1 r/min and 10 mA; the shaft angle is measured. The diagnosis starts from the nameplate, refits it, and gets nothing but the rows of the two runs.".to_owned(),
            "Everything follows from the seed: the same program with the same --sets and --seed writes this page to the bit.".to_owned(),
        ],
        ..Section::default()
    }
}

pub(super) fn table(
    sentence: &str,
    name: &str,
    head: Vec<&'static str>,
    rows: Vec<Vec<Cell>>,
) -> (String, NamedTable) {
    (
        sentence.to_owned(),
        NamedTable {
            name: name.to_owned(),
            table: Table { head, rows },
        },
    )
}

pub(super) fn tally_head(first: &'static str) -> Vec<&'static str> {
    vec![
        first,
        "sets",
        "right",
        "twin",
        "set",
        "partial",
        "not excited",
        "silent",
        "wrong",
        "at most",
        "failed",
        "error before",
        "after",
    ]
}

fn tally_row_of(label: String, answers: &[&Answer]) -> Vec<Cell> {
    let errors = answers.iter().filter_map(|answer| answer.errors());
    tally_row(
        label,
        Tally::of(answers.iter().copied()),
        median_errors(errors),
    )
}

pub(super) fn tally_row(label: String, tally: Tally, errors: Option<(f64, f64)>) -> Vec<Cell> {
    let error = |of: fn((f64, f64)) -> f64| {
        errors.map_or_else(|| "-".to_owned(), |e| significant(of(e), 3))
    };
    let count = |count: usize| match count {
        0 => ".".to_owned(),
        count => count.to_string(),
    };
    cells([
        label,
        tally.sets.to_string(),
        count(tally.right),
        count(tally.twin),
        count(tally.ambiguous),
        count(tally.partial),
        count(tally.not_excited),
        count(tally.abstained),
        count(tally.wrong),
        format!("{} %", fixed(tally.wrong_share().upper_percent, 1)),
        count(tally.failed),
        error(|(before, _)| before),
        error(|(_, after)| after),
    ])
}

fn percent(count: usize, of: usize) -> String {
    if of == 0 {
        "-".to_owned()
    } else {
        fixed(100.0 * count as f64 / of as f64, 0)
    }
}

fn at_most(share: Bounded) -> String {
    format!(
        "{} %, at most {} % with 95 % confidence",
        percent(share.count, share.of),
        fixed(share.upper_percent, 1)
    )
}
