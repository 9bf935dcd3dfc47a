//! Repeated runs of one machine: random-effects mean of each parameter and its variation from run to run, with the chi-square test
//! of homogeneity (Cochran, *Biometrics* 10, 1954).
//!
//! The standard deviation of one fit contains only the noise of its run. Changes between runs (temperature, load, position of
//! a belt) are in the spread of the runs alone, which is used where it is larger.

use serde::Serialize;
use statrs::distribution::{ChiSquared, ContinuousCDF};

use super::first_order::FirstOrder;
use super::verdict::{SETTLED, settled_below};
use drivebench_model::numerics::statistics::{mean, variance};
use drivebench_model::sample::{ParameterEstimate, Reason, Verdict};

/// One parameter over several runs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Repeated {
    /// That of one fit to all runs where its deviation is smaller, else the mean over the runs in which it is observable, with the
    /// standard deviation of that mean.
    #[serde(flatten)]
    pub estimate: ParameterEstimate,
    /// Number of those runs.
    pub runs: usize,
    /// Standard deviation of one run's value about the mean; from two runs on.
    pub run_to_run_std: Option<f64>,
}

/// Combines the estimates of several runs, key by key in the order of their first occurrence. `joint`: of one fit to all of them,
/// or empty.
pub fn combine(per_run: &[Vec<ParameterEstimate>], joint: &[ParameterEstimate]) -> Vec<Repeated> {
    let mut keys: Vec<&str> = Vec::new();
    for parameter in per_run.iter().flatten().chain(joint) {
        if !keys.contains(&parameter.key.as_str()) {
            keys.push(&parameter.key);
        }
    }
    let of = |key| per_run.iter().filter_map(move |run| ParameterEstimate::find(run, key));
    let combined = keys.into_iter().filter_map(|key| {
        let is_known =
            |own: &&ParameterEstimate| own.carried().is_some() || own.verdict == Verdict::Fixed;
        let together = ParameterEstimate::find(joint, key).filter(is_known);
        one(&of(key).collect::<Vec<_>>(), together, per_run.len())
    });
    combined.collect()
}

/// `runs`: how many there are.
fn one(
    all: &[&ParameterEstimate],
    joint: Option<&ParameterEstimate>,
    runs: usize,
) -> Option<Repeated> {
    let first = *all.first().or(joint.as_ref())?;
    let carried: Vec<(f64, f64)> = all
        .iter()
        .filter_map(|p| p.carried().and_then(|(value, std)| Some((value, std?))))
        .collect();
    if carried.len() < 2 {
        // The only run in which it is observable, else the reason of the first run.
        let sound = |p: &&&ParameterEstimate| p.value.is_some() && p.verdict != Verdict::Invalid;
        let known = joint.or_else(|| all.iter().find(sound).copied());
        return Some(Repeated {
            estimate: known.unwrap_or(first).clone(),
            runs: joint.map_or(carried.len(), |_| runs),
            run_to_run_std: None,
        });
    }
    let values: Vec<f64> = carried.iter().map(|(value, _)| *value).collect();
    let count = values.len() as f64;
    let value = mean(&values);
    let spread = variance(&values);
    let within = carried.iter().map(|(_, std)| std * std).sum::<f64>() / count;
    let std = (spread.max(within) / count).sqrt();
    let differs = !by_chance(spread, within, values.len());
    let repeated =
        |estimate, runs| Repeated { estimate, runs, run_to_run_std: Some(spread.sqrt()) };
    if let Some(joint) = joint.filter(|own| FirstOrder::is_key(&own.key)) {
        let estimate = differing(joint, differs.then_some(spread.sqrt()));
        return Some(repeated(estimate, runs));
    }
    // Of homogeneous runs one fit to all of them replaces the mean of their fits, where its deviation is smaller.
    let is_better = |joint: &&ParameterEstimate| !differs && joint.std.is_some_and(|own| own < std);
    if let Some(joint) = joint.filter(is_better) {
        return Some(repeated(joint.clone(), runs));
    }
    // Where the runs differ, the value of a further run has the spread, not the deviation of the mean.
    let deviation = if differs { spread.sqrt() } else { std };
    let relative = |deviation: f64| 100.0 * deviation / value.abs().max(f64::MIN_POSITIVE);
    let mut reasons = Vec::new();
    if differs {
        reasons.push((
            Reason::RunsDiffer,
            format!(
                "differs from run to run by {:.2} %, and the noise within a run explains {:.2} %: \
                 a change between the runs (temperature, load) that is not in the model",
                relative(spread.sqrt()),
                relative(within.sqrt())
            ),
        ));
    }
    if values.len() < all.len() {
        let reason = format!("observable in {} of {} runs", values.len(), all.len());
        reasons.push((Reason::NotInEveryRun, reason));
    }
    // An estimate with a small deviation that is not settled has a reason that further runs do not remove.
    let settled_std = settled_below(&first.key);
    let is_doubted = |p: &&&ParameterEstimate| {
        let is_small = |(value, std): (f64, f64)| std <= settled_std * value.abs();
        p.verdict == Verdict::Searching && p.value.zip(p.std).is_some_and(is_small)
    };
    let doubt = all.iter().find(is_doubted).and_then(|p| p.code.zip(p.reason.clone()));
    let settled = relative(deviation) <= 100.0 * SETTLED && doubt.is_none();
    reasons.extend(doubt);
    if !settled && reasons.is_empty() {
        let reason = format!("relative uncertainty {:.1} %", relative(deviation));
        reasons.push((Reason::Uncertain, reason));
    }
    let mut estimate = ParameterEstimate::found(&first.key, first.unit, value, std, None);
    let (codes, texts): (Vec<Reason>, Vec<String>) = reasons.into_iter().unzip();
    estimate.code = codes.first().copied();
    estimate.reason = estimate.code.map(|_| texts.join("; "));
    if !settled {
        estimate.verdict = Verdict::Searching;
    }
    Some(repeated(estimate, values.len()))
}

