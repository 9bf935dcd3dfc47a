//! Screens over recorded runs: the diagnosis by hand, whose analysis runs on another thread, and the frequency response.

use std::fmt::Write as _;
use std::io::{ErrorKind, Write as _};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use serde::Serialize;

use crate::commands::evidence::{EvidenceFiles, Judging, Prepared, RecommendationBench, prepare};
use crate::commands::pages;
use crate::report::{Document, wording};
use crate::runtime::{
    Failure, Form, Recorded, ScreenEnd, ScreenReturn, Terminal, load, model_file, quoted_word,
    signals, spawn, watched,
};
use crate::tui::{
    self, Appearance, DiagnosisScreen, DiagnosisSources, Exit, Opens, ResponseScreen, Screen,
    StoppedAt,
};
use crate::workflow::{Discovery, News, Order};
use drivebench_bench::recording::ReadOptions;
use drivebench_diagnose::{Diagnosis, NextExperiment};
use drivebench_identify::frequency_response::{Compared, Pathway};
use drivebench_model::plant::FileHistory;

/// Data of the runs for the screen and the model file.
pub(crate) struct Shown {
    pub(crate) title: String,
    pub(crate) opens: Opens,
    pub(crate) stopped_at: Option<StoppedAt>,
    /// Run that the model is fitted on.
    pub(crate) fitted_on: String,
    /// Of the model that the diagnosis began with.
    pub(crate) history: FileHistory,
    pub(crate) output: Option<PathBuf>,
}

/// The present model and its diagnosis.
#[derive(Clone, Debug, Default)]
pub(crate) struct ScreenResult {
    /// The latest diagnosis; none before the first.
    pub(crate) diagnosis: Option<Diagnosis>,
    /// The run that was recommended with it; `None` also where the screen was left before.
    pub(crate) next: Option<NextExperiment>,
    /// The changes by hand, each with the held-out error after it.
    changes: Vec<String>,
    /// Changes after the diagnosis.
    undiagnosed: usize,
    written: Vec<String>,
    /// Whether the last of them is the present model.
    is_written: bool,
}

impl ScreenResult {
    fn update(&mut self, news: &News) {
        let (sign, change) = match news {
            News::Added(change) => ("+", change),
            News::Removed(change) => ("-", change),
            News::Diagnosed(diagnosis) => {
                self.diagnosis = Some((**diagnosis).clone());
                (self.next, self.undiagnosed) = (None, 0);
                return;
            }
            News::Undone { .. } => {
                // The diagnosis of the restored model follows at once.
                self.changes.pop();
                self.is_written = false;
                (self.diagnosis, self.next, self.undiagnosed) = (None, None, 0);
                return;
            }
            News::Recommended(next) => return self.next = next.as_deref().cloned(),
            _ => return,
        };
        if let (true, Some(rung)) = (change.accepted, change.ladder.last()) {
            self.changes.push(format!(
                "{sign} {}: held-out error {:.2} {}",
                change.effect,
                rung.holdout_rmse,
                wording::times(change.after.noise_floor_from)
            ));
            self.is_written = false;
            self.undiagnosed += 1;
        }
    }

    /// File of the present model.
    pub(crate) fn model(&self) -> Option<&str> {
        self.written.last().filter(|_| self.is_written).map(String::as_str)
    }

    /// The changes by hand, and whether the diagnosis is older than they are; empty where nothing was changed.
    pub(crate) fn heading(&self) -> String {
        let mut text: String =
            self.changes.iter().flat_map(|change| [change.as_str(), "\n"]).collect();
        if self.undiagnosed > 0 {
            let last = match self.undiagnosed {
                1 => "change".to_owned(),
                last => format!("{last} changes"),
            };
            let _ = writeln!(
                text,
                "left before this model was diagnosed: the diagnosis is that of the model without the last {last}"
            );
        }
        text
    }
}

pub(crate) struct Closed {
    exit: Exit,
    hang_up: Arc<AtomicBool>,
    result: ScreenResult,
}

