//! The diagnosis by hand: its screen on this thread, the analysis on another; the model file. And the screen of a frequency
//! response, which has no analysis behind it.

use std::fmt::Write as _;
use std::io::{ErrorKind, Write as _};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::commands::evidence::{EvidenceFiles, Judging, Place, prepare};
use crate::commands::pages;
use crate::runtime::ending;
use crate::runtime::ending::{Watched, spawn, watched};
use crate::runtime::failure::Failure;
use crate::runtime::files::{load, model_file};
use crate::runtime::{appearance, output, signals};
use crate::tui::{
    self, DiagnosisScreen, DiagnosisSources, Exit, Opens, ResponseScreen, Screen, StoppedAt,
};
use crate::workflow::{Discovery, News, Order};
use drivebench_diagnose::{Diagnosis, NextExperiment};
use drivebench_identify::frequency_response::{Compared, Pathway};
use drivebench_model::plant::FileHistory;

/// Where a model goes for which no name was given.
const MODEL: &str = "model.toml";

/// Said of a model, before the name of its file.
const WRITTEN: &str = "model written to ";

/// What the screen and the model file say of the runs.
pub(crate) struct Shown {
    pub(crate) title: String,
    /// With what the screen opens.
    pub(crate) opens: Opens,
    /// Where the run was stopped, if it was.
    pub(crate) stopped_at: Option<StoppedAt>,
    /// Run that the model is fitted on.
    pub(crate) fitted_on: String,
    /// Of the model that the diagnosis began with.
    pub(crate) history: FileHistory,
    pub(crate) output: Option<PathBuf>,
}

/// How things stand with the model.
#[derive(Clone, Debug, Default)]
pub(crate) struct Standing {
    /// The latest answer; none before the first.
    pub(crate) diagnosis: Option<Diagnosis>,
    /// The run that was recommended with it; none where there is none, or it was not waited for.
    pub(crate) next: Option<NextExperiment>,
    /// What was changed by hand, each with the held-out error after it.
    changes: Vec<String>,
    /// Changes that the answer does not know of: it was not waited for.
    since: usize,
    /// Where models were written to.
    written: Vec<String>,
    /// The last of them is the model as it stands.
    is_written: bool,
}

impl Standing {
    fn hear(&mut self, news: &News) {
        let (sign, result) = match news {
            News::Added(result) => ("+", result),
            News::Removed(result) => ("-", result),
            News::Diagnosed(diagnosis) => {
                self.diagnosis = Some((**diagnosis).clone());
                (self.next, self.since) = (None, 0);
                return;
            }
            News::Undone { .. } => {
                // The answer to the model as it is again follows at once.
                self.changes.pop();
                self.is_written = false;
                (self.diagnosis, self.next, self.since) = (None, None, 0);
                return;
            }
            News::Recommended(next) => return self.next = next.as_deref().cloned(),
            News::Written(text) => {
                self.is_written = true;
                return self.written.push(text.clone());
            }
            _ => return,
        };
        if let (true, Some(rung)) = (result.accepted, result.ladder.last()) {
            let (effect, error) = (result.effect, rung.holdout_rmse);
            let times = result.after.noise_floor_from.times();
            let change = format!("{sign} {effect}: held-out error {error:.2} {times}");
            self.changes.push(change);
            self.is_written = false;
            self.since += 1;
        }
    }

    /// Where the model as it stands was written to.
    pub(crate) fn model(&self) -> Option<&str> {
        let last = self.written.last().filter(|_| self.is_written);
        last?.strip_prefix(WRITTEN)
    }

    /// What was changed by hand, and whether the answer below it knows of that; nothing where nothing was changed.
    pub(crate) fn heading(&self) -> String {
        let changes = self.changes.iter();
        let lines: Vec<String> = changes.map(|change| format!("{change}\n")).collect();
        let mut text = lines.concat();
        if self.since > 0 {
            let last = match self.since {
                1 => "change".to_owned(),
                last => format!("{last} changes"),
            };
            let _ = writeln!(
                text,
                "left before there was an answer to that model: what follows is about the model without the last {last}"
            );
        }
        text
    }
}

/// How the screen was left.
pub(crate) struct Left {
    exit: Exit,
    hang_up: Arc<AtomicBool>,
    pub(crate) standing: Standing,
}

impl Left {
    /// Ctrl-C or a signal, which may come until the very end.
    pub(crate) fn is_interrupted(&self) -> bool {
        self.exit == Exit::Interrupted || self.hang_up.load(Ordering::Acquire)
    }
}

