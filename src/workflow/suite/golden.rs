//! A suite from recorded runs: the results of a machine as limits on its next result.
//!
//! ```text
//! result.json of each run -> figures (value, standard deviation) -> limits, each with its reason -> SUITE.toml
//! ```
//!
//! The limit of a parameter is a prediction interval for one more run of the same machine (Hahn and Meeker 1991): its own
//! interval and that of the runs, or the spread of the runs where that is larger. A figure without an interval is limited to
//! the worst of the runs and a margin.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use serde::Serialize;
use serde_json::Value;
use statrs::distribution::{ChiSquared, ContinuousCDF, Normal, StudentsT};

use super::limit::find;
use drivebench_model::numerics::statistics::{extent, mean, variance};
use drivebench_model::text::number::{significant, with_std};

/// Cases of which one fails by chance, all parameters of a case together.
const FALSE_ALARMS: f64 = 1000.0;

/// A figure of a part of a speed loop: key, unit, limit by the worst of the runs, and the margin in words.
type Figure = (&'static str, &'static str, fn(f64) -> f64, &'static str);

/// The parts of a speed loop's result with the figure that each part has. Times and overshoots are coarse.
const RESPONSE: [(&str, &str, &[Figure]); 2] = [
    ("tracking", "rms_rad_s", &[("rms_rad_s", "", |worst| 1.25 * worst, "a quarter more")]),
    (
        "steps",
        "at_s",
        &[
            (
                "overshoot_percent",
                " %",
                |worst| (1.5 * worst).max(worst + 2.0),
                "half as much again or 2 points",
            ),
            ("settling_s", " s", |worst| 1.5 * worst, "half as much again"),
        ],
    ),
];

/// The step of a suite that makes a result like this one; in the order of the cases.
fn verb(result: &Value) -> Option<&'static str> {
    let verbs = [("diagnosis", "commission"), ("loop", "speed"), ("parameters", "excite")];
    verbs.into_iter().find(|(key, _)| result.get(key).is_some()).map(|(_, verb)| verb)
}

#[derive(Clone, Debug)]
pub struct GoldenRun {
    /// Its folder, for messages.
    pub name: String,
    pub is_whole: bool,
    /// As the manifest has it.
    pub outcome: Option<String>,
    pub result: Value,
    /// Of the excitation.
    pub seed: Option<u64>,
}

/// Where the suite finds the machine of the runs.
#[derive(Clone, Debug, Default)]
pub struct SuiteTarget {
    /// Bench file, from the folder of the suite.
    pub bench: String,
    /// The same of the software drive; none where the drive is real.
    pub emulator: Option<String>,
    pub port: String,
    /// Of the software drive.
    pub seed: Option<u64>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct GoldenLimit {
    pub case: &'static str,
    pub key: String,
    pub limit: String,
    pub reason: String,
}

#[derive(Clone, Debug)]
pub struct Golden {
    pub text: String,
    pub limits: Vec<GoldenLimit>,
}

/// Why a run cannot set limits: headline and help.
pub type Refused = (String, String);

/// Writes the suite of runs that are of one machine on one bench.
pub fn golden(name: &str, runs: &[GoldenRun], target: &SuiteTarget) -> Result<Golden, Refused> {
    let mut cases: BTreeMap<&'static str, Vec<&GoldenRun>> = BTreeMap::new();
    for run in runs {
        cases.entry(admit(run)?).or_default().push(run);
    }
    let mut text = format!(
        "# Limits of a machine from its runs, by `drivebench init --suite`:\n{}\n\
         # Where the intervals of the parameters are right, one case in {} fails by chance. More runs, on different days,\n\
         # include the variation from day to day in the limits.\n\n\
         name = {}\n",
        runs.iter().map(|run| format!("#   {}", run.name)).collect::<Vec<_>>().join("\n"),
        FALSE_ALARMS,
        quoted(name)
    );
    let mut limits = Vec::new();
    for (verb, runs) in cases {
        let own = match verb {
            "commission" => commission_limits(&runs)?,
            "speed" => response_limits(&runs),
            _ => parameter_limits(verb, &runs)?,
        };
        write_case(&mut text, verb, &runs, target, &own);
        limits.extend(own);
    }
    Ok(Golden { text, limits })
}

fn refused<T>(run: &GoldenRun, what: &str, help: &str) -> Result<T, Refused> {
    Err((format!("{}: {what}", run.name), help.to_owned()))
}

/// The verb of a run that can set limits.
fn admit(run: &GoldenRun) -> Result<&'static str, Refused> {
    if !run.is_whole {
        let help = "limits are set by runs that ended by themselves; record it again";
        return refused(run, "the record is incomplete", help);
    }
    let outcome = run.outcome.as_deref().unwrap_or("no outcome");
    if outcome != "passed" {
        let help = "limits are set by runs that passed; record it again";
        return refused(run, &format!("it ended with {outcome:?}"), help);
    }
    let what = "its result is of no commissioning, run or speed loop";
    let help = "give folders that `drivebench commission`, `run` or `speed` made";
    verb(&run.result).map_or_else(|| refused(run, what, help), Ok)
}

