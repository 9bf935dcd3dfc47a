//! Several runs of one machine: what each parameter is, and how far it differs from run to run.
//!
//! The deviation of one fit knows only the noise of its own run. What changes between runs (temperature, load, the
//! position of a belt) shows in the spread alone, which is therefore what counts as soon as it is larger.

use serde::Serialize;
use statrs::distribution::{ChiSquared, ContinuousCDF};

use super::first_order::FirstOrder;
use super::verdict::{SETTLED, SETTLED_EFFECT};
use drivebench_model::numerics::statistics::{mean, variance};
use drivebench_model::plant::MotorKey;
use drivebench_model::sample::{ParameterEstimate, Verdict};

/// Probability below which a spread is no longer put down to the noise within the runs.
const BY_CHANCE: f64 = 0.01;

/// One parameter over several runs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Repeated {
    /// Of one fit to all runs where that is the surer one, else the mean over the runs that carry it, with the standard
    /// deviation of that mean.
    #[serde(flatten)]
    pub estimate: ParameterEstimate,
    /// Runs that it rests on: those that carry it, or all of one fit.
    pub runs: usize,
    /// Standard deviation of one run's value about the mean; from two runs on.
    pub run_to_run_std: Option<f64>,
}

/// Combines the estimates of several runs, key by key in the order of the first run that names it. `joint`: of one fit to
/// all of them, empty where there is none.
pub fn combine(per_run: &[Vec<ParameterEstimate>], joint: &[ParameterEstimate]) -> Vec<Repeated> {
    let mut keys: Vec<&str> = Vec::new();
    for parameter in per_run.iter().flatten().chain(joint) {
        if !keys.contains(&parameter.key.as_str()) {
            keys.push(&parameter.key);
        }
    }
    let of = |key| {
        let runs = per_run.iter();
        runs.filter_map(move |run| ParameterEstimate::find(run, key))
    };
    let combined = keys.into_iter().filter_map(|key| {
        let together = ParameterEstimate::find(joint, key).filter(|own| own.carried().is_some());
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
        // Nothing to compare: the one run that says something, else the first one's reason.
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
    if let Some(joint) = joint.filter(|own| FirstOrder::is_key(&own.key)) {
        return Some(Repeated {
            estimate: differing(joint, differs.then_some(spread.sqrt())),
            runs,
            run_to_run_std: Some(spread.sqrt()),
        });
    }
    // Of runs that do not differ one fit to all of them knows more than the mean of their fits, where it is the surer one.
    let is_surer = |own: &&ParameterEstimate| !differs && own.std.is_some_and(|own| own < std);
    if let Some(joint) = joint.filter(is_surer) {
        return Some(Repeated {
            estimate: joint.clone(),
            runs,
            run_to_run_std: Some(spread.sqrt()),
        });
    }
    // Where the runs differ, a further run may come out anywhere within the spread: the mean alone settles nothing.
    let doubt = if differs { spread.sqrt() } else { std };
    let relative = |deviation: f64| 100.0 * deviation / value.abs().max(f64::MIN_POSITIVE);
    let mut reasons = Vec::new();
    if differs {
        reasons.push(format!(
            "differs from run to run by {:.2} % where the noise within a run allows {:.2} %: \
             something changes between the runs (temperature, load) that the model does not hold",
            relative(spread.sqrt()),
            relative(within.sqrt())
        ));
    }
    if values.len() < all.len() {
        reasons.push(format!("{} of {} runs carry it", values.len(), all.len()));
    }
    // A run that is narrow enough and not settled all the same has a reason that no further run takes away.
    let is_motor = MotorKey::from_key(&first.key).is_some();
    let narrow = if is_motor { SETTLED } else { SETTLED_EFFECT };
    let doubtful = |p: &&&ParameterEstimate| {
        let is_narrow = |(value, std): (f64, f64)| std <= narrow * value.abs();
        p.verdict == Verdict::Searching && p.value.zip(p.std).is_some_and(is_narrow)
    };
    let doubted = all.iter().find(doubtful).and_then(|p| p.reason.clone());
    let settled = relative(doubt) <= 100.0 * SETTLED && doubted.is_none();
    reasons.extend(doubted);
    if !settled && reasons.is_empty() {
        reasons.push(format!("relative uncertainty {:.1} %", relative(doubt)));
    }
    Some(Repeated {
        estimate: ParameterEstimate {
            verdict: if settled {
                Verdict::Settled
            } else {
                Verdict::Searching
            },
            reason: (!reasons.is_empty()).then(|| reasons.join("; ")),
            ..ParameterEstimate::found(&first.key, first.unit, value, std, None)
        },
        runs: values.len(),
        run_to_run_std: Some(spread.sqrt()),
    })
}

/// A lag of one run holds at that run's level of the voltage, and the mean of several at none: what one fit to all of them gives
/// is as uncertain as they differ.
fn differing(joint: &ParameterEstimate, spread: Option<f64>) -> ParameterEstimate {
    let mut joint = joint.clone();
    let (Some(spread), Some(value)) = (spread, joint.value) else {
        return joint;
    };
    joint.std = joint.std.map(|std| std.max(spread));
    let percent = 100.0 * spread / value.abs().max(f64::MIN_POSITIVE);
    if percent > 100.0 * SETTLED {
        joint.verdict = Verdict::Searching;
        joint.reason = Some(format!(
            "the runs one by one differ by {percent:.1} %, more than their noise: it is another at another level of the voltage"
        ));
    }
    joint
}

/// Whether values that scatter with variance `spread` may be one value seen with variance `within` (chi-square test of
/// homogeneity).
fn by_chance(spread: f64, within: f64, runs: usize) -> bool {
    let freedom = runs as f64 - 1.0;
    let statistic = freedom * spread / within;
    match ChiSquared::new(freedom) {
        Ok(chi) if statistic.is_finite() => 1.0 - chi.cdf(statistic) >= BY_CHANCE,
        _ => spread <= within,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(value: f64, std: f64) -> Vec<ParameterEstimate> {
        vec![ParameterEstimate::found(
            "resistance_ohm",
            "ohm",
            value,
            std,
            None,
        )]
    }

    #[test]
    fn agreeing_runs_share_their_noise() {
        let combined = combine(
            &[run(1.100, 0.002), run(1.102, 0.002), run(1.099, 0.002)],
            &[],
        );
        let estimate = &combined[0].estimate;
        assert!((estimate.value.unwrap() - 1.100_333).abs() < 1e-6);
        assert!((estimate.std.unwrap() - 0.002 / 3f64.sqrt()).abs() < 1e-12);
        assert_eq!(estimate.verdict, Verdict::Settled);
        assert_eq!(estimate.reason, None);
        assert!((combined[0].run_to_run_std.unwrap() - 0.001_527_5).abs() < 1e-6);
    }

    #[test]
    fn runs_that_differ_beyond_their_noise_are_not_settled_by_their_mean() {
        let combined = combine(&[run(1.0, 0.001), run(1.1, 0.001), run(1.2, 0.001)], &[]);
        let estimate = &combined[0].estimate;
        assert_eq!(estimate.verdict, Verdict::Searching);
        assert!(estimate.reason.as_ref().unwrap().contains("run to run"));
        assert!((estimate.std.unwrap() - 0.1 / 3f64.sqrt()).abs() < 1e-12);
    }

    #[test]
    fn a_doubt_that_is_not_of_the_width_stays_whatever_the_number_of_runs() {
        let of = |std, doubt: &str| {
            let doubt = Some(doubt.to_owned());
            vec![ParameterEstimate::found(
                "resistance_ohm",
                "ohm",
                1.1,
                std,
                doubt,
            )]
        };
        let verdict = |runs: &[Vec<ParameterEstimate>]| combine(runs, &[])[0].estimate.verdict;
        let missing = of(0.002, "an effect is missing");
        assert_eq!(verdict(&[run(1.1, 0.002), missing]), Verdict::Searching);
        let wide = of(0.025, "relative uncertainty 2.3 %");
        assert_eq!(verdict(&[wide.clone(), wide]), Verdict::Settled);
    }

    #[test]
    fn a_lag_that_differs_from_run_to_run_is_not_settled_by_one_fit_to_all() {
        let lag = |value: f64| {
            let key = "first_order.gain_rad_s_per_v";
            vec![ParameterEstimate::found(key, "rad/s/V", value, 0.005, None)]
        };
        let of = |runs: &[f64]| {
            let runs: Vec<_> = runs.iter().map(|gain| lag(*gain)).collect();
            combine(&runs, &lag(2.48)).remove(0)
        };
        let apart = of(&[2.61, 2.57, 2.51, 2.43]);
        assert_eq!(apart.estimate.verdict, Verdict::Searching);
        assert_eq!((apart.estimate.value, apart.runs), (Some(2.48), 4));
        assert!(apart.estimate.std.unwrap() > 0.07, "{apart:?}");
        let alike = of(&[2.483, 2.478, 2.481, 2.479]);
        assert_eq!(alike.estimate, lag(2.48)[0]);
    }

    #[test]
    fn a_run_that_carries_nothing_is_counted_out_loud() {
        let dumb = vec![ParameterEstimate::not_observable(
            "resistance_ohm",
            "ohm",
            "at rest",
        )];
        let combined = combine(&[run(1.1, 0.001), dumb.clone(), run(1.1, 0.001)], &[]);
        assert_eq!(combined[0].runs, 2);
        let reason = combined[0].estimate.reason.as_deref();
        assert_eq!(reason, Some("2 of 3 runs carry it"));
        let none = combine(&[dumb.clone(), dumb], &[]);
        assert_eq!(none[0].estimate.verdict, Verdict::NotObservable);
        assert_eq!(none[0].runs, 0);
    }

    #[test]
    fn one_fit_to_all_runs_counts_where_it_is_surer_and_the_runs_do_not_differ() {
        let of = |runs: &[Vec<ParameterEstimate>]| combine(runs, &run(1.2, 0.001))[0].clone();
        let together = of(&[run(1.1, 0.2), run(1.2, 0.2)]);
        assert_eq!((together.estimate.value, together.runs), (Some(1.2), 2));
        let apart = of(&[run(1.0, 0.001), run(1.3, 0.001)]);
        assert_eq!(apart.estimate.verdict, Verdict::Searching);
        let open = vec![ParameterEstimate::not_observable(
            "resistance_ohm",
            "ohm",
            "one level",
        )];
        let none_alone = of(&[open.clone(), open]);
        assert_eq!((none_alone.estimate.value, none_alone.runs), (Some(1.2), 2));
    }
}
