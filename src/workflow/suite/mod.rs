//! A suite of bench tests: cases of steps, read from a file, and their results.
//!
//! ```text
//! SUITE.toml -> Suite (cases, steps, limits) -> the driver runs each step as a command of the program
//!                                  JSON of a step -> limits -> CaseOutcome -> SuiteOutcome -> exit status
//! ```
//!
//! Pure: which process does a step, and in which folder, is the driver's concern. The motor is stopped by the guard of the
//! command that moved it and, where that is gone, by the drive's watchdog; no step of a suite has to do it.

pub mod golden;
pub mod junit;
mod limit;
pub mod open_metrics;
mod outcome;

use std::collections::BTreeMap;

use serde::Deserialize;
use toml::Spanned;

use drivebench_model::config_text::{self, ConfigError, help_for_unknown};
use drivebench_model::sample::Channel;
pub use limit::{Limit, answered, entry, figure, find};
pub use outcome::{
    Answered, CaseOutcome, Check, Confusion, IdentifiedStep, Spread, StepOutcome, SuiteOutcome,
    Verdict,
};

#[derive(Clone, Debug, PartialEq)]
pub struct Suite {
    pub name: String,
    pub cases: Vec<Case>,
}

/// One case: steps in their order, of which the first that fails ends it.
#[derive(Clone, Debug, PartialEq)]
pub struct Case {
    pub name: String,
    pub tags: Vec<String>,
    /// Bench file, from the folder of the suite, or `"@case/NAME"` that a step has made; the embedded one where there is none.
    pub bench: Option<String>,
    /// Embedded name or file of the software drive's motor.
    pub emulator: Option<String>,
    pub port: Option<String>,
    /// Of the software drive; each repeat takes the next.
    pub seed: u64,
    pub repeat: u64,
    pub timeout_s: f64,
    /// What this case cannot do without; on `sim:` it is skipped.
    pub needs: Vec<Need>,
    pub steps: Vec<Step>,
}

impl Case {
    /// Whether its software drive is a process of its own.
    pub fn has_own_drive(&self) -> bool {
        self.needs.contains(&Need::Process)
    }
}

/// What only some ports or options provide.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Need {
    /// A line in real time: the software drive behind a pseudo-terminal, or a real one.
    Line,
    /// The software drive, in memory or behind a pseudo-terminal: what is set in it is not available on a real bench.
    Emulator,
    /// An earlier run of the same machine, given by `--baseline`.
    Baseline,
    /// The software drive in a process of its own, which outlives the command.
    Process,
}

#[derive(Clone, Debug, PartialEq)]
pub struct Step {
    /// By which later steps refer to it; its verb where none was given.
    pub name: String,
    pub action: Action,
    pub timeout_s: Option<f64>,
}

#[derive(Clone, Debug, PartialEq)]
pub enum Action {
    Command {
        verb: Verb,
        /// Options of the command by their long names, `_` for `-`.
        options: Vec<(String, toml::Value)>,
        /// Expected exit statuses.
        statuses: Vec<u8>,
    },
    /// Keys of the emulator's file that are changed for the steps that follow.
    Fault(toml::Table),
    File(ChangedFile),
    /// Limits on the result of an earlier step.
    Assert {
        /// The step; without it the last command.
        of: Option<String>,
        limits: Vec<(String, Limit)>,
        signals: Vec<SignalLimit>,
    },
}

/// A bench file or a drive profile with other keys, made in the folder of the case.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ChangedFile {
    /// TOML file, from the folder of the suite.
    pub of: String,
    /// Its name in the folder of the case, `"@case/NAME"` for the steps that follow.
    pub name: String,
    /// Replaces keys of the file, table by table; `"@case/..."` is a path in the folder of the case.
    pub set: toml::Table,
}

/// What a recorded signal has to be around an instant.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SignalLimit {
    pub channel: String,
    pub at_s: f64,
    /// The value may come so much earlier or later, s.
    #[serde(default)]
    pub within_s: f64,
    pub value: f64,
    pub within: f64,
}

