//! Mystery drives, commissioned by the whole program: one marked answer for each seed.
//!
//! `commission` starts the program; here its printed result is compared with what the seed hides.

use std::path::Path;

use serde::Serialize;
use serde_json::Value;

use super::calibration::{ParameterFinding, truths};
use super::judge::{self, Claims};
use super::{Group, Outcome};
use drivebench::diagnosis::{Diagnosis, DiagnosisVerdict, Evidence, diagnose};
use drivebench::emulator::mystery::{Truth, draw};
use drivebench::identification::speed_from_angle;
use drivebench::plant::{Model, Motor, MotorKey, Scenario};
use drivebench::recording::{ColumnMap, ReadOptions, open_run};
use drivebench::report::wording::diagnosis as words;
use drivebench::sample::Verdict;
use drivebench::workflow::{ORDER, sizes};

#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct MysteryAnswer {
    pub seed: u64,
    /// Id of the hidden effect; `(nothing)`.
    pub hidden: String,
    pub verdict: String,
    pub effects: Vec<String>,
    pub outcome: Outcome,
    /// Why it is marked so, or what failed.
    pub reason: String,
    /// Held-out error in units of the noise: of the five-parameter model, and with all that was named.
    pub holdout_before: Option<f64>,
    pub holdout_after: Option<f64>,
    /// Largest error among the hidden effect's sizes, %.
    pub size_error_percent: Option<f64>,
    /// The motor's parameters with their intervals.
    pub parameters: Vec<ParameterFinding>,
}

/// Named in tables where nothing is hidden.
const NOTHING: &str = "(nothing)";

impl MysteryAnswer {
    /// Compares the output of `commission --json` with what the seed hides.
    pub fn of(seed: u64, commissioned: &Value) -> Self {
        let truth = draw(seed).truth;
        let Some(claims) = claims(commissioned) else {
            return Self::failed(seed, "the answer has no verdict".to_owned());
        };
        let outcome = outcome(&truth, &claims);
        let named = truth.effects.iter();
        let named = named.filter(|effect| claims.effects.contains(&effect.id.as_str()));
        let sizes = sizes(named, |id, key| value(commissioned, id, key));
        let diagnosis = &commissioned["diagnosis"];
        Self {
            outcome,
            verdict: diagnosis["verdict"].as_str().unwrap_or_default().to_owned(),
            effects: claims.effects.into_iter().map(str::to_owned).collect(),
            holdout_before: diagnosis["holdout_before"].as_f64(),
            holdout_after: diagnosis["holdout_after"].as_f64(),
            size_error_percent: (sizes.iter())
                .filter_map(|size| Some(size.error_percent?.abs()))
                .max_by(f64::total_cmp),
            parameters: parameters(&truth, commissioned),
            ..Self::failed(seed, outcome.reason().to_owned())
        }
    }

    /// A mystery for which the program gave no answer.
    pub fn failed(seed: u64, reason: String) -> Self {
        Self { seed, hidden: hidden(&draw(seed).truth), reason, ..Self::default() }
    }

    /// What the answer is called in the confusion matrix.
    pub fn column(&self) -> String {
        match self.verdict.as_str() {
            "effect" => self.effects.join(" + "),
            "" => "(failed)".to_owned(),
            verdict => format!("({verdict})"),
        }
    }
}

fn each(list: &Value) -> impl Iterator<Item = &Value> {
    list.as_array().into_iter().flatten()
}

