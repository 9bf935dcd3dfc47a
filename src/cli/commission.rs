//! `commission`: the whole loop, guided; the screen and the headless run drive the same state machine.

use super::arguments::{LiveArguments, UnknownMotor};
use super::failure::Failure;
use super::{output, progress};
use crate::app::by_hand::{self, Shown};
use crate::app::{Left, Rig, commission, conduct};
use crate::plant::FileHistory;
use crate::tui::Exit;
use crate::workflow::{CommissionResult, Progress, ProgressCell, StepState};

/// The whole loop: check, plan, excite, identify, compare, name the missing effect, add it, report
#[derive(clap::Args)]
#[command(after_help = "Examples:
  drivebench commission --headless                       the emulated motor with a hidden effect
  drivebench commission --headless --emulator zk-22fc-plain   the same motor without one
  drivebench commission bench.toml --port /dev/ttyUSB0   a real drive, on the screen")]
pub(super) struct Arguments {
    #[command(flatten)]
    live: LiveArguments,
    #[command(flatten)]
    unknown: UnknownMotor,
}

pub(super) fn execute(arguments: Arguments) -> Result<(), Failure> {
    let live = arguments.live;
    let json = live.json;
    let options = live.options(arguments.unknown.escalate)?;
    let cell = ProgressCell::default();
    let shown = live.is_headless().then(|| progress::begin("commission"));
    let mut told = shown.is_some().then(StepLog::default);
    let audience = live.audience(Some(cell.clone()));
    let done = conduct(audience, move |strings| {
        commission(options, Box::new(Rig::open), strings, |latest| {
            cell.publish(latest.clone());
            if let Some(told) = &mut told {
                told.tell(latest);
            }
        })
    })?;
    drop(shown);
    let (done, left) = (done.work, done.left);
    let by_hand = matches!(left, Left::Screen(Exit::Diagnosis));
    if let Some(discovery) = done.discovery.filter(|_| by_hand) {
        let first = done.result.runs.first();
        let shown = Shown {
            title: "the runs of this commissioning".to_owned(),
            guess_first: false,
            fitted_on: first.and_then(|run| run.folder.clone()).unwrap_or_default(),
            history: FileHistory::default(),
            output: None,
        };
        let seen = by_hand::show(discovery, shown);
        // However it was left: the result of the loop is there all the same.
        finish(json, &done.result, &done.text)?;
        if seen?.is_interrupted() {
            return Err(Failure::interrupted("interrupted in the diagnosis by hand"));
        }
        return done.unkept.map_or(Ok(()), Err);
    }
    finish(json, &done.result, &done.text)?;
    left.conclude(done.unkept)
}

fn finish(json: bool, result: &CommissionResult, text: &str) -> Result<(), Failure> {
    output::result(result, json, |_| text.to_owned())
}

/// Progress on stderr: each step once when it begins and once with its figure.
#[derive(Default)]
struct StepLog {
    lines: Vec<(StepState, String)>,
}

impl StepLog {
    fn tell(&mut self, progress: &Progress) {
        let total = progress.steps.len();
        self.lines
            .resize(total, (StepState::Waiting, String::new()));
        for (index, step) in progress.steps.iter().enumerate() {
            let now = (step.state, step.line.clone());
            if now == self.lines[index] {
                continue;
            }
            let head = format!("[{:>2}/{total}] {}", index + 1, step.title);
            match step.state {
                StepState::Waiting => {}
                StepState::Active => {
                    output::message(&format!("{head} ..."));
                    progress::stage(&step.title, 0);
                }
                StepState::Done => output::message(&format!("{head}: {}", step.line)),
                StepState::Failed => output::message(&format!("{head} failed")),
            }
            self.lines[index] = now;
        }
    }
}
