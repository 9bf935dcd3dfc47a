//! The steps of a commissioning: what each needs, what it makes possible, and the command that does the same alone.

use drivebench_bench::recording::RunFile;
use drivebench_bench::{BenchFile, Port};
use drivebench_model::text::number::shortest;
use drivebench_model::text::shell::quoted_word;

/// What a recorded run is for. A model is fitted on the first, chosen by the second, and its error reported from the
/// third; the fourth repeats the first and shows what the machine itself does not repeat.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    Fit,
    Select,
    Confirm,
    Repeat,
}

impl Role {
    pub const ALL: [Self; 4] = [Self::Fit, Self::Select, Self::Confirm, Self::Repeat];

    pub const fn name(self) -> &'static str {
        match self {
            Self::Fit => "fit",
            Self::Select => "select",
            Self::Confirm => "confirm",
            Self::Repeat => "repeat",
        }
    }
}

/// A step of the commissioning, in their order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    Connect,
    Safety,
    /// Only an unknown motor needs it.
    Find,
    Plan,
    Record(Role),
    Identify,
    Compare,
    Diagnose,
    Ladder,
    Tune,
    Report,
    /// The recommended run, where there is one; on request.
    Experiment,
    /// On request.
    SpeedLoop,
}

impl Step {
    /// The steps for a motor that is known, or that has to be found first.
    pub fn all(find: bool) -> Vec<Self> {
        let mut steps = vec![Self::Connect, Self::Safety];
        steps.extend(find.then_some(Self::Find));
        steps.push(Self::Plan);
        steps.extend(Role::ALL.map(Self::Record));
        steps.extend([
            Self::Identify,
            Self::Compare,
            Self::Diagnose,
            Self::Ladder,
            Self::Tune,
            Self::Report,
            Self::Experiment,
            Self::SpeedLoop,
        ]);
        steps
    }

    pub const fn title(self) -> &'static str {
        match self {
            Self::Connect => "connect",
            Self::Safety => "safety checks",
            Self::Find => "find the motor",
            Self::Plan => "plan",
            Self::Record(Role::Fit) => "record: fit",
            Self::Record(Role::Select) => "record: select",
            Self::Record(Role::Confirm) => "record: confirm",
            Self::Record(Role::Repeat) => "record: repeat",
            Self::Identify => "identify",
            Self::Compare => "compare",
            Self::Diagnose => "diagnose",
            Self::Ladder => "ladder",
            Self::Tune => "tune",
            Self::Report => "report",
            Self::Experiment => "next experiment",
            Self::SpeedLoop => "speed loop",
        }
    }

    /// Whether it follows the report on request only.
    pub const fn is_on_request(self) -> bool {
        matches!(self, Self::Experiment | Self::SpeedLoop)
    }

    pub const fn needs(self) -> &'static str {
        match self {
            Self::Connect => "a powered drive on the port of the bench file",
            Self::Safety => "a drive that answers, its shaft free to turn a little",
            Self::Find => "the rated current and speed of the bench file's limits",
            Self::Plan => "limits and a nameplate, or the motor that was found",
            Self::Record(Role::Fit) => "a plan that crosses no limit; the motor turns",
            Self::Record(_) => "the run before it; the motor turns",
            Self::Identify => "the fit run",
            Self::Compare => "an identified model and a run that it was not fitted on",
            Self::Diagnose => "the fit run, and another one to select by",
            Self::Ladder => "a named effect",
            Self::Tune => "a model with inertia and back-EMF",
            Self::Report => "the runs and what was found",
            Self::Experiment => "effects not distinguished or not shown so far; the motor turns",
            Self::SpeedLoop => "tuned gains and a [speed] in the bench file; the motor turns",
        }
    }

    pub const fn unlocks(self) -> &'static str {
        match self {
            Self::Connect => "the safety checks",
            Self::Safety => "everything that energises the motor",
            Self::Find => "a plan without a nameplate",
            Self::Plan => "the runs, whose load on the motor is known",
            Self::Record(Role::Fit) => "identification",
            Self::Record(Role::Select) => "a choice between models on data not used in the fit",
            Self::Record(Role::Confirm) => "an error on data used for neither fit nor choice",
            Self::Record(Role::Repeat) => "how far the machine repeats its motion",
            Self::Identify => "the comparison",
            Self::Compare => "where, and by how much, the model fails",
            Self::Diagnose => "the effect to add, with its cause and remedy",
            Self::Ladder => "a model at its floor, or how far it stays above it",
            Self::Tune => "the speed loop",
            Self::Report => "one file for a colleague",
            Self::Experiment => "a diagnosis that distinguishes or shows them",
            Self::SpeedLoop => "a loop that adapts to changes",
        }
    }

    /// The command that does the same by itself; none for what is a part of every run.
    pub fn command(self, context: &CommandContext) -> Option<String> {
        let live = |command: &str| format!("drivebench {command}{}", context.words);
        let [fit, select, confirm] =
            [Role::Fit, Role::Select, Role::Confirm].map(|role| context.run(role));
        let of_fit = |file: RunFile| quoted_word(&format!("{fit}/{}", file.name()));
        let [fit, select, confirm] = [&fit, &select, &confirm].map(|run| quoted_word(run));
        // The folder's own model has the effect already.
        let judged = format!("--model baseline --holdout {select} --confirm {confirm}");
        Some(match self {
            Self::Safety | Self::Report => return None,
            Self::Connect => format!("drivebench probe {}", context.line.as_deref()?),
            Self::Find => live("run") + " --escalate",
            Self::Plan if context.bench.is_empty() => "drivebench plan".to_owned(),
            Self::Plan => format!("drivebench plan {}", quoted_word(&context.bench)),
            Self::Record(role) => {
                let seed = context.seed(role);
                live("run") + &format!(" --run-seed {seed}")
            }
            Self::Identify => format!("drivebench identify {fit}"),
            Self::Compare => {
                format!("drivebench compare {fit} --model baseline --holdout {confirm}")
            }
            Self::Diagnose => format!("drivebench diagnose {fit} {judged}"),
            Self::Ladder => {
                let effect = context.effect.unwrap_or("EFFECT");
                format!("drivebench add {effect} --run {fit} {judged}")
            }
            Self::Tune => {
                let rate_hz = shortest(context.rate_hz, 6);
                format!("drivebench tune --model {} --rate-hz {rate_hz}", of_fit(RunFile::Model))
            }
            Self::Experiment => format!("drivebench run {}", of_fit(RunFile::NextBench)),
            Self::SpeedLoop => live("speed") + " --model " + &of_fit(RunFile::Model),
        })
    }
}