fn commission_limits(runs: &[&GoldenRun]) -> Result<Vec<GoldenLimit>, Refused> {
    let case = "commission";
    // One value per run, else the key has no limit.
    let of = |key: &str| -> Option<Vec<Value>> {
        runs.iter().map(|run| find(&run.result, key)).collect()
    };
    let mut limits = Vec::new();
    let mut limit = |key: &str, limit: String, reason: String| {
        limits.push(GoldenLimit { case, key: key.to_owned(), limit, reason });
    };
    let answers: Vec<Answer> = runs.iter().map(|run| answer(run)).collect::<Result<_, _>>()?;
    let (verdict, effects) = &answers[0];
    if answers.iter().any(|own| *own != answers[0]) {
        let in_words = runs.iter().zip(&answers).map(|(run, (verdict, effects))| {
            let answer = if effects.is_empty() { verdict.clone() } else { effects.join(", ") };
            format!("{}: {answer}", run.name)
        });
        return Err((
            format!(
                "the runs do not agree on what is missing: {}",
                in_words.collect::<Vec<_>>().join("; ")
            ),
            "give runs of one machine in one state, or those alone that are right".to_owned(),
        ));
    }
    let what = "the diagnosis of every run".to_owned();
    match &effects.iter().map(|name| quoted(name)).collect::<Vec<_>>()[..] {
        [] => {
            limit("verdict", quoted(verdict), what);
            if of("sufficient").is_some_and(|all| all.iter().all(|own| *own == true)) {
                limit(
                    "sufficient",
                    "true".to_owned(),
                    "no error above the noise was left".to_owned(),
                );
            }
            // Which effect a run just shows varies from run to run, so that the next run may show fewer.
            let open = of("not_shown").unwrap_or_default();
            if let Some(most) = open.iter().filter_map(Value::as_array).map(Vec::len).max() {
                let more = 3;
                let reason = format!(
                    "{most} effects at most were neither named nor ruled out; which of them a run just shows varies, so that {more} more are allowed"
                );
                limit("not_shown", quoted(&format!("<= {}", most + more)), reason);
            }
        }
        [only] => limit("missing", only.clone(), what),
        several => limit("missing", format!("[{}]", several.join(", ")), what),
    }
    let errors: Option<Vec<f64>> =
        of("held_out_error").and_then(|all| all.iter().map(Value::as_f64).collect());
    if let Some(most) = errors.map(|errors| extent(&errors).1) {
        limit(
            "held_out_error",
            quoted(&format!("< {}", significant(1.25 * most.max(1.0), 3))),
            format!(
                "the largest was {} noise floors; a quarter more than that, or than the floor",
                significant(most, 3)
            ),
        );
    }
    limits.extend(parameter_limits(case, runs)?);
    Ok(limits)
}

/// Verdict and effects, in the order of their names, of a diagnosis; not how much it could rule out, which differs from run
/// to run of one machine.
type Answer = (String, Vec<String>);

/// The diagnosis of a run, where it can set a limit.
fn answer(run: &GoldenRun) -> Result<Answer, Refused> {
    let Some(Value::String(verdict)) = find(&run.result, "verdict") else {
        let help = "limits are set by runs that were diagnosed; record it again";
        return refused(run, "its diagnosis has no verdict", help);
    };
    if verdict == "effect" && find(&run.result, "confirm.confirmed") == Some(Value::Bool(false)) {
        let what = "its confirming run contradicts its diagnosis";
        return refused(run, what, "limits are set by confirmed diagnoses; record it again");
    }
    let effects = find(&run.result, "effects");
    let names = effects.iter().filter_map(Value::as_array).flatten();
    let mut effects: Vec<String> = names.filter_map(Value::as_str).map(str::to_owned).collect();
    effects.sort();
    Ok((verdict, effects))
}

