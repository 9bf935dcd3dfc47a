//! The answer on a run that had no part in it: neither fitted, nor selected by, nor asked for the noise.

use serde::Serialize;

use super::bench::Bench;
use super::diagnose::DiagnosisVerdict;
use super::explained::{Floor, in_noise};
use super::joint::Noise;
use super::joint::likelihood_ratio::likelier;
use crate::identification::noise::FloorSource;
use crate::identification::output_error::FitError;
use crate::plant::Model;

/// What the confirming run says of the answer.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Confirmation {
    /// Whether the answer holds there: the named effects make the run likelier and explain a good part of its error; where nothing is missing the error
    /// is at the floor; where something unexplained is missing it is above. Null where the answer claims nothing, or the run
    /// cannot be judged.
    pub confirmed: Option<bool>,
    /// Error without and with the named effects, in units of the noise.
    pub error_before: Option<f64>,
    pub error_after: Option<f64>,
    /// By how many standard deviations the named effects make the run likelier; null where none is named.
    pub z: Option<f64>,
    pub explained_percent: Option<f64>,
    pub sentence: String,
}

/// Both models on the confirming run.
struct Repeated {
    before: f64,
    after: f64,
    z: f64,
    /// Share of the explainable error that the named effects explain.
    share: f64,
    /// Whether they make the run likelier and explain a good part of its error.
    holds: bool,
    /// Whether the error without them is at the floor, and with them.
    at_the_floor: bool,
    explains_it: bool,
}

/// Standard deviations by which the named effects must make the run likelier.
const SIGNIFICANT: f64 = 3.0;

/// Of two models whose `noise` is what is random beside them; none without a confirming run. `in_motion`: how much noisier
/// the sensors are in motion than at rest.
pub(super) fn of_models(
    bench: &Bench,
    [baseline, best]: [&Model; 2],
    noise: Noise,
    verdict: DiagnosisVerdict,
    names: &[&str],
    in_motion: f64,
) -> Option<Confirmation> {
    let evidence = &bench.evidence;
    let run = evidence.confirm.as_ref()?;
    let source = evidence.noise.source;
    let repeated = || -> Result<Repeated, FitError> {
        let before = bench.confirming(baseline, run)?;
        let after = bench.confirming(best, run)?;
        let (z, unseen) = likelier(
            [&before.model, &after.model],
            [before.start, after.start],
            run,
            noise,
            source != FloorSource::None,
        )
        .ok_or_else(|| FitError::CannotSimulate {
            run: run.name.clone(),
        })?;
        let floor = Floor::new(
            evidence,
            in_noise(unseen.map(Some), &evidence.noise).unwrap_or(0.0),
        );
        let [before, after] = [before.score.nrms, after.score.nrms];
        Ok(Repeated {
            before,
            after,
            z,
            share: floor.explained(before, after),
            holds: z >= SIGNIFICANT && floor.is_explained_in_part(before, after),
            at_the_floor: floor.is_reached(before / in_motion),
            explains_it: floor.is_reached(after / in_motion),
        })
    };
    Some(match repeated() {
        Ok(repeated) => confirmation(verdict, source, names, &repeated),
        Err(error) => Confirmation {
            confirmed: None,
            error_before: None,
            error_after: None,
            z: None,
            explained_percent: None,
            sentence: format!(
                "the confirming run cannot be judged, so that nothing is confirmed: {error}"
            ),
        },
    })
}