/// What the result claims; none where its verdict is unknown. Of an ambiguous one, all effects that explain the run alike: only
/// the most probable is among its effects.
fn claims(commissioned: &Value) -> Option<Claims<'_>> {
    let diagnosis = &commissioned["diagnosis"];
    let verdict = serde_json::from_value(diagnosis["verdict"].clone()).ok()?;
    let mut effects: Vec<&str> = each(&diagnosis["effects"]).filter_map(Value::as_str).collect();
    if effects.is_empty() {
        effects.extend(diagnosis["effect"].as_str());
    }
    if verdict == DiagnosisVerdict::Ambiguous {
        for pair in each(&diagnosis["confusable"]) {
            let pair = || each(pair).filter_map(Value::as_str);
            if pair().any(|id| effects.contains(&id)) {
                let others: Vec<&str> = pair().filter(|id| !effects.contains(id)).collect();
                effects.extend(others);
            }
        }
    }
    Some(Claims {
        verdict,
        pool: effects.clone(),
        not_excited: each(&diagnosis["candidates"])
            .filter(|candidate| candidate["status"] == "not_excited")
            .filter_map(|candidate| candidate["effect"].as_str())
            .collect(),
        orders: (effects.iter())
            .filter_map(|id| Some((*id, value(commissioned, id, ORDER)?)))
            .collect(),
        effects,
    })
}

/// A parameter of an effect: of the commissioned model, which is fitted with every accepted effect, else of the candidate.
fn value(commissioned: &Value, id: &str, key: &str) -> Option<f64> {
    let name = format!("{id}.{key}");
    let fitted = each(&commissioned["parameters"]).find(|own| own["key"] == name.as_str());
    fitted.and_then(|own| own["value"].as_f64()).or_else(|| {
        let mut candidates = each(&commissioned["diagnosis"]["candidates"]);
        let own = candidates.find(|candidate| candidate["effect"] == id)?;
        own["parameters"][key]["value"].as_f64()
    })
}

/// The motor's parameters of the commissioned model, each with its true value.
fn parameters(truth: &Truth, commissioned: &Value) -> Vec<ParameterFinding> {
    let found = truths(&truth.motor).into_iter().filter_map(|(parameter, truth)| {
        let mut estimates = each(&commissioned["parameters"]);
        let own = estimates.find(|own| own["key"] == parameter.key())?;
        Some(ParameterFinding {
            parameter,
            truth,
            value: own["value"].as_f64()?,
            std: own["std"].as_f64()?,
            verdict: if own["verdict"] == "settled" {
                Verdict::Settled
            } else {
                Verdict::Searching
            },
        })
    });
    found.collect()
}

fn hidden(truth: &Truth) -> String {
    truth.effect().map_or_else(|| NOTHING.to_owned(), |effect| effect.id.clone())
}

fn outcome(truth: &Truth, claims: &Claims<'_>) -> Outcome {
    let (group, right) = match truth.effect() {
        None => (Group::Null, vec![]),
        Some(own) if own.is_foreign => (Group::Unknown, vec![]),
        Some(own) => (Group::Single, vec![vec![own.id.as_str()]]),
    };
    let mut parameters = truth.effects.iter().flat_map(|own| &own.parameters);
    let order = parameters.find(|one| one.key == ORDER).map(|one| one.value);
    judge::outcome(group, &right, &[order], claims)
}

/// A record: its file, which column is what, and the model that its publishers start from.
struct Record {
    machine: &'static str,
    source: &'static str,
    file: &'static str,
    map: &'static str,
    inertia: f64,
    friction: f64,
    effects: &'static [&'static str],
}

const RECORDS: [Record; 2] = [
    Record {
        machine: "linear axis: direct-current motor, ball screw and carriage of 95 kg (force and position; N, m and kg stand for N.m, rad and kg.m2)",
        source: "EMPS benchmark of Janot, Gautier and Brunot, 2019; its model: mass, Coulomb and viscous friction, offset",
        file: "emps/DATA_EMPS.csv",
        map: "time_s=t_s,torque_n_m=force_N,angle_rad=qm_m",
        inertia: 95.0,
        friction: 20.0,
        effects: &["viscous_friction", "constant_load"],
    },
    Record {
        machine: "propeller on a thrust stand (torque and optical speed)",
        source: "github.com/bhabas/sar_simulation, random throttle steps of 2023-12-16; a linear model to begin with",
        file: "sar_bldc/time_constant_2023-12-16.csv",
        map: "time_s=Time (s),torque_n_m=Torque (N·m),speed_rad_s=Motor Optical Speed (rad/s)",
        inertia: 1e-5,
        friction: 1e-3,
        effects: &["viscous_friction"],
    },
];

