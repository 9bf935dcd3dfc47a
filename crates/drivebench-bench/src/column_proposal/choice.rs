//! Which candidates belong together: those of one motor, of the first rank, with which both balances hold.
//!
//! `u = R i + L di/dt + Ke w` and `Kt i = J dw/dt + friction` hold in any unit, so that they distinguish columns and signs, but
//! not rad/s from r/min.

use std::cmp::Ordering;

use super::Confidence;
use super::finding::{Doubt, Reason};
use super::source::{Source, Sources, VOLTAGES};
use drivebench_identify::sanity::{self, Balances, EXPLAINS};
use drivebench_model::sample::Channel;

struct Trial<'a> {
    picked: [Option<&'a Source>; 3],
    /// Pairs of columns that are of different motors.
    mixed: usize,
    rank: u32,
    balances: Option<Balances>,
}

impl<'a> Trial<'a> {
    /// `None` where a column stands for two quantities.
    fn of(time_s: &[f64], picked: [Option<&'a Source>; 3]) -> Option<Self> {
        let mut trial = Self { picked, mixed: 0, rank: 0, balances: None };
        let columns: Vec<usize> = trial.columns().collect();
        if (1..columns.len()).any(|at| columns[..at].contains(&columns[at])) {
            return None;
        }
        let there: Vec<&Source> = picked.into_iter().flatten().collect();
        for (at, one) in there.iter().enumerate() {
            trial.mixed += there[at + 1..].iter().filter(|other| other.words != one.words).count();
            trial.rank += u32::from(one.rank);
        }
        if let [Some(voltage), Some(current), Some(speed)] = picked {
            let values = [voltage, current, speed].map(|source| source.values.as_slice());
            trial.balances = sanity::balances(time_s, values);
        }
        Some(trial)
    }

    fn columns(&self) -> impl Iterator<Item = usize> {
        self.picked.iter().flatten().flat_map(|source| source.columns.iter().copied())
    }

    fn count(&self) -> usize {
        self.picked.iter().flatten().count()
    }

    /// What the balances leave unexplained; impossible coefficients come last.
    fn cost(&self) -> f64 {
        self.balances.map_or(1.0, |found| {
            if found.is_physical() { found.error() } else { 2.0 + found.error().min(1.0) }
        })
    }

    /// By all but the balances.
    fn preference(&self, other: &Self) -> Ordering {
        (other.count().cmp(&self.count()))
            .then(self.mixed.cmp(&other.mixed))
            .then(self.rank.cmp(&other.rank))
    }
}

/// Chooses voltage, current and speed together of six candidates each, then what else stands in the file.
pub(super) fn choose(time_s: &[f64], sources: &Sources, headers: &[String]) -> Vec<Source> {
    let options = [&VOLTAGES[..], &[Channel::Current], &[Channel::Speed]]
        .map(|channels| sources.of(channels).take(6).map(Some).chain([None]).collect::<Vec<_>>());
    let mut trials = Vec::new();
    for voltage in &options[0] {
        for current in &options[1] {
            for speed in &options[2] {
                trials.extend(Trial::of(time_s, [*voltage, *current, *speed]));
            }
        }
    }
    trials.sort_by(|one, other| one.preference(other).then(one.cost().total_cmp(&other.cost())));
    let Some((best, others)) = trials.split_first() else { return Vec::new() };
    let mut chosen: Vec<Source> = best.picked.into_iter().flatten().cloned().collect();
    compare_with_others(&mut chosen, best, others, headers);
    if let Some(balances) = best.balances {
        settle_signs(time_s, &mut chosen, &balances);
    }
    chosen.extend(sources.first(Channel::Torque));
    chosen
}

/// What the balances show of the other candidates that are preferred as much.
fn compare_with_others(
    chosen: &mut [Source],
    best: &Trial<'_>,
    others: &[Trial<'_>],
    headers: &[String],
) {
    let name = |column: usize| headers[column].clone();
    let is_apart = |other: &&Trial<'_>| {
        best.count() > 1 && other.columns().all(|column| best.columns().all(|own| own != column))
    };
    let is_equal = |other: &&Trial<'_>| best.preference(other) == Ordering::Equal;
    let (apart, rivals): (Vec<_>, Vec<_>) = others.iter().filter(is_equal).partition(is_apart);
    if let (Some(another), Some(first)) = (apart.first(), chosen.first_mut()) {
        first.doubts.push(Doubt::OtherMotor(another.columns().map(name).collect()));
        first.at_least(Confidence::Likely);
    }
    let places = (0..3).filter(|place| best.picked[*place].is_some());
    for (place, source) in places.zip(chosen) {
        let rival = rivals.iter().find_map(|rival| {
            let other = rival.picked[place].filter(|other| other.columns != source.columns)?;
            Some((rival, other))
        });
        let Some((rival, other)) = rival else { continue };
        let header = other.columns.iter().map(|column| name(*column)).collect::<Vec<_>>().join("*");
        let left = best.cost();
        if left < EXPLAINS && rival.cost() > 2.0 * left {
            let by_other = rival.balances.filter(Balances::is_physical).map(|found| found.error());
            source.reasons.push(Reason::BetterThan { header, left, by_other });
            // The balances distinguish the columns of channels without names.
            if source.confidence == Confidence::Unsure {
                source.confidence = Confidence::Likely;
            }
        } else {
            source.doubts.push(Doubt::Rival { header });
            source.confidence = Confidence::Unsure;
        }
    }
}

/// Turns the column whose sign no motor has; the sources are voltage, current and speed.
fn settle_signs(time_s: &[f64], sources: &mut [Source], given: &Balances) {
    if given.is_physical() {
        let (resistance, back_emf) = (given.resistance.value, given.back_emf.value);
        let left = given.left();
        sources[0].reasons.push(Reason::BalanceHolds { resistance, back_emf, left });
        return;
    }
    let Some(coefficient) = given.impossible() else { return };
    for reversed in [1, 2, 0] {
        sources[reversed].scale(-1.0);
        let values = [0, 1, 2].map(|place: usize| sources[place].values.as_slice());
        let holds = |found: &Balances| found.is_physical() && found.voltage_error < EXPLAINS;
        if let Some(found) = sanity::balances(time_s, values).filter(holds) {
            let source = &mut sources[reversed];
            source.at_least(Confidence::Likely);
            source.reasons.push(Reason::Reversed { coefficient, left: found.left() });
            return;
        }
        sources[reversed].scale(-1.0);
    }
    for source in sources {
        source.confidence = Confidence::Unsure;
        source.doubts.push(Doubt::Impossible { coefficient });
    }
}

pub(super) fn of_channel(sources: &mut [Source], channel: Channel) -> Option<&mut Source> {
    sources.iter_mut().find(|source| source.is_of(&[channel]))
}

/// The shaft takes more work from the motor than it gives back.
pub(super) fn settle_torque(time_s: &[f64], chosen: &mut [Source]) {
    let speed = of_channel(chosen, Channel::Speed).map(|speed| speed.values.clone());
    let (Some(speed), Some(torque)) = (speed, of_channel(chosen, Channel::Torque)) else { return };
    let work = |row: usize| torque.values[row] * speed[row] * (time_s[row] - time_s[row - 1]);
    let all = (1..time_s.len()).map(work).filter(|work| work.is_finite());
    let (work, passed) =
        all.fold((0.0, 0.0), |(sum, sizes), work| (sum + work, sizes + work.abs()));
    if work < -0.2 * passed {
        torque.scale(-1.0);
        torque.reasons.push(Reason::ReactionTorque);
        torque.at_least(Confidence::Likely);
    } else if work < 0.2 * passed {
        torque.doubts.push(Doubt::NoWork);
        torque.at_least(Confidence::Likely);
    }
}