impl SignalLimit {
    fn refusal(&self) -> Option<(String, String)> {
        let wrong = |key: &str, value: f64, allowed: &str| {
            Some((format!("signal: {key} = {value} is not allowed"), format!("allowed: {allowed}")))
        };
        for (key, value) in [("at_s", self.at_s), ("value", self.value)] {
            if !value.is_finite() {
                return wrong(key, value, "a number");
            }
        }
        for (key, width) in [("within_s", self.within_s), ("within", self.within)] {
            if !(width.is_finite() && width >= 0.0) {
                return wrong(key, width, "a width, not negative");
            }
        }
        None
    }

    /// What was found, in words, where no sample around the instant has the value. `points`: time from the start of the run,
    /// s, and value.
    pub fn fails(&self, points: impl Iterator<Item = (f64, f64)>) -> Option<String> {
        let around = |&(time_s, _): &(f64, f64)| (time_s - self.at_s).abs() <= self.within_s;
        let nearest = points
            .filter(around)
            .map(|(_, value)| value)
            .min_by(|a, b| (a - self.value).abs().total_cmp(&(b - self.value).abs()));
        let wanted =
            format!("{} ± {} at {} ± {} s", self.value, self.within, self.at_s, self.within_s);
        match nearest {
            None => Some(format!("no sample, has to be {wanted}")),
            Some(found) if (found - self.value).abs() <= self.within => None,
            Some(found) => Some(format!("{found}, has to be {wanted}")),
        }
    }
}

/// The verbs of steps: each with its key of a step in the file, and the command of the program.
macro_rules! verbs {
    ($($verb:ident $key:ident $command:literal,)+) => {
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum Verb {
            $($verb,)+
        }

        impl Verb {
            /// Each with its word in a suite, and the command of the program.
            pub const ALL: &[(Self, &'static str, &'static str)] =
                &[$((Self::$verb, stringify!($key), $command),)+];
        }

        #[derive(Deserialize)]
        #[serde(deny_unknown_fields)]
        struct StepKeys {
            #[serde(rename = "as")]
            name: Option<String>,
            timeout_s: Option<Spanned<f64>>,
            status: Option<Statuses>,
            $($key: Option<Spanned<toml::Table>>,)+
            fault: Option<toml::Table>,
            file: Option<ChangedFile>,
            assert: Option<BTreeMap<Spanned<String>, Spanned<toml::Value>>>,
            #[serde(default)]
            signal: Vec<SignalLimit>,
            of: Option<String>,
        }

        impl StepKeys {
            fn options(&mut self, verb: Verb) -> Option<Spanned<toml::Table>> {
                match verb {
                    $(Verb::$verb => self.$key.take(),)+
                }
            }
        }
    };
}

verbs! {
    Probe probe "probe",
    Connect connect "run",
    Plan plan "plan",
    Commission commission "commission",
    Excite excite "run",
    Speed speed "speed",
    Identify identify "identify",
    Compare compare "compare",
    Diagnose diagnose "diagnose",
    Add add "add",
}

impl Verb {
    pub fn command(self) -> &'static str {
        Self::ALL.iter().find(|(verb, ..)| *verb == self).map_or("", |(.., command)| command)
    }

    /// Whether it opens a link, and may move the motor.
    pub const fn is_live(self) -> bool {
        matches!(self, Self::Connect | Self::Commission | Self::Excite | Self::Speed)
    }

    /// Whether it exchanges anything with a drive, if only to read.
    pub const fn has_link(self) -> bool {
        self.is_live() || matches!(self, Self::Probe)
    }

    /// Whether it is about a run: one that it records, or an earlier one.
    pub const fn has_run(self) -> bool {
        !matches!(self, Self::Probe | Self::Plan)
    }
}

// The file.

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SuiteKeys {
    name: Spanned<String>,
    #[serde(default)]
    defaults: Defaults,
    #[serde(rename = "case")]
    cases: Vec<CaseKeys>,
}