/// A lag depends on the level of the voltage, so that the mean over runs has no meaning: the deviation of the joint fit is at least
/// the spread of the runs.
fn differing(joint: &ParameterEstimate, spread: Option<f64>) -> ParameterEstimate {
    let mut joint = joint.clone();
    let (Some(spread), Some(value)) = (spread, joint.value) else { return joint };
    joint.std = joint.std.map(|std| std.max(spread));
    let percent = 100.0 * spread / value.abs().max(f64::MIN_POSITIVE);
    if percent > 100.0 * SETTLED {
        let reason = format!(
            "the runs differ by {percent:.1} %, more than their noise: it depends on the level of the voltage"
        );
        joint.set(Verdict::Searching, Reason::RunsDiffer, reason);
    }
    joint
}

/// Chi-square test of homogeneity at 1 %: whether values with the variance `spread` are one value with the variance `within`.
fn by_chance(spread: f64, within: f64, runs: usize) -> bool {
    let freedom = runs as f64 - 1.0;
    let statistic = freedom * spread / within;
    match ChiSquared::new(freedom) {
        Ok(chi) if statistic.is_finite() => 1.0 - chi.cdf(statistic) >= 0.01,
        _ => spread <= within,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::verdict;
    use drivebench_model::plant::MotorKey;

    fn run_with(value: f64, std: f64, doubt: Option<&str>) -> Vec<ParameterEstimate> {
        let doubt = doubt.map(|doubt| (Reason::ModelMisses, doubt.to_owned()));
        vec![ParameterEstimate::found("resistance_ohm", "ohm", value, std, doubt)]
    }

    fn run(value: f64, std: f64) -> Vec<ParameterEstimate> {
        run_with(value, std, None)
    }

    fn open() -> Vec<ParameterEstimate> {
        vec![verdict::unknown(MotorKey::Resistance, Reason::NotExcited, "at rest")]
    }

    fn combined(runs: &[Vec<ParameterEstimate>], joint: &[ParameterEstimate]) -> Repeated {
        combine(runs, joint).remove(0)
    }

    #[test]
    fn agreeing_runs_share_their_noise_and_differing_ones_do_not() {
        let runs = [run(1.100, 0.002), run(1.102, 0.002), run(1.099, 0.002)];
        let Repeated { estimate, run_to_run_std, .. } = combined(&runs, &[]);
        assert!((estimate.value.unwrap() - 1.100_333).abs() < 1e-6);
        assert!((estimate.std.unwrap() - 0.002 / 3f64.sqrt()).abs() < 1e-12);
        assert_eq!((estimate.verdict, estimate.reason), (Verdict::Settled, None));
        assert!((run_to_run_std.unwrap() - 0.001_527_5).abs() < 1e-6);
        let estimate = combined(&[run(1.0, 0.001), run(1.1, 0.001), run(1.2, 0.001)], &[]).estimate;
        assert_eq!(estimate.verdict, Verdict::Searching);
        assert!(estimate.reason.unwrap().contains("run to run"));
        assert!((estimate.std.unwrap() - 0.1 / 3f64.sqrt()).abs() < 1e-12);
    }

    #[test]
    fn a_doubt_other_than_the_uncertainty_stays() {
        let verdict = |runs: &[Vec<ParameterEstimate>]| combined(runs, &[]).estimate.verdict;
        let missing = run_with(1.1, 0.002, Some("an effect is missing"));
        assert_eq!(verdict(&[run(1.1, 0.002), missing]), Verdict::Searching);
        let wide = run_with(1.1, 0.025, Some("relative uncertainty 2.3 %"));
        assert_eq!(verdict(&[wide.clone(), wide]), Verdict::Settled);
    }

    #[test]
    fn a_lag_that_differs_from_run_to_run_is_not_settled_by_one_fit() {
        let lag = |value: f64| {
            let key = "first_order.gain_rad_s_per_v";
            vec![ParameterEstimate::found(key, "rad/s/V", value, 0.005, None)]
        };
        let of = |runs: [f64; 4]| combined(&runs.map(lag), &lag(2.48));
        let apart = of([2.61, 2.57, 2.51, 2.43]);
        assert_eq!(apart.estimate.verdict, Verdict::Searching);
        assert_eq!((apart.estimate.value, apart.runs), (Some(2.48), 4));
        assert!(apart.estimate.std.unwrap() > 0.07, "{apart:?}");
        assert_eq!(of([2.483, 2.478, 2.481, 2.479]).estimate, lag(2.48)[0]);
    }

    #[test]
    fn runs_without_the_parameter_are_counted() {
        let one = combined(&[run(1.1, 0.001), open(), run(1.1, 0.001)], &[]);
        let reason = one.estimate.reason.as_deref();
        assert_eq!((one.runs, reason), (2, Some("observable in 2 of 3 runs")));
        let none = combined(&[open(), open()], &[]);
        assert_eq!((none.estimate.verdict, none.runs), (Verdict::NotObservable, 0));
    }

    #[test]
    fn one_fit_to_all_runs_counts_where_its_deviation_is_smaller() {
        let of = |runs: &[Vec<ParameterEstimate>]| combined(runs, &run(1.2, 0.001));
        for runs in [[run(1.1, 0.2), run(1.2, 0.2)], [open(), open()]] {
            let found = of(&runs);
            assert_eq!((found.estimate.value, found.runs), (Some(1.2), 2));
        }
        assert_eq!(of(&[run(1.0, 0.001), run(1.3, 0.001)]).estimate.verdict, Verdict::Searching);
    }
}