/// The parameters that every run settled.
fn parameter_limits(case: &'static str, runs: &[&GoldenRun]) -> Result<Vec<GoldenLimit>, Refused> {
    let settled: Vec<Vec<Estimate>> = runs.iter().map(|run| estimates(&run.result)).collect();
    let of_key = |key: &str| -> Option<Vec<&Estimate>> {
        settled.iter().map(|run| run.iter().find(|own| own.key == key)).collect()
    };
    let first = settled.first().into_iter().flatten();
    let common: Vec<Vec<&Estimate>> = first.filter_map(|own| of_key(&own.key)).collect();
    if common.is_empty() {
        let names: Vec<&str> = runs.iter().map(|run| run.name.as_str()).collect();
        return Err((
            format!("no parameter was settled in every one of {}", names.join(", ")),
            "a longer or stronger sequence determines more; `drivebench plan` shows what is observable"
                .to_owned(),
        ));
    }
    let level = 1.0 / (FALSE_ALARMS * common.len() as f64);
    Ok(common.iter().map(|own| parameter_limit(case, own, level)).collect())
}

struct Estimate {
    key: String,
    value: f64,
    std: f64,
    unit: String,
}

/// The settled parameters of a result, in either form of its table.
fn estimates(result: &Value) -> Vec<Estimate> {
    let read = |key: &str, own: &Value| {
        (own["verdict"] == "settled").then_some(())?;
        Some(Estimate {
            key: key.to_owned(),
            value: own["value"].as_f64()?,
            std: own["std"].as_f64()?,
            unit: own["unit"].as_str().unwrap_or_default().to_owned(),
        })
    };
    match &result["parameters"] {
        Value::Array(rows) => {
            rows.iter().filter_map(|own| read(own["key"].as_str()?, own)).collect()
        }
        Value::Object(rows) => rows.iter().filter_map(|(key, own)| read(key, own)).collect(),
        _ => Vec::new(),
    }
}

fn parameter_limit(case: &'static str, runs: &[&Estimate], level: f64) -> GoldenLimit {
    let values: Vec<f64> = runs.iter().map(|own| own.value).collect();
    let count = values.len() as f64;
    let own = mean(&runs.iter().map(|own| own.std.powi(2)).collect::<Vec<_>>()).sqrt();
    let between = if values.len() > 1 { variance(&values).sqrt() } else { 0.0 };
    let freedom = count - 1.0;
    // Beyond this spread of the runs is that of the machine, not of their intervals.
    let by_chance = ChiSquared::new(freedom.max(1.0))
        .map_or(f64::INFINITY, |chi| own * (chi.inverse_cdf(0.95) / freedom.max(1.0)).sqrt());
    // Few runs that differ by more than their intervals: the quantile of Student's distribution.
    let (std, factor, whose) = if between > by_chance {
        (
            between,
            StudentsT::new(0.0, 1.0, freedom)
                .map_or(f64::INFINITY, |t| t.inverse_cdf(1.0 - level / 2.0)),
            "the spread of the runs",
        )
    } else {
        (own.max(between), Normal::standard().inverse_cdf(1.0 - level / 2.0), "its interval")
    };
    let around = mean(&values);
    let statistical = factor * std * (1.0 + 1.0 / count).sqrt();
    // Copper that is 5 K warmer has 2 % more resistance.
    let percent = 2.0;
    let least = percent / 100.0 * around.abs();
    let width = statistical.max(least);
    let unit = &runs[0].unit;
    let found = if values.len() > 1 {
        format!("{} {unit}, mean of {count} runs", with_std(around, std))
    } else {
        format!("{} {unit}", with_std(around, std))
    };
    let reason = if statistical >= least {
        format!(
            "{found}; {} standard deviations, from {whose}, for one more run",
            significant(factor, 3)
        )
    } else {
        format!("{found}; {percent} %, more than the variation by chance")
    };
    GoldenLimit {
        case,
        key: runs[0].key.clone(),
        limit: format!("[{}, {}]", number(around - width), number(around + width)),
        reason,
    }
}

/// The response of a speed loop has no interval for the next run, but a margin.
fn response_limits(runs: &[&GoldenRun]) -> Vec<GoldenLimit> {
    let worst = |key: &str| {
        let found = runs.iter().map(|run| find(&run.result, key)?.as_f64());
        Some(extent(&found.collect::<Option<Vec<f64>>>()?).1)
    };
    let mut limits = Vec::new();
    for (list, first, figures) in RESPONSE {
        let key = |part: usize, figure: &str| format!("loop.{list}.{part}.{figure}");
        for part in (0..).take_while(|part| worst(&key(*part, first)).is_some()) {
            for (figure, unit, limit, margin) in figures {
                let key = key(part, figure);
                limits.extend(worst(&key).map(|worst| GoldenLimit {
                    case: "speed",
                    key,
                    limit: quoted(&format!("<= {}", number(limit(worst)))),
                    reason: format!("at most {}{unit}, and {margin}", significant(worst, 3)),
                }));
            }
        }
    }
    limits
}

