//! Which candidates belong together: those of one motor, of the first rank, with which both balances hold.
//!
//! `u = R i + L di/dt + Ke w` and `Kt i = J dw/dt + friction` hold in any unit, so that they tell columns and signs apart, but
//! not rad/s from r/min.

use std::cmp::Ordering;

use super::Confidence;
use super::source::{Source, Sources};
use drivebench_identify::sanity::{self, Balances};
use drivebench_model::sample::Channel;
use drivebench_model::text::number::{percent, significant};

/// What is left unexplained of both balances, up to which a choice explains the record.
const EXPLAINS: f64 = 0.35;
/// Candidates of one quantity that are tried.
const MOST_TRIED: usize = 6;

/// The chosen candidates.
#[derive(Debug, Default)]
pub(super) struct Chosen {
    pub sources: Vec<Source>,
    /// Of voltage, current and speed as they are chosen, signs included.
    pub balances: Option<Balances>,
}

impl Chosen {
    pub(super) fn get(&self, channels: &[Channel]) -> Option<&Source> {
        self.sources.iter().find(|source| channels.contains(&source.target))
    }

    pub(super) fn get_mut(&mut self, channel: Channel) -> Option<&mut Source> {
        self.sources.iter_mut().find(|source| source.target == channel)
    }
}

const VOLTAGES: [Channel; 2] = [Channel::Voltage, Channel::VoltageCmd];

struct Trial<'a> {
    picked: [Option<&'a Source>; 3],
    /// Pairs of columns that are of different motors.
    mixed: usize,
    rank: u32,
    balances: Option<Balances>,
}

impl Trial<'_> {
    /// What the balances leave unexplained; impossible coefficients come last.
    fn cost(&self) -> f64 {
        self.balances.map_or(1.0, |found| {
            if found.is_physical() { found.error() } else { 2.0 + found.error().min(1.0) }
        })
    }

    fn order(&self, other: &Self) -> Ordering {
        let count = |trial: &Self| trial.picked.iter().flatten().count();
        (count(other).cmp(&count(self)))
            .then(self.mixed.cmp(&other.mixed))
            .then(self.rank.cmp(&other.rank))
            .then(self.cost().total_cmp(&other.cost()))
    }

    fn columns(&self) -> Vec<usize> {
        self.picked.iter().flatten().flat_map(|source| source.columns.clone()).collect()
    }
}

/// Chooses voltage, current and speed together, then what else stands in the file.
pub(super) fn choose(time_s: &[f64], sources: &Sources, headers: &[String]) -> Chosen {
    let lists = [&sources.voltage, &sources.current, &sources.speed];
    let several = lists.iter().any(|list| list.len() > 1);
    let options = lists.map(|list| {
        let tried = list.iter().take(MOST_TRIED).map(Some);
        tried.chain([None]).collect::<Vec<_>>()
    });
    let mut trials = Vec::new();
    for voltage in &options[0] {
        for current in &options[1] {
            for speed in &options[2] {
                trials.extend(trial(time_s, [*voltage, *current, *speed]));
            }
        }
    }
    trials.sort_by(Trial::order);
    let Some(best) = trials.first() else { return Chosen::default() };
    let mut chosen = Chosen {
        sources: best.picked.iter().flatten().map(|source| (*source).clone()).collect(),
        balances: best.balances,
    };
    if several {
        compare_with_others(&mut chosen, &trials, headers);
    }
    settle_signs(time_s, &mut chosen);
    chosen.sources.extend(sources.torque.iter().min_by_key(|source| source.rank).cloned());
    chosen
}

fn trial<'a>(time_s: &[f64], picked: [Option<&'a Source>; 3]) -> Option<Trial<'a>> {
    let there: Vec<&Source> = picked.iter().flatten().copied().collect();
    let mut columns: Vec<usize> = there.iter().flat_map(|source| source.columns.clone()).collect();
    columns.sort_unstable();
    let count = columns.len();
    columns.dedup();
    if columns.len() < count {
        return None;
    }
    let mut mixed = 0;
    for (at, one) in there.iter().enumerate() {
        mixed += there[at + 1..].iter().filter(|other| other.words != one.words).count();
    }
    let balances = match picked {
        [Some(voltage), Some(current), Some(speed)] => {
            sanity::balances(time_s, [&voltage.values, &current.values, &speed.values])
        }
        _ => None,
    };
    let rank = there.iter().map(|source| u32::from(source.rank)).sum();
    Some(Trial { picked, mixed, rank, balances })
}

