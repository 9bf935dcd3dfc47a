//! Drift of a machine between two dates: two-sample tests of each parameter (Student's t), corrected for their number (Holm,
//! *Scand. J. Statist.* 6, 1979), with intervals and a possible cause.
//!
//! ```text
//! runs before, runs after -> change and 95 % interval of each parameter -> by chance? (Holm 1979 over all)
//! ```
//!
//! The standard deviation of a fit contains only the noise within its run; the variation of the machine from run to run
//! (temperature, load, position of a belt) is observable in repeated runs alone. With repeats the larger of the two decides;
//! without them the result has a caution.

use serde::Serialize;
use statrs::distribution::{ContinuousCDF, Normal, StudentsT};

use super::temperature;
use drivebench_model::findings;
use drivebench_model::numerics::statistics::mean;
use drivebench_model::plant::{MotorKey, effect};
use drivebench_model::sample::{ParameterEstimate, TWO_SIDED_95};

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Change {
    pub key: String,
    pub unit: &'static str,
    pub before: f64,
    pub after: f64,
    /// Runs of either date in which it is observable.
    pub runs_before: usize,
    pub runs_after: usize,
    /// Relative to the value before; null where that may be zero.
    pub percent: Option<f64>,
    pub interval_95_percent: Option<[f64; 2]>,
    /// The change in the parameter's unit, and its 95 % interval.
    pub change: f64,
    pub interval_95: [f64; 2],
    /// p-value, corrected for the number of parameters.
    pub by_chance: f64,
    /// p-value of this parameter alone under the noise within the runs.
    pub by_noise: f64,
    pub drifted: bool,
    /// Significant against the noise within the runs, but with too few repeats for the variation from run to run.
    pub unsettled: bool,
    /// Null without a drift, or without a known cause.
    #[serde(rename = "possible_cause_code")]
    pub possible_cause: Option<DriftCause>,
    #[serde(rename = "code")]
    pub finding: DriftFinding,
}

findings! {
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub enum DriftFinding {
        Drifted = "drifted",
        Unsettled = "drift_not_settled",
        /// A change larger than its interval is excluded.
        Bounded = "no_larger_change_left_open",
        NotShown = "no_change_shown",
    }
}

findings! {
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub enum DriftCause {
        Winding { kelvin: f64, warmer: bool } = "winding_temperature",
        LessSaturation = "less_saturation",
        MoreSaturation = "more_saturation",
        ColderMagnets = "colder_magnets",
        WarmerMagnets = "warmer_or_weakened_magnets",
        TorqueScale = "magnets_or_torque_scale",
        Load = "load_on_the_shaft",
        MoreFriction = "more_friction",
        LessFriction = "less_friction",
        Connections = "connections",
        /// The cause on the card of the effect.
        Effect { id: &'static str } = "cause_of_the_effect",
    }
}

findings! {
    /// Variation that the intervals do not contain.
    #[derive(Clone, Debug, PartialEq, Eq)]
    pub enum DriftCaution {
        /// The variation from run to run is not known: of these parameters, or of all where there are none.
        SingleRuns { keys: Vec<String> } = "one_run_on_each_side",
        /// An effect that the model lacks may look like a drift.
        OtherExcitation = "other_excitation",
        UnknownUnit = "no_serial_number",
        /// The figures are those of the earlier run.
        SameFigures = "figures_of_the_earlier_run",
        /// So many runs of the baseline are repetitions of another.
        RepeatedRuns { count: usize } = "baseline_has_runs_twice",
    }
}

findings! {
    /// In which runs a parameter is not observable.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub enum NotCarried {
        ByEither = "not_carried_by_either",
        Before = "not_carried_before",
        After = "not_carried_after",
    }
}

impl Change {
    /// Largest change within its 95 % interval, in either direction, in per cent.
    pub fn at_most_percent(&self) -> Option<f64> {
        let [low, high] = self.interval_95_percent?;
        Some(low.abs().max(high.abs()))
    }
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct NotCompared {
    pub key: String,
    #[serde(rename = "code")]
    pub not_carried: NotCarried,
    /// Reason of the fit in which it is not observable.
    #[serde(skip)]
    pub own_reason: Option<String>,
    /// It was observable in the earlier runs, so that its change is not known.
    pub carried_before: bool,
}

/// All parameters of one machine at two dates.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Drift {
    pub changes: Vec<Change>,
    pub not_compared: Vec<NotCompared>,
    pub runs_before: usize,
    pub runs_after: usize,
    #[serde(rename = "caution_codes")]
    pub cautions: Vec<DriftCaution>,
    /// The earlier date as text.
    #[serde(skip)]
    pub since: String,
}

impl Drift {
    pub fn drifted(&self) -> impl Iterator<Item = &Change> {
        self.changes.iter().filter(|change| change.drifted)
    }

    /// Changes that are a drift or may be one.
    pub fn in_question(&self) -> impl Iterator<Item = &Change> {
        self.changes.iter().filter(|change| change.drifted || change.unsettled)
    }

