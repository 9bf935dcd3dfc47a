//! A suite from recorded runs: what a machine was found to be, as limits on what it is found to be next time.
//!
//! ```text
//! result.json of each run -> figures (value, standard deviation) -> limits, each with its reason -> SUITE.toml
//! ```
//!
//! A limit of a parameter is where one more run of the same machine falls but for one in [`FALSE_ALARMS`] cases, all
//! parameters of a case together: its own interval and that of the runs, or what the runs differ by where that is more. Where
//! a figure has no interval, the limit is the worst that was seen and a margin, and its reason says so.

use std::fmt::Write as _;

use serde::Serialize;
use serde_json::Value;
use statrs::distribution::{ChiSquared, ContinuousCDF, Normal, StudentsT};

use super::limit::find;
use drivebench_model::numerics::statistics::{extent, mean, variance};
use drivebench_model::text::number::{significant, with_std};

/// Cases of which one fails by chance, where the intervals of the parameters hold.
pub const FALSE_ALARMS: f64 = 1000.0;
/// A parameter may change by this much whatever the runs say: copper that is 5 K warmer has 2 % more resistance.
const AT_LEAST_PERCENT: f64 = 2.0;
/// Runs that differ by more than this share of chance would have them differ, by more than their intervals.
const BY_CHANCE: f64 = 0.95;
/// The worst error that was seen may grow by this.
const ERROR_MARGIN: f64 = 1.25;
/// The same of times and overshoots, which are coarse.
const RESPONSE_MARGIN: f64 = 1.5;
/// Least room for an overshoot, percent of the step.
const OVERSHOOT_POINTS: f64 = 2.0;
/// Effects beyond those that were not shown in the runs: which of them just shows is chance.
const NOT_SHOWN_MORE: usize = 3;

/// What kind of run a result is of, with its verb in a suite.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    Commission,
    Excite,
    Speed,
}

impl Kind {
    fn of(result: &Value) -> Option<Self> {
        if result.get("diagnosis").is_some() {
            Some(Self::Commission)
        } else if result.get("loop").is_some() {
            Some(Self::Speed)
        } else {
            result.get("parameters").map(|_| Self::Excite)
        }
    }

    const fn verb(self) -> &'static str {
        match self {
            Self::Commission => "commission",
            Self::Excite => "excite",
            Self::Speed => "speed",
        }
    }
}

/// A recorded run.
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

/// Where the machine of the runs is found again.
#[derive(Clone, Debug, Default)]
pub struct Place {
    /// Bench file, from the folder of the suite.
    pub bench: String,
    /// The same of the software drive; none where the drive is real.
    pub emulator: Option<String>,
    pub port: String,
    /// Of the software drive.
    pub seed: Option<u64>,
}

/// A limit and where it comes from.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct GoldenLimit {
    pub case: &'static str,
    pub key: String,
    /// As it stands in the suite.
    pub limit: String,
    pub reason: String,
}

/// A suite as text, with its limits.
#[derive(Clone, Debug)]
pub struct Golden {
    pub text: String,
    pub limits: Vec<GoldenLimit>,
}

/// Why a run is not what a machine should be held to: headline and help.
pub type Refused = (String, String);

/// Writes the suite of runs that are of one machine on one bench.
pub fn golden(name: &str, runs: &[GoldenRun], place: &Place) -> Result<Golden, Refused> {
    let mut cases: Vec<(Kind, Vec<&GoldenRun>)> = Vec::new();
    for run in runs {
        let kind = admit(run)?;
        match cases.iter_mut().find(|(own, _)| *own == kind) {
            Some((_, same)) => same.push(run),
            None => cases.push((kind, vec![run])),
        }
    }
    cases.sort_by_key(|(kind, _)| *kind);
    let names = runs.iter().map(|run| format!("#   {}", run.name));
    let mut text = format!(
        "# A machine as it was, held to what it was found to be: by `drivebench init --suite` from\n{}\n\
         # Where the intervals of the parameters hold, one case in {FALSE_ALARMS} fails by chance. More runs, on different days,\n\
         # make the limits those of the machine and not of one day.\n\n\
         name = {}\n",
        names.collect::<Vec<_>>().join("\n"),
        quoted(name)
    );
    let mut limits = Vec::new();
    for (kind, runs) in cases {
        let own = match kind {
            Kind::Commission => commission_limits(&runs)?,
            Kind::Excite => parameter_limits(kind, &runs)?,
            Kind::Speed => response_limits(&runs),
        };
        write_case(&mut text, kind, &runs, place, &own);
        limits.extend(own);
    }
    Ok(Golden { text, limits })
}

