//! The transaction layer: what both Modbus clients have in common, without a port and without a clock.
//!
//! ```text
//! request --> proof.rs      may it go out? silence until .. | probe with .. | in step
//!    |        bound.rs      how long may it take, and does somebody want a stop meanwhile?
//!    v
//! bytes   --> reception.rs  which of them are the reply, and when did its first byte come?
//!                |          stale, foreign, damaged: counted
//!                '--> proof.rs
//! ```
//!
//! modbus.rs carries the steps out behind tokio-modbus, raw/client.rs on a bare descriptor.

mod bound;
mod proof;
mod reception;

pub(super) use bound::Bound;
pub use bound::CutIn;
pub(super) use proof::{End, Method, PATIENCE, Policy, Proof, Step};
pub use reception::LineCounts;
pub(super) use reception::Reception;

use super::link::LinkError;

pub(super) fn restless(link: &str) -> LinkError {
    LinkError::Corrupt(
        link.to_owned(),
        "the line is never silent: something talks all the time".to_owned(),
    )
}

pub(super) fn out_of_step(link: &str) -> LinkError {
    LinkError::Corrupt(
        link.to_owned(),
        "the line is out of step: no probe came back without older replies".to_owned(),
    )
}
