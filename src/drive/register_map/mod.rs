//! The register map of a drive that is not ours: what its profile file says, checked and resolved.
//!
//! ```text
//! TOML --schema.rs--> keys as written --resolve.rs--> RegisterMap (facts.rs) --> profiled.rs, emulator/foreign
//!                                        address.rs   40026, "01.07", [0x2100, 1] -> address on the wire
//!                                        value.rs     registers <-> number
//!                                        plan.rs      which registers are read together
//! what was read -> candidates.rs (what can be at rest, and other ways of reading it) -> is the profile right?
//! ```
//!
//! Facts only, each with the source and the trust of its file. Nothing here knows a link.

mod address;
mod candidates;
mod facts;
mod plan;
mod resolve;
mod schema;
mod value;

pub use candidates::{Candidate, Hypothesis, Picture, Window};
pub(in crate::drive) use candidates::{confirms, expected_at_rest};
pub use facts::{
    Commands, Condition, Converter, Device, DeviceKind, Expiry, IdentityCheck, IdentityTest,
    Location, Numbers, PollRate, Quantity, Rates, Reading, RegisterMap, Resync, SetPoint, Sign,
    Signal, Step, StoppedOnly, Supervision, SupervisionKind, Unit, Write,
};
pub use plan::{ReadBlock, plan_reads};
pub use schema::{SetPointKeys, SignalKeys, WatchdogKeys};
pub use value::{Byte, Kind, Layout, Order};

#[cfg(test)]
mod tests;
