//! The sets of the study: what is hidden and how large (drawn evenly, about 3 to 15 % of what the motor is rated for), how it
//! is excited, which names are right. The emulator's effects define their sizes.

use drivebench::tabulated;
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

use super::Size;
use super::classes::{CLASSES, Class};
use super::record::LATE_SPEED;
use drivebench::emulator::truth::effect::HiddenEffect;
use drivebench::numerics::checksum::{EMPTY, fnv_1a};
use drivebench::plant::{ParameterSpec, effect};

/// Levels of unmodelled background, as multiples of the emulator's `messy`; level 0 is the single effects themselves.
const BACKGROUND_LEVELS: [f64; 3] = [0.5, 1.0, 2.0];
/// Nulls in each excitation for each set of a cell: false alarms are rare, so they need counting.
const NULLS_PER_SET: u64 = 6;
/// Machines with nothing but the small effects, in each excitation for each set of a cell.
const SMALL_PER_SET: u64 = 24;
/// Machines with one effect, and with nothing hidden, for each set of a class.
const OF_CLASS: [u64; 2] = [12, 4];
/// The harder groups use a rich run, a plain one and a slow one; two effects at once the
/// first two, one among small ones of the first.
const HARD: [Excitation; 3] = [Excitation::Rich, Excitation::Steps, Excitation::Rich100Hz];
/// Length of each run, s.
const SECONDS: f64 = 12.0;

/// The class in tables of machines in which nothing is hidden.
pub const NOTHING: &str = "nothing";

tabulated! {
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
    #[serde(rename_all = "snake_case")]
    pub enum Excitation {
        Rich = "rich",
        Steps = "steps",
        Unipolar = "unipolar",
        Prbs = "prbs",
        Ramp = "ramp",
        /// The rich sequence over a serial link.
        Rich100Hz = "rich 100 Hz",
    }
    pub const fn name(self) -> &'static str;
}

impl Excitation {
    pub const fn description(self) -> &'static str {
        match self {
            Self::Rich => {
                "the default sequence: steps with dither, ramp, five levels at random, slow sine; 1 kHz"
            }
            Self::Steps => "random levels of both signs up to 105 V, held for 0.45 s; 1 kHz",
            Self::Unipolar => "the same with positive levels only, the shaft never reverses; 1 kHz",
            Self::Prbs => "nine levels up to 85 V at random, changing every 80 ms; 1 kHz",
            Self::Ramp => "slow ramps through the full range, nothing quick; 1 kHz",
            Self::Rich100Hz => {
                "the default sequence at 100 Hz, every poll up to 3 ms late and stamped"
            }
        }
    }
}

/// What a set tests.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
#[serde(rename_all = "snake_case", tag = "group")]
pub enum Group {
    /// One effect of the catalogue.
    #[default]
    Single,
    /// Nothing is hidden.
    Null,
    /// Something that no catalogue has.
    Unknown,
    /// An effect in a shape other than the textbook's.
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
    /// A machine of another class: one effect, or nothing.
    Class {
        class: &'static Class,
    },
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
            Self::Class { class } => class.name.to_owned(),
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

#[derive(Clone, Debug)]
pub struct Case {
    pub group: Group,
    pub excitation: Excitation,
    /// The emulator's ids of what is hidden.
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
        let late = match group {
            Group::Class { class } => class.late().map(|_| LATE_SPEED.to_vec()),
            _ => None,
        };
        let right = match group {
            Group::Small => BACKGROUND.iter().map(|id| vec![*id]).collect(),
            _ => (hidden.iter().map(|id| right_names(id)))
                .filter(|names| !names.is_empty())
                .chain(late)
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

    /// The class of its motor, where that is not the reference.
    pub(super) const fn motor_class(&self) -> Option<&'static Class> {
        match self.group {
            Group::Class { class } => Some(class),
            _ => None,
        }
    }

    pub(super) fn period_s(&self) -> f64 {
        self.motor_class().map_or_else(|| self.excitation.period_s(), |class| class.period_s)
    }

