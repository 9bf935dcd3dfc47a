//! The screen on fixed snapshots, keys in every state, and any data at any size.

mod any_size;
mod fixtures;
mod keys;
mod screens;
