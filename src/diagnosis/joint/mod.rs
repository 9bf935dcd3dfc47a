//! Several effects at once: one linear Gaussian model of what the runs' innovations hold, one posterior over all sets.
pub mod columns;
pub mod follow;
mod forms;
pub mod noise;
pub mod select;
pub mod search;
mod tangent;
mod whitened;
