//! The event loop of every screen: keys and changes in, effects out, a frame after each change; the terminal, given back on
//! every path: end, error, panic here and panic elsewhere.

use std::io::{self, IsTerminal, Stdout, Write};
use std::mem::ManuallyDrop;
use std::os::fd::AsFd as _;
use std::panic::PanicHookInfo;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use crossterm::cursor::{Hide, Show};
use crossterm::event::{
    self, DisableMouseCapture, Event as TerminalEvent, MouseButton, MouseEvent, MouseEventKind,
};
use crossterm::execute;
use crossterm::style::Print;
use crossterm::terminal::{
    EnterAlternateScreen, LeaveAlternateScreen, disable_raw_mode, enable_raw_mode,
};
use nix::errno::Errno;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::signal::{SaFlags, SigAction, SigHandler, SigSet, Signal, kill, sigaction};
use nix::unistd::{Pid, getpgrp, getpid, getsid, tcgetpgrp};
use ratatui::backend::CrosstermBackend;
use ratatui::layout::{Position, Rect};
use ratatui::{Frame, Terminal};
use signal_hook::consts::SIGCONT;

use super::keys::{KeyRepeat, Press, press};
use super::theme::{self, Appearance};
use crate::workflow::Order;
use drivebench_bench::Intent;

/// Longest time between two updates of a screen: 25 frames a second. A key is answered at once.
const FRAME: Duration = Duration::from_millis(40);

/// Reports of buttons and wheel, with places beyond column 223; crossterm's own sequence reports every motion too.
const BUTTONS_AND_WHEEL: &str = "\x1b[?1000h\x1b[?1006h";

/// Why a screen was left; the outcome of the motor comes from the worker.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exit {
    Finished,
    /// `d` after the work: the diagnosis is continued by hand.
    Diagnosis,
    /// `v` after the work: the same, with measured and model over time first.
    Traces,
    /// The recommended run is to be made.
    Experiment,
    /// The speed loop is to be run with the identified model.
    SpeedLoop,
    /// `q` before the end; the worker has received the stop.
    Quit,
    /// Ctrl-C or a signal; the worker has stopped.
    Interrupted,
    /// Ctrl-C three times: the worker did not end. Wait for it for a limited time.
    Forced,
    /// Another thread panicked; its message is on standard error.
    WorkerPanicked,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Effect {
    Send(Intent),
    /// Nothing more is to be started, also between two runs, where intents are not read.
    RequestStop,
    Order(Order),
    Leave(Exit),
}