impl Closed {
    /// The result, unless the screen was left by Ctrl-C, or by a signal until the very end.
    pub(crate) fn left(self, interrupted: &str) -> Result<ScreenResult, Failure> {
        if self.exit == Exit::Interrupted || self.hang_up.load(Ordering::Acquire) {
            return Err(Failure::interrupted(interrupted));
        }
        Ok(self.result)
    }
}

/// Diagnoses a run that was just recorded, if the user left its screen by that key; its last part is held out. Returns the
/// file of the model, if one was written.
pub(crate) fn go_on(
    screen: &ScreenEnd,
    folder: &Path,
    terminal: &Terminal,
) -> Result<Option<String>, Failure> {
    let ScreenEnd::Screen(exit) = screen else { return Ok(None) };
    let Some(opens) = Opens::after(*exit) else { return Ok(None) };
    let files = EvidenceFiles { for_screen: true, ..EvidenceFiles::of(folder, terminal) };
    let prepared =
        prepare(files, |path, _| load(path, ReadOptions::default(), terminal), Judging::Refits)?;
    let target = RecommendationBench::of(None, &prepared, terminal)?;
    let closed = show_prepared(&prepared, &target, opens, None, terminal)?;
    let result = closed.left("interrupted in the diagnosis by hand")?;
    Ok(result.model().map(str::to_owned))
}

/// Diagnoses a run that was just recorded, if requested, and prints the result of the run in any case. A failure of the run
/// (a trip, a lost drive) has priority over a failure of the diagnosis.
pub(super) fn finish<T: Serialize>(
    screen: ScreenEnd,
    recorded: &Recorded,
    result: &T,
    mut document: Document,
    form: Form,
    terminal: &Terminal,
) -> Result<(), Failure> {
    let diagnosed = go_on(&screen, recorded.folder.path(), terminal);
    if let Ok(Some(model)) = &diagnosed {
        document.go_on(format!("drivebench tune --model {}", quoted_word(model)));
    }
    terminal.document(result, form, &document)?;
    screen.conclude(recorded.failure()).and(diagnosed.map(drop))
}

/// Shows a model with its runs until the screen is left; from there a person may search for missing effects, and write the
/// model to `output`.
pub(super) fn show_prepared(
    prepared: &Prepared,
    target: &RecommendationBench,
    opens: Opens,
    output: Option<&Path>,
    terminal: &Terminal,
) -> Result<Closed, Failure> {
    let title = match opens {
        Opens::Comparison(_) => format!("{}; model: {}", prepared.about.title, prepared.model.from),
        _ => prepared.about.title.clone(),
    };
    let discovery = Discovery::new(prepared.model.file.model.clone(), prepared.evidence.clone())
        .with_recorded(prepared.recorded.clone())
        .with_limits(target.limits());
    let shown = Shown {
        title,
        opens,
        stopped_at: pages::stopped_at(prepared),
        fitted_on: prepared.run.run.name.clone(),
        history: prepared.model.file.history.clone(),
        output: output.map(Path::to_owned),
    };
    show(discovery, shown, terminal)
}

pub(crate) fn show(
    discovery: Discovery,
    shown: Shown,
    terminal: &Terminal,
) -> Result<Closed, Failure> {
    let hang_up = signals::flag()?;
    let (orders, received) = channel();
    let (sender, news) = channel();
    let sources = DiagnosisSources {
        title: shown.title.clone(),
        opens: shown.opens,
        stopped_at: shown.stopped_at.clone(),
        news,
        orders,
        hang_up: Arc::clone(&hang_up),
    };
    let result = Arc::new(Mutex::new(ScreenResult::default()));
    let gone = Arc::new(AtomicBool::new(false));
    let worker = Worker {
        shown,
        news: sender,
        result: Arc::clone(&result),
        gone: Arc::clone(&gone),
        terminal: terminal.clone(),
    };
    // Never joined: an analysis in progress has nothing to finish, and ends with the program.
    spawn("diagnosis", move || worker.carry_out(discovery, &received))?;
    let held = terminal.hold();
    let exit = until_left(DiagnosisScreen::new(sources), &hang_up, terminal.appearance());
    {
        // A model that is being written is finished; one that was not begun is not begun any more.
        let _whole = terminal.writing();
        gone.store(true, Ordering::Release);
    }
    drop(held);
    let result = lock(&result).clone();
    // The screen that displayed them is closed.
    for path in &result.written {
        terminal.message(&written_text(path));
    }
    Ok(Closed { exit: exit_of(exit?)?, hang_up, result })
}

