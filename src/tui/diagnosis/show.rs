//! The loop: keys and news in, orders out, a frame after each change.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, TryRecvError};
use std::time::Duration;

use crossterm::event::{self, Event as TerminalEvent};

use super::state::State;
use super::update::{Effect, Event};
use super::view::view;
use crate::tui::Exit;
use crate::tui::show::{FRAME, is_gone};
use crate::tui::terminal::Owned;
use crate::workflow::{News, Order};

/// What the screen is given; the worker holds the other ends.
#[derive(Debug)]
pub struct DiscoveryScreen {
    /// What is diagnosed, in a few words.
    pub title: String,
    /// No name is shown before the person has given one.
    pub guess_first: bool,
    pub news: Receiver<News>,
    pub orders: Sender<Order>,
    /// Set by signals (SIGTERM, SIGHUP): the screen closes by itself.
    pub hang_up: Arc<AtomicBool>,
}

/// Shows the screen on the calling thread until it is left. The first diagnosis is ordered by itself.
///
/// # Errors
/// Standard output is not a terminal, or the terminal fails.
pub fn show_discovery(options: DiscoveryScreen) -> io::Result<Exit> {
    let mut owned = Owned::take()?;
    let mut state = State::new(options.title, options.guess_first);
    // A worker that has gone is told below.
    let _ = options.orders.send(Order::Diagnose);
    let mut changed = true;
    loop {
        loop {
            let event = match options.news.try_recv() {
                Ok(news) => Event::News(news),
                Err(TryRecvError::Disconnected) if state.working.is_some() || state.writing => {
                    Event::WorkerGone
                }
                Err(_) => break,
            };
            changed = true;
            if let Some(Effect::Leave(exit)) = state.update(event) {
                return Ok(exit);
            }
        }
        if owned.panicked_elsewhere() {
            return Ok(Exit::WorkerPanicked);
        }
        if options.hang_up.load(Ordering::Acquire) {
            return Ok(Exit::Interrupted);
        }
        if std::mem::take(&mut changed) {
            owned.terminal.draw(|frame| view(&state, frame))?;
        }
        if is_gone(FRAME)? {
            return Err(io::Error::other("the terminal is gone"));
        }
        while event::poll(Duration::ZERO)? {
            changed = true;
            // Everything else, as a change of size, only needs a new frame.
            let TerminalEvent::Key(key) = event::read()? else {
                continue;
            };
            match state.update(Event::Key(key)) {
                Some(Effect::Order(order)) => {
                    let _ = options.orders.send(order);
                }
                Some(Effect::Leave(exit)) => return Ok(exit),
                None => {}
            }
        }
    }
}
