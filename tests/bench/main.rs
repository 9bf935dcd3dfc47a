//! Benches and records of the library against the emulator's truth, in virtual time and without the binary: what is named,
//! what is covered, what is refused.
#![expect(
    clippy::unwrap_used,
    reason = "helpers of an integration test are test code"
)]

mod coverage;
mod diagnosis_on_emulator;
mod mechanical;
mod rule6;
