//! A machine whose truth is known, the question put to the program as its owner would put it, and the judgement of the answer.

use std::fs::{self, File};
use std::path::Path;
use std::process::{Command, Stdio};
use std::thread::sleep;
use std::time::Duration;

use rustix::process::{Pid, WaitId, WaitIdOptions, waitid};
use serde_json::Value;

use super::bench::{Log, Run};

/// A name that is given with more than this is taken for certain.
const CERTAIN: f64 = 0.9;
/// Processor time after which no answer is waited for, s: only a search without end takes so long.
const PATIENCE_S: f64 = 120.0;
/// Characters of a reason that the table has room for.
const LONGEST_REASON: usize = 160;
const POLL: Duration = Duration::from_millis(10);
/// Ticks of the kernel's count of processor time in a second: the same on every Linux.
const TICKS_PER_S: f64 = 100.0;

/// A machine, and how its owner's records are to be read.
pub(crate) struct Case {
    pub(crate) name: &'static str,
    /// What `--map` is given.
    pub(crate) map: &'static str,
    /// R, L, K, J, Mc of the nameplate that its owner gives as a model file.
    pub(crate) nameplate: Option<[f64; 5]>,
    pub(crate) truth: Truth,
    pub(crate) record: fn(u64, Run) -> Log,
}

/// What the baseline misses of a machine, in the words of the catalogue.
pub(crate) enum Truth {
    Nothing,
    /// Any name of each group is right; what is there besides may be named, or not.
    Effects {
        missing: &'static [&'static [&'static str]],
        also: &'static [&'static str],
    },
    /// Something that the catalogue does not have; names that are no lie all the same.
    Unknown {
        akin: &'static [&'static str],
    },
}

impl Truth {
    fn groups(&self) -> &'static [&'static [&'static str]] {
        match self {
            Self::Effects { missing, .. } => missing,
            _ => &[],
        }
    }

    fn is_true(&self, name: &str) -> bool {
        let also = match self {
            Self::Nothing => &[][..],
            Self::Effects { also, .. } => also,
            Self::Unknown { akin } => akin,
        };
        also.contains(&name) || self.groups().iter().any(|group| group.contains(&name))
    }

    fn in_words(&self) -> String {
        match self {
            Self::Nothing => "nothing".to_owned(),
            Self::Effects { missing, .. } => {
                missing.iter().map(|group| group.join("/")).collect::<Vec<_>>().join("+")
            }
            Self::Unknown { .. } => "not in the catalogue".to_owned(),
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Judgement {
    Right,
    /// Not all of the truth, and nothing but the truth.
    Honest,
    Wrong,
}

impl Judgement {
    const fn word(self) -> &'static str {
        match self {
            Self::Right => "right",
            Self::Honest => "honest",
            Self::Wrong => "WRONG",
        }
    }
}

/// One line of the table.
pub(crate) struct Outcome {
    pub(crate) judgement: Judgement,
    /// Whether a name that is not true was given as certain.
    pub(crate) is_misnamed: bool,
    /// Whether an effect that is there was ruled out.
    pub(crate) is_denied: bool,
    /// Whether an answer came at all.
    pub(crate) has_ended: bool,
    pub(crate) line: String,
}

/// What the program said, as far as it is judged.
struct Said<'a> {
    answer: &'a Value,
}

impl<'a> Said<'a> {
    fn verdict(&self) -> &'a str {
        self.answer["verdict"].as_str().unwrap_or_default()
    }

    fn named(&self) -> Vec<(&'a str, f64)> {
        let names = self.answer["effects"].as_array();
        let names = names.into_iter().flatten().filter_map(Value::as_str);
        names
            .map(|name| {
                let own = self.candidate(name);
                let probability = own.and_then(|own| own["probability"].as_f64());
                (name, probability.unwrap_or(f64::NAN))
            })
            .collect()
    }

    fn candidate(&self, name: &str) -> Option<&'a Value> {
        let mut all = self.answer["candidates"].as_array()?.iter();
        all.find(|own| own["effect"] == name)
    }

    fn status(&self, name: &str) -> &'a str {
        let own = self.candidate(name);
        own.and_then(|own| own["status"].as_str()).unwrap_or("-")
    }

    /// Whether it says that it cannot tell this name from one of the others.
    fn cannot_tell(&self, name: &str, truth: &Truth) -> bool {
        let pairs = self.answer["confusable"].as_array();
        let pairs = pairs
            .into_iter()
            .flatten()
            .filter_map(|pair| Some([pair[0].as_str()?, pair[1].as_str()?]));
        pairs.into_iter().any(|[first, second]| {
            (first == name && truth.is_true(second)) || (second == name && truth.is_true(first))
        })
    }
}

/// What an answer is worth.
struct Judged {
    judgement: Judgement,
    is_misnamed: bool,
    is_denied: bool,
    why: String,
}