    /// The class in tables: the emulator's ids of what is hidden.
    pub fn class(&self) -> String {
        if self.group == Group::Small {
            BACKGROUND.join(" + ")
        } else if self.hidden.is_empty() {
            NOTHING.to_owned()
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
    fnv_1a(EMPTY, bytes)
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
    add(Group::Pair, &HARD[..2], &pairs, sets);
    for level in BACKGROUND_LEVELS {
        add(Group::Background { level }, &HARD[..1], &known, sets);
    }
    for excitation in HARD {
        for group in [Group::Harsh, Group::Noisy, Group::Lossy] {
            add(group, &[excitation], &known, sets);
        }
        add(Group::Small, &[excitation], &nothing, SMALL_PER_SET * sets);
        add(Group::Lossy, &[excitation], &nothing, nulls);
    }
    // Every effect in turn, over the classes.
    let [one, none] = OF_CLASS.map(|each| each * sets);
    let mut in_turn = (0_u64..).flat_map(|round| known.iter().map(move |hidden| (round, hidden)));
    for class in &CLASSES {
        let group = Group::Class { class };
        let case =
            |set, hidden: &[&'static str]| Case::new(group, class.excitation, hidden, set, size);
        cases.extend((0..one).zip(&mut in_turn).map(|(_, (round, hidden))| case(round, hidden)));
        cases.extend((0..none).map(|set| case(set, &[])));
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

/// Ids of what the host's catalogue has too: every one is a class of the study.
pub(super) fn known() -> Vec<&'static str> {
    studied(|id, names| names.contains(&id))
}

/// Ids of what no catalogue of the host has: nothing known explains it.
pub(super) fn unknown() -> Vec<&'static str> {
    studied(|_, names| names.is_empty())
}

/// Ids of known effects in a shape that the catalogue does not have.
pub(super) fn wrong_form() -> Vec<&'static str> {
    studied(|id, names| !names.is_empty() && !names.contains(&id))
}

fn studied(is: impl Fn(&str, &[&str]) -> bool) -> Vec<&'static str> {
    let all = HiddenEffect::studied();
    all.filter(|(id, names)| is(id, names)).map(|(id, _)| id).collect()
}

/// The names that are right for what the emulator calls `id`; none for what no catalogue has.
pub(super) fn right_names(id: &str) -> Vec<&'static str> {
    let mut all = HiddenEffect::studied();
    all.find(|(other, _)| *other == id).map_or(vec![], |(_, names)| names.to_vec())
}

/// Two at once.
pub(super) const PAIRS: &[[&str; 2]] = &[
    ["viscous_friction", "voltage_drop"],
    ["cogging", "stribeck_friction"],
    ["quadratic_load", "supply_sag"],
    ["elastic_coupling", "voltage_drop"],
    ["current_offset", "viscous_friction"],
    ["command_delay", "quadratic_load"],
    ["eccentric_load", "winding_heating"],
    ["constant_load", "stribeck_friction"],
];

/// What the emulator's `messy` background is made of: naming one of these there is no mistake.
pub(super) const BACKGROUND: &[&str] =
    &["viscous_friction", "cogging", "command_delay", "supply_sag"];

/// The effect drawn at random, as in an emulator's configuration; what gives it its size is multiplied by `share`. `None`
/// for an id that the study does not hide.
pub(super) fn drawn(id: &str, share: f64, rng: &mut ChaCha8Rng) -> Option<HiddenEffect> {
    let specs = effect::find(id).map_or(&[][..], |effect| effect.parameters());
    let is_size = |key: &str| {
        let mut sizes = specs.iter().filter(|spec| ParameterSpec::is_coefficient(spec));
        sizes.any(|spec| spec.key == key)
    };
    HiddenEffect::study(id, |key| if is_size(key) { share } else { 1.0 }, rng)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    /// The published scores are those of these machines: the order in which sizes are drawn must not change.
    #[test]
    fn the_machines_of_the_published_seeds_stay_as_they_are() {
        let ids = [known(), unknown(), wrong_form()].concat();
        let mut hash = 0xcbf2_9ce4_8422_2325_u64;
        for seed in 1..=200 {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            for id in &ids {
                let table = toml::Table::try_from(drawn(id, 0.7, &mut rng).unwrap()).unwrap();
                for byte in table.to_string().bytes() {
                    hash = (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
                }
            }
        }
        assert_eq!(hash, 0x8b70_e17e_11aa_ad97);
    }
}