    /// Parameters that were observable in the earlier runs and are not in the later ones.
    pub fn lost(&self) -> impl Iterator<Item = &NotCompared> {
        self.not_compared.iter().filter(|parameter| parameter.carried_before)
    }

    /// Largest change that is or may be a drift, in per cent: zero without one. `None` where one of them has no percentage, where a
    /// parameter was lost, or where none was compared.
    pub fn largest_percent(&self) -> Option<f64> {
        self.largest(self.in_question().map(|change| change.percent.map(f64::abs)))
    }

    /// Largest change within the 95 % interval of any parameter, in per cent; `None` as above.
    pub fn open_percent(&self) -> Option<f64> {
        self.largest(self.changes.iter().map(Change::at_most_percent))
    }

    fn largest(&self, sizes: impl Iterator<Item = Option<f64>>) -> Option<f64> {
        let is_whole = !self.changes.is_empty() && self.lost().next().is_none();
        let sizes: Option<Vec<f64>> = sizes.collect();
        Some(sizes.filter(|_| is_whole)?.into_iter().fold(0.0, f64::max))
    }
}

struct Sample {
    values: Vec<f64>,
    /// Mean variance of one fit.
    within: f64,
    unit: &'static str,
}

impl Sample {
    fn of(key: &str, runs: &[Vec<ParameterEstimate>]) -> Option<Self> {
        let all = runs.iter().filter_map(|run| ParameterEstimate::find(run, key));
        let unit = all.clone().next()?.unit;
        let carried = all.filter_map(|estimate| {
            let (value, std) = estimate.carried()?;
            std.filter(|std| std.is_finite() && *std > 0.0).map(|std| (value, std * std))
        });
        let (values, variances): (Vec<f64>, Vec<f64>) = carried.unzip();
        (!values.is_empty()).then(|| Self { within: mean(&variances), values, unit })
    }

    fn count(&self) -> f64 {
        self.values.len() as f64
    }

    fn squares(&self) -> f64 {
        let centre = mean(&self.values);
        self.values.iter().map(|value| (value - centre).powi(2)).sum()
    }
}

/// Compares the estimates of runs at two dates, run by run on either side; `since` is the earlier date as text.
pub fn between(
    before: &[Vec<ParameterEstimate>],
    after: &[Vec<ParameterEstimate>],
    since: &str,
) -> Drift {
    let mut keys: Vec<&str> = Vec::new();
    for parameter in before.iter().chain(after).flatten() {
        if !keys.contains(&parameter.key.as_str()) {
            keys.push(&parameter.key);
        }
    }
    // One quantity is compared once: at 20 °C where the temperature is known on both sides.
    let both = |key: &str| Sample::of(key, before).zip(Sample::of(key, after));
    let resistance = MotorKey::Resistance.key();
    let is_at_20 = both(temperature::KEY).is_some();
    let other = if is_at_20 { resistance } else { temperature::KEY };
    keys.retain(|key| *key != other);
    let (mut changes, mut not_compared) = (Vec::new(), Vec::new());
    for key in keys {
        match both(key) {
            Some((earlier, later)) => changes.push(change(key, &earlier, &later)),
            None => not_compared.extend(why_not(key, before, after)),
        }
    }
    correct(&mut changes);
    let compared = changes.len() as f64;
    // Family-wise: the probability that any parameter is reported although none has changed.
    let significance = 0.01;
    for change in &mut changes {
        change.drifted = change.by_chance < significance;
        let is_beyond_noise = compared * change.by_noise < significance;
        let freedom = (change.runs_before + change.runs_after) as f64 - 2.0;
        // With two degrees of freedom or fewer the variation from run to run is hardly known.
        change.unsettled = is_beyond_noise && !change.drifted && freedom < 3.0;
        change.possible_cause = change.drifted.then(|| cause(change)).flatten();
        change.finding = match change.at_most_percent() {
            _ if change.drifted => DriftFinding::Drifted,
            _ if change.unsettled => DriftFinding::Unsettled,
            Some(_) => DriftFinding::Bounded,
            None => DriftFinding::NotShown,
        };
    }
    let single = |change: &&Change| change.runs_before + change.runs_after <= 2;
    let singles: Vec<String> =
        changes.iter().filter(single).map(|change| change.key.clone()).collect();
    let caution = (!singles.is_empty()).then(|| DriftCaution::SingleRuns {
        keys: if singles.len() == changes.len() { Vec::new() } else { singles },
    });
    let cautions = caution.into_iter().collect();
    Drift {
        since: since.to_owned(),
        changes,
        not_compared,
        runs_before: before.len(),
        runs_after: after.len(),
        cautions,
    }
}