#[derive(Clone, Debug, Serialize)]
pub struct RecordAnswer {
    pub machine: &'static str,
    pub source: &'static str,
    pub file: &'static str,
    /// The diagnosis' own sentence, or why there is none.
    pub sentence: String,
    pub effects: Vec<&'static str>,
    pub holdout_before: Option<f64>,
    pub holdout_after: Option<f64>,
}

/// Every record whose file is in `folder`.
pub fn records(folder: &Path) -> Vec<RecordAnswer> {
    let at_hand = |record: &&Record| folder.join(record.file).is_file();
    let records = RECORDS.iter().filter(at_hand);
    records.map(|record| answer(record, folder)).collect()
}

/// The files that are looked for.
pub fn files() -> impl Iterator<Item = &'static str> {
    RECORDS.iter().map(|record| record.file)
}

fn answer(record: &Record, folder: &Path) -> RecordAnswer {
    let found = diagnosis(record, folder);
    let error = |of: fn(&Diagnosis) -> f64| found.as_ref().ok().map(of);
    let effects = found.as_ref().map(|found| found.effects.clone());
    RecordAnswer {
        machine: record.machine,
        source: record.source,
        file: record.file,
        holdout_before: error(|found| found.holdout_before),
        holdout_after: error(|found| found.holdout_after),
        effects: effects.unwrap_or_default(),
        sentence: found.map_or_else(|reason| reason, |found| words::diagnosis(&found)),
    }
}

