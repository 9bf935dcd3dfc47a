//! Parameters from data: recursive on line, batch afterwards, with honest uncertainty.

pub mod noise;
pub mod online;
pub mod output_error;
pub mod recursive;
pub mod speed_from_angle;
pub mod start;
mod verdict;
pub mod weak_form;