/// What kind it is of, where it may be held to.
fn admit(run: &GoldenRun) -> Result<Kind, Refused> {
    let refuse = |what: String, help: &str| Err((format!("{}: {what}", run.name), help.to_owned()));
    if !run.is_whole {
        return refuse(
            "the record is not whole".to_owned(),
            "a machine is held to runs that ended by themselves; record it again",
        );
    }
    match run.outcome.as_deref() {
        Some("passed") => {}
        outcome => {
            return refuse(
                format!("it ended with {:?}", outcome.unwrap_or("no outcome")),
                "a machine is held to runs that passed; record it again",
            );
        }
    }
    match Kind::of(&run.result) {
        Some(kind) => Ok(kind),
        None => refuse(
            "its result is of no commissioning, run or speed loop".to_owned(),
            "give folders that `drivebench commission`, `run` or `speed` made",
        ),
    }
}

fn commission_limits(runs: &[&GoldenRun]) -> Result<Vec<GoldenLimit>, Refused> {
    let case = Kind::Commission.verb();
    // One value per run, or the key is none to hold a machine to.
    let of = |key: &str| -> Option<Vec<Value>> {
        runs.iter().map(|run| find(&run.result, key)).collect()
    };
    let mut limits = Vec::new();
    let mut say = |key: &str, limit: String, reason: String| {
        limits.push(GoldenLimit { case, key: key.to_owned(), limit, reason });
    };
    let answers: Vec<Answer> = runs.iter().map(|run| answer(run)).collect::<Result<_, _>>()?;
    if answers.iter().any(|own| *own != answers[0]) {
        let told: Vec<String> = runs
            .iter()
            .zip(&answers)
            .map(|(run, own)| format!("{}: {}", run.name, own.words()))
            .collect();
        return Err((
            format!("the runs do not agree on what is missing: {}", told.join("; ")),
            "give runs of one machine in one state, or those alone that are right".to_owned(),
        ));
    }
    let what = "what the diagnosis said of every run".to_owned();
    let Answer { verdict, effects } = &answers[0];
    let names: Vec<String> = effects.iter().map(|name| quoted(name)).collect();
    match &names[..] {
        [] => {
            say("verdict", quoted(verdict), what);
            if of("sufficient").is_some_and(|all| all.iter().all(|own| *own == true)) {
                say("sufficient", "true".to_owned(), "no error was left".to_owned());
            }
            // Which effect a run just shows differs from run to run: one without reserve is no promise for the next.
            let open = of("not_shown").unwrap_or_default();
            if let Some(most) = open.iter().filter_map(Value::as_array).map(Vec::len).max() {
                let reason = format!(
                    "{most} effects at most were neither named nor ruled out; which of them a run just shows is chance, so {NOT_SHOWN_MORE} more may be"
                );
                say("not_shown", quoted(&format!("<= {}", most + NOT_SHOWN_MORE)), reason);
            }
        }
        [only] => say("missing", only.clone(), what),
        several => say("missing", format!("[{}]", several.join(", ")), what),
    }
    let errors: Option<Vec<f64>> =
        of("held_out_error").and_then(|all| all.iter().map(Value::as_f64).collect());
    if let Some(errors) = errors {
        let most = extent(&errors).1;
        say(
            "held_out_error",
            quoted(&format!("< {}", significant(ERROR_MARGIN * most.max(1.0), 3))),
            format!(
                "the largest was {} noise floors; a quarter more than that, or than the floor",
                significant(most, 3)
            ),
        );
    }
    limits.extend(parameter_limits(Kind::Commission, runs)?);
    Ok(limits)
}

/// What a diagnosis said, without how much it could rule out: that differs from run to run of one machine.
#[derive(PartialEq)]
struct Answer {
    verdict: String,
    /// In the order of their names.
    effects: Vec<String>,
}

impl Answer {
    fn words(&self) -> String {
        match &self.effects[..] {
            [] => self.verdict.clone(),
            effects => effects.join(", "),
        }
    }
}

/// The answer of a run, where one more run may be held to it.
fn answer(run: &GoldenRun) -> Result<Answer, Refused> {
    let refuse = |what: &str, help: &str| Err((format!("{}: {what}", run.name), help.to_owned()));
    let Some(Value::String(verdict)) = find(&run.result, "verdict") else {
        return refuse(
            "its diagnosis has no verdict",
            "a machine is held to runs that were diagnosed; record it again",
        );
    };
    if verdict == "effect" && find(&run.result, "confirm.confirmed") == Some(Value::Bool(false)) {
        return refuse(
            "its confirming run speaks against what its diagnosis named",
            "a machine is held to what was confirmed; record it again",
        );
    }
    let effects = find(&run.result, "effects");
    let names = effects.iter().filter_map(Value::as_array).flatten();
    let mut effects: Vec<String> = names.filter_map(Value::as_str).map(str::to_owned).collect();
    effects.sort();
    Ok(Answer { verdict, effects })
}