fn diagnosis(record: &Record, folder: &Path) -> Result<Diagnosis, String> {
    let map: ColumnMap = record.map.parse().map_err(|error| format!("{error}"))?;
    let loaded = open_run(&folder.join(record.file), ReadOptions::mapped(&map))
        .map_err(|error| error.to_string())?;
    let run = speed_from_angle::complete(&loaded.run).map_err(|error| error.to_string())?;
    let run = Scenario::from_run(&run).map_err(|error| error.to_string())?;
    let motor = Motor::new("machine")
        .with(MotorKey::Inertia, record.inertia)
        .with(MotorKey::LoadTorque, record.friction);
    let mut model = Model::baseline(motor);
    for id in record.effects {
        model = model.with_effect(id).map_err(|error| error.to_string())?;
    }
    diagnose(&model, Evidence::new(run, None, None)).map_err(|error| error.to_string())
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use drivebench::plant::effect;

    fn seed_of(id: &str) -> u64 {
        let hides = |seed: &u64| hidden(&draw(*seed).truth) == id;
        (0..2000).find(hides).unwrap()
    }

    #[test]
    fn the_marks_are_those_of_the_study() {
        let others: &[_] = &["backlash", "eccentric_load"];
        for (id, verdict, effects, not_excited, expected) in [
            ("cogging", "effect", &["cogging"][..], None, Outcome::Right),
            ("cogging", "effect", &["backlash"], None, Outcome::Wrong),
            ("cogging", "effect", &["cogging", "backlash"], None, Outcome::Wrong),
            ("speed_delay", "effect", &["speed_filter"], None, Outcome::Twin),
            ("cogging", "none", &[], None, Outcome::Abstained),
            ("cogging", "none", &[], Some("cogging"), Outcome::NotExcited),
            ("cogging", "unexplained", &[], None, Outcome::Abstained),
            ("cogging", "ambiguous", &["cogging", "eccentric_load"], None, Outcome::Ambiguous),
            ("cogging", "ambiguous", others, None, Outcome::Wrong),
            (NOTHING, "ambiguous", others, None, Outcome::Wrong),
            ("random_load", "ambiguous", others, None, Outcome::Wrong),
            (NOTHING, "none", &[], None, Outcome::Right),
            (NOTHING, "effect", &["cogging"], None, Outcome::Wrong),
        ] {
            let candidates: Vec<Value> = not_excited
                .iter()
                .map(|id| json!({"effect": id, "status": "not_excited"}))
                .collect();
            let reported = json!({
                "diagnosis": {"verdict": verdict, "effects": effects, "candidates": candidates}
            });
            let found = MysteryAnswer::of(seed_of(id), &reported).outcome;
            assert_eq!(found, expected, "{id}: {verdict} {effects:?}");
        }
    }

    #[test]
    fn a_set_is_all_that_the_answer_leaves_open() {
        let reported = json!({
            "diagnosis": {
                "verdict": "ambiguous", "effects": ["speed_filter"], "candidates": [],
                "confusable": [["speed_filter", "speed_delay"]]
            }
        });
        let answer = MysteryAnswer::of(seed_of("speed_delay"), &reported);
        assert_eq!(answer.outcome, Outcome::Ambiguous);
    }

    /// By the order of the commissioned model, not by that of the candidate.
    #[test]
    fn a_wave_of_another_order_is_not_what_is_hidden() {
        let seed = seed_of("cogging");
        let truth = draw(seed).truth;
        let mut parameters = truth.effects[0].parameters.iter();
        let order = parameters.find(|one| one.key == ORDER).unwrap().value;
        for (fitted, expected) in [(order, Outcome::Right), (2.0 * order, Outcome::Wrong)] {
            let candidate =
                json!({"effect": "cogging", "parameters": {"order": {"value": 3.0 * order}}});
            let reported = json!({
                "diagnosis": {"verdict": "effect", "effects": ["cogging"], "candidates": [candidate]},
                "parameters": [{"key": "cogging.order", "value": fitted}],
            });
            assert_eq!(MysteryAnswer::of(seed, &reported).outcome, expected);
        }
        let none = MysteryAnswer::of(seed, &json!({"diagnosis": {"signals": {}}}));
        assert_eq!(none.outcome, Outcome::Failed);
    }

    #[test]
    fn parameters_are_compared_with_the_true_ones() {
        let seed = seed_of("cogging");
        let truth = draw(seed).truth.motor.resistance_ohm;
        let reported = json!({
            "diagnosis": {"verdict": "effect", "effects": ["cogging"], "candidates": [],
                "holdout_before": 5.0, "holdout_after": 1.02},
            "parameters": [
                {"key": "resistance_ohm", "value": 1.01 * truth, "std": 0.02, "verdict": "settled"},
                {"key": "inertia_kg_m2", "value": null, "std": null, "verdict": "not_observable"}
            ]
        });
        let answer = MysteryAnswer::of(seed, &reported);
        let [own] = answer.parameters.as_slice() else { panic!("{:?}", answer.parameters) };
        assert_eq!(own.verdict, Verdict::Settled);
        assert!((own.value / own.truth - 1.01).abs() < 1e-12);
        assert_eq!(answer.holdout_after, Some(1.02));
    }

    #[test]
    fn every_record_can_be_mapped_and_its_model_is_of_the_catalogue() {
        for record in &RECORDS {
            assert!(record.map.parse::<ColumnMap>().is_ok(), "{}", record.map);
            assert!(record.effects.iter().all(|id| effect::find(id).is_some()));
        }
    }

    #[test]
    fn a_broken_record_is_reported_and_an_absent_one_left_out() {
        let folder = tempfile::tempdir().unwrap();
        assert!(records(folder.path()).is_empty());
        let file = folder.path().join(RECORDS[0].file);
        std::fs::create_dir_all(file.parent().unwrap()).unwrap();
        std::fs::write(&file, "t_s,qm_m\n0,0\n").unwrap();
        let [found] = &records(folder.path())[..] else {
            panic!("one record is at hand");
        };
        assert!(found.effects.is_empty() && found.holdout_after.is_none());
        assert!(found.sentence.contains("force_N"), "{}", found.sentence);
    }
}
