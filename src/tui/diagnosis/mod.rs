//! The screen on which a person finds the missing effect: how good the model is, where it fails, what would mend it.
//!
//! ```text
//! News (from the worker) --\
//! keys, resize ------------+--> State::update --> Effect --> Order to the worker, leave
//!                                 |
//!                      view(&State, frame): pure, drawn only after a change
//!
//! +-------------------------------------------+
//! | title                       working, done |
//! | verdict in one sentence                   |
//! | where it fails: figures, lights, places   |  panel/failing
//! | candidates: bars while they are judged,   |  panel/candidates
//! |   then status, size, interval             |
//! | ladder: held-out error and noise floor    |  panel/ladder
//! | keys                                      |
//! +-------------------------------------------+   over it: panel/{card, map, help}
//! ```
//!
//! `guess`: the teaching flow, in which no name is shown before the person has given one.

mod guess;
mod keys;
mod panel;
mod show;
mod state;
mod update;
mod view;

#[cfg(test)]
mod tests;

pub use show::{DiscoveryScreen, show_discovery};