/// Judges an answer; the reason where it is not right.
fn judged(truth: &Truth, said: &Said<'_>) -> Judged {
    let named = said.named();
    let groups = truth.groups();
    let has = |group: &&[&str]| named.iter().any(|(name, _)| group.contains(name));
    let is_named = groups.iter().all(has);
    let denied = groups.iter().find(|group| {
        let mut names = group.iter();
        !has(group) && names.all(|name| said.status(name) == "ruled_out")
    });
    let is_false = |name: &str| !truth.is_true(name) && !said.cannot_tell(name, truth);
    let misnamed =
        named.iter().find(|(name, probability)| is_false(name) && *probability > CERTAIN);
    let guessed = named.iter().find(|(name, _)| is_false(name));
    let sentence = said.answer["sentence"].as_str().unwrap_or_default();
    let right_if = |is_right: bool| {
        if is_right { Judgement::Right } else { Judgement::Honest }
    };
    let (judgement, why) = if let Some((name, _)) = misnamed {
        (Judgement::Wrong, format!("{name} is not there: {sentence}"))
    } else if let Some(group) = denied {
        (Judgement::Wrong, format!("{} is ruled out", group.join("/")))
    } else {
        match (said.verdict(), truth) {
            // A guess as a part of what stays unexplained is none of the whole.
            ("unexplained", Truth::Unknown { .. }) => (Judgement::Right, sentence.to_owned()),
            ("unexplained", _) => {
                let is_right = is_named && !groups.is_empty();
                (right_if(is_right), sentence.to_owned())
            }
            ("none", Truth::Nothing) => (Judgement::Right, String::new()),
            // What is missing is observable in every record, also where the noise is not known.
            ("none", _) if said.answer["sufficient"] == true => {
                (Judgement::Wrong, sentence.to_owned())
            }
            ("none" | "not_fitted", _) => (Judgement::Honest, sentence.to_owned()),
            ("effect" | "ambiguous", _) => match guessed {
                Some((name, _)) => (Judgement::Wrong, format!("{name} is not there")),
                None => (right_if(is_named), sentence.to_owned()),
            },
            (other, _) => (Judgement::Wrong, format!("no verdict: {other:?}")),
        }
    };
    Judged {
        judgement,
        is_misnamed: misnamed.is_some(),
        is_denied: denied.is_some(),
        why: if judgement == Judgement::Right {
            String::new()
        } else {
            why.chars().take(LONGEST_REASON).collect()
        },
    }
}

/// Records the machine, asks the program, and judges what it says.
pub(crate) fn trial(case: &Case, seed: u64, folder: &Path) -> Outcome {
    fs::create_dir_all(folder).expect("a folder for the records");
    let mut rows = 0;
    for run in Run::ALL {
        let log = (case.record)(seed, run);
        rows = rows.max(log.rows.len());
        let file = folder.join(format!("{}.csv", run.name()));
        fs::write(file, log.text()).expect("the record is written");
    }
    let mut command = Command::new(env!("CARGO_BIN_EXE_drivebench"));
    command.current_dir(folder).args([
        "diagnose",
        "fit.csv",
        "--holdout",
        "holdout.csv",
        "--confirm",
        "confirm.csv",
        "--json",
    ]);
    command.args(["--map", case.map]);
    if let Some([r, l, k, j, dry]) = case.nameplate {
        let model = format!(
            "[motor]\nname = \"plate\"\nresistance_ohm = {r}\ninductance_h = {l}\nback_emf_v_s_per_rad = {k}\n\
             inertia_kg_m2 = {j}\nload_torque_n_m = {dry}\n"
        );
        fs::write(folder.join("model.toml"), model).expect("the model is written");
        command.args(["--model", "model.toml"]);
    }
    let (status, took_s) = run_to_its_end(&mut command, folder);
    let stdout = fs::read_to_string(folder.join("stdout")).unwrap_or_default();
    let stderr = fs::read_to_string(folder.join("stderr")).unwrap_or_default();
    let head = format!(
        "{:<42} {seed:>4} {rows:>5} {took_s:>6.1}  {:<26}",
        case.name,
        case.truth.in_words()
    );
    let answer: Value = serde_json::from_str(&stdout).unwrap_or_default();
    if status != Some(0) {
        // A refusal names nothing; that the record of a machine in order is refused is wrong all the same.
        let last = stderr.lines().rfind(|line| line.starts_with("error: "));
        let why = last.unwrap_or("no answer");
        return Outcome {
            judgement: if status == Some(5) { Judgement::Honest } else { Judgement::Wrong },
            is_misnamed: false,
            is_denied: false,
            has_ended: status.is_some(),
            line: format!("{head} status {status:?}: {why}"),
        };
    }
    let said = Said { answer: &answer };
    let Judged { judgement, is_misnamed, is_denied, why } = judged(&case.truth, &said);
    let names: Vec<String> =
        said.named().iter().map(|(name, probability)| format!("{name} {probability:.3}")).collect();
    let statuses: Vec<String> = case
        .truth
        .groups()
        .concat()
        .iter()
        .map(|name| format!("{name} {}", said.status(name)))
        .collect();
    let number = |key: &str| answer[key].as_f64().unwrap_or(f64::NAN);
    Outcome {
        judgement,
        is_misnamed,
        is_denied,
        has_ended: true,
        line: format!(
            "{head} {:<6} {:<11} [{}] ({}) {:.2}->{:.2} {why}",
            judgement.word(),
            said.verdict(),
            names.join(", "),
            statuses.join(", "),
            number("holdout_before"),
            number("holdout_after"),
        ),
    }
}