/// Goes on with a run that was just recorded, where its screen was left for that; its last part is held out. Where the
/// model as it stands then was written to, if it was.
pub(crate) fn go_on(left: &ending::Left, folder: &Path) -> Result<Option<String>, Failure> {
    let opens = match left {
        ending::Left::Screen(exit) => Opens::asked_by(*exit),
        _ => None,
    };
    let Some(opens) = opens else {
        return Ok(None);
    };
    let seen = show_run(folder, opens)?;
    if seen.is_interrupted() {
        return Err(Failure::interrupted("interrupted in the diagnosis by hand"));
    }
    Ok(seen.standing.model().map(str::to_owned))
}

fn show_run(folder: &Path, opens: Opens) -> Result<Left, Failure> {
    let files = EvidenceFiles {
        run: folder,
        model: None,
        holdout: None,
        confirm: None,
        later: &[],
        for_screen: true,
    };
    let prepared = prepare(files, |path, _| load(path, None), Judging::Refits)?;
    let place = Place::of(None, &prepared)?;
    let shown = Shown {
        title: prepared.about.title.clone(),
        opens,
        stopped_at: pages::stopped_at(&prepared),
        fitted_on: prepared.run.run.name.clone(),
        history: prepared.model.file.history.clone(),
        output: None,
    };
    let discovery = Discovery::new(prepared.model.file.model, prepared.evidence)
        .with_recorded(prepared.recorded);
    show(discovery.with_limits(place.limits()), shown)
}

/// Shows the screen until it is left.
pub(crate) fn show(discovery: Discovery, shown: Shown) -> Result<Left, Failure> {
    let hang_up = signals::flag()?;
    let (orders, ordered) = channel();
    let (told, news) = channel();
    let sources = DiagnosisSources {
        title: shown.title.clone(),
        opens: shown.opens,
        stopped_at: shown.stopped_at.clone(),
        news,
        orders,
        hang_up: Arc::clone(&hang_up),
    };
    let standing = Arc::new(Mutex::new(Standing::default()));
    let gone = Arc::new(AtomicBool::new(false));
    let (heard, is_left) = (Arc::clone(&standing), Arc::clone(&gone));
    // Never joined: an analysis in progress has nothing to put down, and ends with the program.
    spawn("diagnosis", move || {
        work(discovery, &shown, &ordered, &told, &heard, &is_left);
    })?;
    let held = output::hold();
    let exit = until_left(DiagnosisScreen::new(sources), &hang_up);
    {
        // A model that is being written is finished; one that was not begun is not begun any more.
        let _whole = signals::writing();
        gone.store(true, Ordering::Release);
    }
    drop(held);
    let standing = lock(&standing).clone();
    // The screen that said so is gone.
    standing.written.iter().for_each(|text| output::message(text));
    let exit = exit_of(exit?)?;
    Ok(Left { exit, hang_up, standing })
}

/// Shows a screen under which nothing is energised until it is left, or its terminal is gone.
fn until_left(
    screen: impl Screen + Send + 'static,
    hang_up: &AtomicBool,
) -> Result<Watched, Failure> {
    let closed = AtomicBool::new(false);
    watched(
        move || tui::show(screen, appearance::get()),
        || closed.store(true, Ordering::Release),
        || closed.load(Ordering::Acquire) || hang_up.load(Ordering::Acquire),
    )
}

fn exit_of(watched: Watched) -> Result<Exit, Failure> {
    match watched {
        Watched::Left(Exit::WorkerPanicked) => Err(Failure::internal("the analysis has panicked")),
        Watched::Left(exit) => Ok(exit),
        // Closed, most likely: nothing is energised, and a model that was written is there.
        Watched::Failed(reason) => {
            let headline = format!("the screen has failed: {reason}");
            Err(Failure::interrupted(headline))
        }
        Watched::Panicked(said) => {
            let headline = format!("the screen has panicked ({said})");
            Err(Failure::internal(headline))
        }
    }
}

/// Shows a frequency response until its screen is left.
pub(crate) fn show_response(
    title: String,
    compared: Compared,
    asked: Option<Pathway>,
) -> Result<(), Failure> {
    let hang_up = signals::flag()?;
    let screen = ResponseScreen::new(title, compared, asked, Arc::clone(&hang_up));
    let held = output::hold();
    let left = until_left(screen, &hang_up);
    drop(held);
    if exit_of(left?)? == Exit::Interrupted {
        return Err(Failure::interrupted("interrupted"));
    }
    Ok(())
}

fn lock(standing: &Mutex<Standing>) -> MutexGuard<'_, Standing> {
    standing.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Carries orders out until the screen has gone.
