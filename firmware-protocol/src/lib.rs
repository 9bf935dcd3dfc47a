//! The contract between drivebench and the firmware of a drive: `no_std`, no allocation, no I/O.
//!
//! ```text
//!                       registers.rs   the one table: address, kind, scale, range, meaning
//!                            |
//!        telemetry.rs  command.rs  identity.rs  capture.rs      typed views of its four blocks
//!              |                                    |
//!        modbus/ (PDU, RTU, TCP: slave side)   stream/ (COBS frames, CRC, messages)
//!              |                                    |
//!           SPEC.md and vectors/ are generated from the code and checked by the tests
//! ```
//!
//! Addresses, scales and ranges stand in [`registers::REGISTERS`] and nowhere else.
#![no_std]
#![warn(missing_docs)]

#[cfg(test)]
extern crate std;

mod bytes;
pub mod capture;
mod codes;
pub mod command;
pub mod identity;
pub mod modbus;
pub mod registers;
pub mod stream;
pub mod telemetry;
mod wire;

pub use bytes::Bytes;
pub use capture::{CaptureControl, CaptureSample, CaptureState};
pub use command::{CommandBlock, Control, DriveCommand};
pub use identity::{DeviceKind, Identity, IdentityError};
pub use registers::{PROTOCOL_VERSION, REGISTERS, Register};
pub use telemetry::{Fault, State, Status, Telemetry};