/// The parameters that every run settled.
fn parameter_limits(kind: Kind, runs: &[&GoldenRun]) -> Result<Vec<GoldenLimit>, Refused> {
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
            "a longer or stronger sequence tells more; `drivebench plan` says what can be observed"
                .to_owned(),
        ));
    }
    let level = 1.0 / (FALSE_ALARMS * common.len() as f64);
    Ok(common.iter().map(|own| parameter_limit(kind, own, level)).collect())
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

fn parameter_limit(kind: Kind, runs: &[&Estimate], level: f64) -> GoldenLimit {
    let values: Vec<f64> = runs.iter().map(|own| own.value).collect();
    let count = values.len() as f64;
    let own = mean(&runs.iter().map(|own| own.std.powi(2)).collect::<Vec<_>>()).sqrt();
    let between = if values.len() > 1 { variance(&values).sqrt() } else { 0.0 };
    let freedom = count - 1.0;
    let by_chance = ChiSquared::new(freedom.max(1.0))
        .map_or(f64::INFINITY, |chi| own * (chi.inverse_cdf(BY_CHANCE) / freedom.max(1.0)).sqrt());
    // Two numbers that differ by more than their intervals tell little of how far the next may be: Student's quantile says how
    // little.
    let (std, factor, whose) = if between > by_chance {
        (
            between,
            StudentsT::new(0.0, 1.0, freedom)
                .map_or(f64::INFINITY, |t| t.inverse_cdf(1.0 - level / 2.0)),
            "what the runs differ by",
        )
    } else {
        (own.max(between), Normal::standard().inverse_cdf(1.0 - level / 2.0), "its interval")
    };
    let around = mean(&values);
    let statistical = factor * std * (1.0 + 1.0 / count).sqrt();
    let least = AT_LEAST_PERCENT / 100.0 * around.abs();
    let width = statistical.max(least);
    let unit = &runs[0].unit;
    let seen = if values.len() > 1 {
        format!("{} {unit}, mean of {count} runs", with_std(around, std))
    } else {
        format!("{} {unit}", with_std(around, std))
    };
    let reason = if statistical >= least {
        format!(
            "{seen}; {} standard deviations, from {whose}, for one more run",
            significant(factor, 3)
        )
    } else {
        format!("{seen}; {AT_LEAST_PERCENT} %, more than chance takes it")
    };
    GoldenLimit {
        case: kind.verb(),
        key: runs[0].key.clone(),
        limit: format!("[{}, {}]", number(around - width), number(around + width)),
        reason,
    }
}

/// How a speed loop answers: no interval says how far the next run may be, so that a margin has to.
fn response_limits(runs: &[&GoldenRun]) -> Vec<GoldenLimit> {
    let mut limits = Vec::new();
    let most = |path: &str| {
        let found: Option<Vec<f64>> =
            runs.iter().map(|run| find(&run.result, path)?.as_f64()).collect();
        found.filter(|all| !all.is_empty()).map(|all| extent(&all).1)
    };
    let mut say = |key: String, limit: f64, reason: String| {
        limits.push(GoldenLimit {
            case: Kind::Speed.verb(),
            key,
            limit: quoted(&format!("<= {}", number(limit))),
            reason,
        });
    };
    for part in 0.. {
        let key = format!("loop.tracking.{part}.rms_rad_s");
        let Some(worst) = most(&key) else { break };
        say(
            key,
            ERROR_MARGIN * worst,
            format!("at most {}, and a quarter more", significant(worst, 3)),
        );
    }
    for step in 0.. {
        let key = |figure: &str| format!("loop.steps.{step}.{figure}");
        if most(&key("at_s")).is_none() {
            break;
        }
        if let Some(worst) = most(&key("overshoot_percent")) {
            let limit = (RESPONSE_MARGIN * worst).max(worst + OVERSHOOT_POINTS);
            let reason = format!(
                "at most {} %, and half as much again or {OVERSHOOT_POINTS} points",
                significant(worst, 3)
            );
            say(key("overshoot_percent"), limit, reason);
        }
        if let Some(worst) = most(&key("settling_s")) {
            let reason = format!("at most {} s, and half as much again", significant(worst, 3));
            say(key("settling_s"), RESPONSE_MARGIN * worst, reason);
        }
    }
    limits
}