fn write_case(
    text: &mut String,
    verb: &str,
    runs: &[&GoldenRun],
    target: &SuiteTarget,
    limits: &[GoldenLimit],
) {
    let _ = write!(
        text,
        "\n[[case]]\nname = {}\ntags = [\"golden\"]\nbench = {}\n",
        quoted(&format!("{verb}: the machine has not changed")),
        quoted(&target.bench)
    );
    if let Some(emulator) = &target.emulator {
        let _ = writeln!(text, "emulator = {}", quoted(emulator));
    }
    let _ = writeln!(text, "port = {}", quoted(&target.port));
    if let Some(seed) = target.seed {
        let _ =
            writeln!(text, "# The specimen of the software drive, and its noise.\nseed = {seed}");
    }
    // Every run of one excitation, or the suite has to choose one.
    let seed = runs.first().and_then(|run| run.seed);
    let options = match (verb, seed) {
        ("excite", Some(seed)) if runs.iter().all(|run| run.seed == Some(seed)) => {
            format!("{{ run_seed = {seed} }}")
        }
        _ => "{}".to_owned(),
    };
    let _ =
        write!(text, "\n[[case.step]]\n{verb} = {options}\n\n[[case.step]]\n[case.step.assert]\n");
    for limit in limits {
        let is_bare =
            limit.key.chars().all(|letter| letter.is_ascii_alphanumeric() || letter == '_');
        let key = if is_bare { limit.key.clone() } else { quoted(&limit.key) };
        let _ = writeln!(text, "# {}\n{key} = {}", limit.reason, limit.limit);
    }
}

/// Six digits, as TOML takes them.
fn number(value: f64) -> String {
    let text = significant(value, 6);
    if text.contains(['.', 'e']) { text } else { format!("{text}.0") }
}