#[derive(Clone, Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct Defaults {
    bench: Option<String>,
    emulator: Option<String>,
    port: Option<String>,
    timeout_s: Option<f64>,
    #[serde(default)]
    tags: Vec<String>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CaseKeys {
    name: Spanned<String>,
    #[serde(default)]
    tags: Vec<String>,
    bench: Option<String>,
    emulator: Option<String>,
    port: Option<String>,
    #[serde(default = "one")]
    seed: u64,
    #[serde(default = "one_repeat")]
    repeat: Spanned<u64>,
    timeout_s: Option<Spanned<f64>>,
    #[serde(default)]
    needs: Vec<Need>,
    #[serde(rename = "step")]
    steps: Vec<Spanned<StepKeys>>,
}

const fn one() -> u64 {
    1
}

fn one_repeat() -> Spanned<u64> {
    Spanned::new(0..0, 1)
}

#[derive(Deserialize)]
#[serde(untagged)]
enum Statuses {
    One(u8),
    Any(Vec<u8>),
}

/// By which options refer to the folder of the case, as in `"@case/model.toml"`.
pub const CASE: &str = "case";
/// Longest time for a step, s: a day.
const MOST_S: f64 = 86_400.0;
/// Time for a step where the file gives none, s.
const TIMEOUT_S: f64 = 300.0;
/// Options that the driver sets from the case and from its own command line: a step does not choose the motor or the folder.
const GIVEN: [&str; 8] =
    ["port", "emulator", "seed", "out", "hardware", "headless", "json", "screen"];
/// What a suite has instead of acts on its own commands.
const HOST_HELP: &str = "allowed: faults of line and drive, as fault = { fault = [{ kind = \"black_hole\", from_s = 1.0 }] }; \
                         a suite does not act on signals, terminals, ports and disks";
/// Begin of keys of earlier versions: figures of acts on a command, and of what its motor did. No result has them.
const NO_FIGURES: [&str; 7] = [
    "host.",
    "motor.armed_again",
    "motor.falls_after_s",
    "motor.fault",
    "motor.on_at_end",
    "motor.peak_",
    "motor.zero_after_s",
];
const PRINTABLE: &str = "allowed: up to 200 characters that can be printed";
const FILE_HELP: &str = "allowed: the name of a file, which is made in the folder of the case";
/// Options that name a file to be written; a suite writes nowhere but into the folder of its case.
const WRITTEN: [&str; 5] = ["tap", "output", "html", "next-bench", "load-torque"];

