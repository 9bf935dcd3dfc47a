//! The terminal, given back on every path: end, error, panic here and panic elsewhere.

use std::io::{self, IsTerminal, Stdout, Write};
use std::mem::ManuallyDrop;
use std::panic::PanicHookInfo;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;

use crossterm::cursor::{Hide, Show};
use crossterm::execute;
use crossterm::terminal::{
    EnterAlternateScreen, LeaveAlternateScreen, disable_raw_mode, enable_raw_mode,
};
use ratatui::Terminal;
use ratatui::backend::CrosstermBackend;

type Hook = dyn Fn(&PanicHookInfo<'_>) + Send + Sync;

/// Raw mode, alternate screen and no cursor, for as long as it lives.
///
/// `ratatui::init` restores the terminal in the panic hook of whatever thread panics, and the screen would go on drawing
/// over the shell. Here a panic elsewhere is kept until the screen has left.
pub(super) struct Owned {
    /// Never dropped: its drop shows the cursor, and panics where neither the terminal nor standard error takes a word any
    /// more (`eprintln!` in `ratatui_core::terminal`). What it would do is done by [`give_back`].
    pub(super) terminal: ManuallyDrop<Terminal<CrosstermBackend<Stdout>>>,
    previous: Arc<Hook>,
    elsewhere: Arc<Mutex<Vec<String>>>,
}

impl Owned {
    /// # Errors
    /// Standard output is not a terminal, or the terminal refuses raw mode.
    pub(super) fn take() -> io::Result<Self> {
        // Keys come from the controlling terminal, wherever standard input is.
        if !io::stdout().is_terminal() {
            return Err(io::Error::other(
                "standard output is not a terminal, so there is no screen (help: use --headless)",
            ));
        }
        let terminal = enter().inspect_err(|_| give_back())?;
        let previous: Arc<Hook> = Arc::from(std::panic::take_hook());
        let elsewhere = Arc::new(Mutex::new(Vec::new()));
        let (screen, after, kept) = (
            thread::current().id(),
            Arc::clone(&previous),
            Arc::clone(&elsewhere),
        );
        std::panic::set_hook(Box::new(move |info| {
            if thread::current().id() == screen {
                give_back();
                after(info);
            } else {
                let name = thread::current().name().unwrap_or("worker").to_owned();
                let mut kept = kept.lock().unwrap_or_else(PoisonError::into_inner);
                kept.push(format!("thread {name:?}: {info}"));
            }
        }));
        Ok(Self {
            terminal: ManuallyDrop::new(terminal),
            previous,
            elsewhere,
        })
    }

    /// Whether a thread other than the screen's has panicked.
    pub(super) fn panicked_elsewhere(&self) -> bool {
        !self
            .elsewhere
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .is_empty()
    }
}

impl Drop for Owned {
    fn drop(&mut self) {
        give_back();
        if !thread::panicking() {
            let previous = Arc::clone(&self.previous);
            drop(std::panic::take_hook());
            std::panic::set_hook(Box::new(move |info| previous(info)));
        }
        let kept = self
            .elsewhere
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        for message in kept.iter() {
            // Nothing is left to report to if this fails.
            let _ = writeln!(io::stderr(), "{message}");
        }
    }
}

fn enter() -> io::Result<Terminal<CrosstermBackend<Stdout>>> {
    enable_raw_mode()?;
    execute!(io::stdout(), EnterAlternateScreen, Hide)?;
    Terminal::new(CrosstermBackend::new(io::stdout()))
}

fn give_back() {
    // A terminal that is gone cannot be restored, and need not be.
    let _ = disable_raw_mode();
    let _ = execute!(io::stdout(), LeaveAlternateScreen, Show);
}