fn write_case(
    text: &mut String,
    kind: Kind,
    runs: &[&GoldenRun],
    place: &Place,
    limits: &[GoldenLimit],
) {
    let verb = kind.verb();
    let _ = write!(
        text,
        "\n[[case]]\nname = {}\ntags = [\"golden\"]\nbench = {}\n",
        quoted(&format!("{verb}: the machine is as it was")),
        quoted(&place.bench)
    );
    if let Some(emulator) = &place.emulator {
        let _ = writeln!(text, "emulator = {}", quoted(emulator));
    }
    let _ = writeln!(text, "port = {}", quoted(&place.port));
    if let Some(seed) = place.seed {
        let _ =
            writeln!(text, "# The specimen of the software drive, and its noise.\nseed = {seed}");
    }
    // Every run of one excitation, or the suite has to choose one.
    let seed = runs.first().and_then(|run| run.seed);
    let options = match (kind, seed) {
        (Kind::Excite, Some(seed)) if runs.iter().all(|run| run.seed == Some(seed)) => {
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

/// A text as TOML takes it.
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

    fn place() -> Place {
        Place { bench: "bench.toml".to_owned(), port: "sim:".to_owned(), ..Place::default() }
    }

    /// Half the width of the limit of the resistance, in ohm.
    fn width(runs: &[GoldenRun]) -> f64 {
        let made = golden("m", runs, &place()).unwrap();
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
    fn a_run_that_is_not_whole_or_tripped_is_not_held_to() {
        let refused = |change: fn(&mut GoldenRun)| {
            let mut own = run("runs/a", 1.0, 0.1);
            change(&mut own);
            golden("m", &[run("runs/b", 1.0, 0.1), own], &place()).unwrap_err().0
        };
        assert!(refused(|run| run.is_whole = false).contains("runs/a: the record is not whole"));
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
    fn held_to(runs: &[GoldenRun]) -> Result<Vec<(String, String)>, String> {
        let made = golden("m", runs, &place()).map_err(|(what, _)| what)?;
        let all = made.limits.into_iter().map(|own| (own.key, own.limit));
        Ok(all.filter(|(key, _)| key != "resistance_ohm").collect())
    }

    #[test]
    fn what_runs_agree_on_is_held_to_whatever_they_could_rule_out() {
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
        // Without reserve or with it: the next run may leave an effect open.
        assert_eq!(held_to(&[of(0), of(0)]).unwrap(), nothing("\"<= 3\""));
        assert_eq!(held_to(&[of(0), of(2)]).unwrap(), nothing("\"<= 5\""));
        assert_eq!(held_to(&[of(1), of(2)]).unwrap(), nothing("\"<= 5\""));
        let named =
            |effects: &[&str]| held_to(&[diagnosed("effect", effects, 0)]).unwrap()[0].clone();
        assert_eq!(named(&["cogging"]).1, "\"cogging\"");
        assert_eq!(named(&["b", "a"]).1, "[\"a\", \"b\"]");
        assert_eq!(held_to(&[diagnosed("unexplained", &[], 0)]).unwrap()[0].1, "\"unexplained\"");
        // What one of them does not say of itself is no limit.
        let mut silent = of(0);
        silent.result["diagnosis"].as_object_mut().unwrap().remove("sufficient");
        silent.result["diagnosis"].as_object_mut().unwrap().remove("holdout_after");
        let keys: Vec<String> =
            held_to(&[silent, of(0)]).unwrap().into_iter().map(|(key, _)| key).collect();
        assert_eq!(keys, ["verdict", "not_shown"]);
    }

    #[test]
    fn runs_that_do_not_agree_are_no_machine_to_hold_to() {
        let nothing = diagnosed("none", &[], 1);
        let unknown = diagnosed("unexplained", &[], 0);
        let cogging = diagnosed("effect", &["cogging"], 0);
        for other in [&unknown, &cogging] {
            let told = held_to(&[nothing.clone(), other.clone()]).unwrap_err();
            assert!(told.contains("do not agree"), "{told}");
        }
        let mut silent = nothing.clone();
        silent.result["diagnosis"] = Value::Null;
        let told = held_to(&[nothing, silent]).unwrap_err();
        assert!(told.contains("no verdict"), "{told}");
        let mut refuted = cogging;
        refuted.result["diagnosis"]["confirm"] = json!({ "confirmed": false });
        let told = held_to(&[refuted]).unwrap_err();
        assert!(told.contains("speaks against"), "{told}");
    }
}