/// Shows a screen under which nothing is energised until it is left, or its terminal is gone.
fn until_left(
    screen: impl Screen + Send + 'static,
    hang_up: &AtomicBool,
    appearance: Appearance,
) -> Result<ScreenReturn, Failure> {
    let closed = AtomicBool::new(false);
    watched(
        move || tui::show(screen, appearance),
        || closed.store(true, Ordering::Release),
        || closed.load(Ordering::Acquire) || hang_up.load(Ordering::Acquire),
    )
}

fn exit_of(watched: ScreenReturn) -> Result<Exit, Failure> {
    match watched {
        ScreenReturn::Left(Exit::WorkerPanicked) => {
            Err(Failure::internal("the analysis has panicked"))
        }
        ScreenReturn::Left(exit) => Ok(exit),
        // The terminal was closed, most likely: nothing is energised, and a model that was written is complete.
        ScreenReturn::Failed(reason) => {
            Err(Failure::interrupted(format!("the screen has failed: {reason}")))
        }
        ScreenReturn::Panicked(text) => {
            Err(Failure::internal(format!("the screen has panicked ({text})")))
        }
    }
}

pub(crate) fn show_response(
    title: String,
    compared: Compared,
    pathway: Option<Pathway>,
    terminal: &Terminal,
) -> Result<(), Failure> {
    let hang_up = signals::flag()?;
    let screen = ResponseScreen::new(title, compared, pathway, Arc::clone(&hang_up));
    let held = terminal.hold();
    let closed = until_left(screen, &hang_up, terminal.appearance());
    drop(held);
    if exit_of(closed?)? == Exit::Interrupted {
        return Err(Failure::interrupted("interrupted"));
    }
    Ok(())
}

fn lock(result: &Mutex<ScreenResult>) -> MutexGuard<'_, ScreenResult> {
    result.lock().unwrap_or_else(PoisonError::into_inner)
}

fn written_text(path: &str) -> String {
    format!("model written to {path}")
}

struct Worker {
    shown: Shown,
    news: Sender<News>,
    result: Arc<Mutex<ScreenResult>>,
    gone: Arc<AtomicBool>,
    terminal: Terminal,
}

impl Worker {
    /// Carries orders out until the screen was left.
    fn carry_out(&self, mut discovery: Discovery, orders: &Receiver<Order>) {
        let publish = |news: News| {
            lock(&self.result).update(&news);
            // A screen that was left receives no news.
            let _ = self.news.send(news);
        };
        while let Ok(order) = orders.recv() {
            if order != Order::Write {
                discovery.carry_out(order, &publish);
                continue;
            }
            publish(match self.write(&discovery) {
                Ok(path) => {
                    let path = path.display().to_string();
                    let text = written_text(&path);
                    let mut result = lock(&self.result);
                    result.written.push(path);
                    result.is_written = true;
                    News::Written(text)
                }
                Err(reason) => News::NotWritten(reason),
            });
        }
    }

    /// The model as it is, in a new file.
    fn write(&self, discovery: &Discovery) -> Result<PathBuf, String> {
        let fitted = discovery.fitted().ok_or("there is no fitted model yet")?;
        let (run, floor) = (Some(self.shown.fitted_on.clone()), fitted.noise.source);
        let file = model_file(fitted, &self.shown.history, run, discovery.ladder(), floor);
        let wanted = self.shown.output.as_deref().unwrap_or(Path::new("model.toml"));
        write_new(wanted, &file.to_toml(), &self.gone, &self.terminal)
    }
}