/// Exit status and processor time of a process, s; no status where it was ended because no answer came.
fn run_to_its_end(command: &mut Command, folder: &Path) -> (Option<i32>, f64) {
    let file = |name: &str| File::create(folder.join(name)).expect("a file for what it says");
    command.stdin(Stdio::null()).stdout(file("stdout")).stderr(file("stderr"));
    let mut child = command.spawn().expect("the program can be started");
    let id = i32::try_from(child.id()).ok().and_then(Pid::from_raw);
    let id = id.expect("a process has an id");
    // Seen to have ended and not yet forgotten by the kernel, which still knows how long it computed.
    let look = WaitIdOptions::EXITED | WaitIdOptions::NOWAIT | WaitIdOptions::NOHANG;
    let (has_ended, took_s) = loop {
        let ended = waitid(WaitId::Pid(id), look).expect("a child can be waited for");
        let took_s = processor_s(child.id());
        if ended.is_some() || took_s > PATIENCE_S {
            break (ended.is_some(), took_s);
        }
        sleep(POLL);
    };
    if !has_ended {
        child.kill().expect("a child can be ended");
    }
    let status = child.wait().expect("a child can be waited for");
    (status.code().filter(|_| has_ended), took_s)
}

/// Processor time of all threads of a process until now, s.
fn processor_s(id: u32) -> f64 {
    let text = fs::read_to_string(format!("/proc/{id}/stat")).unwrap_or_default();
    let behind_name = text.rsplit(')').next().unwrap_or_default();
    let fields = behind_name.split_whitespace();
    // Fields 14 and 15 of proc(5): user and system; the third is the first behind the name.
    let ticks = fields.skip(11).take(2).map(str::parse::<f64>);
    ticks.map(Result::unwrap_or_default).sum::<f64>() / TICKS_PER_S
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    const DRAG: Truth = Truth::Effects {
        missing: &[&["viscous_friction", "quadratic_load"]],
        also: &["stribeck_friction"],
    };
    const NOTHING: Truth = Truth::Nothing;
    const OTHER: Truth = Truth::Unknown { akin: &[] };

    /// An answer with these effects, each with its probability, that rules out what is `denied`.
    fn answer(verdict: &str, effects: &[(&str, f64)], denied: &[&str]) -> Value {
        let named = effects
            .iter()
            .map(|(name, p)| json!({ "effect": name, "status": "possible", "probability": p }));
        let denied = denied
            .iter()
            .map(|name| json!({ "effect": name, "status": "ruled_out", "probability": 0.01 }));
        let candidates: Vec<Value> = named.chain(denied).collect();
        let names: Vec<&str> = effects.iter().map(|(name, _)| *name).collect();
        json!({
            "verdict": verdict, "effects": names, "sentence": "", "sufficient": true,
            "candidates": candidates, "confusable": [["field_change", "viscous_friction"]]
        })
    }

    #[test]
    fn answers_are_right_wrong_or_honest() {
        use Judgement::{Honest, Right, Wrong};
        const BOTH: &[&str] = &["viscous_friction", "quadratic_load"];
        let of = |verdict, name, p| answer(verdict, &[(name, p)], &[]);
        let open = |verdict| answer(verdict, &[], &[]);
        let cases = [
            (&DRAG, of("effect", "quadratic_load", 0.99), Right, false),
            (&DRAG, of("effect", "stribeck_friction", 0.99), Honest, false),
            (&DRAG, of("effect", "voltage_drop", 0.99), Wrong, true),
            (&DRAG, of("effect", "voltage_drop", 0.6), Wrong, false),
            (&DRAG, of("ambiguous", "field_change", 0.99), Honest, false),
            (&DRAG, open("none"), Wrong, false),
            (&DRAG, open("not_fitted"), Honest, false),
            (&DRAG, answer("unexplained", &[], &BOTH[..1]), Honest, false),
            (&DRAG, answer("unexplained", &[], BOTH), Wrong, false),
            (&NOTHING, open("none"), Right, false),
            (&NOTHING, open("unexplained"), Honest, false),
            (&OTHER, open("unexplained"), Right, false),
            (&OTHER, of("unexplained", "cogging", 0.99), Wrong, true),
            (&OTHER, of("unexplained", "constant_load", 0.6), Right, false),
            (&OTHER, open(""), Wrong, false),
        ];
        for (truth, answer, judgement, is_misnamed) in cases {
            let judged = judged(truth, &Said { answer: &answer });
            let found = (judged.judgement, judged.is_misnamed);
            assert_eq!(found, (judgement, is_misnamed), "{answer}");
        }
    }
}