fn why_not(
    key: &str,
    before: &[Vec<ParameterEstimate>],
    after: &[Vec<ParameterEstimate>],
) -> Option<NotCompared> {
    let mut all = before.iter().chain(after).flatten().filter(|estimate| estimate.key == key);
    // A value that was given for both is not an estimate.
    let is_given = all.clone().all(|estimate| estimate.std == Some(0.0));
    let [open_before, open_after] = [before, after].map(|runs| Sample::of(key, runs).is_none());
    let not_carried = match (open_before, open_after) {
        (true, true) => NotCarried::ByEither,
        (true, false) => NotCarried::Before,
        _ => NotCarried::After,
    };
    let own_reason = all.find_map(|estimate| estimate.reason.clone());
    let carried_before = !open_before;
    (!is_given).then(|| NotCompared {
        key: key.to_owned(),
        not_carried,
        own_reason,
        carried_before,
    })
}

/// The change with its interval; the p-value is that of this parameter alone.
fn change(key: &str, before: &Sample, after: &Sample) -> Change {
    let (from, to) = (mean(&before.values), mean(&after.values));
    let change = to - from;
    let by_noise = (before.within / before.count() + after.within / after.count()).sqrt();
    let freedom = before.count() + after.count() - 2.0;
    let pooled = (freedom > 0.0).then(|| (before.squares() + after.squares()) / freedom);
    let student = pooled.and_then(|pooled| Some((pooled, StudentsT::new(0.0, 1.0, freedom).ok()?)));
    // Half-width of the interval of `to - share * from`: the larger one of noise and spread.
    let half = |share: f64| {
        let of = |earlier: f64, later: f64| {
            (later / after.count() + share * share * earlier / before.count()).sqrt()
        };
        let of_spread = student
            .map_or(0.0, |(pooled, student)| student.inverse_cdf(0.975) * of(pooled, pooled));
        of_spread.max(TWO_SIDED_95 * of(before.within, after.within))
    };
    let of_noise = 2.0 * Normal::standard().sf(change.abs() / by_noise);
    let mut by_chance = of_noise;
    if let Some((pooled, student)) = student.filter(|(pooled, _)| *pooled > 0.0) {
        let std = (pooled * (1.0 / before.count() + 1.0 / after.count())).sqrt();
        by_chance = by_chance.max(2.0 * student.sf(change.abs() / std));
    }
    // The relative change `to/from - 1`: the uncertainty of the denominator counts with the ratio (Fieller's theorem to first order).
    let is_clear = from.abs() > 5.0 * (before.within / before.count()).sqrt();
    let (half, widened) = (half(1.0), half(to / from));
    let percent = |value: f64| 100.0 * value / from;
    let ends = [percent(change - widened), percent(change + widened)];
    Change {
        key: key.to_owned(),
        unit: before.unit,
        before: from,
        after: to,
        runs_before: before.values.len(),
        runs_after: after.values.len(),
        percent: is_clear.then(|| percent(change)),
        interval_95_percent: is_clear.then(|| [ends[0].min(ends[1]), ends[0].max(ends[1])]),
        change,
        interval_95: [change - half, change + half],
        by_chance,
        by_noise: of_noise,
        drifted: false,
        unsettled: false,
        possible_cause: None,
        finding: DriftFinding::NotShown,
    }
}

/// Holm's step-down correction of the p-values for the number of parameters.
fn correct(changes: &mut [Change]) {
    let mut order: Vec<usize> = (0..changes.len()).collect();
    order.sort_by(|a, b| changes[*a].by_chance.total_cmp(&changes[*b].by_chance));
    let (count, mut least) = (order.len(), 0.0_f64);
    for (rank, index) in order.into_iter().enumerate() {
        let corrected = (changes[index].by_chance * (count - rank) as f64).min(1.0);
        least = least.max(corrected);
        changes[index].by_chance = least;
    }
}

fn cause(change: &Change) -> Option<DriftCause> {
    let grew = change.change > 0.0;
    let share = change.percent.map(|percent| percent / 100.0);
    Some(match MotorKey::from_key(&change.key) {
        Some(MotorKey::Resistance) => {
            DriftCause::Winding { kelvin: share?.abs() / temperature::COPPER_PER_K, warmer: grew }
        }
        Some(MotorKey::Inductance) if grew => DriftCause::LessSaturation,
        Some(MotorKey::Inductance) => DriftCause::MoreSaturation,
        Some(MotorKey::BackEmf) if grew => DriftCause::ColderMagnets,
        Some(MotorKey::BackEmf) => DriftCause::WarmerMagnets,
        Some(MotorKey::TorqueConstant) => DriftCause::TorqueScale,
        Some(MotorKey::Inertia) => DriftCause::Load,
        Some(MotorKey::LoadTorque) if grew => DriftCause::MoreFriction,
        Some(MotorKey::LoadTorque) => DriftCause::LessFriction,
        None if change.key == temperature::KEY => DriftCause::Connections,
        None => {
            let (id, _) = change.key.split_once('.')?;
            let card = effect::find(id)?.card();
            card.drift_cause.map(|_| DriftCause::Effect { id: card.id })?
        }
    })
}

#[cfg(test)]
#[path = "drift_tests.rs"]
mod tests;
