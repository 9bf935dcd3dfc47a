//! The register map of a drive that is not ours: its profile file, checked and resolved.
//!
//! ```text
//! TOML --schema.rs--> keys as written --resolve.rs--> RegisterMap (facts.rs) --> profiled.rs, emulator/foreign
//!                                        terms.rs     the words that keys and facts share
//!                                        address.rs   40026, "01.07", [0x2100, 1] -> address on the wire
//!                                        value.rs     registers <-> number
//!                                        plan.rs      which registers are read together
//! what was read -> candidates.rs (what can be at rest, and other ways of reading it) -> is the profile right?
//! ```
//!
//! Facts only, each with the source and the trust of its file. No link is used here.

mod address;
mod candidates;
mod facts;
mod plan;
mod resolve;
mod schema;
mod terms;
mod value;

pub use crate::framing::{Grammar, Line};
pub use candidates::{Candidate, Hypothesis, Picture, Window};
pub(crate) use candidates::{confirms, expected_at_rest};
pub use facts::{
    Beyond, Commands, Condition, Formula, IdentityCheck, IdentityTest, Location, Numbers, Reading,
    RegisterMap, SetPoint, Signal, Step, Supervision, Write, product_of,
};
pub use plan::{ReadBlock, plan_reads};
pub use schema::{SetPointKeys, SignalKeys, WatchdogKeys};
pub use terms::{
    Converter, Device, DeviceKind, Expiry, PollRate, Quantity, Rates, Resync, Sign, StoppedOnly,
    SupervisionKind, Unit,
};
pub use value::{Byte, CellSize, Kind, Layout, Order};

#[cfg(test)]
mod tests;