/// Writes under `wanted`, or where that is taken under the next free name: `model-2.toml`, `model-3.toml`, ... Once the
/// screen is `gone`, nothing: the program may end in the middle of it.
fn write_new(
    wanted: &Path,
    text: &str,
    gone: &AtomicBool,
    terminal: &Terminal,
) -> Result<PathBuf, String> {
    let _whole = terminal.writing();
    if gone.load(Ordering::Acquire) {
        return Err("the screen was left".to_owned());
    }
    for copy in 1..=1000 {
        let path = if copy == 1 {
            wanted.to_owned()
        } else {
            let stem = wanted.file_stem().unwrap_or_default().to_string_lossy();
            let ending = wanted.extension().unwrap_or_default().to_string_lossy();
            let dot = if ending.is_empty() { "" } else { "." };
            wanted.with_file_name(format!("{stem}-{copy}{dot}{ending}"))
        };
        let made = std::fs::File::create_new(&path);
        match made.and_then(|mut file| file.write_all(text.as_bytes())) {
            Ok(()) => return Ok(path),
            Err(error) if error.kind() == ErrorKind::AlreadyExists => {}
            Err(error) => return Err(format!("{}: {error}", path.display())),
        }
    }
    Err(format!("{}: 1000 files of that name exist", wanted.display()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use drivebench_diagnose::{DiagnosisVerdict, Evidence};
    use drivebench_model::plant::testing::with_a_fan;
    use drivebench_model::plant::{Model, Motor};

    #[test]
    fn a_file_that_exists_is_not_overwritten() {
        let folder = tempfile::tempdir().unwrap();
        let wanted = folder.path().join("model.toml");
        let (gone, terminal) = (AtomicBool::new(false), Terminal::default());
        for (text, name) in
            [("first", "model.toml"), ("second", "model-2.toml"), ("third", "model-3.toml")]
        {
            let path = write_new(&wanted, text, &gone, &terminal).unwrap();
            assert_eq!(path.file_name().unwrap(), name);
            assert_eq!(std::fs::read_to_string(&path).unwrap(), text);
        }
        assert_eq!(std::fs::read_to_string(&wanted).unwrap(), "first");
        let nowhere = folder.path().join("missing/model.toml");
        assert!(write_new(&nowhere, "text", &gone, &terminal).is_err());
        gone.store(true, Ordering::Release);
        assert!(write_new(&folder.path().join("late.toml"), "text", &gone, &terminal).is_err());
        assert!(!folder.path().join("late.toml").exists());
    }

    /// A motor with a fan, which is not in the model; at rest for long enough to estimate the noise.
    fn discovery() -> Discovery {
        let evidence = Evidence::new(with_a_fan(0), Some(with_a_fan(1)), None);
        Discovery::new(Model::baseline(Motor::zk_22fc()), evidence)
    }

    #[test]
    fn the_result_is_that_of_the_present_model() {
        let mut discovery = discovery();
        let result = Mutex::new(ScreenResult::default());
        let now = || result.lock().unwrap().clone();
        // As if the screen were left in between: the diagnosis is marked as older than the model.
        let between = Mutex::new(None);
        for order in [Order::Diagnose, Order::Add("quadratic_load")] {
            discovery.carry_out(order, &|news| {
                result.lock().unwrap().update(&news);
                if let News::Added(_) = news {
                    *between.lock().unwrap() = Some(now());
                }
            });
            if order == Order::Diagnose {
                assert_eq!(now().heading(), "");
                assert_eq!(now().diagnosis.unwrap().effect, Some("quadratic_load"));
            }
        }
        let heading = between.into_inner().unwrap().unwrap().heading();
        assert!(heading.starts_with("+ quadratic_load: held-out error "), "{heading}");
        assert!(heading.contains("without the last change"), "{heading}");
        let last = now();
        let answered = &last.diagnosis.as_ref().unwrap().baseline.model;
        assert_eq!(answered.effect_ids(), ["quadratic_load"]);
        assert_eq!(last.diagnosis.as_ref().unwrap().verdict, DiagnosisVerdict::None);
        assert_eq!(last.heading().lines().count(), 1, "{}", last.heading());
    }
}
