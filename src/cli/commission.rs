//! `commission`: the whole loop, guided; the screen and the headless run drive the same state machine.

use super::failure::{Failure, INTERRUPTED};
use super::live::{LiveArguments, UnknownMotor};
use super::{output, progress};
use crate::app::discovery::{self, Shown};
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
    let mut told = shown.is_some().then(Told::default);
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
        let runs = &done.result.runs;
        let shown = Shown {
            title: "the runs of this commissioning".to_owned(),
            guess_first: false,
            fitted_on: runs
                .first()
                .and_then(|run| run.folder.clone())
                .unwrap_or_default(),
            history: FileHistory::default(),
            output: None,
        };
        let seen = discovery::show(discovery, shown);
        // However it was left: the result of the loop is there all the same.
        finish(json, &done.result, &done.text)?;
        if seen?.is_interrupted() {
            return Err(Failure::new(
                INTERRUPTED,
                "interrupted in the diagnosis by hand",
            ));
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
struct Told {
    lines: Vec<(StepState, String)>,
}

impl Told {
    fn tell(&mut self, progress: &Progress) {
        let total = progress.steps.len();
        self.lines
            .resize(total, (StepState::Waiting, String::new()));
        for (index, step) in progress.steps.iter().enumerate() {
            let now = (step.state, step.line.clone());
            if now == self.lines[index] {
                continue;
            }
            let number = index + 1;
            match step.state {
                StepState::Waiting => {}
                StepState::Active => {
                    output::message(&format!("[{number:>2}/{total}] {} ...", step.title));
                    progress::stage(&step.title, 0);
                }
                StepState::Done => output::message(&format!(
                    "[{number:>2}/{total}] {}: {}",
                    step.title, step.line
                )),
                StepState::Failed => {
                    output::message(&format!("[{number:>2}/{total}] {} failed", step.title));
                }
            }
            self.lines[index] = now;
        }
    }
}
