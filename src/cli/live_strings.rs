//! What ties a run to the world: signals, the intents of a screen, and what the screen sees.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};

use super::failure::Failure;
use super::interrupt;
use crate::bench::{Intent, SnapshotCell};

/// What ties a run to the world: signals, intents of a screen, and what the screen sees.
pub(super) struct Strings {
    pub(super) snapshots: SnapshotCell,
    pub(super) interrupted: Arc<AtomicBool>,
    /// Set by every stop key: nothing more is to be started, also between two runs, where nobody reads intents.
    pub(super) stop_requested: Arc<AtomicBool>,
    intents: Receiver<Intent>,
}

impl Strings {
    /// Whether nothing more is to be started.
    pub(super) fn is_stopped(&self) -> bool {
        self.interrupted.load(Ordering::Acquire) || self.stop_requested.load(Ordering::Acquire)
    }

    pub(super) const fn intents(&self) -> &Receiver<Intent> {
        &self.intents
    }

    /// Registers the signals; the sender belongs to the screen.
    pub(super) fn new() -> Result<(Self, Sender<Intent>), Failure> {
        let interrupted = interrupt::flag()?;
        let (sender, intents) = channel();
        Ok((
            Self {
                snapshots: SnapshotCell::default(),
                interrupted,
                stop_requested: Arc::default(),
                intents,
            },
            sender,
        ))
    }
}