impl Suite {
    /// Reads a suite. `options_of` gives the long names of the options that the command of a verb has.
    pub fn parse(
        file: &str,
        text: &str,
        options_of: impl Fn(Verb) -> Vec<String>,
    ) -> Result<Self, ConfigError> {
        let keys: SuiteKeys =
            config_text::parse(file, text).map_err(|mut error: ConfigError| {
                if error.message.contains("unknown field `host`") {
                    HOST_HELP.clone_into(&mut error.help);
                }
                error
            })?;
        let error = |offset: usize, what: String, help: &str| {
            ConfigError::at(file, text, offset, what, help)
        };
        if !is_printable(keys.name.get_ref()) {
            let what = format!("name = {:?} is not allowed", keys.name.get_ref());
            return Err(error(keys.name.span().start, what, PRINTABLE));
        }
        let mut cases: Vec<Case> = Vec::new();
        for case in keys.cases {
            let at = case.name.span().start;
            let name = case.name.into_inner();
            let word = [&name].into_iter().chain(&case.tags).find(|word| !is_printable(word));
            if let Some(word) = word {
                let what = format!("{word:?} is not allowed as a name or a tag");
                return Err(error(at, what, PRINTABLE));
            }
            if cases.iter().any(|other| other.name == name) {
                let what = format!("two cases are named {name:?}");
                return Err(error(at, what, "each needs a name of its own"));
            }
            let repeat = *case.repeat.get_ref();
            if !(1..=10_000).contains(&repeat) {
                let what = format!("repeat = {repeat} is not allowed");
                return Err(error(case.repeat.span().start, what, "allowed: 1 to 10000"));
            }
            let timeout_at = case.timeout_s.as_ref().map_or(at, |time| time.span().start);
            let timeout_s = case.timeout_s.map(Spanned::into_inner);
            let timeout_s = timeout_s.or(keys.defaults.timeout_s).unwrap_or(TIMEOUT_S);
            if let Some((what, help)) = time_refusal(timeout_s) {
                return Err(error(timeout_at, what, &help));
            }
            if case.steps.is_empty() {
                let what = format!("the case {name:?} has no step");
                return Err(error(at, what, "give it [[case.step]]"));
            }
            let mut steps: Vec<Step> = Vec::new();
            for step in case.steps {
                let step = read_step(step, &steps, &options_of)
                    .map_err(|(offset, what, help)| error(offset, what, &help))?;
                steps.push(step);
            }
            let defaults = keys.defaults.clone();
            cases.push(Case {
                tags: [defaults.tags, case.tags].concat(),
                bench: case.bench.or(defaults.bench),
                emulator: case.emulator.or(defaults.emulator),
                port: case.port.or(defaults.port),
                seed: case.seed,
                repeat,
                timeout_s,
                needs: case.needs,
                name,
                steps,
            });
        }
        Ok(Self { name: keys.name.into_inner(), cases })
    }
}

/// What is wrong with a time for a step, and what is allowed.
fn time_refusal(timeout_s: f64) -> Option<(String, String)> {
    let is_allowed = timeout_s > 0.0 && timeout_s <= MOST_S;
    let what = format!("timeout_s = {timeout_s} is not allowed");
    (!is_allowed).then(|| (what, format!("allowed: more than 0, to {MOST_S} s")))
}

/// Where, what and what is allowed.
type StepError = (usize, String, String);

fn wrong<T>(at: usize, what: impl Into<String>, help: impl Into<String>) -> Result<T, StepError> {
    Err((at, what.into(), help.into()))
}

