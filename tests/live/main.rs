//! The real binary and the links in real time: drives in processes of their own, over pseudo-terminals and TCP. Nothing
//! that keeps every core busy runs with them.
#![cfg(target_os = "linux")]
#![expect(
    clippy::unwrap_used,
    clippy::panic,
    reason = "helpers of an integration test are test code"
)]

#[path = "../kit/mod.rs"]
mod kit;
#[path = "../witness/mod.rs"]
mod witness;

mod burst;
mod c_slave;
mod fault_trials;
mod init;
mod link_contract;
mod odd_units;
mod probe;
mod profiles;
mod reopen;
mod run;
mod screen;
mod speed;
mod suite;
mod tools;
mod ways_out;