/// What the balances say of the other candidates of the same rank.
fn compare_with_others(chosen: &mut Chosen, trials: &[Trial<'_>], headers: &[String]) {
    let (best, others) = (&trials[0], &trials[1..]);
    let count = best.picked.iter().flatten().count();
    let rivals = others
        .iter()
        .filter(|other| other.picked.iter().flatten().count() == count && other.rank == best.rank);
    for (place, own) in best.picked.iter().enumerate() {
        let Some(own) = own else { continue };
        // The same but for this one quantity.
        let rival = rivals.clone().find(|other| {
            let same = |at: usize| {
                let columns = |trial: &Trial<'_>| trial.picked[at].map(|it| it.columns.clone());
                columns(other) == columns(best)
            };
            (0..3).all(|at| same(at) != (at == place)) && other.mixed == best.mixed
        });
        let Some(rival) = rival else { continue };
        let Some(source) = chosen.sources.iter_mut().find(|it| it.columns == own.columns) else {
            continue;
        };
        let name = rival.picked[place].map_or_else(String::new, |other| {
            other
                .columns
                .iter()
                .map(|column| headers[*column].as_str())
                .collect::<Vec<_>>()
                .join("*")
        });
        let (cost, other) = (best.cost(), rival.cost());
        if cost < EXPLAINS && other > 2.0 * cost {
            source.reasons.push(format!(
                "with it both balances leave {} unexplained, with {name:?} {}",
                percent(100.0 * cost),
                if other < 2.0 { percent(100.0 * other) } else { "no possible motor".to_owned() }
            ));
            // The balances tell the columns of channels without names apart.
            if source.confidence == Confidence::Unsure && source.hole.is_none() {
                source.confidence = Confidence::Likely;
            }
        } else {
            source.doubts.push(format!("{name:?} may be it as well; the balances do not decide"));
            source.confidence = Confidence::Unsure;
        }
    }
    by_permutation(chosen, trials);
    // Another motor in the same file.
    let used = best.columns();
    let another = others.iter().find(|other| {
        other.picked.iter().flatten().count() == count
            && other.mixed == 0
            && best.mixed == 0
            && other.columns().iter().all(|column| !used.contains(column))
            && other.rank == best.rank
    });
    if let (Some(another), Some(first)) = (another, chosen.sources.first_mut()) {
        let names: Vec<&str> =
            another.columns().iter().map(|column| headers[*column].as_str()).collect();
        let names = names.join(", ");
        first.doubts.retain(|doubt| !doubt.contains("may be it as well"));
        first.doubts.push(format!("the file holds another motor too: {names}"));
        first.confidence = first.confidence.max(Confidence::Likely);
    }
}

/// Channels without names: whether the balances hold with one order of them only.
fn by_permutation(chosen: &mut Chosen, trials: &[Trial<'_>]) {
    let sorted = |trial: &Trial<'_>| {
        let mut columns = trial.columns();
        columns.sort_unstable();
        columns
    };
    let best = &trials[0];
    let mut orders = trials[1..].iter().filter(|other| sorted(other) == sorted(best));
    let Some(second) = orders.next() else { return };
    let (cost, other) = (best.cost(), second.cost());
    for source in &mut chosen.sources {
        if cost < EXPLAINS && other > 2.0 * cost {
            source.reasons.push(format!(
                "both balances hold in this order of the columns, and leave {} unexplained; the next best leaves {}",
                percent(100.0 * cost),
                if other < 2.0 { percent(100.0 * other) } else { "no possible motor".to_owned() }
            ));
            source.confidence = Confidence::Likely;
        } else {
            source.doubts.push("neither a name nor the balances decide which column it is".into());
        }
    }
}

/// Turns the column whose sign no motor has.
fn settle_signs(time_s: &[f64], chosen: &mut Chosen) {
    let place = |channels: &[Channel]| {
        chosen.sources.iter().position(|source| channels.contains(&source.target))
    };
    let (voltage, current) = (place(&VOLTAGES), place(&[Channel::Current]));
    let (Some(voltage), Some(current), Some(speed)) = (voltage, current, place(&[Channel::Speed]))
    else {
        return;
    };
    let Some(given) = chosen.balances else { return };
    let figures = |found: &Balances| {
        format!(
            "{} of the voltage and {} of the current unexplained",
            percent(100.0 * found.voltage_error),
            percent(100.0 * found.torque_error)
        )
    };
    if given.is_physical() {
        let reason = format!(
            "u = R i + L di/dt + Ke w holds with R {} and Ke {} in the units of the map and leaves {}",
            significant(given.resistance.value, 3),
            significant(given.back_emf.value, 3),
            figures(&given)
        );
        chosen.sources[voltage].reasons.push(reason);
        return;
    }
    let Some((key, value)) = given.impossible() else { return };
    for reversed in [current, speed, voltage] {
        chosen.sources[reversed].reverse();
        let values = |place: usize| chosen.sources[place].values.as_slice();
        let found = sanity::balances(time_s, [values(voltage), values(current), values(speed)]);
        if let Some(found) =
            found.filter(|found| found.is_physical() && found.voltage_error < EXPLAINS)
        {
            let source = &mut chosen.sources[reversed];
            source.confidence = source.confidence.max(Confidence::Likely);
            source.reasons.push(format!(
                "turned: as it stands, the balances give {} of {}, which no motor has; turned, they leave {}",
                key.key(),
                significant(value, 3),
                figures(&found)
            ));
            chosen.balances = Some(found);
            return;
        }
        chosen.sources[reversed].reverse();
    }
    for place in [voltage, current, speed] {
        let source = &mut chosen.sources[place];
        source.confidence = Confidence::Unsure;
        source.doubts.push(format!(
            "the balances of voltage, current and speed give {} of {}, which no motor has, in either sign",
            key.key(),
            significant(value, 3)
        ));
    }
}

/// The shaft takes more work from the motor than it gives back.
pub(super) fn settle_torque(time_s: &[f64], chosen: &mut Chosen) {
    let of = |channel| chosen.get(&[channel]).map(|source| source.values.clone());
    let (Some(torque), Some(speed)) = (of(Channel::Torque), of(Channel::Speed)) else { return };
    let mut work = 0.0;
    let mut passed = 0.0;
    for row in 1..time_s.len() {
        let power = torque[row] * speed[row] * (time_s[row] - time_s[row - 1]);
        if power.is_finite() {
            work += power;
            passed += power.abs();
        }
    }
    let Some(source) = chosen.get_mut(Channel::Torque) else { return };
    if work < -0.2 * passed {
        source.reverse();
        source.confidence = source.confidence.max(Confidence::Likely);
        source.reasons.push(
            "turned: as it stands, the shaft drives the motor all the time; a sensor of the reaction counts so".into(),
        );
    } else if work < 0.2 * passed {
        source.doubts.push(
            "speed and torque do not show its sign: the work of the record is near zero".into(),
        );
        source.confidence = source.confidence.max(Confidence::Likely);
    }
}