fn read_step(
    step: Spanned<StepKeys>,
    before: &[Step],
    options_of: &impl Fn(Verb) -> Vec<String>,
) -> Result<Step, StepError> {
    let at = step.span().start;
    let mut keys = step.into_inner();
    if let Some(name) = keys.name.as_ref().filter(|name| !is_file_name(name) || *name == CASE) {
        let help = "allowed: letters, digits, -, _ and dots, not at the beginning, and not \"case\"; files are named by it";
        return wrong(at, format!("as = {name:?} is not allowed"), help);
    }
    if let Some(timeout_s) = &keys.timeout_s
        && let Some((what, help)) = time_refusal(*timeout_s.get_ref())
    {
        return wrong(timeout_s.span().start, what, help);
    }
    let has_status = keys.status.is_some();
    let statuses = match keys.status.take() {
        None => vec![0],
        Some(Statuses::One(status)) => vec![status],
        Some(Statuses::Any(statuses)) => statuses,
    };
    let mut found: Vec<(&'static str, Action)> = Vec::new();
    for &(verb, word, _) in Verb::ALL {
        if let Some(table) = keys.options(verb) {
            let options = read_options(verb, word, table, before, options_of)?;
            found.push((word, Action::Command { verb, options, statuses: statuses.clone() }));
        }
    }
    found.extend(keys.fault.map(|fault| ("fault", Action::Fault(fault))));
    if let Some(file) = keys.file {
        if !is_file_name(&file.name) {
            return wrong(at, format!("file: name = {:?} is not allowed", file.name), FILE_HELP);
        }
        found.push(("file", Action::File(file)));
    }
    if keys.assert.is_some() || !keys.signal.is_empty() {
        let action = read_assert(at, keys.assert, keys.signal, keys.of, before)?;
        found.push(("assert", action));
    }
    let [(word, action)] = <[_; 1]>::try_from(found).map_err(|found| {
        let names: Vec<&str> = found.iter().map(|(word, _)| *word).collect();
        let what = if names.is_empty() {
            "the step does nothing".to_owned()
        } else {
            format!("the step does several things: {}", names.join(", "))
        };
        let verbs = Verb::ALL.iter().map(|(_, word, _)| *word).collect::<Vec<_>>().join(", ");
        (at, what, format!("allowed: one of {verbs}, fault, file, assert"))
    })?;
    if has_status && !matches!(action, Action::Command { .. }) {
        let help = "give it to the step whose exit status it is";
        return wrong(at, "status without a command", help);
    }
    Ok(Step {
        name: keys.name.unwrap_or_else(|| word.to_owned()),
        action,
        timeout_s: keys.timeout_s.map(Spanned::into_inner),
    })
}

/// The options of a command, each known and each reference to a step that is there.
fn read_options(
    verb: Verb,
    word: &str,
    table: Spanned<toml::Table>,
    before: &[Step],
    options_of: &impl Fn(Verb) -> Vec<String>,
) -> Result<Vec<(String, toml::Value)>, StepError> {
    let at = table.span().start;
    let known = options_of(verb);
    let table = table.into_inner();
    for (key, value) in &table {
        let option = key.replace('_', "-");
        let is_positional = key == "run" || key == "effect";
        if !is_positional && !known.contains(&option) {
            let names: Vec<String> = known.iter().map(|name| name.replace('-', "_")).collect();
            let help = help_for_unknown(key, names.iter().map(String::as_str));
            return wrong(at, format!("unknown option `{key}` of {word}"), help);
        }
        if GIVEN.contains(&option.as_str()) {
            let help = "port, emulator and seed are set by the case, the others by the command line of the suite";
            return wrong(at, format!("{word} does not take `{key}`"), help);
        }
        if is_written(key) && !value.as_str().is_some_and(is_file_name) {
            return wrong(at, format!("{key} = {value} is not allowed"), FILE_HELP);
        }
        for name in references(value) {
            if name != CASE && !before.iter().any(|step| step.name == name) {
                let what = format!("{key} = \"@{name}\": no earlier step is named {name:?}");
                return wrong(at, what, help_for_name(name, before));
            }
        }
    }
    Ok(table.into_iter().collect())
}

fn read_assert(
    at: usize,
    keys: Option<BTreeMap<Spanned<String>, Spanned<toml::Value>>>,
    signals: Vec<SignalLimit>,
    of: Option<String>,
    before: &[Step],
) -> Result<Action, StepError> {
    let mut limits = Vec::new();
    for (key, value) in keys.into_iter().flatten() {
        if NO_FIGURES.iter().any(|of| key.get_ref().starts_with(of)) {
            let what = format!("{} = {} is not allowed", key.get_ref(), value.get_ref());
            let help = "allowed: figures of the result of a command, as its --json prints them; \
                        `drivebench emulate --journal FILE` writes what the motor of a software drive does";
            return wrong(key.span().start, what, help);
        }
        let limit = Limit::parse(value.get_ref()).or_else(|(what, help)| {
            wrong(value.span().start, format!("{}: {what}", key.get_ref()), help)
        })?;
        limits.push((key.into_inner(), limit));
    }
    if let Some(of) = of.as_ref().filter(|of| !before.iter().any(|step| step.name == **of)) {
        let what = format!("of = {of:?}: no earlier step is named so");
        return wrong(at, what, help_for_name(of, before));
    }
    for signal in &signals {
        if Channel::from_key(&signal.channel).is_none() {
            let help = help_for_unknown(&signal.channel, Channel::ALL.map(Channel::key));
            return wrong(at, format!("there is no channel {:?}", signal.channel), help);
        }
        if let Some((what, help)) = signal.refusal() {
            return wrong(at, what, help);
        }
    }
    Ok(Action::Assert { of, limits, signals })
}

fn help_for_name(name: &str, before: &[Step]) -> String {
    match before {
        [] => "this is the first step; give an earlier one a name with `as`".to_owned(),
        before => help_for_unknown(name, before.iter().map(|step| step.name.as_str())),
    }
}

/// Whether an option names a file that its command writes.
pub fn is_written(key: &str) -> bool {
    WRITTEN.contains(&key.replace('_', "-").as_str())
}

/// Whether a file in a folder may have this name, and needs no quotes in a shell.
fn is_file_name(name: &str) -> bool {
    let is_plain = |letter: char| letter.is_ascii_alphanumeric() || "-_.".contains(letter);
    (1..=100).contains(&name.len()) && !name.starts_with(['.', '-']) && name.chars().all(is_plain)
}

/// Whether a name can be printed on a terminal unchanged.
fn is_printable(name: &str) -> bool {
    (1..=200).contains(&name.chars().count()) && !name.chars().any(char::is_control)
}

/// Names of steps in a value: `"@fit"`, `"@fit/model.toml"`.
pub fn references(value: &toml::Value) -> Vec<&str> {
    match value {
        toml::Value::String(text) => reference(text).map(|(name, _)| name).into_iter().collect(),
        toml::Value::Array(list) => list.iter().flat_map(references).collect(),
        _ => Vec::new(),
    }
}

/// The step that `"@fit/model.toml"` names, and what follows it.
pub fn reference(text: &str) -> Option<(&str, &str)> {
    let text = text.strip_prefix('@')?;
    Some(text.split_at(text.find('/').unwrap_or(text.len())))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn options_of(_: Verb) -> Vec<String> {
        ["run-seed", "escalate", "holdout", "model", "require", "out", "tap"]
            .map(String::from)
            .into()
    }

    fn parse(text: &str) -> Result<Suite, ConfigError> {
        Suite::parse("suite.toml", text, options_of)
    }

    const WHOLE: &str = r#"
name = "acceptance"
[defaults]
port = "sim:"
tags = ["all"]
[[case]]
name = "plain"
emulator = "zk-22fc-plain"
tags = ["smoke"]
repeat = 3
[[case.step]]
fault = { noise = { current_a = 0.1 } }
[[case.step]]
as = "fit"
excite = { run_seed = 2, escalate = true }
[[case.step]]
diagnose = { run = "@fit", model = "@fit/model.toml" }
[[case.step]]
assert = { missing = "none", resistance_ohm = [1.0, 1.3] }
[[case.step]]
of = "fit"
signal = [ { channel = "speed_rad_s", at_s = 1.0, within_s = 0.1, value = 90.0, within = 2.0 } ]
[[case.step]]
speed = {}
status = 4
timeout_s = 9.0
"#;

    #[test]
    fn a_suite_is_read_whole() {
        let suite = parse(WHOLE).unwrap();
        let case = &suite.cases[0];
        assert_eq!((suite.name.as_str(), case.repeat, case.seed), ("acceptance", 3, 1));
        assert_eq!(case.port.as_deref(), Some("sim:"));
        assert_eq!(case.tags, ["all", "smoke"]);
        assert!((case.timeout_s - TIMEOUT_S).abs() < 1e-9);
        let names: Vec<&str> = case.steps.iter().map(|step| step.name.as_str()).collect();
        assert_eq!(names, ["fault", "fit", "diagnose", "assert", "assert", "speed"]);
        let Action::Command { statuses, .. } = &case.steps[5].action else {
            panic!("speed is a command");
        };
        assert_eq!(statuses, &[4]);
        let Action::Assert { limits, .. } = &case.steps[3].action else {
            panic!("an assertion");
        };
        assert_eq!(limits.len(), 2);
    }

    #[test]
    fn each_error_has_its_line_and_column() {
        for (from, to, words) in [
            ("repeat = 3", "repeat = 0", "10:10: repeat = 0"),
            ("tags = [\"smoke\"]", "tag = 1", "unknown field `tag`"),
            ("run_seed = 2", "runseed = 2", "unknown option `runseed` of excite"),
            ("\"@fit\"", "\"@fitt\"", "no earlier step is named \"fitt\""),
            ("[1.0, 1.3]", "[1.3, 1.0]", "resistance_ohm: [1.3, 1] has its larger end first"),
            (
                "name = \"acceptance\"",
                "name = \"\\u001b[2J\"",
                "name = \"\\u{1b}[2J\" is not allowed",
            ),
            ("tags = [\"smoke\"]", "tags = [\"a\\u0007\"]", "not allowed as a name or a tag"),
            ("as = \"fit\"", "as = \"a/../b\"", "as = \"a/../b\" is not allowed"),
            ("run_seed = 2", "out = \"/\"", "excite does not take `out`"),
            ("run_seed = 2", "tap = \"../line.pcap\"", "tap = \"../line.pcap\" is not allowed"),
            ("speed = {}", "", "the step does nothing"),
            ("speed = {}", "assert = { rows = 1 }", "status without a command"),
            ("speed = {}", "speed = {}\nexcite = {}", "several things"),
            ("speed = {}", "speed = {}\nhost = { act = \"kill\" }", "25:1: unknown field `host`"),
            (
                "missing = \"none\"",
                "\"motor.zero_after_s\" = \"< 1\"",
                "motor.zero_after_s = \"< 1\" is not allowed",
            ),
            (
                "speed = {}",
                "file = { of = \"a.toml\", name = \"../b.toml\", set = {} }",
                "file: name = \"../b.toml\" is not allowed",
            ),
            ("of = \"fit\"", "of = \"fir\"", "no earlier step is named so"),
            ("within = 2.0", "within = inf", "signal: within = inf is not allowed"),
            ("within_s = 0.1", "within_s = nan", "signal: within_s = NaN is not allowed"),
            ("timeout_s = 9.0", "timeout_s = nan", "26:13: timeout_s = NaN is not allowed"),
            ("timeout_s = 9.0", "timeout_s = inf", "timeout_s = inf is not allowed"),
            ("timeout_s = 9.0", "timeout = 9.0", "unknown field `timeout`"),
        ] {
            assert!(WHOLE.contains(from), "{from}");
            let error = parse(&WHOLE.replace(from, to)).unwrap_err();
            assert!(error.to_string().contains(words), "{to}: {error}");
            assert!(!error.help.is_empty(), "{to}");
        }
        let twice = format!("{WHOLE}[[case]]\nname = \"plain\"\n[[case.step]]\nspeed = {{}}\n");
        assert!(parse(&twice).unwrap_err().message.contains("two cases"));
        let host = WHOLE.replace("speed = {}", "speed = {}\nhost = { act = \"kill\" }");
        assert_eq!(parse(&host).unwrap_err().help, HOST_HELP);
        let error = parse(&WHOLE.replace("run_seed", "runseed")).unwrap_err();
        assert_eq!(error.help, "did you mean `run_seed`?");
    }

    #[test]
    fn a_signal_may_come_earlier_or_later_by_its_tolerance() {
        let limit = SignalLimit {
            channel: "speed_rad_s".into(),
            at_s: 1.0,
            within_s: 0.1,
            value: 90.0,
            within: 2.0,
        };
        let ramp = |from_s: f64| {
            (0..200).map(move |count| {
                let time_s = f64::from(count) * 0.01;
                (time_s, if time_s < from_s { 0.0 } else { 90.0 })
            })
        };
        assert_eq!(limit.fails(ramp(1.05)), None);
        assert_eq!(limit.fails(ramp(1.2)).unwrap(), "0, has to be 90 ± 2 at 1 ± 0.1 s");
        assert!(limit.fails(std::iter::empty()).unwrap().contains("no sample"));
    }
}
