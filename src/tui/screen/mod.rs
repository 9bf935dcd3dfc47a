//! One file per screen.

pub(super) mod help;
pub(super) mod live;
pub(super) mod parameters;
pub(super) mod steps;
