//! The sets of the study: what is hidden, how it is excited, which names are right.

use serde::Serialize;

use super::Size;
use super::record::Excitation;
use super::sizes::{BACKGROUND, PAIRS, known, right_names, unknown, wrong_form};

/// Levels of unmodelled background, as multiples of the emulator's `messy`; level 0 is the single effects themselves.
const BACKGROUND_LEVELS: [f64; 3] = [0.5, 1.0, 2.0];
/// Nulls in each excitation for each set of a cell: false alarms are rare, so they need counting.
const NULLS_PER_SET: u64 = 6;
/// Machines with nothing but the small effects, in each excitation for each set of a cell.
const SMALL_PER_SET: u64 = 24;
/// What is hard in other ways than the effect itself is asked of a rich run, a plain one and a slow one.
const HARD: [Excitation; 3] = [Excitation::Rich, Excitation::Steps, Excitation::Rich100Hz];
/// Length of each run, s.
const SECONDS: f64 = 12.0;

/// What a set asks.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case", tag = "group")]
pub enum Group {
    /// One effect of the catalogue.
    Single,
    /// Nothing is hidden.
    Null,
    /// Something that no catalogue has.
    Unknown,
    /// An effect in another shape than anybody's textbook.
    WrongForm,
    Pair,
    /// One effect among small unmodelled ones.
    Background {
        level: f64,
    },
    /// The same at half the size, with sensors three times as noisy.
    Harsh,
    /// The small effects of a background, and nothing else that is known.
    Small,
    /// The machines of [`Self::Single`], with sensors three times as noisy.
    Noisy,
    /// The runs of [`Self::Single`] and [`Self::Null`], of which rows were lost.
    Lossy,
}

impl Group {
    pub fn name(self) -> String {
        match self {
            Self::Single => "one effect".to_owned(),
            Self::Null => "nothing hidden".to_owned(),
            Self::Unknown => "in no catalogue".to_owned(),
            Self::WrongForm => "another shape".to_owned(),
            Self::Pair => "two effects".to_owned(),
            Self::Background { level } => format!("background {level}"),
            Self::Harsh => "harsh background".to_owned(),
            Self::Small => "small effects only".to_owned(),
            Self::Noisy => "three times the noise".to_owned(),
            Self::Lossy => "lost rows".to_owned(),
        }
    }

    /// Scale of the emulator's `messy` in machines of this group.
    pub(super) const fn background(self) -> Option<f64> {
        match self {
            Self::Background { level } => Some(level),
            Self::Harsh | Self::Small => Some(1.0),
            _ => None,
        }
    }

    /// The group whose machines are drawn: a comparison is one of the same machines.
    const fn drawn_as(self, nothing_hidden: bool) -> Self {
        match self {
            Self::Noisy | Self::Lossy if nothing_hidden => Self::Null,
            Self::Noisy | Self::Lossy => Self::Single,
            other => other,
        }
    }
}

/// One set.
#[derive(Clone, Debug)]
pub struct Case {
    pub group: Group,
    pub excitation: Excitation,
    /// Ids of what is hidden, in the emulator's words.
    pub hidden: Vec<&'static str>,
    /// For each hidden effect the names that are right.
    pub right: Vec<Vec<&'static str>>,
    /// Draws motor, sizes, excitation and noise.
    pub seed: u64,
    /// Length of each run, s; that of the rich sequence is its own.
    pub seconds: f64,
}

impl Case {
    fn new(
        group: Group,
        excitation: Excitation,
        hidden: &[&'static str],
        set: u64,
        size: Size,
    ) -> Self {
        let right = match group {
            Group::Small => BACKGROUND.iter().map(|id| vec![*id]).collect(),
            _ => (hidden.iter().map(|id| right_names(id)))
                .filter(|names| !names.is_empty())
                .collect(),
        };
        let cell = format!(
            "{}/{}/{}",
            group.drawn_as(hidden.is_empty()).name(),
            excitation.name(),
            hidden.join("+")
        );
        Self {
            group,
            excitation,
            hidden: hidden.to_vec(),
            right,
            seed: seed_of(&cell, size.seed, set),
            seconds: SECONDS,
        }
    }

    /// The class in tables: what is hidden, in words of the emulator.
    pub fn class(&self) -> String {
        if self.group == Group::Small {
            BACKGROUND.join(" + ")
        } else if self.hidden.is_empty() {
            "nothing".to_owned()
        } else {
            self.hidden.join(" + ")
        }
    }
}

/// FNV-1a of the cell's name with the study's seed and the set's number behind it, one after the other: a cell keeps its
/// sets when others are added to the study, and studies of two seeds share none.
fn seed_of(cell: &str, seed: u64, set: u64) -> u64 {
    let numbers = seed.to_le_bytes().into_iter().chain(set.to_le_bytes());
    let bytes = cell.bytes().chain(numbers);
    bytes.fold(0xcbf2_9ce4_8422_2325, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
    })
}

/// Every set of the study, in the order of its tables.
pub(super) fn all(size: Size) -> Vec<Case> {
    if size.reduced {
        return reduced(size);
    }
    let each = |ids: Vec<&'static str>| ids.into_iter().map(|id| vec![id]).collect::<Vec<_>>();
    let known = each(known());
    let unknown = each(unknown());
    let other_shapes = each(wrong_form());
    let pairs: Vec<_> = PAIRS.iter().map(|pair| pair.to_vec()).collect();
    let nothing = [vec![]];
    let mut cases = Vec::new();
    let mut add = |group, excitations: &[Excitation], hidden: &[Vec<&'static str>], sets: u64| {
        for excitation in excitations {
            for hidden in hidden {
                let case = |set| Case::new(group, *excitation, hidden, set, size);
                cases.extend((0..sets).map(case));
            }
        }
    };
    let (sets, nulls) = (size.sets, NULLS_PER_SET * size.sets);
    add(Group::Single, &Excitation::ALL, &known, sets);
    add(Group::Null, &Excitation::ALL, &nothing, nulls);
    add(Group::Unknown, &Excitation::ALL, &unknown, sets);
    add(Group::WrongForm, &Excitation::ALL, &other_shapes, sets);
    add(
        Group::Pair,
        &[Excitation::Rich, Excitation::Steps],
        &pairs,
        sets,
    );
    for level in BACKGROUND_LEVELS {
        add(
            Group::Background { level },
            &[Excitation::Rich],
            &known,
            sets,
        );
    }
    for excitation in HARD {
        for group in [Group::Harsh, Group::Noisy, Group::Lossy] {
            add(group, &[excitation], &known, sets);
        }
        add(Group::Small, &[excitation], &nothing, SMALL_PER_SET * sets);
        add(Group::Lossy, &[excitation], &nothing, nulls);
    }
    cases
}

/// Ten sets: five effects, four nulls, one pair.
fn reduced(size: Size) -> Vec<Case> {
    let case = |group, hidden: &[&'static str], set| {
        Case::new(group, Excitation::Rich100Hz, hidden, set, size)
    };
    let single = [
        "viscous_friction",
        "quadratic_load",
        "stribeck_friction",
        "voltage_drop",
        "winding_heating",
    ];
    let mut cases: Vec<Case> = single.map(|id| case(Group::Single, &[id], 0)).into();
    cases.extend((0..4).map(|set| case(Group::Null, &[], set)));
    cases.push(case(Group::Pair, &PAIRS[0], 0));
    cases
}
