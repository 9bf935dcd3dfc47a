//! Screens on a fixed diagnosis, keys in every state, and any data at any size.

mod fixtures;
mod keys;
mod screens;
