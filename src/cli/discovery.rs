//! The diagnosis screen on this thread, the analysis on another; the model file.

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, OnceLock};
use std::thread;

use super::failure::{Failure, INTERNAL, INTERRUPTED};
use super::model_output;
use crate::diagnosis::Diagnosis;
use crate::plant::{FileHistory, ModelFile};
use crate::tui::{DiscoveryScreen, Exit, show_discovery};
use crate::workflow::{Discovery, News, Order};

/// Where a model goes for which no name was given.
const MODEL: &str = "model.toml";

/// What the screen and the model file say of the runs.
pub(super) struct Shown {
    pub(super) title: String,
    pub(super) guess_first: bool,
    /// Run that the model is fitted on.
    pub(super) fitted_on: String,
    /// Of the model that the diagnosis began with.
    pub(super) history: FileHistory,
    pub(super) output: Option<PathBuf>,
}

/// Shows the screen until it is left; returns the answer to the model as it was given.
pub(super) fn show(discovery: Discovery, shown: Shown) -> Result<Diagnosis, Failure> {
    let hang_up = Arc::new(AtomicBool::new(false));
    for signal in [
        signal_hook::consts::SIGINT,
        signal_hook::consts::SIGTERM,
        signal_hook::consts::SIGHUP,
    ] {
        signal_hook::flag::register(signal, Arc::clone(&hang_up)).map_err(|error| {
            Failure::new(INTERNAL, format!("cannot watch for signals: {error}"))
        })?;
    }
    let (orders, ordered) = channel();
    let (told, news) = channel();
    let screen = DiscoveryScreen {
        title: shown.title.clone(),
        guess_first: shown.guess_first,
        news,
        orders,
        hang_up,
    };
    let first = Arc::new(OnceLock::new());
    let found = Arc::clone(&first);
    // Never joined: an analysis in progress has nothing to put down, and ends with the program.
    thread::Builder::new()
        .name("diagnosis".to_owned())
        .spawn(move || work(discovery, &shown, &ordered, &told, &found))
        .map_err(|error| Failure::new(INTERNAL, format!("cannot start a thread: {error}")))?;
    let exit = show_discovery(screen)
        .map_err(|error| Failure::new(INTERNAL, format!("the screen has failed: {error}")))?;
    if exit == Exit::WorkerPanicked {
        return Err(Failure::new(INTERNAL, "the analysis has panicked"));
    }
    match first.get() {
        Some(diagnosis) if exit != Exit::Interrupted => Ok(diagnosis.clone()),
        Some(_) => Err(Failure::new(INTERRUPTED, "interrupted")),
        None => Err(Failure::new(INTERRUPTED, "left before there was an answer")),
    }
}

/// Carries orders out until the screen has gone.
fn work(
    mut discovery: Discovery,
    shown: &Shown,
    ordered: &Receiver<Order>,
    told: &Sender<News>,
    first: &OnceLock<Diagnosis>,
) {
    let tell = |news: News| {
        if let News::Diagnosed(diagnosis) = &news {
            first.get_or_init(|| (**diagnosis).clone());
        }
        // A screen that has gone needs no news.
        let _ = told.send(news);
    };
    while let Ok(order) = ordered.recv() {
        if order == Order::Write {
            tell(News::Written(match write(&discovery, shown) {
                Ok(path) => format!("model written to {}", path.display()),
                Err(reason) => format!("NOT WRITTEN: {reason}"),
            }));
        } else {
            discovery.carry_out(order, &tell);
        }
    }
}

/// The model as it stands, in a new file.
fn write(discovery: &Discovery, shown: &Shown) -> Result<PathBuf, String> {
    let Some(fitted) = discovery.fitted() else {
        return Err("there is no fitted model yet".to_owned());
    };
    let mut history = FileHistory {
        fitted: model_output::fitted(&fitted.parameters),
        fitted_on: vec![shown.fitted_on.clone()],
        ..shown.history.clone()
    };
    for rung in discovery.ladder() {
        let line = model_output::rung(rung, fitted.noise.source);
        if history.ladder.last() != Some(&line) {
            history.ladder.push(line);
        }
    }
    let file = ModelFile {
        model: fitted.model.clone(),
        history,
    };
    let wanted = shown.output.as_deref().unwrap_or_else(|| Path::new(MODEL));
    write_new(wanted, &file.to_toml())
}

/// Copies that are tried beside a name that is taken.
const MOST_COPIES: u32 = 1000;

/// Writes under `wanted`, or where that is taken under the next free name: `model-2.toml`, `model-3.toml`, ...
fn write_new(wanted: &Path, text: &str) -> Result<PathBuf, String> {
    for copy in 1..=MOST_COPIES {
        let path = if copy == 1 {
            wanted.to_owned()
        } else {
            let stem = wanted.file_stem().unwrap_or_default().to_string_lossy();
            let ending = wanted.extension().unwrap_or_default().to_string_lossy();
            let dot = if ending.is_empty() { "" } else { "." };
            wanted.with_file_name(format!("{stem}-{copy}{dot}{ending}"))
        };
        match std::fs::File::create_new(&path) {
            Ok(mut file) => {
                return file
                    .write_all(text.as_bytes())
                    .map(|()| path.clone())
                    .map_err(|error| format!("{}: {error}", path.display()));
            }
            Err(error) if error.kind() == std::io::ErrorKind::AlreadyExists => {}
            Err(error) => return Err(format!("{}: {error}", path.display())),
        }
    }
    Err(format!(
        "{}: {MOST_COPIES} files of that name exist",
        wanted.display()
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_that_is_taken_is_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        let wanted = folder.path().join("model.toml");
        let names: Vec<String> = ["first", "second", "third"]
            .into_iter()
            .map(|text| {
                let path = write_new(&wanted, text).unwrap();
                assert_eq!(std::fs::read_to_string(&path).unwrap(), text);
                path.file_name().unwrap().to_string_lossy().into_owned()
            })
            .collect();
        assert_eq!(names, ["model.toml", "model-2.toml", "model-3.toml"]);
        assert_eq!(std::fs::read_to_string(&wanted).unwrap(), "first");
        let nowhere = folder.path().join("missing/model.toml");
        assert!(write_new(&nowhere, "text").is_err());
    }
}