/// The confirming run's word on an answer.
fn confirmation(
    verdict: DiagnosisVerdict,
    source: FloorSource,
    names: &[&str],
    repeated: &Repeated,
) -> Confirmation {
    let (before, after, times) = (repeated.before, repeated.after, source.times());
    let named = matches!(
        verdict,
        DiagnosisVerdict::Effect | DiagnosisVerdict::Ambiguous
    );
    let confirmed = match verdict {
        DiagnosisVerdict::Effect | DiagnosisVerdict::Ambiguous => Some(repeated.holds),
        DiagnosisVerdict::None => (source != FloorSource::None).then_some(repeated.at_the_floor),
        DiagnosisVerdict::Unexplained => Some(!repeated.at_the_floor),
    };
    let found = match verdict {
        DiagnosisVerdict::Effect | DiagnosisVerdict::Ambiguous => format!(
            "there {} takes the error from {before:.2} to {after:.2} {times} and explains {:.0} % of what can be explained \
             (z {:.1}, {SIGNIFICANT} is asked){}",
            names.join(" and "),
            100.0 * repeated.share,
            repeated.z,
            if repeated.explains_it || source == FloorSource::None {
                ""
            } else {
                "; what is left there is more than noise"
            }
        ),
        DiagnosisVerdict::None if confirmed.is_none() => format!(
            "the error there is {before:.2} {times}, and without a noise floor nobody knows how large it may be"
        ),
        DiagnosisVerdict::None if repeated.at_the_floor => {
            format!("the error is {before:.2} {times} there too")
        }
        DiagnosisVerdict::None => format!(
            "the error there is {before:.2} {times}: something is missing that only this run shows"
        ),
        DiagnosisVerdict::Unexplained if repeated.at_the_floor => {
            format!("there the model explains the run to the noise ({before:.2} {times})")
        }
        DiagnosisVerdict::Unexplained => format!("the error is {before:.2} {times} there too"),
    };
    let word = match confirmed {
        Some(true) => "confirmed",
        Some(false) => "NOT confirmed",
        None => "neither confirmed nor refuted",
    };
    Confirmation {
        confirmed,
        error_before: Some(before),
        error_after: Some(if named { after } else { before }),
        z: named.then_some(repeated.z),
        explained_percent: named.then_some(100.0 * repeated.share),
        sentence: format!("{word} on the run that had no part in the answer: {found}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnosis::tests::{evidence, nameplate, record, truth};
    use crate::diagnosis::{Diagnosis, Evidence, diagnose};

    fn confirmed(diagnosis: &Diagnosis) -> &Confirmation {
        diagnosis.confirm.as_ref().unwrap()
    }

    #[test]
    fn a_named_effect_is_confirmed_where_it_is_and_not_where_it_is_not() {
        let fan = truth("quadratic_load", &[2e-6]);
        let data = evidence(&fan, 1);
        let there = diagnose(&nameplate(), data.clone()).unwrap();
        assert_eq!(there.effects, ["quadratic_load"]);
        let found = confirmed(&there);
        assert_eq!(found.confirmed, Some(true), "{}", found.sentence);
        assert!(found.z.unwrap() > SIGNIFICANT && found.explained_percent.unwrap() > 90.0);
        assert!(found.error_after.unwrap() < 1.15 && found.error_before.unwrap() > 1.5);

        // The fan was taken off for the third run: the same answer, since that run has no part in it, and no confirmation.
        let mut off = data;
        off.confirm = Some(record(&nameplate(), 2, 77));
        let elsewhere = diagnose(&nameplate(), off).unwrap();
        assert_eq!(elsewhere.effects, there.effects);
        assert!((elsewhere.holdout_after - there.holdout_after).abs() < 1e-12);
        let found = confirmed(&elsewhere);
        assert_eq!(found.confirmed, Some(false), "{}", found.sentence);
        assert!(found.error_after.unwrap() > found.error_before.unwrap());
    }

    #[test]
    fn that_nothing_is_missing_is_confirmed_only_where_the_error_is_at_the_floor() {
        let mut data = evidence(&nameplate(), 2);
        let nothing = diagnose(&nameplate(), data.clone()).unwrap();
        assert_eq!(nothing.verdict, DiagnosisVerdict::None);
        assert_eq!(confirmed(&nothing).confirmed, Some(true));
        assert_eq!(confirmed(&nothing).z, None);
        data.confirm = Some(record(&truth("voltage_drop", &[1.2]), 2, 78));
        let hidden = diagnose(&nameplate(), data.clone()).unwrap();
        assert_eq!(hidden.verdict, DiagnosisVerdict::None);
        assert_eq!(confirmed(&hidden).confirmed, Some(false));
        // What one run contradicts is not said.
        assert!(!hidden.sufficient && nothing.sufficient);
        assert!(
            nothing.sentence.starts_with("nothing is missing"),
            "{}",
            nothing.sentence
        );
        assert!(
            !hidden.sentence.contains("nothing is missing"),
            "{}",
            hidden.sentence
        );
        assert!(
            hidden.sentence.contains("on the confirming run"),
            "{}",
            hidden.sentence
        );
        data.confirm = None;
        assert_eq!(diagnose(&nameplate(), data).unwrap().confirm, None);
    }

    #[test]
    fn the_noise_floor_owes_nothing_to_the_confirming_run() {
        let data = evidence(&nameplate(), 3);
        let mut loud = record(&nameplate(), 2, 79);
        for (k, speed) in loud.speed_rad_s.iter_mut().enumerate() {
            *speed += if k % 2 == 0 { 3.0 } else { -3.0 };
        }
        let with = Evidence::new(
            data.training.clone(),
            Some(data.holdout.clone()),
            Some(loud),
        );
        assert_eq!(
            with.noise,
            Evidence::new(data.training, Some(data.holdout), None).noise
        );
    }
}