/// A screen as a value, with its ends of the channels.
pub trait Screen {
    /// Takes new values from its channels; whether there were any, and the exit if one closes the screen.
    fn poll(&mut self) -> (bool, Option<Exit>);
    /// Handles a key; the exit if it closes the screen.
    fn press(&mut self, press: Press) -> Option<Exit>;
    /// Handles a click of the mouse on a screen of this size.
    fn click(&mut self, at: Position, area: Rect);
    /// Shows a message instead of that of the last key.
    fn notify(&mut self, text: &str);
    /// Whether the program may be halted now; else the screen shows why not. An analysis goes on where it was.
    fn may_suspend(&mut self) -> bool {
        true
    }
    /// Whether a panic of another thread is the end of it: where nothing is energised.
    fn ends_with_a_panic(&self) -> bool {
        true
    }
    fn draw(&self, frame: &mut Frame<'_>);
}

/// Shows a screen on the calling thread until it is left.
///
/// # Errors
/// Standard output is not a terminal, or the terminal fails. A bench must not go on under a screen that has failed or
/// panicked: that is for the caller to see to.
#[expect(
    clippy::disallowed_methods,
    reason = "the clock of a person's keys: nothing that is computed depends on it"
)]
pub fn show(mut screen: impl Screen, appearance: Appearance) -> io::Result<Exit> {
    let mut owned = RawTerminal::take(appearance.takes_mouse)?;
    let mut changed = true;
    let mut input = Input::new(Instant::now());
    loop {
        let (is_changed, exit) = screen.poll();
        if let Some(exit) = exit {
            return Ok(exit);
        }
        if !kept(&owned.elsewhere).is_empty() && screen.ends_with_a_panic() {
            return Ok(Exit::WorkerPanicked);
        }
        if std::mem::take(&mut changed) || is_changed {
            owned.terminal.draw(|frame| {
                screen.draw(frame);
                if appearance.is_light {
                    theme::lighten(frame.buffer_mut());
                }
            })?;
        }
        // Checked before the read: crossterm does not return from the read of a closed terminal.
        if is_gone(FRAME)? {
            return Err(io::Error::other("the terminal is gone"));
        }
        let mut events = Vec::new();
        while event::poll(Duration::ZERO)? {
            events.push(event::read()?);
        }
        // A change of size only needs a new frame.
        changed |= events.iter().any(TerminalEvent::is_resize);
        let presses = input.presses(events, Instant::now());
        changed |= !presses.is_empty();
        for press in presses {
            if let Press::Click(at) = press {
                let area = Rect::from((Position::ORIGIN, owned.terminal.size()?));
                if area.contains(at) {
                    screen.click(at, area);
                }
            } else if press == Press::Suspend {
                if screen.may_suspend() && !owned.suspend()? {
                    screen.notify("Ctrl-Z: there is no shell that could resume this program");
                }
            } else if let Some(exit) = screen.press(press) {
                return Ok(exit);
            }
        }
    }
}

/// Keys and mouse, from one poll of the terminal to the next.
struct Input {
    repeat: KeyRepeat,
    /// When the latest key or frame without one was counted.
    counted: Instant,
}

impl Input {
    fn new(now: Instant) -> Self {
        Self { repeat: KeyRepeat::default(), counted: now }
    }

    /// Presses in their order. A frame without a key has the same length whatever else wakes the loop: a delayed stop key comes
    /// after it.
    fn presses(&mut self, events: Vec<TerminalEvent>, now: Instant) -> Vec<Press> {
        let mut presses = Vec::new();
        let mut has_key = false;
        for event in events {
            match event {
                TerminalEvent::Key(key) => {
                    let press = press(key);
                    has_key |= press.is_some();
                    presses.extend(press.and_then(|press| self.repeat.key(press)));
                }
                TerminalEvent::Mouse(mouse) => presses.extend(mouse_press(mouse)),
                _ => {}
            }
        }
        let is_frame = !has_key && now.duration_since(self.counted) >= FRAME;
        if is_frame {
            presses.extend(self.repeat.frame());
        }
        if has_key || is_frame {
            self.counted = now;
        }
        presses
    }
}

/// `None` where the mouse only moves.
const fn mouse_press(mouse: MouseEvent) -> Option<Press> {
    match mouse.kind {
        MouseEventKind::ScrollUp => Some(Press::Wheel(-1)),
        MouseEventKind::ScrollDown => Some(Press::Wheel(1)),
        MouseEventKind::Down(MouseButton::Left) => {
            Some(Press::Click(Position::new(mouse.column, mouse.row)))
        }
        _ => None,
    }
}

/// Waits for a key, for `longest` at most; whether the terminal has been closed.
pub fn is_gone(longest: Duration) -> io::Result<bool> {
    let stdout = io::stdout();
    let mut terminal = [PollFd::new(stdout.as_fd(), PollFlags::POLLIN)];
    match poll(&mut terminal, PollTimeout::try_from(longest).unwrap_or(PollTimeout::ZERO)) {
        // A signal, as that of a change of size, ends the wait.
        Ok(_) | Err(Errno::EINTR) => {}
        Err(error) => return Err(error.into()),
    }
    let gone = PollFlags::POLLHUP | PollFlags::POLLERR | PollFlags::POLLNVAL;
    Ok(terminal[0].revents().is_some_and(|events| events.intersects(gone)))
}