/// Data for the commands of single steps: the arguments of the commissioning, its runs and effect so far.
#[derive(Clone, Debug, Default)]
pub struct CommandContext {
    /// The bench file; empty for the embedded one.
    bench: String,
    /// Bench, link and motor as they were named, each with a space before it.
    words: String,
    /// The line of the drive for commands that only read; none where there is no line.
    line: Option<String>,
    rate_hz: f64,
    seeds: [u64; 4],
    /// Run folders by role, as far as they are recorded.
    pub(super) runs: Vec<String>,
    /// The effect that was named.
    pub(super) effect: Option<&'static str>,
}

impl CommandContext {
    /// `file` is the bench file, `None` for the embedded one; `words` are the arguments of the live command, each with a space
    /// before it.
    pub fn new(bench: &BenchFile, file: Option<&str>, words: String) -> Self {
        let line = match bench.port() {
            Port::Sim | Port::SimRtu => None,
            Port::Emulator | Port::Tcp(_) | Port::Serial(_) => {
                Some(format!("--port {} --drive {}", bench.link.port, bench.drive.profile))
            }
        };
        let runs = bench.runs;
        Self {
            bench: file.unwrap_or_default().to_owned(),
            words,
            line,
            rate_hz: bench.link.rate_hz,
            seeds: [runs.fit, runs.select, runs.confirm, runs.repeat],
            ..Self::default()
        }
    }

    const fn seed(&self, role: Role) -> u64 {
        self.seeds[role as usize]
    }

    fn run(&self, role: Role) -> String {
        self.runs.get(role as usize).cloned().unwrap_or_else(|| role.name().to_uppercase())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn context() -> CommandContext {
        let bench = BenchFile::embedded_default();
        CommandContext::new(
            &bench,
            Some("bench.toml"),
            " bench.toml --port /dev/ttyUSB0".to_owned(),
        )
    }

    #[test]
    fn each_step_has_its_needs_and_results() {
        for step in Step::all(true) {
            for words in [step.title(), step.needs(), step.unlocks()] {
                assert!(!words.is_empty() && words.len() < 70, "{step:?}: {words}");
            }
        }
        assert_eq!(Step::all(true).len(), Step::all(false).len() + 1);
    }

    #[test]
    fn commands_have_placeholders_for_what_is_not_known() {
        let mut context = context();
        let command = |context: &CommandContext, step: Step| step.command(context).unwrap();
        assert_eq!(
            command(&context, Step::Record(Role::Select)),
            "drivebench run bench.toml --port /dev/ttyUSB0 --run-seed 2"
        );
        assert_eq!(
            command(&context, Step::Ladder),
            "drivebench add EFFECT --run FIT --model baseline --holdout SELECT --confirm CONFIRM"
        );
        context.runs = ["a", "b", "c"].map(str::to_owned).to_vec();
        context.effect = Some("voltage_drop");
        assert_eq!(
            command(&context, Step::Ladder),
            "drivebench add voltage_drop --run a --model baseline --holdout b --confirm c"
        );
        assert_eq!(
            command(&context, Step::SpeedLoop),
            "drivebench speed bench.toml --port /dev/ttyUSB0 --model a/model.toml"
        );
        assert_eq!(Step::Safety.command(&context), None);
        let embedded = CommandContext::new(&BenchFile::embedded_default(), None, String::new());
        assert_eq!(command(&embedded, Step::Plan), "drivebench plan");
    }
}