fn work(
    mut discovery: Discovery,
    shown: &Shown,
    ordered: &Receiver<Order>,
    told: &Sender<News>,
    standing: &Mutex<Standing>,
    gone: &AtomicBool,
) {
    let tell = |news: News| {
        lock(standing).hear(&news);
        // A screen that has gone needs no news.
        let _ = told.send(news);
    };
    while let Ok(order) = ordered.recv() {
        if order == Order::Write {
            tell(match write(&discovery, shown, gone) {
                Ok(path) => News::Written(format!("{WRITTEN}{}", path.display())),
                Err(reason) => News::NotWritten(reason),
            });
        } else {
            discovery.carry_out(order, &tell);
        }
    }
}

/// The model as it stands, in a new file.
fn write(discovery: &Discovery, shown: &Shown, gone: &AtomicBool) -> Result<PathBuf, String> {
    let fitted = discovery.fitted().ok_or("there is no fitted model yet")?;
    let (run, floor) = (Some(shown.fitted_on.clone()), fitted.noise.source);
    let file = model_file(fitted, &shown.history, run, discovery.ladder(), floor);
    let wanted = shown.output.as_deref().unwrap_or_else(|| Path::new(MODEL));
    write_new(wanted, &file.to_toml(), gone)
}

/// Copies that are tried beside a name that is taken.
const MOST_COPIES: u32 = 1000;

/// Writes under `wanted`, or where that is taken under the next free name: `model-2.toml`, `model-3.toml`, ... Once the
/// screen is `gone`, nothing: the program may end in the middle of it.
fn write_new(wanted: &Path, text: &str, gone: &AtomicBool) -> Result<PathBuf, String> {
    let _whole = signals::writing();
    if gone.load(Ordering::Acquire) {
        return Err("the screen was left".to_owned());
    }
    for copy in 1..=MOST_COPIES {
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
    Err(format!("{}: {MOST_COPIES} files of that name exist", wanted.display()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use drivebench_diagnose::{DiagnosisVerdict, Evidence};
    use drivebench_model::plant::testing::with_a_fan;
    use drivebench_model::plant::{Model, Motor};

    #[test]
    fn a_name_that_is_taken_is_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        let wanted = folder.path().join("model.toml");
        let gone = AtomicBool::new(false);
        for (text, name) in
            [("first", "model.toml"), ("second", "model-2.toml"), ("third", "model-3.toml")]
        {
            let path = write_new(&wanted, text, &gone).unwrap();
            assert_eq!(path.file_name().unwrap(), name);
            assert_eq!(std::fs::read_to_string(&path).unwrap(), text);
        }
        assert_eq!(std::fs::read_to_string(&wanted).unwrap(), "first");
        let nowhere = folder.path().join("missing/model.toml");
        assert!(write_new(&nowhere, "text", &gone).is_err());
        gone.store(true, Ordering::Release);
        assert!(write_new(&folder.path().join("late.toml"), "text", &gone).is_err());
        assert!(!folder.path().join("late.toml").exists());
    }

    /// A motor with a fan, which is not in the model; at rest for long enough to know the noise.
    fn discovery() -> Discovery {
        let evidence = Evidence::new(with_a_fan(0), Some(with_a_fan(1)), None);
        Discovery::new(Model::baseline(Motor::zk_22fc()), evidence)
    }

    #[test]
    fn what_is_left_behind_is_about_the_model_as_it_stands() {
        let mut discovery = discovery();
        let standing = Mutex::new(Standing::default());
        let now = || standing.lock().unwrap().clone();
        // As if the screen were left in the middle: the answer is old, and it is said so.
        let between = Mutex::new(None);
        for order in [Order::Diagnose, Order::Add("quadratic_load")] {
            discovery.carry_out(order, &|news| {
                standing.lock().unwrap().hear(&news);
                if let News::Added(_) = news {
                    *between.lock().unwrap() = Some(now());
                }
            });
            if order == Order::Diagnose {
                assert_eq!(now().heading(), "");
                assert_eq!(now().diagnosis.unwrap().effect, Some("quadratic_load"));
            }
        }
        let between = between.into_inner().unwrap().unwrap();
        let heading = between.heading();
        assert!(heading.starts_with("+ quadratic_load: held-out error "), "{heading}");
        assert!(heading.contains("without the last change"), "{heading}");
        let last = now();
        let answered = &last.diagnosis.as_ref().unwrap().baseline.model;
        assert_eq!(answered.effect_ids(), ["quadratic_load"]);
        assert_eq!(last.diagnosis.as_ref().unwrap().verdict, DiagnosisVerdict::None);
        assert_eq!(last.heading().lines().count(), 1, "{}", last.heading());
    }
}