fn quoted(text: &str) -> String {
    toml::Value::String(text.to_owned()).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn run(name: &str, resistance_ohm: f64, std: f64) -> GoldenRun {
        let own = |value: f64, std: f64, verdict: &str| json!({ "value": value, "std": std, "unit": "ohm", "verdict": verdict });
        GoldenRun {
            name: name.to_owned(),
            is_whole: true,
            outcome: Some("passed".to_owned()),
            result: json!({ "parameters": {
                "resistance_ohm": own(resistance_ohm, std, "settled"),
                "inductance_h": own(0.01, 0.1, "searching"),
            } }),
            seed: Some(1),
        }
    }

    fn target() -> SuiteTarget {
        SuiteTarget {
            bench: "bench.toml".to_owned(),
            port: "sim:".to_owned(),
            ..SuiteTarget::default()
        }
    }

    /// Half the width of the limit of the resistance, in ohm.
    fn width(runs: &[GoldenRun]) -> f64 {
        let made = golden("m", runs, &target()).unwrap();
        assert_eq!(made.limits.len(), 1, "what is not settled is no limit");
        let table: toml::Table =
            toml::from_str(&format!("limit = {}", made.limits[0].limit)).unwrap();
        let ends = table["limit"].as_array().unwrap();
        0.5 * (ends[1].as_float().unwrap() - ends[0].as_float().unwrap())
    }

    #[test]
    fn a_limit_is_as_wide_as_chance_takes_one_more_run() {
        // 3.29 deviations of a difference of two runs, one case in 1,000.
        let one = width(&[run("a", 1.0, 0.1)]);
        assert!((one - 3.2905 * 0.1 * 2f64.sqrt()).abs() < 1e-3, "{one}");
        // More runs of the same: only the next one is left to chance.
        let many: Vec<GoldenRun> = (0..9).map(|_| run("a", 1.0, 0.1)).collect();
        assert!((width(&many) - 3.2905 * 0.1 * (10f64 / 9.0).sqrt()).abs() < 1e-3);
        // Runs that differ by more than their intervals: their spread is the machine's.
        let spread: Vec<GoldenRun> =
            [0.97, 0.99, 1.0, 1.01, 1.03].map(|value| run("a", value, 1e-4)).into();
        let wide = width(&spread);
        assert!(wide > 8.0 * 0.022 && wide < 10.0 * 0.022, "{wide}");
        // A parameter that is known to the last digit may still warm.
        assert!((width(&[run("a", 1.0, 1e-6)]) - 0.02).abs() < 1e-6);
    }

    #[test]
    fn an_incomplete_or_tripped_run_sets_no_limits() {
        let refused = |change: fn(&mut GoldenRun)| {
            let mut own = run("runs/a", 1.0, 0.1);
            change(&mut own);
            golden("m", &[run("runs/b", 1.0, 0.1), own], &target()).unwrap_err().0
        };
        assert!(refused(|run| run.is_whole = false).contains("runs/a: the record is incomplete"));
        let trip = refused(|run| run.outcome = Some("safety trip: over-speed".to_owned()));
        assert!(trip.contains("safety trip: over-speed"), "{trip}");
        assert!(refused(|run| run.result = json!({})).contains("no commissioning"));
        let unknown = refused(|run| {
            run.result["parameters"]["resistance_ohm"]["verdict"] = json!("searching");
        });
        assert!(unknown.contains("no parameter was settled"), "{unknown}");
    }

    /// A commissioning; `open` effects were neither named nor ruled out.
    fn diagnosed(verdict: &str, effects: &[&str], open: usize) -> GoldenRun {
        let mut own = run("a", 1.0, 0.1);
        let candidates = vec![json!({ "effect": "x", "status": "not_observable" }); open];
        own.result["diagnosis"] = json!({
            "verdict": verdict, "effects": effects, "sufficient": verdict != "unexplained",
            "candidates": candidates, "holdout_after": 1.0,
        });
        own
    }

    /// The limits but for those of the parameters.
    fn limits_of(runs: &[GoldenRun]) -> Result<Vec<(String, String)>, String> {
        let made = golden("m", runs, &target()).map_err(|(what, _)| what)?;
        let all = made.limits.into_iter().map(|own| (own.key, own.limit));
        Ok(all.filter(|(key, _)| key != "resistance_ohm").collect())
    }

    #[test]
    fn a_common_diagnosis_of_the_runs_sets_limits() {
        let texts = |all: &[(&str, &str)]| -> Vec<(String, String)> {
            all.iter().map(|(key, limit)| ((*key).to_owned(), (*limit).to_owned())).collect()
        };
        let nothing = |not_shown| {
            texts(&[
                ("verdict", "\"none\""),
                ("sufficient", "true"),
                ("not_shown", not_shown),
                ("held_out_error", "\"< 1.25\""),
            ])
        };
        let of = |open| diagnosed("none", &[], open);
        // Whether the runs leave effects open or not: the next run may leave some open.
        assert_eq!(limits_of(&[of(0), of(0)]).unwrap(), nothing("\"<= 3\""));
        assert_eq!(limits_of(&[of(0), of(2)]).unwrap(), nothing("\"<= 5\""));
        assert_eq!(limits_of(&[of(1), of(2)]).unwrap(), nothing("\"<= 5\""));
        let named =
            |effects: &[&str]| limits_of(&[diagnosed("effect", effects, 0)]).unwrap()[0].clone();
        assert_eq!(named(&["cogging"]).1, "\"cogging\"");
        assert_eq!(named(&["b", "a"]).1, "[\"a\", \"b\"]");
        assert_eq!(limits_of(&[diagnosed("unexplained", &[], 0)]).unwrap()[0].1, "\"unexplained\"");
        // A key that one of them lacks has no limit.
        let mut incomplete = of(0);
        incomplete.result["diagnosis"].as_object_mut().unwrap().remove("sufficient");
        incomplete.result["diagnosis"].as_object_mut().unwrap().remove("holdout_after");
        let keys: Vec<String> =
            limits_of(&[incomplete, of(0)]).unwrap().into_iter().map(|(key, _)| key).collect();
        assert_eq!(keys, ["verdict", "not_shown"]);
    }

    #[test]
    fn runs_that_do_not_agree_set_no_limits() {
        let nothing = diagnosed("none", &[], 1);
        let unknown = diagnosed("unexplained", &[], 0);
        let cogging = diagnosed("effect", &["cogging"], 0);
        for other in [&unknown, &cogging] {
            let refusal = limits_of(&[nothing.clone(), other.clone()]).unwrap_err();
            assert!(refusal.contains("do not agree"), "{refusal}");
        }
        let mut incomplete = nothing.clone();
        incomplete.result["diagnosis"] = Value::Null;
        let refusal = limits_of(&[nothing, incomplete]).unwrap_err();
        assert!(refusal.contains("no verdict"), "{refusal}");
        let mut refuted = cogging;
        refuted.result["diagnosis"]["confirm"] = json!({ "confirmed": false });
        let refusal = limits_of(&[refuted]).unwrap_err();
        assert!(refusal.contains("contradicts"), "{refusal}");
    }
}