type Hook = dyn Fn(&PanicHookInfo<'_>) + Send + Sync;

/// Raw mode, alternate screen and no cursor, for as long as it lives.
///
/// `ratatui::init` restores the terminal in the panic hook of whatever thread panics, and the screen would go on drawing
/// over the shell. Here a panic elsewhere is kept until the screen has left.
struct RawTerminal {
    /// Never dropped: its drop shows the cursor, and panics where neither the terminal nor standard error accepts output
    /// (`eprintln!` in `ratatui_core::terminal`). [`restore`] does the same without a panic.
    terminal: ManuallyDrop<Terminal<CrosstermBackend<Stdout>>>,
    takes_mouse: bool,
    previous: Arc<Hook>,
    elsewhere: Arc<Mutex<Vec<String>>>,
}

impl RawTerminal {
    /// # Errors
    /// Standard output is not a terminal, or the terminal refuses raw mode.
    fn take(takes_mouse: bool) -> io::Result<Self> {
        // Keys come from the controlling terminal, wherever standard input is.
        if !io::stdout().is_terminal() {
            return Err(io::Error::other(
                "standard output is not a terminal, so there is no screen (help: use --headless)",
            ));
        }
        let terminal = enter(takes_mouse).inspect_err(|_| restore(takes_mouse))?;
        let previous: Arc<Hook> = Arc::from(std::panic::take_hook());
        let elsewhere = Arc::new(Mutex::new(Vec::new()));
        let screen = thread::current().id();
        let (after, others) = (Arc::clone(&previous), Arc::clone(&elsewhere));
        std::panic::set_hook(Box::new(move |info| {
            if thread::current().id() == screen {
                restore(takes_mouse);
                after(info);
            } else {
                let name = thread::current().name().unwrap_or("worker").to_owned();
                kept(&others).push(format!("thread {name:?}: {info}"));
            }
        }));
        Ok(Self { terminal: ManuallyDrop::new(terminal), takes_mouse, previous, elsewhere })
    }

    /// Gives the terminal back and halts the program, with everything that was started with it, until it is in the
    /// foreground again; whether it could be halted.
    fn suspend(&mut self) -> io::Result<bool> {
        // A session leader has no shell that could resume it.
        if getsid(None) == Ok(getpid()) {
            return Ok(false);
        }
        restore(self.takes_mouse);
        let mut is_halted = halt_group()?;
        // In the background it must not draw over the shell: it is halted again.
        while is_halted && tcgetpgrp(io::stdout()).is_ok_and(|owner| owner != getpgrp()) {
            is_halted = halt_group()?;
        }
        // A new one draws every cell; the old one must not be dropped.
        self.terminal = ManuallyDrop::new(enter(self.takes_mouse)?);
        Ok(is_halted)
    }
}

/// Halts the process group as the terminal itself would: `cargo run` and this program are one job of the shell;
/// whether it was resumed.
fn halt_group() -> io::Result<bool> {
    let resumed = Arc::new(AtomicBool::new(false));
    let watch = signal_hook::flag::register(SIGCONT, Arc::clone(&resumed))?;
    let default = SigAction::new(SigHandler::SigDfl, SaFlags::empty(), SigSet::empty());
    #[expect(unsafe_code, reason = "there is no safe way to the default of a signal")]
    // SAFETY: the default action runs nothing of ours, and what is put back is what was there.
    let before = unsafe { sigaction(Signal::SIGTSTP, &default) }?;
    let sent = kill(Pid::from_raw(0), Signal::SIGTSTP);
    // Up to 0.5 s: on a busy machine the signal may be delivered late.
    for _ in 0..50 {
        if sent.is_err() || resumed.load(Ordering::Acquire) {
            break;
        }
        thread::sleep(Duration::from_millis(10));
    }
    #[expect(unsafe_code, reason = "as above")]
    // SAFETY: as above.
    unsafe { sigaction(Signal::SIGTSTP, &before) }?;
    signal_hook::low_level::unregister(watch);
    sent?;
    Ok(resumed.load(Ordering::Acquire))
}

fn kept(messages: &Mutex<Vec<String>>) -> MutexGuard<'_, Vec<String>> {
    messages.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Drop for RawTerminal {
    fn drop(&mut self) {
        restore(self.takes_mouse);
        if !thread::panicking() {
            let previous = Arc::clone(&self.previous);
            drop(std::panic::take_hook());
            std::panic::set_hook(Box::new(move |info| previous(info)));
        }
        for message in kept(&self.elsewhere).iter() {
            // Nothing is left to report to if this fails.
            let _ = writeln!(io::stderr(), "{message}");
        }
    }
}

fn enter(takes_mouse: bool) -> io::Result<Terminal<CrosstermBackend<Stdout>>> {
    enable_raw_mode()?;
    execute!(io::stdout(), EnterAlternateScreen, Hide)?;
    if takes_mouse {
        execute!(io::stdout(), Print(BUTTONS_AND_WHEEL))?;
    }
    Terminal::new(CrosstermBackend::new(io::stdout()))
}

fn restore(takes_mouse: bool) {
    // A terminal that is gone cannot be restored, and need not be.
    let _ = disable_raw_mode();
    if takes_mouse {
        let _ = execute!(io::stdout(), DisableMouseCapture);
    }
    let _ = execute!(io::stdout(), LeaveAlternateScreen, Show);
}

#[cfg(test)]
#[expect(clippy::disallowed_methods, reason = "an instant to count from")]
mod tests {
    use crossterm::event::{KeyCode, KeyEvent, KeyModifiers};

    use super::*;

    fn key(code: KeyCode) -> TerminalEvent {
        TerminalEvent::Key(KeyEvent::new(code, KeyModifiers::NONE))
    }

    fn mouse(kind: MouseEventKind) -> TerminalEvent {
        TerminalEvent::Mouse(MouseEvent { kind, column: 7, row: 3, modifiers: KeyModifiers::NONE })
    }

    #[test]
    fn a_second_stop_counts_whatever_the_mouse_does() {
        for (name, kind) in [
            ("rests", None),
            ("moves", Some(MouseEventKind::Moved)),
            ("drags", Some(MouseEventKind::Drag(MouseButton::Left))),
            ("scrolls", Some(MouseEventKind::ScrollDown)),
        ] {
            for is_held in [false, true] {
                let start = Instant::now();
                let mut input = Input::new(start);
                let mut stops = 0;
                for at_ms in (0..2000).step_by(5) {
                    // Five every 40 ms are a held key; one after 400 ms is not.
                    let is_key = at_ms == 0
                        || if is_held {
                            (500..1500).contains(&at_ms) && at_ms % 40 == 0
                        } else {
                            at_ms == 400
                        };
                    let mut events: Vec<_> = kind.map(mouse).into_iter().collect();
                    events.extend(is_key.then(|| key(KeyCode::Char(' '))));
                    // Without an event the loop wakes after a frame.
                    if events.is_empty() && at_ms % 40 != 5 {
                        continue;
                    }
                    let now = start + Duration::from_millis(at_ms);
                    let presses = input.presses(events, now).into_iter();
                    stops += presses.filter(|press| *press == Press::Stop).count();
                }
                assert_eq!(stops, if is_held { 1 } else { 2 }, "the mouse {name}, held: {is_held}");
            }
        }
    }

    #[test]
    fn clicks_and_keys_are_handled_in_their_order() {
        let start = Instant::now();
        let mut input = Input::new(start);
        let click = mouse(MouseEventKind::Down(MouseButton::Left));
        let released = mouse(MouseEventKind::Up(MouseButton::Left));
        let events = vec![key(KeyCode::Down), click, released, key(KeyCode::Enter)];
        let expected = [Press::Move(1), Press::Click(Position::new(7, 3)), Press::Open];
        assert_eq!(input.presses(events, start), expected);
    }
}
